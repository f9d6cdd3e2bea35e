//! Lends each worker a simulator with an instance of its own; finds out how instances can be reused, and whether several
//! can be used at once.

use crate::description::Variable;
use crate::error::FmiError;
use crate::fmu::Reuse;
use crate::plan::SimulationPlan;
use crate::simulation::{PROBE_STEPS, Probe, Simulator};
use crate::sys::{Loan, Shared};
use ode::{ErrorKind, Ignore, Observer, Sample};
use std::ops::{ControlFlow, Deref, DerefMut};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
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

/// Simulators of one plan, for any number of workers.
///
/// Before the first one is lent, the FMU is tested with the plan itself, from start to end (of a simulation that takes
/// seconds: its first steps): a run on a reset instance, after one with other values, while a second instance is run in
/// between, and while another thread runs one at the same time, must have the same bits as a run on a new instance. If
/// reset fails the test, every run gets a new instance. If instances disturb each other (or the FMU allows only one), one
/// simulator is lent at a time, of all pools whose FMUs have this library, and [`lend`](Self::lend) waits.
#[derive(Debug)]
pub struct Pool {
    plan: Arc<SimulationPlan>,
    /// Parameters of the test.
    reference: Vec<f64>,
    state: Mutex<State>,
    returned: Condvar,
}

#[derive(Debug, Default)]
struct State {
    idle: Vec<Simulator>,
    lent: usize,
    tested: Option<Tested>,
}

/// What the test found.
#[derive(Debug, Clone, Copy)]
struct Tested {
    reuse: Reuse,
    independent: bool,
}

/// A simulator on loan; it goes back to its pool on drop.
#[derive(Debug)]
pub struct Lease<'a> {
    pool: &'a Pool,
    /// `None` only while it is dropped.
    simulator: Option<Simulator>,
    /// Where instances disturb each other. Given back after the instance.
    loan: Option<Loan>,
}

impl Pool {
    /// A pool of simulators of this plan. Nothing is loaded or run yet. The test is made with the values that the
    /// parameters have in the model.
    pub fn new(plan: Arc<SimulationPlan>) -> Self {
        let reference = plan.parameter_starts().to_vec();
        Self { plan, reference, state: Mutex::default(), returned: Condvar::new() }
    }

    /// The same, with the test made at other values of the parameters: where the model can be simulated at all.
    ///
    /// # Errors
    /// A value is not finite, or there are not as many as parameters.
    pub fn with_reference(plan: Arc<SimulationPlan>, reference: &[f64]) -> Result<Self, FmiError> {
        plan.check_parameters(reference)?;
        Ok(Self { reference: reference.to_vec(), ..Self::new(plan) })
    }

    /// The plan.
    pub fn plan(&self) -> &Arc<SimulationPlan> {
        &self.plan
    }

    /// How instances are brought back to their beginning.
    ///
    /// # Errors
    /// The FMU has to be tested first and cannot be instantiated.
    pub fn reuse(&self) -> Result<Reuse, FmiError> {
        let mut state = self.state();
        self.test(&mut state)
            .map(|tested| self.plan.reuse().map_or(tested.reuse, |known| known.max(tested.reuse)))
    }

    /// Whether several instances can be used at the same time.
    ///
    /// # Errors
    /// The FMU has to be tested first and cannot be instantiated.
    pub fn is_concurrent(&self) -> Result<bool, FmiError> {
        let mut state = self.state();
        let tested = self.test(&mut state)?;
        Ok(tested.independent && !self.shared()?.is_dependent())
    }

    /// Lends a simulator: an idle one, else a new one. Where only one may be used at a time, waits until it is returned
    /// (to its pool, if that is another one of the same library); a thread that keeps a lease and asks for a second one
    /// then waits for itself.
    ///
    /// # Errors
    /// The FMU cannot be loaded or instantiated.
    pub fn lend(&self) -> Result<Lease<'_>, FmiError> {
        let mut state = self.state();
        let tested = self.test(&mut state)?;
        while !tested.independent && state.lent > 0 {
            state = self.returned.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.lent += 1;
        let idle = state.idle.pop();
        drop(state);
        let shared = self.shared();
        let loan = shared.ok().filter(|shared| shared.is_dependent()).map(|shared| shared.borrow_alone());
        let simulator = match idle {
            Some(simulator) => Ok(simulator),
            None => Simulator::new(Arc::clone(&self.plan)),
        };
        match simulator {
            Ok(simulator) => Ok(Lease { pool: self, simulator: Some(simulator), loan }),
            Err(error) => {
                self.state().lent -= 1;
                self.returned.notify_one();
                Err(error)
            }
        }
    }

    /// What all users of the library share.
    fn shared(&self) -> Result<Arc<Shared>, FmiError> {
        Ok(Arc::clone(self.plan.fmu().library(self.plan.kind)?.shared()))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tests the FMU, once. The lock is held meanwhile: nobody can use a simulator before the test is over.
    fn test(&self, state: &mut State) -> Result<Tested, FmiError> {
        if let Some(tested) = state.tested {
            return Ok(tested);
        }
        let shared = self.shared()?;
        let interface = self.plan.fmu().check_interface(self.plan.kind)?;
        let only_one = interface.capabilities.can_be_instantiated_only_once_per_process;
        if only_one {
            shared.set_dependent();
        }
        let _loan = shared.is_dependent().then(|| shared.borrow_alone());
        let _turn = shared.turn();
        let mut simulator = Simulator::new(Arc::clone(&self.plan))?;
        let Some(tested) = examine(&self.plan, &self.reference, &mut simulator)? else {
            // It says nothing about the FMU, so it binds nobody but this pool.
            log::warn!(
                "{}: the model cannot be simulated at {:?}, so reset and concurrency cannot be tested; simulations run \
                 one at a time",
                self.plan.fmu().description().model_name,
                self.reference
            );
            let cautious = Tested { reuse: Reuse::Reinstantiate, independent: false };
            if shared.is_dependent() {
                simulator.park();
            }
            state.idle.push(simulator);
            state.tested = Some(cautious);
            return Ok(cautious);
        };
        self.plan.set_reuse(tested.reuse);
        if tested.reuse == Reuse::Reinstantiate {
            log::warn!(
                "{}: reset cannot be relied on; every simulation gets a new instance",
                self.plan.fmu().description().model_name
            );
        }
        if !tested.independent {
            log::warn!(
                "{}: several instances at once cannot be relied on; simulations run one at a time",
                self.plan.fmu().description().model_name
            );
            // For some FMUs the instance made last is the only one that is right: none stays beside the one in use.
            shared.set_dependent();
            simulator.park();
            shared.free_spares();
        }
        state.idle.push(simulator);
        state.tested = Some(tested);
        Ok(tested)
    }
}

/// The test; see [`Pool`]. `None`: the model cannot be started with `base`, or a trial run was not over in time, and there
/// is nothing to compare.
fn examine(
    plan: &Arc<SimulationPlan>,
    base: &[f64],
    simulator: &mut Simulator,
) -> Result<Option<Tested>, FmiError> {
    let fmu = plan.fmu();
    let mut clock = Clock { end: Instant::now() + LONG, over: false };
    let mut truth = simulator.probe_new(base, None, &mut clock)?;
    let steps = clock.over.then_some(PROBE_STEPS);
    if clock.over {
        truth = simulator.probe_new(base, steps, &mut Ignore)?;
    }
    if !matches!(truth, Probe::Digest(_)) {
        return Ok(None);
    }
    let after_reset = match simulator.probe_after_others(base, steps)? {
        // A run that fails leaves no instance to reset: then at least the same run twice.
        None => match simulator.probe_new(base, steps, &mut Ignore)? {
            again if again == truth => simulator.probe_reset(base, steps)?,
            again => Some(again),
        },
        probe => probe,
    };
    if after_reset == Some(Probe::TimedOut) {
        return Ok(None);
    }
    let reset = after_reset == Some(truth);
    let reuse =
        if reset && plan.reuse() != Some(Reuse::Reinstantiate) { Reuse::Reset } else { Reuse::Reinstantiate };
    if fmu.shared(plan.kind).is_some_and(|shared| shared.is_dependent()) {
        return Ok(Some(Tested { reuse, independent: false }));
    }
    let mut independent = interleaved(plan, base, simulator, steps, truth)?;
    if independent == Some(true) && !fmu.shared(plan.kind).is_some_and(|shared| shared.is_reentrant()) {
        independent = at_once(plan, base, simulator, steps, truth, reuse)?;
        if let Some(shared) = fmu.shared(plan.kind).filter(|_| independent == Some(true)) {
            shared.set_reentrant();
        }
    }
    Ok(independent.map(|independent| Tested { reuse, independent }))
}

/// Whether a run is the same when a second instance is made, run and freed after its initialization, and again after its
/// first event iteration.
fn interleaved(
    plan: &Arc<SimulationPlan>,
    base: &[f64],
    simulator: &mut Simulator,
    steps: Option<u64>,
    truth: Probe,
) -> Result<Option<bool>, FmiError> {
    let mut second = Second { plan, base, steps, polled: false, failed: None };
    if !simulator.begin_new(&plan.start_values, base)? {
        return Ok(Some(false));
    }
    second.run();
    let probe = simulator.finish_probe(steps, &mut second)?;
    Ok(match second.failed {
        Some(error) if is_cancelled(&error) => return Err(error),
        // The second instance could not be made.
        Some(_) => Some(false),
        None if probe == Probe::TimedOut => None,
        None => Some(probe == truth),
    })
}

/// Whether runs of two threads are the same as alone: code that keeps intermediate results in static variables shows only
/// so.
fn at_once(
    plan: &Arc<SimulationPlan>,
    base: &[f64],
    simulator: &mut Simulator,
    steps: Option<u64>,
    truth: Probe,
    reuse: Reuse,
) -> Result<Option<bool>, FmiError> {
    let others = plan.other_values(base);
    let other_truth = match simulator.begin_new(&others.0, &others.1)? {
        true => simulator.finish_probe(steps, &mut Ignore)?,
        false => Probe::Nothing,
    };
    let values = [(&plan.start_values, base), (&others.0, &others.1[..])];
    let truths = [truth, other_truth];
    // With other values the model may not run at all.
    let choice = if matches!(other_truth, Probe::Digest(_)) { [0, 1] } else { [0, 0] };
    // Rounds begun, steps and samples; `usize::MAX` when a thread is done.
    let pulses = [AtomicUsize::new(0), AtomicUsize::new(0)];
    let start = Instant::now();
    let work = |me: usize| -> Result<Option<bool>, FmiError> {
        let which = choice[me];
        let mut simulator = Simulator::new(Arc::clone(plan))?;
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
            // By turns on a new and on a reset instance.
            let reset = if round % 2 == 0 && reuse == Reuse::Reset {
                simulator.probe_reset_with(start_values, parameters, steps, &mut Pulse(mine))?
            } else {
                None
            };
            let probe = match reset {
                Some(probe) => probe,
                None if simulator.begin_new(start_values, parameters)? => {
                    simulator.finish_probe(steps, &mut Pulse(mine))?
                }
                None => Probe::Nothing,
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
    plan: &'a Arc<SimulationPlan>,
    base: &'a [f64],
    steps: Option<u64>,
    polled: bool,
    failed: Option<FmiError>,
}

impl Second<'_> {
    fn run(&mut self) {
        let (start_values, parameters) = self.plan.other_values(self.base);
        let outcome = Simulator::new(Arc::clone(self.plan)).and_then(|mut second| {
            if second.begin_new(&start_values, &parameters)? {
                second.finish_probe(self.steps, &mut Ignore)?;
            }
            Ok(())
        });
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

impl Deref for Lease<'_> {
    type Target = Simulator;

    fn deref(&self) -> &Simulator {
        match &self.simulator {
            Some(simulator) => simulator,
            None => unreachable!("a lease has its simulator until it is dropped"),
        }
    }
}

impl DerefMut for Lease<'_> {
    fn deref_mut(&mut self) -> &mut Simulator {
        match &mut self.simulator {
            Some(simulator) => simulator,
            None => unreachable!("a lease has its simulator until it is dropped"),
        }
    }
}

impl Drop for Lease<'_> {
    fn drop(&mut self) {
        let mut simulator = self.simulator.take();
        if let Some((simulator, _)) = simulator.as_mut().zip(self.loan.as_ref()) {
            // Other pools of this library need the place of its instance.
            simulator.park();
        }
        let mut state = self.pool.state();
        state.lent -= 1;
        state.idle.extend(simulator);
        drop(state);
        self.pool.returned.notify_one();
    }
}
