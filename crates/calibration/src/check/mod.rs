//! What does not fit between model, recordings and parameters, said before anything is fitted.

mod model;
mod recording;
mod result;
mod scales;
mod simulated;
mod subject;

pub(crate) use model::unstated_noise;
pub use result::Check;

use crate::calibration::Calibration;
use crate::error::CalibrationError;
use crate::finding::{Finding, Severity};
use ode::Stats;
use simulated::{Evaluated, Place};
use subject::Subject;

impl Calibration {
    /// Looks for what does not fit, and says what to do about it: with one evaluation at the parameters' start values, and another with
    /// times a thousandth as long where the times could be in ms.
    ///
    /// Looked at are the times (order, gaps, unit, start), the recorded values (constant, clipped, missing, units, initial values,
    /// columns that are swapped), outputs that count unlike in the cost, inputs that nothing drives or that end early, and ranges that
    /// the model states for its parameters. What cannot be evaluated at all is refused when the calibration is built.
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
        let subjects = self.subjects();
        let mut findings = model::construction_warnings(self.warnings());
        findings.extend(self.findings_of_description_and_data(&subjects));
        findings.extend(model::unstated_noise(self.problem()));
        let (mut n_evaluations, mut at_start) = (0, None);
        if simulate {
            n_evaluations += 1;
            match self.residuals_until(&self.start(), cancelled) {
                Ok(residuals) => at_start = Some(Evaluated { residuals, x: self.start() }),
                Err(CalibrationError::Cancelled) => return Err(CalibrationError::Cancelled),
                Err(error) => findings.push(Finding::new(
                    Severity::Error,
                    "start values",
                    error.to_string(),
                    "start where the model can be simulated; fits try other points, but their first steps are taken from here",
                )),
            }
        }
        if let Some(at_start) = &at_start {
            let mut evaluations = simulated::Evaluations { cancelled, n: 0, stats: Stats::default() };
            findings.extend(simulated::findings(self, &subjects, (at_start, None), &mut evaluations)?);
            n_evaluations += evaluations.n;
        }
        let squares = at_start.as_ref().map(|at| (at.residuals.as_slice(), Place::Start));
        findings.extend(scales::finding(self, squares));
        findings.sort_by_key(|finding| finding.severity);
        Ok(Check { findings, n_evaluations })
    }

    /// What a check finds beyond notes, judged again at the result of a fit: a doubt that the fitted values have removed is none any
    /// more. Residuals, without a loss, and values at the start and at the result; empty where it is cancelled.
    pub(crate) fn check_after_fit(
        &self,
        (start, at_start): (&[f64], Option<&[f64]>),
        (x, at_end): (&[f64], &[f64]),
        cancelled: &dyn Fn() -> bool,
        stats: &mut Stats,
    ) -> Vec<Finding> {
        let subjects = self.subjects();
        let mut doubts = self.findings_of_description_and_data(&subjects);
        if let Some(at_start) = at_start {
            let [at_start, at_end] = [(at_start, start), (at_end, x)]
                .map(|(residuals, x)| Evaluated { residuals: residuals.to_vec(), x: x.to_vec() });
            let mut evaluations = simulated::Evaluations { cancelled, n: 0, stats: Stats::default() };
            let found = simulated::findings(self, &subjects, (&at_start, Some(&at_end)), &mut evaluations);
            *stats += evaluations.stats;
            match found {
                Ok(found) => doubts.extend(found),
                Err(_) => return Vec::new(),
            }
        }
        doubts.extend(scales::finding(self, Some((at_end, Place::Fitted))));
        doubts.retain(|finding| finding.severity != Severity::Note);
        // Notes of the construction say how the data were read.
        doubts.extend(model::construction_warnings(self.warnings()));
        doubts
    }

    fn subjects(&self) -> Vec<Subject<'_>> {
        let (problem, description) = (self.problem(), self.fmu().description());
        let names = problem.experiment_names();
        let is_one = names.len() == 1;
        let subject = |(k, name): (usize, String)| Subject {
            prefix: if is_one { String::new() } else { format!("{name}: ") },
            experiment: &problem.experiments[k],
            description,
            start_time: self.evaluator().simulations[k].options.start_time.unwrap_or_default(),
        };
        names.into_iter().enumerate().map(subject).collect()
    }

    /// What is found without a simulation.
    fn findings_of_description_and_data(&self, subjects: &[Subject<'_>]) -> Vec<Finding> {
        let mut findings = model::parameters(self.parameters(), self.fmu().description());
        for subject in subjects {
            findings.extend(model::inputs(subject));
            findings.extend(model::units(subject));
            findings.extend(recording::times(subject));
            findings.extend(recording::columns(subject));
        }
        findings
    }
}
