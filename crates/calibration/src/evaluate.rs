//! A problem with its model loaded: residuals and cost at any point.

use crate::column_units::convert_columns;
use crate::error::CalibrationError;
use crate::experiment::{Experiment, SimulationSettings};
use crate::layout::ResidualLayout;
use crate::no_cost::NoCost;
use crate::parameter::Parameter;
use crate::problem::{Element, Problem};
use crate::residual::{Accumulator, Comparison, CostRule, Stop, sum_of_squares};
use crate::warning::{SetupWarning, held_inputs};
use dfo::FailureKind;
use fmi::{FmiError, Fmu, Pool, SimulateOptions, SimulationPlan};
use ode::{Number, Observer, Report, Stats};
use std::borrow::Cow;
use std::sync::Arc;

/// A checked problem and its model.
#[derive(Debug)]
pub(crate) struct Evaluator {
    pub(crate) fmu: Fmu,
    pub(crate) problem: Problem,
    /// One per entry of `x`.
    pub(crate) parameters: Vec<Parameter>,
    pub(crate) simulations: Vec<Simulation>,
    pub(crate) n_residuals: usize,
    pub(crate) layout: ResidualLayout,
    pub(crate) warnings: Vec<SetupWarning>,
}

/// How an experiment is simulated and compared.
#[derive(Debug)]
pub(crate) struct Simulation {
    /// The name of the experiment.
    pub(crate) name: String,
    /// Simulators with the method that the settings name.
    pub(crate) pool: Pool,
    /// The same, by which others are made with another method.
    pub(crate) options: SimulateOptions,
    comparison: Comparison,
    /// Which entries of `x` it takes; `None`: all of them.
    elements: Option<Vec<usize>>,
}

impl Evaluator {
    /// Looks everything up and checks it; loads the model, but simulates nothing yet.
    pub(crate) fn new(fmu: Fmu, mut problem: Problem) -> Result<Self, CalibrationError> {
        let mut warnings = problem.check(fmu.description())?;
        warnings.extend(convert_columns(&mut problem, fmu.description())?);
        let elements = problem.elements()?;
        let simulations = (problem.experiments.iter().zip(problem.experiment_names()).enumerate())
            .map(|(k, (experiment, name))| {
                let setup = (&problem.settings, &problem.parameters[..], &elements[..]);
                let (simulation, in_doubt) = Simulation::new(&fmu, (k, name, experiment), setup)
                    .map_err(|error| problem.error_in(k, error))?;
                for warning in in_doubt.into_iter().map(|warning| problem.warning_in(k, warning)) {
                    // A setting that is ignored is the same in all experiments.
                    if !warnings.contains(&warning) {
                        warnings.push(warning);
                    }
                }
                Ok(simulation)
            })
            .collect::<Result<Vec<_>, CalibrationError>>()?;
        let layout = layout(&problem, &simulations);
        let n_residuals = layout.n_residuals();
        let parameters = elements.into_iter().map(|element| element.parameter).collect();
        Ok(Self { fmu, problem, parameters, simulations, n_residuals, layout, warnings })
    }

    /// Start values of all entries of `x`.
    pub(crate) fn start(&self) -> Vec<f64> {
        self.parameters.iter().map(Parameter::start).collect()
    }

    /// How often simulations of the model were found to depend on earlier ones.
    pub(crate) fn n_history_findings(&self) -> u64 {
        self.fmu.n_history_findings(self.simulations[0].pool.plan().kind())
    }

    /// The cost at `x`: the sum of the squares of the residuals, which go to `out`, from its first to its last. What the
    /// simulations take is added to `stats` (of those that could not be started nothing). `run` makes the simulation of an
    /// experiment with its values of the parameters. Ends where the cost is above the cutoff, and when it is cancelled.
    ///
    /// # Panics
    /// `x` or `out` have another length than there are parameters and residuals.
    pub(crate) fn evaluate(
        &self,
        x: &[f64],
        rule: CostRule<'_>,
        out: &mut [f64],
        stats: &mut Stats,
        mut run: impl FnMut(usize, &[f64], &mut dyn Observer) -> Result<Result<Report, FmiError>, NoCost>,
    ) -> Result<f64, NoCost> {
        // The running sum is in the order of time, the cost in that of the residuals. The sums of n numbers above 0 in two orders
        // differ by less than 2 n units of rounding (Higham, Accuracy and Stability of Numerical Algorithms, 2002, section 4.2).
        let running =
            CostRule { cutoff: rule.cutoff * (1.0 + 2.0 * self.n_residuals as f64 * f64::EPSILON), ..rule };
        let mut sum = 0.0;
        let mut rest = &mut *out;
        for (k, simulation) in self.simulations.iter().enumerate() {
            let (part, others) = rest.split_at_mut(simulation.comparison.n_residuals());
            rest = others;
            let mut accumulator = Accumulator::new(&simulation.comparison, running, sum, part);
            let ran = run(k, &simulation.values(x), &mut accumulator)?;
            match &ran {
                Ok(report) => *stats += report.stats,
                Err(FmiError::Simulation(error)) => *stats += error.stats,
                Err(_) => {}
            }
            sum = self.running_sum(k, &accumulator, ran).map_err(|no_cost| match self.simulations.len() {
                1 => no_cost,
                _ => no_cost.in_experiment(&simulation.name),
            })?;
        }
        let cost = sum_of_squares(out);
        if cost > rule.cutoff { Err(NoCost::Above) } else { Ok(cost) }
    }

    /// The running sum after the simulation of an experiment.
    fn running_sum(
        &self,
        k: usize,
        accumulator: &Accumulator<'_>,
        ran: Result<Report, FmiError>,
    ) -> Result<f64, NoCost> {
        match accumulator.stop {
            Some(Stop::AboveCutoff) => return Err(NoCost::Above),
            Some(Stop::Cancelled) => return Err(NoCost::Cancelled),
            Some(Stop::NotFinite(output)) => {
                let name = &self.problem.experiments[k].outputs[output].variable;
                let reason = format!("the residual of '{name}' is not finite");
                return Err(NoCost::failed(FailureKind::NotFinite, reason));
            }
            None => {}
        }
        let end = Number(ran?.time);
        if accumulator.is_complete() {
            return Ok(accumulator.sum);
        }
        let reason = format!("the model ended the simulation before the last measurement, at t = {end}");
        Err(NoCost::failed(FailureKind::Error, reason))
    }
}

impl Simulation {
    /// The simulation of an experiment, and what is in doubt about it.
    fn new(
        fmu: &Fmu,
        (k, name, experiment): (usize, String, &Experiment),
        (settings, parameters, elements): (&SimulationSettings, &[Parameter], &[Element]),
    ) -> Result<(Self, Vec<SetupWarning>), CalibrationError> {
        let own = |e: &&Element| e.experiment.is_none_or(|only| only == k);
        let varied: Vec<&Parameter> = elements.iter().filter(own).map(|e| &e.parameter).collect();
        let names: Vec<String> = varied.iter().map(|p| p.variable().to_owned()).collect();
        let start: Vec<f64> = varied.iter().map(|p| p.start()).collect();
        let (times, columns) = experiment.measurements()?;
        let weights: Vec<f64> = experiment.outputs.iter().map(|o| o.weight).collect();
        let (times, comparison) = Comparison::new(&times, &columns, &weights);
        let start_time = start_time(fmu, experiment, &times)?;
        let mut warnings = held_inputs(experiment, (start_time, times[times.len() - 1]));
        let is_constant = |(name, _): &&(String, _)| !Experiment::is_start_of_local(name, parameters);
        let options = SimulateOptions {
            start_time: Some(start_time),
            final_time: times.last().copied(),
            times: Some(times),
            start_values: experiment.start_values.iter().filter(is_constant).cloned().collect(),
            parameters: names.clone(),
            outputs: Some(experiment.outputs.iter().map(|o| o.variable.clone()).collect()),
            inputs: experiment.input_table()?,
            relative_tolerance: settings.relative_tolerance,
            kind: settings.kind,
            method: settings.method,
            step_size: settings.step_size,
            max_step: settings.max_step,
            timeout: settings.timeout,
            chattering: settings.chattering,
            input_derivatives: settings.input_derivatives,
            sharing: settings.sharing,
            ..SimulateOptions::default()
        };
        let plan = SimulationPlan::new(fmu, &options)?;
        plan.require_single_numbers()?;
        experiment.check_outputs(fmu.description(), &names)?;
        warnings.extend(options.without_effect(plan.kind()).into_iter().map(SetupWarning::NoEffect));
        let pool = Pool::with_reference(Arc::new(plan), &start)?;
        let numbers = elements.iter().enumerate().filter(|(_, e)| own(e)).map(|(i, _)| i);
        let elements = (names.len() < elements.len()).then(|| numbers.collect());
        Ok((Self { name, pool, options, comparison, elements }, warnings))
    }

    /// The values of its parameters at `x`.
    pub(crate) fn values<'x>(&self, x: &'x [f64]) -> Cow<'x, [f64]> {
        match &self.elements {
            None => Cow::Borrowed(x),
            Some(elements) => elements.iter().map(|&i| x[i]).collect(),
        }
    }
}

/// What the residual vector is made of.
fn layout(problem: &Problem, simulations: &[Simulation]) -> ResidualLayout {
    let mut layout = ResidualLayout::default();
    for (k, (experiment, simulation)) in problem.experiments.iter().zip(simulations).enumerate() {
        let times = simulation.options.times.as_deref().unwrap_or_default();
        let of_experiment = simulation.comparison.layout((layout.n_measurements(), times));
        for (mut residuals, measured) in of_experiment.into_iter().zip(&experiment.outputs) {
            residuals.experiment = k;
            residuals.variable = measured.variable.clone();
            residuals.column = measured.column.clone();
            layout.outputs.push(residuals);
        }
    }
    layout
}

/// Where the simulation of an experiment starts; refuses one after the first measurement.
fn start_time(fmu: &Fmu, experiment: &Experiment, times: &[f64]) -> Result<f64, CalibrationError> {
    let start = experiment.start_time.or(fmu.description().default_experiment.start_time).unwrap_or(0.0);
    let rounding = 100.0 * f64::EPSILON / 2.0 * start.abs().max(times[times.len() - 1].abs());
    if times[0] < start - rounding {
        let [first, start] = [times[0], start].map(Number);
        let source = experiment.data.source();
        return Err(CalibrationError::Setup(format!(
            "{source}: the first measurement is at {first} s, before the simulation starts at {start} s; give \
             start_time = {first}, or a window that begins later"
        )));
    }
    experiment.check_begin(start)?;
    Ok(start)
}
