//! Selection of the variables that a simulation records: names, elements of arrays, patterns, everything.

use super::buffers::{OutputContext, OutputPlan, element_of};
use crate::description::{Causality, ModelDescription, Structure, Variability, Variable};
use crate::error::{FmiError, Result};
use crate::instance::assignments::resolve;
use std::collections::HashSet;

/// Where a model declares neither outputs nor states, everything that changes is recorded, if it is not more
/// than this.
const MOST_UNASKED: usize = 10_000;

/// The name that stands for all variables, where none has it.
const ALL: &str = "all";

/// The columns of a result and where their values come from.
#[derive(Debug, Default)]
pub(crate) struct Selection {
    pub(crate) plan: OutputPlan,
    pub(crate) names: Vec<String>,
    /// Of each column: position of its variable.
    pub(crate) variables: Vec<usize>,
}

impl Selection {
    /// The outputs and the states; where a model declares neither, whatever changes. `states`: positions.
    pub(crate) fn default_of(context: &OutputContext<'_>, states: &[usize]) -> Self {
        let variables = &context.model.variables;
        let positions = |wanted: &dyn Fn(&Variable) -> bool| -> Vec<usize> {
            (0..variables.len()).filter(|i| wanted(&variables[*i])).collect()
        };
        let mut chosen = positions(&|v| v.causality == Causality::Output);
        let known: HashSet<usize> = chosen.iter().copied().collect();
        let mut added = HashSet::new();
        chosen.extend(states.iter().filter(|state| !known.contains(*state) && added.insert(**state)));
        if chosen.is_empty() {
            chosen = positions(&|v| {
                matches!(v.variability, Variability::Discrete | Variability::Continuous)
                    && !matches!(v.causality, Causality::Input | Causality::Independent)
            });
            if chosen.len() > MOST_UNASKED {
                log::warn!(
                    "{}: the model declares neither outputs nor states, and {} variables that change are too many to be \
                     recorded unasked; say which",
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

    /// Columns of the variables given by these names, elements (`name[2,1]`, counted from 1) and patterns
    /// (`*`: any characters, `?`: one); `all`: every variable. A variable found again by a pattern is not
    /// recorded twice.
    ///
    /// # Errors
    /// A name is unknown; a pattern fits nothing.
    pub(crate) fn of_names<'a>(context: &OutputContext<'a>, names: &'a [String]) -> Result<Self> {
        let (model, structure) = (context.model, context.structure);
        let mut selection = Self::default();
        // Those recorded as a whole.
        let mut known: HashSet<&str> = HashSet::new();
        for name in names {
            if let Some(position) = model.variable_index(name) {
                known.insert(name);
                selection.add(context, position, name, None);
                continue;
            }
            let extents = |array: &str| Some(structure.extents(model, model.variable(array)?));
            if let Some((array, element)) = element_of(name, extents) {
                selection.add(context, resolve(model, array)?, name, Some(element));
            } else if name == ALL {
                selection.add_matching(context, "*", &mut known);
            } else if name.contains(['*', '?']) {
                if selection.add_matching(context, name, &mut known) == 0 {
                    let problem = format!("the pattern \"{name}\" fits the name of no variable");
                    return Err(FmiError::BadSetting(problem));
                }
            } else if name != "time" {
                // Time is always there; models may or may not have a variable for it.
                resolve(model, name)?;
            }
        }
        selection.plan.finish();
        Ok(selection)
    }

    /// Adds the variables that fit a pattern by one of their names, under that name, and are not there yet;
    /// how many fit.
    fn add_matching<'a>(
        &mut self,
        context: &OutputContext<'a>,
        pattern: &str,
        known: &mut HashSet<&'a str>,
    ) -> usize {
        let mut found = 0;
        for (name, position) in context.model.names() {
            let is_time = context.model.variables[position].causality == Causality::Independent;
            if !is_time && fits(pattern, name) {
                found += 1;
                if known.insert(name) {
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

/// The positions of the state variables in the order of the state vector; `None` where the description does
/// not say which variable a derivative belongs to. An array stands there once for each element.
pub(crate) fn states(description: &ModelDescription, structure: &Structure) -> Vec<Option<usize>> {
    let mut states = Vec::new();
    for unknown in &description.structure.derivatives {
        let derivative = &description.variables[unknown.index];
        states
            .extend(std::iter::repeat_n(derivative.derivative, structure.elements(description, derivative)));
    }
    states
}

/// True if `name` matches a pattern in which `*` stands for any characters and `?` for one. The part after
/// the last `*` passed is tried at one position after the other, which takes no more than the product of the
/// lengths.
fn fits(pattern: &str, name: &str) -> bool {
    let (mut p, mut n) = (pattern.chars(), name.chars());
    // The rest of the pattern behind the last star, and of the name where that was tried last.
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
    fn patterns_fit_whole_names() {
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
    fn many_stars_take_no_time() {
        let pattern = "*a".repeat(2000) + "b";
        assert!(!fits(&pattern, &"a".repeat(4000)));
    }
}
