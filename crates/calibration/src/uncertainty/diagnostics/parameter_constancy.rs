//! Constancy of the parameters: whether parts of the measurements ask for the same values.

use crate::error::CalibrationError;
use crate::findings::finding::Finding;
use crate::findings::shown_text::digits;
use crate::problem::residual_layout::{OutputResiduals, ResidualLayout};
use crate::uncertainty::diagnostics::residual_check::ResidualCheck;
use crate::uncertainty::p_values::BY_CHANCE;
use crate::uncertainty::row_blocks::{go_on, triangle};
use base::RunContext;
use nalgebra::{DMatrix, DVector, Dyn, StorageMut, Vector};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};
use std::ops::Range;

/// A part leaves at least so many degrees of freedom to its own values of the parameters.
const FEWEST_DEGREES: usize = 3;

/// Larger matrices are not copied: so many numbers take some 100 MB.
const MOST: usize = 1 << 24;

/// A combination of the parameters that changes a part by less than this part of what it changes all
/// measurements by is not determined by the part.
const LEAST: f64 = 1e-6;

/// Two parts of the measurements.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum DataSplit {
    /// The first and the second half of each recording.
    Halves,
    /// The measurements of a variable of the model, and those of the others.
    Variable(String),
    /// An experiment, and the others.
    Experiment(String),
}

/// Two parts of the measurements that no common values of the parameters suit: each with values of its own
/// leaves less than their noise explains (Chow, Econometrica 28, 1960, with a variance of its own for each
/// part), as linearised around the result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct PartConflict {
    /// The parts.
    pub parts: DataSplit,
    /// The chance of residuals like these if the same values hold for both.
    pub chance: f64,
    /// The parameter whose values differ most for their standard errors, by number, with the value and the
    /// standard error of each part; `None` where a part alone does not determine the parameters.
    pub differs_most: Option<(usize, [(f64, f64); 2])>,
}

/// The rows of a part, of `[U r]` in standard deviations, as a triangle.
struct Part {
    triangle: DMatrix<f64>,
    n: usize,
}

/// Least squares of a part alone.
struct Alone {
    /// Variance of its residuals.
    variance: f64,
    degrees: usize,
    /// The step of the coordinates along U, and its covariance; `None` where not all are determined.
    step: Option<(DVector<f64>, DMatrix<f64>)>,
}

impl Part {
    fn new(
        rows: &DMatrix<f64>,
        ranges: &[Range<usize>],
        context: &RunContext<'_>,
    ) -> Result<Self, CalibrationError> {
        let n = ranges.iter().map(ExactSizeIterator::len).sum();
        Ok(Self { triangle: triangle(rows, ranges, context)?, n })
    }

    fn alone(&self) -> Option<Alone> {
        let q = self.triangle.ncols() - 1;
        let changes = self.triangle.columns(0, q).into_owned();
        let right = self.triangle.column(q).into_owned();
        let svd = changes.try_svd(true, true, f64::EPSILON, 10_000)?;
        let (u, v_t) = (svd.u?, svd.v_t?);
        let rank = svd.singular_values.iter().filter(|s| **s > LEAST).count();
        let along = u.columns(0, rank).tr_mul(&right);
        let degrees = self.n.checked_sub(rank).filter(|degrees| *degrees >= FEWEST_DEGREES)?;
        let variance = (right.norm_squared() - along.norm_squared()) / degrees as f64;
        let step = (rank == q).then(|| {
            let scaled = DMatrix::from_fn(q, q, |i, k| v_t[(k, i)] / svd.singular_values[k]);
            (-(&scaled * along), &scaled * scaled.transpose() * variance)
        });
        (variance > f64::EPSILON).then_some(Alone { variance, degrees, step })
    }
}

/// Residuals, and what their noise is supposed to be.
pub(crate) struct WithNoise<'a> {
    pub(crate) values: &'a [f64],
    /// Variances of each if they are independent.
    pub(crate) variances: &'a [f64],
    /// Of each output.
    pub(crate) autocorrelations: &'a [f64],
}

impl WithNoise<'_> {
    /// Divides a change of the residuals by their noise, and frees it from the autocorrelation that an output
    /// has (Prais and Winsten, 1954).
    pub(crate) fn whiten<S: StorageMut<f64, Dyn>>(
        &self,
        layout: &ResidualLayout,
        column: &mut Vector<f64, Dyn, S>,
    ) {
        column.iter_mut().zip(self.variances).for_each(|(value, variance)| *value /= variance.sqrt());
        for (output, rho) in layout.outputs.iter().zip(self.autocorrelations).filter(|(_, rho)| **rho != 0.0)
        {
            let scale = (1.0 - rho * rho).sqrt().recip();
            for i in output.range.clone().skip(1).rev() {
                column[i] = (column[i] - rho * column[i - 1]) * scale;
            }
        }
    }

    /// True if each has noise.
    pub(crate) fn is_noisy(&self) -> bool {
        self.variances.iter().all(|v| *v > 0.0 && v.is_finite())
    }
}

/// The free parameters of the estimate.
pub(crate) struct FreeParameters<'a> {
    /// Their numbers.
    pub(crate) free: &'a [usize],
    pub(crate) x: &'a [f64],
    pub(crate) is_log: &'a [bool],
    /// Steps of the coordinates of the search by those along U.
    pub(crate) inverse: DMatrix<f64>,
}

impl PartConflict {
    /// The least likely conflict between two parts, if it is no chance. `base`: U, of the changes that the
    /// parameters make of the residuals, `by_starts`: changes by
    /// measured initial states, which each part may have of its own.
    ///
    /// # Errors
    /// [`CalibrationError::Cancelled`].
    pub(crate) fn find(
        layout: &ResidualLayout,
        checks: &[ResidualCheck],
        residuals: &WithNoise<'_>,
        base: &DMatrix<f64>,
        by_starts: &[DVector<f64>],
        mut parameters: FreeParameters<'_>,
        context: &RunContext<'_>,
    ) -> Result<Option<Self>, CalibrationError> {
        let (n, q) = (base.nrows(), base.ncols() + by_starts.len());
        let pairs = pairs(layout, checks);
        if q == 0 || n.saturating_mul(q) > MOST || n < 2 * (q + FEWEST_DEGREES) || !residuals.is_noisy() {
            return Ok(None);
        }
        let mut rows = base.clone().resize_horizontally(q + 1, 0.0);
        for (k, change) in by_starts.iter().enumerate() {
            rows.column_mut(base.ncols() + k).copy_from(change);
        }
        rows.column_mut(q).copy_from_slice(residuals.values);
        for mut column in rows.column_iter_mut() {
            go_on(context)?;
            residuals.whiten(layout, &mut column);
        }
        for k in 0..q {
            let norm = rows.column(k).norm();
            rows.column_mut(k).scale_mut(norm.recip());
            if k < base.ncols() {
                parameters.inverse.column_mut(k).scale_mut(norm.recip());
            }
        }
        let mut found: Option<Self> = None;
        let n_pairs = pairs.len() as f64;
        for (parts, ranges) in pairs {
            let [a, b] = [Part::new(&rows, &ranges[0], context)?, Part::new(&rows, &ranges[1], context)?];
            let conflict =
                conflict(parts, &a, &b, &parameters).map(|own| Self { chance: own.chance * n_pairs, ..own });
            let worse =
                conflict.filter(|own| own.chance < found.as_ref().map_or(BY_CHANCE, |found| found.chance));
            found = worse.or(found);
        }
        Ok(found)
    }

    pub(crate) fn finding(&self, names: &[String]) -> Finding {
        let (subject, parts) = match &self.parts {
            DataSplit::Halves => {
                ("measurements".to_owned(), "the first and the second half of the measurements".to_owned())
            }
            DataSplit::Variable(name) => (name.clone(), format!("{name} and the other outputs")),
            DataSplit::Experiment(name) => (name.clone(), format!("{name} and the other experiments")),
        };
        let differs = match &self.differs_most {
            Some((index, [(a, of_a), (b, of_b)])) => format!(
                " (apart, {} about {} +- {} and {} +- {})",
                names[*index],
                digits(*a),
                digits(*of_a),
                digits(*b),
                digits(*of_b)
            ),
            None => String::new(),
        };
        let sentence = format!(
            "{parts} ask for different values of the parameters{differs}; by chance with a probability of {}: the model leaves out \
             something, or a column, an input or a value that is held is wrong",
            digits(self.chance)
        );
        Finding::warning(
            subject,
            sentence,
            "look at the residuals of both; fit them apart to see how the values differ",
        )
    }
}

/// Pairs of parts, as rows of the residual vector; priors belong to the second.
fn pairs(layout: &ResidualLayout, checks: &[ResidualCheck]) -> Vec<(DataSplit, [Vec<Range<usize>>; 2])> {
    let outputs = &layout.outputs;
    let priors = layout.n_measurements()..layout.n_residuals();
    let halves = |first: bool| {
        let half = |output: &OutputResiduals| {
            let Range { start, end } = output.range;
            let middle = start + (end - start) / 2;
            if first { start..middle } else { middle..end }
        };
        outputs.iter().map(half).chain((!first).then(|| priors.clone())).collect()
    };
    let mut pairs = vec![(DataSplit::Halves, [halves(true), halves(false)])];
    let mut add = |name: &dyn Fn(usize) -> String, parts: &dyn Fn(String) -> DataSplit| {
        let mut names: Vec<String> = (0..outputs.len()).map(name).collect();
        let own = |is: &dyn Fn(&str) -> bool| -> Vec<Range<usize>> {
            (0..outputs.len()).filter(|k| is(&name(*k))).map(|k| outputs[k].range.clone()).collect()
        };
        names.sort();
        names.dedup();
        // Of two either is the other of the other.
        let n = if names.len() <= 2 { names.len() / 2 } else { names.len() };
        for one in names.into_iter().take(n) {
            let (this, mut others) = (own(&|name| name == one), own(&|name| name != one));
            others.push(priors.clone());
            pairs.push((parts(one), [this, others]));
        }
    };
    add(&|k| outputs[k].variable.clone(), &DataSplit::Variable);
    add(&|k| checks[k].experiment.clone(), &DataSplit::Experiment);
    pairs
}

/// With a variance of its own for each part: the test of Chow after weighing each by it, with the degrees of
/// freedom of the smaller part.
fn conflict(parts: DataSplit, a: &Part, b: &Part, parameters: &FreeParameters<'_>) -> Option<PartConflict> {
    let (of_a, of_b) = (a.alone()?, b.alone()?);
    let q = a.triangle.ncols() - 1;
    let (top, n_top) = (&a.triangle / of_a.variance.sqrt(), a.triangle.nrows());
    let mut stacked = top.resize_vertically(n_top + b.triangle.nrows(), 0.0);
    stacked.rows_mut(n_top, b.triangle.nrows()).copy_from(&(&b.triangle / of_b.variance.sqrt()));
    let together = stacked.qr().r();
    let together = if together.nrows() > q { together[(q, q)].powi(2) } else { return None };
    let (apart, n) = (of_a.degrees + of_b.degrees, a.n + b.n);
    let of_own = (n - q).checked_sub(apart).filter(|of_own| *of_own > 0)?;
    let ratio = (together - apart as f64) / of_own as f64;
    let degrees = of_a.degrees.min(of_b.degrees);
    let chance = FisherSnedecor::new(of_own as f64, degrees as f64).ok()?.sf(ratio.max(0.0));
    let differs_most = of_a.step.zip(of_b.step).and_then(|(a, b)| parameters.differs_most(&a, &b));
    Some(PartConflict { parts, chance, differs_most })
}

type Step = (DVector<f64>, DMatrix<f64>);

impl FreeParameters<'_> {
    /// The parameter with the most standard errors between the steps of two parts, with its values.
    fn differs_most(&self, a: &Step, b: &Step) -> Option<(usize, [(f64, f64); 2])> {
        let step = |k: usize, (step, covariance): &Step| {
            let (row, q) = (self.inverse.row(k), self.inverse.ncols());
            let variance = (row * covariance.view((0, 0), (q, q)) * row.transpose())[(0, 0)];
            ((row * step.rows(0, q))[(0, 0)], variance.max(0.0).sqrt())
        };
        let value = |k: usize, (step, error): (f64, f64)| {
            let x = self.x[self.free[k]];
            match self.is_log[self.free[k]] {
                true => (x * step.exp(), x * step.exp() * error),
                false => (x + step, error),
            }
        };
        let of = |k: usize| {
            let (a, b) = (step(k, a), step(k, b));
            ((a.0 - b.0).abs() / a.1.hypot(b.1), (self.free[k], [value(k, a), value(k, b)]))
        };
        let all = (0..self.free.len()).map(of).filter(|(apart, _)| apart.is_finite());
        all.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, of)| of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::uncertainty::p_values::normal_numbers;

    fn layout(n: usize) -> ResidualLayout {
        let output = |k: usize| OutputResiduals {
            experiment: 0,
            output: k,
            variable: format!("y{k}"),
            column: format!("y{k}"),
            range: k * n..(k + 1) * n,
            times: (0..n).map(|i| i as f64).collect::<Vec<_>>().into(),
            measured: vec![0.0; n].into(),
            weights: vec![1.0; n].into(),
            starts_simulation: false,
        };
        ResidualLayout { outputs: vec![output(0), output(1)], priors: Vec::new() }
    }

    /// Two outputs of n rows, and a fit of four parameters to both. The second half is half as noisy again,
    /// the second output three times as noisy.
    #[test]
    fn parts_conflict_by_their_values_and_not_by_their_noise() {
        for n in [12, 60] {
            let (layout, mut state) = (layout(n), 1);
            let t = |i: usize| (i % n) as f64 / n as f64;
            let changes = |i: usize, j: usize| match (j, i / n) {
                (3, output) => output as f64,
                (j, output) => (t(i) * (j as f64 + 1.0) * (1.0 + output as f64)).cos(),
            };
            let base = DMatrix::from_fn(2 * n, 4, changes).qr().q();
            let sd = |i: usize| if i < n { 1.0 } else { 3.0 };
            let by_half = |i: usize| if t(i) < 0.5 { 1.0 } else { 1.5 };
            let checks =
                ResidualCheck::all(&layout, &["a".to_owned()], &vec![0.0; 2 * n], None, &RunContext::new())
                    .unwrap();
            let variances: Vec<f64> = (0..2 * n).map(|i| (sd(i) * 1.27_f64).powi(2)).collect();
            let found = |errors: &[f64]| {
                let errors = DVector::from_column_slice(errors);
                let left = &errors - &base * base.tr_mul(&errors);
                let (free, x, is_log, inverse) =
                    ([0, 1, 2, 3], [1.0; 4], [false; 4], DMatrix::identity(4, 4));
                let parameters = FreeParameters { free: &free, x: &x, is_log: &is_log, inverse };
                let residuals = WithNoise {
                    values: left.as_slice(),
                    variances: &variances,
                    autocorrelations: &[0.0, 0.0],
                };
                let context = RunContext::new();
                PartConflict::find(&layout, &checks, &residuals, &base, &[], parameters, &context).unwrap()
            };
            let noise = |state: &mut u64| -> Vec<f64> {
                let own = normal_numbers(2 * n, state);
                own.iter().enumerate().map(|(i, e)| e * sd(i) * by_half(i)).collect()
            };
            let false_alarms = (0..4000).filter(|_| found(&noise(&mut state)).is_some()).count();
            assert!(false_alarms <= 12, "{n}: {false_alarms} of 4000, where 4 are expected");
            // Other values in the second half.
            let conflicts = (0..100).filter(|_| {
                let mut errors = noise(&mut state);
                (0..2 * n)
                    .filter(|i| t(*i) >= 0.5)
                    .for_each(|i| errors[i] += 40.0 * base[(i, 1)] * (n as f64).sqrt());
                found(&errors).is_some_and(|conflict| {
                    conflict.parts == DataSplit::Halves && conflict.differs_most.is_some()
                })
            });
            let conflicts = conflicts.count();
            assert!(conflicts >= 80, "{n}: {conflicts}");
        }
    }
}
