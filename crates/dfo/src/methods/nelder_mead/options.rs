//! Options of Nelder-Mead.

use crate::error::Error;
use crate::method_interface::interface::{Lookahead, Setup};
use crate::values::choices::BoundsHandling;
use serde::{Deserialize, Serialize};

/// The coefficients of the simplex operations.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Coefficients {
    /// [`Standard`](Self::Standard) below five free parameters, [`Adaptive`](Self::Adaptive) from there on.
    #[default]
    Auto,
    /// Reflection 1, expansion 2, contraction 1/2, shrink 1/2: those of Nelder and Mead (Comput. J. 7, 1965),
    /// and of Table 1 of Gedda et al. (Modelica Conference 2012); Python's `fmin` takes them for any number
    /// of parameters.
    Standard,
    /// 1, 1 + 2/n, 3/4 - 1/(2n), 1 - 1/n: those of Gao and Han (Comput. Optim. Appl. 51, 2012).
    Adaptive,
    /// The user's.
    Custom {
        /// Positive.
        reflection: f64,
        /// Above 1 and above `reflection`.
        expansion: f64,
        /// Between 0 and 1.
        contraction: f64,
        /// Between 0 and 1.
        shrink: f64,
    },
}

/// Coefficients as numbers.
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
            // With one parameter the formulas would shrink to a point and expand threefold.
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

/// The starting simplex. Its first vertex is always the start point, unless all vertices are given.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum InitialSimplex {
    /// From the sizes of the parameters: the nominal value where one was given, else the width of the box if
    /// it tells one (see [`typical_size`](crate::typical_size)), else |x0|. Where x0 is zero and nothing else
    /// is known, the size is looked for first, by steps of powers of ten along the parameter: the one at
    /// which the cost is least becomes a vertex. That takes some ten evaluations per such parameter at the
    /// start, and some at the end; nominal values save them. Without any bound: a regular simplex with edges
    /// of `0.3 * size`, away from zero, so that multiplying a parameter by a constant changes nothing. Else
    /// one step along each free parameter: a tenth of the width of the box where that tells a size, else
    /// `0.3 * size` (a logarithmic parameter has the size 1 of its logarithm).
    #[default]
    Auto,
    /// These steps, one per parameter in the user's order; a step of a logarithmic parameter is one of `ln
    /// x`, one of a fixed parameter is ignored.
    Steps(Vec<f64>),
    /// These vertices, one more than there are free parameters, each a whole point in the user's units. The
    /// start point is then not evaluated unless it is among them.
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
    /// Number of points that are evaluated at once; default [`Lookahead::Measured`].
    pub batch: Lookahead,
    /// Coefficients; default standard below five parameters, adaptive from there on.
    pub coefficients: Coefficients,
    /// Treatment of bounds; default [`BoundsHandling::Sine`].
    #[serde(rename = "bounds_handling")]
    pub bounds: BoundsHandling,
    /// The starting simplex.
    #[serde(rename = "initial_simplex")]
    pub initial: InitialSimplex,
    /// Number of times that a simplex that is flat, or lies on a kink or beside points that failed, when the
    /// tests pass is built anew around its best vertex; default 20. A simplex is flat if its vertices
    /// (nearly) lie in a plane: then it may have stopped where the cost still falls across that plane; the
    /// new one has the size that it has then (at least 1e-3 of the sizes). At a kink it may have collapsed;
    /// the new one has 0.05 of the sizes. A sound simplex is not restarted, one that lies on a bound is not
    /// flat, and after a restart that found nothing better there is none. This is no search for other minima:
    /// for those start from several points, or use differential evolution.
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
    /// Sets the number of points that are evaluated at once.
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

    /// Sets how the search is kept in the box.
    #[must_use]
    pub fn bounds_handling(mut self, handling: BoundsHandling) -> Self {
        self.bounds = handling;
        self
    }

    /// Sets how often a flat simplex may be built anew, see [`NelderMead::restarts`](field@Self::restarts).
    #[must_use]
    pub fn restarts(mut self, restarts: usize) -> Self {
        self.restarts = restarts;
        self
    }

    /// Starts with these steps from the start point, see [`InitialSimplex::Steps`].
    #[must_use]
    pub fn initial_steps(mut self, steps: &[f64]) -> Self {
        self.initial = InitialSimplex::Steps(steps.to_vec());
        self
    }

    /// Starts with these vertices, see [`InitialSimplex::Vertices`].
    #[must_use]
    pub fn initial_simplex(mut self, vertices: Vec<Vec<f64>>) -> Self {
        self.initial = InitialSimplex::Vertices(vertices);
        self
    }
}

impl NelderMead {
    /// The problem as the search sees it: without bounds that stand for "none", over angles, if so wished.
    pub(crate) fn prepared(&self, setup: &Setup) -> Setup {
        let mut setup = Setup { space: setup.space.without_far_bounds(), ..setup.clone() };
        if self.bounds == BoundsHandling::Sine {
            setup.space = setup.space.with_sine();
        }
        setup
    }
}
