//! Derived parameters: values that follow from other parameters by a formula.

use crate::error::CalibrationError;
use crate::expression::{Affine as LinearPart, Expression, nearest};
use crate::problem::definition::{Element, Problem};
use crate::problem::parameter::{Cycle, Parameter, Target};
use base::Number;
use std::borrow::Cow;

/// Formula of a derived parameter and the parameters of the problem that it uses.
#[derive(Debug, Clone)]
struct Formula {
    /// Index of the derived parameter.
    parameter: usize,
    expression: Expression,
    /// Index of the parameter that each name of the expression refers to.
    uses: Vec<usize>,
}

/// Entry of the extended values that a name refers to, and its range if it is periodic.
pub(crate) type Argument = (usize, Option<Cycle>);

/// Derived parameter in one experiment.
#[derive(Debug)]
struct DerivedEntry {
    formula: Formula,
    /// Arguments, one for each name of the formula.
    arguments: Vec<Argument>,
    name: String,
    lower: f64,
    upper: f64,
}

/// Derived parameters of an experiment. They extend the values `x`: a formula uses entries of `x` and values
/// of the formulas before it.
#[derive(Debug, Default)]
pub(crate) struct Derivation {
    /// Number of entries of `x`.
    n: usize,
    entries: Vec<DerivedEntry>,
}

/// Derived value that is undefined or outside its bounds.
pub(crate) struct DerivedFault {
    /// Name of the parameter.
    pub(crate) name: String,
    pub(crate) value: f64,
    pub(crate) expression: String,
    /// Names and values of the parameters that the formula uses.
    pub(crate) at: String,
    /// The fault without numbers of the point, such as "below its lower bound 0".
    pub(crate) fault: String,
}

/// Derived parameter as results list it.
#[derive(Debug)]
pub(crate) struct Reported {
    /// Name; the experiment follows if the value differs between experiments.
    pub(crate) name: String,
    pub(crate) shown_name: String,
    /// Index of the parameter of the problem.
    pub(crate) parameter: usize,
    /// An experiment in which it has this value.
    pub(crate) experiment: usize,
}

fn bad<T>(parameter: &Parameter, message: String) -> Result<T, CalibrationError> {
    Err(CalibrationError::Parameter { name: parameter.name().to_owned(), message })
}

impl Problem {
    /// Returns the formulas of the derived parameters in an order in which each uses only earlier ones.
    fn formulas(&self) -> Result<Vec<Formula>, CalibrationError> {
        let derived = self.parameters.iter().enumerate();
        let derived = derived.filter_map(|(i, parameter)| Some((i, parameter.derivation()?)));
        let mut open = Vec::new();
        for (parameter, expression) in derived {
            let uses = self.parameters_in(&self.parameters[parameter], &expression)?;
            open.push(Formula { parameter, expression, uses });
        }
        let mut is_open = vec![false; self.parameters.len()];
        open.iter().for_each(|formula: &Formula| is_open[formula.parameter] = true);
        let mut ordered: Vec<Formula> = Vec::with_capacity(open.len());
        while !open.is_empty() {
            let Some(next) = open.iter().position(|formula| !formula.uses.iter().any(|i| is_open[*i])) else {
                return self.cycle(&open);
            };
            let formula = open.remove(next);
            is_open[formula.parameter] = false;
            ordered.push(formula);
        }
        Ok(ordered)
    }

    /// Returns the index of the parameter that each name of an expression refers to.
    fn parameters_in(
        &self,
        parameter: &Parameter,
        expression: &Expression,
    ) -> Result<Vec<usize>, CalibrationError> {
        let is_name = |name: &str| self.parameters.iter().any(|p| p.name() == name);
        if let Err(error) = expression.check_constants(is_name) {
            return bad(parameter, format!("expr: {error}"));
        }
        if let Some(criterion) = expression.criteria().next() {
            let text = criterion.text();
            let message = format!("{text} needs a simulation, so no parameter can follow from it");
            return bad(parameter, format!("expr: {}", expression.error_at_name(&text, message)));
        }
        let index = |name: &String| match self.parameters.iter().position(|p| p.name() == name) {
            Some(index) => Ok(index),
            None => {
                let unknown = self.unknown_name(name, parameter.name());
                match parameter.tie() {
                    Some(_) => bad(parameter, format!("it is tied to {unknown}")),
                    None => {
                        let error =
                            expression.error_at_name(name, format!("the expression contains {unknown}"));
                        bad(parameter, format!("expr: {error}"))
                    }
                }
            }
        };
        expression.names().iter().map(index).collect()
    }

    /// Describes a name that is no parameter. `except` is not suggested.
    pub(crate) fn unknown_name(&self, name: &str, except: &str) -> String {
        let names: Vec<&str> = self.parameters.iter().map(Parameter::name).filter(|n| *n != except).collect();
        let near =
            nearest(name, names.iter().copied()).map_or_else(String::new, |near| format!(" ('{near}'?)"));
        format!("'{name}'{near}, which does not exist; available: {}", names.join(", "))
    }

    /// Returns the error of formulas that use each other in a circle.
    fn cycle<T>(&self, open: &[Formula]) -> Result<T, CalibrationError> {
        // Each open formula uses an open one, so a walk along them must repeat itself.
        let mut path: Vec<usize> = Vec::new();
        let mut at = open.first().map_or(0, |formula| formula.parameter);
        while !path.contains(&at) {
            path.push(at);
            let formula = open.iter().find(|formula| formula.parameter == at);
            let used = formula.and_then(|formula| {
                formula.uses.iter().find(|i| open.iter().any(|other| other.parameter == **i))
            });
            at = used.copied().unwrap_or(at);
        }
        let from = path.iter().position(|i| *i == at).unwrap_or(0);
        let names = path[from..].iter().chain([&at]).map(|i| format!("'{}'", self.parameters[*i].name()));
        let message = format!(
            "it follows from itself: {}. Give one of them a start value",
            names.collect::<Vec<_>>().join(" from ")
        );
        bad(&self.parameters[at], message)
    }

    /// Checks the formulas of the derived parameters, and that each parameter without variables is used by
    /// one.
    pub(crate) fn check_formulas(&self) -> Result<(), CalibrationError> {
        let formulas = self.formulas()?;
        let is_unused = |(i, p): &(usize, &Parameter)| {
            let acts = !matches!(p.target(), Target::Variables([])) || p.is_derived();
            !acts && !formulas.iter().any(|formula| formula.uses.contains(i))
        };
        match self.parameters.iter().enumerate().find(is_unused) {
            None => Ok(()),
            Some((_, unused)) => bad(
                unused,
                "variables is empty. Specify the variables that it sets, or use it in the expr of another parameter"
                    .to_owned(),
            ),
        }
    }

    /// Returns the parameters for a problem with these experiments only: those that act in them, and those
    /// that their formulas use.
    pub(crate) fn acting_in(&self, experiments: &[String]) -> Vec<Parameter> {
        let acting = self.parameters.iter().filter_map(|p| p.restricted_to(experiments));
        self.with_used(acting.collect())
    }

    /// Adds parameters of this problem that formulas of the kept ones use. They set no variable.
    pub(crate) fn with_used(&self, kept: Vec<Parameter>) -> Vec<Parameter> {
        let mut chosen: Vec<Option<Parameter>> = (self.parameters.iter())
            .map(|own| kept.iter().find(|parameter| parameter.name() == own.name()).cloned())
            .collect();
        loop {
            let used: Vec<String> = (chosen.iter().flatten().filter_map(Parameter::derivation))
                .flat_map(|expression| expression.names().to_vec())
                .collect();
            let mut is_complete = true;
            for (own, chosen) in self.parameters.iter().zip(&mut chosen) {
                if chosen.is_none() && used.iter().any(|name| name == own.name()) {
                    *chosen = Some(own.without_target());
                    is_complete = false;
                }
            }
            if is_complete {
                return chosen.into_iter().flatten().collect();
            }
        }
    }

    /// Returns for each parameter whether it has a separate value in each experiment, because it is local or
    /// follows from a local one.
    pub(crate) fn local_parameters(&self) -> Result<Vec<bool>, CalibrationError> {
        let mut is_local: Vec<bool> = self.parameters.iter().map(Parameter::is_local).collect();
        for formula in self.formulas()? {
            is_local[formula.parameter] = formula.uses.iter().any(|i| is_local[*i]);
        }
        Ok(is_local)
    }

    /// Returns the derived parameters in the order in which results list them. A value that follows from a
    /// local parameter occurs once per experiment.
    pub(crate) fn reported(&self) -> Result<Vec<Reported>, CalibrationError> {
        let is_local = self.local_parameters()?;
        let names = self.experiment_names();
        let mut all = Vec::new();
        for (i, parameter) in self.parameters.iter().enumerate().filter(|(_, p)| p.is_derived()) {
            let mut acting = (0..names.len()).filter(|k| parameter.acts_in(&names[*k]));
            if is_local[i] {
                all.extend(acting.map(|experiment| {
                    let here = parameter.in_experiment(&names[experiment], None);
                    let (name, shown_name) = (here.name().to_owned(), here.shown_name().to_owned());
                    Reported { name, shown_name, parameter: i, experiment }
                }));
            } else if let Some(experiment) = acting.next() {
                let (name, shown_name) = (parameter.name().to_owned(), parameter.shown_name().to_owned());
                all.push(Reported { name, shown_name, parameter: i, experiment });
            }
        }
        Ok(all)
    }
}

impl Derivation {
    /// Resolves the derived parameters of the experiment with index `k`.
    pub(crate) fn new(problem: &Problem, k: usize, elements: &[Element]) -> Result<Self, CalibrationError> {
        let mut made = Self { n: elements.len(), entries: Vec::new() };
        let names = problem.experiment_names();
        let mut formulas = problem.formulas()?;
        // A parameter that does not act here may still be used by one that does.
        let mut needed: Vec<bool> = problem.parameters.iter().map(|p| p.acts_in(&names[k])).collect();
        for formula in
            formulas.iter().rev().filter(|formula| needed[formula.parameter]).cloned().collect::<Vec<_>>()
        {
            formula.uses.iter().for_each(|i| needed[*i] = true);
        }
        formulas.retain(|formula| needed[formula.parameter]);
        for formula in formulas {
            let parameter = &problem.parameters[formula.parameter];
            let mut arguments = Vec::with_capacity(formula.uses.len());
            for i in &formula.uses {
                let used = &problem.parameters[*i];
                let entry = made.entry_of(*i).or_else(|| entry(elements, *i, k));
                let Some(entry) = entry else {
                    let (how, remedy) = match parameter.tie() {
                        Some(_) => ("is tied to", "List the experiments of both"),
                        None => ("follows from", "List the experiments of both"),
                    };
                    let message =
                        format!("it {how} '{}', which does not act in {}. {remedy}", used.name(), names[k]);
                    return bad(parameter, message);
                };
                arguments.push((entry, used.cycle()));
            }
            let (lower, upper) = parameter.given_bounds();
            let name = parameter.name().to_owned();
            made.entries.push(DerivedEntry { formula, arguments, name, lower, upper });
        }
        Ok(made)
    }

    /// Returns the number of extended values.
    pub(crate) fn len(&self) -> usize {
        self.n + self.entries.len()
    }

    /// Returns the entry of the value of a derived parameter.
    pub(crate) fn entry_of(&self, parameter: usize) -> Option<usize> {
        let found = self.entries.iter().position(|entry| entry.formula.parameter == parameter);
        found.map(|index| self.n + index)
    }

    /// Returns the name of a derived parameter, given its entry.
    pub(crate) fn name(&self, entry: usize) -> Option<&str> {
        self.entries.get(entry.checked_sub(self.n)?).map(|entry| entry.name.as_str())
    }

    /// Returns `x` followed by the derived values.
    pub(crate) fn extended<'x>(&self, x: &'x [f64]) -> Cow<'x, [f64]> {
        if self.entries.is_empty() {
            return Cow::Borrowed(x);
        }
        let mut values = Vec::with_capacity(x.len() + self.entries.len());
        values.extend_from_slice(x);
        for entry in &self.entries {
            let value = entry.formula.expression.value(&inputs(&entry.arguments, &values));
            values.push(value);
        }
        Cow::Owned(values)
    }

    /// Returns the first derived value at `x` that is undefined or outside its bounds.
    pub(crate) fn fault(&self, x: &[f64]) -> Option<DerivedFault> {
        let values = self.extended(x);
        let (entry, value, fault) =
            self.entries.iter().zip(values.iter().skip(self.n)).find_map(|(entry, value)| {
                let fault = match *value {
                    value if !value.is_finite() => "not finite".to_owned(),
                    value if value < entry.lower => format!("below its lower bound {}", Number(entry.lower)),
                    value if value > entry.upper => format!("above its upper bound {}", Number(entry.upper)),
                    _ => return None,
                };
                Some((entry, *value, fault))
            })?;
        let pairs = entry.formula.expression.names().iter().zip(inputs(&entry.arguments, &values));
        let at =
            pairs.map(|(name, value)| format!("{name} = {}", Number(value))).collect::<Vec<_>>().join(", ");
        let expression = entry.formula.expression.text().to_owned();
        Some(DerivedFault { name: entry.name.clone(), value, expression, at, fault })
    }

    /// Returns the partial derivatives of an entry with respect to `x`.
    pub(crate) fn slopes(&self, entry: usize, x: &[f64]) -> Vec<f64> {
        let values = self.extended(x);
        let unit = |k: usize| (0..self.n).map(|i| f64::from(u8::from(i == k))).collect::<Vec<f64>>();
        let mut all: Vec<Vec<f64>> = (0..self.n).map(unit).collect();
        for derived in &self.entries {
            let outer = derived.formula.expression.derivatives(&inputs(&derived.arguments, &values));
            let mut slopes = vec![0.0; self.n];
            for (outer, (argument, _)) in outer.iter().zip(&derived.arguments) {
                for (slope, inner) in slopes.iter_mut().zip(&all[*argument]) {
                    // A constant has no influence even where a function has no slope.
                    if *inner != 0.0 && *outer != 0.0 {
                        *slope += outer * inner;
                    }
                }
            }
            all.push(slopes);
        }
        all.swap_remove(entry)
    }

    /// Returns the linear form of each entry over `x`, if it has one.
    pub(crate) fn linear_forms(&self) -> Vec<Option<LinearPart>> {
        let of_x = (0..self.n).map(|k| {
            let mut form = LinearPart::constant(self.n, 0.0);
            form.slopes[k] = 1.0;
            Some(form)
        });
        let mut all: Vec<Option<LinearPart>> = of_x.collect();
        for derived in &self.entries {
            let form = composed(&derived.formula.expression, &derived.arguments, self.n, &all);
            all.push(form);
        }
        all
    }

    /// Returns for each entry of `x` whether arguments depend on it.
    pub(crate) fn dependence(&self, arguments: &[Argument]) -> Vec<bool> {
        let of = |all: &[Vec<bool>], arguments: &[Argument]| {
            let mut depends = vec![false; self.n];
            for (entry, _) in arguments {
                match all.get(entry.wrapping_sub(self.n)) {
                    Some(inner) => depends.iter_mut().zip(inner).for_each(|(own, inner)| *own |= inner),
                    None => depends[*entry] = true,
                }
            }
            depends
        };
        let mut all: Vec<Vec<bool>> = Vec::new();
        for derived in &self.entries {
            let depends = of(&all, &derived.arguments);
            all.push(depends);
        }
        of(&all, arguments)
    }

    /// Returns the lowest and the highest value of an entry, as far as the bounds of the parameters and its
    /// own bounds determine them.
    pub(crate) fn range(&self, entry: usize, elements: &[Element]) -> (f64, f64) {
        let bounds: Vec<(f64, f64)> =
            elements.iter().map(|e| (e.parameter.lower(), e.parameter.upper())).collect();
        if let Some(bounds) = bounds.get(entry) {
            return *bounds;
        }
        let Some(derived) = entry.checked_sub(self.n).and_then(|index| self.entries.get(index)) else {
            return (f64::NEG_INFINITY, f64::INFINITY);
        };
        let (low, high) = match self.linear_forms().swap_remove(entry) {
            Some(form) => form.range(&bounds),
            None => (f64::NEG_INFINITY, f64::INFINITY),
        };
        (low.max(derived.lower), high.min(derived.upper))
    }
}

/// Returns the values of arguments, given the extended values.
pub(crate) fn inputs(arguments: &[Argument], values: &[f64]) -> Vec<f64> {
    let input = |(entry, cycle): &Argument| {
        let value = values.get(*entry).copied().unwrap_or(f64::NAN);
        cycle.map_or(value, |cycle| cycle.wrapped(value))
    };
    arguments.iter().map(input).collect()
}

/// Returns the linear form of an expression whose names have linear forms over `x`. A periodic argument has
/// none, because it is wrapped.
pub(crate) fn composed(
    expression: &Expression,
    arguments: &[Argument],
    n: usize,
    forms: &[Option<LinearPart>],
) -> Option<LinearPart> {
    let own = expression.affine_form()?;
    let mut sum = LinearPart::constant(n, own.constant);
    for (slope, (argument, cycle)) in own.slopes.iter().zip(arguments).filter(|(slope, _)| **slope != 0.0) {
        let form = forms.get(*argument)?.as_ref().filter(|_| cycle.is_none())?;
        sum = sum.plus(*slope, form);
    }
    Some(sum)
}

/// Returns the entry of `x` of a parameter in an experiment.
pub(crate) fn entry(elements: &[Element], parameter: usize, k: usize) -> Option<usize> {
    let is_it = |e: &Element| e.source == Some(parameter) && e.experiment.is_none_or(|only| only == k);
    elements.iter().position(is_it)
}
