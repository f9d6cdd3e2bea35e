//! Switches between an explicit method for non-stiff phases and an implicit method for stiff phases.
//!
//! Stiffness is determined by trial: Radau5 sometimes makes a few steps, and continues if they advance more
//! per right-hand side than the explicit method did. This measures the cost directly. Estimates of
//! eigenvalues do not: the product of step size and eigenvalue at which stability limits the step depends on
//! the system. It differs between real and imaginary eigenvalues, and is smaller for tight tolerances.
//!
//! The time of a trial depends only on cost. A trial starts at once if the product of step size and
//! eigenvalue stays at the end of the interval of stability. The last two stages give an estimate of the
//! eigenvalue (E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.2). Otherwise, a
//! trial starts when the right-hand sides since the last trial justify its cost.

use crate::error::Undetermined;
use crate::explicit_rk::{Dop853, ExplicitRk};
use crate::implicit::{Formula, Multistep, Radau5};
use crate::lu;
use crate::stepper::{Attempt, Consistency, Equations, Properties, Stepper, Trial};
use crate::system::{CallError, CallResult, HybridSystem};
use crate::tableau::Tsit5;

/// Below this relative tolerance, DOP853 is the explicit method, because it then needs fewer right-hand sides
/// (`benches/work_precision.md`).
const TIGHT: f64 = 1e-7;
/// At tight tolerances, Tsit5 replaces DOP853 after an event if the last stretch took at most this number of
/// steps of DOP853, whose restarts are expensive. DOP853 returns once a stretch costs more than its own last
/// one did. Each return halves the number, so that a run wastes at most four stretches. From the table of
/// events in `benches/work_precision.md`.
const SHORT: u32 = 8;
/// From this number of states, BDF replaces Radau5 if the largest eigenvalue is real and the system is
/// nonlinear. BDF then needs fewer right-hand sides and a fifth of the linear algebra for the same error. For
/// linear systems, Radau5 needs one iteration per step and is better (dense diffusion and advection of
/// `--tuning` in `benches/auto.rs`: half the right-hand sides). Radau5 is also better near the imaginary
/// axis, where BDF of order 3 to 5 is unstable, and for small systems, whose Jacobians are cheap.
const LARGE: usize = 16;
/// If the product of step size and largest eigenvalue is below this, stability does not limit any explicit
/// method.
const FREE: f64 = 1.0;
/// Consecutive steps at the limit of stability that start a trial, and consecutive clean steps that reset
/// their count (6: dopri5.f of Hairer and Wanner, which uses 15 for the former, because it then stops).
const STIFF_STEPS: u32 = 2;
const CLEAN_STEPS: u32 = 6;
/// Right-hand sides that a trial is expected to waste, in addition to its Jacobian: four steps of
/// Radau5, less their advance. Trials after the first start after as many right-hand sides of the explicit
/// method. Each trial that is lost doubles the wait for the next one.
const WASTE: f64 = 30.0;
/// Initial number of right-hand sides before the next trial, as a multiple of those that a trial wastes. For
/// DOP853 the multiple is one, because its interpolant has errors inside steps if a fast component follows a
/// slow one.
const PATIENCE: f64 = 2.5;
/// Right-hand sides per Jacobian up to which the first trial starts without waiting. This bounds the loss for
/// a non-stiff system.
const AFFORDABLE: f64 = 100.0;
/// Difference that decides a trial. The trial is won if the number of steps that advanced more per right-hand
/// side exceeds the number of steps that advanced less by this value. It is lost in the opposite case. The
/// first steps must damp the fast components left by the explicit method, and then grow.
const DECIDED: i32 = 4;
/// The system is nonlinear if the contraction of Newton's iterations exceeds `LINEAR` in this number of
/// steps. For a linear system, rounding leaves about 1e-8, the error of a finite-difference Jacobian.
const NONLINEAR_STEPS: u32 = 3;
const LINEAR: f64 = 1e-6;
/// After this number of trials lost because Newton's method failed, or of failures between accepted steps,
/// BDF replaces Radau5 if the largest eigenvalue is real. Slopes that change within the tolerance, as in a
/// flow through a valve with a narrow linear part, can let each trial of Radau5 fail. With 1, BDF also
/// replaces Radau5 for HIRES, whose error then decreases irregularly with the tolerance
/// (`tests/all/vectors.rs`).
const UNSOLVED: u32 = 2;
/// Largest cosine between an eigenvector and its image for which the eigenvalue counts as real and negative.
const REAL: f64 = -0.9;
/// Weight of the past in the means of work and advance, per step.
const FORGET: f64 = 0.9;
/// Number of steps of the explicit method after which its return is judged.
const RETURN_STEPS: u32 = 8;

/// The method in use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Active {
    Tsit5,
    Dop853,
    Radau5,
    Bdf,
}

#[derive(Debug)]
pub(crate) struct Auto {
    tsit5: ExplicitRk<7, Tsit5>,
    dop853: ExplicitRk<16, Dop853>,
    radau5: Radau5,
    bdf: Multistep,
    /// True if the tolerance is tight.
    is_tight: bool,
    /// The explicit method chosen for the tolerance and the distance of events.
    explicit: Active,
    /// Steps and right-hand sides of explicit methods since the last event, the right-hand sides of the last
    /// short stretch of DOP853, and the number of its steps that counts as short.
    steps: u32,
    stretch: f64,
    budget: f64,
    short: u32,
    active: Active,
    /// True if Radau5 (or BDF) has allocated its work space for this system.
    radau5_has_begun: bool,
    bdf_has_begun: bool,
    /// True if the system has a mass matrix. Radau5 is then used alone, without trials.
    only_radau5: bool,
    /// Right-hand sides per Jacobian, as far as known. Includes the cost of decompositions that a sparse
    /// decomposition would avoid.
    jacobian_cost: f64,
    hits: u32,
    clean: u32,
    /// Right-hand sides of the current step, and since the last trial.
    work: u64,
    since_trial: f64,
    patience: f64,
    /// Means over the last steps of the explicit method.
    mean_work: f64,
    mean_advance: f64,
    /// True if the method in use is on trial. `balance` is the number of better steps minus worse steps.
    on_trial: bool,
    balance: i32,
    /// Steps of Radau5 that showed the system to be nonlinear.
    nonlinear: u32,
    /// Trials lost, or successive steps repeated, because Newton's method of Radau5 failed.
    unsolved: u32,
    /// Step size of the explicit method when the trial began.
    explicit_h: f64,
    /// True if BDF is used from the next step.
    bdf_is_next: bool,
    /// Size of the first step of BDF (order 1) as a fraction of a step of Radau5 (order 5).
    first_share: f64,
    /// Estimate of the right-hand sides that the explicit method would have saved in the steps of Radau5 so
    /// far. `caution` multiplies the required number after returns that increased the cost.
    saved: f64,
    caution: f64,
    /// Right-hand sides that Radau5 has saved since it was chosen, including its trial, by the same estimate.
    ledger: f64,
    /// Means over the last steps of Radau5. `left_at` is their quotient when the explicit method returned,
    /// and `since_return` counts its steps since.
    radau5_work: f64,
    radau5_advance: f64,
    left_at: Option<f64>,
    since_return: u32,
    /// Estimate of the modulus of the largest eigenvalue in the last good step of the explicit method.
    rate: f64,
    /// Product of `rate` and the size of that step.
    response: f64,
    /// True if no trial has been decided yet in this run.
    is_first: bool,
}

impl Auto {
    pub(crate) fn new(rtol: f64) -> Self {
        let explicit = if rtol < TIGHT { Active::Dop853 } else { Active::Tsit5 };
        Self {
            tsit5: ExplicitRk::new(),
            dop853: ExplicitRk::new(),
            radau5: Radau5::default(),
            bdf: Multistep::new(Formula::Bdf, false),
            is_tight: rtol < TIGHT,
            explicit,
            steps: 0,
            stretch: 0.0,
            budget: f64::INFINITY,
            short: SHORT,
            active: explicit,
            radau5_has_begun: false,
            bdf_has_begun: false,
            only_radau5: false,
            jacobian_cost: 0.0,
            hits: 0,
            clean: 0,
            work: 0,
            since_trial: 0.0,
            patience: 0.0,
            mean_work: 0.0,
            mean_advance: 0.0,
            on_trial: false,
            balance: 0,
            nonlinear: 0,
            unsolved: 0,
            explicit_h: 0.0,
            bdf_is_next: false,
            first_share: rtol.powf(0.25),
            saved: 0.0,
            caution: 1.0,
            ledger: 0.0,
            radau5_work: 0.0,
            radau5_advance: 0.0,
            left_at: None,
            since_return: 0,
            rate: 0.0,
            response: 0.0,
            is_first: true,
        }
    }
}

impl Auto {
    fn active(&self) -> &dyn Stepper {
        match self.active {
            Active::Tsit5 => &self.tsit5,
            Active::Dop853 => &self.dop853,
            Active::Radau5 => &self.radau5,
            Active::Bdf => &self.bdf,
        }
    }

    fn active_mut(&mut self) -> &mut dyn Stepper {
        match self.active {
            Active::Tsit5 => &mut self.tsit5,
            Active::Dop853 => &mut self.dop853,
            Active::Radau5 => &mut self.radau5,
            Active::Bdf => &mut self.bdf,
        }
    }

    /// Returns the number of right-hand sides per step of the explicit method and its stability limit on the
    /// negative real axis. The limit is slightly smaller than the exact one, because steps limited only by
    /// stability settle there (dopri5.f and dop853.f: 3.25 and 6.1).
    fn stages_and_limit(&self) -> (f64, f64) {
        if self.explicit == Active::Tsit5 { (6.0, 3.25) } else { (12.0, 6.1) }
    }

    fn is_explicit(&self) -> bool {
        self.active == self.explicit
    }

    /// Changes the explicit method at an event (or the start) if the tolerance is tight and it is in use.
    fn begin_stretch(&mut self) {
        if self.active == Active::Dop853 && (1..=self.short).contains(&self.steps) {
            self.budget = self.stretch;
            (self.explicit, self.active) = (Active::Tsit5, Active::Tsit5);
            self.tsit5.forget();
        }
        (self.steps, self.stretch) = (0, 0.0);
    }

    /// Returns to DOP853 if Tsit5 has cost more in this stretch than DOP853 in its last one.
    fn end_short_stretches(&mut self) {
        if self.is_tight && self.active == Active::Tsit5 && self.stretch > self.budget {
            self.dop853.take_over(self.tsit5.derivative());
            (self.explicit, self.active) = (Active::Dop853, Active::Dop853);
            self.short /= 2;
            (self.mean_work, self.mean_advance) = (0.0, 0.0);
        }
    }

    /// Resets the counts.
    fn calm(&mut self) {
        self.hits = 0;
        self.clean = 0;
        self.since_trial = 0.0;
        self.saved = 0.0;
        self.on_trial = false;
        self.balance = 0;
    }

    /// Starts a trial of Radau5 if it is due.
    fn try_radau5(&mut self, equations: &mut Equations<'_>, h: f64) -> CallResult<()> {
        // With Tsit5, the first trial comes early. Tsit5 with a loose tolerance would otherwise excite fast
        // oscillations, which Radau5 would have to follow.
        let is_early = self.is_first && self.jacobian_cost <= AFFORDABLE && h * self.rate > FREE;
        let is_worth_it = self.since_trial >= self.patience * (self.jacobian_cost + WASTE);
        let is_due = is_early || (self.response > FREE && is_worth_it);
        let is_urgent = self.hits >= STIFF_STEPS && self.since_trial >= self.patience * self.jacobian_cost;
        if !(is_due || is_urgent) {
            return Ok(());
        }
        if !self.radau5_has_begun {
            if self.radau5.begin(equations.system).is_err() {
                // Memory is insufficient for its matrices, so the explicit method continues.
                self.patience = f64::INFINITY;
                self.is_first = false;
                return Ok(());
            }
            self.radau5_has_begun = true;
        }
        let f = match self.explicit {
            Active::Tsit5 => self.tsit5.derivative(),
            _ => self.dop853.derivative(),
        };
        self.radau5.take_over(f);
        self.judge_return();
        (self.radau5_work, self.radau5_advance) = (0.0, 0.0);
        self.ledger = 0.0;
        self.calm();
        self.active = Active::Radau5;
        self.on_trial = true;
        self.explicit_h = h;
        self.nonlinear = 0;
        Ok(())
    }

    /// Continues with BDF and the Jacobian of Radau5.
    fn use_bdf(&mut self, system: &dyn HybridSystem, x: &[f64]) -> CallResult<()> {
        if !self.bdf_has_begun {
            self.bdf.begin(system)?;
            self.bdf_has_begun = true;
        }
        self.bdf.take_over(x, self.radau5.derivative());
        self.bdf.freshness_mut().take_over(self.radau5.freshness_mut());
        self.active = Active::Bdf;
        self.on_trial = false;
        Ok(())
    }

    /// Returns to the explicit method after a lost trial. The next trial waits longer.
    fn give_up_trial(&mut self) {
        self.leave_radau5();
        if !std::mem::take(&mut self.is_first) {
            self.patience *= 2.0;
        }
    }

    /// Returns to the explicit method.
    fn leave_radau5(&mut self) {
        let f = self.radau5.derivative();
        match self.explicit {
            Active::Tsit5 => self.tsit5.take_over(f),
            _ => self.dop853.take_over(f),
        }
        (self.mean_work, self.mean_advance) = (0.0, 0.0);
        self.calm();
        self.active = self.explicit;
    }

    /// Judges the last return to the explicit method. If it advances less than Radau5 did before, the next
    /// return requires a larger saving.
    fn judge_return(&mut self) {
        if let Some(rate) = self.left_at.take() {
            let was_right = self.mean_advance >= rate * self.mean_work;
            self.caution = if was_right { (0.5 * self.caution).max(1.0) } else { 2.0 * self.caution };
        }
    }

    /// Ratio of step sizes, explicit method to Radau5, if only the error test limits both. From the non-stiff
    /// problems of `benches/auto.rs` and an oscillator.
    fn reach(&self) -> f64 {
        if self.explicit == Active::Tsit5 { 1.5 } else { 3.0 }
    }

    /// Counts a step of Radau5. Returns the right-hand sides that the explicit method would have saved, or a
    /// negative number if it would need more. The estimate uses the steps that its stability and the error
    /// test allow.
    fn enter(&mut self, work: f64, h: f64) -> f64 {
        let (stages, limit) = self.stages_and_limit();
        let saved = work - stages * (h * self.radau5.spectrum().0 / limit).max(1.0 / self.reach());
        self.radau5_work = FORGET * self.radau5_work + work;
        self.radau5_advance = FORGET * self.radau5_advance + h;
        self.ledger -= saved;
        saved
    }

    /// Updates the counts after an accepted step of the explicit method.
    fn watch_explicit(&mut self, work: f64, h: f64) {
        self.mean_work = FORGET * self.mean_work + work;
        self.mean_advance = FORGET * self.mean_advance + h;
        self.since_return += 1;
        if self.since_return == RETURN_STEPS {
            self.judge_return();
        }
        self.since_trial += work;
        if self.response > self.stages_and_limit().1 {
            self.hits += 1;
            self.clean = 0;
        } else {
            self.clean += 1;
            if self.clean >= CLEAN_STEPS {
                self.hits = 0;
            }
        }
    }

    /// Judges an accepted step of Radau5 on trial. Returns the next step size.
    fn judge(&mut self, work: f64, h: f64, proposed: f64) -> f64 {
        self.nonlinear += u32::from(self.radau5.contraction() > LINEAR);
        self.enter(work, h);
        let to_beat = if self.is_first {
            // The steps of the explicit method have not settled yet, so the maximum that stability allows is
            // used.
            let (stages, limit) = self.stages_and_limit();
            limit / (stages * self.radau5.spectrum().0)
        } else {
            self.mean_advance / self.mean_work
        };
        let better = h > to_beat * work;
        self.balance += if better { 1 } else { -1 };
        if self.balance <= -DECIDED {
            self.give_up_trial();
            return self.explicit_h;
        }
        if self.balance >= DECIDED {
            self.is_first = false;
            self.calm();
        }
        proposed
    }

    /// Decides after an accepted step of Radau5 whether to change the method. Returns the next step size.
    fn watch_radau5(&mut self, work: f64, h: f64, proposed: f64) -> f64 {
        if self.only_radau5 {
            return proposed;
        }
        self.unsolved = 0;
        self.nonlinear += u32::from(self.radau5.contraction() > LINEAR);
        let (_, cosine) = self.radau5.spectrum();
        if self.radau5.derivative().len() >= LARGE {
            self.bdf_is_next = self.nonlinear >= NONLINEAR_STEPS && cosine < REAL;
            if self.bdf_is_next {
                return self.first_share * proposed;
            }
        }
        // The explicit method returns when the saved right-hand sides would have paid for another trial of
        // Radau5.
        self.saved = (self.saved + self.enter(work, h)).max(0.0);
        if self.saved > self.caution * (self.jacobian_cost + WASTE) {
            // This use of Radau5 cost more than it saved.
            if self.ledger < 0.0 {
                self.patience *= 2.0;
            }
            self.left_at = Some(self.radau5_advance / self.radau5_work);
            self.since_return = 0;
            self.leave_radau5();
        }
        proposed
    }
}

impl Stepper for Auto {
    fn properties(&self) -> Properties {
        Properties { takes_mass_matrix: true, ..self.active().properties() }
    }

    fn begin(&mut self, system: &dyn HybridSystem) -> CallResult<()> {
        self.only_radau5 = system.mass_matrix().is_some();
        if self.is_tight {
            self.explicit = Active::Dop853;
            (self.steps, self.short) = (0, SHORT);
            self.tsit5.begin(system)?;
        }
        self.active = if self.only_radau5 { Active::Radau5 } else { self.explicit };
        self.active_mut().begin(system)?;
        self.radau5_has_begun = self.only_radau5;
        self.bdf_has_begun = false;
        self.bdf_is_next = false;
        let n = system.n_states();
        let pattern = system.jacobian_pattern().filter(|p| p.n_states() == n);
        self.jacobian_cost = pattern.map_or(n as f64, |p| p.widest_column() as f64 + lu::needless_work(p));
        self.patience = if self.explicit == Active::Tsit5 { PATIENCE } else { 1.0 };
        self.caution = 1.0;
        self.left_at = None;
        self.unsolved = 0;
        self.rate = 0.0;
        self.response = 0.0;
        self.mean_work = 0.0;
        self.mean_advance = 0.0;
        self.work = 0;
        self.calm();
        self.is_first = self.explicit == Active::Tsit5;
        Ok(())
    }

    fn evaluate(&mut self, equations: &mut Equations<'_>, t: f64, x: &[f64]) -> CallResult<()> {
        self.begin_stretch();
        self.active_mut().evaluate(equations, t, x)
    }

    fn make_consistent(
        &mut self,
        equations: &mut Equations<'_>,
        t: f64,
        x: &mut [f64],
    ) -> CallResult<Consistency> {
        self.active_mut().make_consistent(equations, t, x)
    }

    fn forget(&mut self) {
        self.active_mut().forget();
    }

    fn begin_with(&mut self, s: f64, dx: &[f64]) {
        self.active_mut().begin_with(s, dx);
    }

    fn kink(&mut self, h: f64) -> f64 {
        self.active_mut().kink(h)
    }

    fn repeat(&mut self) {
        self.active_mut().repeat();
    }

    fn undetermined(&mut self, equations: &mut Equations<'_>, t: f64, x: &[f64]) -> Option<Undetermined> {
        self.active_mut().undetermined(equations, t, x)
    }

    fn derivative(&self) -> &[f64] {
        self.active().derivative()
    }

    fn try_step(
        &mut self,
        equations: &mut Equations<'_>,
        trial: Trial<'_>,
        x_new: &mut [f64],
    ) -> CallResult<Attempt> {
        if self.is_explicit() {
            self.try_radau5(equations, trial.h)?;
        } else if std::mem::take(&mut self.bdf_is_next) {
            self.use_bdf(equations.system, trial.x)?;
        }
        let calls = |equations: &Equations<'_>| {
            equations.stats.right_hand_sides + equations.stats.directional_derivatives
        };
        let before = calls(equations);
        let attempt = self.active_mut().try_step(equations, trial, x_new);
        self.work += calls(equations) - before;
        let is_hopeless = matches!(attempt, Ok(Attempt::NotSolved { .. }) | Err(CallError::Discard));
        if self.active == Active::Radau5
            && !self.only_radau5
            && matches!(attempt, Ok(Attempt::NotSolved { .. }))
        {
            self.unsolved += 1;
            if self.unsolved >= UNSOLVED && self.radau5.spectrum().1 < REAL {
                let h = if self.on_trial { self.explicit_h } else { trial.h };
                self.use_bdf(equations.system, trial.x)?;
                return Ok(Attempt::NotSolved { h: self.first_share * h });
            }
        }
        if self.on_trial && is_hopeless {
            // The equations cannot be solved here, or the Jacobian cannot be evaluated. The explicit method
            // needs neither.
            self.give_up_trial();
            return Ok(Attempt::NotSolved { h: self.explicit_h });
        }
        if matches!(attempt, Ok(Attempt::Good)) {
            match self.active {
                Active::Tsit5 => self.rate = self.tsit5.response(trial.x, x_new, equations.weights),
                Active::Dop853 => self.rate = self.dop853.response(trial.x, x_new, equations.weights),
                _ => {}
            }
            self.response = if self.active == self.explicit { trial.h * self.rate } else { 0.0 };
        }
        attempt
    }

    fn error(&self) -> &[f64] {
        self.active().error()
    }

    fn refused(&mut self, h: f64) -> f64 {
        self.active_mut().refused(h)
    }

    fn prepare_interpolation(
        &mut self,
        equations: &mut Equations<'_>,
        trial: Trial<'_>,
        x_new: &[f64],
    ) -> CallResult<()> {
        self.active_mut().prepare_interpolation(equations, trial, x_new)
    }

    fn interpolate(&self, trial: Trial<'_>, theta: f64, x: &mut [f64]) {
        self.active().interpolate(trial, theta, x);
    }

    fn accept(&mut self, h: f64, theta: f64) -> f64 {
        let proposed = self.active_mut().accept(h, theta);
        let work = std::mem::take(&mut self.work) as f64;
        self.steps += 1;
        self.stretch += work;
        // After an event, the method does not change, because the right-hand side at the end of the step is
        // unknown.
        if theta < 1.0 {
            return proposed;
        }
        match self.active {
            Active::Radau5 if self.on_trial => return self.judge(work, h, proposed),
            Active::Radau5 => return self.watch_radau5(work, h, proposed),
            Active::Bdf => {}
            Active::Tsit5 | Active::Dop853 => {
                self.watch_explicit(work, h);
                self.end_short_stretches();
            }
        }
        proposed
    }
}
