//! Ask/tell interface of the methods. A method proposes a batch of points and receives their outcomes in
//! request order. It never calls the objective.

use crate::error::Error;
use crate::method_interface::cost::Cost;
use crate::method_interface::linear_model::LinearModel;
use crate::method_interface::tolerances::{ToleranceTests, Tolerances};
use crate::outcome::answer::{Answer, Answers, EvaluationKind};
use crate::outcome::pareto_front::ParetoFront;
use crate::outcome::termination::Termination;
use crate::problem::constraints::{ActiveConstraint, Constraints};
use crate::problem::loss::RobustLoss;
use crate::problem::objective::Query;
use crate::problem::space::Space;
use crate::values::choices::{ParameterKind, Search};
use crate::values::encoding::{decode, encode};
use base::RunContext;
use serde::de::{DeserializeOwned, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;

/// Points that a method requests next, with their ids, cutoffs and the kind of values requested. Reuse one
/// batch for a whole run: after the first rounds, `ask` allocates nothing.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Batch {
    #[serde(rename = "want")]
    kind: EvaluationKind,
    n: usize,
    index: u64,
    first_id: u64,
    points: Vec<f64>,
    cutoffs: Vec<f64>,
    ids: Vec<u64>,
    /// Number of leading points that the path will reach.
    #[serde(skip)]
    n_certain: usize,
}

/// Upper limit of the numbers of points, batches and iterations that a run can count. The sum of two such
/// numbers does not overflow.
const MOST_COUNTED: u64 = 1 << 60;

impl Batch {
    /// Creates an empty batch.
    pub fn new() -> Self {
        Self::default()
    }

    /// Empties the batch, sets its numbers and requests costs; for methods. `n` is the length of the points.
    pub fn start(&mut self, n: usize, index: u64, first_id: u64) {
        self.kind = EvaluationKind::Cost;
        self.n = n;
        self.index = index;
        self.first_id = first_id;
        self.points.clear();
        self.cutoffs.clear();
        self.ids.clear();
        self.n_certain = 0;
    }

    /// Marks all points so far as certain; for methods that look ahead. The path will reach certain points
    /// unless the run ends first.
    pub fn all_certain(&mut self) {
        self.n_certain = self.len();
    }

    /// Returns the number of speculative points that the path will reach.
    pub(crate) fn n_certain(&self) -> usize {
        self.n_certain
    }

    /// Sets the kind of values requested for all points; for methods. With residuals there are no cutoffs.
    pub fn set_kind(&mut self, kind: EvaluationKind) {
        self.kind = kind;
    }

    /// Returns the kind of values requested for all points.
    pub fn kind(&self) -> EvaluationKind {
        self.kind
    }

    /// Adds a point (user's units) with its cutoff (`f64::INFINITY` for none); for methods.
    pub fn push(&mut self, x: &[f64], cutoff: f64) {
        debug_assert_eq!(x.len(), self.n, "a batch holds points of one length");
        self.push_with_id(x, cutoff, self.first_id + self.cutoffs.len() as u64);
    }

    /// Adds a point with an explicit id.
    pub(crate) fn push_with_id(&mut self, x: &[f64], cutoff: f64, id: u64) {
        self.points.extend_from_slice(x);
        self.cutoffs.push(cutoff);
        self.ids.push(id);
    }

    /// Renumbers the points; for a method that wraps another method.
    pub(crate) fn renumber(&mut self, index: u64, first_id: u64) {
        (self.index, self.first_id) = (index, first_id + self.first_id);
        self.ids.iter_mut().for_each(|id| *id += first_id);
    }

    /// True if its lists are consistent with each other and with points of length `n`. A batch read from a
    /// file may be inconsistent.
    pub(crate) fn is_sound(&self, n: usize) -> bool {
        let len = self.cutoffs.len();
        (len == 0 || self.n == n)
            && self.points.len() == len * self.n
            && self.ids.len() == len
            && [self.index, self.first_id].iter().chain(&self.ids).all(|number| *number <= MOST_COUNTED)
    }

    /// Returns the index of the point with this id. Ids ascend.
    pub(crate) fn place_of(&self, id: u64) -> Option<usize> {
        self.ids.binary_search(&id).ok()
    }

    /// Removes all cutoffs.
    pub(crate) fn remove_cutoffs(&mut self) {
        self.cutoffs.iter_mut().for_each(|cutoff| *cutoff = f64::INFINITY);
    }

    /// Replaces the cutoff of point `k`; for a method that wraps another method.
    pub(crate) fn set_cutoff(&mut self, k: usize, cutoff: f64) {
        self.cutoffs[k] = cutoff;
    }

    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.cutoffs.len()
    }

    /// True if there is nothing to evaluate because the method has ended.
    pub fn is_empty(&self) -> bool {
        self.cutoffs.is_empty()
    }

    /// Returns the length of each point.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Returns the index of the batch, counted over the run.
    pub fn index(&self) -> u64 {
        self.index
    }

    /// Returns the id of point `k`, counted over the run.
    pub fn id(&self, k: usize) -> u64 {
        self.ids[k]
    }

    /// Returns point `k` in the user's units.
    pub fn point(&self, k: usize) -> &[f64] {
        &self.points[k * self.n..(k + 1) * self.n]
    }

    /// Returns the cutoff of point `k`; infinite if there is none.
    pub fn cutoff(&self, k: usize) -> f64 {
        self.cutoffs[k]
    }

    /// Returns all points, one after the other.
    pub fn as_flat(&self) -> &[f64] {
        &self.points
    }

    /// Returns the points in request order.
    pub fn points(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        (0..self.len()).map(|k| self.point(k))
    }

    /// Returns the query to the objective for point `k`.
    pub fn query(&self, k: usize) -> Query<'static> {
        let cutoff = if self.kind == EvaluationKind::Residuals { f64::INFINITY } else { self.cutoffs[k] };
        Query::new(self.id(k), self.index, cutoff).kind(self.kind)
    }
}

/// Number of points that a run evaluates at once when the path of its method needs fewer. The additional
/// points come from [`Method::speculate`]. The path does not depend on this option. Users write a name or a
/// number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub enum Lookahead {
    /// `serial`: only the points that the path needs, without any surplus evaluation.
    #[default]
    #[serde(rename = "serial")]
    None,
    /// `ahead`: as many as there are workers, however short an evaluation is.
    #[serde(rename = "ahead")]
    Workers,
    /// `auto`: the number, up to the number of workers, with which the path advances fastest. It is measured
    /// during the run. It is one if evaluations are too short to be worth a transfer.
    #[serde(rename = "auto")]
    Measured,
    /// Up to this number, whatever the evaluations cost.
    #[serde(untagged)]
    Points(usize),
}

impl Lookahead {
    /// Returns the name of the variant, `points` for a number.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "serial",
            Self::Workers => "ahead",
            Self::Measured => "auto",
            Self::Points(_) => "points",
        }
    }

    /// Checks the number of points.
    ///
    /// # Errors
    /// Returns an error if the number of points is zero.
    pub(crate) fn check(self) -> Result<(), Error> {
        match self {
            Self::Points(0) => Err(Error::Option { name: "batch", value: 0.0, range: "at least 1" }),
            _ => Ok(()),
        }
    }
}

impl<'de> Deserialize<'de> for Lookahead {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        const NAMES: [(&str, Lookahead); 3] =
            [("auto", Lookahead::Measured), ("serial", Lookahead::None), ("ahead", Lookahead::Workers)];
        let expected = "an integer, 'auto', 'serial' or 'ahead'";
        name_or_number(deserializer, expected, &NAMES, Lookahead::Points)
    }
}

/// Reads one of the given names, or a number. An untagged enum variant would not report what is `expected`.
pub(crate) fn name_or_number<'de, D: Deserializer<'de>, T: Copy>(
    deserializer: D,
    expected: &'static str,
    names: &[(&str, T)],
    of_number: fn(usize) -> T,
) -> Result<T, D::Error> {
    struct NameOrNumber<'a, T>(&'static str, &'a [(&'a str, T)], fn(usize) -> T);
    impl<T: Copy> Visitor<'_> for NameOrNumber<'_, T> {
        type Value = T;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str(self.0)
        }

        fn visit_u64<E: serde::de::Error>(self, number: u64) -> Result<T, E> {
            usize::try_from(number).map(self.2).map_err(E::custom)
        }

        fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<T, E> {
            let listed = self.1.iter().find(|(listed, _)| listed.eq_ignore_ascii_case(name));
            listed.map(|(_, value)| *value).ok_or_else(|| E::invalid_value(Unexpected::Str(name), &self))
        }
    }
    deserializer.deserialize_any(NameOrNumber(expected, names, of_number))
}

/// Operation of one iteration of a method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Operation {
    /// The starting points were evaluated.
    Initial,
    /// The reflected point was accepted.
    Reflection,
    /// The expanded point was accepted.
    Expansion,
    /// The outside contraction was accepted.
    OutsideContraction,
    /// The inside contraction was accepted.
    InsideContraction,
    /// The simplex was shrunk towards its best vertex.
    Shrink,
    /// A new simplex was built around the best vertex of a simplex that had become flat.
    Restart,
    /// A generation was evaluated and selection was applied.
    Generation,
    /// The minimum of a model within its trust region was evaluated.
    TrustRegionStep,
    /// Local searches from several starts advanced by one step each.
    LocalSearches,
    /// A poll found a better point.
    Poll,
    /// No point of a poll was better, and the frame was shrunk.
    Refinement,
}

impl fmt::Display for Operation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Initial => "initial",
            Self::Reflection => "reflection",
            Self::Expansion => "expansion",
            Self::OutsideContraction => "outside contraction",
            Self::InsideContraction => "inside contraction",
            Self::Shrink => "shrink",
            Self::Restart => "restart",
            Self::Generation => "generation",
            Self::TrustRegionStep => "trust region step",
            Self::LocalSearches => "local searches",
            Self::Poll => "poll",
            Self::Refinement => "refinement",
        })
    }
}

/// State of the progress of a method.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Status {
    /// The method requests more evaluations.
    Running,
    /// The method ended by itself.
    Ended(Termination),
    /// Every starting point failed, so the method cannot continue.
    NoStart,
}

/// Problem, tolerances and seed that a method starts with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// Start point, box and scales.
    pub space: Space,
    /// Tolerances of the tests that end the method.
    pub tolerances: Tolerances,
    /// Seed of the random numbers. If `None`, a method that needs a seed draws one and reports it
    /// ([`MethodDetails::seed`]).
    pub seed: Option<u64>,
    /// Limit of evaluations, for methods that plan ahead with it.
    pub max_evaluations: Option<usize>,
    /// True if the user gave the start point. Otherwise, it is only the middle of the box.
    pub start_given: bool,
    /// Points of an earlier run, best first; all are in the box.
    pub prior: Vec<Vec<f64>>,
    /// Loss that has already been applied to the residuals.
    #[serde(default, skip_serializing_if = "RobustLoss::is_linear")]
    pub loss: RobustLoss,
    /// Nonlinear constraints. Linear ones are part of the space.
    #[serde(default, skip_serializing_if = "Constraints::is_empty")]
    pub constraints: Constraints,
    /// Number of evaluations that may run at once, for methods whose batch plan depends on it.
    #[serde(skip)]
    pub workers: usize,
}

impl Setup {
    /// Creates a setup with default tolerances.
    pub fn new(space: Space) -> Self {
        Self {
            space,
            tolerances: Tolerances::default(),
            seed: None,
            max_evaluations: None,
            start_given: true,
            prior: Vec::new(),
            loss: RobustLoss::default(),
            constraints: Constraints::default(),
            workers: 1,
        }
    }
}

/// Properties of a problem that determine the choice of its method.
#[derive(Debug, Clone, Copy)]
pub struct ProblemClass<'a> {
    /// Lower bounds; infinite if there is none.
    pub lower: &'a [f64],
    /// Upper bounds. If an upper bound equals the lower bound, the parameter is fixed.
    pub upper: &'a [f64],
    /// Kinds of the parameters; all are continuous if empty.
    pub kinds: &'a [ParameterKind],
    /// True if the objective returns residuals.
    pub residuals: bool,
    /// Goal of the search.
    pub search: Search,
    /// True if there are linear constraints.
    pub linear: bool,
    /// True if there are nonlinear constraints.
    pub nonlinear: bool,
    /// True if there are nonlinear equalities.
    pub equalities: bool,
}

impl ProblemClass<'_> {
    /// Returns the index of the first free parameter without a finite range.
    pub(crate) fn open(&self) -> Option<usize> {
        let width = |i: usize| self.upper[i] - self.lower[i];
        (0..self.lower.len()).find(|&i| self.lower[i] != self.upper[i] && !width(i).is_finite())
    }
}

/// Options of a method, which create the [`Method`] for a problem.
pub trait MethodOptions {
    /// The method that these options describe.
    type Method: Method + Send + 'static;

    /// Checks the options against the problem and starts the method.
    ///
    /// # Errors
    /// Returns an error with index and value if an option does not fit the problem.
    fn begin(&self, setup: &Setup) -> Result<Self::Method, Error>;

    /// Continues from a state that [`Method::save`] returned.
    ///
    /// # Errors
    /// Returns an error if the state is damaged or belongs to another method or problem, or if the method
    /// cannot be continued.
    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<Self::Method, Error> {
        let _ = (setup, state);
        Err(Error::State { message: "this method does not support checkpoints".to_owned() })
    }

    /// Returns the method for a problem of this class and the reason for the choice, if these options leave
    /// the choice open.
    ///
    /// # Errors
    /// Returns an error if no method supports the requested search.
    fn chosen(&self, class: &ProblemClass<'_>) -> Result<Option<(Self, String)>, Error>
    where
        Self: Sized,
    {
        let _ = class;
        Ok(None)
    }

    /// True if the method keeps linear constraints at all points that it requests.
    fn supports_linear(&self) -> bool {
        false
    }

    /// True if the method searches for points that satisfy nonlinear constraints.
    fn supports_nonlinear(&self) -> bool {
        false
    }

    /// True if the method also finds points that satisfy nonlinear equalities of continuous parameters.
    fn supports_equalities(&self) -> bool {
        self.supports_nonlinear()
    }

    /// True if the method requires a start point. Other methods use the middle of the box if no start point
    /// is given.
    fn needs_start(&self) -> bool {
        true
    }

    /// True if the method requests residuals, so that the objective must return them.
    fn needs_residuals(&self) -> bool {
        false
    }

    /// True if the start point must be strictly inside the bounds.
    fn starts_inside(&self) -> bool {
        false
    }

    /// Returns the options and their values as text. A checkpoint with other options is then recognised, and
    /// the error can name the difference.
    fn describe(&self) -> Vec<(String, String)> {
        Vec::new()
    }

    /// True if the path depends on the limit of evaluations.
    fn plans_with_budget(&self) -> bool {
        false
    }

    /// Returns the default limits of evaluations and iterations for `n` free parameters, for users who set no
    /// limit.
    fn default_limits(&self, n: usize) -> (Option<usize>, Option<usize>) {
        (Some(5000usize.saturating_mul(n + 1)), Some(1000usize.saturating_mul(n + 1)))
    }

    /// Returns the default number of evaluations to remember, so that exact repeats cost nothing. 0 for
    /// methods that rarely repeat points.
    fn default_cache(&self) -> usize {
        0
    }
}

/// Known answers while the points that a method requested are being evaluated.
pub trait AnswersSoFar {
    /// True if the point does not need an evaluation.
    fn contains(&self, x: &[f64]) -> bool;

    /// Returns the answer to point `k` of the last batch, if it is available.
    fn answer(&self, k: usize) -> Option<&Answer>;

    /// Returns the answer to this query at a point evaluated speculatively.
    fn ahead(&self, x: &[f64], query: &Query<'_>) -> Option<Answer>;
}

/// An optimisation method as a state machine without input or output.
///
/// [`ask`](Self::ask) and [`tell`](Self::tell) alternate until `ask` leaves the batch empty.
pub trait Method {
    /// Returns the name of the method, as users write it.
    fn name(&self) -> &'static str;

    /// Fills `batch` with the points that the path needs next. Leaves it empty when the method has ended. A
    /// second `ask` without `tell` returns the same batch.
    fn ask(&mut self, batch: &mut Batch);

    /// Like [`ask`](Self::ask), for methods whose own computations may take long. If the context has ended,
    /// the batch is left empty although the method has not ended, and `ask` can be called again.
    fn ask_unless(&mut self, context: &RunContext<'_>, batch: &mut Batch) {
        let _ = context;
        self.ask(batch);
    }

    /// Adds points that the path may need after the points just requested. Their cutoffs must be at least as
    /// high as on the path. First come the points that the path will reach unless the run ends
    /// ([`Batch::all_certain`]), in its order, including known ones. Other points follow, the most probable
    /// first. Adds at most `wanted` points that are not in `answers_so_far`.
    ///
    /// The outcomes are not passed to the method. They are available when the path requests the points. Must
    /// not change the behaviour of the method.
    fn speculate(&mut self, wanted: usize, answers_so_far: &dyn AnswersSoFar, batch: &mut Batch) {
        let _ = (wanted, answers_so_far, batch);
    }

    /// Receives the answers to the last batch, in request order. Some points have no usable outcome: they
    /// were not evaluated ([`Outcome::Skipped`](crate::Outcome::Skipped), or too few answers), or their
    /// outcome is unknown (see [`Outcome::is_conclusive`](crate::Outcome::is_conclusive)). The method
    /// requests such points again if it needs them.
    ///
    /// # Errors
    /// Returns an error if no batch was requested, or if there are more answers than points.
    fn tell(&mut self, answers: &Answers) -> Result<(), Error>;

    /// Like [`tell`](Self::tell), with answers that are not read afterwards. A method that keeps residuals
    /// takes them ([`Answers::take_residuals`]) instead of copying them, because a copy of many residuals is
    /// slow.
    ///
    /// # Errors
    /// Returns the errors of [`tell`](Self::tell).
    fn tell_last(&mut self, answers: &mut Answers) -> Result<(), Error> {
        self.tell(answers)
    }

    /// Returns the status of the method.
    fn status(&self) -> Status;

    /// Returns the best point known to the method, with its cost.
    fn best(&self) -> Option<(&[f64], f64)>;

    /// Returns the violation of nonlinear constraints at the best point; 0 if it is feasible.
    fn best_violation(&self) -> f64 {
        0.0
    }

    /// Returns details of the progress of the method, including data that only some methods have.
    fn details(&self) -> MethodDetails<'_>;

    /// Returns the derivatives of the residuals at the best point, for methods that have them (see [`Space`]
    /// for its scales). Called once, at the end of a run. Returns `None` if the computation would take long
    /// and the context has ended.
    fn linear_model(&self, context: &RunContext<'_>) -> Option<LinearModel> {
        let _ = context;
        None
    }

    /// Returns the Pareto front so far, for methods with several criteria.
    fn front(&self) -> Option<ParetoFront> {
        None
    }

    /// Returns the whole state, for [`MethodOptions::restore`]. `None` for methods that cannot be continued.
    /// May be called at any time. A state saved between `ask` and `tell` requests the same batch again.
    fn save(&self) -> Option<Vec<u8>> {
        None
    }
}

/// Evidence from a model that the cost is not smooth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Roughness {
    /// The curvature of the model grows as its region shrinks.
    Curvature,
    /// Steps fail at successive resolutions.
    RefusedSteps,
}

impl fmt::Display for Roughness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Curvature => {
                "the cost has kinks or noise (the curvature of the model grows as its region shrinks)"
            }
            Self::RefusedSteps => {
                "the cost has kinks or noise (steps that the model predicts to lower it do not)"
            }
        })
    }
}

/// Progress of a method in addition to its status and its best point. A method fills in the fields that
/// apply; all others have a default.
#[derive(Debug, Clone, Default)]
pub struct MethodDetails<'a> {
    /// Number of complete iterations.
    pub n_iterations: usize,
    /// Operation of the last complete iteration; `None` before the starting points are known.
    pub operation: Option<Operation>,
    /// Tolerance tests after the last complete iteration.
    pub tests: Option<ToleranceTests>,
    /// True if the tests have passed but the method continues its search. An end at a limit is then a
    /// success.
    pub settled: bool,
    /// Name of the batch plan in use.
    pub plan: &'static str,
    /// Number of speculative points.
    pub lookahead: Lookahead,
    /// Seed in use, for methods that draw random numbers.
    pub seed: Option<u64>,
    /// Evidence of noise or kinks in the model of the cost, for methods that have one.
    pub roughness: Option<Roughness>,
    /// Number of points after which another method took over because of this evidence, and the name of this
    /// method.
    pub handed_over: Option<(u64, &'static str)>,
    /// Indices of parameters that started at zero and have unknown size, because no step of them has changed
    /// the cost.
    pub without_effect: Vec<usize>,
    /// Simplex, for methods that have one.
    pub simplex: Option<SimplexView<'a>>,
    /// Population, for methods that have one. For quadratic models, the interpolation points.
    pub population: Option<SimplexView<'a>>,
    /// Complete stages of a sequential barrier search.
    pub schedule: &'a [BarrierStage],
    /// Minima at which searches from several starts ended, best first.
    pub optima: &'a [Optimum],
    /// Active constraints at the best point with their multipliers, for methods that have them.
    pub multipliers: Vec<ActiveConstraint>,
}

/// A minimum at which local searches ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Optimum {
    /// Point, in the user's units and order.
    pub x: Vec<f64>,
    /// Cost at the point.
    pub cost: f64,
    /// Number of starts whose search ended there.
    pub n_starts: usize,
}

/// One stage of a sequential barrier search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct BarrierStage {
    /// Barrier parameter.
    pub mu: f64,
    /// `B(x)` at the end of the stage.
    pub barrier: f64,
    /// Point at the end of the stage: the best point for `f + mu B`.
    pub x: Vec<f64>,
    /// Value of `f + mu B` at the point.
    pub value: f64,
    /// Number of evaluations of the stage.
    pub n_evaluations: usize,
}

/// Borrowed view of a simplex, best vertex first.
#[derive(Debug, Clone, Copy)]
pub struct SimplexView<'a> {
    pub(crate) n: usize,
    pub(crate) x: &'a [f64],
    pub(crate) costs: &'a [Option<f64>],
    /// Costs by which the points rank.
    pub(crate) ranked: &'a [Cost],
    pub(crate) order: &'a [usize],
}

/// Encodes a state as bytes.
pub(crate) fn saved<S: Serialize>(state: &S) -> Option<Vec<u8>> {
    encode(state).ok()
}

/// True if every counter (`n_...`, `idle`) has a value that a run can reach.
fn counts_are_possible(state: &ciborium::Value) -> bool {
    use ciborium::Value;
    match state {
        Value::Map(fields) => fields.iter().all(|(key, value)| match (key.as_text(), value) {
            (Some(key), Value::Integer(count)) if key.starts_with("n_") || key == "idle" => {
                i128::from(*count) <= i128::from(MOST_COUNTED)
            }
            _ => counts_are_possible(value),
        }),
        Value::Array(items) => items.iter().all(counts_are_possible),
        _ => true,
    }
}

/// Decodes a state from bytes and checks it with `sound`.
pub(crate) fn restored<S: DeserializeOwned>(state: &[u8], sound: impl Fn(&S) -> bool) -> Result<S, Error> {
    let bad = |message| Error::State { message };
    let counts: ciborium::Value = decode(state).map_err(bad)?;
    let state: S = decode(state).map_err(bad)?;
    if counts_are_possible(&counts) && sound(&state) {
        Ok(state)
    } else {
        Err(Error::State { message: "its parts are inconsistent".to_owned() })
    }
}

impl<'a> SimplexView<'a> {
    /// Returns the number of vertices.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// True if there are no vertices.
    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// Returns the vertex with this rank (0 is the best), in the user's units.
    pub fn vertex(&self, rank: usize) -> &'a [f64] {
        let slot = self.order[rank];
        &self.x[slot * self.n..(slot + 1) * self.n]
    }

    /// Returns the cost of the vertex with this rank; `None` if it failed or is not known yet.
    pub fn cost(&self, rank: usize) -> Option<f64> {
        self.costs[self.order[rank]]
    }

    /// Returns the cost by which the vertex of this rank ranks.
    pub(crate) fn rank_cost(&self, rank: usize) -> Cost {
        self.ranked[self.order[rank]]
    }

    /// Returns an owned copy.
    pub fn to_owned(&self) -> Simplex {
        Simplex {
            vertices: (0..self.len()).map(|k| self.vertex(k).to_vec()).collect(),
            costs: (0..self.len()).map(|k| self.cost(k)).collect(),
        }
    }
}

/// A simplex or a population, best first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Simplex {
    /// Vertices in the user's units.
    pub vertices: Vec<Vec<f64>>,
    /// Costs of the vertices; `None` if the objective failed.
    pub costs: Vec<Option<f64>>,
}
