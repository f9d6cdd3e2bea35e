//! Noise of an output with an error model, at the simulated values of a fit.

use crate::error::CalibrationError;
use crate::loaded::calibration::Calibration;
use crate::problem::definition::Problem;
use crate::problem::error_model::{ErrorModel, FittedRow};
use crate::problem::experiment::Weight;
use crate::problem::residual_layout::OutputResiduals;
use base::Number;
use serde::{Deserialize, Serialize};

/// Relative change of the standard deviations of error models that ends the rounds. A change of all standard
/// deviations by this factor moves a parameter by about the same part of its standard error.
const MODEL_SETTLED: f64 = 1e-4;

/// The limit for estimated coefficients, whose errors are a hundred times larger.
const FITTED_MODEL_SETTLED: f64 = 1e-3;

/// Minimum degrees of freedom for an estimate from the residuals.
pub(super) const FEWEST: f64 = 2.0;

/// Noise of a variable with an [`ErrorModel`].
///
/// The fits alternate with the standard deviations at their simulated values and with the estimates of the
/// coefficients, if any (iterated generalised least squares: Carroll and Ruppert, Transformation and
/// Weighting in Regression, 1988, section 2.4).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct ModelledNoise {
    /// Name of the variable.
    pub variable: String,
    /// Requested error model.
    pub model: ErrorModel,
    /// Constant term, stated or estimated, in the unit of the variable.
    pub a: f64,
    /// Factor of the size of the simulated value, stated or estimated.
    pub b: f64,
    /// True if the residuals determine the estimated coefficients, or if there are none.
    pub is_of_residuals: bool,
    /// Standard deviations of the last fit, for each recording of the variable.
    pub series: Vec<SigmaSeries>,
}

/// Standard deviations of the measurements of an output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct SigmaSeries {
    /// Index of the experiment, from 0.
    pub experiment: usize,
    /// Index of the output within the experiment, from 0.
    pub output: usize,
    /// One value for each row of the recording, in the unit of the variable. Rows that do not count have the
    /// value at the measurement, or infinity.
    pub sigma: Vec<f64>,
    /// Sum of the logarithms of the standard deviations that count.
    pub sum_of_logarithms: f64,
}

impl ModelledNoise {
    /// Returns the names and values of the estimated coefficients.
    pub fn coefficients(&self) -> impl Iterator<Item = (&str, f64)> {
        let all = [(&self.model.constant, self.a), (&self.model.proportional, self.b)];
        all.into_iter().filter_map(|(of, value)| Some((of.name()?, value)))
    }

    /// True if the noise belongs to this output of a problem.
    pub(super) fn is_of(&self, problem: &Problem, output: &OutputResiduals) -> bool {
        self.variable == output.variable && weight(problem, output).error_model() == Some(&self.model)
    }

    /// Returns the noise before the first fit, from the measured values.
    pub(super) fn first(
        calibration: &Calibration,
        variable: &str,
        model: &ErrorModel,
    ) -> Result<Self, CalibrationError> {
        let noise = Self {
            variable: variable.to_owned(),
            model: model.clone(),
            a: 0.0,
            b: 0.0,
            is_of_residuals: !model.is_fitted(),
            series: Vec::new(),
        };
        let (problem, layout) = (calibration.problem(), calibration.residual_layout());
        let outputs = || layout.outputs.iter().filter(|output| noise.is_of(problem, output));
        let measured: Vec<f64> = outputs().flat_map(|output| output.measured.iter().copied()).collect();
        let [a, b] = model.at_start(&measured);
        let series = outputs().map(|output| noise.series(problem, output, [a, b], None));
        let series = series.collect::<Result<_, _>>()?;
        Ok(Self { a, b, series, ..noise })
    }

    /// Returns the standard deviations of an output at its simulated values, or at its measured values.
    fn series(
        &self,
        problem: &Problem,
        output: &OutputResiduals,
        [a, b]: [f64; 2],
        simulated: Option<&[f64]>,
    ) -> Result<SigmaSeries, CalibrationError> {
        let experiment = &problem.experiments[output.experiment];
        let measured = experiment.data.measured(&output.column, 0..experiment.data.time().len())?;
        let mut sigma = self.model.of_measured([a, b], measured);
        let mut sum_of_logarithms = 0.0;
        for (k, row) in rows_of(problem, output)?.into_iter().enumerate() {
            if let Some(simulated) = simulated {
                sigma[row] = a + b * simulated[k].abs();
            }
            if sigma[row].is_nan() || sigma[row] <= 0.0 {
                return Err(CalibrationError::Setup(format!(
                    "sigma '{}' of output '{}' (column '{}') is {} at time {}, where the simulated value is {}. Add a constant to sigma, or \
                     exclude the measurement",
                    self.model,
                    output.variable,
                    output.column,
                    Number(sigma[row]),
                    Number(output.times[k]),
                    Number(simulated.map_or(f64::NAN, |simulated| simulated[k]))
                )));
            }
            sum_of_logarithms += sigma[row].ln();
        }
        sigma
            .iter_mut()
            .filter(|sigma| sigma.is_nan() || **sigma <= 0.0)
            .for_each(|sigma| *sigma = f64::INFINITY);
        Ok(SigmaSeries { experiment: output.experiment, output: output.output, sigma, sum_of_logarithms })
    }

    /// Returns the noise after a fit with this noise.
    pub(super) fn next(
        &self,
        calibration: &Calibration,
        residuals: &[f64],
        leverages: &[f64],
    ) -> Result<Self, CalibrationError> {
        let (problem, layout) = (calibration.problem(), calibration.residual_layout());
        let (mut all, mut fitted) = (Vec::new(), Vec::new());
        let outputs = layout.outputs.iter().filter(|output| self.is_of(problem, output));
        for (output, SigmaSeries { sigma, .. }) in outputs.zip(&self.series) {
            let rows = rows_of(problem, output)?;
            let differences: Vec<f64> =
                output.range.clone().zip(rows).map(|(i, row)| residuals[i] * sigma[row]).collect();
            let simulated: Vec<f64> = output.measured.iter().zip(&differences).map(|(y, d)| y + d).collect();
            fitted.extend(output.noisy_rows().map(|i| {
                let k = i - output.range.start;
                let leverage = leverages.get(i).copied().unwrap_or(0.0);
                FittedRow { simulated: simulated[k], difference: differences[k], leverage }
            }));
            all.push((output, simulated));
        }
        let mut next = self.clone();
        if self.model.is_fitted() {
            let degrees: f64 = fitted.iter().map(|row| 1.0 - row.leverage).sum();
            let found = self.model.estimate(&fitted).filter(|_| degrees > FEWEST);
            next.is_of_residuals = found.is_some();
            [next.a, next.b] = found.unwrap_or([self.a, self.b]);
            // Residuals of exact data are simulation errors.
            let size = fitted.iter().map(|row| row.simulated.abs()).sum::<f64>() / fitted.len() as f64;
            let least = calibration.relative_tolerance();
            if next.a + next.b * size < least * size {
                match self.model.constant.name() {
                    Some(_) => next.a = least * size,
                    None => next.b = least,
                }
            }
        }
        let series = all.iter().map(|(output, y)| next.series(problem, output, [next.a, next.b], Some(y)));
        next.series = series.collect::<Result<_, _>>()?;
        Ok(next)
    }

    /// True if no standard deviation differs by more than the tolerance that ends the rounds.
    pub(super) fn is_close(&self, other: &Self) -> bool {
        let most = if self.model.is_fitted() { FITTED_MODEL_SETTLED } else { MODEL_SETTLED };
        let is_close = |a: &f64, b: &f64| a == b || (a / b).ln().abs() <= most;
        let mut pairs = self.series.iter().zip(&other.series);
        pairs.all(|(a, b)| a.sigma.iter().zip(&b.sigma).all(|(a, b)| is_close(a, b)))
    }
}

/// Returns the row of the recording of each measurement of an output.
pub(super) fn rows_of(problem: &Problem, output: &OutputResiduals) -> Result<Vec<usize>, CalibrationError> {
    let data = &problem.experiments[output.experiment].data;
    Ok(output.rows_of(data.time(), data.measured(&output.column, 0..data.time().len())?))
}

/// Returns the weight of an output.
pub(super) fn weight<'a>(problem: &'a Problem, output: &OutputResiduals) -> &'a Weight {
    &problem.experiments[output.experiment].outputs[output.output].weight
}
