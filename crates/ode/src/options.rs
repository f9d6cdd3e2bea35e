//! Options of a run: method, tolerances, limits. They are checked once, when a driver is created.

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
    /// [`Tsit5`](Self::Tsit5), or [`Dop853`](Self::Dop853) below a relative tolerance of 1e-7 unless events
    /// are close to each other. Switches to [`Radau5`](Self::Radau5) if trial steps of an implicit method
    /// advance more per right-hand side. Switches to [`Bdf`](Self::Bdf) instead if the largest eigenvalue is
    /// real and the system is nonlinear with 16 or more states, or Newton's method of Radau5 fails
    /// repeatedly.
    #[default]
    Auto,
    /// Tsitouras 5(4), explicit, adaptive.
    Tsit5,
    /// Dormand, Prince and Hairer 8(5,3), explicit, adaptive. For tight tolerances.
    Dop853,
    /// Radau IIA of order 5, implicit, adaptive. For stiff systems and systems with a mass matrix.
    Radau5,
    /// Adams-Moulton of order 1 to 12, adaptive. For systems that are not stiff, with an expensive right-hand
    /// side and few events.
    Adams,
    /// Backward differentiation of order 1 to 5, implicit, adaptive. For stiff systems with an expensive
    /// right-hand side and few events.
    Bdf,
    /// The classical Runge-Kutta method of order 4 with a fixed step.
    Rk4,
    /// The explicit Euler method with a fixed step.
    Euler,
}

impl Method {
    /// All methods.
    pub const ALL: [Self; 8] =
        [Self::Auto, Self::Tsit5, Self::Dop853, Self::Radau5, Self::Adams, Self::Bdf, Self::Rk4, Self::Euler];

    /// Name of the method, as accepted by [`FromStr`].
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Tsit5 => "tsit5",
            Self::Dop853 => "dop853",
            Self::Radau5 => "radau5",
            Self::Adams => "adams",
            Self::Bdf => "bdf",
            Self::Rk4 => "rk4",
            Self::Euler => "euler",
        }
    }

    /// Returns the method that corresponds to a method name of other tools (SciPy, SUNDIALS).
    pub fn of_alias(name: &str) -> Option<Self> {
        const OTHERS: [(&str, Method); 5] = [
            ("rk45", Method::Tsit5),
            ("radau", Method::Radau5),
            ("lsoda", Method::Auto),
            ("cvode", Method::Auto),
            ("cvodes", Method::Auto),
        ];
        OTHERS.into_iter().find(|(other, _)| other.eq_ignore_ascii_case(name)).map(|(_, method)| method)
    }

    /// True if the step size is set by the user, not by an error estimate.
    pub fn is_fixed_step(self) -> bool {
        matches!(self, Self::Rk4 | Self::Euler)
    }

    /// True if the method may use Jacobians.
    pub fn is_implicit(self) -> bool {
        matches!(self, Self::Auto | Self::Radau5 | Self::Adams | Self::Bdf)
    }
}

impl FromStr for Method {
    type Err = OptionsError;

    fn from_str(name: &str) -> Result<Self, OptionsError> {
        let found = Self::ALL.into_iter().find(|method| method.name().eq_ignore_ascii_case(name));
        found.or_else(|| Self::of_alias(name)).ok_or_else(|| OptionsError::UnknownMethod(name.to_owned()))
    }
}

/// Limits that end a run before its final time; `None` means no limit. The numbers of steps and right-hand
/// sides are checked before each trial step, and the number of events before each event.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Limits {
    /// Maximum number of steps, accepted and rejected.
    pub max_steps: Option<u64>,
    /// Maximum number of events.
    pub max_events: Option<u64>,
    /// Maximum number of evaluations of the right-hand side.
    pub max_right_hand_sides: Option<u64>,
    /// Maximum wall-clock time, checked before each step and each evaluation.
    pub timeout: Option<Duration>,
}

/// Policy for state events that follow each other so closely that time hardly advances. The threshold is a
/// hundred state events within 1e-6 of the span. For spans above 1000 units of time, the limit is a
/// thousandth of a unit instead, or the resolution of times if that is larger.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum ChatteringPolicy {
    /// Ends the run with an error that contains the index of the indicator.
    #[default]
    Error,
    /// Continues to locate every event and counts the occurrences in
    /// [`Stats::chattering`](crate::Stats::chattering). The run still fails if time does not advance.
    Warn,
    /// Continues in steps of [`SLIDING_STEP`](Self::SLIDING_STEP) times the span. Events of the chattering
    /// indicators happen at the ends of these steps, wherever in the step the indicators crossed. An
    /// indicator leaves this mode after a hundred such steps without its event.
    ///
    /// If the vector fields on both sides point towards each other, the solution slides between them as
    /// Filippov defines it. Its error is of the order of this step (A. F. Filippov, Differential Equations
    /// with Discontinuous Righthand Sides, 1988, section 8).
    ///
    /// If events change states and accumulate (bounces), the indicator is held at zero, on the side from
    /// which it came in the run. Its sign is ignored: it crosses if it is found on the other side. If its
    /// event leaves the indicator there without letting it pass, the change made by the event is scaled. If
    /// the indicator depends on the changed states, the scaled change sets it to zero at once. Otherwise (a
    /// body whose speed is reversed), the scaled change sets the speed that leads back to zero. States that
    /// the event did not change are never moved. For this case, the threshold is a hundred such events within
    /// ten steps of sliding (at most a thousandth of a unit of time).
    ///
    /// The other indicators are located as usual. [`Stats::chattering`](crate::Stats::chattering) counts the
    /// occurrences. Methods with a fixed step end with the error.
    Slide,
}

impl ChatteringPolicy {
    /// Length of a step of [`Slide`](Self::Slide) as a fraction of the span.
    pub const SLIDING_STEP: f64 = 1e-5;

    /// Names of all policies, as accepted by [`FromStr`].
    pub const NAMES: [&'static str; 3] = ["error", "warn", "slide"];

    /// Name of the policy.
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
    /// `0.01 * relative_tolerance * nominal_i`, the usual rule for FMUs. Follows changes of the nominal
    /// values.
    #[default]
    FromNominals,
    /// One tolerance for all states. Zero means a purely relative tolerance. A state of value zero then has
    /// no tolerance, which is [an error](crate::ErrorKind::NoTolerance) when it happens.
    Scalar(f64),
    /// One tolerance per state, with the meaning of `Scalar`.
    PerState(Vec<f64>),
}

/// Options of a [`Driver`](crate::Driver).
#[derive(Debug, Clone)]
pub struct Options {
    /// The method; default [`Method::Auto`].
    pub method: Method,
    /// Relative tolerance of the adaptive methods; default 1e-6. It does not apply to
    /// [unbounded](crate::HybridSystem::is_unbounded) states. It may be zero if the absolute tolerances are
    /// positive.
    pub relative_tolerance: f64,
    /// Absolute tolerances; default [`AbsoluteTolerance::FromNominals`].
    pub absolute_tolerance: AbsoluteTolerance,
    /// Step of the fixed-step methods in units of time; default: the span divided by 500.
    pub step_size: Option<f64>,
    /// Splits each step of a fixed-step method into two halves, including steps shortened by an input or an
    /// event. Useful for comparison with a run that does not split them. Default `false`.
    pub halve_steps: bool,
    /// Maximum step of the adaptive methods; default: the span. A value that cannot distinguish instants of
    /// the span is an [error](crate::ErrorKind::StepBelowRounding) of the run.
    pub max_step: Option<f64>,
    /// First step of the adaptive methods; default: estimated. It is enlarged if it would not advance time.
    pub first_step: Option<f64>,
    /// Records samples on both sides of every event.
    pub record_events: bool,
    /// Number of points inside each step at which the event indicators are evaluated, in addition to its end.
    /// A crossing and its return can otherwise be missed within one step. Each value is compared with the one
    /// before.
    ///
    /// The default is one point, or three with DOP853 and Radau5, whose steps are long. By default, no points
    /// are used if the step is known to contain an event. Up to 32 points are added if three neighbouring
    /// values bend by more than their distance from zero. Each is in the middle of an adjacent interval.
    ///
    /// Two further checks do not depend on this option. First, the turning points of parabolas through three
    /// neighbouring values are evaluated if they are near zero (below a quarter of these values). This
    /// repeats while they approach zero. Second, an indicator near zero after its event that leads out of its
    /// domain is followed. This ends when it is seen there, or when the run ends with
    /// [`ErrorKind::EventsAccumulate`](crate::ErrorKind).
    pub interior_samples: Option<u32>,
    /// Locates indicators that only jump between a value and its negative to `1e-10 max(|t|, step)` instead
    /// of to rounding. This saves a fifth of the evaluations in models with many such indicators. Default
    /// `false`.
    pub loose_jump_indicators: bool,
    /// Excludes states without a derivative in the equations from the error test, but not from the test of
    /// Newton's method. Applies to differential-algebraic systems integrated by [`Method::Bdf`]. Default
    /// `false`, because their errors in systems of index 1 are of the order of the others' and nothing else
    /// would limit them.
    pub exclude_algebraic: bool,
    /// Limits of the run; default none.
    pub limits: Limits,
    /// Policy for chattering and for accumulating events; default an error.
    pub chattering: ChatteringPolicy,
    /// Flag to set from outside. It ends the run at its next step, evaluation or sample with
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
    /// Returns the relative tolerance. If it is zero, returns the smallest absolute tolerance instead, as if
    /// states were of size 1, because some rules need a relative tolerance.
    pub(crate) fn rtol_or_like(&self) -> f64 {
        let least = match &self.absolute_tolerance {
            _ if self.relative_tolerance > 0.0 => return self.relative_tolerance,
            AbsoluteTolerance::FromNominals => return self.relative_tolerance,
            AbsoluteTolerance::Scalar(v) => *v,
            AbsoluteTolerance::PerState(list) => list.iter().copied().fold(f64::INFINITY, f64::min),
        };
        least.clamp(1e-14, 1e-3)
    }

    /// Checks all values.
    ///
    /// # Errors
    /// Returns [`OptionsError`] with the option and its value.
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
            let range = "at least 1e-14 and below 1, or 0 if absolute tolerances are given";
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

/// An invalid option.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OptionsError {
    /// A number is outside its range.
    #[error("{name} = {} must be {range}", Number(*.value))]
    OutOfRange {
        /// Name of the option.
        name: &'static str,
        /// The value given.
        value: f64,
        /// Condition that the value must meet.
        range: &'static str,
    },
    /// No method has this name.
    #[error("unknown solver '{0}'; expected one of: auto, tsit5, dop853, radau5, adams, bdf, rk4, euler")]
    UnknownMethod(String),
    /// No chattering policy has this name.
    #[error("unknown chattering policy '{0}'; expected one of: error, warn, slide")]
    UnknownChatteringPolicy(String),
}
