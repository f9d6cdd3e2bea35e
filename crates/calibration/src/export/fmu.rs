//! A copy of the FMU that starts with the fitted values.

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

/// The copy may differ from the fit by so many times the relative tolerance of the simulations, as a part of
/// the largest value of an output: it is the same library with the same values, which are only set in another
/// way.
const CLOSE: f64 = 10.0;

/// Result of [`Fit::export_fmu`]: the files that it has written.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FmuExport {
    /// The copy; `None` where it is not as fitted.
    pub fmu: Option<PathBuf>,
    /// The values as an SSP parameter file, where the copy alone is not as fitted.
    pub ssv: Option<PathBuf>,
    /// Why, in a sentence.
    pub warning: Option<String>,
}

/// Why the copy was not written.
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
    /// Writes a copy of the FMU with the fitted values as start values in its description, and nothing else
    /// changed ([`Fmu::write_with_start_values`]), simulates it as it is, and compares it with the fit.
    ///
    /// **Many libraries ignore the start values of the description**: theirs are compiled in, and the FMI
    /// standard leaves it to the importing tool to set those of the description. Where the copy, simulated
    /// without setting anything, is not as fitted, the values are written as an SSP parameter file beside it,
    /// `path` with the suffix `.ssv`, and no copy; with `keep` the copy as well, for tools that set the start
    /// values of the description.
    ///
    /// `experiment`: whose values, where there are [local](crate::Parameter::local) parameters. Values that
    /// were given as [start values](crate::Experiment::start_value) of experiments are no part of the fit and
    /// not written. Simulations end with the context; they are made where those of the fit are.
    ///
    /// # Errors
    /// As [`Calibration::variable_values`]; [`CalibrationError::Setup`] for a name that does not end in
    /// `.fmu`, or for the model itself; those of simulating and writing.
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
            let message =
                "no parameter of the fit sets a variable of the model: there is nothing to write into a copy";
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
                "{} is right only in tools that set the start values of the description",
                path.display()
            ),
            false => format!("{} is not written", path.display()),
        };
        let warning = format!(
            "the library of {model} does not take its start values from the description, as FMI allows: simulated as it is, a \
             copy with the fitted values there is not as fitted ({difference}); {what}, the values are in {place}"
        );
        Ok(FmuExport { fmu, ssv: Some(ssv), warning: Some(warning) })
    }

    /// Difference between the copy, simulated as it is, and the fit in an experiment, in words; `None` if
    /// there is none.
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
        // The copy has fitted values as its start values only.
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

/// The largest difference of two trajectories, if one is larger than this part of the largest value of its
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
    // Also where it is no number.
    (gap.is_nan() || gap > close).then(|| {
        let [gap, time] = [gap * size, fitted.time[row]].map(|x| Number((x * 1e4).round() / 1e4));
        format!("'{name}' by {gap} at t = {time}")
    })
}
