//! The check of the ways of bringing instances back: short runs on one instance against those on new ones,
//! with other values in between.

use super::first_run::FirstRun;
use super::reset::reset;
use super::simulator::Simulator;
use crate::description::QuirkKind;
use crate::error::FmiError;
use crate::libraries::Reuse;
use crate::simulation::digest::Digest;
use crate::simulation::variable_elements::RunInput;
use crate::sys::{RawInstance, is_worker};
use log::Level;
use ode::{Checks, ErrorKind, Limits, Observer, Report, Sample, Seconds};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

const HIDDEN_STATE: &str = "a simulation depends on earlier ones in the same process: the model keeps a state that no variable shows and \
                            that a new instance does not renew";

const DIFFERS: &str = "a simulation after it differs from one on a new instance";

/// Result of a short run.
enum Probe {
    /// Digest of the FMU's results.
    Digest(Digest),
    /// It could not be started: nothing to compare.
    Nothing,
    /// A time limit ended it, which says nothing about the FMU.
    TimedOut,
    /// It was not made: the run before has failed and left no instance to bring back.
    Gone,
    /// It was not made: the instance cannot be brought back.
    Refused,
}

impl Probe {
    fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Digest(one), Self::Digest(other)) => one.value() == other.value(),
            _ => matches!((self, other), (Self::Nothing, Self::Nothing)),
        }
    }

    fn says_nothing(&self) -> bool {
        matches!(self, Self::TimedOut | Self::Gone)
    }
}

/// Result of a check.
enum Finding {
    /// Nothing: runs fail, or a time limit ends them.
    Nothing,
    /// It is a way, or none for the reason that is given.
    Way(Reuse, Option<&'static str>),
    /// Runs on new instances depend on earlier ones.
    State,
}

impl Simulator {
    /// Begins to note what the coming run answers, where it is not known yet how instances are brought back.
    pub(super) fn begin_first(&mut self, parameters: &[f64], wants_steps: bool) -> Option<Box<FirstRun>> {
        // A run whose rows were read in another way is none to compare with.
        let before_reading = self.plan.fmu().before_reading();
        self.first = self.first.take().filter(|first| first.before_reading == before_reading);
        if self.first.is_some() || self.reuse().is_some() {
            return None;
        }
        self.engine.running().begin_digest(Digest::default());
        Some(Box::new(FirstRun::new(&self.plan, parameters, wants_steps)))
    }

    /// Checks a way of bringing instances back, if the runs so far allow for that.
    ///
    /// # Errors
    /// The simulation is to end.
    pub(super) fn check_if_due(&mut self, observer: &mut dyn Observer) -> Result<Checks, FmiError> {
        if !self.first.as_ref().is_some_and(|first| first.is_due()) || self.reuse().is_some() {
            return Ok(Checks::default());
        }
        let Some(mut first) = self.first.take() else { return Ok(Checks::default()) };
        if first.before_reading != self.plan.fmu().before_reading() {
            return Ok(Checks::default());
        }
        let plan = Arc::clone(&self.plan);
        self.use_plan(&first.plan);
        let watch = SilentObserver { observer, wants_steps: first.wants_steps, is_stopped: false };
        let (began, checks) = (Instant::now(), Checks::default());
        let mut check = Check { first: &first, watch, began, checks };
        let found = check.find(self);
        let checks = check.taken();
        self.use_plan(&plan);
        let fmu = plan.fmu();
        let text = format!(
            "{} short simulations ({} steps, {:.3} s) were made to check how instances are brought back to their start",
            checks.runs,
            checks.steps,
            checks.seconds.get()
        );
        fmu.say_once(Level::Debug, "checks", &text);
        match found {
            // At the other values, perhaps; another check could end so, too.
            // Its runs were read in different ways.
            _ if first.before_reading != fmu.before_reading() => {}
            _ if self.is_fatal() => fmu.reset_knowledge(plan.kind).note(Reuse::Reinstantiate),
            Ok(Finding::State) => {
                fmu.note_hidden_state();
                let advice = "; results in this process may be wrong, isolation = \"process\" starts a process for every simulation";
                let advice = if is_worker() { "" } else { advice };
                fmu.note_quirk(QuirkKind::HiddenState, format!("{HIDDEN_STATE}{advice}"));
            }
            Ok(Finding::Way(reuse, None)) => {
                self.proven = Some(reuse);
                fmu.reset_knowledge(plan.kind).note(reuse);
            }
            Ok(Finding::Way(reuse, Some(reason))) => {
                self.give_up_reuse(reuse, reason);
                first.spent = 0.0;
                self.first = Some(first);
            }
            Err(error @ FmiError::Simulation(_)) => return Err(error),
            Ok(Finding::Nothing) | Err(_) => {}
        }
        Ok(checks)
    }
}

/// The runs of a check.
struct Check<'a> {
    first: &'a FirstRun,
    watch: SilentObserver<'a>,
    began: Instant,
    checks: Checks,
}

impl Check<'_> {
    /// Compares runs on new instances with each other, and with those on one that is brought back in the next
    /// way.
    ///
    /// # Errors
    /// The simulation is to end; there is no new instance to be had.
    fn find(&mut self, simulator: &mut Simulator) -> Result<Finding, FmiError> {
        let (plan, parameters) = (&self.first.plan, &self.first.parameters);
        let base = plan.values.input(parameters);
        let (start, other_parameters) = plan.values.perturbed(plan.fmu().description(), parameters);
        let others = RunInput { start: &start, parameters: &other_parameters };
        let reuse = if simulator.may_restore() { Reuse::Restore } else { Reuse::Reset };
        let other_truth = self.on_new(simulator, None, others)?;
        let truth = self.on_new(simulator, Some(reuse), base)?;
        let Probe::Digest(digest) = &truth else { return Ok(Finding::Nothing) };
        if other_truth.says_nothing() {
            return Ok(Finding::Nothing);
        }
        if !self.first.digest.begins_as(digest) {
            return Ok(Finding::State);
        }
        if reuse == Reuse::Restore && !simulator.may_restore() {
            return Ok(Finding::Way(reuse, Some("saving one fails")));
        }
        let wrong = |probe: &Probe, truth: &Probe| match probe {
            Probe::Refused => Some("it fails"),
            probe => (!probe.is_same(truth)).then_some(DIFFERS),
        };
        let other = self.again(simulator, reuse, others)?;
        if other.says_nothing() {
            return Ok(Finding::Nothing);
        }
        if let Some(reason) = wrong(&other, &other_truth) {
            return Ok(Finding::Way(reuse, Some(reason)));
        }
        let mut last = self.again(simulator, reuse, base)?;
        if matches!(last, Probe::Gone) {
            // A run that fails leaves no instance to bring back: then at least the same run twice.
            self.on_new(simulator, Some(reuse), base)?;
            last = self.again(simulator, reuse, base)?;
        }
        if last.says_nothing() {
            return Ok(Finding::Nothing);
        }
        Ok(Finding::Way(reuse, wrong(&last, &truth)))
    }

    /// A run on a new instance that can be brought back in this way afterwards.
    fn on_new(
        &mut self,
        simulator: &mut Simulator,
        reuse: Option<Reuse>,
        input: RunInput<'_>,
    ) -> Result<Probe, FmiError> {
        let raw = simulator.new_instance_for(reuse)?;
        self.probe(simulator, raw, input)
    }

    /// A run on the instance of the last one, brought back to its start.
    fn again(
        &mut self,
        simulator: &mut Simulator,
        reuse: Reuse,
        input: RunInput<'_>,
    ) -> Result<Probe, FmiError> {
        let Some(used) = simulator.engine.running().retire() else { return Ok(Probe::Gone) };
        match reset(used, simulator.plan.fmu(), reuse) {
            Ok(raw) => self.probe(simulator, raw, input),
            Err(_) => Ok(Probe::Refused),
        }
    }

    /// The first steps of a run of an instance that is new or was brought back. That it fails is part of what
    /// it shows.
    fn probe(
        &mut self,
        simulator: &mut Simulator,
        raw: RawInstance,
        input: RunInput<'_>,
    ) -> Result<Probe, FmiError> {
        self.checks.runs += 1;
        let limits = simulator.limits_after(&self.taken());
        if simulator.engine.initialize(raw, input).is_err() {
            return Ok(Probe::Nothing);
        }
        simulator.engine.running().begin_digest(Digest::default());
        let limits = Limits { max_steps: Some(self.first.n_check_steps()), ..limits };
        let outcome = simulator.engine.run(&simulator.plan, Some(limits), &mut self.watch);
        let digest = simulator.engine.running().end_digest().map_or(Probe::Nothing, Probe::Digest);
        let (probe, stats) = match &outcome {
            Err(FmiError::Simulation(error)) => match error.kind {
                ErrorKind::Cancelled => return Err(simulator.ended(ErrorKind::Cancelled)),
                ErrorKind::TimedOut(_) => (Probe::TimedOut, Some(&error.stats)),
                _ => (digest, Some(&error.stats)),
            },
            Ok(Report { stats, .. }) => (digest, Some(stats)),
            Err(_) => (digest, None),
        };
        if let Some(stats) = stats {
            self.checks.steps += stats.accepted_steps + stats.rejected_steps;
            self.checks.right_hand_sides += stats.right_hand_sides;
        }
        if self.watch.is_stopped { Err(simulator.ended(ErrorKind::Cancelled)) } else { Ok(probe) }
    }

    /// Cost so far.
    fn taken(&self) -> Checks {
        Checks { seconds: Seconds::new(self.began.elapsed().as_secs_f64()), ..self.checks }
    }
}

/// Takes steps as the first run did, and hands no samples on.
struct SilentObserver<'a> {
    observer: &'a mut dyn Observer,
    wants_steps: bool,
    is_stopped: bool,
}

impl Observer for SilentObserver<'_> {
    fn sample(&mut self, _: &Sample<'_>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn wants_steps(&self) -> bool {
        self.wants_steps
    }

    fn poll(&mut self) -> ControlFlow<()> {
        let polled = self.observer.poll();
        self.is_stopped |= polled.is_break();
        polled
    }
}
