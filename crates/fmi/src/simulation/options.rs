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

/// Default number of output intervals.
pub const DEFAULT_INTERVALS: usize = 500;

/// Default relative tolerance, used if neither the options nor the model specify one.
pub const DEFAULT_TOLERANCE: f64 = 1e-6;

/// Treatment of rows between the steps of a co-simulation that cannot stop at them.
///
/// Such a model supports only steps of one length, or only steps between multiples of its internal step
/// (`fixedInternalStepSize`, FMI 3.0).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BetweenSteps {
    /// Interpolates continuous variables linearly between the steps on both sides. If the model provides
    /// output derivatives, a parabola that has the derivative at the later step is used. Other variables have
    /// the value of the previous step.
    #[default]
    Interpolate,
    /// Returns an error instead of simulating.
    #[serde(rename = "error")]
    Refuse,
}

/// Builder functions that set an option and return the options.
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

/// Settings that a user chooses once for all simulations of a model. Serialized under the names that users
/// write.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default)]
pub struct RunSettings {
    /// Interface that runs the model. Default: model exchange if the model supports it, otherwise
    /// co-simulation.
    #[cfg_attr(feature = "schema", schemars(schema_with = "kinds"))]
    pub kind: InterfaceChoice,
    /// Integration method (model exchange).
    #[serde(rename = "solver")]
    #[cfg_attr(feature = "schema", schemars(schema_with = "solvers"))]
    pub method: Method,
    /// Relative tolerance. Default: the tolerance of the default experiment, otherwise 1e-6. The model
    /// receives a tolerance only if these settings or the default experiment specify one. Otherwise a
    /// co-simulation uses its own default.
    pub relative_tolerance: Option<f64>,
    /// Step size.
    ///
    /// Model exchange: step of the fixed-step methods; default: 1/500 of the simulated time span.
    ///
    /// Co-simulation: communication step size. It defaults to the default experiment's step size or the row
    /// spacing, whichever is larger. If the model supports only steps of one length, it defaults to the
    /// default experiment's step size. The row spacing is used instead if that step size would result in more
    /// than 1e6 steps.
    ///
    /// If the model supports steps of any length, rows and times at which an input jumps or changes its slope
    /// are also communication points. If the model also does not receive input derivatives, this includes all
    /// times at which an input changes its value.
    pub step_size: Option<f64>,
    /// Maximum step of the adaptive methods.
    pub max_step: Option<f64>,
    /// Number of points within each step at which the event indicators are evaluated (model exchange). They
    /// detect indicators that cross zero twice within one step. Default: see
    /// [`ode::Options::interior_samples`].
    pub interior_samples: Option<u32>,
    /// Passes input derivatives to co-simulations that extrapolate inputs (`canInterpolateInputs`, FMI 1.0
    /// and 2.0). Default: yes.
    ///
    /// Each derivative is the slope of the line to the input value at the end of the next step. `Some(false)`
    /// holds inputs constant over each step, as most other tools do. This is less accurate, with an error of
    /// the order of the step size.
    pub input_derivatives: Option<bool>,
    /// Response to state events that follow each other so closely that time hardly advances (model exchange).
    /// Default: an error.
    #[cfg_attr(feature = "schema", schemars(schema_with = "policies"))]
    pub chattering: ChatteringPolicy,
    /// Limit on the wall-clock time of one simulation. Users write it in seconds.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>", extend("exclusiveMinimum" = 0)))]
    pub timeout: Option<Duration>,
}

/// JSON schema of a choice from a list of names.
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

/// Start of a simulation from steady state (model exchange). After the initialization, the states move under
/// the derivatives at the start time, with the inputs at their first values, until they are at rest. States
/// in [`SimulateOptions::initial_states`] keep their values.
///
/// The approach is a pseudo-transient continuation (Kelley and Keyes, SIAM Journal on Numerical Analysis 35,
/// 1998) with the steps of Radau5, which is L-stable: a long step ends at the equilibrium. The time of the
///       model stays at the start time. The states are at rest if none changes by more than the relative
///       tolerance times the sum of its magnitude and its nominal value in a window. A window is as long as
///       the simulation and as long as the approach before it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SteadyStart {
    /// Longest approach, in units of time. Default: 1000 times the simulated time span. A model that is not
    /// at rest by then fails with [`FmiError::NotSteady`](crate::FmiError::NotSteady).
    pub limit: Option<f64>,
}

/// Options of a simulation. With the default options, the model determines all settings.
///
/// ```
/// use fmi::SimulateOptions;
/// let options = SimulateOptions::default().final_time(40.0).start_value("armFriction", 0.01).outputs(["armJoint.phi"]);
/// ```
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct SimulateOptions {
    /// Start time. Default: the start time of the default experiment, otherwise 0.
    pub start_time: Option<f64>,
    /// Final time. Default: the stop time of the default experiment, otherwise the last entry of `times`,
    /// otherwise an error.
    pub final_time: Option<f64>,
    /// Times of the rows, ascending. Specify at most one of `times`, `output_interval` and `ncp`. Without any
    /// of them there are 500 intervals.
    ///
    /// A time listed twice gives two rows: the limit from the left, then the limit from the right.
    /// Co-simulations without event mode return only the limit from the left. Their rows are read before the
    /// inputs of the next communication step are set. Inputs, and variables that depend on them directly,
    /// therefore have the values of the previous step.
    pub times: Option<Vec<f64>>,
    /// Row spacing. The last row is at the final time.
    pub output_interval: Option<f64>,
    /// Number of intervals between the rows.
    pub ncp: Option<usize>,
    /// Values of parameters and variables with a start value, set before the initialization. If a variable
    /// occurs several times, the last value is used.
    pub start_values: Vec<(String, Value)>,
    /// Names among `start_values` and `parameters` whose variables must have their values when the simulation
    /// starts. This holds even if the initialization computes other values (`initial="approx"` or
    /// `"calculated"`).
    ///
    /// In model exchange, continuous states are set after the initialization by the function that sets
    /// continuous states. An event iteration follows. In all other cases a simulation that starts with a
    /// different value fails with [`FmiError::StateNotTaken`](crate::FmiError::StateNotTaken).
    pub initial_states: Vec<String>,
    /// Brings the model to rest before the simulation (model exchange).
    #[serde(default)]
    pub steady: Option<SteadyStart>,
    /// Intervals between the ticks of input clocks with fixed or tunable intervals (FMI 3.0).
    pub clock_intervals: Vec<(String, Interval)>,
    /// Real variables whose values are passed to each run.
    pub parameters: Vec<String>,
    /// Variables to record. Entries are names, elements of arrays (`name[2,1]`, counted from 1), patterns, or
    /// `all`. In a pattern, `*` matches any characters and `?` matches one. `all` selects all variables.
    /// Default: outputs and states, or all variables that change if there are neither. Time is always
    /// recorded.
    pub outputs: Option<Vec<String>>,
    /// Time-varying inputs.
    pub inputs: Option<Inputs>,
    /// Settings for running the model.
    pub run: RunSettings,
    /// Divides each step of a fixed-step method into two halves, including steps shortened by an input or an
    /// event (model exchange). Use it for comparison with a run without halved steps.
    pub halve_steps: bool,
    /// Treatment of rows between the steps of a co-simulation that cannot stop at them. Default:
    /// interpolation.
    pub between_steps: BetweenSteps,
    /// Adds rows for both sides of every event.
    pub record_events: bool,
    /// Flag that another thread sets to end the run.
    #[serde(skip)]
    pub cancel: Option<Arc<AtomicBool>>,
}

impl SimulateOptions {
    /// Returns the default options.
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
        steady(SteadyStart) = |steady| Some(steady);
        halve_steps(bool) = |halve| halve;
        between_steps(BetweenSteps) = |choice| choice;
        record_events(bool) = |on| on;
        cancel(Arc<AtomicBool>) = |flag| Some(flag);
    }}

    setters! { "RunSettings", run. {
        input_derivatives(bool) = |reported| Some(reported);
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

    /// True if an input is driven by a function.
    pub fn has_input_functions(&self) -> bool {
        self.inputs.as_ref().is_some_and(Inputs::has_functions)
    }

    /// True if a plan made for one set of options can be used for the other. All options must be equal,
    /// including the cancellation flag.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        // One pattern lists all fields, so the compiler reports a missing one.
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
        same!(but inputs, cancel; start_time, final_time, times, output_interval, ncp, start_values, initial_states, steady, clock_intervals,
            parameters, outputs, run, halve_steps, between_steps, record_events)
    }

    /// Returns the requested tolerance, otherwise the tolerance of the default experiment.
    pub(crate) fn stated_tolerance(&self, experiment: &DefaultExperiment) -> Option<f64> {
        let suggested = experiment.tolerance.filter(|tolerance| (1e-14..1.0).contains(tolerance));
        self.run.relative_tolerance.or(suggested)
    }

    /// Returns the options of the integration method.
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
    /// Returns one sentence with the reason for each setting that has no effect with this interface.
    pub fn without_effect(&self, kind: InterfaceKind) -> Vec<String> {
        let (method, integrates) = (self.run.method, kind == InterfaceKind::ModelExchange);
        let mut found = Vec::new();
        if !integrates && method != Method::Auto {
            found.push(format!(
                "solver '{}' has no effect in co-simulation, because the model contains its own solver",
                method.name()
            ));
        }
        if let Some(step) = self.run.step_size.filter(|_| integrates && !method.is_fixed_step()) {
            found.push(format!(
                "step_size = {} has no effect with the solver '{}', which selects its own steps; use \
                 max_step to limit them",
                Number(step),
                method.name()
            ));
        }
        match self.run.max_step.map(Number) {
            Some(step) if !integrates => found.push(format!(
                "max_step = {step} has no effect in co-simulation, because the model contains its own \
                 solver; set the communication step with step_size"
            )),
            Some(step) if method.is_fixed_step() => found.push(format!(
                "max_step = {step} has no effect with the solver '{}', because all its steps have the size \
                 step_size",
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
    fn without_effect_reports_each_ignored_setting() {
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
