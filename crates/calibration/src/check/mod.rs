//! Check of a setup before a fit: consistency of model, recordings and parameters.

mod at_start;
mod columns;
mod experiment_subject;
mod input_columns;
mod model;
mod options;
mod parameters;
mod result;
mod settings;
mod simulated_outputs;
mod times;

pub(crate) use model::unstated_noise;
pub use options::CheckOptions;
pub use result::Check;

use crate::cost::residual::PointResiduals;
use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Severity, sort};
use crate::findings::identifier::FindingId;
use crate::loaded::calibration::Calibration;
use base::RunContext;
use experiment_subject::ExperimentSubject;
use ode::Stats;
use simulated_outputs::{Evaluations, Outputs, Place};

impl Calibration {
    /// Looks for inconsistencies and returns findings with remedies. Requires one evaluation at the start
    /// values of the parameters. A fixed step or a co-simulation requires a second evaluation, with half the
    /// step or communication step. A recording with the length of the default experiment in another unit of
    /// time requires one in this unit.
    ///
    /// The check covers these items:
    ///
    /// - Times: unit and start.
    /// - Recorded values: constants, placeholders, units, initial values, and swapped columns.
    /// - Inputs: inputs without a source, and columns that are all zero, have long gaps, or have a different
    ///   unit.
    /// - Parameters: values, ranges and start values declared by the model.
    /// - Accuracy of the simulations.
    ///
    /// A setup that cannot be evaluated at all is rejected when the calibration is built.
    pub fn check(&self) -> Check {
        self.check_with(&CheckOptions::default(), &RunContext::new()).unwrap_or_default()
    }

    /// Checks the setup as [`check`](Self::check) does, with options. The context can end the check.
    ///
    /// # Errors
    /// Returns only [`CalibrationError::Cancelled`]. A failed simulation and an expired time limit are
    /// findings.
    pub fn check_with(
        &self,
        options: &CheckOptions,
        context: &RunContext<'_>,
    ) -> Result<Check, CalibrationError> {
        let limited = context.within(options.max_time);
        let mut evaluations = Evaluations { context: limited, n: 0, stats: Stats::default() };
        let subjects = self.subjects();
        let mut findings = model::construction_warnings(self.warnings());
        findings.extend(self.findings_of_description_and_data(&subjects, &self.start()));
        findings.extend(model::unstated_noise(self.problem()));
        let mut is_start_simulated = false;
        let simulated = match options.simulate {
            true => self.findings_of_simulations(
                &subjects,
                &mut is_start_simulated,
                &mut findings,
                &mut evaluations,
            ),
            false => Ok(()),
        };
        match simulated {
            Err(CalibrationError::Cancelled) if !context.is_over() => {
                findings.push(options.out_of_time(is_start_simulated))
            }
            other => other?,
        }
        sort(&mut findings);
        Ok(Check { findings, n_evaluations: evaluations.n })
    }

    /// Adds the findings from simulations at the start values, within the time limit.
    fn findings_of_simulations(
        &self,
        subjects: &[ExperimentSubject<'_>],
        is_start_simulated: &mut bool,
        findings: &mut Vec<Finding>,
        evaluations: &mut Evaluations<'_>,
    ) -> Result<(), CalibrationError> {
        evaluations.n += 1;
        let x = self.start();
        let start = match self.residuals(&x, &evaluations.context) {
            Ok(residuals) => PointResiduals { residuals, x },
            Err(CalibrationError::Cancelled) => return Err(CalibrationError::Cancelled),
            Err(error) => {
                findings.extend(times::other_unit(self, subjects, (&x, None), evaluations)?);
                findings.push(Finding::new(
                    Severity::Error,
                    FindingId::FailedStart,
                    "start values",
                    error.to_string(),
                    "Choose start values that can be simulated, because the first steps of a fit begin there",
                ));
                return Ok(());
            }
        };
        *is_start_simulated = true;
        findings.extend(self.ineffective_start_values(subjects));
        findings.extend(at_start::findings(subjects, &Outputs::new(self, &start, None)));
        findings.extend(times::other_unit(self, subjects, (&start.x, Some(&start)), evaluations)?);
        findings.extend(settings::large_step(self, &start, Place::Start, evaluations)?);
        Ok(())
    }

    /// Returns the findings of a check at the result of a fit, without notes. Doubts that the fitted values
    /// resolved are omitted. Requires no simulation.
    pub(crate) fn check_after_fit(
        &self,
        start: Option<&PointResiduals>,
        end: &PointResiduals,
    ) -> Vec<Finding> {
        let subjects = self.subjects();
        let mut doubts = self.findings_of_description_and_data(&subjects, &end.x);
        doubts.extend(self.ineffective_start_values(&subjects));
        if let Some(start) = start {
            doubts.extend(at_start::findings(&subjects, &Outputs::new(self, start, Some(end))));
        }
        doubts.retain(|finding| finding.severity != Severity::Note);
        // Notes of the construction describe how the data were read, so keep them.
        doubts.extend(model::construction_warnings(self.warnings()));
        doubts
    }

    /// Returns findings about another unit of time at the start of a fit. Requires an evaluation only if the
    /// recording has the length of the default experiment in another unit.
    pub(crate) fn other_time_unit_at_start(
        &self,
        start: &PointResiduals,
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> Vec<Finding> {
        let mut evaluations = Evaluations { context: *context, n: 0, stats: Stats::default() };
        let found = times::other_unit(self, &self.subjects(), (&start.x, Some(start)), &mut evaluations);
        *stats += evaluations.stats;
        found.unwrap_or_default()
    }

    /// Returns the findings that require no simulation, without notes.
    pub(crate) fn check_of_setup(&self, x: &[f64]) -> Vec<Finding> {
        let mut doubts = self.findings_of_description_and_data(&self.subjects(), x);
        doubts.retain(|finding| finding.severity != Severity::Note);
        doubts
    }

    /// Returns a finding if the fixed step or the communication step of a co-simulation is too large at the
    /// result of a fit. For fixed steps, use it if the uncertainty, which also compares with half the step,
    /// is not available.
    pub(crate) fn large_step_after_fit(
        &self,
        end: &PointResiduals,
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> Option<Finding> {
        let mut evaluations = Evaluations { context: *context, n: 0, stats: Stats::default() };
        let found = settings::large_step(self, end, Place::Fitted, &mut evaluations);
        *stats += evaluations.stats;
        found.ok().flatten()
    }

    /// Returns sentences about used columns that declare no unit although the model declares one.
    pub fn columns_without_unit(&self) -> Vec<String> {
        self.subjects().iter().flat_map(model::units).map(|finding| finding.advice()).collect()
    }

    /// Returns the findings about long gaps in inputs.
    pub(crate) fn gaps_of_inputs(&self) -> Vec<Finding> {
        self.subjects().iter().flat_map(input_columns::gaps).collect()
    }

    fn subjects(&self) -> Vec<ExperimentSubject<'_>> {
        let (problem, description) = (self.problem(), self.fmu().description());
        let names = problem.experiment_names();
        let is_one = names.len() == 1;
        let subject = |(k, name): (usize, String)| ExperimentSubject {
            prefix: if is_one { String::new() } else { format!("{name}: ") },
            experiment: &problem.experiments[k],
            description,
            parameters: &problem.parameters,
            start_time: self.evaluator().simulations[k].options.start_time.unwrap_or_default(),
        };
        names.into_iter().enumerate().map(subject).collect()
    }

    /// Returns findings about start values that had no effect in the simulations so far.
    fn ineffective_start_values(&self, subjects: &[ExperimentSubject<'_>]) -> Vec<Finding> {
        let of = |subject| model::start_values(self.fmu(), self.is_co_simulation(), subject);
        subjects.iter().flat_map(of).collect()
    }

    /// Returns the findings that require no simulation.
    fn findings_of_description_and_data(
        &self,
        subjects: &[ExperimentSubject<'_>],
        x: &[f64],
    ) -> Vec<Finding> {
        let (parameters, description) = (self.parameters(), self.fmu().description());
        let mut findings = parameters::ranges(parameters, description);
        findings.extend(parameters::far_from_model_start(parameters, x, description));
        findings.extend(settings::many_steps(self));
        for subject in subjects {
            findings.extend(model::inputs(subject));
            findings.extend(model::units(subject));
            findings.extend(parameters::given_values(subject, &self.problem().parameters));
            findings.extend(times::findings(subject));
            findings.extend(columns::findings(subject));
            findings.extend(input_columns::findings(subject));
        }
        findings
    }
}
