//! Selection of the variables that a simulation records: names, array elements, patterns, or everything.

use super::buffers::{OutputContext, OutputPlan, element_of};
use crate::description::{Causality, ModelDescription, Structure, Variability, Variable};
use crate::error::{FmiError, Result};
use crate::instance::assignments::resolve;
use std::collections::HashSet;

/// Maximum number of variables recorded by default. All variables that change are recorded if a model
/// declares neither outputs nor states.
const MOST_UNASKED: usize = 10_000;

/// Name that selects all variables, unless a variable has this name.
const ALL: &str = "all";

/// Columns of a result and the sources of their values.
#[derive(Debug, Default)]
pub(crate) struct Selection {
    pub(crate) plan: OutputPlan,
    pub(crate) names: Vec<String>,
    /// Index of the variable of each column.
    pub(crate) variables: Vec<usize>,
}

impl Selection {
    /// Selects the outputs and the states. If a model declares neither, selects all variables that change.
    /// `states` contains indices of variables.
    pub(crate) fn default_of(context: &OutputContext<'_>, states: &[usize]) -> Self {
        let variables = &context.model.variables;
        let positions = |wanted: &dyn Fn(&Variable) -> bool| -> Vec<usize> {
            (0..variables.len()).filter(|i| wanted(&variables[*i])).collect()
        };
        let mut chosen = positions(&|v| v.causality == Causality::Output);
        let already_chosen: HashSet<usize> = chosen.iter().copied().collect();
        let mut added = HashSet::new();
        chosen
            .extend(states.iter().filter(|state| !already_chosen.contains(*state) && added.insert(**state)));
        if chosen.is_empty() {
            chosen = positions(&|v| {
                matches!(v.variability, Variability::Discrete | Variability::Continuous)
                    && !matches!(v.causality, Causality::Input | Causality::Independent)
            });
            if chosen.len() > MOST_UNASKED {
                log::warn!(
                    "{}: the model declares neither outputs nor states, and its {} changing variables are \
                     too many to record by default. Specify outputs",
                    context.model.model_name,
                    chosen.len()
                );
                chosen.clear();
            }
        }
        let mut selection = Self::default();
        for position in chosen {
            selection.add(context, position, &variables[position].name, None);
        }
        selection.plan.finish();
        selection
    }

    /// Selects the columns for names, elements (`name[2,1]`, counted from 1) and patterns (`*` matches any
    /// characters, `?` one). `all` selects every variable. A variable that a pattern matches again is not
    /// recorded twice.
    ///
    /// # Errors
    /// Returns an error if a name is unknown, or a pattern matches nothing.
    pub(crate) fn of_names<'a>(context: &OutputContext<'a>, names: &'a [String]) -> Result<Self> {
        let (model, structure) = (context.model, context.structure);
        let mut selection = Self::default();
        // Variables that are recorded completely.
        let mut selected: HashSet<&str> = HashSet::new();
        for name in names {
            if let Some(position) = model.variable_index(name) {
                selected.insert(name);
                selection.add(context, position, name, None);
                continue;
            }
            let extents = |array: &str| Some(structure.extents(model, model.variable(array)?));
            if let Some((array, element)) = element_of(name, extents) {
                selection.add(context, resolve(model, array)?, name, Some(element));
            } else if name == ALL {
                selection.add_matching(context, "*", &mut selected);
            } else if name.contains(['*', '?']) {
                if selection.add_matching(context, name, &mut selected) == 0 {
                    let problem = format!("the pattern \"{name}\" does not match any variable");
                    return Err(FmiError::BadSetting(problem));
                }
            } else if name != "time" {
                // Time is always recorded, and a model may have no variable for it.
                resolve(model, name)?;
            }
        }
        selection.plan.finish();
        Ok(selection)
    }

    /// Adds the variables with a name that matches a pattern, under that name, unless already present.
    /// Returns the number of matches.
    fn add_matching<'a>(
        &mut self,
        context: &OutputContext<'a>,
        pattern: &str,
        selected: &mut HashSet<&'a str>,
    ) -> usize {
        let mut found = 0;
        for (name, position) in context.model.names() {
            let is_time = context.model.variables[position].causality == Causality::Independent;
            if !is_time && fits(pattern, name) {
                found += 1;
                if selected.insert(name) {
                    self.add(context, position, name, None);
                }
            }
        }
        found
    }

    fn add(&mut self, context: &OutputContext<'_>, position: usize, name: &str, element: Option<usize>) {
        let columns = self.plan.add(context, &context.model.variables[position], name, element);
        self.variables.extend(columns.iter().map(|_| position));
        self.names.extend(columns);
    }
}

/// Returns the indices of the state variables in the order of the state vector. An index is `None` if the
/// description does not specify the state of a derivative. An array occurs once for each element.
pub(crate) fn states(description: &ModelDescription, structure: &Structure) -> Vec<Option<usize>> {
    let mut states = Vec::new();
    for unknown in &description.structure.derivatives {
        let derivative = &description.variables[unknown.index];
        states
            .extend(std::iter::repeat_n(derivative.derivative, structure.elements(description, derivative)));
    }
    states
}

/// True if `name` matches a pattern in which `*` matches any characters and `?` one. The part after the last
/// `*` is tried at each position. The run time is at most the product of the lengths.
fn fits(pattern: &str, name: &str) -> bool {
    let (mut p, mut n) = (pattern.chars(), name.chars());
    // Remaining pattern after the last star, and remaining name at its last attempt.
    let mut star: Option<(std::str::Chars<'_>, std::str::Chars<'_>)> = None;
    loop {
        let (mut p_next, mut n_next) = (p.clone(), n.clone());
        match (p_next.next(), n_next.next()) {
            (Some('*'), _) => {
                star = Some((p_next.clone(), n.clone()));
                p = p_next;
            }
            (None, None) => return true,
            (Some(wanted), Some(found)) if wanted == '?' || wanted == found => {
                (p, n) = (p_next, n_next);
            }
            _ => {
                let Some((behind, tried)) = &mut star else { return false };
                if tried.next().is_none() {
                    return false;
                }
                (p, n) = (behind.clone(), tried.clone());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::fits;

    #[test]
    fn fits_matches_whole_names() {
        for (pattern, name) in [
            ("*", ""),
            ("*", "arm.phi"),
            ("arm*.phi", "armJoint.phi"),
            ("arm*.phi", "arm.phi.phi"),
            ("*phi*", "phi"),
            ("?.x", "\u{e4}.x"),
            ("a*b*c", "aXbYbZc"),
            ("a?*", "ab"),
            ("x[*]", "x[1,2]"),
        ] {
            assert!(fits(pattern, name), "{pattern} {name}");
        }
        for (pattern, name) in [
            ("arm*.phi", "armJoint.w"),
            ("?", ""),
            ("?", "ab"),
            ("a*b", "abc"),
            ("a", "A"),
            ("", "a"),
            ("a?*", "a"),
        ] {
            assert!(!fits(pattern, name), "{pattern} {name}");
        }
    }

    #[test]
    fn fits_is_fast_for_many_stars() {
        let pattern = "*a".repeat(2000) + "b";
        assert!(!fits(&pattern, &"a".repeat(4000)));
    }
}
