//! The state machine: which points are asked for, and what follows from their outcomes.
//!
//! There is one decision procedure, that of the serial method. It runs over the trial points as far as they are
//! known; where it meets an unknown one, that point is what the next batch asks for. Asking ahead of need only means
//! that more is known when the procedure runs, so all plans take the same path.

use super::options::{BatchPlan, Numbers};
use super::simplex::{Cost, SimplexData};
use crate::error::Error;
use crate::method::{Batch, Method, Operation, Setup, SimplexView, Status};
use crate::objective::Outcome;
use crate::scaling::{BoundsHandling, Space};
use crate::termination::{Termination, Tests};

/// The four trial points of an iteration; the number is the position in the tables below.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Trial {
    Reflection = 0,
    Expansion = 1,
    Outside = 2,
    Inside = 3,
}

#[derive(Debug, Clone)]
struct TrialPoint {
    u: Vec<f64>,
    x: Vec<f64>,
    seen: Seen,
    /// Whether the decision looked at it.
    consulted: bool,
}

/// What is known about a trial point.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Seen {
    Unknown,
    Cost(f64),
    /// Failed, or above a cutoff that no acceptable point is above.
    Rejected,
}

/// What a point of the last batch stands for.
#[derive(Debug, Clone, Copy)]
enum Role {
    Vertex(usize),
    Trial(Trial),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Vertices without a known outcome are asked for: the starting ones.
    Starting,
    /// The same after a shrink.
    Shrinking,
    /// An iteration needs this trial point next.
    Trying(Trial),
    Done,
}

/// A running Nelder-Mead search; made by [`NelderMead`](super::NelderMead).
///
/// Driven by hand it takes the path that [`minimize`](crate::minimize) takes:
///
/// ```
/// use dfo::{Batch, Bounds, Method, MethodOptions, NelderMead, Outcome, Setup, Space};
///
/// let cost = |x: &[f64]| (x[0] - 1.0).powi(2) + 10.0 * (x[1] + 2.0).powi(2);
/// let space = Space::new(&[0.0, 0.0], Bounds::unbounded(2), &[], &[])?;
/// let mut search = NelderMead::default().begin(&Setup::new(space))?;
/// let mut batch = Batch::new();
/// loop {
///     search.ask(&mut batch);
///     if batch.is_empty() {
///         break;
///     }
///     let outcomes: Vec<Outcome> = batch.points().map(|x| Outcome::Value(cost(x))).collect();
///     search.tell(&outcomes)?;
/// }
/// let (x, f) = search.best().unwrap();
/// assert!((x[0] - 1.0).abs() < 1e-4 && (x[1] + 2.0).abs() < 1e-4 && f < 1e-8);
///
/// let report = dfo::minimize(cost).start(&[0.0, 0.0]).run()?;
/// assert_eq!((x, f), (&report.x[..], report.fun));
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct NelderMeadState {
    setup: Setup,
    plan: BatchPlan,
    numbers: Numbers,
    handling: BoundsHandling,
    simplex: SimplexData,
    centroid: Vec<f64>,
    trials: [TrialPoint; 4],
    phase: Phase,
    ended: Option<Termination>,
    roles: Vec<Role>,
    waiting: bool,
    used: Vec<bool>,
    n_batches: u64,
    n_points: u64,
    n_iterations: usize,
    operation: Option<Operation>,
    tests: Option<Tests>,
    f_0: f64,
}

impl NelderMeadState {
    pub(super) fn new(
        setup: Setup,
        plan: BatchPlan,
        numbers: Numbers,
        handling: BoundsHandling,
        simplex: SimplexData,
    ) -> Self {
        let (n, n_user) = (setup.space.n_free(), setup.space.n());
        let trial =
            || TrialPoint { u: vec![0.0; n], x: vec![0.0; n_user], seen: Seen::Unknown, consulted: false };
        let capacity = (n + 1).max(4);
        Self {
            setup,
            plan,
            numbers,
            handling,
            simplex,
            centroid: vec![0.0; n],
            trials: [trial(), trial(), trial(), trial()],
            phase: Phase::Starting,
            ended: None,
            roles: Vec::with_capacity(capacity),
            waiting: false,
            used: Vec::with_capacity(capacity),
            n_batches: 0,
            n_points: 0,
            n_iterations: 0,
            operation: None,
            tests: None,
            f_0: 0.0,
        }
    }

    /// The trial points that a new iteration asks for, in request order.
    fn first_round(&self) -> &'static [Trial] {
        match self.plan {
            BatchPlan::Two => &[Trial::Reflection, Trial::Inside],
            BatchPlan::Four => &[Trial::Reflection, Trial::Expansion, Trial::Outside, Trial::Inside],
            BatchPlan::Auto | BatchPlan::Serial => &[Trial::Reflection],
        }
    }

    /// Where an evaluation may stop without changing a decision. While the reflection is not known yet, the
    /// expansion is compared with the best vertex, which the reflection would have to beat, and the outside
    /// contraction with the worst, which it would have to stay below.
    fn cutoff(&self, trial: Trial) -> f64 {
        let Cost::Value(worst) = self.simplex.cost(self.simplex.worst()) else { return f64::INFINITY };
        let best = self.simplex.cost(self.simplex.best()).value().unwrap_or(f64::INFINITY);
        match (trial, self.trials[Trial::Reflection as usize].seen) {
            (Trial::Reflection | Trial::Inside, _) => worst,
            (Trial::Expansion | Trial::Outside, Seen::Cost(reflected)) => reflected,
            (Trial::Expansion, _) => best,
            (Trial::Outside, _) => worst,
        }
    }

    fn place(&mut self, trial: Trial) {
        let Numbers { reflection, expansion, contraction, .. } = self.numbers;
        let factor = match trial {
            Trial::Reflection => reflection,
            Trial::Expansion => reflection * expansion,
            Trial::Outside => reflection * contraction,
            Trial::Inside => -contraction,
        };
        let space = &self.setup.space;
        let point = &mut self.trials[trial as usize];
        let worst = self.simplex.u(self.simplex.worst());
        let best = self.simplex.u(self.simplex.best());
        let centroid = &self.centroid;
        let raw = |k: usize| centroid[k] + factor * (centroid[k] - worst[k]);
        for (k, u) in point.u.iter_mut().enumerate() {
            *u = space.bring_inside(k, raw(k), best[k], self.handling);
            if self.handling == BoundsHandling::Mirror && mirrored_onto(*u, raw(k), centroid[k]) {
                *u = beside(space, k, raw(k), centroid[k]);
            }
        }
        if self.handling == BoundsHandling::Mirror && self.simplex.has_vertex(&point.u) {
            for (k, u) in point.u.iter_mut().enumerate().filter(|(k, u)| **u != raw(*k)) {
                *u = beside(space, k, raw(k), centroid[k]);
            }
        }
        space.to_user(&point.u, &mut point.x);
    }

    fn request_trial(&mut self, trial: Trial, batch: &mut Batch) {
        self.place(trial);
        let cutoff = self.cutoff(trial);
        batch.push(&self.trials[trial as usize].x, cutoff);
        self.roles.push(Role::Trial(trial));
    }

    /// The cost of a trial point: `Ok(None)` if it is no candidate, `Err` if it is not known yet.
    fn consult(&mut self, trial: Trial) -> Result<Option<f64>, Trial> {
        let point = &mut self.trials[trial as usize];
        point.consulted = true;
        match point.seen {
            Seen::Unknown => Err(trial),
            Seen::Cost(v) => Ok(Some(v)),
            Seen::Rejected => Ok(None),
        }
    }

    /// The decision of an iteration (Lagarias et al. 1998, section 2, steps 2 to 5). `Err`: this point is needed.
    fn decide(&mut self) -> Result<Operation, Trial> {
        let [best, second_worst, worst] =
            [self.simplex.best(), self.simplex.second_worst(), self.simplex.worst()]
                .map(|s| self.simplex.cost(s));
        let reflected = self.consult(Trial::Reflection)?;
        let reflection_beats = |cost| reflected.is_some_and(|r| Cost::Value(r).better_than(cost));
        if let Some(r) = reflected.filter(|_| reflection_beats(best)) {
            return Ok(match self.consult(Trial::Expansion)? {
                Some(e) if e < r => self.accept(Trial::Expansion, e, Operation::Expansion),
                _ => self.accept(Trial::Reflection, r, Operation::Reflection),
            });
        }
        if let Some(r) = reflected.filter(|_| reflection_beats(second_worst)) {
            return Ok(self.accept(Trial::Reflection, r, Operation::Reflection));
        }
        if let Some(r) = reflected.filter(|_| reflection_beats(worst)) {
            if let Some(c) = self.consult(Trial::Outside)?.filter(|c| *c <= r) {
                return Ok(self.accept(Trial::Outside, c, Operation::OutsideContraction));
            }
        } else if let Some(c) = self.consult(Trial::Inside)?.filter(|c| Cost::Value(*c).better_than(worst)) {
            return Ok(self.accept(Trial::Inside, c, Operation::InsideContraction));
        }
        self.simplex.shrink(self.numbers.shrink, &self.setup.space);
        Ok(Operation::Shrink)
    }

    fn accept(&mut self, trial: Trial, value: f64, operation: Operation) -> Operation {
        let point = &self.trials[trial as usize];
        self.simplex.replace_worst(&point.u, &point.x, value);
        operation
    }

    fn begin_iteration(&mut self) {
        for point in &mut self.trials {
            point.seen = Seen::Unknown;
        }
        self.phase = Phase::Trying(Trial::Reflection);
    }

    fn end_iteration(&mut self, operation: Operation) {
        self.n_iterations += 1;
        self.operation = Some(operation);
        let space = &self.setup.space;
        let tolerances = &self.setup.tolerances;
        let f_best = self.simplex.cost(self.simplex.best()).value().unwrap_or(f64::NAN);
        let x_size = self.simplex.x_size(space, tolerances.measure);
        let tests = tolerances.judge(x_size, self.simplex.f_spread(), f_best, self.f_0);
        self.tests = Some(tests);
        if tests.passed {
            self.end(Termination::Converged);
        } else if self.simplex.is_collapsed(space) {
            self.end(Termination::Collapsed);
        } else {
            self.begin_iteration();
        }
    }

    fn end(&mut self, termination: Termination) {
        self.phase = Phase::Done;
        self.ended = Some(termination);
    }

    /// All vertices asked for are known.
    fn vertices_known(&mut self) {
        let starting = self.phase == Phase::Starting;
        self.simplex.sort();
        if !starting {
            return self.end_iteration(Operation::Shrink);
        }
        if self.simplex.cost(self.simplex.best()).value().is_none() {
            self.phase = Phase::Done;
            return;
        }
        self.f_0 = self.simplex.typical_cost();
        self.operation = Some(Operation::Initial);
        if self.setup.space.n_free() == 0 {
            return self.end(Termination::AllFixed);
        }
        self.begin_iteration();
    }
}

/// Whether mirroring took a coordinate (nearly) back to the centroid: with starts and steps on a grid of tenths of
/// the box that happens, and a simplex that accepts the point is flat ever after.
fn mirrored_onto(u: f64, raw: f64, centroid: f64) -> bool {
    u != raw && (u - centroid).abs() <= 1e-3 * (raw - centroid).abs()
}

/// Where such a coordinate goes instead: onto the bound that was crossed, half as far from the centroid as the point
/// would have been without bounds; if the centroid lies there itself, into the middle of the box.
fn beside(space: &Space, k: usize, raw: f64, centroid: f64) -> f64 {
    let (lower, upper) = space.working_bounds(k);
    let bound = if raw.is_finite() { raw.clamp(lower, upper) } else { centroid.clamp(lower, upper) };
    if bound == centroid && lower.is_finite() && upper.is_finite() {
        0.5 * lower + 0.5 * upper
    } else {
        bound
    }
}

/// The cost that an outcome stands for; `Err` if it says nothing.
fn cost_of(outcome: &Outcome) -> Result<Option<f64>, ()> {
    if outcome.is_known() { Ok(outcome.value()) } else { Err(()) }
}

impl Method for NelderMeadState {
    fn name(&self) -> &'static str {
        "nelder-mead"
    }

    fn ask(&mut self, batch: &mut Batch) {
        batch.start(self.setup.space.n(), self.n_batches, self.n_points);
        self.roles.clear();
        match self.phase {
            Phase::Done => {}
            Phase::Starting | Phase::Shrinking => {
                for &slot in self.simplex.order() {
                    if self.simplex.cost(slot) == Cost::Pending {
                        batch.push(self.simplex.x(slot), f64::INFINITY);
                        self.roles.push(Role::Vertex(slot));
                    }
                }
            }
            Phase::Trying(Trial::Reflection) => {
                self.simplex.centroid(&mut self.centroid);
                for &trial in self.first_round() {
                    self.request_trial(trial, batch);
                }
            }
            Phase::Trying(trial) => self.request_trial(trial, batch),
        }
        self.waiting = !self.roles.is_empty();
    }

    fn tell(&mut self, outcomes: &[Outcome]) -> Result<(), Error> {
        let asked = self.roles.len();
        if !self.waiting {
            return Err(Error::TellWithoutAsk);
        }
        if outcomes.len() > asked {
            return Err(Error::TooManyOutcomes { asked, told: outcomes.len() });
        }
        self.waiting = false;
        self.n_batches += 1;
        self.n_points += asked as u64;
        self.used.clear();
        self.used.resize(asked, false);
        for point in &mut self.trials {
            point.consulted = false;
        }
        for (k, outcome) in outcomes.iter().enumerate() {
            let Ok(cost) = cost_of(outcome) else { continue };
            match self.roles[k] {
                Role::Vertex(slot) => {
                    self.simplex.set_cost(slot, cost.map_or(Cost::Failed, Cost::Value));
                    self.used[k] = true;
                }
                Role::Trial(trial) => {
                    self.trials[trial as usize].seen = cost.map_or(Seen::Rejected, Seen::Cost);
                }
            }
        }
        match self.phase {
            Phase::Done => {}
            Phase::Starting | Phase::Shrinking => {
                if !self.simplex.is_pending() {
                    self.vertices_known();
                }
            }
            Phase::Trying(_) => {
                let decision = self.decide();
                for (k, role) in self.roles.iter().enumerate() {
                    if let Role::Trial(trial) = *role {
                        let point = &self.trials[trial as usize];
                        self.used[k] = point.consulted && point.seen != Seen::Unknown;
                    }
                }
                match decision {
                    // Nothing was decided: what was seen ahead is asked again together with the reflection.
                    Err(Trial::Reflection) => self.begin_iteration(),
                    Err(needed) => self.phase = Phase::Trying(needed),
                    Ok(Operation::Shrink) => self.phase = Phase::Shrinking,
                    Ok(operation) => self.end_iteration(operation),
                }
            }
        }
        Ok(())
    }

    fn used(&self) -> &[bool] {
        &self.used
    }

    fn status(&self) -> Status {
        match (&self.ended, self.phase) {
            (Some(termination), _) => Status::Ended(termination.clone()),
            (None, Phase::Done) => Status::NoStart,
            (None, _) => Status::Running,
        }
    }

    fn n_iterations(&self) -> usize {
        self.n_iterations
    }

    fn operation(&self) -> Option<Operation> {
        self.operation
    }

    fn plan(&self) -> &'static str {
        self.plan.name()
    }

    fn tests(&self) -> Option<Tests> {
        self.tests
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        // While starting vertices are missing they are not ranked yet.
        let mut best: Option<(&[f64], f64)> = None;
        for &slot in self.simplex.order() {
            if let Cost::Value(v) = self.simplex.cost(slot)
                && best.is_none_or(|(_, b)| v < b)
            {
                best = Some((self.simplex.x(slot), v));
            }
        }
        // A reflection that waits for its expansion is not a vertex yet, but it has been seen and counts.
        let reflection = &self.trials[Trial::Reflection as usize];
        match (self.phase, reflection.seen) {
            (Phase::Trying(_), Seen::Cost(r)) if best.is_none_or(|(_, b)| r < b) => Some((&reflection.x, r)),
            _ => best,
        }
    }

    fn simplex(&self) -> Option<SimplexView<'_>> {
        Some(self.simplex.view())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounds::Bounds;
    use crate::method::MethodOptions;
    use crate::nelder_mead::NelderMead;

    /// The reflection that a given simplex (best, second, worst) in the unit square leads to.
    fn reflection(vertices: [[f64; 2]; 3]) -> Vec<f64> {
        let space = Space::new(&vertices[0], Bounds::new(&[0.0; 2], &[1.0; 2]).unwrap(), &[], &[]).unwrap();
        let options = NelderMead::default().initial_simplex(vertices.iter().map(|v| v.to_vec()).collect());
        let mut search = options.begin(&Setup::new(space)).unwrap();
        let mut batch = Batch::new();
        search.ask(&mut batch);
        search.tell(&[0.0, 1.0, 2.0].map(Outcome::Value)).unwrap();
        search.ask(&mut batch);
        batch.point(0).to_vec()
    }

    #[test]
    fn mirroring_never_makes_the_simplex_flat() {
        // Unbounded (-0.25, 0.375): mirrored onto the line through the other two, so it goes onto the bound.
        assert_eq!(reflection([[0.25, 0.25], [0.25, 0.5], [0.75, 0.375]]), [0.0, 0.375]);
        // Unbounded (-0.25, 0.25): mirrored onto the best vertex.
        assert_eq!(reflection([[0.25, 0.25], [0.375, 0.5], [0.875, 0.5]]), [0.0, 0.25]);
        // An ordinary mirror image stays one.
        assert_eq!(reflection([[0.25, 0.25], [0.25, 0.5], [0.625, 0.375]]), [0.125, 0.375]);
    }
}
