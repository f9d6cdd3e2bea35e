//! The comparison of integration methods: the one that simulates with the least counted work, accurately.
//!
//! For a system that is simulated over and over, as in a fit. Work is counted ([`Stats::work`]), never
//! measured, so that the comparison has the same winner on every machine. [`Method::Auto`] runs first. Where
//! the system is not stiff that is Tsit5, and there is nothing to win: the comparison is over, and `Auto`
//! stays, which also copes with parameters that make the system stiff; unless it took much work, and Radau5
//! takes a quarter of that at most. Where it is stiff, Radau5 with a tenth of the tolerance shows what is
//! right, and BDF and Radau5 are tried. Of those within 5 tolerances of it the winner is who takes the least
//! work, an error counted as more of it, and that of `Auto` twice. A method takes part as long as it may
//! still be that one.

use ode::{Method, Stats};
use serde::{Deserialize, Serialize};

/// Samples may differ by this many tolerances: what differs more makes the cost of a fit noisy.
const MOST_DIFFERENCE: f64 = 5.0;
/// The simulation that shows what is right: its share of the tolerance, and how much more work than the first
/// it may be. Differences below that share are its own.
const TIGHTER: f64 = 0.1;
/// An error counts as much as work that goes with this power of it. The same method takes 0.13 to 0.19
/// (Radau5 and BDF on HIRES, ROBER, OREGO and VDPOL between rtol 1e-4 and 1e-8, `benches/work_precision.md`;
/// a step of order 5 has an error that goes with `h^6`). What is more is the price of a rough cost: a fit of
/// four parameters of a stiff model took 56 evaluations with an error of 0.4 tolerances, and hundreds with
/// one of 4.
const WORK_PER_ERROR: f64 = 0.25;
/// With fewer iterations of Newton's method per step `auto` was at work with an explicit method, but for
/// trials.
const STIFF_ITERATIONS: f64 = 0.5;
const MOST_WORK: f64 = 20.0;
/// From so much work on it is looked whether Radau5 takes less than this part of what `auto` took without it:
/// where components are smaller than their absolute tolerances, an explicit method at the limit of its
/// stability looks like one that is not held back, and its samples may be wrong.
const MUCH_WORK: f64 = 1e4;
const HIDDEN_PART: f64 = 0.25;
/// Where the system is stiff, `auto` begins with an explicit method all the same, which may leave what an
/// implicit one cannot mend: it wins where it takes less than this part of the work of the others.
const AUTO_PART: f64 = 0.5;
/// Who competes with [`Method::Auto`] where the system is stiff.
const STIFF: [Method; 2] = [Method::Bdf, Method::Radau5];

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

/// A simulation of a comparison, with its residuals and the seconds that they took where it is an evaluation
/// as well.
pub(crate) type ComparisonRun = (ComparisonOutcome, Option<(Vec<f64>, f64)>);

/// Outcome of a method in a comparison.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Verdict {
    /// It agrees with the simulation of tighter tolerance: the largest difference in tolerances of its
    /// sample.
    Agrees(f64),
    /// It does not: the largest difference, above 5.
    Differs(f64),
    /// There was nothing to compare it with: the system is not stiff, or the simulation of tighter tolerance
    /// failed.
    NotCompared,
    /// It was given up when its work was that of the best method so far.
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
    /// The winner: of the methods that agree the one with the least work, an error counted as more of it, and
    /// that of [`Method::Auto`] twice; where none does the one that differs least; [`Method::Auto`] where
    /// there is nothing to compare.
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
/// // A system on which BDF takes a tenth of the right-hand sides.
/// let result: Result<_, ()> = compare_solvers(1e-6, &[1e-8], 1, |task| {
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
    let auto = ComparisonTask { method: Method::Auto, relative_tolerance, max_work: None };
    let first = run(&auto)?;
    let mut comparison = SolverComparison { method: Method::Auto, entries: Vec::new() };
    let mut reference_work = None;
    if let ComparisonOutcome::Finished { stats, .. } = &first {
        let work = stats.work(n_states);
        let is_explicit = (stats.newton_iterations as f64) <= STIFF_ITERATIONS * stats.accepted_steps as f64;
        let mut is_less = || {
            let max_work = Some(HIDDEN_PART * work);
            let outcome = run(&ComparisonTask { method: Method::Radau5, relative_tolerance, max_work })?;
            Ok(matches!(outcome, ComparisonOutcome::Finished { .. }))
        };
        if is_explicit && !(work > MUCH_WORK && is_less()?) {
            comparison.entries.push(ComparedSolver {
                method: Method::Auto,
                work: Some(work),
                verdict: Verdict::NotCompared,
            });
            return Ok(comparison);
        }
        reference_work = Some(MOST_WORK * work);
    }
    let tighter = ComparisonTask {
        method: Method::Radau5,
        relative_tolerance: (TIGHTER * relative_tolerance).max(1e-14),
        max_work: reference_work,
    };
    let right = match run(&tighter)? {
        ComparisonOutcome::Finished { samples, .. } => Some(samples),
        ComparisonOutcome::GivenUp | ComparisonOutcome::Failed(_) => None,
    };
    let mut least = None;
    comparison.enter(Method::Auto, first, tolerance, right.as_deref(), n_states, &mut least);
    if right.is_some() {
        for method in STIFF {
            // With an error too small to be seen it could have taken so much.
            let max_work = least.map(|least| least / TIGHTER.powf(WORK_PER_ERROR));
            let outcome = run(&ComparisonTask { method, relative_tolerance, max_work })?;
            comparison.enter(method, outcome, tolerance, right.as_deref(), n_states, &mut least);
        }
        if least.is_none() {
            comparison.take_closest();
        }
    }
    Ok(comparison)
}

impl SolverComparison {
    /// Judges a simulation against the right one; the best so far leads, with `least` work at an error of one
    /// tolerance.
    fn enter(
        &mut self,
        method: Method,
        outcome: ComparisonOutcome,
        tolerance: Tolerance<'_>,
        right: Option<&[f64]>,
        n_states: usize,
        least: &mut Option<f64>,
    ) {
        let (work, verdict) = match outcome {
            ComparisonOutcome::GivenUp => {
                (least.map(|least| least / TIGHTER.powf(WORK_PER_ERROR)), Verdict::GivenUp)
            }
            ComparisonOutcome::Failed(why) => (None, Verdict::Failed(why)),
            ComparisonOutcome::Finished { samples, stats } => {
                let distance = right.map(|right| tolerance.distance(&samples, right));
                let verdict = match distance {
                    None => Verdict::NotCompared,
                    Some(distance) if distance <= MOST_DIFFERENCE => Verdict::Agrees(distance),
                    Some(distance) => Verdict::Differs(distance),
                };
                (Some(stats.work(n_states)), verdict)
            }
        };
        if let (Verdict::Agrees(distance), Some(work)) = (&verdict, work) {
            let of_method = if method == Method::Auto { work / AUTO_PART } else { work };
            let at_equal_error = of_method * distance.max(TIGHTER).powf(WORK_PER_ERROR);
            if least.is_none_or(|least| at_equal_error < least) {
                *least = Some(at_equal_error);
                self.method = method;
            }
        }
        self.entries.push(ComparedSolver { method, work, verdict });
    }

    /// Where none agrees: who differs least.
    fn take_closest(&mut self) {
        let distances = self.entries.iter().filter_map(|entry| match entry.verdict {
            Verdict::Differs(distance) if !distance.is_nan() => Some((distance, entry.method)),
            _ => None,
        });
        if let Some((_, method)) = distances.min_by(|a, b| a.0.total_cmp(&b.0)) {
            self.method = method;
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
        let mut tasks = Vec::new();
        let comparison: Result<_, ()> = compare_solvers(1e-6, &[1e-6], 1, |task| {
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
    fn the_least_work_at_equal_error_wins_of_those_that_agree() {
        let (comparison, tasks) = run(|task| match task.method {
            Method::Auto => finished(1.0 + 8e-6, 100, 9),
            Method::Bdf => finished(1.0 - 3.2e-5, 50, 9),
            _ if task.relative_tolerance < 1e-6 => finished(1.0, 200, 9),
            _ => finished(1.0 + 2e-7, 110, 9),
        });
        // BDF is 16 tolerances off; Radau5 takes 10 % more work than `auto`, but its error is 40 times as small.
        assert_eq!(
            (comparison.method, methods(&comparison)),
            (Method::Radau5, [&[Method::Auto], &STIFF[..]].concat())
        );
        assert!(
            matches!(comparison.entries[0].verdict, Verdict::Agrees(d) if (d - 4.0).abs() < 1e-6),
            "{comparison:?}"
        );
        assert!(
            matches!(comparison.entries[1].verdict, Verdict::Differs(d) if (d - 16.0).abs() < 1e-6),
            "{comparison:?}"
        );
        // The limits: none, twenty times the first, and from then on what the best so far would take with no error at all.
        let limits: Vec<_> = tasks.iter().map(|h| h.max_work).collect();
        let most = 100.0 / AUTO_PART * 40f64.powf(WORK_PER_ERROR);
        assert_eq!(limits[..2], [None, Some(2000.0)]);
        assert!(limits[2..].iter().all(|limit| (limit.unwrap() - most).abs() < 1e-3), "{limits:?} {most}");
        assert_eq!(tasks[1].relative_tolerance, 0.1 * 1e-6);
    }

    #[test]
    fn where_none_agrees_the_closest_wins() {
        let (comparison, _) = run(|task| match task.method {
            Method::Auto => finished(1.0 + 9e-5, 100, 9),
            Method::Bdf => finished(1.0 - 4e-5, 10, 9),
            _ if task.relative_tolerance < 1e-6 => finished(1.0, 200, 9),
            _ => finished(1.0 + 1.2e-5, 300, 9),
        });
        assert_eq!(comparison.method, Method::Radau5);
    }

    /// Tsit5 at the limit of its stability takes very many right-hand sides: Radau5 shows that it need not.
    #[test]
    fn much_explicit_work_is_looked_into() {
        for (implicit, winner) in [(900_u32, Method::Bdf), (30_000, Method::Auto)] {
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
    fn who_fails_or_is_given_up_cannot_win() {
        let (comparison, tasks) = run(|task| match task.method {
            Method::Auto => ComparisonOutcome::Failed("too many steps".to_owned()),
            Method::Bdf => finished(1.0, 50, 9),
            _ if task.max_work.is_some() => ComparisonOutcome::GivenUp,
            _ => finished(1.0, 200, 9),
        });
        assert_eq!(comparison.method, Method::Bdf);
        assert_eq!(comparison.entries[0].verdict, Verdict::Failed("too many steps".to_owned()));
        // BDF has no visible error: none may take more work.
        assert_eq!(comparison.entries[2].work, Some(50.0));
        assert_eq!(comparison.entries[2].verdict, Verdict::GivenUp);
        let limits: Vec<_> = tasks.iter().map(|h| h.max_work).collect();
        assert_eq!(limits, [None, None, None, Some(50.0)]);
    }

    #[test]
    fn without_anything_to_compare_with_auto_stays() {
        let (comparison, tasks) = run(|task| match task.method {
            Method::Radau5 => ComparisonOutcome::GivenUp,
            _ => finished(1.0, 50, 9),
        });
        assert_eq!((comparison.method, tasks.len()), (Method::Auto, 2));
        assert_eq!(comparison.entries[0].verdict, Verdict::NotCompared);
        // Not a number, or samples missing: no agreement.
        for bad in [vec![1.0, f64::NAN], vec![1.0]] {
            let (comparison, _) = run(|task| match task.method {
                Method::Bdf => ComparisonOutcome::Finished { samples: bad.clone(), stats: Stats::default() },
                _ => finished(1.0, 50, 9),
            });
            assert!(matches!(comparison.entries[1].verdict, Verdict::Differs(d) if d.is_nan()));
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
