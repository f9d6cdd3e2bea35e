//! Options of a simulation.

use crate::description::{DefaultExperiment, Interval, Value};
use crate::fmu::InterfaceChoice;
use crate::simulation::inputs::Inputs;
use crate::sys::InterfaceKind;
use base::Number;
use ode::{ChatteringPolicy, Method};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Output intervals where nothing else is said.
pub const DEFAULT_INTERVALS: usize = 500;

/// Relative tolerance where neither the options nor the model say one.
pub const DEFAULT_TOLERANCE: f64 = 1e-6;

/// Treatment of rows between the steps of a co-simulation that cannot stop there: one that takes steps of one
/// length only, or steps from one multiple of its own step to the next (`fixedInternalStepSize`, FMI 3.0).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BetweenSteps {
    /// Continuous variables are interpolated linearly between the steps on both sides (where the model tells
    /// derivatives of its outputs, along the parabola that has that at the later one), others have the value
    /// of the step before.
    #[default]
    Interpolate,
    /// The simulation is refused.
    #[serde(rename = "error")]
    Refuse,
}

/// Functions that set an option and give the options back.
macro_rules! setters {
    ($of:literal, $($part:ident.)? { $($name:ident($type:ty) = |$given:ident| $value:expr;)* }) => {
        setters!(@ $of, [$($part.)?] $($name($type) = |$given| $value;)*);
    };
    (@ $of:literal, $part:tt $($name:ident($type:ty) = |$given:ident| $value:expr;)*) => {$(
        setters!(@@ $of, $part, $name($type) = |$given| $value);
    )*};
    (@@ $of:literal, [$($part:tt)*], $name:ident($type:ty) = |$given:ident| $value:expr) => {
        #[doc = concat!("Sets [`", stringify!($name), "`](", $of, "::", stringify!($name), ").")]
        #[must_use]
        pub fn $name(mut self, $given: $type) -> Self {
            self.$($part)*$name = $value;
            self
        }
    };
}

/// How a model is run: what a user sets once for all simulations of it. Serialised under the names that users
/// write.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default)]
pub struct RunSettings {
    /// Interface that runs the model; default: model exchange where it offers that, else co-simulation.
    #[cfg_attr(feature = "schema", schemars(schema_with = "kinds"))]
    pub kind: InterfaceChoice,
    /// Integration method (model exchange).
    #[serde(rename = "solver")]
    #[cfg_attr(feature = "schema", schemars(schema_with = "solvers"))]
    pub method: Method,
    /// Relative tolerance; default: that of the default experiment, else 1e-6. The model is told of it where
    /// it is given here or there: a co-simulation has a default of its own.
    pub relative_tolerance: Option<f64>,
    /// Model exchange: step of the fixed-step methods; default: a 500th of the span. Co-simulation: the
    /// communication step; default: the larger of that of the default experiment and the distance of the
    /// rows; of a model that takes steps of one length, that of the default experiment unless it makes more
    /// than 1e6 steps, else the distance of the rows. A model that takes steps of any length has further
    /// communication points: the rows, and the times at which an input jumps or changes its slope, or, if it
    /// is not told derivatives of inputs, at which an input has another value than in the row before.
    pub step_size: Option<f64>,
    /// Largest step of the adaptive methods.
    pub max_step: Option<f64>,
    /// Points within each step at which event indicators are looked at, for those that cross zero and back
    /// within one (model exchange); default: see [`ode::Options::interior_samples`].
    pub interior_samples: Option<u32>,
    /// Passes derivatives of inputs, those of the line to the inputs at the end of the next step, to
    /// co-simulations that extrapolate inputs (`canInterpolateInputs`, FMI 1.0 and 2.0). Default: yes. Inputs
    /// held over each step, as with `Some(false)` and in most other tools, are less accurate, by an error of
    /// the order of the step.
    pub input_derivatives: Option<bool>,
    /// Response to state events that follow each other so closely that time hardly advances (model exchange);
    /// default: an error.
    #[cfg_attr(feature = "schema", schemars(schema_with = "policies"))]
    pub chattering: ChatteringPolicy,
    /// Limit of wall-clock time of one simulation, in s where users write it.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>", extend("exclusiveMinimum" = 0)))]
    pub timeout: Option<Duration>,
}

/// JSON schema of a choice between names.
#[cfg(feature = "schema")]
macro_rules! names {
    ($($function:ident = $names:expr;)*) => {$(
        fn $function(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
            schemars::json_schema!({ "enum": $names })
        }
    )*};
}

#[cfg(feature = "schema")]
names! {
    kinds = ["auto", "ME", "CS", "me", "cs", "ModelExchange", "CoSimulation", "model-exchange", "co-simulation"];
    solvers = [&Method::ALL.map(Method::name)[..], &["RK45", "Radau", "LSODA", "CVode", "CVodes"]].concat();
    policies = ChatteringPolicy::NAMES;
}

/// Options of a simulation; the default leaves everything to the model.
///
/// ```
/// use fmi::SimulateOptions;
/// let options = SimulateOptions::default().final_time(40.0).start_value("armFriction", 0.01).outputs(["armJoint.phi"]);
/// ```
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct SimulateOptions {
    /// Start time; default: that of the default experiment, else 0.
    pub start_time: Option<f64>,
    /// Final time; default: that of the default experiment, else the last of `times`, else an error.
    pub final_time: Option<f64>,
    /// The times of the rows, ascending. A time listed twice gives the limit from the left, then that from
    /// the right. Co-simulations without event mode have the former only: rows are read before the inputs of
    /// the next communication step are set, so that what follows an input directly, and the input itself, are
    /// those of the step before. At most one of `times`, `output_interval` and `ncp`; without any there are
    /// 500 intervals.
    pub times: Option<Vec<f64>>,
    /// Distance of the rows; the last row is at the final time.
    pub output_interval: Option<f64>,
    /// Number of intervals between the rows.
    pub ncp: Option<usize>,
    /// Values for parameters and variables with a start value, set before the initialization. Of several for
    /// one variable the last counts.
    pub start_values: Vec<(String, Value)>,
    /// Names among `start_values` and `parameters` of variables that have their values when the simulation
    /// starts, also where the initialization computes others (`initial="approx"` or `"calculated"`). In model
    /// exchange continuous states are set after the initialization, with the function that sets continuous
    /// states, and an event iteration follows. Elsewhere a simulation that starts with another value fails
    /// with [`FmiError::StateNotTaken`](crate::FmiError::StateNotTaken).
    pub initial_states: Vec<String>,
    /// Intervals between the ticks of clocks (FMI 3.0): for input clocks whose intervals are fixed or
    /// tunable.
    pub clock_intervals: Vec<(String, Interval)>,
    /// Real variables whose values are given anew at each run.
    pub parameters: Vec<String>,
    /// Variables to record: names; elements of arrays (`name[2,1]`, counted from 1); patterns, in which `*`
    /// stands for any characters and `?` for one; `all` for everything that is a number. Default: the
    /// variables of causality output and the states, or where there are neither, all variables that change.
    /// Time is always there.
    pub outputs: Option<Vec<String>>,
    /// Time-varying inputs.
    pub inputs: Option<Inputs>,
    /// How the model is run.
    pub run: RunSettings,
    /// Takes each step of a fixed-step method in two halves, also one that an input or an event has cut
    /// (model exchange): for comparison with a run that does not.
    pub halve_steps: bool,
    /// Rows between the steps of a co-simulation that cannot stop there; default: interpolated.
    pub between_steps: BetweenSteps,
    /// Add rows for both sides of every event.
    pub record_events: bool,
    /// Set from outside to end the run.
    #[serde(skip)]
    pub cancel: Option<Arc<AtomicBool>>,
}

impl SimulateOptions {
    /// Options that leave everything to the model.
    pub fn new() -> Self {
        Self::default()
    }

    setters! { "Self", {
        start_time(f64) = |time| Some(time);
        final_time(f64) = |time| Some(time);
        times(impl Into<Vec<f64>>) = |times| Some(times.into());
        output_interval(f64) = |interval| Some(interval);
        ncp(usize) = |intervals| Some(intervals);
        inputs(Inputs) = |inputs| Some(inputs);
        halve_steps(bool) = |halve| halve;
        between_steps(BetweenSteps) = |choice| choice;
        record_events(bool) = |on| on;
        cancel(Arc<AtomicBool>) = |flag| Some(flag);
    }}

    setters! { "RunSettings", run. {
        input_derivatives(bool) = |told| Some(told);
        relative_tolerance(f64) = |tolerance| Some(tolerance);
        kind(InterfaceChoice) = |kind| kind;
        method(Method) = |method| method;
        step_size(f64) = |step| Some(step);
        max_step(f64) = |step| Some(step);
        interior_samples(u32) = |points| Some(points);
        timeout(Duration) = |limit| Some(limit);
        chattering(ChatteringPolicy) = |policy| policy;
    }}

    /// Adds to [`clock_intervals`](Self::clock_intervals).
    #[must_use]
    pub fn clock_interval(mut self, name: impl Into<String>, interval: Interval) -> Self {
        self.clock_intervals.push((name.into(), interval));
        self
    }

    /// Adds to [`start_values`](Self::start_values).
    #[must_use]
    pub fn start_value(mut self, name: impl Into<String>, value: impl Into<Value>) -> Self {
        self.start_values.push((name.into(), value.into()));
        self
    }

    /// Adds to [`start_values`](Self::start_values) and [`initial_states`](Self::initial_states).
    #[must_use]
    pub fn initial_state(mut self, name: impl Into<String>, value: f64) -> Self {
        let name = name.into();
        self.initial_states.push(name.clone());
        self.start_value(name, value)
    }

    /// Sets [`parameters`](Self::parameters).
    #[must_use]
    pub fn parameters<N: Into<String>>(mut self, names: impl IntoIterator<Item = N>) -> Self {
        self.parameters = names.into_iter().map(Into::into).collect();
        self
    }

    /// Sets [`outputs`](Self::outputs).
    #[must_use]
    pub fn outputs<N: Into<String>>(mut self, names: impl IntoIterator<Item = N>) -> Self {
        self.outputs = Some(names.into_iter().map(Into::into).collect());
        self
    }

    /// True if a function drives an input.
    pub fn has_input_functions(&self) -> bool {
        self.inputs.as_ref().is_some_and(Inputs::has_functions)
    }

    /// True if a plan for one can be used for the other: all options are equal, including the flag that
    /// cancels.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        // One pattern for all fields, so that none can be forgotten.
        macro_rules! same {
            (but $inputs:ident, $cancel:ident; $($field:ident),+) => {{
                let Self { $inputs, $cancel, $($field),+ } = self;
                let same_inputs = match ($inputs, &other.$inputs) {
                    (Some(inputs), Some(others)) => inputs.is_same(others),
                    (inputs, others) => inputs.is_none() && others.is_none(),
                };
                let flag = |flag: &Option<Arc<AtomicBool>>| flag.as_ref().map(Arc::as_ptr);
                same_inputs && flag($cancel) == flag(&other.$cancel) $(&& *$field == other.$field)+
            }};
        }
        same!(but inputs, cancel; start_time, final_time, times, output_interval, ncp, start_values, initial_states, clock_intervals,
            parameters, outputs, run, halve_steps, between_steps, record_events)
    }

    /// The tolerance that was asked for, else that of the default experiment.
    pub(crate) fn stated_tolerance(&self, experiment: &DefaultExperiment) -> Option<f64> {
        let suggested = experiment.tolerance.filter(|tolerance| (1e-14..1.0).contains(tolerance));
        self.run.relative_tolerance.or(suggested)
    }

    /// The options of the integration method.
    pub(crate) fn method_options(&self, experiment: &DefaultExperiment) -> ode::Options {
        let run = &self.run;
        ode::Options {
            method: run.method,
            relative_tolerance: self.stated_tolerance(experiment).unwrap_or(DEFAULT_TOLERANCE),
            step_size: run.step_size,
            halve_steps: self.halve_steps,
            max_step: run.max_step,
            interior_samples: run.interior_samples,
            record_events: self.record_events,
            limits: ode::Limits { timeout: run.timeout, ..ode::Limits::default() },
            chattering: run.chattering,
            cancel: self.cancel.clone(),
            ..ode::Options::default()
        }
    }
}

impl SimulateOptions {
    /// Settings that have no effect with this interface, with the reason; one sentence each.
    pub fn without_effect(&self, kind: InterfaceKind) -> Vec<String> {
        let (method, integrates) = (self.run.method, kind == InterfaceKind::ModelExchange);
        let mut found = Vec::new();
        if !integrates && method != Method::Auto {
            found.push(format!(
                "solver '{}' has no effect in co-simulation: the model integrates itself",
                method.name()
            ));
        }
        if let Some(step) = self.run.step_size.filter(|_| integrates && !method.is_fixed_step()) {
            found.push(format!(
                "step_size = {} has no effect with the solver '{}', which chooses its steps itself; max_step limits them",
                Number(step),
                method.name()
            ));
        }
        match self.run.max_step.map(Number) {
            Some(step) if !integrates => found.push(format!(
                "max_step = {step} has no effect in co-simulation: the model integrates itself; step_size is the \
                 communication step"
            )),
            Some(step) if method.is_fixed_step() => found.push(format!(
                "max_step = {step} has no effect with the solver '{}': all its steps are step_size",
                method.name()
            )),
            _ => {}
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_ignored_is_said() {
        let both = |method| SimulateOptions::new().method(method).step_size(0.1).max_step(0.2);
        for (method, kind, expected) in [
            (
                Method::Tsit5,
                InterfaceKind::ModelExchange,
                &["step_size = 0.1 has no effect with the solver 'tsit5'"][..],
            ),
            (
                Method::Rk4,
                InterfaceKind::ModelExchange,
                &["max_step = 0.2 has no effect with the solver 'rk4'"],
            ),
            (Method::Auto, InterfaceKind::CoSimulation, &["max_step = 0.2 has no effect in co-simulation"]),
            (Method::Bdf, InterfaceKind::CoSimulation, &["solver 'bdf' has no effect", "max_step = 0.2"]),
        ] {
            let found = both(method).without_effect(kind);
            assert_eq!(found.len(), expected.len(), "{found:?}");
            assert!(found.iter().zip(expected).all(|(found, start)| found.starts_with(start)), "{found:?}");
        }
    }
}
