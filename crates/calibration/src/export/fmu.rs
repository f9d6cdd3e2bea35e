//! Copy of the FMU whose start values are the fitted values.

use super::files::{check_belongs, check_path, check_suffix};
use crate::cost::model_process::ModelProcess;
use crate::error::CalibrationError;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use base::{Number, RunContext};
use fmi::platform::fill_atomically;
use fmi::{FmiError, Fmu, Trajectory};
use ode::Termination;
use std::fs::File;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// Maximum difference between copy and fit, as a multiple of the relative tolerance of the simulations. It is
/// relative to the largest value of an output. Both run the same library with the same values, which are only
/// set in different ways.
const CLOSE: f64 = 10.0;

/// Files written by [`Fit::export_fmu`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FmuExport {
    /// Path of the copy. `None` if it was not written because it does not reproduce the fit.
    pub fmu: Option<PathBuf>,
    /// Path of the SSP parameter file with the values. It is written if the copy alone does not reproduce the
    /// fit.
    pub ssv: Option<PathBuf>,
    /// Reason for the parameter file, in a sentence.
    pub warning: Option<String>,
}

/// Reason why the copy was not written.
enum Unwritten {
    Ignored(String),
    Failed(CalibrationError),
}

impl From<FmiError> for Unwritten {
    fn from(error: FmiError) -> Self {
        Self::Failed(error.into())
    }
}

impl Fit {
    /// Writes a copy of the FMU with the fitted values as start values in its description. Nothing else is
    /// changed ([`Fmu::write_with_start_values`]). Simulates the copy without setting any values and compares
    /// it with the fit.
    ///
    /// **Many libraries ignore the start values of the description**: their own values are compiled in, and
    /// the FMI standard expects the importing tool to set the start values of the description. If the copy
    /// does not reproduce the fit without setting values, an SSP parameter file replaces it: `path` with the
    /// suffix `.ssv`. With `keep`, the copy is also written, for tools that set the start values of the
    /// description.
    ///
    /// `experiment` selects the experiment of the values if there are [local](crate::Parameter::local)
    /// parameters. [Start values](crate::Experiment::start_value) of experiments are not part of the fit and
    /// are not written. The context can end the simulations, which run in the same processes as the
    /// simulations of the fit.
    ///
    /// # Errors
    /// Returns the errors of [`Calibration::variable_values`]. Returns [`CalibrationError::Setup`] if the
    /// name does not end in `.fmu` or is the model itself. Also returns the errors of simulating and writing.
    pub fn export_fmu(
        &self,
        calibration: &Calibration,
        path: impl AsRef<Path>,
        experiment: Option<&str>,
        keep: bool,
        context: &RunContext<'_>,
    ) -> Result<FmuExport, CalibrationError> {
        let path = path.as_ref();
        check_suffix(path, "fmu")?;
        check_belongs(self, calibration)?;
        check_path(path, calibration)?;
        let values = calibration.variable_values(&self.x, experiment)?;
        if values.is_empty() {
            let message = "no parameter of the fit sets a variable of the model, so a copy of the FMU would contain no fitted value";
            return Err(CalibrationError::Setup(message.to_owned()));
        }
        let experiments = match experiment {
            Some(name) => vec![calibration.experiment_index(name)?],
            None => (0..calibration.problem().experiments.len()).collect(),
        };
        let mut ignored = None;
        let fill = |file: &File, copy: &Path| -> Result<(), Unwritten> {
            calibration.fmu().write_with_start_values(&values, file)?;
            let copy = Fmu::open_with(copy, calibration.fmu().options())?;
            for &k in &experiments {
                match self.difference(calibration, &copy, k, context).map_err(Unwritten::Failed)? {
                    Some(difference) if keep => ignored = Some(difference),
                    Some(difference) => return Err(Unwritten::Ignored(difference)),
                    None => {}
                }
            }
            Ok(())
        };
        let written = match fill_atomically(path, fill) {
            Ok(()) => true,
            Err(Unwritten::Failed(error)) => return Err(error),
            Err(Unwritten::Ignored(difference)) => {
                ignored = Some(difference);
                false
            }
        };
        let fmu = written.then(|| path.to_owned());
        let Some(difference) = ignored else { return Ok(FmuExport { fmu, ssv: None, warning: None }) };
        let ssv = path.with_extension("ssv");
        self.export_ssv(calibration, &ssv, experiment)?;
        let (model, place) = (&calibration.fmu().description().model_name, ssv.display());
        let what = match written {
            true => format!(
                "{} is correct only in tools that set the start values of the description",
                path.display()
            ),
            false => format!("{} is not written", path.display()),
        };
        let warning = format!(
            "the library of {model} ignores the start values in the description, which FMI allows, so a copy with the fitted values \
             differs from the fit ({difference}). {what}, the values are in {place}"
        );
        Ok(FmuExport { fmu, ssv: Some(ssv), warning: Some(warning) })
    }

    /// Returns the difference between the copy, simulated without setting values, and the fit in an
    /// experiment. Returns `None` if there is none.
    fn difference(
        &self,
        calibration: &Calibration,
        copy: &Fmu,
        k: usize,
        context: &RunContext<'_>,
    ) -> Result<Option<String>, CalibrationError> {
        let outputs: Vec<String> =
            calibration.problem().experiments[k].outputs().map(|(variable, _)| variable.to_owned()).collect();
        let fitted = calibration.simulate_variables(k, &self.x, None, &outputs, context)?;
        let simulation = &calibration.evaluator().simulations[k];
        let mut options = simulation.recording(&self.x, None, &outputs);
        // The fitted values are the start values of the copy.
        options.initial_states.retain(|state| options.start_values.iter().any(|(name, _)| name == state));
        let copied = if calibration.evaluator().remote.is_ok() {
            let limits = calibration.problem().settings.worker_limits();
            ModelProcess::new(copy, limits).and_then(|process| process.simulate(&options, context))
        } else {
            let mut poll =
                || if context.is_over() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
            copy.simulate_with(&options, &mut poll)
        };
        let copied = match copied {
            Ok(trajectory) if trajectory.termination == Termination::StoppedByObserver => {
                return Err(CalibrationError::Cancelled);
            }
            Ok(trajectory) => trajectory,
            Err(FmiError::Cancelled) => return Err(CalibrationError::Cancelled),
            Err(error) => return Ok(Some(format!("its simulation failed: {error}"))),
        };
        Ok(largest_difference(&fitted, &copied, CLOSE * simulation.pool.plan().relative_tolerance()))
    }
}

/// Returns the largest difference of two trajectories if it exceeds this part of the largest value of its
/// column.
fn largest_difference(fitted: &Trajectory, copied: &Trajectory, close: f64) -> Option<String> {
    if fitted.time.len() != copied.time.len() {
        return Some(format!("it ends at t = {}", Number(copied.end_time)));
    }
    let columns = fitted.names.iter().zip(fitted.columns.iter().zip(&copied.columns));
    let largest = columns.filter_map(|(name, (a, b))| {
        let size = a.iter().fold(f64::MIN_POSITIVE, |size, value| size.max(value.abs()));
        let gaps = a.iter().zip(b).map(|(a, b)| (a - b).abs() / size).enumerate();
        gaps.max_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(row, gap)| (name, row, gap, size))
    });
    let (name, row, gap, size) = largest.max_by(|a, b| a.2.total_cmp(&b.2))?;
    // Also report NaN.
    (gap.is_nan() || gap > close).then(|| {
        let [gap, time] = [gap * size, fitted.time[row]].map(|x| Number((x * 1e4).round() / 1e4));
        format!("'{name}' by {gap} at t = {time}")
    })
}
