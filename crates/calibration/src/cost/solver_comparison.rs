//! The comparison of integration methods: the one that a system is simulated with over and over, as in a fit.
//!
//! Work is counted ([`Stats::work`]), never measured, so that the comparison has the same winner on every
//! machine. [`Method::Auto`] runs first. Where the system is not stiff that is an explicit method, and the
//! comparison is over: `Auto` stays, which also copes with parameters that make the system stiff. Where it is
//! stiff, Radau5 is tried, within twice the work of `Auto`, which begins with an explicit method all the same
//! and leaves what no implicit one can mend: Radau5 wins where it comes to its end. A large system is
//! simulated with BDF as well, which wins with less work, an error counted as more of it. So a system that is
//! not stiff takes one simulation, a stiff one two, a large stiff one three, of which that of the winner is
//! the first evaluation of a fit.

use ode::{Method, Stats};
use serde::{Deserialize, Serialize};

/// Samples may differ by this many tolerances: what differs more makes the cost of a fit noisy.
const MOST_DIFFERENCE: f64 = 5.0;
/// Differences from Radau5 below this many tolerances are its own, which counts with them.
const SMALLEST_DIFFERENCE: f64 = 0.1;
/// An error counts as much as work that goes with this power of it. The same method takes 0.13 to 0.19
/// (Radau5 and BDF on HIRES, ROBER, OREGO and VDPOL between rtol 1e-4 and 1e-8, `benches/work_precision.md`;
/// a step of order 5 has an error that goes with `h^6`). What is more is the price of a rough cost: a fit of
/// four parameters of a stiff model took 56 evaluations with an error of 0.4 tolerances, and hundreds with
/// one of 4.
const WORK_PER_ERROR: f64 = 0.25;
/// With fewer iterations of Newton's method per step `auto` was at work with an explicit method, but for
/// trials.
const STIFF_ITERATIONS: f64 = 0.5;
/// From so much work on it is looked whether Radau5 takes less than this part of what `auto` took without it:
/// where components are smaller than their absolute tolerances, an explicit method at the limit of its
/// stability looks like one that is not held back, and its samples may be wrong.
const MUCH_WORK: f64 = 1e4;
const HIDDEN_PART: f64 = 0.25;
/// Where the system is stiff, `auto` wins where it takes less than this part of the work of Radau5.
const AUTO_PART: f64 = 0.5;
/// From so many states on BDF is tried where the system is stiff: `LARGE` of `auto`, below which it takes
/// more right-hand sides than Radau5 (`benches/work_precision.md`).
const LARGE: usize = 16;

/// Simulation to be made in a comparison of methods.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ComparisonTask {
    /// With this method.
    pub method: Method,
    /// With this relative tolerance; the absolute ones in proportion.
    pub relative_tolerance: f64,
    /// The work after which it may be given up, for [`Limits::max_work`](ode::Limits::max_work).
    pub max_work: Option<f64>,
}

/// Outcome of a simulation in a comparison of methods.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ComparisonOutcome {
    /// Well.
    Finished {
        /// The samples, row by row, all of their outputs one after the other.
        #[serde(skip)]
        samples: Vec<f64>,
        /// Statistics of the simulation. (Of several simulations: the sum.)
        stats: Stats,
    },
    /// It was given up at the limit of its work.
    GivenUp,
    /// It failed: why.
    Failed(String),
}

/// A simulation of a comparison, with its residuals where it is an evaluation as well.
pub(crate) type ComparisonRun = (ComparisonOutcome, Option<Vec<f64>>);

/// Outcome of a method in a comparison.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Verdict {
    /// It agrees with Radau5: the largest difference in tolerances of its sample.
    Agrees(f64),
    /// It does not: the largest difference, above 5.
    Differs(f64),
    /// There was nothing to compare it with: the system is not stiff, or Radau5 failed; or it is Radau5, with
    /// which the others are compared.
    NotCompared,
    /// It was given up at the work with which it could not win any more.
    GivenUp,
    /// It failed: why.
    Failed(String),
}

/// A method in a comparison.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ComparedSolver {
    /// The method.
    pub method: Method,
    /// Its work in equivalents of a right-hand side; of one that was given up: what it had done then, at
    /// least. `None`: it failed.
    pub work: Option<f64>,
    /// Outcome of the method in the comparison.
    pub verdict: Verdict,
}

/// A comparison of methods and its winner.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct SolverComparison {
    /// The winner: [`Method::Auto`] where the system is not stiff, or Radau5 takes twice its work or fails;
    /// else Radau5, or BDF where that agrees with less work, an error counted as more of it.
    pub method: Method,
    /// The methods that took part, in the order in which they ran.
    pub entries: Vec<ComparedSolver>,
}

/// The differences that count as none.
#[derive(Debug, Clone, Copy)]
struct Tolerance<'a> {
    relative: f64,
    /// Of the first samples, then repeated.
    absolute: &'a [f64],
}

impl Tolerance<'_> {
    /// The largest difference in tolerances of the samples; NaN where they cannot be compared.
    fn distance(self, samples: &[f64], right: &[f64]) -> f64 {
        if samples.len() != right.len() {
            return f64::NAN;
        }
        let scales = self.absolute.iter().cycle();
        samples.iter().zip(right).zip(scales).fold(0.0, |largest: f64, ((y, right), absolute)| {
            let distance = (y - right).abs() / (absolute + self.relative * right.abs());
            if largest.is_nan() || distance.is_nan() { f64::NAN } else { largest.max(distance) }
        })
    }
}

/// Compares the methods on a system of `n_states`. `run` makes one simulation and gives its samples; an error
/// of it ends the comparison. `absolute` holds the absolute tolerances of the first samples, and of the
/// following ones again from its start: one per output is enough.
///
/// ```
/// use calibration::{ComparisonOutcome, compare_solvers};
/// use ode::{Method, Stats};
/// // A stiff system of 30 states, on which BDF takes a tenth of the right-hand sides.
/// let result: Result<_, ()> = compare_solvers(1e-6, &[1e-8], 30, |task| {
///     let right_hand_sides = if task.method == Method::Bdf { 100 } else { 1000 };
///     let stats = Stats { right_hand_sides, newton_iterations: 50, ..Stats::default() };
///     Ok(ComparisonOutcome::Finished { samples: vec![1.0, 2.0], stats })
/// });
/// assert_eq!(result.unwrap().method, Method::Bdf);
/// ```
///
/// # Errors
/// Errors of `run`, which end the comparison.
pub fn compare_solvers<E>(
    relative_tolerance: f64,
    absolute: &[f64],
    n_states: usize,
    mut run: impl FnMut(&ComparisonTask) -> Result<ComparisonOutcome, E>,
) -> Result<SolverComparison, E> {
    let tolerance = Tolerance { relative: relative_tolerance, absolute };
    let mut simulated =
        |method, max_work: Option<f64>| run(&ComparisonTask { method, relative_tolerance, max_work });
    let first = simulated(Method::Auto, None)?;
    let mut comparison = SolverComparison { method: Method::Auto, entries: Vec::new() };
    let mut most = None;
    if let ComparisonOutcome::Finished { stats, .. } = &first {
        let work = stats.work(n_states);
        let is_explicit = (stats.newton_iterations as f64) <= STIFF_ITERATIONS * stats.accepted_steps as f64;
        if is_explicit && work <= MUCH_WORK {
            comparison.enter(Method::Auto, (first, None), None, tolerance, n_states);
            return Ok(comparison);
        }
        most = Some(work * if is_explicit { HIDDEN_PART } else { 1.0 / AUTO_PART });
    }
    let second = simulated(Method::Radau5, most)?;
    let right = match &second {
        ComparisonOutcome::Finished { samples, stats } => Some((samples.clone(), stats.work(n_states))),
        ComparisonOutcome::GivenUp | ComparisonOutcome::Failed(_) => None,
    };
    let has_finished = matches!(first, ComparisonOutcome::Finished { .. });
    let samples = right.as_ref().map(|(samples, _)| samples.as_slice());
    comparison.enter(Method::Auto, (first, None), samples, tolerance, n_states);
    comparison.enter(Method::Radau5, (second, most), None, tolerance, n_states);
    match &right {
        Some((samples, work)) => {
            comparison.method = Method::Radau5;
            if n_states >= LARGE {
                let third = simulated(Method::Bdf, Some(*work))?;
                let within = (third, Some(*work));
                comparison.enter(Method::Bdf, within, Some(samples), tolerance, n_states);
                comparison.take_cheaper(*work);
            }
        }
        None if !has_finished => {
            let third = simulated(Method::Bdf, None)?;
            if matches!(third, ComparisonOutcome::Finished { .. }) {
                comparison.method = Method::Bdf;
            }
            comparison.enter(Method::Bdf, (third, None), None, tolerance, n_states);
        }
        None => {}
    }
    Ok(comparison)
}

impl SolverComparison {
    /// Adds a simulation, made within this work, compared with the right one where there is one.
    fn enter(
        &mut self,
        method: Method,
        (outcome, most): (ComparisonOutcome, Option<f64>),
        right: Option<&[f64]>,
        tolerance: Tolerance<'_>,
        n_states: usize,
    ) {
        let (work, verdict) = match outcome {
            ComparisonOutcome::GivenUp => (most, Verdict::GivenUp),
            ComparisonOutcome::Failed(why) => (None, Verdict::Failed(why)),
            ComparisonOutcome::Finished { samples, stats } => {
                let verdict = match right.map(|right| tolerance.distance(&samples, right)) {
                    None => Verdict::NotCompared,
                    Some(distance) if distance <= MOST_DIFFERENCE => Verdict::Agrees(distance),
                    Some(distance) => Verdict::Differs(distance),
                };
                (Some(stats.work(n_states)), verdict)
            }
        };
        self.entries.push(ComparedSolver { method, work, verdict });
    }

    /// Takes the last method where it agrees with Radau5, which took so much work, and takes less, its error
    /// counted as more of it.
    fn take_cheaper(&mut self, of_radau5: f64) {
        if let Some(ComparedSolver { method, work: Some(work), verdict: Verdict::Agrees(distance) }) =
            self.entries.last()
        {
            let error = distance.max(SMALLEST_DIFFERENCE) / SMALLEST_DIFFERENCE;
            if work * error.powf(WORK_PER_ERROR) < of_radau5 {
                self.method = *method;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finished(sample: f64, work: u64, newton_iterations: u64) -> ComparisonOutcome {
        let stats = Stats { right_hand_sides: work, newton_iterations, ..Stats::default() };
        ComparisonOutcome::Finished { samples: vec![1.0, sample], stats }
    }

    fn methods(comparison: &SolverComparison) -> Vec<Method> {
        comparison.entries.iter().map(|e| e.method).collect()
    }

    /// With `rtol = 1e-6` and `atol = 1e-6` a difference of 2e-6 at 1 is one tolerance.
    fn run(
        outcome: impl Fn(&ComparisonTask) -> ComparisonOutcome,
    ) -> (SolverComparison, Vec<ComparisonTask>) {
        run_with(1, outcome)
    }

    fn run_with(
        n_states: usize,
        outcome: impl Fn(&ComparisonTask) -> ComparisonOutcome,
    ) -> (SolverComparison, Vec<ComparisonTask>) {
        let mut tasks = Vec::new();
        let comparison: Result<_, ()> = compare_solvers(1e-6, &[1e-6], n_states, |task| {
            tasks.push(*task);
            Ok(outcome(task))
        });
        (comparison.unwrap(), tasks)
    }

    #[test]
    fn without_stiffness_there_is_one_simulation() {
        let (comparison, tasks) = run(|_| finished(1.0, 100, 0));
        assert_eq!((comparison.method, methods(&comparison)), (Method::Auto, vec![Method::Auto]));
        assert_eq!(
            tasks,
            [ComparisonTask { method: Method::Auto, relative_tolerance: 1e-6, max_work: None }]
        );
        assert_eq!(comparison.entries[0].work, Some(100.0));
    }

    #[test]
    fn radau5_wins_where_a_small_system_is_stiff() {
        let (comparison, tasks) = run(|task| match task.method {
            Method::Auto => finished(1.0 + 8e-6, 100, 9),
            _ => finished(1.0, 110, 9),
        });
        assert_eq!(
            (comparison.method, methods(&comparison)),
            (Method::Radau5, vec![Method::Auto, Method::Radau5])
        );
        assert!(
            matches!(comparison.entries[0].verdict, Verdict::Agrees(d) if (d - 4.0).abs() < 1e-6),
            "{comparison:?}"
        );
        // The limits: none, and twice the first.
        let limits: Vec<_> = tasks.iter().map(|task| task.max_work).collect();
        assert_eq!(limits, [None, Some(200.0)]);
        // With more work than that Radau5 is given up, and auto stays.
        let (comparison, _) = run(|task| match task.method {
            Method::Auto => finished(1.0, 100, 9),
            _ => ComparisonOutcome::GivenUp,
        });
        assert_eq!(comparison.method, Method::Auto);
        assert_eq!(comparison.entries[1].verdict, Verdict::GivenUp);
    }

    #[test]
    fn bdf_wins_on_a_large_stiff_system_with_less_work_at_equal_error() {
        // Errors of 2e-8, 2e-6 and 2e-5 are 0.01, 1 and 10 tolerances: none, a factor of 1.78, too much.
        for (error, work, winner) in [
            (2e-8, 90, Method::Bdf),
            (2e-6, 90, Method::Radau5),
            (2e-6, 50, Method::Bdf),
            (2e-5, 10, Method::Radau5),
        ] {
            let (comparison, tasks) = run_with(LARGE, |task| match task.method {
                Method::Auto => finished(1.0, 200, 9),
                Method::Bdf => finished(1.0 + error, work, 9),
                _ => finished(1.0, 100, 9),
            });
            assert_eq!(comparison.method, winner, "{comparison:?}");
            assert_eq!(methods(&comparison), [Method::Auto, Method::Radau5, Method::Bdf]);
            let of_radau5 = comparison.entries[1].work;
            assert_eq!(tasks[2].max_work, of_radau5);
        }
    }

    /// Tsit5 at the limit of its stability takes very many right-hand sides: Radau5 shows that it need not.
    #[test]
    fn much_explicit_work_is_looked_into() {
        for (implicit, winner) in [(900_u32, Method::Radau5), (30_000, Method::Auto)] {
            let (comparison, tasks) = run(|task| match task.method {
                Method::Auto => finished(1.0 + 3e-4, 100_000, 0),
                _ if task.max_work.is_some_and(|most| most < f64::from(implicit)) => {
                    ComparisonOutcome::GivenUp
                }
                _ => finished(1.0, u64::from(implicit), 300),
            });
            assert_eq!((tasks[1].method, tasks[1].max_work), (Method::Radau5, Some(25_000.0)));
            assert_eq!(comparison.method, winner, "{comparison:?}");
        }
    }

    #[test]
    fn trials_are_no_stiffness() {
        let stats =
            Stats { right_hand_sides: 600, accepted_steps: 100, newton_iterations: 12, ..Stats::default() };
        let (comparison, _) = run(|_| ComparisonOutcome::Finished { samples: vec![1.0], stats });
        assert_eq!(comparison.entries.len(), 1);
    }

    #[test]
    fn who_fails_cannot_win() {
        let (comparison, tasks) = run(|task| match task.method {
            Method::Auto => ComparisonOutcome::Failed("too many steps".to_owned()),
            _ => finished(1.0, 200, 9),
        });
        assert_eq!((comparison.method, tasks[1].max_work), (Method::Radau5, None));
        assert_eq!(comparison.entries[0].verdict, Verdict::Failed("too many steps".to_owned()));
        let (comparison, tasks) = run(|task| match task.method {
            Method::Bdf => finished(1.0, 50, 9),
            _ => ComparisonOutcome::Failed("too many steps".to_owned()),
        });
        assert_eq!((comparison.method, tasks.len()), (Method::Bdf, 3));
        let (comparison, _) = run(|_| ComparisonOutcome::Failed("too many steps".to_owned()));
        assert_eq!(comparison.method, Method::Auto);
    }

    #[test]
    fn without_anything_to_compare_with_auto_stays() {
        let (comparison, tasks) = run(|task| match task.method {
            Method::Radau5 => ComparisonOutcome::Failed("singular".to_owned()),
            _ => finished(1.0, 50, 9),
        });
        assert_eq!((comparison.method, tasks.len()), (Method::Auto, 2));
        assert_eq!(comparison.entries[0].verdict, Verdict::NotCompared);
        // Not a number, or samples missing: no agreement.
        for bad in [vec![1.0, f64::NAN], vec![1.0]] {
            let (comparison, _) = run_with(LARGE, |task| match task.method {
                Method::Bdf => ComparisonOutcome::Finished { samples: bad.clone(), stats: Stats::default() },
                _ => finished(1.0, 50, 9),
            });
            assert!(matches!(comparison.entries[2].verdict, Verdict::Differs(d) if d.is_nan()));
            assert_eq!(comparison.method, Method::Radau5);
        }
    }

    #[test]
    fn an_error_ends_the_comparison() {
        let stopped = compare_solvers(1e-6, &[1e-6], 1, |task| match task.method {
            Method::Auto => Ok(finished(1.0, 10, 9)),
            _ => Err("cancelled"),
        });
        assert_eq!(stopped, Err("cancelled"));
    }
}
