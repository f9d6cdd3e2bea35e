//! Structure of the Jacobian from the model description: directional derivatives, and the states on which
//! each derivative depends.

use crate::description::{Capabilities, Causality, ModelDescription, Structure, Variability};
use ode::JacobianPattern;
use std::collections::HashMap;

/// Data for computing the Jacobian of the right-hand side with the FMU.
#[derive(Debug, Default)]
pub(crate) struct JacobianPlan {
    /// Entries that may be nonzero, if the description declares them and the Jacobian is not full.
    pub(crate) pattern: Option<JacobianPattern>,
    /// Value references of derivatives and states, if the FMU supports directional derivatives.
    pub(crate) directional: Option<Directional>,
}

/// Unknowns and knowns of a directional derivative.
#[derive(Debug)]
pub(crate) struct Directional {
    pub(crate) derivatives: Vec<u32>,
    pub(crate) states: Vec<u32>,
}

impl JacobianPlan {
    pub(crate) fn new(model: &ModelDescription, structure: &Structure, capabilities: &Capabilities) -> Self {
        Self {
            pattern: pattern(model, structure),
            directional: if capabilities.provides_directional_derivative {
                directional(model, structure)
            } else {
                None
            },
        }
    }
}

/// Returns the value references of the derivatives and their states, in the order of the state vector.
/// Returns `None` if a state is not declared or its size differs from its derivative; differences are then
/// used.
fn directional(model: &ModelDescription, structure: &Structure) -> Option<Directional> {
    let (mut derivatives, mut states, mut n) = (Vec::new(), Vec::new(), 0);
    for unknown in &model.structure.derivatives {
        let derivative = &model.variables[unknown.index];
        let state = &model.variables[derivative.derivative?];
        let elements = structure.elements(model, derivative);
        if elements != structure.elements(model, state) || derivative.negated || state.negated {
            return None;
        }
        n += elements;
        derivatives.push(derivative.value_reference);
        states.push(state.value_reference);
    }
    (structure.states(model) == n).then_some(Directional { derivatives, states })
}

/// Returns the declared dependencies between derivatives and states. An unclear dependency counts as a
/// dependency on all states. Returns `None` for a full pattern.
fn pattern(model: &ModelDescription, structure: &Structure) -> Option<JacobianPattern> {
    // Ranges of the states in the state vector. Aliases share the value reference of their variable.
    let mut places = HashMap::new();
    let mut rows = Vec::new();
    let mut n = 0;
    for unknown in &model.structure.derivatives {
        let derivative = &model.variables[unknown.index];
        let state = &model.variables[derivative.derivative?];
        let elements = n..n + structure.elements(model, derivative);
        n = elements.end;
        places.insert((state.kind, state.value_reference), elements.clone());
        rows.push((elements, unknown.dependencies.as_ref()?));
    }
    if n != structure.states(model) {
        return None;
    }
    let mut entries = Vec::new();
    for (row, dependencies) in rows {
        for &index in dependencies {
            let variable = &model.variables[index];
            let columns = match places.get(&(variable.kind, variable.value_reference)) {
                Some(columns) => columns.clone(),
                None if is_independent_of_states(variable.causality, variable.variability) => continue,
                None => 0..n,
            };
            entries.extend(row.clone().flat_map(|i| columns.clone().map(move |k| (i, k))));
        }
    }
    JacobianPattern::new(n, entries).filter(|pattern| pattern.n_entries() < n * n)
}

/// True if the variable does not depend on the states.
fn is_independent_of_states(causality: Causality, variability: Variability) -> bool {
    use Causality::{CalculatedParameter, Independent, Input, Parameter, StructuralParameter};
    matches!(causality, Input | Independent | Parameter | StructuralParameter | CalculatedParameter)
        || variability != Variability::Continuous
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Creates a plan with three states. The arguments are the dependency attributes of their derivatives.
    fn plan(dependencies: [&str; 3]) -> JacobianPlan {
        let unknowns: String = dependencies
            .iter()
            .zip(4..)
            .map(|(text, index)| format!("<Unknown index=\"{index}\" {text}/>"))
            .collect();
        let states: String = (1..=3)
            .map(|i| format!("<ScalarVariable name=\"x{i}\" valueReference=\"{i}\"><Real/></ScalarVariable>"))
            .collect();
        let derivatives: String = (1..=3)
            .map(|i| {
                format!(
                    "<ScalarVariable name=\"der(x{i})\" valueReference=\"1{i}\"><Real derivative=\"{i}\"/></ScalarVariable>"
                )
            })
            .collect();
        let text = format!(
            "<fmiModelDescription fmiVersion=\"2.0\" modelName=\"m\" guid=\"1\">\
             <ModelExchange modelIdentifier=\"m\" providesDirectionalDerivative=\"true\"/><ModelVariables>\
             {states}{derivatives}\
             <ScalarVariable name=\"u\" valueReference=\"20\" causality=\"input\"><Real start=\"0\"/></ScalarVariable>\
             <ScalarVariable name=\"alias of x2\" valueReference=\"2\"><Real/></ScalarVariable>\
             <ScalarVariable name=\"algebraic\" valueReference=\"30\"><Real/></ScalarVariable>\
             </ModelVariables><ModelStructure><Derivatives>{unknowns}</Derivatives></ModelStructure></fmiModelDescription>"
        );
        let model = ModelDescription::parse(text.as_bytes()).unwrap();
        let capabilities = model.model_exchange.as_ref().unwrap().capabilities;
        JacobianPlan::new(&model, &Structure::default(), &capabilities)
    }

    fn pattern_of(entries: &[(usize, usize)]) -> Option<JacobianPattern> {
        JacobianPattern::new(3, entries.iter().copied())
    }

    #[test]
    fn pattern_contains_declared_dependencies() {
        let found = plan(["dependencies=\"1 7\"", "dependencies=\"1 8\"", "dependencies=\"\""]);
        assert_eq!(found.pattern, pattern_of(&[(0, 0), (1, 0), (1, 1)]));
        let directional = found.directional.unwrap();
        assert_eq!((directional.derivatives, directional.states), (vec![11, 12, 13], vec![1, 2, 3]));
    }

    #[test]
    fn pattern_is_full_for_undeclared_or_unclear_dependencies() {
        assert_eq!(plan(["dependencies=\"1\"", "", "dependencies=\"3\""]).pattern, None);
        // An algebraic variable may depend on any state.
        let found = plan(["dependencies=\"1\"", "dependencies=\"9\"", "dependencies=\"3\""]);
        assert_eq!(found.pattern, pattern_of(&[(0, 0), (1, 0), (1, 1), (1, 2), (2, 2)]));
        assert_eq!(plan(["dependencies=\"1 2 3\""; 3]).pattern, None);
    }
}
