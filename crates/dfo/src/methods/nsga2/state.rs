//! State machine of NSGA-II: creation of children, selection, and the front.

use super::operators::{cross, mutate};
use super::options::Nsga2;
use super::ranking::{Ranking, dominates, rank};
use crate::error::Error;
use crate::method_interface::interface::{Batch, Method, MethodDetails, Operation, Setup, Status, saved};
use crate::method_interface::rng::{Purpose, Stream};
use crate::methods::shared::cost::Cost;
use crate::methods::shared::generations::Populations;
use crate::methods::shared::pending_generation::PendingGeneration;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::outcome::answer::{Answers, EvaluationKind};
use crate::outcome::pareto_front::{ParetoFront, ParetoPoint};
use crate::outcome::termination::Termination;
use serde::{Deserialize, Serialize};

/// Maximum number of attempts to create a pair without repeated points. Only the values of discrete
/// parameters can make all attempts fail, and repeated points are then known and cost nothing.
const ATTEMPTS: usize = 100;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
enum Phase {
    /// The first population is being evaluated.
    Starting,
    /// Children must be created.
    Proposing,
    /// The children are being evaluated.
    Evaluating,
    NoStart,
    AllFixed,
}

/// Known values of a point in addition to its cost; no criteria if it has none.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Values {
    criteria: Vec<f64>,
    /// Largest violation of a nonlinear constraint.
    violation: f64,
    /// Crowding distance of a member at its selection.
    crowding: f64,
}

/// A running NSGA-II, created by [`Nsga2`].
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Nsga2State {
    options: Nsga2,
    /// Members from the best to the worst, and children.
    pool: Populations,
    /// Values of the members and of the children.
    members: Vec<Values>,
    children: Vec<Values>,
    phase: Phase,
    rounds: PendingGeneration,
    n_iterations: usize,
    /// The second child of the last pair if the number of children is odd.
    #[serde(skip)]
    spare: Vec<f64>,
    /// Members of the tournaments of a generation.
    #[serde(skip)]
    drawn: Vec<usize>,
}

impl Nsga2State {
    pub(super) fn new(options: &Nsga2, setup: Setup, seed: u64) -> Result<Self, Error> {
        let n = if setup.space.n_free() == 0 { 1 } else { options.population };
        let (pool, _) = Populations::new(setup, seed, n, n, options.sampling, options.include_start)?;
        Ok(Self {
            options: options.clone(),
            pool,
            members: vec![Values::default(); n],
            children: vec![Values::default(); n],
            phase: Phase::Starting,
            rounds: PendingGeneration::with_capacity(n),
            n_iterations: 0,
            spare: Vec::new(),
            drawn: Vec::new(),
        })
    }

    /// True if this state was created with `options`.
    pub(super) fn is_of(&self, options: &Nsga2) -> bool {
        self.options == *options
    }

    /// True if the state is consistent with itself and with the problem. State loaded from a file may be
    /// inconsistent.
    pub(super) fn is_sound(&self, setup: &Setup) -> bool {
        let Populations { setup: stored, population, candidates, .. } = &self.pool;
        let space = &setup.space;
        let n = if space.n_free() == 0 { 1 } else { self.options.population };
        let n_criteria = self.n_criteria();
        let is_inside = |points: &RankedPoints| {
            let inside = |(k, u): (usize, &f64)| {
                let (lower, upper) = space.working_bounds(k % space.n_free());
                (lower..=upper).contains(u)
            };
            points.u.iter().enumerate().all(inside)
        };
        let is_known = |points: &RankedPoints, values: &[Values]| {
            values.len() == n
                && points.costs.iter().zip(values).all(|(cost, values)| {
                    let has_criteria = Some(values.criteria.len()) == n_criteria;
                    (has_criteria || cost.value().is_none())
                        && values.criteria.iter().all(|value| value.is_finite())
                })
        };
        stored.space == *space
            && stored.constraints == setup.constraints
            && self.options.check().is_ok()
            && (population.len(), candidates.len()) == (n, n)
            && population.is_sound(space)
            && candidates.is_sound(space)
            && is_inside(population)
            && is_known(population, &self.members)
            && is_known(candidates, &self.children)
            && (self.phase == Phase::Starting || !population.is_pending())
            && self.rounds.is_sound(space.n())
    }

    /// Returns the number of criteria, once known.
    fn n_criteria(&self) -> Option<usize> {
        let mut numbers = self.members.iter().chain(&self.children).map(|values| values.criteria.len());
        numbers.find(|n| *n > 0)
    }

    /// Returns the ranking of the members and, while they are being evaluated, of the children. Children
    /// follow the members.
    fn ranking(&self) -> Ranking {
        let Populations { population, candidates, .. } = &self.pool;
        let mut costs = population.costs.clone();
        if self.phase == Phase::Evaluating {
            costs.extend(&candidates.costs);
        }
        rank(&costs, |k| &self.values(k).criteria)
    }

    /// Returns the values of a member, or of a child that follows the members.
    fn values(&self, k: usize) -> &Values {
        self.members.get(k).unwrap_or_else(|| &self.children[k - self.members.len()])
    }

    /// Replaces the members by the best members and children.
    fn select(&mut self) {
        let Ranking { order, crowding, .. } = self.ranking();
        let n = self.members.len();
        let value = |k: &usize| Values { crowding: crowding[*k], ..self.values(*k).clone() };
        let values: Vec<Values> = order[..n].iter().map(value).collect();
        let Populations { population, candidates, .. } = &mut self.pool;
        let before = population.clone();
        for (slot, &k) in order[..n].iter().enumerate() {
            match k.checked_sub(n) {
                None => population.copy_from(slot, &before, k),
                Some(child) => population.copy_from(slot, candidates, child),
            }
        }
        population.order.sort_unstable();
        self.members = values;
    }

    /// Returns the winner of a tournament of two members: the member that dominates the other, otherwise the
    /// one with the larger crowding distance, otherwise the first. The program of the authors of the paper
    /// compares in this way, and the paper by the front instead of by dominance. By the front, more
    /// populations lose the spread of ZDT2 (`benches/dfo/pareto.py`).
    fn winner(population: &RankedPoints, members: &[Values], [first, second]: [usize; 2]) -> usize {
        let (a, b) = (&members[first], &members[second]);
        let is_second = match (population.cost(first), population.cost(second)) {
            (Cost::Value(_), Cost::Value(_)) if dominates(&a.criteria, &b.criteria) => false,
            (Cost::Value(_), Cost::Value(_)) => {
                dominates(&b.criteria, &a.criteria) || b.crowding > a.crowding
            }
            (first, second) => second.better_than(first),
        };
        if is_second { second } else { first }
    }

    /// Draws the members of the tournaments of a generation: consecutive random permutations of the members,
    /// so that each member enters equally many tournaments, as in the program of the authors of the paper.
    fn draw_tournaments(&mut self) {
        let n = self.members.len();
        let mut stream = Stream::new(self.pool.seed, Purpose::Individual, self.n_iterations as u64 + 1, n);
        self.drawn.clear();
        while self.drawn.len() < 4 * n.div_ceil(2) {
            let begin = self.drawn.len();
            self.drawn.extend(0..n);
            stream.shuffle(&mut self.drawn[begin..]);
        }
    }

    /// Creates the children. Each pair uses a separate random stream.
    fn make_children(&mut self) {
        self.draw_tournaments();
        let Self { options, pool, members, spare, drawn, .. } = self;
        let Populations { setup, seed, population, candidates } = pool;
        let space = &setup.space;
        let rate = options.mutation_rate_of(space.n_free());
        spare.resize(space.n_free(), 0.0);
        let mut first = std::mem::take(spare);
        let mut second = first.clone();
        let n = candidates.len();
        for slot in (0..n).step_by(2) {
            let mut stream = Stream::new(*seed, Purpose::Individual, self.n_iterations as u64 + 1, slot / 2);
            let parent = |at: usize| Self::winner(population, members, [drawn[at], drawn[at + 1]]);
            let parents = [parent(2 * slot), parent(2 * slot + 2)];
            for _ in 0..ATTEMPTS {
                first.copy_from_slice(population.u(parents[0]));
                second.copy_from_slice(population.u(parents[1]));
                if stream.chance(options.crossover_rate) {
                    cross(&mut stream, space, options.crossover_index, &mut first, &mut second);
                }
                let mut is_new = true;
                for (child, u) in [(slot, &mut first), (slot + 1, &mut second)] {
                    mutate(&mut stream, space, rate, options.mutation_index, u);
                    space.restore(u);
                    if child < n {
                        candidates.place(child, u, space);
                        let x = candidates.x(child);
                        is_new &= (0..n).all(|other| population.x(other) != x)
                            && (0..child).all(|other| candidates.x(other) != x);
                    }
                }
                if is_new {
                    break;
                }
            }
        }
        *spare = first;
    }
}

impl Method for Nsga2State {
    fn name(&self) -> &'static str {
        Nsga2::NAME
    }

    fn ask(&mut self, batch: &mut Batch) {
        if self.phase == Phase::Proposing {
            self.make_children();
            self.phase = Phase::Evaluating;
        }
        let Populations { setup, population, candidates, .. } = &self.pool;
        let n = setup.space.n();
        match self.phase {
            Phase::Starting => self.rounds.ask(batch, n, population, |_| f64::INFINITY),
            Phase::Evaluating => self.rounds.ask(batch, n, candidates, |_| f64::INFINITY),
            Phase::Proposing | Phase::NoStart | Phase::AllFixed => self.rounds.ask_nothing(batch, n),
        }
        batch.set_kind(EvaluationKind::Residuals);
    }

    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        let first = || (0..answers.len()).find_map(|k| answers.residuals(k)).map_or(0, <[f64]>::len);
        // The driver of a run reports another number of criteria as an error.
        let n_criteria = self.n_criteria().unwrap_or_else(first);
        let Populations { setup, population, candidates, .. } = &mut self.pool;
        let constraints = &setup.constraints;
        let is_first = self.phase == Phase::Starting;
        let (points, known) =
            if is_first { (population, &mut self.members) } else { (candidates, &mut self.children) };
        let cost_of = |slot: usize, k: usize| {
            let values: &mut Values = &mut known[slot];
            let criteria = answers.residuals(k).unwrap_or_default();
            values.criteria.clear();
            values.violation = constraints.violation(answers.constraints(k));
            let has_criteria = criteria.len() == n_criteria && criteria.iter().all(|value| value.is_finite());
            match Cost::of(&answers.outcomes()[k], constraints, answers.constraints(k)) {
                Cost::Value(value) if has_criteria && n_criteria > 0 => {
                    values.criteria.extend_from_slice(criteria);
                    Cost::Value(value)
                }
                Cost::Value(_) => Cost::Failed,
                cost => cost,
            }
        };
        if !self.rounds.tell_ranked(answers, constraints, points, cost_of)? {
            return Ok(());
        }
        self.select();
        self.n_iterations += usize::from(!is_first);
        self.phase = if self.pool.population.n_finite() == 0 {
            Phase::NoStart
        } else if self.pool.setup.space.n_free() == 0 {
            Phase::AllFixed
        } else {
            Phase::Proposing
        };
        Ok(())
    }

    fn status(&self) -> Status {
        match self.phase {
            Phase::NoStart => Status::NoStart,
            Phase::AllFixed => Status::Ended(Termination::AllFixed),
            Phase::Starting | Phase::Proposing | Phase::Evaluating => Status::Running,
        }
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        self.rounds.best()
    }

    fn best_violation(&self) -> f64 {
        self.rounds.best_violation()
    }

    fn details(&self) -> MethodDetails<'_> {
        let operation = match (&self.phase, self.n_iterations) {
            (Phase::Starting | Phase::NoStart, _) => None,
            (_, 0) => Some(Operation::Initial),
            _ => Some(Operation::Generation),
        };
        MethodDetails {
            n_iterations: self.n_iterations,
            operation,
            plan: "generation",
            seed: Some(self.pool.seed),
            ..MethodDetails::default()
        }
    }

    fn front(&self) -> Option<ParetoFront> {
        let Ranking { order, n_first, .. } = self.ranking();
        let n = self.members.len();
        let point = |&k: &usize| {
            let Values { criteria, violation, .. } = self.values(k).clone();
            let x = match k.checked_sub(n) {
                None => self.pool.population.x(k),
                Some(child) => self.pool.candidates.x(child),
            };
            ParetoPoint { x: x.to_vec(), criteria, constr_violation: violation }
        };
        Some(ParetoFront::new(order.iter().take(n_first.min(n)).map(point).collect()))
    }

    fn save(&self) -> Option<Vec<u8>> {
        saved(self)
    }
}
