//! What does not fit between model, recordings and parameters, said before anything is fitted.

mod finding;
mod model;
mod recording;
mod simulated;
mod subject;

pub use finding::{Check, Finding, Severity};

use crate::calibration::Calibration;
use crate::error::CalibrationError;
use ode::Stats;
use subject::Subject;

impl Calibration {
    /// Looks for what does not fit, and says what to do about it: with one evaluation at the parameters' start values, and another with
    /// times a thousandth as long where the times could be in ms.
    ///
    /// Looked at are the times (order, gaps, unit, start), the recorded values (constant, clipped, missing, units, initial values,
    /// columns that are swapped), inputs that nothing drives or that end early, and ranges that the model states for its parameters. What
    /// cannot be evaluated at all is refused when the calibration is built.
    pub fn check(&self) -> Check {
        self.check_until(true, &|| false).unwrap_or_default()
    }

    /// As [`check`](Self::check); simulates only if `simulate` says so, and ends when `cancelled` does.
    ///
    /// # Errors
    /// [`CalibrationError::Cancelled`] alone: a simulation that fails is a finding.
    pub fn check_until(
        &self,
        simulate: bool,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Check, CalibrationError> {
        self.check_counted((simulate, None), cancelled, &mut Stats::default())
    }

    /// The same; `known`: the residuals at the parameters' start values, without a loss, which are not simulated again then. What
    /// simulations take is added to `stats`.
    pub(crate) fn check_counted(
        &self,
        (simulate, known): (bool, Option<&[f64]>),
        cancelled: &dyn Fn() -> bool,
        stats: &mut Stats,
    ) -> Result<Check, CalibrationError> {
        let (problem, description) = (self.problem(), self.fmu().description());
        let mut findings = model::construction_warnings(self.warnings());
        findings.extend(model::parameters(self.parameters(), description));
        findings.extend(model::priors(problem));
        let names = problem.experiment_names();
        let is_one = names.len() == 1;
        let subjects: Vec<Subject<'_>> = (problem.experiments.iter().zip(&names).enumerate())
            .map(|(k, (experiment, name))| Subject {
                prefix: if is_one { String::new() } else { format!("{name}: ") },
                experiment,
                description,
                start_time: self.evaluator().simulations[k].options.start_time.unwrap_or_default(),
            })
            .collect();
        for subject in &subjects {
            findings.extend(model::inputs(subject));
            findings.extend(model::units(subject));
            findings.extend(recording::times(subject));
            findings.extend(recording::columns(subject));
        }
        let mut n_evaluations = 0;
        if simulate {
            let at_start = match known {
                Some(residuals) => Ok(residuals.to_vec()),
                None => {
                    n_evaluations += 1;
                    self.residuals_counted(&self.start(), cancelled, stats)
                }
            };
            let asked = (cancelled, &mut n_evaluations, stats);
            findings.extend(simulated::findings(self, &subjects, at_start, asked)?);
        }
        findings.sort_by_key(|finding| finding.severity);
        Ok(Check { findings, n_evaluations })
    }
}
