//! Linearization of a model at the current point of an instance.

use super::core::Core;
use super::phases::{ContinuousTime, Instance};
use crate::description::{Causality, ModelDescription, Structure, Variability, Variable, VariableKind};
use crate::error::{FmiError, Result};
use serde::{Deserialize, Serialize};

/// Relative step of a central difference quotient. The cube root of the rounding error balances rounding and
/// truncation (Press et al., Numerical Recipes, 3rd ed., section 5.7).
const DIFFERENCE: f64 = 6.055_454_452_393_343e-6;

/// Linear system `dx/dt = A x + B u`, `y = C x + D u` of deviations from the point. Matrices are stored by
/// rows.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Linearization {
    /// Names of the states, with array elements listed separately. A name is `?` if the description does not
    /// provide it.
    pub states: Vec<String>,
    /// Names of the continuous inputs of type Real.
    pub inputs: Vec<String>,
    /// Names of the continuous outputs of type Real.
    pub outputs: Vec<String>,
    /// Derivatives of the state derivatives with respect to the states.
    pub a: Vec<f64>,
    /// Derivatives of the state derivatives with respect to the inputs.
    pub b: Vec<f64>,
    /// Derivatives of the outputs with respect to the states.
    pub c: Vec<f64>,
    /// Derivatives of the outputs with respect to the inputs.
    pub d: Vec<f64>,
}

/// Variables of a vector: their references, and the names and nominal values of their elements.
#[derive(Default)]
struct Vector {
    references: Vec<u32>,
    names: Vec<String>,
    nominals: Vec<f64>,
}

impl Vector {
    fn new<'a>(
        model: &ModelDescription,
        structure: &Structure,
        variables: impl Iterator<Item = &'a Variable>,
    ) -> Self {
        let mut vector = Self::default();
        for variable in variables {
            let nominal = variable.nominal.map(f64::abs).filter(|n| n.is_finite() && *n > 0.0).unwrap_or(1.0);
            vector.references.push(variable.value_reference);
            let before = vector.names.len();
            name_elements(&variable.name, &structure.extents(model, variable), &mut vector.names);
            vector.nominals.resize(vector.nominals.len() + vector.names.len() - before, nominal);
        }
        vector
    }

    fn len(&self) -> usize {
        self.names.len()
    }
}

/// Appends the names of the elements of a variable. The last index varies fastest.
fn name_elements(name: &str, extents: &[usize], names: &mut Vec<String>) {
    if extents.is_empty() {
        names.push(name.to_owned());
        return;
    }
    let count: usize = extents.iter().product();
    for element in 0..count {
        let (mut rest, mut indices) = (element, vec![0; extents.len()]);
        for (index, extent) in indices.iter_mut().zip(extents).rev() {
            (*index, rest) = (rest % extent + 1, rest / extent);
        }
        let indices: Vec<String> = indices.iter().map(ToString::to_string).collect();
        names.push(format!("{name}[{}]", indices.join(",")));
    }
}

impl Instance<ContinuousTime> {
    /// Linearizes the model at its current point. Uses directional derivatives if the model supports them and
    /// `differences` is false, otherwise central differences. The model is at the same point afterwards.
    ///
    /// # Errors
    /// Returns an error if the FMU returns an error, or an element of a matrix is not finite.
    pub fn linearize(&mut self, differences: bool) -> Result<Linearization> {
        let fmu = self.fmu().clone();
        let model = fmu.description();
        let structure = self.core().structure.clone();
        let n = structure.states(model);
        let continuous = |causality| {
            let is = move |v: &&Variable| {
                v.kind == VariableKind::Real
                    && v.causality == causality
                    && v.variability == Variability::Continuous
            };
            Vector::new(model, &structure, model.variables.iter().filter(is))
        };
        let (inputs, outputs) = (continuous(Causality::Input), continuous(Causality::Output));
        let derivatives =
            || model.structure.derivatives.iter().map(|unknown| &model.variables[unknown.index]);
        let states = Vector::new(
            model,
            &structure,
            derivatives().filter_map(|v| v.derivative.map(|state| &model.variables[state])),
        );
        let slopes = Vector::new(model, &structure, derivatives());
        let has_states = states.len() == n && slopes.len() == n;
        let interface = model.model_exchange.as_ref();
        let is_offered = interface.is_some_and(|i| i.capabilities.provides_directional_derivative);
        let names = match self.state_names() {
            _ if has_states => states.names.clone(),
            Ok(names) if names.len() == n => names.into_iter().map(|n| n.unwrap_or("?".to_owned())).collect(),
            _ => vec!["?".to_owned(); n],
        };
        let columns = match is_offered && has_states && !differences {
            true => self.by_directions(&states, &slopes, &inputs, &outputs)?,
            false => self.by_differences(n, &inputs, &outputs)?,
        };
        let (p, m) = (outputs.len(), inputs.len());
        // Selects entries (i, j) of the columns: derivatives first, then outputs.
        let matrix = |rows: std::ops::Range<usize>, of: std::ops::Range<usize>| {
            rows.flat_map(|i| of.clone().map(move |j| (i, j))).map(|(i, j)| columns[j][i]).collect()
        };
        let linear = Linearization {
            a: matrix(0..n, 0..n),
            b: matrix(0..n, n..n + m),
            c: matrix(n..n + p, 0..n),
            d: matrix(n..n + p, n..n + m),
            states: names,
            inputs: inputs.names,
            outputs: outputs.names,
        };
        match columns.iter().position(|column| !column.iter().all(|value| value.is_finite())) {
            None => Ok(linear),
            Some(j) => {
                let name = linear.states.iter().chain(&linear.inputs).nth(j).map_or("?", String::as_str);
                Err(FmiError::BadSetting(format!(
                    "the derivatives of the model with respect to {name} are not finite at this point"
                )))
            }
        }
    }

    /// Computes the columns with respect to states and inputs from directional derivatives.
    fn by_directions(
        &mut self,
        states: &Vector,
        slopes: &Vector,
        inputs: &Vector,
        outputs: &Vector,
    ) -> Result<Vec<Vec<f64>>> {
        let unknowns = [slopes.references.as_slice(), &outputs.references].concat();
        let rows = slopes.len() + outputs.len();
        let mut columns = Vec::new();
        for knowns in [states, inputs] {
            for j in 0..knowns.len() {
                let (mut seed, mut column) = (vec![0.0; knowns.len()], vec![0.0; rows]);
                seed[j] = 1.0;
                if rows > 0 {
                    self.directional_derivative(&unknowns, &knowns.references, &seed, &mut column)?;
                }
                columns.push(column);
            }
        }
        Ok(columns)
    }

    /// Computes the columns with respect to states and inputs from central differences.
    fn by_differences(&mut self, n: usize, inputs: &Vector, outputs: &Vector) -> Result<Vec<Vec<f64>>> {
        let (mut x, mut u) = (vec![0.0; n], vec![0.0; inputs.len()]);
        let mut nominals = vec![1.0; n];
        if n > 0 {
            self.get_continuous_states(&mut x)?;
            self.get_nominals(&mut nominals)?;
        }
        if !u.is_empty() {
            self.get_reals(&inputs.references, &mut u)?;
        }
        nominals.extend_from_slice(&inputs.nominals);
        let mut point = [x, u].concat();
        let mut columns = Vec::with_capacity(point.len());
        for j in 0..point.len() {
            let (here, nominal) = (point[j], nominals[j].abs());
            let size = if nominal.is_finite() && nominal > 0.0 { nominal } else { 1.0 };
            let difference = DIFFERENCE * here.abs().max(size);
            let (above, below) = (here + difference, here - difference);
            point[j] = above;
            let mut column = self.evaluate(&point, n, inputs, outputs)?;
            point[j] = below;
            let lower = self.evaluate(&point, n, inputs, outputs)?;
            point[j] = here;
            for (upper, lower) in column.iter_mut().zip(lower) {
                *upper = (*upper - lower) / (above - below);
            }
            columns.push(column);
        }
        self.evaluate(&point, n, inputs, outputs)?;
        Ok(columns)
    }

    /// Returns the derivatives and outputs at these states and inputs.
    fn evaluate(&mut self, point: &[f64], n: usize, inputs: &Vector, outputs: &Vector) -> Result<Vec<f64>> {
        let (x, u) = point.split_at(n);
        let mut values = vec![0.0; n + outputs.len()];
        let (dx, y) = values.split_at_mut(n);
        let core: &mut Core = self.core();
        core.set_reals(&inputs.references, u)?;
        if n > 0 {
            self.set_continuous_states(x)?;
            self.get_derivatives(dx)?;
        }
        if !y.is_empty() {
            self.get_reals(&outputs.references, y)?;
        }
        Ok(values)
    }
}
