//! Constraints between parameters, resolved to rows over the entries of `x`.

use crate::error::CalibrationError;
use crate::expression::{Affine as LinearPart, Criterion, Inequality, Relation, nearest};
use crate::problem::definition::{Element, Problem};
use crate::problem::derived::{Argument, Derivation, composed, entry, inputs};
use crate::problem::resolved_goals::with_criteria;
use crate::problem::warning::SetupWarning;
use base::Number;
use dfo::{LinearConstraint, NonlinearConstraint};
use nalgebra::{DMatrix, DVector};

/// Linear constraints of a search: `lower <= a x <= upper`, row by row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LinearRows {
    /// Coefficients of all entries of `x`, in the user's units.
    pub a: Vec<Vec<f64>>,
    /// Smallest values, or `-inf`.
    pub lower: Vec<f64>,
    /// Largest values, or `inf`. They equal the smallest ones for equalities.
    pub upper: Vec<f64>,
}

/// Singular value of equalities, with gradients of length 1, below which one depends on the others.
const DEPENDENT: f64 = 1e-10;

/// Constraints of a calibration over the entries of `x`, in the user's units.
#[derive(Debug, Default)]
pub struct Constraints {
    rows: Vec<Row>,
    /// Derived parameters of each experiment.
    derivations: Vec<Derivation>,
    /// Number of criteria of each experiment.
    n_criteria: usize,
}

/// One comparison in one experiment.
#[derive(Debug)]
struct Row {
    /// The comparison as written, with the experiment if it contains local parameters.
    text: String,
    inequality: Inequality,
    arguments: Vec<Argument>,
    experiment: usize,
    /// True if it contains a criterion of the simulation.
    has_criteria: bool,
    /// Linear form over `x`, if there is one.
    linear: Option<LinearPart>,
    lower: f64,
    upper: f64,
}

fn bad<T>(constraint: &Relation, message: &str) -> Result<T, CalibrationError> {
    Err(CalibrationError::Setup(format!("constraint '{constraint}': {message}")))
}

impl Problem {
    /// Removes the constraints that contain a parameter of other experiments.
    pub(crate) fn drop_foreign_constraints(&mut self) -> Result<(), CalibrationError> {
        let elements = self.elements()?;
        let is_here = |name: &str| {
            let mut parameters = self.parameters.iter().map(|p| p.name());
            parameters.any(|own| own == name) || elements.iter().any(|e| e.parameter.name() == name)
        };
        let kept = self
            .constraints
            .iter()
            .filter(|constraint| constraint.names_of_parameters().into_iter().all(is_here));
        self.constraints = kept.cloned().collect();
        Ok(())
    }
}

impl Constraints {
    /// Resolves and checks the constraints of a problem. Returns them with warnings about constraints that
    /// fixed parameters satisfy.
    ///
    /// # Errors
    /// Returns an error for an unknown name, for a constraint that contradicts the bounds or fixed values,
    /// and for two linear constraints that contradict each other.
    pub(crate) fn new(
        problem: &Problem,
        elements: &[Element],
    ) -> Result<(Self, Vec<SetupWarning>), CalibrationError> {
        let mut made = Self::default();
        let mut warnings = Vec::new();
        if problem.constraints.is_empty() {
            return Ok((made, warnings));
        }
        let n = problem.experiments.len();
        made.n_criteria = problem.criteria().len();
        made.derivations = (0..n).map(|k| Derivation::new(problem, k, elements)).collect::<Result<_, _>>()?;
        for constraint in &problem.constraints {
            check_names(constraint, problem, elements)?;
            for row in made.rows_of(constraint, problem, elements)? {
                match row.check_bounds(constraint, elements, &made.derivations)? {
                    Some(held) => warnings.push(SetupWarning::NoEffect(held)),
                    None => {
                        made.check_against_earlier(constraint, &row)?;
                        made.rows.push(row);
                    }
                }
            }
        }
        Ok((made, warnings))
    }

    /// Returns the rows of a constraint: one for each comparison, and for each experiment if it contains
    /// local parameters.
    fn rows_of(
        &self,
        constraint: &Relation,
        problem: &Problem,
        elements: &[Element],
    ) -> Result<Vec<Row>, CalibrationError> {
        let is_local = problem.local_parameters()?;
        let names = problem.experiment_names();
        let criteria: Vec<String> = problem.criteria().iter().map(Criterion::text).collect();
        let mut rows = Vec::new();
        for inequality in constraint.inequalities() {
            let has_criteria = inequality.expression.criteria().next().is_some();
            let place = |name: &String, k: usize| -> Option<Argument> {
                if inequality.expression.is_criterion(name) {
                    let c = criteria.iter().position(|text| text == name)?;
                    return Some((self.derivations[k].len() + c, None));
                }
                let Some(i) = problem.parameters.iter().position(|p| p.name() == name) else {
                    let at = elements.iter().position(|element| element.parameter.name() == name)?;
                    return Some((at, elements[at].parameter.cycle()));
                };
                let at = self.derivations[k].entry_of(i).or_else(|| entry(elements, i, k))?;
                Some((at, problem.parameters[i].cycle()))
            };
            let has_local = has_criteria
                || inequality.expression.names().iter().any(|name| {
                    problem.parameters.iter().position(|p| p.name() == name).is_some_and(|i| is_local[i])
                });
            let before = rows.len();
            for (experiment, of) in names.iter().enumerate() {
                let arguments = inequality.expression.names().iter().map(|name| place(name, experiment));
                let Some(arguments) = arguments.collect::<Option<Vec<Argument>>>() else { continue };
                let forms = self.derivations[experiment].linear_forms();
                let linear = composed(&inequality.expression, &arguments, elements.len(), &forms)
                    .filter(|_| !has_criteria);
                let shift = linear.as_ref().map_or(0.0, |form| form.constant);
                let text = match has_local && names.len() > 1 {
                    true => format!("{} [{of}]", inequality.text),
                    false => inequality.text.clone(),
                };
                let (lower, upper) = (inequality.lower - shift, inequality.upper - shift);
                let inequality = inequality.clone();
                rows.push(Row {
                    text,
                    inequality,
                    arguments,
                    experiment,
                    has_criteria,
                    linear,
                    lower,
                    upper,
                });
                if !has_local {
                    break;
                }
            }
            if rows.len() == before {
                return bad(constraint, "no experiment contains all its parameters. Check their experiments");
            }
        }
        Ok(rows)
    }

    /// Returns an error if an earlier linear row with proportional coefficients leaves no value.
    fn check_against_earlier(&self, constraint: &Relation, row: &Row) -> Result<(), CalibrationError> {
        let Some(form) = &row.linear else { return Ok(()) };
        for earlier in &self.rows {
            let factor = earlier.linear.as_ref().and_then(|other| form.multiple_of(other));
            let Some(factor) = factor else { continue };
            let (a, b) = (factor * earlier.lower, factor * earlier.upper);
            let (low, high) = (row.lower.max(a.min(b)), row.upper.min(a.max(b)));
            if low - high > 1e-12 * (1.0 + low.abs().min(high.abs())) {
                return bad(
                    constraint,
                    &format!("'{}' contradicts '{}'. Remove one of them", row.text, earlier.text),
                );
            }
        }
        Ok(())
    }

    /// True if there are no constraints.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Returns the texts of the rows: the linear ones, then the others.
    pub fn texts(&self) -> Vec<&str> {
        let of = |linear: bool| self.rows.iter().filter(move |row| row.linear.is_some() == linear);
        of(true).chain(of(false)).map(|row| row.text.as_str()).collect()
    }

    /// Returns the linear rows.
    pub fn linear(&self) -> LinearRows {
        let mut rows = LinearRows::default();
        for row in &self.rows {
            let Some(form) = &row.linear else { continue };
            rows.a.push(form.slopes.clone());
            rows.lower.push(row.lower);
            rows.upper.push(row.upper);
        }
        rows
    }

    /// Returns the constraints of a search.
    pub(crate) fn of_search(&self, tolerance: f64) -> dfo::Constraints {
        let LinearRows { a, lower, upper } = self.linear();
        let linear = a.into_iter().zip(lower.into_iter().zip(upper));
        let nonlinear = self.nonlinear_limits().into_iter();
        dfo::Constraints {
            linear: linear
                .map(|(coefficients, (lower, upper))| LinearConstraint { coefficients, lower, upper })
                .collect(),
            nonlinear: nonlinear
                .map(|(lower, upper)| NonlinearConstraint { lower, upper, keep_feasible: false })
                .collect(),
            tolerance,
        }
    }

    /// Returns the number of independent equalities over these entries of `x`, linearised at `x`.
    pub(crate) fn n_equalities(&self, x: &[f64], free: &[usize]) -> usize {
        let sizes: Vec<f64> = x.iter().map(|x| if *x == 0.0 { 1.0 } else { x.abs() }).collect();
        let equalities = self.rows.iter().filter(|row| row.lower == row.upper);
        let unknown = CriteriaNearby::default();
        let gradients =
            equalities.filter_map(|row| row.around(x, &sizes, &self.derivations, &unknown, self.n_criteria));
        let columns = gradients.filter_map(|nearby| {
            let scaled = free.iter().map(|&i| nearby.gradient[i] * sizes[i]);
            DVector::from_iterator(free.len(), scaled).try_normalize(0.0)
        });
        let columns: Vec<DVector<f64>> = columns.collect();
        if columns.is_empty() { 0 } else { DMatrix::from_columns(&columns).rank(DEPENDENT) }
    }

    /// Returns the first equality, as written.
    pub(crate) fn first_equality(&self) -> Option<&str> {
        self.rows.iter().find(|row| row.lower == row.upper).map(|row| row.text.as_str())
    }

    /// Returns the first constraint that contains a criterion of the simulation, as written.
    pub(crate) fn first_of_simulation(&self) -> Option<&str> {
        self.rows.iter().find(|row| row.has_criteria).map(|row| row.text.as_str())
    }

    /// True if all constraints between parameters hold at a point, up to rounding. Constraints with criteria
    /// are never known to hold.
    pub(crate) fn hold_at(&self, x: &[f64]) -> bool {
        self.rows.iter().all(|row| {
            let value = match &row.linear {
                Some(form) => form.slopes.iter().zip(x).map(|(a, x)| a * x).sum::<f64>(),
                None => row.value(x, &self.derivations, &[], 0),
            };
            let rounding = 1e-12 * value.abs();
            row.lower - rounding <= value && value <= row.upper + rounding
        })
    }

    /// Returns the constraints near a point, linearised there. `sizes`: typical sizes of the entries of `x`.
    /// `criteria`: the criteria of the simulations at the point, if a constraint contains any.
    pub(crate) fn around(&self, x: &[f64], sizes: &[f64], criteria: &CriteriaNearby) -> Vec<Nearby> {
        let around = |row: &Row| row.around(x, sizes, &self.derivations, criteria, self.n_criteria);
        self.rows.iter().filter_map(around).collect()
    }

    /// Returns the smallest and the largest value of each nonlinear row.
    pub fn nonlinear_limits(&self) -> Vec<(f64, f64)> {
        self.nonlinear_rows().map(|row| (row.lower, row.upper)).collect()
    }

    /// Computes the values of the nonlinear rows at `x` and writes them to `out`. `criteria` contains the
    /// criteria of all experiments; it may be empty if no constraint contains any. A value is NaN where a
    /// function is undefined.
    pub fn nonlinear(&self, x: &[f64], criteria: &[f64], out: &mut Vec<f64>) {
        out.clear();
        let value = |row: &Row| row.value(x, &self.derivations, criteria, self.n_criteria);
        out.extend(self.nonlinear_rows().map(value));
    }

    fn nonlinear_rows(&self) -> impl Iterator<Item = &Row> {
        self.rows.iter().filter(|row| row.linear.is_none())
    }
}

/// Criteria of all experiments at a point, and their derivatives.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct CriteriaNearby {
    pub(crate) values: Vec<f64>,
    /// Derivatives with respect to each entry of `x`; zero for fixed entries.
    pub(crate) slopes: Vec<Vec<f64>>,
}

/// A constraint, linearised at a point.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Nearby {
    /// Text of the constraint.
    pub(crate) text: String,
    /// Derivatives with respect to the entries of `x`.
    pub(crate) gradient: Vec<f64>,
    /// Distances of the value from the lower and the upper limit; not negative.
    pub(crate) room: (f64, f64),
    /// True if the point is at a limit.
    pub(crate) is_active: bool,
}

/// Distance from a limit, relative to the change of the constraint over the sizes of its parameters, below
/// which the constraint is active.
const AT_LIMIT: f64 = 1e-6;

impl Row {
    fn around(
        &self,
        x: &[f64],
        sizes: &[f64],
        derivations: &[Derivation],
        criteria: &CriteriaNearby,
        n_criteria: usize,
    ) -> Option<Nearby> {
        let (gradient, value) = match &self.linear {
            Some(form) => (form.slopes.clone(), form.slopes.iter().zip(x).map(|(a, x)| a * x).sum::<f64>()),
            None => {
                let derivation = &derivations[self.experiment];
                let values = with_criteria(derivation, x, &criteria.values, self.experiment, n_criteria);
                let of_names = self.inequality.expression.derivatives(&inputs(&self.arguments, &values));
                let mut gradient = vec![0.0; x.len()];
                for (outer, (entry, _)) in of_names.iter().zip(&self.arguments).filter(|(o, _)| **o != 0.0) {
                    let inner = match entry.checked_sub(derivation.len()) {
                        None => derivation.slopes(*entry, x),
                        Some(criterion) => {
                            let index = self.experiment * n_criteria + criterion;
                            let slope = |of: &Vec<f64>| of.get(index).copied().unwrap_or(f64::NAN);
                            criteria.slopes.iter().map(slope).collect()
                        }
                    };
                    gradient.iter_mut().zip(inner).for_each(|(to, inner)| *to += outer * inner);
                }
                (gradient, self.value(x, derivations, &criteria.values, n_criteria))
            }
        };
        let scale: f64 = gradient.iter().zip(sizes).map(|(slope, size)| (slope * size).abs()).sum();
        if !(scale > 0.0 && scale.is_finite() && value.is_finite()) {
            return None;
        }
        let room = ((value - self.lower).max(0.0), (self.upper - value).max(0.0));
        let is_active = room.0.min(room.1) <= AT_LIMIT * scale;
        Some(Nearby { text: self.text.clone(), gradient, room, is_active })
    }

    fn value(&self, x: &[f64], derivations: &[Derivation], criteria: &[f64], n_criteria: usize) -> f64 {
        let derivation = &derivations[self.experiment];
        let values = with_criteria(derivation, x, criteria, self.experiment, n_criteria);
        self.inequality.expression.value(&inputs(&self.arguments, &values))
    }

    /// Compares the row with the bounds of the parameters. Returns a sentence if it holds for all values
    /// because its parameters are fixed.
    fn check_bounds(
        &self,
        constraint: &Relation,
        elements: &[Element],
        derivations: &[Derivation],
    ) -> Result<Option<String>, CalibrationError> {
        if self.has_criteria {
            return Ok(None);
        }
        let bounds: Vec<(f64, f64)> =
            elements.iter().map(|e| (e.parameter.lower(), e.parameter.upper())).collect();
        let start: Vec<f64> = elements.iter().map(|e| e.parameter.start()).collect();
        let slopes = derivations[self.experiment].dependence(&self.arguments);
        let is_free = |i: usize| slopes[i] && bounds[i].0 < bounds[i].1;
        let is_constant =
            !(0..bounds.len()).any(is_free) || self.linear.as_ref().is_some_and(|form| form.is_constant());
        let (low, high, size) = match &self.linear {
            Some(form) => {
                let (low, high) = form.range(&bounds);
                let terms = form.slopes.iter().zip(&start).map(|(slope, value)| (slope * value).abs());
                (low, high, terms.sum::<f64>() + form.constant.abs())
            }
            None if is_constant => {
                let value = self.value(&start, derivations, &[], 0);
                (value, value, value.abs())
            }
            None => return Ok(None),
        };
        let Inequality { expression, lower, upper, .. } = &self.inequality;
        // Sums of fixed values are exact up to rounding.
        let rounding = 4.0 * f64::EPSILON * bounds.len() as f64 * size;
        if low <= upper + rounding && high >= lower - rounding {
            let held = format!("constraint '{}' holds for all values", self.text);
            return Ok(is_constant.then_some(held));
        }
        let wanted = match (*lower, *upper) {
            (lower, upper) if lower == upper => format!("must be {}", Number(lower)),
            (f64::NEG_INFINITY, upper) => format!("must be at most {}", Number(upper)),
            (lower, _) => format!("must be at least {}", Number(lower)),
        };
        let found = match low == high {
            true => format!("{expression} is {}", Number(low)),
            false => {
                format!("{expression} is between {} and {} within the bounds", Number(low), Number(high))
            }
        };
        let remedy = if is_constant {
            "Correct the fixed values or the constraint"
        } else {
            "Correct the bounds or the constraint"
        };
        bad(constraint, &format!("{found}, but {wanted}. {remedy}"))
    }
}

/// Checks that a constraint contains parameters only.
fn check_names(
    constraint: &Relation,
    problem: &Problem,
    elements: &[Element],
) -> Result<(), CalibrationError> {
    let mut names: Vec<&str> = problem.parameters.iter().map(|p| p.name()).collect();
    for element in elements {
        if !names.contains(&element.parameter.name()) {
            names.push(element.parameter.name());
        }
    }
    if let Err(error) = constraint.check_constants(|name| names.contains(&name)) {
        return bad(constraint, &error.to_string());
    }
    if constraint.names().is_empty() {
        return bad(constraint, "it contains no parameter. Remove it");
    }
    let found = constraint.names_of_parameters();
    match found.iter().find(|name| !names.contains(*name)) {
        None => Ok(()),
        Some(unknown) => {
            let near = nearest(unknown, names.iter().copied());
            let near = near.map_or_else(String::new, |near| format!(" ('{near}'?)"));
            let available = names.join(", ");
            let message = format!("'{unknown}'{near} is not a parameter; available: {available}");
            bad(constraint, &constraint.error_at_name(unknown, message).to_string())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Data;
    use crate::problem::definition::ModelFile;
    use crate::problem::experiment::Experiment;
    use crate::problem::goal::Combination;
    use crate::problem::parameter::Parameter;
    use crate::problem::settings::SimulationSettings;
    use std::path::PathBuf;

    fn problem(parameters: &[Parameter], constraints: &[&str], n_experiments: usize) -> Problem {
        Problem {
            model: ModelFile { path: PathBuf::from("none.fmu"), content_hash: String::new() },
            parameters: parameters.to_vec(),
            experiments: vec![Experiment::new(Data::default()); n_experiments],
            settings: SimulationSettings::default(),
            constraints: constraints.iter().map(|text| text.parse().unwrap()).collect(),
            goals: Vec::new(),
            combination: Combination::default(),
        }
    }

    fn resolved(
        parameters: &[Parameter],
        constraints: &[&str],
    ) -> Result<(Constraints, Vec<SetupWarning>), CalibrationError> {
        let problem = problem(parameters, constraints, 2);
        Constraints::new(&problem, &problem.elements().unwrap())
    }

    fn p(name: &str) -> Parameter {
        Parameter::new(name, 0.5).bounds(0.0, 1.0)
    }

    #[test]
    fn linear_constraints_become_rows_over_x() {
        let third = Parameter::derived("k3", "1 - k1 - k2").unwrap();
        let (made, warnings) = resolved(
            &[p("k1"), p("k2"), third, p("free")],
            &["k1 + k2 == 0.75", "0 <= k1 <= 2*k2 - 0.25", "k3 >= 0.1"],
        )
        .unwrap();
        assert!(warnings.is_empty());
        let rows = made.linear();
        assert_eq!(rows.a, [[1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1.0, -2.0, 0.0], [-1.0, -1.0, 0.0]]);
        assert_eq!(rows.lower[..2], [0.75, 0.0]);
        assert_eq!((rows.lower[2], rows.upper[2]), (f64::NEG_INFINITY, -0.25));
        assert_eq!((rows.lower[3], rows.upper[3]), (0.1 - 1.0, f64::INFINITY));
        assert_eq!(rows.upper[0], 0.75);
        assert!(made.nonlinear_limits().is_empty());
        assert_eq!(made.texts(), ["k1 + k2 == 0.75", "0 <= k1", "k1 <= 2*k2 - 0.25", "k3 >= 0.1"]);
    }

    #[test]
    fn nonlinear_constraints_become_functions_of_x() {
        let product = Parameter::derived("product", "a * b").unwrap();
        let angle = Parameter::new("angle", 0.5).bounds(0.0, 1.0).periodic(true);
        let (made, _) = resolved(
            &[p("a"), p("b"), product, angle],
            &["a / b <= 2", "product + a >= 0.1", "angle <= 0.9"],
        )
        .unwrap();
        assert!(made.linear().a.is_empty());
        let infinity = f64::INFINITY;
        assert_eq!(made.nonlinear_limits(), [(-infinity, 2.0), (0.1, infinity), (-infinity, 0.9)]);
        let mut out = vec![7.0];
        made.nonlinear(&[0.5, 0.25, 1.25], &[], &mut out);
        assert_eq!(out, [2.0, 0.625, 0.25]);
    }

    #[test]
    fn constraint_over_local_parameters_holds_in_each_experiment() {
        let local = p("k").local(true);
        let double = Parameter::derived("double", "2 * k").unwrap();
        let (made, _) =
            resolved(&[local, double, p("shared")], &["double <= shared", "k[run1] <= k[run2]"]).unwrap();
        assert_eq!(made.linear().a, [[2.0, 0.0, -1.0], [0.0, 2.0, -1.0], [1.0, -1.0, 0.0]]);
        assert_eq!(made.texts()[1], "double <= shared [run2]");
    }

    #[test]
    fn mistakes_in_constraints_are_named() {
        let fixed = |name: &str, value: f64| Parameter::new(name, value).fixed(true);
        let all = [p("tau1"), p("tau2"), fixed("c", 0.1), fixed("d", 0.2), Parameter::new("open", 1.0)];
        for (constraints, expected) in [
            (
                &["tau1 <= tua2"][..],
                "'tua2' ('tau2'?) is not a parameter; available: tau1, tau2, c, d, open (column 9)",
            ),
            (
                &["tau1 + tau2 == 3"],
                "tau1 + tau2 is between 0 and 2 within the bounds, but must be 3. Correct the bounds",
            ),
            (&["tau1 <= -0.5"], "tau1 is between 0 and 1 within the bounds, but must be at most -0.5"),
            (&["c + d >= 0.5"], "but must be at least 0.5. Correct the fixed values"),
            (&["c * d == 0.5"], "c * d is 0.020000000000000004, but must be 0.5"),
            (&["1 <= 2"], "it contains no parameter"),
            (&["tau1 <= tau2", "tau1 >= tau2 + 0.25"], "'tau1 >= tau2 + 0.25' contradicts 'tau1 <= tau2'"),
            (&["open <= 2", "-3*open <= -9"], "'-3*open <= -9' contradicts 'open <= 2'"),
        ] {
            let error = resolved(&all, constraints).unwrap_err().to_string();
            assert!(error.starts_with("constraint '") && error.contains(expected), "{error}");
        }
        let (made, warnings) = resolved(&all, &["c + d == 0.3", "tau1 - tau1 <= 1"]).unwrap();
        assert!(made.is_empty() && warnings.len() == 2, "{warnings:?}");
        assert!(warnings[0].to_string().contains("'c + d == 0.3' holds for all values"), "{warnings:?}");
        // A relation is not contradicted by one that touches it.
        assert_eq!(resolved(&all, &["open <= 2", "open >= 2"]).unwrap().0.linear().a.len(), 2);
    }
}
