//! Simulation of an experiment: its plan, the assignment of the entries of `x`, and the comparison with
//! measurements.

use crate::cost::criteria::Criteria;
use crate::cost::residual::{Comparison, Schedule};
use crate::data::Series;
use crate::error::CalibrationError;
use crate::problem::assignment::{Affine, Assignments, Shifts, initial_values};
use crate::problem::definition::{Element, Problem};
use crate::problem::derived::Derivation;
use crate::problem::experiment::{Experiment, InitialState};
use crate::problem::input::{Shift, Signal};
use crate::problem::measurements::Measurements;
use crate::problem::warning::SetupWarning;
use base::Number;
use fmi::description::Causality;
use fmi::{
    DEFAULT_INTERVALS, FmiError, Fmu, Inputs, InterfaceKind, ModelDescription, SharedSimulator,
    SimulateOptions, SimulationPlan, Simulator, Trajectory, Value,
};
use ode::{Observer, Report};
use std::borrow::Cow;
use std::cmp::Ordering;
use std::ops::ControlFlow;
use std::sync::Arc;

/// Simulation of an experiment and its comparison with measurements.
#[derive(Debug)]
pub(crate) struct Simulation {
    /// Name of the experiment.
    pub(crate) name: String,
    /// Simulators with the method of the settings.
    pub(crate) pool: SharedSimulator,
    /// Options at the start values of the parameters, without the row times.
    pub(crate) options: SimulateOptions,
    pub(crate) comparison: Comparison,
    pub(crate) criteria: Criteria,
    /// Schedule at the start values.
    schedule: Schedule,
    /// Times of the measurements.
    times: Series,
    signals: Vec<Signal>,
    assigned: Assignments,
    /// True if delays of outputs, or delays or offsets of inputs, depend on `x`.
    is_shifted_by_x: bool,
}

impl Simulation {
    /// Creates the simulation of an experiment and returns it with warnings.
    pub(crate) fn new(
        fmu: &Fmu,
        name: String,
        experiment: &Experiment,
        problem: &Problem,
        elements: &[Element],
        mut assigned: Assignments,
    ) -> Result<(Self, Vec<SetupWarning>), CalibrationError> {
        let (description, settings) = (fmu.description(), &problem.settings);
        let default = &description.default_experiment;
        let default_start = default.start_time.unwrap_or(0.0);
        let measurements = match problem.goals.is_empty() {
            true => Measurements::new(experiment, default_start)?,
            false => Measurements::of_scenario(experiment, (default_start, default.stop_time))?,
        };
        let start_time = measurements.start_time;
        let mut criteria = Criteria::new(problem, experiment, description)?;
        let further = measurements.end.into_iter().collect();
        let mut comparison = Comparison::new(&measurements.outputs).with_further(further);
        let signals =
            experiment.inputs.iter().map(|(input, source)| Signal::new(input, source, &experiment.data));
        let signals = signals.collect::<Result<Vec<_>, _>>()?;
        let final_time = final_time(&measurements, &assigned, elements)?;
        if !experiment.hold_inputs {
            for (signal, Shifts { delay, .. }) in signals.iter().zip(&assigned.inputs) {
                let (lowest, highest) = range(delay, &assigned, elements);
                let span = (start_time - highest.min(0.0), final_time - lowest);
                signal.check_covers(&experiment.data, span)?;
            }
        }
        let start: Vec<f64> = elements.iter().map(|e| e.parameter.start()).collect();
        let values_at_start = assigned.derivation.extended(&start).into_owned();
        let is_constant =
            |(name, _): &&(String, _)| !Experiment::is_start_of_local(name, &problem.parameters);
        let mut start_values: Vec<_> = experiment.start_values.iter().filter(is_constant).cloned().collect();
        start_values.extend(initial_values(experiment, start_time, &mut assigned)?);
        let names: Vec<String> = assigned.variables.iter().map(|(name, _)| name.clone()).collect();
        let mut run = settings.run_of_fits(description);
        if !problem.goals.is_empty() && settings.run.relative_tolerance.is_none() {
            let stated = default.tolerance.filter(|stated| *stated > 0.0).unwrap_or(DESIGN_TOLERANCE);
            run.relative_tolerance = Some(stated.min(DESIGN_TOLERANCE));
        }
        let initial_states = initial_states(experiment, &names, description, fmu.choose(run.kind)?);
        let times = comparison.schedule(|_| 0.0, start_time).times;
        let options = SimulateOptions {
            start_time: Some(start_time),
            final_time: Some(final_time),
            start_values,
            initial_states,
            steady: experiment.steady,
            parameters: names.clone(),
            outputs: Some(criteria.outputs().to_vec()),
            inputs: inputs(&signals, assigned.input_shifts(&values_at_start)),
            run,
            ..SimulateOptions::default()
        };
        // Row spacing settings depend on the spacing of the measurements.
        let mut plan = SimulationPlan::new(
            fmu,
            &SimulateOptions {
                final_time: Some(final_time.max(measurements.last_time())),
                times: Some(times.to_vec()),
                ..options.clone()
            },
        )?;
        if !criteria.is_empty() {
            criteria.has_steps = plan.kind() == InterfaceKind::ModelExchange;
            criteria.tolerance = plan.relative_tolerance();
        }
        if !criteria.is_empty() && !criteria.has_steps {
            // A co-simulation is known at its communication points.
            comparison = comparison.with_further(communication_points(&plan));
        }
        let schedule = comparison
            .schedule(|output| assigned.outputs[output].delay.in_model(&values_at_start), start_time);
        if schedule.times != times {
            plan =
                plan.with_rows(&SimulateOptions { times: Some(schedule.times.to_vec()), ..options.clone() })?;
        }
        plan.require_single_numbers()?;
        experiment.check_outputs(description, &names)?;
        let warnings = options.without_effect(plan.kind()).into_iter().map(SetupWarning::NoEffect).collect();
        let is_shifted_by_x = assigned.outputs.iter().any(|output| !output.delay.is_constant())
            || assigned.inputs.iter().any(|Shifts { delay, factor, offset }| {
                [delay, factor, offset].iter().any(|of| !of.is_constant())
            });
        let simulation = Self {
            name,
            pool: SharedSimulator::new(Arc::new(plan)),
            options,
            comparison,
            criteria,
            schedule,
            times,
            signals,
            assigned,
            is_shifted_by_x,
        };
        Ok((simulation, warnings))
    }

    /// Returns the values of the parameters of the model at `x`.
    pub(crate) fn values<'x>(&self, x: &'x [f64]) -> Cow<'x, [f64]> {
        values(&self.assigned, x)
    }

    /// Returns the variables that the simulation sets and their values at `x`, in the units of the model.
    pub(crate) fn named_values(&self, x: &[f64]) -> impl Iterator<Item = (&str, f64)> {
        let values = self.assigned.derivation.extended(x);
        let named = self.assigned.variables.iter();
        named.map(|(name, of)| (name.as_str(), of.in_model(&values))).collect::<Vec<_>>().into_iter()
    }

    /// Returns the derived parameters.
    pub(crate) fn derivation(&self) -> &Derivation {
        &self.assigned.derivation
    }

    /// Sets the start time and the initial values of this simulation in an experiment that receives other
    /// windows.
    pub(crate) fn keep_start(&self, experiment: &mut Experiment) {
        experiment.start_time = experiment.start_time.or(experiment.warm_up.and(self.options.start_time));
        for (state, initial) in &mut experiment.initial_states {
            if initial.measured_output(state).is_some()
                && let Some((_, Value::Real(value))) =
                    self.options.start_values.iter().find(|(name, _)| name == state)
            {
                *initial = InitialState::Value(*value);
            }
        }
    }

    /// Returns the value of a measured initial state at `x`.
    pub(crate) fn measured_start(&self, state: &str, x: &[f64]) -> Option<f64> {
        match self.options.start_values.iter().find(|(name, _)| name == state) {
            Some((_, Value::Real(value))) => Some(*value),
            _ => self.named_values(x).find(|(name, _)| *name == state).map(|(_, value)| value),
        }
    }

    /// True if the simulation starts at this time of a measurement of an output or later. Outputs are counted
    /// from 0.
    pub(crate) fn starts_at(&self, output: usize, time: f64) -> bool {
        let delay = self.assigned.outputs[output].delay;
        let start = self.options.start_time.unwrap_or_default();
        delay.is_constant() && time - delay.in_model(&[]) <= start + base::time_tolerance(start, time)
    }

    /// Returns the delay, the factor and the offset of each output at `x`.
    pub(crate) fn output_shifts(&self, x: &[f64]) -> Vec<Shift> {
        let values = self.assigned.derivation.extended(x);
        self.assigned.outputs.iter().map(|output| output.at(&values)).collect()
    }

    /// Returns the sample times of the outputs at `x`.
    pub(crate) fn schedule(&self, x: &[f64]) -> Cow<'_, Schedule> {
        match self.is_shifted_by_x {
            false => Cow::Borrowed(&self.schedule),
            true => Cow::Owned(self.scheduled(&self.comparison, x)),
        }
    }

    fn scheduled(&self, comparison: &Comparison, x: &[f64]) -> Schedule {
        let start = self.options.start_time.unwrap_or_default();
        let values = self.assigned.derivation.extended(x);
        comparison.schedule(|output| self.assigned.outputs[output].delay.in_model(&values), start)
    }

    /// Returns the options at the start values of the parameters, as a template for other options.
    pub(crate) fn options_at_start(&self) -> SimulateOptions {
        SimulateOptions { times: Some(self.schedule.times.to_vec()), ..self.options.clone() }
    }

    /// Returns times that show the response of a simulation without additional steps. These are about `n`
    /// equidistant times and the measured times. In a co-simulation, a row is a communication point, so about
    /// `n` of its existing points are returned.
    pub(crate) fn curve_times(&self, n: usize) -> Vec<f64> {
        let plan = self.pool.plan();
        let (start, end) = (plan.start_time(), plan.final_time());
        let is_late = self.is_shifted_by_x || self.schedule.times != self.times;
        let spacing = match plan.kind() {
            InterfaceKind::ModelExchange => Some((end - start) / (n - 1) as f64),
            // Samples of delayed outputs are not at communication points.
            InterfaceKind::CoSimulation => plan.regular_communication_step().filter(|_| !is_late),
        };
        let tolerance = base::time_tolerance(start, end);
        let mut times = self.times.to_vec();
        if let Some(spacing) = spacing.filter(|spacing| *spacing > tolerance) {
            let n_all = ((end - start + tolerance) / spacing).floor() as usize;
            let every = n_all.div_ceil(n).max(1);
            times.extend((0..=n_all).step_by(every).map(|k| (start + k as f64 * spacing).min(end)));
        }
        times.sort_by(f64::total_cmp);
        times.dedup_by(|next, before| *next - *before <= tolerance);
        times
    }

    /// Returns the options at `x`, with these rows.
    fn options_at(&self, x: &[f64], times: &[f64]) -> SimulateOptions {
        let last = times.last().copied();
        SimulateOptions {
            final_time: self.options.final_time.map(|end| last.map_or(end, |last| end.max(last))),
            times: Some(times.to_vec()),
            inputs: inputs(&self.signals, self.assigned.input_shifts(&self.assigned.derivation.extended(x))),
            ..self.options.clone()
        }
    }

    /// Simulates at `x` with one of the simulators.
    pub(crate) fn run(
        &self,
        simulator: &mut Simulator,
        x: &[f64],
        schedule: &Schedule,
        observer: &mut dyn Observer,
    ) -> Result<Report, FmiError> {
        if self.is_shifted_by_x {
            let plan = simulator.plan().with_rows(&self.options_at(x, &schedule.times))?;
            simulator.set_plan(Arc::new(plan))?;
        }
        simulator.run(&self.values(x), observer)
    }

    /// Returns the options to record these variables of the model at `x`, without delays and offsets. The
    /// rows are the measured times or `times`. The values of [`named_values`](Self::named_values) are not
    /// included.
    pub(crate) fn recording(
        &self,
        x: &[f64],
        times: Option<&[f64]>,
        variables: &[String],
    ) -> SimulateOptions {
        let times = times.unwrap_or(&self.times);
        SimulateOptions {
            parameters: Vec::new(),
            outputs: Some(variables.to_vec()),
            final_time: times.last().copied(),
            ..self.options_at(x, times)
        }
    }

    /// Returns the compared outputs at `x`, with their delays and offsets, at the measured times or `times`.
    pub(crate) fn trajectory(
        &self,
        fmu: &Fmu,
        x: &[f64],
        times: Option<&[f64]>,
        poll: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Trajectory, FmiError> {
        let given = times;
        let times = times.unwrap_or(&self.times);
        let values = self.assigned.derivation.extended(x);
        let is_late = self.assigned.outputs.iter().any(|output| output.delay.in_model(&values) != 0.0);
        if let Some(given) = given {
            // Sample times of delayed outputs are sorted and begin at the start, and the last one ends the
            // run.
            check_times(given, self.options.start_time.unwrap_or_default())?;
        }
        let rows = Comparison::at_times(times, self.assigned.outputs.len());
        let schedule = is_late.then(|| self.scheduled(&rows, x));
        let sampled = schedule.as_ref().map_or(times, |schedule| &schedule.times[..]);
        let mut options = self.options_at(x, sampled);
        if schedule.is_none() {
            options.final_time = times.last().copied();
        }
        options.parameters.clear();
        // Outputs of criteria follow the compared ones.
        options.outputs.iter_mut().for_each(|outputs| outputs.truncate(self.assigned.outputs.len()));
        options
            .start_values
            .extend(self.named_values(x).map(|(name, value)| (name.to_owned(), value.into())));
        let mut trajectory = fmu.simulate_with(&options, poll)?;
        if let Some(schedule) = schedule.filter(|schedule| trajectory.time.len() == schedule.times.len()) {
            trajectory.columns = rows.gather(&schedule, &trajectory.columns);
            trajectory.time = times.to_vec();
        }
        for (column, shift) in trajectory.columns.iter_mut().zip(self.output_shifts(x)) {
            column.iter_mut().for_each(|value| *value = shift.of(*value));
        }
        Ok(trajectory)
    }
}

/// Returns the variables that have given values at the start of the simulation, independent of the
/// initialization. These are initial states, and fitted variables that are not parameters of the model. A
/// co-simulation cannot set them after the initialization, so a number for an initial state is a start value
/// there.
fn initial_states(
    experiment: &Experiment,
    fitted: &[String],
    description: &ModelDescription,
    kind: InterfaceKind,
) -> Vec<String> {
    let is_state = |name: &&String| {
        // An element of an array has no separate declaration.
        let array = name.split('[').next().unwrap_or_default();
        let variable = description.variable(name).or_else(|| description.variable(array));
        variable.is_some_and(|v| matches!(v.causality, Causality::Local | Causality::Output))
    };
    let is_required = |(name, initial): &&(String, InitialState)| match initial {
        InitialState::Value(_) => kind == InterfaceKind::ModelExchange,
        InitialState::MeasuredBy(_) => is_state(&name),
        InitialState::Measured | InitialState::Fitted(_) => true,
    };
    let given = experiment.initial_states.iter().filter(is_required).map(|(name, _)| name);
    let mut names: Vec<String> = given.chain(fitted.iter().filter(is_state)).cloned().collect();
    names.sort_unstable();
    names.dedup();
    names
}

/// Returns an error if the row times are invalid for a simulation.
fn check_times(times: &[f64], start: f64) -> Result<(), FmiError> {
    let bad = |message: String| Err(FmiError::BadSetting(message));
    for (i, time) in times.iter().enumerate() {
        let before = if i == 0 { start } else { times[i - 1] };
        match time.partial_cmp(&before) {
            Some(Ordering::Less) if i > 0 => {
                let (time, before) = (Number(*time), Number(before));
                return bad(format!("times must ascend: times[{i}] = {time} comes after {before}"));
            }
            Some(Ordering::Less) if start - time > base::time_tolerance(start, start) => {
                let (time, start) = (Number(*time), Number(start));
                return bad(format!("times[{i}] = {time} is before the start of the simulation, {start}"));
            }
            Some(_) if time.is_finite() => {}
            _ => return bad(format!("times[{i}] = {} is not a finite number", Number(*time))),
        }
    }
    Ok(())
}

fn values<'x>(assigned: &Assignments, x: &'x [f64]) -> Cow<'x, [f64]> {
    match assigned.is_identity {
        true => Cow::Borrowed(x),
        false => {
            let values = assigned.derivation.extended(x);
            assigned.variables.iter().map(|(_, of)| of.in_model(&values)).collect()
        }
    }
}

fn inputs(signals: &[Signal], shifts: impl Iterator<Item = Shift>) -> Option<Inputs> {
    let add = |inputs: Inputs, (signal, shift): (&Signal, Shift)| signal.add_to(inputs, shift);
    (!signals.is_empty()).then(|| signals.iter().zip(shifts).fold(Inputs::new(), add))
}

/// Returns the lowest and the highest value of a quantity within the bounds of its parameter.
fn range(of: &Affine, assigned: &Assignments, elements: &[Element]) -> (f64, f64) {
    let (lower, upper) = of.entry.map_or((0.0, 0.0), |entry| assigned.derivation.range(entry, elements));
    let at = |value: f64| Affine { entry: of.entry.map(|_| 0), ..*of }.in_model(&[value]);
    let (one, other) = (at(lower), at(upper));
    (one.min(other), one.max(other))
}

/// Returns the communication points of a co-simulation from its start to its end.
fn communication_points(plan: &SimulationPlan) -> Vec<f64> {
    let (start, end) = (plan.start_time(), plan.final_time());
    let step = plan.regular_communication_step().unwrap_or((end - start) / DEFAULT_INTERVALS as f64);
    let tolerance = base::time_tolerance(start, end);
    let n = ((end - start + tolerance) / step).floor();
    let mut points: Vec<f64> = (0..=n as u64).map(|k| (start + k as f64 * step).min(end)).collect();
    if points.last().is_some_and(|last| end - last > tolerance) {
        points.push(end);
    }
    points
}

/// Default relative tolerance of designs, unless the model states a smaller one. With 1e-6, criteria of the
/// tank controllers have relative noise of 1.6e-5, and searches with constraints end without convergence;
/// with 1e-8, the noise is 1e-8 (`benches/design.md`).
const DESIGN_TOLERANCE: f64 = 1e-8;

/// Returns the end time of a simulation: the last measurement, or the last sample if outputs may be early.
fn final_time(
    measurements: &Measurements,
    assigned: &Assignments,
    elements: &[Element],
) -> Result<f64, CalibrationError> {
    let mut end = measurements.end.unwrap_or(measurements.start_time);
    for (measured, Shifts { delay, .. }) in measurements.outputs.iter().zip(&assigned.outputs) {
        let (lowest, _) = range(delay, assigned, elements);
        if !lowest.is_finite() {
            let of_x = |entry: usize| elements.get(entry).map(|element| element.parameter.name());
            let name = delay.entry.and_then(|entry| of_x(entry).or_else(|| assigned.derivation.name(entry)));
            let name = name.unwrap_or_default().to_owned();
            let message = format!("its delay may reach {}. Set finite bounds for the delay", Number(lowest));
            return Err(CalibrationError::Parameter { name, message });
        }
        end = measured.times.iter().fold(end, |end, time| end.max(time - lowest.min(0.0)));
    }
    Ok(end)
}
