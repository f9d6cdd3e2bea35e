//! Tsit5 while the system is not stiff, Radau5 while it is.
//!
//! The test: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.2: two stages at the end of a
//! step tell how strongly the right-hand side answers to a change of the state; where the product with the step size
//! stays at the limit of stability, it is stability and not accuracy that decides the step. Back: by a bound on the
//! spectral radius of the Jacobian.

use crate::explicit_rk::ExplicitRk;
use crate::radau5::Radau5;
use crate::stepper::{Attempt, Consistency, Equations, Stepper, Trial};
use crate::system::{CallError, CallResult, HybridSystem};
use crate::tableau::TSIT5;

/// The interval of stability of Tsit5 on the negative axis ends at 3.5; a step size that only stability holds back settles
/// a little below.
const LIMIT: f64 = 3.25;
/// So many steps at the limit make it stiff; so many clean ones in a row make them forgotten.
const STIFF_STEPS: u32 = 15;
const CLEAN_STEPS: u32 = 6;
/// Also stiff: more than about half of many steps rejected (a running count that forgets).
const TOO_MANY_REJECTIONS: f64 = 25.0;
const FORGET: f64 = 0.98;
/// At tight tolerances the two stages differ by slow parts of the solution and see too little. So after this many steps of
/// Tsit5, or this many per evaluation of a Jacobian, the spectral radius is taken from a Jacobian.
/// There the fast parts must be damped more strongly to stay within the tolerance: steps settle at a smaller product.
const NEAR_LIMIT: f64 = 2.0;
/// How small depends on the tolerance. So where the largest eigenvalue is real and negative, and the product above this,
/// Radau5 makes so many steps on trial: the method that advances more per right-hand side goes on.
const WORTH_A_TRIAL: f64 = 0.3;
const TRIAL_STEPS: u32 = 15;
/// The first steps of a trial, in which the step size grows, do not count.
const TRIAL_START: u32 = 5;
/// After a trial that Tsit5 won the next one waits twice as long, up to so many times.
const MOST_PATIENCE: usize = 64;
const PROBE_STEPS: usize = 100;
const PROBE_STEPS_PER_COST: usize = 4;
/// Back after so many steps that Tsit5 could have made with room to spare.
const EASY: f64 = 1.5;
const EASY_STEPS: u32 = 5;

#[derive(Debug)]
pub(crate) struct Auto {
    easy: ExplicitRk<7>,
    stiff: Radau5,
    is_stiff: bool,
    /// The system has a mass matrix, which only Radau5 takes.
    only_stiff: bool,
    hits: u32,
    clean: u32,
    easy_steps: u32,
    strain: f64,
    /// Steps of Tsit5 since a Jacobian was looked at.
    since_probe: usize,
    /// So many more probes until the next trial, and how many there shall be after a trial lost.
    until_trial: usize,
    patience: usize,
    /// Right-hand sides and time advanced since the last probe, or since the start of the trial.
    work: u64,
    advanced: f64,
    /// Steps left of a trial of Radau5, and the time that Tsit5 advanced per right-hand side before.
    trial_left: u32,
    pace: f64,
    /// Below this product Tsit5 takes over again.
    easy_limit: f64,
    /// `h` times the estimated spectral radius, of the last good trial of Tsit5.
    response: f64,
}

impl Default for Auto {
    fn default() -> Self {
        Self {
            easy: ExplicitRk::new(&TSIT5),
            stiff: Radau5::default(),
            is_stiff: false,
            only_stiff: false,
            hits: 0,
            clean: 0,
            easy_steps: 0,
            strain: 0.0,
            since_probe: 0,
            until_trial: 0,
            patience: 1,
            work: 0,
            advanced: 0.0,
            trial_left: 0,
            pace: 0.0,
            easy_limit: EASY,
            response: 0.0,
        }
    }
}

/// Calls the method in use.
macro_rules! active {
    ($self:ident.$call:ident($($argument:expr),*)) => {
        if $self.is_stiff { $self.stiff.$call($($argument),*) } else { $self.easy.$call($($argument),*) }
    };
}

impl Auto {
    fn calm(&mut self) {
        self.hits = 0;
        self.clean = 0;
        self.easy_steps = 0;
        self.strain = 0.0;
        self.since_probe = 0;
        self.work = 0;
        self.advanced = 0.0;
        self.trial_left = 0;
    }

    /// Looks at the Jacobian at the start of a step of Tsit5, now and then, and switches if it says so.
    fn probe<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        trial: Trial<'_>,
    ) -> CallResult<()> {
        let wait = PROBE_STEPS.max(PROBE_STEPS_PER_COST * self.stiff.jacobian_cost());
        if self.since_probe < wait {
            return Ok(());
        }
        let pace = self.advanced / self.work.max(1) as f64;
        let point = (trial.t, trial.x, self.easy.derivative());
        self.since_probe = 0;
        self.work = 0;
        self.advanced = 0.0;
        self.until_trial = self.until_trial.saturating_sub(1);
        match self.stiff.spectral_radius(equations, point) {
            Ok((radius, _)) if trial.h * radius > NEAR_LIMIT => self.become_stiff(),
            Ok((radius, quotient))
                if self.until_trial == 0 && trial.h * radius > WORTH_A_TRIAL && quotient < -0.9 * radius =>
            {
                self.become_stiff();
                self.trial_left = TRIAL_STEPS;
                self.pace = pace;
                self.easy_limit = EASY.min(0.5 * trial.h * radius);
            }
            // No Jacobian to be had here: as before.
            Ok(_) | Err(CallError::Discard) => {}
            Err(failed) => return Err(failed),
        }
        Ok(())
    }

    fn become_stiff(&mut self) {
        self.calm();
        self.is_stiff = true;
        self.easy_limit = EASY;
        self.stiff.take_over(self.easy.derivative());
    }

    /// After an accepted step of Tsit5: is it stiff here?
    fn became_stiff(&mut self) -> bool {
        self.strain *= FORGET;
        self.since_probe += 1;
        if self.response > LIMIT {
            self.hits += 1;
            self.clean = 0;
        } else {
            self.clean += 1;
            if self.clean >= CLEAN_STEPS {
                self.hits = 0;
            }
        }
        self.hits >= STIFF_STEPS || self.strain > TOO_MANY_REJECTIONS
    }

    /// After an accepted step of Radau5: would Tsit5 do?
    fn became_easy(&mut self, h: f64) -> bool {
        if self.trial_left > 0 {
            return self.lost_trial();
        }
        let easy = self.stiff.stiffness(h).is_some_and(|response| response < self.easy_limit);
        self.easy_steps = if easy { self.easy_steps + 1 } else { 0 };
        !self.only_stiff && self.easy_steps >= EASY_STEPS
    }
}

impl Auto {
    /// After a step of a trial of Radau5: has it come to its end, and was Tsit5 faster?
    fn lost_trial(&mut self) -> bool {
        self.trial_left -= 1;
        if self.trial_left + TRIAL_START == TRIAL_STEPS {
            self.work = 0;
            self.advanced = 0.0;
        }
        if self.trial_left > 0 {
            return false;
        }
        let lost = self.advanced < self.pace * self.work as f64;
        self.patience = if lost { (2 * self.patience).min(MOST_PATIENCE) } else { 1 };
        self.until_trial = if lost { self.patience } else { 0 };
        lost
    }
}

impl Stepper for Auto {
    fn order(&self) -> u32 {
        active!(self.order())
    }

    fn has_error_estimate(&self) -> bool {
        true
    }

    fn takes_mass_matrix(&self) -> bool {
        true
    }

    fn repeats_step_at_event(&self) -> bool {
        active!(self.repeats_step_at_event())
    }

    fn takes_long_steps(&self) -> bool {
        active!(self.takes_long_steps())
    }

    fn begin<S: HybridSystem + ?Sized>(&mut self, system: &S) {
        self.easy.begin(system);
        self.stiff.begin(system);
        self.only_stiff = system.mass_matrix().is_some();
        self.is_stiff = self.only_stiff;
        self.until_trial = 0;
        self.patience = 1;
        self.easy_limit = EASY;
        self.calm();
    }

    fn evaluate<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        t: f64,
        x: &[f64],
    ) -> CallResult<()> {
        active!(self.evaluate(equations, t, x))
    }

    fn make_consistent<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        t: f64,
        x: &mut [f64],
    ) -> CallResult<Consistency> {
        active!(self.make_consistent(equations, t, x))
    }

    fn forget(&mut self) {
        active!(self.forget());
    }

    fn kink(&mut self, h: f64) -> f64 {
        active!(self.kink(h))
    }

    fn repeat(&mut self) {
        active!(self.repeat());
    }

    fn takes_jacobians(&self) -> bool {
        active!(self.takes_jacobians())
    }

    fn undetermined<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        t: f64,
        x: &[f64],
    ) -> Option<usize> {
        active!(self.undetermined(equations, t, x))
    }

    fn derivative(&self) -> &[f64] {
        active!(self.derivative())
    }

    fn try_step<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        trial: Trial<'_>,
        x_new: &mut [f64],
    ) -> CallResult<Attempt> {
        if !self.is_stiff {
            self.probe(equations, trial)?;
        }
        let before = equations.stats.right_hand_sides + equations.stats.directional_derivatives;
        let attempt = active!(self.try_step(equations, trial, x_new))?;
        self.work += equations.stats.right_hand_sides + equations.stats.directional_derivatives - before;
        if !self.is_stiff {
            match attempt {
                Attempt::Good => {
                    self.response = trial.h * self.easy.response(trial.x, x_new, equations.weights)
                }
                _ => self.strain += 1.0,
            }
        }
        Ok(attempt)
    }

    fn error(&self) -> &[f64] {
        active!(self.error())
    }

    fn refused(&mut self, h: f64) -> f64 {
        active!(self.refused(h))
    }

    fn prepare_interpolation<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        trial: Trial<'_>,
        x_new: &[f64],
    ) -> CallResult<()> {
        active!(self.prepare_interpolation(equations, trial, x_new))
    }

    fn interpolate(&self, trial: Trial<'_>, theta: f64, x: &mut [f64]) {
        active!(self.interpolate(trial, theta, x));
    }

    fn accept(&mut self, h: f64, theta: f64) -> f64 {
        let proposed = active!(self.accept(h, theta));
        self.advanced += theta * h;
        // At an event the method goes on as it is: the right-hand side of the end of the step is not known.
        if theta < 1.0 {
            return proposed;
        }
        if self.is_stiff {
            if self.became_easy(h) {
                self.calm();
                self.is_stiff = false;
                self.easy.take_over(self.stiff.derivative());
            }
        } else if self.became_stiff() {
            self.become_stiff();
        }
        proposed
    }
}
