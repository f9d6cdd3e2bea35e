//! Assignment of the entries of `x` to variables, delays and offsets of an experiment.

use crate::data::{TimeUnit, UnitConversion};
use crate::error::CalibrationError;
use crate::problem::column_units::declared;
use crate::problem::definition::{Element, Problem};
use crate::problem::derived::{Derivation, entry};
use crate::problem::experiment::{Experiment, InitialState};
use crate::problem::input::Shift;
use crate::problem::parameter::{Cycle, Parameter, Target};
use base::Number;
use fmi::{ModelDescription, Value};

/// A number that is constant or follows an entry of the extended values (`x` and the derived values):
/// `factor * values[entry] + offset`, converted to another unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Affine {
    pub(crate) entry: Option<usize>,
    /// In the unit of the parameter.
    pub(crate) factor: f64,
    pub(crate) offset: f64,
    pub(crate) unit: UnitConversion,
    /// Range of the entry if it is periodic.
    pub(crate) cycle: Option<Cycle>,
}

/// Returns the conversion from the unit of a parameter to the unit of a variable, or of the time.
fn conversion(
    parameter: &Parameter,
    variable: Option<&str>,
    description: &ModelDescription,
) -> Result<UnitConversion, CalibrationError> {
    let Some(unit) = parameter.given_unit() else { return Ok(UnitConversion::IDENTITY) };
    let found = match variable {
        None => match TimeUnit::of_model(description).conversion_from(unit) {
            Some(conversion) => Ok(conversion),
            None => UnitConversion::between(unit, description.time_unit()),
        },
        Some(name) => match declared(description, name) {
            Some(variable) => UnitConversion::to_variable(unit, variable, description),
            // Planning the simulation rejects an unknown name and suggests the nearest ones.
            None => return Ok(UnitConversion::IDENTITY),
        },
    };
    found.map_err(|reason| {
        let message = format!(
            "its unit '{unit}' cannot be used: {reason}. Omit unit for values in the unit of the model"
        );
        CalibrationError::Parameter { name: parameter.name().to_owned(), message }
    })
}

impl Affine {
    fn constant(value: f64) -> Self {
        Self { entry: None, factor: 0.0, offset: value, unit: UnitConversion::IDENTITY, cycle: None }
    }

    /// True if the value equals the entry.
    fn is_plain(&self) -> bool {
        self.entry.is_some()
            && (self.factor, self.offset) == (1.0, 0.0)
            && self.unit == UnitConversion::IDENTITY
            && self.cycle.is_none()
    }

    pub(crate) fn is_constant(&self) -> bool {
        self.entry.is_none()
    }

    /// Returns the number in the unit of the parameter.
    fn value(&self, x: &[f64]) -> f64 {
        let Some(entry) = self.entry else { return self.offset };
        let x = self.cycle.map_or(x[entry], |cycle| cycle.wrapped(x[entry]));
        match (self.factor, self.offset) {
            // This is exact also for an infinite entry.
            (1.0, 0.0) => x,
            (factor, offset) => factor * x + offset,
        }
    }

    /// Returns the number in the unit of the model.
    pub(crate) fn in_model(&self, x: &[f64]) -> f64 {
        let value = self.value(x);
        if self.unit.is_identity() { value } else { self.unit.apply(value) }
    }
}

/// Delay, factor and offset of an output or input.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shifts {
    pub(crate) delay: Affine,
    pub(crate) factor: Affine,
    pub(crate) offset: Affine,
}

impl Shifts {
    /// Returns the numbers at the extended values.
    pub(crate) fn at(&self, x: &[f64]) -> Shift {
        let [delay, factor, offset] = [self.delay, self.factor, self.offset].map(|of| of.in_model(x));
        Shift { delay, factor, offset }
    }
}

/// Quantities of the simulation of one experiment that the entries of `x` set.
#[derive(Debug)]
pub(crate) struct Assignments {
    /// Derived parameters.
    pub(crate) derivation: Derivation,
    /// Variables of the model.
    pub(crate) variables: Vec<(String, Affine)>,
    pub(crate) outputs: Vec<Shifts>,
    pub(crate) inputs: Vec<Shifts>,
    /// True if the variables equal the entries, in the same order.
    pub(crate) is_identity: bool,
}

impl Assignments {
    /// Creates the assignments of the experiment with index `k`.
    pub(crate) fn new(
        problem: &Problem,
        k: usize,
        elements: &[Element],
        description: &ModelDescription,
    ) -> Result<Self, CalibrationError> {
        let experiment = &problem.experiments[k];
        let constant = |variable: &str| {
            let delay = experiment.delays.iter().find(|(delayed, _)| delayed == variable);
            let delay = Affine::constant(delay.map_or(0.0, |(_, delay)| *delay));
            Shifts { delay, factor: Affine::constant(1.0), offset: Affine::constant(0.0) }
        };
        let mut all = Self {
            derivation: Derivation::new(problem, k, elements)?,
            variables: Vec::new(),
            outputs: experiment.outputs.iter().map(|output| constant(&output.variable)).collect(),
            inputs: experiment.inputs.iter().map(|(input, _)| constant(input)).collect(),
            is_identity: false,
        };
        for (parameter, of) in follow(problem, k, elements, &all.derivation)? {
            match parameter.target() {
                Target::Variables(variables) => {
                    for variable in variables {
                        let unit = conversion(parameter, Some(variable), description)?;
                        all.variables.push((variable.clone(), Affine { unit, ..of }));
                    }
                }
                Target::Delay(variable) => {
                    let unit = conversion(parameter, None, description)?;
                    all.shifts(experiment, variable).for_each(|shifts| shifts.delay = Affine { unit, ..of });
                }
                Target::Offset(variable) => {
                    let unit = conversion(parameter, Some(variable), description)?;
                    let unit = UnitConversion { offset: 0.0, ..unit };
                    all.shifts(experiment, variable).for_each(|shifts| shifts.offset = Affine { unit, ..of });
                }
                Target::Factor(variable) => {
                    all.shifts(experiment, variable).for_each(|shifts| shifts.factor = of);
                }
            }
        }
        all.is_identity = all.variables.len() == elements.len()
            && all.variables.iter().enumerate().all(|(i, (_, of))| of.is_plain() && of.entry == Some(i));
        Ok(all)
    }

    /// Returns the delays, factors and offsets of the outputs and inputs with this name.
    fn shifts<'a>(
        &'a mut self,
        experiment: &'a Experiment,
        variable: &'a str,
    ) -> impl Iterator<Item = &'a mut Shifts> {
        let outputs = experiment.outputs.iter().map(|output| &output.variable).zip(&mut self.outputs);
        let inputs = experiment.inputs.iter().map(|(input, _)| input).zip(&mut self.inputs);
        outputs.chain(inputs).filter(move |(name, _)| *name == variable).map(|(_, shift)| shift)
    }

    /// Returns the delay, the factor and the offset of each input at the extended values.
    pub(crate) fn input_shifts(&self, x: &[f64]) -> impl Iterator<Item = Shift> {
        self.inputs.iter().map(|shifts| shifts.at(x))
    }
}

/// Returns the parameters of an experiment with the entries that they follow. Fitted initial states come
/// last.
fn follow<'a>(
    problem: &'a Problem,
    k: usize,
    elements: &'a [Element],
    derivation: &Derivation,
) -> Result<Vec<(&'a Parameter, Affine)>, CalibrationError> {
    let mut all = Vec::with_capacity(elements.len());
    let name = &problem.experiment_names()[k];
    let plain = |entry: Option<usize>, cycle: Option<Cycle>| Affine {
        entry,
        factor: 1.0,
        offset: 0.0,
        unit: UnitConversion::IDENTITY,
        cycle,
    };
    let acting = problem.parameters.iter().enumerate().filter(|(_, parameter)| parameter.acts_in(name));
    for (i, parameter) in acting {
        let Some(entry) = derivation.entry_of(i).or_else(|| entry(elements, i, k)) else {
            let message = format!("it has no value in {name}");
            return Err(CalibrationError::Parameter { name: parameter.name().to_owned(), message });
        };
        all.push((parameter, plain(Some(entry), parameter.cycle())));
    }
    for (i, element) in elements.iter().enumerate() {
        if element.source.is_none() && element.experiment == Some(k) {
            all.push((&element.parameter, plain(Some(i), element.parameter.cycle())));
        }
    }
    Ok(all)
}

/// Returns the constant initial states of an experiment by name. An initial state that depends on a fitted
/// offset of its output is added to the variables of `assigned` instead.
pub(crate) fn initial_values(
    experiment: &Experiment,
    start_time: f64,
    assigned: &mut Assignments,
) -> Result<Vec<(String, Value)>, CalibrationError> {
    let setup = |message: String| Err(CalibrationError::Setup(message));
    let mut values = Vec::new();
    for (state, initial) in &experiment.initial_states {
        let value = match initial {
            InitialState::Fitted(_) => continue,
            InitialState::Value(value) if value.is_finite() => *value,
            InitialState::Value(value) => {
                return setup(format!("initial state '{state}' = {} must be finite", Number(*value)));
            }
            InitialState::Measured | InitialState::MeasuredBy(_) => {
                let by = initial.measured_output(state).unwrap_or(state);
                let Some(output) = experiment.outputs.iter().position(|output| output.variable == by) else {
                    return setup(format!(
                        "initial state '{state}' is 'measured', but no column is compared with '{by}'. Add its column to the outputs, \
                         or use a number or a parameter"
                    ));
                };
                let Shifts { delay, factor, offset } = assigned.outputs[output];
                if !delay.is_constant() {
                    return setup(format!(
                        "initial state '{state}' is 'measured', but the delay of its output is fitted, so the row of the start is \
                         unknown. Use a number or a parameter"
                    ));
                }
                if !factor.is_constant() {
                    return setup(format!(
                        "initial state '{state}' is 'measured', but the factor of its output is fitted. Use a number or a parameter"
                    ));
                }
                let column = &experiment.outputs[output].column;
                let measured = experiment.data.value_at(column, start_time + delay.in_model(&[]));
                let measured = measured.map_err(|error| match error {
                    CalibrationError::Data { source_name, message } => CalibrationError::Data {
                        source_name,
                        message: format!(
                            "initial state '{state}' is 'measured', but {message}. Start at a measurement (start_time), or use a \
                             number or a parameter"
                        ),
                    },
                    other => other,
                })?;
                // The compared value is the output plus its offset.
                if offset.entry.is_some() {
                    let (n, d) = offset.unit.factor;
                    let state_of = Affine {
                        factor: -offset.factor * n / d,
                        offset: measured - offset.offset * n / d,
                        unit: UnitConversion::IDENTITY,
                        ..offset
                    };
                    assigned.variables.push((state.clone(), state_of));
                    assigned.is_identity = false;
                    continue;
                }
                measured - offset.in_model(&[])
            }
        };
        values.push((state.clone(), Value::Real(value)));
    }
    Ok(values)
}
