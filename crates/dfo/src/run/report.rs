//! Result of a run: the best point, its cost and the reason why the run ended.

use crate::error::{Error, NothingFound};
use crate::evaluation::ledger::Ledger;
use crate::method_interface::interface::{BarrierStage, Lookahead, Method, Optimum, Simplex};
use crate::method_interface::linear_model::{Covariance, Dependence, LinearModel};
use crate::method_interface::tolerances::{Limits, ToleranceTests};
use crate::outcome::pareto_front::ParetoFront;
use crate::outcome::termination::{Termination, UNBOUNDED};
use crate::outcome::trace::Trace;
use crate::problem::constraints::ActiveConstraint;
use crate::problem::loss::RobustLoss;
use crate::problem::m_estimator::MeanScore;
use base::{Number, RunContext};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::fmt;
use std::path::PathBuf;

/// Checkpoint from which a run was continued. `Display` prints a sentence about it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Resumed {
    /// The file.
    pub path: PathBuf,
    /// Number of evaluations made before the checkpoint was written.
    pub n_evaluations: usize,
}

impl fmt::Display for Resumed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (path, n) = (self.path.display(), self.n_evaluations);
        write!(f, "continued from {path}, which contains the first {n} evaluations")
    }
}

/// Result of a run. `Display` prints a readable summary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Report {
    /// Best point, in the user's units and order. With several criteria, the compromise of the front.
    pub x: Vec<f64>,
    /// Cost of the best point, the smallest of all used points. With several criteria, the distance of the
    /// compromise, see [`ParetoFront::compromise`].
    pub fun: f64,
    /// Number of evaluations of the path of the method. Budgets limit this number. It is the same for any
    /// number of workers.
    pub n_evaluations: usize,
    /// Number of complete iterations.
    pub n_iterations: usize,
    /// Number of rounds. A round evaluates one or more points.
    pub n_batches: usize,
    /// Number of failed evaluations of the path.
    pub n_failed: usize,
    /// Number of points of the path whose cost was not evaluated, because they violate a constraint that must
    /// be kept. They are not failures.
    #[serde(default)]
    pub n_infeasible: usize,
    /// Number of answers that the engine lost, for example because a machine or a connection failed. Their
    /// points were evaluated again and count once.
    #[serde(default)]
    pub n_lost: usize,
    /// Number of answers that do not count as evaluations, because the point was already known. If a point
    /// was only known to be above a lower cutoff, the point is evaluated again outside the budget and the
    /// trace. Therefore cutoffs do not change any count.
    pub n_cached: usize,
    /// Number of additional, speculative calls of the objective that were not needed. May
    /// depend on the number of workers and on the duration of evaluations.
    pub n_speculative: usize,
    /// Reason why the run ended.
    pub termination: Termination,
    /// Reason as a sentence, including the test that passed and its values.
    pub message: String,
    /// The last values of the tolerance tests.
    pub tests: Option<ToleranceTests>,
    /// All evaluations; the evaluations of the path are in request order.
    pub trace: Trace,
    /// The simplex at the end, for methods that have one.
    pub final_simplex: Option<Simplex>,
    /// Reasons of the failures with their counts, most frequent first.
    pub failures: Vec<(String, usize)>,
    /// Name of the method.
    pub method: Cow<'static, str>,
    /// Reason why the method was chosen, if the user left the choice open.
    pub method_reason: Option<String>,
    /// Options of the method and the tolerances, by name, as text.
    #[serde(default)]
    pub options: Vec<(String, String)>,
    /// Batch plan of the method.
    pub batch: Cow<'static, str>,
    /// Number of evaluations that could run at once.
    pub workers: usize,
    /// Stages of a sequential barrier search: barrier parameter, barrier, point and cost of each stage.
    pub schedule: Vec<BarrierStage>,
    /// Distinct minima at which searches from several starts ended, lowest first, with the number of starts
    /// that reached each minimum. If the run stopped early, its result may be lower than all of them.
    pub optima: Vec<Optimum>,
    /// The population at the end, for methods that have one.
    pub final_population: Option<Simplex>,
    /// Seed of the random numbers, for methods that draw random numbers: the given or the drawn seed.
    pub seed: Option<u64>,
    /// Wall-clock time in seconds.
    pub seconds: f64,
    /// Residuals at the best point, if its evaluation requested them. These are the plain residuals, whatever
    /// the loss.
    pub residuals: Option<Vec<f64>>,
    /// Derivatives of the residuals with respect to the parameters, row by row (m x n), in the user's units
    /// and order. Columns of fixed parameters are zero. The values come from the method's model at the end.
    pub jacobian: Option<Vec<f64>>,
    /// Active bounds, one entry per parameter: -1 at the lower bound (also for fixed parameters), 1 at the
    /// upper bound, otherwise 0. Empty if there is no Jacobian.
    pub active: Vec<i8>,
    /// Loss applied to the residuals in [`fun`](Self::fun).
    pub loss: RobustLoss,
    /// Checkpoint from which the run was continued; `None` if the run started fresh.
    #[serde(default)]
    pub resumed: Option<Resumed>,
    /// Largest violation of a nonlinear constraint at the best point; 0 without nonlinear constraints.
    #[serde(default)]
    pub constr_violation: f64,
    /// Values of the nonlinear constraints at the best point.
    #[serde(default)]
    pub constraints: Vec<f64>,
    /// Parameters that change with others: through linear equalities, and through linear inequalities that
    /// are active at the best point. Empty if there is no Jacobian.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dependent: Vec<Dependence>,
    /// Lagrange multipliers of the active constraints at the best point, for methods that have them.
    /// Equalities and constraints on a single parameter have none.
    #[serde(default)]
    pub multipliers: Vec<ActiveConstraint>,
    /// Pareto front, for methods with several criteria. [`residuals`](Self::residuals) are then the criteria
    /// of the compromise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub front: Option<ParetoFront>,
}

impl Report {
    /// True if the tolerance tests passed, the target was reached, or there was nothing to search. Also true
    /// if only noise was left and the x test passed. The search for a front has no tests. It is a success if
    /// it ended at a limit or by itself, and found a feasible point.
    pub fn is_success(&self) -> bool {
        match (&self.front, &self.termination) {
            (
                Some(front),
                Termination::MaxEvaluations
                | Termination::MaxIterations
                | Termination::MaxTime
                | Termination::Stalled
                | Termination::AllFixed,
            ) => !front.points.is_empty(),
            (_, Termination::Noise) => self.tests.is_some_and(|tests| tests.x_passed),
            (_, termination) => termination.is_success(),
        }
    }

    /// Creates the report of a run that ran out of time before any evaluation had ended. It contains the
    /// start point with a cost of NaN.
    pub fn without_cost(x: &[f64], method: &str, found: NothingFound, seconds: f64) -> Self {
        Self {
            message: String::new(),
            x: x.to_vec(),
            fun: f64::NAN,
            n_evaluations: found.n_evaluations,
            n_iterations: 0,
            n_batches: 0,
            n_failed: found.failures.iter().map(|(_, count)| count).sum(),
            n_infeasible: found.n_infeasible,
            n_lost: 0,
            n_cached: 0,
            n_speculative: 0,
            termination: Termination::MaxTime,
            tests: None,
            failures: found.failures,
            trace: found.trace,
            final_simplex: None,
            final_population: None,
            schedule: Vec::new(),
            optima: Vec::new(),
            seed: None,
            method: method.to_owned().into(),
            method_reason: None,
            options: Vec::new(),
            batch: String::new().into(),
            workers: 1,
            seconds,
            residuals: None,
            jacobian: None,
            active: Vec::new(),
            loss: RobustLoss::default(),
            resumed: None,
            constr_violation: 0.0,
            constraints: Vec::new(),
            dependent: Vec::new(),
            multipliers: Vec::new(),
            front: None,
        }
    }

    /// True if the lengths of all parts are consistent. A report read from a file may be inconsistent.
    pub fn is_sound(&self) -> bool {
        let n = self.x.len();
        let simplexes = self.final_simplex.iter().chain(&self.final_population);
        let m = self.residuals.as_ref().map_or(0, Vec::len);
        self.trace.is_sound(n)
            && simplexes
                .into_iter()
                .all(|s| s.costs.len() == s.vertices.len() && s.vertices.iter().all(|v| v.len() == n))
            && self.jacobian.as_ref().is_none_or(|jacobian| jacobian.len() == m * n)
            && self.active.len() == if self.jacobian.is_some() { n } else { 0 }
            && self.dependent.iter().all(|other| other.index < n && other.coefficients.len() == n)
            && self.schedule.iter().all(|stage| stage.x.len() == n)
            && self.optima.iter().all(|optimum| optimum.x.len() == n)
            && self.front.as_ref().is_none_or(|front| front.is_sound(n))
    }

    /// Computes the covariance of the parameters from the linear model of the residuals at the end. It is
    /// `s^2 (J' J)^-1` with `s^2 = r' r / (m - n)`, over the free parameters that are not at a bound and do
    /// not depend on others. Equalities and active inequalities determine the entries of dependent
    /// parameters. `None` without residuals or Jacobian.
    ///
    /// With a loss, the result is the covariance of the M-estimator. The residuals r are then replaced with
    /// their scores, divided by the slope of the mean score. They are multiplied by the square root of the
    /// correction for small samples ([`MeanScore`]).
    pub fn covariance(&self) -> Option<Covariance> {
        self.covariance_unless(&RunContext::new())
    }

    /// Like [`covariance`](Self::covariance). Also returns `None` if there are many residuals and the context
    /// has ended.
    pub fn covariance_unless(&self, context: &RunContext<'_>) -> Option<Covariance> {
        let (residuals, jacobian) = (self.residuals.as_ref()?, self.jacobian.as_ref()?);
        let n_free = self.active.iter().filter(|active| **active == 0).count();
        let n_free = n_free.saturating_sub(self.dependent.len());
        let mean = self.loss.mean_score(residuals, n_free as f64 / residuals.len() as f64);
        let Some(MeanScore { slope, correction }) = mean.filter(|_| !self.loss.is_linear()) else {
            return Covariance::new(residuals, jacobian, &self.active, &self.dependent, context);
        };
        let (factor, m) = (correction.sqrt() / slope, residuals.len());
        let score = |(k, r): (usize, &f64)| factor * self.loss.of_residual(k, m).score(*r);
        let working: Vec<f64> = residuals.iter().enumerate().map(score).collect();
        Covariance::new(&working, jacobian, &self.active, &self.dependent, context)
    }

    /// Returns the sum of squares of the plain residuals. With the linear loss, it equals the cost.
    pub fn sum_of_squares(&self) -> Option<f64> {
        self.residuals.as_ref().map(|residuals| residuals.iter().map(|r| r * r).sum())
    }

    /// Converts residuals and Jacobian that a loss has transformed back to the plain ones.
    pub(crate) fn undo(&mut self, loss: RobustLoss) {
        self.loss = loss;
        let Some(residuals) = self.residuals.as_mut().filter(|_| !loss.is_linear()) else { return };
        loss.inverse_all(residuals);
        let (n, m) = (self.x.len(), residuals.len());
        for (k, j) in self.jacobian.iter_mut().flatten().enumerate() {
            *j /= loss.of_residual(k / n, m).slope(residuals[k / n]);
        }
        if self.jacobian.iter().flatten().any(|j| !j.is_finite()) {
            self.jacobian = None;
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}: {}", self.method, self.message)?;
        if let Some(reason) = &self.method_reason {
            writeln!(f, "  chosen       {reason}")?;
        }
        writeln!(f, "  cost         {}", Number(self.fun))?;
        writeln!(f, "  x            {:?}", self.x)?;
        writeln!(f, "  iterations   {}", self.n_iterations)?;
        write!(f, "  evaluations  {} in {} batches", self.n_evaluations, self.n_batches)?;
        writeln!(f, " ({} failed, {} speculative)", self.n_failed, self.n_speculative)?;
        if self.n_infeasible > 0 {
            let n = self.n_infeasible;
            writeln!(f, "  infeasible   {n} points, whose cost was not evaluated")?;
        }
        if self.n_lost > 0 {
            writeln!(
                f,
                "  lost         {} answers of the engine; their points were evaluated again",
                self.n_lost
            )?;
        }
        if let Some(resumed) = &self.resumed {
            writeln!(f, "  {resumed}")?;
        }
        for (reason, count) in &self.failures {
            writeln!(f, "    {count} x {reason}")?;
        }
        write!(f, "  time         {:.3} s, workers {}, batch plan {}", self.seconds, self.workers, self.batch)
    }
}

/// Builds the result of a method and a ledger; the trace moves into the result. A termination of `None` means
/// that all starting points failed.
pub(crate) fn conclude(
    method: &dyn Method,
    ledger: &mut Ledger,
    limits: &Limits,
    workers: usize,
    termination: Option<Termination>,
    seconds: f64,
    context: &RunContext<'_>,
) -> Result<Report, Error> {
    let Some(termination) = termination else {
        return Err(Error::AllStartsFailed(ledger.nothing_found()));
    };
    let Some((mut x, mut fun)) = ledger.best.get().map(|(x, f)| (x.to_vec(), f)) else {
        return Err(Error::EndedWithoutPoint { termination, found: ledger.nothing_found() });
    };
    let front = method.front();
    let is_met = termination.is_success() || termination == Termination::Noise;
    let termination = if is_met && !ledger.is_feasible() { Termination::Infeasible } else { termination };
    let details = method.details();
    let mut residuals =
        Some(std::mem::take(&mut ledger.best_residuals)).filter(|residuals| !residuals.is_empty());
    let mut constr_violation = ledger.constraints.violation(&ledger.best_constraints);
    let message = message(method, ledger, limits, &termination, front.as_ref(), fun, seconds);
    if let Some((point, distance)) = front.as_ref().and_then(ParetoFront::compromise) {
        (x, fun) = (point.x.clone(), distance);
        (residuals, constr_violation) = (Some(point.criteria.clone()), point.constr_violation);
    }
    let fits =
        |model: &LinearModel| residuals.as_ref().is_some_and(|r| model.jacobian.len() == r.len() * x.len());
    let is_over = || termination == Termination::Interrupted || context.is_over();
    let model = method.linear_model(&RunContext::new().polling(&is_over)).filter(fits);
    let (jacobian, active, dependent, multipliers) = match model {
        Some(LinearModel { jacobian, active, dependent, multipliers }) => {
            (Some(jacobian), active, dependent, multipliers)
        }
        None => (None, Vec::new(), Vec::new(), Vec::new()),
    };
    Ok(Report {
        message,
        x,
        fun,
        n_evaluations: ledger.n_evaluations,
        n_iterations: details.n_iterations,
        n_batches: ledger.n_batches,
        n_failed: ledger.n_failed,
        n_infeasible: ledger.n_infeasible,
        n_lost: ledger.n_lost,
        n_cached: ledger.n_cached,
        n_speculative: ledger.n_speculative(),
        termination,
        tests: details.tests,
        failures: ledger.failures(),
        trace: std::mem::take(&mut ledger.trace),
        final_simplex: details.simplex.map(|s| s.to_owned()),
        final_population: details.population.map(|s| s.to_owned()),
        schedule: details.schedule.to_vec(),
        optima: details.optima.to_vec(),
        seed: details.seed,
        method: method.name().into(),
        method_reason: None,
        options: Vec::new(),
        batch: match details.lookahead {
            Lookahead::Points(points) => points.to_string().into(),
            _ => details.plan.into(),
        },
        workers,
        seconds,
        residuals,
        jacobian,
        active,
        loss: RobustLoss::default(),
        resumed: None,
        constr_violation,
        constraints: std::mem::take(&mut ledger.best_constraints),
        dependent,
        multipliers: if multipliers.is_empty() { details.multipliers } else { multipliers },
        front,
    })
}

fn message(
    method: &dyn Method,
    ledger: &Ledger,
    limits: &Limits,
    termination: &Termination,
    front: Option<&ParetoFront>,
    fun: f64,
    seconds: f64,
) -> String {
    let details = method.details();
    let tests = details.tests.map_or_else(String::new, |t| t.to_string());
    let with_tests = |text: String| if tests.is_empty() { text } else { format!("{text}; {tests}") };
    let ended = match termination {
        Termination::Converged => format!("converged; {tests}"),
        Termination::Noise => {
            let has_passed = details.tests.is_some_and(|tests| tests.x_passed);
            let ended = if has_passed { "ended" } else { "not converged: ended" };
            let why = "in the noise of the residuals: the possible decrease is smaller than the effect of \
                       the noise";
            with_tests(format!("{ended} {why}"))
        }
        Termination::Target => {
            let target = Number(limits.target.unwrap_or(f64::NAN));
            format!("target reached: cost {} <= {target}", Number(fun))
        }
        Termination::ConstantCost => {
            with_tests("not informative: the search ended, but the cost did not change".to_owned())
        }
        Termination::Infeasible => {
            let violation = Number(ledger.constraints.violation(&ledger.best_constraints));
            let tolerance = Number(ledger.constraints.tolerance);
            with_tests(format!(
                "not converged: the best point violates a nonlinear constraint by {violation} \
                 (constraint_tol = {tolerance})"
            ))
        }
        Termination::Unbounded if fun >= UNBOUNDED => with_tests(
            "not converged: the minimum is at infinity or bounds are missing, because the cost still \
             decreases in the direction in which the parameters moved from the start"
                .to_owned(),
        ),
        Termination::Unbounded => {
            format!(
                "the cost has no minimum: it decreased to {}, below {}, and would decrease further",
                Number(fun),
                Number(UNBOUNDED)
            )
        }
        Termination::Collapsed => with_tests(
            "not converged: the search region has become too small for floating-point numbers".to_owned(),
        ),
        Termination::OneFiniteVertex => with_tests(
            "not converged: only one vertex of the simplex has a cost, because all others failed".to_owned(),
        ),
        Termination::BesideFailures => with_tests(
            "not converged: points around the best point fail, and there may be a lower cost between them"
                .to_owned(),
        ),
        Termination::BeforeMinimum => with_tests("not converged: the minimum is elsewhere".to_owned()),
        Termination::AllFailed => {
            with_tests("not converged: after some successful points, all points failed".to_owned())
        }
        Termination::TooManyFailed => with_tests(format!(
            "not converged: {} of {} evaluations failed, more than the allowed share of {}",
            ledger.n_failed,
            ledger.n_evaluations,
            limits.max_failed.unwrap_or(f64::NAN)
        )),
        Termination::Stalled => with_tests("not converged: no progress for a long time".to_owned()),
        Termination::AllFixed => "all parameters are fixed, so only one point was evaluated".to_owned(),
        Termination::MaxEvaluations => {
            with_tests(format!("stopped at the limit of {} evaluations", ledger.n_evaluations))
        }
        Termination::MaxIterations => {
            with_tests(format!("stopped at the limit of {} iterations", details.n_iterations))
        }
        Termination::MaxTime => {
            let limit = limits.max_time.map_or(seconds, |t| t.as_secs_f64());
            with_tests(format!("stopped at the time limit of {limit} s"))
        }
        Termination::StoppedByObserver => with_tests("stopped by the callback".to_owned()),
        Termination::Interrupted => with_tests("interrupted".to_owned()),
        Termination::Aborted(reason) => format!("aborted: {reason}"),
        Termination::NotSaved { reason, ended } => {
            let ended = message(method, ledger, limits, ended, None, fun, seconds);
            return format!("{ended}; the last state could not be saved: {reason}");
        }
    };
    let ended = match ledger.is_feasible() || *termination == Termination::Infeasible {
        true => ended,
        false => {
            let violation = ledger.constraints.violation(&ledger.best_constraints);
            format!("{ended}; the best point violates a nonlinear constraint by {}", Number(violation))
        }
    };
    if let Some(front) = front {
        return match front.points.len() {
            0 => format!("{ended}; no evaluated point is feasible"),
            1 => format!("{ended}; the front has 1 point"),
            n => format!("{ended}; the front has {n} points"),
        };
    }
    let message = match (details.roughness, details.handed_over) {
        (Some(roughness), Some((points, method))) => {
            format!("{ended}; switched to {method} after {points} evaluations, because {roughness}")
        }
        (Some(roughness), None) if !termination.is_success() => format!("{ended}; {roughness}"),
        _ => ended,
    };
    if let Some(cost) = ledger.trace.constant() {
        format!("{message}; the cost was {} at all {} points", Number(cost), ledger.n_evaluations)
    } else if details.without_effect.is_empty() {
        message
    } else {
        let names: Vec<String> = details.without_effect.iter().map(|index| format!("x[{index}]")).collect();
        format!(
            "{message}; no step of {} from zero changed the cost. If it should, specify a nominal size",
            names.join(", ")
        )
    }
}
