//! Ask / tell: a method proposes a batch of points, is told their outcomes in request order, and never calls
//! the objective.

use crate::error::Error;
use crate::method_interface::linear_model::LinearModel;
use crate::method_interface::tolerances::{ToleranceTests, Tolerances};
use crate::outcome::answer::{Answer, Answers, Want};
use crate::outcome::termination::Termination;
use crate::problem::loss::RobustLoss;
use crate::problem::objective::Query;
use crate::problem::space::Space;
use crate::values::choices::{ParameterKind, Search};
use crate::values::encoding::{decode, encode};
use base::RunContext;
use serde::de::{DeserializeOwned, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;

/// The points that a method wants evaluated next, with their ids and cutoffs, and what it wants to know of
/// them. Reuse one over a whole run: after the first rounds asking allocates nothing.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Batch {
    want: Want,
    n: usize,
    index: u64,
    first_id: u64,
    points: Vec<f64>,
    cutoffs: Vec<f64>,
    ids: Vec<u64>,
    /// So many of the first points the path will come to.
    #[serde(skip)]
    n_certain: usize,
}

/// No run counts more points, batches or iterations: to add two such numbers is no overflow.
const MOST_COUNTED: u64 = 1 << 60;

impl Batch {
    /// An empty batch.
    pub fn new() -> Self {
        Self::default()
    }

    /// For methods: empties the batch and gives it its numbers; costs are wanted. `n` is the length of the
    /// points.
    pub fn start(&mut self, n: usize, index: u64, first_id: u64) {
        self.want = Want::Cost;
        self.n = n;
        self.index = index;
        self.first_id = first_id;
        self.points.clear();
        self.cutoffs.clear();
        self.ids.clear();
        self.n_certain = 0;
    }

    /// For methods that look ahead: the path will come to all points so far, unless the run ends before.
    pub fn all_certain(&mut self) {
        self.n_certain = self.len();
    }

    /// Of the points ahead of need, the number of those that the path will come to.
    pub(crate) fn n_certain(&self) -> usize {
        self.n_certain
    }

    /// For methods: says what is wanted of all points. With residuals there are no cutoffs.
    pub fn set_want(&mut self, want: Want) {
        self.want = want;
    }

    /// Kind of values that is requested of all points.
    pub fn want(&self) -> Want {
        self.want
    }

    /// For methods: adds a point (user's units) with its cutoff (`f64::INFINITY` for none).
    pub fn push(&mut self, x: &[f64], cutoff: f64) {
        debug_assert_eq!(x.len(), self.n, "a batch holds points of one length");
        self.push_with_id(x, cutoff, self.first_id + self.cutoffs.len() as u64);
    }

    /// The same with a number of its own.
    pub(crate) fn push_with_id(&mut self, x: &[f64], cutoff: f64, id: u64) {
        self.points.extend_from_slice(x);
        self.cutoffs.push(cutoff);
        self.ids.push(id);
    }

    /// For a method that wraps another: other numbers for the same points.
    pub(crate) fn renumber(&mut self, index: u64, first_id: u64) {
        (self.index, self.first_id) = (index, first_id + self.first_id);
        self.ids.iter_mut().for_each(|id| *id += first_id);
    }

    /// True if its lists fit together and to points of this length: what comes from a file may not.
    pub(crate) fn is_sound(&self, n: usize) -> bool {
        let len = self.cutoffs.len();
        (len == 0 || self.n == n)
            && self.points.len() == len * self.n
            && self.ids.len() == len
            && [self.index, self.first_id].iter().chain(&self.ids).all(|number| *number <= MOST_COUNTED)
    }

    /// The place of a point by its number; numbers ascend.
    pub(crate) fn place_of(&self, id: u64) -> Option<usize> {
        self.ids.binary_search(&id).ok()
    }

    /// For a method that wraps another: another cutoff for a point.
    pub(crate) fn set_cutoff(&mut self, k: usize, cutoff: f64) {
        self.cutoffs[k] = cutoff;
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.cutoffs.len()
    }

    /// True if there is nothing to evaluate: the method has ended.
    pub fn is_empty(&self) -> bool {
        self.cutoffs.is_empty()
    }

    /// Length of each point.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Running number of the batch.
    pub fn index(&self) -> u64 {
        self.index
    }

    /// Running number of point `k`.
    pub fn id(&self, k: usize) -> u64 {
        self.ids[k]
    }

    /// Point `k` in the user's units.
    pub fn point(&self, k: usize) -> &[f64] {
        &self.points[k * self.n..(k + 1) * self.n]
    }

    /// Cutoff of point `k`; infinite if there is none.
    pub fn cutoff(&self, k: usize) -> f64 {
        self.cutoffs[k]
    }

    /// All points, one after the other.
    pub fn as_flat(&self) -> &[f64] {
        &self.points
    }

    /// The points in request order.
    pub fn points(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        (0..self.len()).map(|k| self.point(k))
    }

    /// Query to the objective for point `k`.
    pub fn query(&self, k: usize) -> Query<'static> {
        let cutoff = if self.want == Want::Residuals { f64::INFINITY } else { self.cutoffs[k] };
        Query::new(self.id(k), self.index, cutoff).want(self.want)
    }
}

/// Number of points that a run evaluates at once where the path of its method needs fewer; the others are
/// those of [`Method::speculate`]. The path is the same in any case. Users write a name or a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub enum Lookahead {
    /// `serial`: the points that the path needs, never an evaluation too many.
    #[default]
    #[serde(rename = "serial")]
    None,
    /// `ahead`: as many as there are workers, however short an evaluation is.
    #[serde(rename = "ahead")]
    Workers,
    /// `auto`: at most as many as there are workers: so many that the path advances fastest. That is measured
    /// while the run goes on; where evaluations are too short to be handed over, it is one.
    #[serde(rename = "auto")]
    Measured,
    /// Up to so many, whatever they cost.
    #[serde(untagged)]
    Points(usize),
}

impl Lookahead {
    /// Its name; a number has none of its own.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "serial",
            Self::Workers => "ahead",
            Self::Measured => "auto",
            Self::Points(_) => "points",
        }
    }

    /// # Errors
    /// It would be no point at all.
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
        let expected = "a whole number, 'auto', 'serial' or 'ahead'";
        name_or_number(deserializer, expected, &NAMES, Lookahead::Points)
    }
}

/// Reads one of some names, or a number; an untagged variant of an enum would not say what is `expected`.
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
            let known = self.1.iter().find(|(known, _)| known.eq_ignore_ascii_case(name));
            known.map(|(_, value)| *value).ok_or_else(|| E::invalid_value(Unexpected::Str(name), &self))
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
    /// A new simplex was built around the best vertex of one that had become flat.
    Restart,
    /// A generation was evaluated and selected from.
    Generation,
    /// The best point of a model within its trust region was tried.
    TrustRegionStep,
    /// Local searches from several starts advanced by a step each.
    LocalSearches,
    /// A poll found a better point.
    Poll,
    /// No point of a poll was better: the frame has shrunk.
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

/// Where a method stands.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Status {
    /// It has more to ask.
    Running,
    /// It came to its own end.
    Ended(Termination),
    /// Every starting point failed: there is nothing to go on from.
    NoStart,
}

/// Problem, tolerances and seed that a method starts with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// Start point, box, scales.
    pub space: Space,
    /// When to stop.
    pub tolerances: Tolerances,
    /// Seed of what is random; `None`: a method that needs one draws it and says it
    /// ([`MethodDetails::seed`]).
    pub seed: Option<u64>,
    /// The budget, for methods that plan ahead with it.
    pub max_evaluations: Option<usize>,
    /// True if the start point of the space is the user's; else it is only the middle of the box.
    pub start_given: bool,
    /// Points of an earlier run, best first; all lie in the box.
    pub prior: Vec<Vec<f64>>,
    /// Loss that the residuals have gone through already.
    #[serde(default, skip_serializing_if = "RobustLoss::is_linear")]
    pub loss: RobustLoss,
}

impl Setup {
    /// Default tolerances.
    pub fn new(space: Space) -> Self {
        Self {
            space,
            tolerances: Tolerances::default(),
            seed: None,
            max_evaluations: None,
            start_given: true,
            prior: Vec::new(),
            loss: RobustLoss::default(),
        }
    }
}

/// Properties of a problem from which a method is chosen for it.
#[derive(Debug, Clone, Copy)]
pub struct ProblemClass<'a> {
    /// Lower bounds; infinite where there is none.
    pub lower: &'a [f64],
    /// Upper bounds; where they equal the lower ones, the parameter is fixed.
    pub upper: &'a [f64],
    /// Kinds of the parameters; empty: all continuous.
    pub kinds: &'a [ParameterKind],
    /// True if the objective gives residuals.
    pub residuals: bool,
    /// Goal of the search.
    pub search: Search,
}

impl ProblemClass<'_> {
    /// The first free parameter without a finite range.
    pub(crate) fn open(&self) -> Option<usize> {
        let width = |i: usize| self.upper[i] - self.lower[i];
        (0..self.lower.len()).find(|&i| self.lower[i] != self.upper[i] && !width(i).is_finite())
    }
}

/// The options of a method: what makes the [`Method`] once the problem is known.
pub trait MethodOptions {
    /// The method that these options describe.
    type Method: Method;

    /// Checks the options against the problem and starts.
    ///
    /// # Errors
    /// Options that do not fit, with index and value.
    fn begin(&self, setup: &Setup) -> Result<Self::Method, Error>;

    /// Continues from a state that [`Method::save`] gave.
    ///
    /// # Errors
    /// A state of another method or another problem, or one that was damaged; a method that cannot be
    /// continued.
    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<Self::Method, Error> {
        let _ = (setup, state);
        Err(Error::State { message: "this method cannot be continued".to_owned() })
    }

    /// The method for a problem of this class and the reason, where these options leave the choice open.
    ///
    /// # Errors
    /// There is none for the search that is asked for.
    fn chosen(&self, class: &ProblemClass<'_>) -> Result<Option<(Self, String)>, Error>
    where
        Self: Sized,
    {
        let _ = class;
        Ok(None)
    }

    /// True if the method needs a start point; one that does not takes the middle of the box where none is
    /// given.
    fn needs_start(&self) -> bool {
        true
    }

    /// True if the method requests residuals: then the objective must have them.
    fn needs_residuals(&self) -> bool {
        false
    }

    /// True if a start must lie strictly inside of the bounds.
    fn starts_inside(&self) -> bool {
        false
    }

    /// The options and their values in words, so that a checkpoint of other options is recognised, and the
    /// one that differs can be named.
    fn describe(&self) -> Vec<(String, String)> {
        Vec::new()
    }

    /// True if the path depends on the limit of evaluations.
    fn plans_with_budget(&self) -> bool {
        false
    }

    /// Limits for users who set none: evaluations and iterations for `n` free parameters.
    fn default_limits(&self, n: usize) -> (Option<usize>, Option<usize>) {
        (Some(5000usize.saturating_mul(n + 1)), Some(1000usize.saturating_mul(n + 1)))
    }

    /// Number of evaluations to remember by default, so that exact repeats cost nothing; 0 for methods that
    /// repeat themselves rarely.
    fn default_cache(&self) -> usize {
        0
    }
}

/// What is known while the points that a method asked for are under way.
pub trait AnswersSoFar {
    /// Whether a point needs no evaluation any more.
    fn contains(&self, x: &[f64]) -> bool;

    /// The answer to point `k` of the batch last asked, once it has come.
    fn answer(&self, k: usize) -> Option<&Answer>;

    /// The answer to this query at a point that was evaluated ahead of need.
    fn ahead(&self, x: &[f64], query: &Query<'_>) -> Option<Answer>;
}

/// A method of optimisation as a state machine without input or output.
///
/// [`ask`](Self::ask) and [`tell`](Self::tell) alternate until `ask` leaves the batch empty.
pub trait Method {
    /// Name, as users write it.
    fn name(&self) -> &'static str;

    /// Fills `batch` with the points that the path needs next; leaves it empty when the method has ended.
    /// Asking twice without telling gives the same batch.
    fn ask(&mut self, batch: &mut Batch);

    /// The same for methods whose own computations may take long: where the context is over, the batch is
    /// left empty although the method has not ended, and it can be asked again.
    fn ask_unless(&mut self, context: &RunContext<'_>, batch: &mut Batch) {
        let _ = context;
        self.ask(batch);
    }

    /// Adds points that the path may need after those just asked for, with cutoffs that are at least those of
    /// the path: first those that it will come to unless the run ends before ([`Batch::all_certain`]), in its
    /// order, also those that are known, then others, the most probable first; up to `wanted` that are not
    /// `known`. What becomes of them is not told: it is at hand when the path asks for them. Must not change
    /// what the method does.
    fn speculate(&mut self, wanted: usize, known: &dyn AnswersSoFar, batch: &mut Batch) {
        let _ = (wanted, known, batch);
    }

    /// Takes the answers to the batch last asked, in request order. Points that were not evaluated
    /// ([`Outcome::Skipped`](crate::Outcome::Skipped), or too few answers) and outcomes that say nothing
    /// (see [`Outcome::is_known`](crate::Outcome::is_known)) are asked again where they are needed.
    ///
    /// # Errors
    /// Nothing was asked, or there are more answers than points.
    fn tell(&mut self, answers: &Answers) -> Result<(), Error>;

    /// As [`tell`](Self::tell), with answers that nobody reads any more: a method that keeps residuals takes
    /// them ([`Answers::take_residuals`]) instead of a copy, which would take a while where there are many.
    ///
    /// # Errors
    /// As [`tell`](Self::tell).
    fn tell_last(&mut self, answers: &mut Answers) -> Result<(), Error> {
        self.tell(answers)
    }

    /// Where the method stands.
    fn status(&self) -> Status;

    /// The best point and its cost, as the method sees it.
    fn best(&self) -> Option<(&[f64], f64)>;

    /// Where the method stands in detail, and what only some methods have.
    fn details(&self) -> MethodDetails<'_>;

    /// The derivatives of the residuals at the best point, for methods that have them (see [`Space`] for its
    /// scales). Called once, at the end of a run. `None` where it would take long and the context is over.
    fn linear_model(&self, context: &RunContext<'_>) -> Option<LinearModel> {
        let _ = context;
        None
    }

    /// The whole state, for [`MethodOptions::restore`]; `None` for methods that cannot be continued. May be
    /// called at any time; a state saved between ask and tell asks for the same batch again.
    fn save(&self) -> Option<Vec<u8>> {
        None
    }
}

/// Evidence in a model that the cost is not smooth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Roughness {
    /// The curvature of the model grows as its region shrinks.
    Curvature,
    /// Steps fail at one resolution after the other.
    RefusedSteps,
}

impl fmt::Display for Roughness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Curvature => {
                "the cost has kinks or noise (the curvature of the model grows as its region shrinks)"
            }
            Self::RefusedSteps => {
                "the cost has kinks or noise (steps that the model takes for good do not lower it)"
            }
        })
    }
}

/// Where a method stands, besides its status and its best point. A method gives what it has; all else has a
/// default.
#[derive(Debug, Clone, Default)]
pub struct MethodDetails<'a> {
    /// Number of complete iterations.
    pub n_iterations: usize,
    /// Operation of the last complete iteration; `None` before the starting points are known.
    pub operation: Option<Operation>,
    /// The tolerance tests after the last complete iteration.
    pub tests: Option<ToleranceTests>,
    /// True if these have passed, and the method goes on all the same for what may lie beside: an end by a
    /// limit is a success.
    pub settled: bool,
    /// The batch plan in use.
    pub plan: &'static str,
    /// Number of points to evaluate ahead of need.
    pub lookahead: Lookahead,
    /// The seed in use, for methods that draw random numbers.
    pub seed: Option<u64>,
    /// Evidence of noise or kinks in the model of the cost, for methods that have one.
    pub roughness: Option<Roughness>,
    /// The number of points after which another method took over because of that.
    pub handed_over: Option<u64>,
    /// Parameters that started at zero, and whose size no step could tell because none has changed the cost,
    /// by index.
    pub without_effect: Vec<usize>,
    /// The simplex, for methods that have one.
    pub simplex: Option<SimplexView<'a>>,
    /// The population, for methods that have one; of quadratic models the interpolation points.
    pub population: Option<SimplexView<'a>>,
    /// The stages of a sequential barrier search, complete ones only.
    pub schedule: &'a [BarrierStage],
    /// The minima that searches from several starts ended at, the best first.
    pub optima: &'a [Optimum],
}

/// A minimum that local searches ended at.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Optimum {
    /// The point, in the user's units and order.
    pub x: Vec<f64>,
    /// Its cost.
    pub cost: f64,
    /// Number of starts whose search ended there.
    pub n_starts: usize,
}

/// One stage of a sequential barrier search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct BarrierStage {
    /// The barrier parameter.
    pub mu: f64,
    /// `B(x)` at the end of the stage.
    pub barrier: f64,
    /// The point at the end of the stage: the best for `f + mu B`.
    pub x: Vec<f64>,
    /// Its `f + mu B`.
    pub value: f64,
    /// Evaluations of the stage.
    pub n_evaluations: usize,
}

/// A simplex as it stands, best vertex first.
#[derive(Debug, Clone, Copy)]
pub struct SimplexView<'a> {
    pub(crate) n: usize,
    pub(crate) x: &'a [f64],
    pub(crate) costs: &'a [Option<f64>],
    pub(crate) order: &'a [usize],
}

/// A state as bytes.
pub(crate) fn saved<S: Serialize>(state: &S) -> Option<Vec<u8>> {
    encode(state).ok()
}

/// True if no field that counts (`n_...`, `idle`) has a number that no run comes to.
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

/// A state from bytes, if it is `sound`.
pub(crate) fn restored<S: DeserializeOwned>(state: &[u8], sound: impl Fn(&S) -> bool) -> Result<S, Error> {
    let bad = |message| Error::State { message };
    let counts: ciborium::Value = decode(state).map_err(bad)?;
    let state: S = decode(state).map_err(bad)?;
    if counts_are_possible(&counts) && sound(&state) {
        Ok(state)
    } else {
        Err(Error::State { message: "its parts do not fit together".to_owned() })
    }
}

impl<'a> SimplexView<'a> {
    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// True if there are no vertices.
    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// The vertex of a rank (0 is the best), in the user's units.
    pub fn vertex(&self, rank: usize) -> &'a [f64] {
        let slot = self.order[rank];
        &self.x[slot * self.n..(slot + 1) * self.n]
    }

    /// Its cost; `None` if it failed or is not known yet.
    pub fn cost(&self, rank: usize) -> Option<f64> {
        self.costs[self.order[rank]]
    }

    /// A copy that stays.
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
    /// The vertices in the user's units.
    pub vertices: Vec<Vec<f64>>,
    /// Their costs; `None` where the objective failed.
    pub costs: Vec<Option<f64>>,
}
