//! Communication points of a co-simulation.
//!
//! Regular points are `start + k * step`, never sums. Each step passes the same constant step size. A
//! difference of times can be wrong in its last digit. This slows some FMUs down and changes the results of
//! others.
//!
//! If the FMU accepts steps of any length, requested times and input changes are also communication points.
//! Otherwise samples between two points are interpolated, and the last step may end after the final time.
//!
//! Some FMUs advance only between multiples of an internal step size (`fixedInternalStepSize`, FMI 3.0) and
//! keep their values in between. All communication points except event times are then such multiples. A
//! requested time between two multiples adds both of them.

use crate::description::{Capabilities, DefaultExperiment};
use crate::error::{FmiError, Result};
use crate::simulation::grid::Grid;
use crate::simulation::options::{BetweenSteps, SimulateOptions};
use base::Number;

/// Maximum number of steps. A larger number is assumed to be a mistake.
const MAX_STEPS: f64 = 1e9;

/// Number of steps above which a run causes a warning before it starts.
pub(super) const MANY_STEPS: f64 = 1e6;

/// Communication points of a simulation.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Communication {
    /// Spacing of the regular points; `None` if only requested times and inputs determine points.
    pub(crate) step: Option<f64>,
    /// True if points at other times are possible.
    pub(crate) variable: bool,
    /// Internal step size of the model. All points except event times are multiples of it.
    internal: Option<f64>,
    /// True if the FMU extrapolates inputs.
    pub(crate) extrapolates: bool,
    /// True if input derivatives are passed to the FMU for the extrapolation.
    pub(crate) input_derivatives: bool,
    /// True if the FMU provides output derivatives at the end of a step.
    pub(crate) output_derivatives: bool,
}

impl Communication {
    pub(crate) fn new(
        options: &SimulateOptions,
        experiment: &DefaultExperiment,
        capabilities: &Capabilities,
        grid: &Grid,
    ) -> Result<Self> {
        let span = grid.end - grid.start;
        let makes_sense =
            |step: &f64| step.is_finite() && *step > grid.time_tolerance && span / *step <= MAX_STEPS;
        if let Some(step) = options.run.step_size.filter(|step| !makes_sense(step)) {
            let problem = format!(
                "step_size = {} from {} to {}: expected a positive, finite value that results in at most \
                 {MAX_STEPS:e} steps",
                Number(step),
                Number(grid.start),
                Number(grid.end)
            );
            return Err(FmiError::BadSetting(problem));
        }
        let variable = capabilities.can_handle_variable_communication_step_size;
        let stated = experiment.step_size.filter(makes_sense);
        // A model with steps of one length may reject any step size except its declared one. Rows between
        // steps are interpolated. The declared step size is kept unless it results in too many steps.
        let stays = |stated: f64| !variable && span / stated <= MANY_STEPS;
        let stated =
            stated.map(|stated| if stays(stated) { stated } else { stated.max(grid.mean_interval()) });
        let step = options.run.step_size.or(stated).or(grid.interval.filter(makes_sense));
        // The default is 500 steps, equal to the default number of rows.
        let step = if variable { step } else { step.or(Some(span / 500.0).filter(makes_sense)) };
        let internal = capabilities.fixed_internal_step_size;
        let is_multiple = |step: f64, internal: f64| {
            let multiple = (step / internal).round();
            multiple >= 1.0 && (step - multiple * internal).abs() <= 1e-9 * step
        };
        // Without a requested step size, a step that the model supports is chosen. If only one length is
        // possible, the internal step size avoids skipping values.
        let step = match (internal, options.run.step_size, step) {
            (Some(internal), None, Some(step)) if is_multiple(step, internal) => {
                Some((step / internal).round() * internal)
            }
            (Some(internal), None, Some(step)) if variable => {
                Some((step / internal).round().max(1.0) * internal)
            }
            (Some(internal), None, _) if !variable && makes_sense(&internal) => Some(internal),
            _ => step,
        };
        if let (Some(internal), Some(step)) = (internal, step)
            && !is_multiple(step, internal)
        {
            let (lower, upper) = ((step / internal).floor() * internal, (step / internal).ceil() * internal);
            let (below, above) = (Number(lower), Number(upper));
            let next = if lower > 0.0 { format!("{below} and {above}") } else { above.to_string() };
            let (step, internal) = (Number(step), Number(internal));
            let problem = format!(
                "the communication step {step} is not a multiple of the internal step {internal} of the \
                 model; nearest multiples: {next}"
            );
            return Err(FmiError::BadSetting(problem));
        }
        Ok(Self {
            step,
            variable,
            internal,
            extrapolates: capabilities.can_interpolate_inputs,
            input_derivatives: capabilities.can_interpolate_inputs
                && options.run.input_derivatives != Some(false),
            output_derivatives: capabilities.max_output_derivative_order > 0,
        })
    }

    /// Returns the stop time that is passed to the model. This is the final time or the end of the last step,
    /// whichever is later.
    pub(crate) fn stop_time(&self, start: f64, end: f64, time_tolerance: f64) -> f64 {
        let last = self.fixed_step().and_then(|step| around(step, start, end, time_tolerance));
        last.map_or(end, |(_, above)| above)
    }

    /// Returns the multiples of the model's internal step before and after `time`. Returns `None` if `time`
    /// is a multiple or the model has no internal step.
    pub(crate) fn steps_around(&self, start: f64, time: f64, time_tolerance: f64) -> Option<(f64, f64)> {
        around(self.internal?, start, time, time_tolerance)
    }

    /// Returns the step of a model that can stop only at its multiples. This is the internal step or a
    /// communication step of fixed length.
    fn fixed_step(&self) -> Option<f64> {
        if self.variable { self.internal } else { self.step }
    }

    /// Returns a message if rows are between the steps of the model.
    ///
    /// # Errors
    /// Returns an error if there are rows between steps and the options do not allow them. The message
    /// contains the first such row and the neighboring steps.
    pub(crate) fn check_rows(&self, grid: &Grid, between: BetweenSteps) -> Result<Option<String>> {
        let Some(step) = self.fixed_step() else { return Ok(None) };
        let beside =
            |time: &f64| around(step, grid.start, *time, grid.time_tolerance).map(|pair| (*time, pair));
        let Some((time, (below, above))) = grid.times.iter().find_map(beside) else { return Ok(None) };
        let (time, below, above) = (Number(time), Number(below), Number(above));
        let what = format!(
            "the row at t = {time} is between two communication points of the model, {below} and {above} \
             (its step size is {})",
            Number(step)
        );
        match between {
            BetweenSteps::Interpolate => Ok(Some(format!("{what}; such rows are interpolated linearly"))),
            BetweenSteps::Refuse => {
                let problem = format!(
                    "{what}, and between_steps rejects such rows. Request rows at multiples of the step"
                );
                Err(FmiError::BadSetting(problem))
            }
        }
    }

    /// Returns a message if the inputs add more communication points than the requested step size.
    pub(crate) fn check_inputs(&self, grid: &Grid, requested: Option<f64>, points: usize) -> Option<String> {
        let step = requested.filter(|_| self.variable && self.internal.is_none())?;
        let regular = ((grid.end - grid.start) / step).ceil();
        (points as f64 > regular).then(|| {
            format!(
                "the inputs change at {points} times. These are communication points in addition to the \
                 multiples of the step {}",
                Number(step)
            )
        })
    }
}

/// Returns the multiples of `step` from `start` before and after `time`, or `None` if `time` is a multiple.
fn around(step: f64, start: f64, time: f64, time_tolerance: f64) -> Option<(f64, f64)> {
    let steps = (time - start) / step;
    let point = |steps: f64| start + steps * step;
    let is_one = (point(steps.round()) - time).abs() <= time_tolerance;
    (!is_one).then(|| (point(steps.floor()), point(steps.ceil())))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Grid {
        SimulateOptions::new().final_time(10.0).ncp(100).grid(&DefaultExperiment::default()).unwrap()
    }

    fn capabilities(variable: bool) -> Capabilities {
        Capabilities { can_handle_variable_communication_step_size: variable, ..Capabilities::default() }
    }

    fn communication(step: Option<f64>, suggested: Option<f64>, variable: bool) -> Result<Communication> {
        let options = SimulateOptions {
            run: crate::RunSettings { step_size: step, ..Default::default() },
            ..SimulateOptions::default()
        };
        let experiment = DefaultExperiment { step_size: suggested, ..DefaultExperiment::default() };
        Communication::new(&options, &experiment, &capabilities(variable), &grid())
    }

    #[test]
    fn step_comes_from_options_then_experiment_then_rows() {
        let step = |step, suggested| communication(step, suggested, false).unwrap().step;
        assert_eq!(step(Some(0.3), Some(0.2)), Some(0.3));
        assert_eq!(step(None, Some(0.2)), Some(0.2));
        assert_eq!(step(None, Some(0.01)), Some(0.01));
        assert_eq!(step(None, Some(-1.0)), Some(0.1));
        assert_eq!(step(None, None), Some(0.1));
    }

    #[test]
    fn step_is_the_larger_of_declared_step_and_interval_unless_requested() {
        let step = |step, suggested, variable| communication(step, suggested, variable).unwrap().step;
        for (suggested, variable, expected) in
            [(1e-8, true, 0.1), (0.01, true, 0.1), (0.25, true, 0.25), (1e-8, false, 0.1), (1e-12, true, 0.1)]
        {
            assert_eq!(step(None, Some(suggested), variable), Some(expected), "{suggested} {variable}");
        }
        assert_eq!(step(Some(0.003), Some(0.01), true), Some(0.003));
    }

    #[test]
    fn stop_time_is_the_end_of_the_last_step() {
        let stop = |step, variable, end| {
            communication(Some(step), None, variable).unwrap().stop_time(0.0, end, 1e-13)
        };
        assert_eq!((stop(0.3, true, 1.0), stop(0.25, false, 1.0)), (1.0, 1.0));
        assert_eq!(stop(0.1, false, 0.3), 0.3);
        assert!((stop(0.3, false, 1.0) - 1.2).abs() < 1e-15);
    }

    #[test]
    fn step_defaults_to_a_500th_for_fixed_steps_without_regular_rows() {
        let times = SimulateOptions::new().times([0.0, 1.0, 4.0]);
        let grid = times.grid(&DefaultExperiment::default()).unwrap();
        let step = |variable| {
            Communication::new(&times, &DefaultExperiment::default(), &capabilities(variable), &grid)
                .unwrap()
                .step
        };
        assert_eq!((step(true), step(false)), (None, Some(4.0 / 500.0)));
    }

    #[test]
    fn new_rejects_invalid_step_sizes() {
        for step in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-12] {
            let problem = communication(Some(step), None, true).unwrap_err().to_string();
            assert!(problem.contains("step_size"), "{problem}");
        }
    }
}
