//! Options of a run: method, tolerances, limits. Checked once, when a driver is made.

use base::Number;
use serde::{Deserialize, Serialize};
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// The integration method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Method {
    /// [`Tsit5`](Self::Tsit5), below a relative tolerance of 1e-7 [`Dop853`](Self::Dop853); where steps of an
    /// implicit method, made on trial, advance more per right-hand side, [`Radau5`](Self::Radau5), or, for
    /// nonlinear systems of 16 states and more whose largest eigenvalue is real, [`Bdf`](Self::Bdf).
    #[default]
    Auto,
    /// Tsitouras 5(4), explicit, adaptive.
    Tsit5,
    /// Dormand, Prince and Hairer 8(5,3), explicit, adaptive: for tight tolerances.
    Dop853,
    /// Radau IIA of order 5, implicit, adaptive: for stiff systems and systems with a mass matrix.
    Radau5,
    /// Backward differentiation of order 1 to 5, implicit, adaptive: for stiff systems whose right-hand side
    /// is expensive and whose events are rare.
    Bdf,
    /// The classical Runge-Kutta method of order 4 with a fixed step.
    Rk4,
    /// The explicit Euler method with a fixed step.
    Euler,
}

impl Method {
    /// All methods.
    pub const ALL: [Self; 7] =
        [Self::Auto, Self::Tsit5, Self::Dop853, Self::Radau5, Self::Bdf, Self::Rk4, Self::Euler];

    /// The name that [`FromStr`] understands.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Tsit5 => "tsit5",
            Self::Dop853 => "dop853",
            Self::Radau5 => "radau5",
            Self::Bdf => "bdf",
            Self::Rk4 => "rk4",
            Self::Euler => "euler",
        }
    }

    /// The method that stands for one of other tools (SciPy, SUNDIALS), by its name there.
    pub fn standing_for(name: &str) -> Option<Self> {
        const OTHERS: [(&str, Method); 5] = [
            ("rk45", Method::Tsit5),
            ("radau", Method::Radau5),
            ("lsoda", Method::Auto),
            ("cvode", Method::Auto),
            ("cvodes", Method::Auto),
        ];
        OTHERS.into_iter().find(|(other, _)| other.eq_ignore_ascii_case(name)).map(|(_, own)| own)
    }

    /// True if the step size is given by the user instead of by an error estimate.
    pub fn is_fixed_step(self) -> bool {
        matches!(self, Self::Rk4 | Self::Euler)
    }

    /// True if it may take Jacobians.
    pub fn is_implicit(self) -> bool {
        matches!(self, Self::Auto | Self::Radau5 | Self::Bdf)
    }
}

impl FromStr for Method {
    type Err = OptionsError;

    fn from_str(name: &str) -> Result<Self, OptionsError> {
        let found = Self::ALL.into_iter().find(|method| method.name().eq_ignore_ascii_case(name));
        found.or_else(|| Self::standing_for(name)).ok_or_else(|| OptionsError::UnknownMethod(name.to_owned()))
    }
}

/// Limits that end a run before its final time; `None` means no limit. Counts are checked before each trial
/// step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Limits {
    /// Accepted and rejected steps together.
    pub max_steps: Option<u64>,
    /// Events.
    pub max_events: Option<u64>,
    /// Evaluations of the right-hand side.
    pub max_right_hand_sides: Option<u64>,
    /// Wall-clock time; looked at before each step and each evaluation.
    pub timeout: Option<Duration>,
}

/// Policy where state events follow each other so closely that time hardly advances: a hundred of them within
/// 1e-6 of the span; in spans above 1000 units of time, within a thousandth of one (or as close as times can
/// be told apart).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum ChatteringPolicy {
    /// End the run with an error that names the indicators.
    #[default]
    Error,
    /// Go on locating every event, and count it in [`Stats::chattering`](crate::Stats::chattering); an error
    /// still where time stands still.
    Warn,
    /// Go on in steps of [`SLIDING_STEP`](Self::SLIDING_STEP) of the span, at whose ends the events happen
    /// wherever in the step the indicators that chatter crossed, each until a hundred such steps have passed
    /// without its event. Where the vector fields on both sides point to each other, the solution slides
    /// between them as Filippov defines it, up to an error of the order of this step (A. F. Filippov,
    /// Differential Equations with Discontinuous Righthand Sides, 1988, section 8). Where events change
    /// states and accumulate (bounces), the indicator is held at zero, on the side that it came from in the
    /// run, whatever its sign: it crosses where it is found on the other side. Where its event leaves it
    /// there and has not let it pass, what the event changes is made as strong as it takes: to zero at once
    /// where the indicator depends on it, else (a body whose speed is reversed) with the speed that leads
    /// back to zero. States that the event has not changed are never moved. For this a hundred such events
    /// within ten steps of sliding (at most a thousandth of a unit of time) are too many. The other
    /// indicators are located as ever. Counted in [`Stats::chattering`](crate::Stats::chattering), too.
    /// Methods with a fixed step end with the error.
    Slide,
}

impl ChatteringPolicy {
    /// Length of a step of [`Slide`](Self::Slide), as a share of the span.
    pub const SLIDING_STEP: f64 = 1e-5;

    /// All policies by the names that [`FromStr`] understands.
    pub const NAMES: [&'static str; 3] = ["error", "warn", "slide"];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Error => "error",
            Self::Warn => "warn",
            Self::Slide => "slide",
        }
    }
}

impl FromStr for ChatteringPolicy {
    type Err = OptionsError;

    fn from_str(name: &str) -> Result<Self, OptionsError> {
        match name.to_ascii_lowercase().as_str() {
            "error" => Ok(Self::Error),
            "warn" => Ok(Self::Warn),
            "slide" => Ok(Self::Slide),
            _ => Err(OptionsError::UnknownChatteringPolicy(name.to_owned())),
        }
    }
}

/// Absolute tolerances of the states.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub enum AbsoluteTolerance {
    /// `0.01 * relative_tolerance * nominal_i`, the rule that users of FMUs know; follows changed nominals.
    #[default]
    FromNominals,
    /// The same for all states. Zero is a purely relative tolerance: a state of value zero has none then,
    /// which is [an error](crate::ErrorKind::NoTolerance) when it happens.
    Scalar(f64),
    /// One per state, each as above.
    PerState(Vec<f64>),
}

/// Options of a [`Driver`](crate::Driver).
#[derive(Debug, Clone)]
pub struct Options {
    /// The method; default [`Method::Auto`].
    pub method: Method,
    /// Relative tolerance of the adaptive methods; default 1e-6. Not of
    /// [unbounded](crate::HybridSystem::is_unbounded) states. Zero where positive absolute tolerances are
    /// given.
    pub relative_tolerance: f64,
    /// Absolute tolerances; default [`AbsoluteTolerance::FromNominals`].
    pub absolute_tolerance: AbsoluteTolerance,
    /// Step of the fixed-step methods in units of time; default: a 500th of the span.
    pub step_size: Option<f64>,
    /// Take each step of a fixed-step method in two halves, also one that an input or an event has cut: for
    /// comparison with a run that does not. Default `false`.
    pub halve_steps: bool,
    /// Largest step of the adaptive methods; default: the span. One that cannot tell instants of the span
    /// apart is an [error](crate::ErrorKind::StepBelowRounding) of the run.
    pub max_step: Option<f64>,
    /// First step of the adaptive methods; default: estimated. Made larger where it would not advance time.
    pub first_step: Option<f64>,
    /// Also sample both sides of every event.
    pub record_events: bool,
    /// Points inside each step at which the event indicators are looked at too, so that a crossing and its
    /// return do not hide in one step; each is compared with the one before. Default: one (three with DOP853
    /// and Radau5, whose steps are long), none where an event is known to lie in the step, and up to 32 more
    /// where three neighbouring values bend by more than they stay away from zero, in the middle of the
    /// interval beside them. Whatever this is, the turning points of parabolas through three neighbouring
    /// values are looked at where they lie near zero (below a quarter of these values), again and again while
    /// they come nearer; and an indicator next to zero after its event, that leads out of its domain, is
    /// followed until it is seen there or the run ends with
    /// [`ErrorKind::EventsAccumulate`](crate::ErrorKind).
    pub interior_samples: Option<u32>,
    /// Locate indicators that only jump between a value and its negative to `1e-10 max(|t|, step)` instead of
    /// to rounding: a fifth of the evaluations less, for models that have many such. Default `false`.
    pub loose_jump_indicators: bool,
    /// In differential-algebraic systems integrated by [`Method::Bdf`]: leave states that have no derivative
    /// in the equations out of the error test, but not out of Newton's. Default `false`: in systems of index
    /// 1 their errors are of the order of the others', and nothing else would limit them.
    pub exclude_algebraic: bool,
    /// Limits; default none.
    pub limits: Limits,
    /// Answer to chattering, and to events that accumulate; default an error.
    pub chattering: ChatteringPolicy,
    /// Set from outside to end the run at its next step, evaluation or sample with
    /// [`ErrorKind::Cancelled`](crate::ErrorKind).
    pub cancel: Option<Arc<AtomicBool>>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            method: Method::Auto,
            relative_tolerance: 1e-6,
            absolute_tolerance: AbsoluteTolerance::FromNominals,
            step_size: None,
            halve_steps: false,
            max_step: None,
            first_step: None,
            record_events: false,
            interior_samples: None,
            loose_jump_indicators: false,
            exclude_algebraic: false,
            limits: Limits::default(),
            chattering: ChatteringPolicy::Error,
            cancel: None,
        }
    }
}

impl Options {
    /// The relative tolerance, or what stands for it in rules that need one where it is zero: the smallest
    /// absolute tolerance, as if states were of the size 1.
    pub(crate) fn rtol_or_like(&self) -> f64 {
        let least = match &self.absolute_tolerance {
            _ if self.relative_tolerance > 0.0 => return self.relative_tolerance,
            AbsoluteTolerance::FromNominals => return self.relative_tolerance,
            AbsoluteTolerance::Scalar(v) => *v,
            AbsoluteTolerance::PerState(list) => list.iter().copied().fold(f64::INFINITY, f64::min),
        };
        least.clamp(1e-14, 1e-3)
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`OptionsError`] names the option and its value.
    pub fn check(&self) -> Result<(), OptionsError> {
        let positive = |name: &'static str, value: Option<f64>| match value {
            Some(v) if !(v > 0.0 && v.is_finite()) => {
                Err(OptionsError::OutOfRange { name, value: v, range: "positive and finite" })
            }
            _ => Ok(()),
        };
        let rtol = self.relative_tolerance;
        let given = match &self.absolute_tolerance {
            AbsoluteTolerance::FromNominals => None,
            AbsoluteTolerance::Scalar(v) => Some(std::slice::from_ref(v)),
            AbsoluteTolerance::PerState(list) => Some(list.as_slice()),
        };
        if !((rtol == 0.0 && given.is_some()) || (1e-14..1.0).contains(&rtol)) {
            let range = "at least 1e-14 and below 1, or 0 where absolute tolerances are given";
            return Err(OptionsError::OutOfRange { name: "relative_tolerance", value: rtol, range });
        }
        for &value in given.unwrap_or_default() {
            let name = "absolute_tolerance";
            if rtol == 0.0 {
                positive(name, Some(value))?;
            } else if !(value >= 0.0 && value.is_finite()) {
                return Err(OptionsError::OutOfRange { name, value, range: "finite and not negative" });
            }
        }
        positive("step_size", self.step_size)?;
        positive("max_step", self.max_step)?;
        positive("first_step", self.first_step)
    }
}

/// An option that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OptionsError {
    /// A number outside its range.
    #[error("{name} = {} must be {range}", Number(*.value))]
    OutOfRange {
        /// Name of the option.
        name: &'static str,
        /// The value given.
        value: f64,
        /// Condition that it must meet.
        range: &'static str,
    },
    /// No method has this name.
    #[error("unknown solver '{0}'; there are: auto, tsit5, dop853, radau5, bdf, rk4, euler")]
    UnknownMethod(String),
    /// No policy for chattering has this name.
    #[error("unknown answer to chattering '{0}'; there are: error, warn, slide")]
    UnknownChatteringPolicy(String),
}
