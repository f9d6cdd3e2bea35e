//! An explicit method while the system is not stiff, an implicit one while it is.
//!
//! What is stiff is found by trial: now and then Radau5 makes a few steps, and goes on if they advance more
//! per right-hand side than those of the explicit method did. (That counts what matters. Estimates of
//! eigenvalues do not: steps are held back by stability at one product with the step size where eigenvalues
//! are real, at another one where they are imaginary, and at smaller ones where the tolerance is tight.) When
//! to try is a question of cost alone: at once where the product of step size and eigenvalue, which the last
//! two stages tell (E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.2), stays at
//! the end of the interval of stability; else when the right-hand sides since the last trial are worth it.

use crate::error::Undetermined;
use crate::explicit_rk::{Dop853, ExplicitRk};
use crate::implicit::{Bdf, Radau5};
use crate::lu;
use crate::stepper::{Attempt, Consistency, Equations, Properties, Stepper, Trial};
use crate::system::{CallError, CallResult, HybridSystem};
use crate::tableau::Tsit5;

/// Below this tolerance DOP853 is the explicit method, which takes fewer right-hand sides from there on
/// (`benches/work_precision.md`).
const TIGHT: f64 = 1e-7;
/// From so many states on BDF takes over from Radau5 where the largest eigenvalue is real and the system is
/// not linear: fewer right-hand sides and a fifth of the linear algebra for the same error. For linear
/// systems Radau5 needs one iteration a step and is the better one (dense diffusion and advection of
/// `--tuning` in `benches/auto.rs`: half the right-hand sides), as it is near the imaginary axis, where BDF
/// of order 3 to 5 is not stable, and for small systems, whose Jacobians cost little.
const LARGE: usize = 16;
/// Below this product of step size and largest eigenvalue no explicit method is held back by its stability.
const FREE: f64 = 1.0;
/// Steps at the limit of stability that make a trial; so many others in a row make them forgotten (6:
/// dopri5.f of Hairer and Wanner, which has 15 for the former, because it then stops).
const STIFF_STEPS: u32 = 2;
const CLEAN_STEPS: u32 = 6;
/// Right-hand sides that a trial is expected to waste, besides those of its Jacobian: four steps of Radau5,
/// less what they advance. Trials after the first come after as many of the explicit method; each one that is
/// lost makes the next one wait twice as long.
const WASTE: f64 = 30.0;
/// Right-hand sides before the next trial, at first, as a multiple of those that a trial wastes. For DOP853
/// once: its interpolant makes errors inside of steps where a fast component follows a slow one.
const PATIENCE: f64 = 2.5;
/// Right-hand sides of a Jacobian up to which the first trial does not wait: it bounds what a system that is
/// not stiff can lose.
const AFFORDABLE: f64 = 100.0;
/// A trial is won when so many more of its steps advanced more per right-hand side than less, and lost when
/// so many more advanced less: the first ones must damp what the explicit method has left of fast parts, and
/// then grow.
const DECIDED: i32 = 4;
/// So many steps in which the iterations of Newton's method contract by more than this tell that the system
/// is not linear; of a linear one rounding leaves some 1e-8, the error of differences in the Jacobian.
const NONLINEAR_STEPS: u32 = 3;
const LINEAR: f64 = 1e-6;
/// The cosine between an eigenvector and its image, up to which its eigenvalue counts as real and negative.
const REAL: f64 = -0.9;
/// Share of the past in the means of work and advance, per step.
const FORGET: f64 = 0.9;
/// So many steps of the explicit method after its return tell whether it was right.
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
    bdf: Bdf,
    /// The explicit one of them that the tolerance asks for.
    explicit: Active,
    active: Active,
    /// Radau5 has room for this system; BDF has.
    radau5_has_begun: bool,
    bdf_has_begun: bool,
    /// The system has a mass matrix: Radau5 alone, which no trial has to choose.
    only_radau5: bool,
    /// Right-hand sides of a Jacobian, as far as they are known, and as many as its decompositions take where
    /// they could do with far less.
    jacobian_cost: f64,
    hits: u32,
    clean: u32,
    /// Right-hand sides of the step in the making, and since the last trial.
    work: u64,
    since_trial: f64,
    patience: f64,
    /// Means over the last steps of the explicit method.
    mean_work: f64,
    mean_advance: f64,
    /// The method in use is on trial: so many steps in a row were better (or worse, below zero).
    on_trial: bool,
    balance: i32,
    /// Steps of Radau5 that showed that the system is not linear.
    nonlinear: u32,
    /// The step size of the explicit method when the trial began.
    explicit_h: f64,
    /// BDF takes over at the next step.
    bdf_is_next: bool,
    /// The share of a step of Radau5, of order 5, that the first one of BDF, of order 1, begins with.
    first_share: f64,
    /// Right-hand sides that the explicit method would have saved in the steps of Radau5 so far, by an
    /// estimate, and how many times more they must be after returns that made things worse.
    saved: f64,
    caution: f64,
    /// Right-hand sides that Radau5 has saved since it took over, its trial included, by the same estimate.
    ledger: f64,
    /// Means over the last steps of Radau5; their quotient when the explicit method returned, and its steps
    /// since.
    radau5_work: f64,
    radau5_advance: f64,
    left_at: Option<f64>,
    since_return: u32,
    /// The estimated largest eigenvalue, in modulus, of the last good step of the explicit method.
    rate: f64,
    /// Its product with that step.
    response: f64,
    /// No trial has been decided yet in this run.
    is_first: bool,
}

impl Auto {
    pub(crate) fn new(rtol: f64) -> Self {
        let explicit = if rtol < TIGHT { Active::Dop853 } else { Active::Tsit5 };
        Self {
            tsit5: ExplicitRk::new(),
            dop853: ExplicitRk::new(),
            radau5: Radau5::default(),
            bdf: Bdf::new(false),
            explicit,
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

    /// Right-hand sides of a step of the explicit method, and the end of its interval of stability on the
    /// negative axis, or a little less, where steps settle that only stability holds back (dopri5.f and
    /// dop853.f: 3.25 and 6.1).
    fn stages_and_limit(&self) -> (f64, f64) {
        if self.explicit == Active::Tsit5 { (6.0, 3.25) } else { (12.0, 6.1) }
    }

    fn is_explicit(&self) -> bool {
        self.active == self.explicit
    }

    /// Starts to count anew.
    fn calm(&mut self) {
        self.hits = 0;
        self.clean = 0;
        self.since_trial = 0.0;
        self.saved = 0.0;
        self.on_trial = false;
        self.balance = 0;
    }

    /// Lets Radau5 make the next steps, on trial, if it is time to.
    fn try_radau5(&mut self, equations: &mut Equations<'_>, h: f64) -> CallResult<()> {
        // Of Tsit5 the first trial comes before it has excited fast oscillations within a crude tolerance, which Radau5 would
        // have to follow.
        let is_early = self.is_first && self.jacobian_cost <= AFFORDABLE && h * self.rate > FREE;
        let is_worth_it = self.since_trial >= self.patience * (self.jacobian_cost + WASTE);
        let is_due = is_early || (self.response > FREE && is_worth_it);
        let is_urgent = self.hits >= STIFF_STEPS && self.since_trial >= self.patience * self.jacobian_cost;
        if !(is_due || is_urgent) {
            return Ok(());
        }
        if !self.radau5_has_begun {
            if self.radau5.begin(equations.system).is_err() {
                // No room for its matrices: the explicit method goes on.
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

    /// Back to the explicit method after a trial that was lost: the next one waits longer.
    fn give_up_trial(&mut self) {
        self.leave_radau5();
        if !std::mem::take(&mut self.is_first) {
            self.patience *= 2.0;
        }
    }

    /// Back to the explicit method.
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

    /// Where the explicit method advances less since its return than Radau5 did before, the next one must be
    /// worth more.
    fn judge_return(&mut self) {
        if let Some(rate) = self.left_at.take() {
            let was_right = self.mean_advance >= rate * self.mean_work;
            self.caution = if was_right { (0.5 * self.caution).max(1.0) } else { 2.0 * self.caution };
        }
    }

    /// Ratio of the steps of the explicit method to those of Radau5 where only the error test bounds either,
    /// from the non-stiff problems of `benches/auto.rs` and an oscillator.
    fn reach(&self) -> f64 {
        if self.explicit == Active::Tsit5 { 1.5 } else { 3.0 }
    }

    /// Counts a step of Radau5. Returns the right-hand sides that the explicit method would have saved (or
    /// needed more, below zero), by the steps that its stability and the error test allow it.
    fn enter(&mut self, work: f64, h: f64) -> f64 {
        let (stages, limit) = self.stages_and_limit();
        let saved = work - stages * (h * self.radau5.spectrum().0 / limit).max(1.0 / self.reach());
        self.radau5_work = FORGET * self.radau5_work + work;
        self.radau5_advance = FORGET * self.radau5_advance + h;
        self.ledger -= saved;
        saved
    }

    /// After an accepted step of the explicit method.
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

    /// After an accepted step of Radau5 on trial; returns the step size to go on with.
    fn judge(&mut self, work: f64, h: f64, proposed: f64) -> f64 {
        self.nonlinear += u32::from(self.radau5.contraction() > LINEAR);
        self.enter(work, h);
        let to_beat = if self.is_first {
            // Its steps have not settled yet: the most that stability allows them.
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

    /// After an accepted step of Radau5: is another method the better one? Returns the step size to go on
    /// with.
    fn watch_radau5(&mut self, work: f64, h: f64, proposed: f64) -> f64 {
        if self.only_radau5 {
            return proposed;
        }
        self.nonlinear += u32::from(self.radau5.contraction() > LINEAR);
        let (_, cosine) = self.radau5.spectrum();
        if self.radau5.derivative().len() >= LARGE {
            self.bdf_is_next = self.nonlinear >= NONLINEAR_STEPS && cosine < REAL;
            if self.bdf_is_next {
                return self.first_share * proposed;
            }
        }
        // The right-hand sides that the explicit method would have saved. It takes over when they would have paid for coming back.
        self.saved = (self.saved + self.enter(work, h)).max(0.0);
        if self.saved > self.caution * (self.jacobian_cost + WASTE) {
            // What it cost to come here, and to find out that this phase is over, was more than it has brought.
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
            if !self.bdf_has_begun {
                self.bdf.begin(equations.system)?;
                self.bdf_has_begun = true;
            }
            self.bdf.take_over(trial.x, self.radau5.derivative());
            self.bdf.freshness_mut().take_over(self.radau5.freshness_mut());
            self.active = Active::Bdf;
        }
        let calls = |equations: &Equations<'_>| {
            equations.stats.right_hand_sides + equations.stats.directional_derivatives
        };
        let before = calls(equations);
        let attempt = self.active_mut().try_step(equations, trial, x_new);
        self.work += calls(equations) - before;
        let is_hopeless = matches!(attempt, Ok(Attempt::NotSolved { .. }) | Err(CallError::Discard));
        if self.on_trial && is_hopeless {
            // Equations or a Jacobian that cannot be had here: the explicit method does without.
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
        // At an event the method goes on as it is: the right-hand side of the end of the step is not known.
        if theta < 1.0 {
            return proposed;
        }
        match self.active {
            Active::Radau5 if self.on_trial => return self.judge(work, h, proposed),
            Active::Radau5 => return self.watch_radau5(work, h, proposed),
            Active::Bdf => {}
            Active::Tsit5 | Active::Dop853 => self.watch_explicit(work, h),
        }
        proposed
    }
}
