//! Options of Nelder-Mead.

use crate::error::Error;
use crate::method_interface::interface::{Lookahead, Setup};
use crate::problem::space::Space;
use crate::values::choices::BoundsHandling;
use serde::{Deserialize, Serialize};

/// Coefficients of the simplex operations.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Coefficients {
    /// [`Standard`](Self::Standard) below five free parameters, [`Adaptive`](Self::Adaptive) for five and
    /// more.
    #[default]
    Auto,
    /// Reflection 1, expansion 2, contraction 1/2, shrink 1/2, from Nelder and Mead (Comput. J. 7, 1965) and
    /// Table 1 of Gedda et al. (Modelica Conference 2012). Python's `fmin` uses them for any number of
    /// parameters.
    Standard,
    /// 1, 1 + 2/n, 3/4 - 1/(2n), 1 - 1/n, from Gao and Han (Comput. Optim. Appl. 51, 2012).
    Adaptive,
    /// User-defined coefficients.
    Custom {
        /// Reflection coefficient; positive.
        reflection: f64,
        /// Expansion coefficient; above 1 and above `reflection`.
        expansion: f64,
        /// Contraction coefficient; between 0 and 1.
        contraction: f64,
        /// Shrink coefficient; between 0 and 1.
        shrink: f64,
    },
}

/// Numeric values of the coefficients.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct CoefficientValues {
    pub(super) reflection: f64,
    pub(super) expansion: f64,
    pub(super) contraction: f64,
    pub(super) shrink: f64,
}

impl Coefficients {
    pub(super) fn resolve(self, n: usize) -> Result<CoefficientValues, Error> {
        let standard = CoefficientValues { reflection: 1.0, expansion: 2.0, contraction: 0.5, shrink: 0.5 };
        let d = n as f64;
        match self {
            Self::Standard => Ok(standard),
            Self::Auto if n < 5 => Ok(standard),
            // With one parameter, the formulas would shrink to a point and expand threefold.
            Self::Adaptive if n < 2 => Ok(standard),
            Self::Auto | Self::Adaptive => Ok(CoefficientValues {
                reflection: 1.0,
                expansion: 1.0 + 2.0 / d,
                contraction: 0.75 - 1.0 / (2.0 * d),
                shrink: 1.0 - 1.0 / d,
            }),
            Self::Custom { reflection, expansion, contraction, shrink } => {
                let fraction = |v: f64| v > 0.0 && v < 1.0;
                for (name, value, good, range) in [
                    (
                        "reflection",
                        reflection,
                        reflection > 0.0 && reflection.is_finite(),
                        "positive and finite",
                    ),
                    (
                        "expansion",
                        expansion,
                        expansion > 1.0 && expansion > reflection && expansion.is_finite(),
                        "above 1 and above the reflection coefficient",
                    ),
                    ("contraction", contraction, fraction(contraction), "between 0 and 1"),
                    ("shrink", shrink, fraction(shrink), "between 0 and 1"),
                ] {
                    if !good {
                        return Err(Error::Option { name, value, range });
                    }
                }
                Ok(CoefficientValues { reflection, expansion, contraction, shrink })
            }
        }
    }
}

/// Initial simplex. Its first vertex is always the start point, unless all vertices are given.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum InitialSimplex {
    /// Determined from the sizes of the parameters. The size is the nominal value if given, otherwise the
    /// width of the box if it determines a size (see [`typical_size`](crate::typical_size)), otherwise |x0|.
    /// If x0 is zero and nothing else is known, steps of powers of ten along the parameter first determine
    /// the size. The step with the lowest cost becomes a vertex. This costs about ten evaluations per such
    /// parameter at the start, and some at the end; nominal values avoid them. Without any bound, the simplex
    /// is regular with edges of `0.3 * size`, pointing away from zero. Multiplying a parameter by a constant
    /// then has no effect. With bounds, the simplex has one step along each free parameter. The step is a
    /// tenth of the width of the box if the width determines a size, otherwise `0.3 * size` (a logarithmic
    /// parameter has the size 1 of its logarithm).
    #[default]
    Auto,
    /// These steps, one per parameter in the user's order. A step of a logarithmic parameter is a step of `ln
    /// x`. Steps of fixed parameters are ignored.
    Steps(Vec<f64>),
    /// These vertices, one more than the number of free parameters. Each vertex is a complete point in the
    /// user's units. The start point is evaluated only if it is one of the vertices.
    Vertices(Vec<Vec<f64>>),
}

/// Options of the Nelder-Mead method.
///
/// ```
/// use dfo::{Lookahead, NelderMead};
/// let method = NelderMead::default().batch(Lookahead::Points(4)).initial_steps(&[0.1, 0.02]);
/// # assert_eq!(method.batch, Lookahead::Points(4));
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct NelderMead {
    /// Number of points evaluated at once; default [`Lookahead::Measured`].
    pub batch: Lookahead,
    /// Coefficients; default standard below five parameters, adaptive for five and more.
    pub coefficients: Coefficients,
    /// Treatment of bounds and linear constraints. Default: [`BoundsHandling::Sine`], or
    /// [`BoundsHandling::Mirror`] with linear constraints.
    #[serde(rename = "bounds_handling")]
    pub bounds: BoundsHandling,
    /// Initial simplex.
    #[serde(rename = "initial_simplex")]
    pub initial: InitialSimplex,
    /// Maximum number of restarts; default 20. A restart rebuilds the simplex around its best vertex after
    /// the tests have passed. The simplex is rebuilt if it is flat, on a kink, or next to failed points. A
    /// flat simplex has vertices (nearly) in a plane, and may have stopped where the cost still decreases
    /// across this plane. The new simplex has the size of the flat one (at least 1e-3 of the parameter
    /// sizes). On a kink, the simplex may have collapsed, and the new one has 0.05 of the parameter sizes. A
    /// sound simplex is not restarted, and a simplex on a bound does not count as flat. A restart without a
    /// better result is the last one. Restarts do not search for other minima. To find these, start from
    /// several points or use differential evolution.
    pub restarts: usize,
}

impl Default for NelderMead {
    fn default() -> Self {
        Self {
            batch: Lookahead::Measured,
            coefficients: Coefficients::Auto,
            bounds: BoundsHandling::default(),
            initial: InitialSimplex::Auto,
            restarts: 20,
        }
    }
}

impl NelderMead {
    /// Sets the number of points evaluated at once.
    #[must_use]
    pub fn batch(mut self, points: Lookahead) -> Self {
        self.batch = points;
        self
    }

    /// Sets the coefficients.
    #[must_use]
    pub fn coefficients(mut self, coefficients: Coefficients) -> Self {
        self.coefficients = coefficients;
        self
    }

    /// Sets the treatment of points outside the bounds.
    #[must_use]
    pub fn bounds_handling(mut self, handling: BoundsHandling) -> Self {
        self.bounds = handling;
        self
    }

    /// Sets the maximum number of restarts, see [`NelderMead::restarts`](field@Self::restarts).
    #[must_use]
    pub fn restarts(mut self, restarts: usize) -> Self {
        self.restarts = restarts;
        self
    }

    /// Sets the steps from the start point to the other vertices, see [`InitialSimplex::Steps`].
    #[must_use]
    pub fn initial_steps(mut self, steps: &[f64]) -> Self {
        self.initial = InitialSimplex::Steps(steps.to_vec());
        self
    }

    /// Sets the vertices of the initial simplex, see [`InitialSimplex::Vertices`].
    #[must_use]
    pub fn initial_simplex(mut self, vertices: Vec<Vec<f64>>) -> Self {
        self.initial = InitialSimplex::Vertices(vertices);
        self
    }
}

impl NelderMead {
    /// Returns the setup without bounds that mean "unbounded". If the bounds are treated by sines, the
    /// parameters are angles.
    pub(crate) fn prepared(&self, setup: &Setup) -> Setup {
        let mut setup = Setup { space: setup.space.without_far_bounds(), ..setup.clone() };
        if self.handling(&setup.space) == BoundsHandling::Sine {
            setup.space = setup.space.with_sine();
        }
        setup
    }

    /// Returns the treatment of bounds. Linear constraints are not linear in angles, so sines are replaced by
    /// mirroring. With clamping, a simplex becomes flat: 48 of 6000 quadratic programs then end with a false
    /// success, and one with mirroring (`benches/quadratic_programs.rs`).
    pub(super) fn handling(&self, space: &Space) -> BoundsHandling {
        match self.bounds {
            BoundsHandling::Sine if space.has_linear() => BoundsHandling::Mirror,
            handling => handling,
        }
    }
}
