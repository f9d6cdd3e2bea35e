//! Effects that the model leaves out of an output, where one number describes them: an offset, a factor, a
//! delay, a drift of the measurements.

use crate::error::CalibrationError;
use crate::findings::shown_text::digits;
use crate::problem::residual_layout::OutputResiduals;
use crate::uncertainty::row_blocks::go_on;
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Of fewer residuals one number more explains too much.
const FEWEST: usize = 20;

/// It leaves no more than this part of the squares of the output, and this part of all squares.
const LEFT: (f64, f64) = (0.1, 0.5);

/// A change that the parameters make, too, but for this part of its squares, is no other one.
const OWN: f64 = 1e-3;

/// What the changes along an orthonormal base leave of residuals.
pub(crate) fn left(residuals: &[f64], base: &DMatrix<f64>) -> DVector<f64> {
    let residuals = DVector::from_column_slice(residuals);
    let along = base.tr_mul(&residuals);
    residuals - base * along
}

/// Kind of effect in the measurements that the simulation does not have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum OutputEffectKind {
    /// A number is added to them.
    Offset,
    /// They are multiplied with one.
    Factor,
    /// They are late.
    Delay,
    /// They move away with time.
    Drift,
}

impl OutputEffectKind {
    pub(crate) const ALL: [Self; 4] = [Self::Offset, Self::Factor, Self::Delay, Self::Drift];

    /// What to do about it.
    pub(crate) fn remedy(self) -> &'static str {
        match self {
            Self::Offset => {
                "is the zero of the sensor right, and its unit? A parameter with offset_of fits it"
            }
            Self::Factor => "are the unit and the gain of the sensor right?",
            Self::Delay => {
                "do inputs and outputs have the same clock? A parameter with delay_of fits it; delays that are known stand in delays"
            }
            Self::Drift => "does the sensor drift? Leave the trend out",
        }
    }
}

/// The changes of the residuals of an output by what its measurements may have.
pub(crate) struct Changes<'a> {
    output: &'a OutputResiduals,
    simulated: Vec<f64>,
    /// The middle of the times.
    middle: f64,
}

impl<'a> Changes<'a> {
    /// Of an output with these residuals.
    pub(crate) fn of(output: &'a OutputResiduals, residuals: &[f64]) -> Self {
        let OutputResiduals { measured, weights, times, .. } = output;
        let simulated = (0..residuals.len()).map(|k| measured[k] + residuals[k] / weights[k]).collect();
        let middle = times.iter().sum::<f64>() / times.len() as f64;
        Self { output, simulated, middle }
    }

    /// By how much each residual, simulated less measured, falls for a size of one.
    pub(crate) fn by(&self, kind: OutputEffectKind) -> DVector<f64> {
        let Self { output: OutputResiduals { times, weights, .. }, simulated, middle } = self;
        let slope = |k: usize| {
            let (a, b) = (k.saturating_sub(1), (k + 1).min(simulated.len() - 1));
            (simulated[b] - simulated[a]) / (times[b] - times[a])
        };
        DVector::from_fn(simulated.len(), |k, _| {
            weights[k]
                * match kind {
                    OutputEffectKind::Offset => -1.0,
                    OutputEffectKind::Factor => -simulated[k],
                    OutputEffectKind::Delay => slope(k),
                    OutputEffectKind::Drift => middle - times[k],
                }
        })
    }
}

/// One number of an output that would explain its residuals, together with other values of the parameters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct OutputEffect {
    /// Kind of the effect.
    pub kind: OutputEffectKind,
    /// The offset in the unit of the variable, the factor, the delay in s, the drift per s.
    pub size: f64,
    /// The part of the squares of the output that it would leave.
    pub left: f64,
}

impl OutputEffect {
    /// The best explanation of the residuals (m) of an output, beside an orthonormal base U (m x q) of the
    /// changes that the parameters make. `before`: what these leave of the residuals, to which U is
    /// orthogonal: so of a change v of this output the rows of the others are not needed, `v'(I - U U') v` is
    /// `v'v` less the square of `U'v`.
    ///
    /// # Errors
    /// [`CalibrationError::Cancelled`].
    pub(crate) fn find(
        output: &OutputResiduals,
        residuals: &[f64],
        before: &DVector<f64>,
        base: &DMatrix<f64>,
        context: &RunContext<'_>,
    ) -> Result<Option<Self>, CalibrationError> {
        let range = &output.range;
        if range.len() < FEWEST {
            return Ok(None);
        }
        let changes = Changes::of(output, &residuals[range.clone()]);
        let (base, all_before) = (base.rows(range.start, range.len()), before.norm_squared());
        let before = before.rows(range.start, range.len());
        let of = |kind: OutputEffectKind| {
            let change = changes.by(kind);
            let (along, all) = (base.tr_mul(&change), change.norm_squared());
            let beside = all - along.norm_squared();
            let size = change.dot(&before) / beside;
            let after = before - (&change - base * along) * size;
            let left = after.norm_squared() / before.norm_squared();
            let explains = left < LEFT.0 && all_before - size * size * beside < LEFT.1 * all_before;
            let is_other = all.is_finite() && beside > OWN * all;
            let size = if kind == OutputEffectKind::Factor { 1.0 + size } else { size };
            // A sign is no gain.
            let is_possible = size.is_finite() && (kind != OutputEffectKind::Factor || size > 0.0);
            (explains && is_other && is_possible).then_some(Self { kind, size, left })
        };
        let mut best: Option<Self> = None;
        for kind in OutputEffectKind::ALL {
            go_on(context)?;
            let found = of(kind).filter(|found| best.is_none_or(|best| found.left < best.left));
            best = found.or(best);
        }
        Ok(best)
    }

    /// Description of the effect with its number.
    pub(crate) fn words(&self) -> String {
        let size = digits(self.size);
        match self.kind {
            OutputEffectKind::Offset => format!("an offset of the measurements of {size}"),
            OutputEffectKind::Factor => format!("measurements that are {size} times as large"),
            OutputEffectKind::Delay => format!("measurements that are {size} s late"),
            OutputEffectKind::Drift => format!("a drift of the measurements of {size} per s"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_number_is_found_beside_a_parameter() {
        let n = 200;
        let t: Vec<f64> = (0..n).map(|k| 0.05 * f64::from(k)).collect();
        let noise = |k: usize| 1e-3 * ((12.9898 * (k as f64 + 1.0)).sin() * 43_758.547).fract();
        let simulated: Vec<f64> = t.iter().map(|t| 2.0 + t.sin()).collect();
        // A parameter that moves the output by t^2.
        let column = DVector::from_iterator(t.len(), t.iter().map(|t| t * t));
        let base = DMatrix::from_columns(&[&column / column.norm()]);
        let cases = [
            (OutputEffectKind::Offset, 0.3),
            (OutputEffectKind::Factor, 1.2),
            (OutputEffectKind::Delay, 0.05),
            (OutputEffectKind::Drift, 0.1),
        ];
        for (kind, size) in cases {
            let measured = (0..t.len()).map(|k| {
                noise(k)
                    + match kind {
                        OutputEffectKind::Offset => simulated[k] + size,
                        OutputEffectKind::Factor => simulated[k] * size,
                        OutputEffectKind::Delay => 2.0 + (t[k] - size).sin(),
                        OutputEffectKind::Drift => simulated[k] + size * (t[k] - 5.0),
                    }
            });
            let measured: Vec<f64> = measured.collect();
            // Weights of 2, and the parameter has moved.
            let moved = |k: usize| 0.01 * t[k] * t[k];
            let residuals: Vec<f64> =
                (0..t.len()).map(|k| 2.0 * (simulated[k] - measured[k] + moved(k))).collect();
            let output = OutputResiduals {
                experiment: 0,
                output: 0,
                variable: "y".to_owned(),
                column: "y".to_owned(),
                range: 0..t.len(),
                times: t.clone().into(),
                measured: measured.into(),
                weights: vec![2.0; t.len()].into(),
                starts_simulation: false,
            };
            let found =
                OutputEffect::find(&output, &residuals, &left(&residuals, &base), &base, &RunContext::new())
                    .unwrap()
                    .unwrap();
            assert!(found.kind == kind && (found.size - size).abs() < 0.1 * size, "{found:?}");
            assert!(
                found.left < 0.02 && found.words().contains("of the") || found.words().contains("that are")
            );
        }
    }
}
