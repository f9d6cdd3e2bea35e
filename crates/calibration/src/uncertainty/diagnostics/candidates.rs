//! Numbers of a model that are taken as known, and by how much each changes the residuals: offsets of inputs,
//! start values, parameters that are held.

use crate::error::CalibrationError;
use crate::loaded::calibration::Calibration;
use crate::loaded::simulations_around::{Point, Simulations};
use crate::problem::definition::Problem;
use crate::problem::experiment::{Experiment, InitialState};
use crate::problem::input::InputSource;
use crate::problem::parameter::Parameter;
use crate::problem::resolution::{is_same, states};
use crate::uncertainty::diagnostics::score_test::{Change, OmittedKind};
use dfo::RobustLoss;
use fmi::Value;
use fmi::description::{Causality, Initial, Variability, Variable};
use nalgebra::DVector;

/// So many are looked at: each takes one simulation, or two.
const MOST: usize = 16;

/// Simulations for all of them.
pub(crate) const MOST_SIMULATIONS: usize = 1 + 2 * MOST;

/// Of the simulations beside the first this part moves a number for the first time, the others with a better
/// step.
const FIRST: (usize, usize) = (2, 3);

/// The part of its size that each is moved by first.
const PART: f64 = 1e-3;

/// A step that changes the residuals by less than the first or by more than the second, in standard
/// deviations, is made again with a better length, at most so many times as long.
const STEP: (f64, f64) = (0.03, 30.0);
const LONGER: f64 = 100.0;

/// Simulations that should be the same differ by less than this part of the residuals.
const SAME: f64 = 1e-3;

/// A number that is taken as known.
struct Candidate {
    effect: OmittedKind,
    variable: String,
    /// Its value in each experiment, or that of an offset.
    starts: Vec<f64>,
    size: f64,
    /// The parameter that holds it, by number; `None`: it is none.
    fixed: Option<usize>,
}

/// A point whose residuals are known.
pub(crate) struct AtPoint<'a> {
    pub(crate) x: &'a [f64],
    pub(crate) residuals: &'a [f64],
    /// Their variances.
    pub(crate) variances: &'a [f64],
}

impl Calibration {
    /// The changes of the residuals at a point by each of them, for a size of one; those that cannot be set
    /// are left out. `most`: simulations that this may take.
    ///
    /// # Errors
    /// [`CalibrationError::Cancelled`].
    pub(crate) fn changes_by_candidates(
        &self,
        at: &AtPoint<'_>,
        most: usize,
        simulations: &mut Simulations<'_>,
    ) -> Result<Vec<Change>, CalibrationError> {
        let last = simulations.n + most;
        let candidates = self.candidates((most.saturating_sub(1) * FIRST.0 / FIRST.1).min(MOST));
        if let Some(all) = self.changes_by(&candidates, at, last, simulations)? {
            return Ok(all);
        }
        // One of them that cannot be set, or that is no value of its own, spoils no others than those of its kind.
        let mut found = Vec::new();
        for kind in candidates.chunk_by(|a, b| a.effect == b.effect) {
            found.extend(self.changes_by(kind, at, last, simulations)?.unwrap_or_default());
        }
        Ok(found)
    }

    /// The offsets of the inputs, the start values, and the parameters that the model has beside those that
    /// are fitted: so many at most, first those that the problem names, each in the order of the model.
    fn candidates(&self, most: usize) -> Vec<Candidate> {
        let (problem, description) = (self.problem(), self.fmu().description());
        let is_fitted = |variable: &Variable| {
            let is_it = |name: &str| is_same(description, name, &variable.name);
            let mut fitted = problem.parameters.iter().filter_map(Parameter::variable);
            let of_parameter = |p: &Parameter| p.variable_names().iter().any(|name| is_it(name));
            fitted.any(is_it) || problem.parameters.iter().any(of_parameter)
        };
        let number = |effect: OmittedKind, variable: &Variable| {
            let start =
                variable.start.as_ref().and_then(Value::as_number).filter(|start| start.is_finite())?;
            let is_one = variable.kind.is_float() && variable.dimensions.is_empty() && !is_fitted(variable);
            let starts = self.given(variable, start)?;
            let size = [start, variable.nominal.unwrap_or(1.0)].map(f64::abs).into_iter().find(|s| *s > 0.0);
            let size = size.filter(|_| is_one)?;
            // Not beyond the range of the variable.
            let is_at_top = variable.max.is_some_and(|max| start + PART * size > max);
            let size = if is_at_top { -size } else { size };
            Some(Candidate { effect, variable: variable.name.clone(), starts, size, fixed: None })
        };
        let mut inputs: Vec<Candidate> = Vec::new();
        for (experiment, (name, source)) in
            problem.experiments.iter().flat_map(|e| e.inputs.iter().map(move |input| (e, input)))
        {
            let Some(variable) = description.variable(name).filter(|v| v.kind.is_float()) else { continue };
            if !is_fitted(variable) && !inputs.iter().any(|known| known.variable == *name) {
                let size = [size_of(experiment, source), variable.nominal.unwrap_or(1.0).abs()];
                let size = size.into_iter().find(|size| *size > 0.0 && size.is_finite()).unwrap_or(1.0);
                let (effect, variable) = (OmittedKind::InputOffset, name.clone());
                let starts = vec![0.0; problem.experiments.len()];
                inputs.push(Candidate { effect, variable, starts, size, fixed: None });
            }
        }
        let starts = states(description).into_iter().filter_map(|name| description.variable(name));
        // A start value that is a guess may have no effect; an initial state is set in model exchange.
        let has_effect = |v: &&Variable| {
            let mut states = problem.experiments.iter().flat_map(|e| &e.initial_states);
            v.initial == Some(Initial::Exact)
                || v.initial == Some(Initial::Approx)
                    && !self.is_co_simulation()
                    && states.any(|(name, _)| is_same(description, name, &v.name))
        };
        let starts = starts.filter(has_effect).filter_map(|v| number(OmittedKind::StartValue, v));
        let is_driven = |v: &Variable| {
            let mut inputs = problem.experiments.iter().flat_map(|e| &e.inputs);
            inputs.any(|(name, _)| is_same(description, name, &v.name))
        };
        let is_held = |v: &&Variable| {
            v.causality == Causality::Parameter
                && matches!(v.variability, Variability::Fixed | Variability::Tunable)
                && v.initial != Some(Initial::Calculated)
                && !is_driven(v)
        };
        let held =
            description.variables.iter().filter(is_held).filter_map(|v| number(OmittedKind::HeldValue, v));
        let fixed =
            self.parameters().iter().enumerate().filter(|(_, p)| p.lower() == p.upper()).map(|(i, p)| {
                let (x, effect, variable) = (p.lower(), OmittedKind::HeldValue, p.name().to_owned());
                let size = if x == 0.0 { 1.0 } else { x.abs() };
                Candidate {
                    effect,
                    variable,
                    starts: vec![x; problem.experiments.len()],
                    size,
                    fixed: Some(i),
                }
            });
        let mut all: Vec<Candidate> = inputs.into_iter().chain(starts).chain(fixed).chain(held).collect();
        let is_named = |c: &Candidate| {
            let is_it = |name: &str| is_same(description, name, &c.variable);
            let mut given = problem.experiments.iter().flat_map(|e| {
                let states = e.initial_states.iter().map(|(name, _)| name);
                states.chain(e.start_values.iter().map(|(name, _)| name))
            });
            c.effect == OmittedKind::InputOffset || c.fixed.is_some() || given.any(|name| is_it(name))
        };
        all.sort_by_cached_key(|c| !is_named(c));
        all.truncate(most);
        all
    }

    /// The value of a variable in each experiment, its own where none is given; `None`: one that is measured,
    /// fitted or no number.
    fn given(&self, variable: &Variable, own: f64) -> Option<Vec<f64>> {
        let description = self.fmu().description();
        let is_it = |name: &str| is_same(description, name, &variable.name);
        let of = |experiment: &Experiment| {
            let state = experiment.initial_states.iter().find(|(name, _)| is_it(name));
            let start = experiment.start_values.iter().find(|(name, _)| is_it(name));
            match (state, start) {
                (Some((_, InitialState::Value(value))), _) => Some(*value),
                (Some(_), _) => None,
                (None, Some((_, value))) => value.as_number(),
                (None, None) => Some(own),
            }
        };
        self.problem().experiments.iter().map(of).collect()
    }

    /// `None`: with these as parameters of their own the simulation is another one, or none. Of the
    /// simulations the last one has the number `last`.
    fn changes_by(
        &self,
        candidates: &[Candidate],
        at: &AtPoint<'_>,
        last: usize,
        simulations: &mut Simulations<'_>,
    ) -> Result<Option<Vec<Change>>, CalibrationError> {
        if candidates.is_empty() || simulations.n + candidates.len() >= last {
            return Ok(Some(Vec::new()));
        }
        let AtPoint { x, residuals, variances } = *at;
        let problem = self.problem_with(candidates);
        let derived = problem.elements().and_then(|elements| Ok((elements, self.derived_beside(problem)?)));
        let Ok((elements, derived)) = derived else { return Ok(None) };
        let n_parameters = self.problem().parameters.len();
        // Those that a parameter holds are no new ones.
        let new: Vec<usize> = (0..candidates.len()).filter(|c| candidates[*c].fixed.is_none()).collect();
        let (mut own, mut center, mut moves) = (x.iter().enumerate(), Vec::new(), Vec::new());
        for element in &elements {
            let added = element.source.and_then(|source| source.checked_sub(n_parameters));
            let (value, candidate) = match (added, added.is_none().then(|| own.next()).flatten()) {
                (Some(n), _) => (element.parameter.start(), new.get(n).copied()),
                (None, Some((i, x))) => (*x, candidates.iter().position(|c| c.fixed == Some(i))),
                (None, None) => return Ok(None),
            };
            center.push(value);
            moves.push(candidate);
        }
        let moved = |c: usize, step: f64| {
            let by = |k: usize| if moves[k] == Some(c) { step } else { 0.0 };
            Point::new(center.iter().enumerate().map(|(k, x)| x + by(k)).collect())
        };
        let (workers, context) = (simulations.workers, simulations.context);
        let Ok(mut own) = Simulations::new(&derived, RobustLoss::default(), workers, &context) else {
            return Ok(None);
        };
        let mut steps: Vec<f64> = candidates.iter().map(|c| PART * c.size).collect();
        let mut points = vec![Point::new(center.clone())];
        points.extend(steps.iter().enumerate().map(|(c, step)| moved(c, *step)));
        let mut found = own.residuals(&points)?;
        let norm = |from: &[f64], to: &[f64]| {
            let each = from.iter().zip(to).zip(variances);
            each.map(|((a, b), variance)| (a - b) * (a - b) / variance).sum::<f64>().sqrt()
        };
        let zero = vec![0.0; residuals.len()];
        let base = found.remove(0).ok().filter(|base| {
            base.len() == residuals.len() && norm(base, residuals) <= SAME * norm(residuals, &zero)
        });
        let mut again = Vec::new();
        if let Some(base) = &base {
            let mut left = last - (simulations.n + own.n);
            for (c, found) in found.iter_mut().enumerate() {
                let by = found.as_ref().map_or(0.0, |found| norm(found, base));
                if by > 0.0 && by.is_finite() && !(STEP.0..=STEP.1).contains(&by) {
                    if left == 0 {
                        *found = Err("there is no simulation left for a better step".to_owned());
                        continue;
                    }
                    left -= 1;
                    steps[c] *= by.recip().min(LONGER);
                    again.push((c, moved(c, steps[c])));
                }
            }
            let points: Vec<Point> = again.iter().map(|(_, point)| point.clone()).collect();
            let better = if points.is_empty() { Vec::new() } else { own.residuals(&points)? };
            again.iter().zip(better).for_each(|((c, _), better)| found[*c] = better);
        }
        simulations.n += own.n;
        simulations.stats += own.stats;
        let Some(base) = base else { return Ok(None) };
        let mut changes = Vec::new();
        for (c, found) in found.into_iter().enumerate() {
            let Ok(found) = found else { continue };
            let column = DVector::from_fn(residuals.len(), |i, _| (found[i] - base[i]) / steps[c]);
            changes.extend(self.by_experiment(&candidates[c], column));
        }
        Ok(Some(changes))
    }

    /// A change in all experiments, and of each alone where there are several. A value that is held is that
    /// of the machine, a start that of an experiment; nor is one value asked for where several are given.
    fn by_experiment(&self, candidate: &Candidate, column: DVector<f64>) -> Vec<Change> {
        let Candidate { effect, variable, starts, .. } = candidate;
        let change = |experiment: Option<usize>, column: DVector<f64>| Change {
            effect: *effect,
            variable: variable.clone(),
            start: starts[experiment.unwrap_or(0)],
            experiment,
            column,
        };
        if starts.len() == 1 {
            return vec![change(None, column)];
        }
        let outputs = &self.residual_layout().outputs;
        let of = |k: usize| {
            let mut own = DVector::zeros(column.len());
            for output in outputs.iter().filter(|output| output.experiment == k) {
                let (from, n) = (output.range.start, output.range.len());
                own.rows_mut(from, n).copy_from(&column.rows(from, n));
            }
            change(Some(k), own)
        };
        let is_one = starts.iter().all(|start| *start == starts[0]) && *effect != OmittedKind::StartValue;
        let each = (0..starts.len()).filter(|_| *effect != OmittedKind::HeldValue || !is_one).map(of);
        let mut all: Vec<Change> = each.collect();
        all.extend(is_one.then(|| change(None, column)));
        all
    }

    /// The problem with these as further parameters: those that an experiment gives a value of its own are
    /// local ones.
    fn problem_with(&self, candidates: &[Candidate]) -> Problem {
        let (mut problem, description) = (self.problem().clone(), self.fmu().description());
        for Candidate { effect, variable, starts, .. } in candidates.iter().filter(|c| c.fixed.is_none()) {
            let parameter = Parameter::new(variable.clone(), starts[0]);
            problem.parameters.push(match effect {
                OmittedKind::InputOffset => {
                    Parameter::new(format!("offset of {variable}"), 0.0).offset_of(variable.clone())
                }
                _ => parameter.local(true),
            });
            if *effect == OmittedKind::InputOffset {
                continue;
            }
            for (experiment, start) in problem.experiments.iter_mut().zip(starts) {
                let is_other = |name: &str| !is_same(description, name, variable);
                experiment.initial_states.retain(|(name, _)| is_other(name));
                experiment.start_values.retain(|(name, _)| is_other(name));
                experiment.start_values.push((variable.clone(), Value::Real(*start)));
            }
        }
        problem
    }
}

/// The largest value of an input; of a function nothing is known.
fn size_of(experiment: &Experiment, source: &InputSource) -> f64 {
    match source {
        InputSource::Column(column) => experiment.data.series(column).map_or(0.0, |values| {
            values.iter().map(|v| v.abs()).filter(|v| v.is_finite()).fold(0.0, f64::max)
        }),
        InputSource::Constant(value) => value.abs(),
        InputSource::Function(_) => 0.0,
    }
}
