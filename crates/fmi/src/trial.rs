//! The trial runs that show how instances of a library can be reused, and whether several can be used at once.

use crate::beginning::StartValues;
use crate::description::Variable;
use crate::error::FmiError;
use crate::fmu::Reuse;
use crate::plan::SimulationPlan;
use crate::simulation::{PROBE_STEPS, Probe, Simulator};
use ode::{ErrorKind, Ignore, Observer, Sample};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// A simulation that takes longer than this is tested by its first steps only.
const LONG: Duration = Duration::from_secs(2);

/// How often two threads run instances at the same time. Only runs during which the other thread has moved on count: on a
/// busy machine threads get the processor by turns of some milliseconds. The library passes this once for all pools.
const ROUNDS: usize = 20;

/// When they have not met that often by then, it is enough.
const ROUNDS_TIME: Duration = Duration::from_millis(500);

/// Stack of threads that simulate.
const STACK: usize = 16 << 20;

/// Makes a simulator for a thread of the test.
pub(crate) type Make<'a> = &'a (dyn Fn() -> Result<Simulator, FmiError> + Sync);

/// What a run on a new instance gives, with which all others are compared; see [`Pool`](crate::Pool).
pub(crate) struct Trial<'a> {
    plan: &'a Arc<SimulationPlan>,
    base: &'a [f64],
    /// Start values and parameters a little off.
    others: (StartValues, Vec<f64>),
    /// `None`: from start to end.
    steps: Option<u64>,
    truth: Probe,
}

impl<'a> Trial<'a> {
    /// The run on a new instance. `None`: the model cannot be started with `base`, or the run was not over in time, and
    /// there is nothing to compare.
    ///
    /// # Errors
    /// It was cancelled; there is no new instance to be had.
    pub(crate) fn new(
        plan: &'a Arc<SimulationPlan>,
        base: &'a [f64],
        simulator: &mut Simulator,
    ) -> Result<Option<Self>, FmiError> {
        let mut clock = Clock { end: Instant::now() + LONG, over: false };
        let mut truth = simulator.probe_new(&plan.values.start, base, None, &mut clock)?;
        let steps = clock.over.then_some(PROBE_STEPS);
        if clock.over {
            truth = simulator.probe_new(&plan.values.start, base, steps, &mut Ignore)?;
        }
        let others = plan.values.others(plan.fmu().description(), base);
        Ok(matches!(truth, Probe::Digest(_)).then_some(Self { plan, base, others, steps, truth }))
    }

    /// The first way of bringing an instance back to its beginning that passes; `None`: a time limit ended a run.
    ///
    /// # Errors
    /// It was cancelled; there is no new instance to be had.
    pub(crate) fn reuse(&self, simulator: &mut Simulator) -> Result<Option<Reuse>, FmiError> {
        let known = self.plan.reuse();
        for reuse in [Reuse::Restore, Reuse::Reset] {
            let is_out = reuse == Reuse::Restore && !self.plan.may_restore();
            if is_out || known.is_some_and(|known| known > reuse) {
                continue;
            }
            match self.passes(reuse, simulator)? {
                None => return Ok(None),
                Some(true) => return Ok(Some(reuse)),
                Some(false) if reuse == Reuse::Restore => self.plan.refuse_restore(),
                Some(false) => {}
            }
        }
        Ok(Some(Reuse::Reinstantiate))
    }

    /// Whether runs on one instance, brought back to its beginning in between, are those of new instances: one with the
    /// base values, one with others, and one with the base values again.
    fn passes(&self, reuse: Reuse, simulator: &mut Simulator) -> Result<Option<bool>, FmiError> {
        let short = Some(PROBE_STEPS);
        let others = (&self.others.0, &self.others.1[..]);
        let other_truth = simulator.probe_new(others.0, others.1, short, &mut Ignore)?;
        let first = simulator.probe_first(reuse, self.base, self.steps)?;
        if first == Probe::TimedOut || other_truth == Probe::TimedOut {
            return Ok(None);
        }
        if first != self.truth {
            return Ok(Some(false));
        }
        let again = |simulator: &mut Simulator| {
            simulator.probe_again(reuse, &self.plan.values.start, self.base, self.steps, &mut Ignore)
        };
        let last = match simulator.probe_again(reuse, others.0, others.1, short, &mut Ignore)? {
            Some(Probe::TimedOut) => return Ok(None),
            Some(probe) if probe != other_truth => return Ok(Some(false)),
            Some(_) => again(simulator)?,
            None => None,
        };
        let last = match last {
            // A run that fails leaves no instance to bring back: then at least the same run twice.
            None => {
                simulator.probe_first(reuse, self.base, self.steps)?;
                again(simulator)?
            }
            last => last,
        };
        Ok(if last == Some(Probe::TimedOut) { None } else { Some(last == Some(self.truth)) })
    }

    /// Whether instances leave each other alone, one run inside of the other and two at once. The simulators of `make`
    /// are compared, and `simulator`, which is one of them, is used.
    ///
    /// # Errors
    /// It was cancelled; there is no new instance to be had.
    pub(crate) fn independent(
        &self,
        make: Make<'_>,
        simulator: &mut Simulator,
        reuse: Reuse,
    ) -> Result<Option<bool>, FmiError> {
        let independent = self.interleaved(make, simulator)?;
        let known = simulator.shared().is_reentrant();
        if independent != Some(true) || known {
            return Ok(independent);
        }
        let independent = self.at_once(make, simulator, reuse)?;
        if independent == Some(true) {
            simulator.shared().set_reentrant();
        }
        Ok(independent)
    }

    /// Whether simulators with private copies of the library give the same, and leave each other alone. That there is no
    /// copy to be had is a no.
    ///
    /// # Errors
    /// It was cancelled.
    pub(crate) fn copies_work(&self, reuse: Reuse) -> Result<Option<bool>, FmiError> {
        let plan = self.plan;
        let make = || {
            let copy = plan.fmu().private_copy(plan.kind)?;
            Simulator::with_library(Arc::clone(plan), Some(copy))
        };
        let no_copy = |error: FmiError| {
            log::warn!("{}: {error}", plan.fmu().description().model_name);
            if is_cancelled(&error) { Err(error) } else { Ok(Some(false)) }
        };
        let mut simulator = match make() {
            Ok(simulator) => simulator,
            Err(error) => return no_copy(error),
        };
        match simulator.probe_new(&plan.values.start, self.base, self.steps, &mut Ignore) {
            Ok(Probe::TimedOut) => Ok(None),
            Ok(probe) if probe != self.truth => Ok(Some(false)),
            Ok(_) => self.independent(&make, &mut simulator, reuse).or_else(no_copy),
            Err(error) => no_copy(error),
        }
    }

    /// Whether a run is the same when a second instance is made, run and freed after its initialization, and again after
    /// its first event iteration.
    fn interleaved(&self, make: Make<'_>, simulator: &mut Simulator) -> Result<Option<bool>, FmiError> {
        let mut second = Second { trial: self, make, polled: false, failed: None };
        if !simulator.begin_new(&self.plan.values.start, self.base)? {
            return Ok(Some(false));
        }
        second.run();
        let probe = simulator.finish_probe(self.steps, &mut second)?;
        Ok(match second.failed {
            Some(error) if is_cancelled(&error) => return Err(error),
            // The second instance could not be made.
            Some(_) => Some(false),
            None if probe == Probe::TimedOut => None,
            None => Some(probe == self.truth),
        })
    }

    /// Whether runs of two threads are the same as alone: code that keeps intermediate results in static variables shows
    /// only so.
    fn at_once(
        &self,
        make: Make<'_>,
        simulator: &mut Simulator,
        reuse: Reuse,
    ) -> Result<Option<bool>, FmiError> {
        let Self { plan, base, others, steps, truth } = self;
        let other_truth = simulator.probe_new(&others.0, &others.1, *steps, &mut Ignore)?;
        let values = [(&plan.values.start, *base), (&others.0, &others.1[..])];
        let truths = [*truth, other_truth];
        // With other values the model may not run at all.
        let choice = if matches!(other_truth, Probe::Digest(_)) { [0, 1] } else { [0, 0] };
        // Rounds begun, steps and samples; `usize::MAX` when a thread is done.
        let pulses = [AtomicUsize::new(0), AtomicUsize::new(0)];
        let start = Instant::now();
        let work = |me: usize| -> Result<Option<bool>, FmiError> {
            let which = choice[me];
            let mut simulator = make()?;
            let (mine, theirs) = (&pulses[me], || pulses[1 - me].load(Ordering::Acquire));
            let mut met = 0;
            let mut round = 0;
            while met < ROUNDS && (round < 2 || (start.elapsed() < ROUNDS_TIME && theirs() < usize::MAX)) {
                round += 1;
                mine.fetch_add(1, Ordering::Release);
                // Not a sleeping wait: a run may be shorter than the time it takes to wake up.
                while theirs() == 0 {
                    std::thread::yield_now();
                }
                let before = theirs();
                let (start_values, parameters) = values[which];
                // By turns on a new instance and on one that was brought back.
                let again = if round % 2 == 0 && reuse != Reuse::Reinstantiate {
                    simulator.probe_again(reuse, start_values, parameters, *steps, &mut Pulse(mine))?
                } else {
                    None
                };
                let probe = match again {
                    Some(probe) => probe,
                    None => {
                        simulator.renewable(reuse)?;
                        simulator.probe_new(start_values, parameters, *steps, &mut Pulse(mine))?
                    }
                };
                if probe == Probe::TimedOut {
                    return Ok(None);
                }
                if probe != truths[which] {
                    return Ok(Some(false));
                }
                met += usize::from(theirs().saturating_sub(before) > 1);
            }
            Ok(Some(true))
        };
        let run = |me: usize| {
            let shared = plan.fmu().shared(plan.kind);
            let _turn = shared.as_ref().map(|shared| shared.turn_beside());
            let verdict = work(me);
            pulses[me].store(usize::MAX, Ordering::Release);
            verdict
        };
        let verdicts = std::thread::scope(|scope| {
            let builder = || std::thread::Builder::new().stack_size(STACK);
            let Ok(first) = builder().spawn_scoped(scope, || run(0)) else { return None };
            let second = match builder().spawn_scoped(scope, || run(1)) {
                Ok(second) => second.join().ok(),
                Err(_) => {
                    pulses[1].store(usize::MAX, Ordering::Release);
                    None
                }
            };
            Some((first.join().ok()?, second?))
        });
        // No threads to be had: no verdict.
        let Some((first, second)) = verdicts else { return Ok(None) };
        let verdict = |outcome: Result<Option<bool>, FmiError>| match outcome {
            Err(error) if is_cancelled(&error) => Err(error),
            // No second instance beside the first.
            Err(_) => Ok(Some(false)),
            Ok(verdict) => Ok(verdict),
        };
        Ok(match (verdict(first)?, verdict(second)?) {
            (Some(false), _) | (_, Some(false)) => Some(false),
            (Some(true), Some(true)) => Some(true),
            _ => None,
        })
    }
}

fn is_cancelled(error: &FmiError) -> bool {
    matches!(error, FmiError::Simulation(error) if matches!(error.kind, ErrorKind::Cancelled))
}

/// A value a little off, within the variable's bounds.
pub(crate) fn nudge(variable: &Variable, value: f64) -> f64 {
    let size = if value != 0.0 {
        value.abs()
    } else {
        variable.nominal.filter(|n| n.is_normal()).unwrap_or(1.0).abs()
    };
    let fits = |x: &f64| variable.min.is_none_or(|min| *x >= min) && variable.max.is_none_or(|max| *x <= max);
    [value + 0.02 * size, value - 0.02 * size].into_iter().find(fits).unwrap_or(value)
}

/// Ends a run that takes too long to be made again and again.
struct Clock {
    end: Instant,
    over: bool,
}

impl Observer for Clock {
    fn sample(&mut self, _: &Sample<'_>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn poll(&mut self) -> ControlFlow<()> {
        self.over |= Instant::now() > self.end;
        if self.over { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

/// Tells another thread that a run goes on.
struct Pulse<'a>(&'a AtomicUsize);

impl Observer for Pulse<'_> {
    fn sample(&mut self, _: &Sample<'_>) -> ControlFlow<()> {
        self.poll()
    }

    fn poll(&mut self) -> ControlFlow<()> {
        self.0.fetch_add(1, Ordering::Release);
        ControlFlow::Continue(())
    }
}

/// Makes, runs and frees a second instance while the first one is under way.
struct Second<'a> {
    trial: &'a Trial<'a>,
    make: Make<'a>,
    polled: bool,
    failed: Option<FmiError>,
}

impl Second<'_> {
    fn run(&mut self) {
        let Trial { others, steps, .. } = self.trial;
        let outcome =
            (self.make)().and_then(|mut second| second.probe_new(&others.0, &others.1, *steps, &mut Ignore));
        if let Err(error) = outcome {
            self.failed = Some(error);
        }
    }
}

impl Observer for Second<'_> {
    fn sample(&mut self, _: &Sample<'_>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn poll(&mut self) -> ControlFlow<()> {
        if !std::mem::replace(&mut self.polled, true) {
            self.run();
        }
        ControlFlow::Continue(())
    }
}
