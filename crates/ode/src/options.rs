//! What a run may be told: method, tolerances, limits. Checked once, when a driver is made.

use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// The integration method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Method {
    /// The driver's choice; at present [`Tsit5`](Self::Tsit5).
    #[default]
    Auto,
    /// Tsitouras 5(4), explicit, adaptive.
    Tsit5,
    /// The classical Runge-Kutta method of order 4 with a fixed step.
    Rk4,
    /// The explicit Euler method with a fixed step.
    Euler,
}

impl Method {
    /// All methods by the names that [`FromStr`] understands.
    pub const NAMES: [&'static str; 4] = ["auto", "tsit5", "rk4", "euler"];

    /// The name that [`FromStr`] understands.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Tsit5 => "tsit5",
            Self::Rk4 => "rk4",
            Self::Euler => "euler",
        }
    }

    /// Whether the step size is given by the user instead of by an error estimate.
    pub fn is_fixed_step(self) -> bool {
        matches!(self, Self::Rk4 | Self::Euler)
    }
}

impl FromStr for Method {
    type Err = OptionsError;

    fn from_str(name: &str) -> Result<Self, OptionsError> {
        match name.to_ascii_lowercase().as_str() {
            "auto" => Ok(Self::Auto),
            "tsit5" => Ok(Self::Tsit5),
            "rk4" => Ok(Self::Rk4),
            "euler" => Ok(Self::Euler),
            "dop853" | "radau5" | "bdf" => Err(OptionsError::MethodNotYet(name.to_owned())),
            _ => Err(OptionsError::UnknownMethod(name.to_owned())),
        }
    }
}

/// What ends a run before its time; `None` means no limit. Limits are looked at before each trial step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Limits {
    /// Accepted and rejected steps together.
    pub max_steps: Option<u64>,
    /// Events.
    pub max_events: Option<u64>,
    /// Evaluations of the right-hand side.
    pub max_right_hand_sides: Option<u64>,
    /// Wall-clock time; looked at between calls into the model, at every step.
    pub timeout: Option<Duration>,
}

/// What to do when state events follow each other so closely that time hardly advances.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum ChatteringPolicy {
    /// End the run with an error that names the indicators.
    #[default]
    Error,
}

/// Absolute tolerances of the states.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub enum AbsoluteTolerance {
    /// `0.01 * relative_tolerance * nominal_i`, the rule that users of FMUs know; follows changed nominals.
    #[default]
    FromNominals,
    /// The same for all states.
    Scalar(f64),
    /// One per state.
    PerState(Vec<f64>),
}

/// Options of a [`Driver`](crate::Driver).
#[derive(Debug, Clone)]
pub struct Options {
    /// The method; default [`Method::Auto`].
    pub method: Method,
    /// Relative tolerance of the adaptive methods; default 1e-6.
    pub relative_tolerance: f64,
    /// Absolute tolerances; default [`AbsoluteTolerance::FromNominals`].
    pub absolute_tolerance: AbsoluteTolerance,
    /// Step of the fixed-step methods in units of time; default: a 500th of the span.
    pub step_size: Option<f64>,
    /// Largest step of the adaptive methods; default: the span.
    pub max_step: Option<f64>,
    /// First step of the adaptive methods; default: estimated.
    pub initial_step: Option<f64>,
    /// Also sample both sides of every event.
    pub record_events: bool,
    /// Limits; default none.
    pub limits: Limits,
    /// Answer to chattering; default an error.
    pub chattering: ChatteringPolicy,
    /// Set from outside to end the run at its next step with [`ErrorKind::Cancelled`](crate::ErrorKind).
    pub cancel: Option<Arc<AtomicBool>>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            method: Method::Auto,
            relative_tolerance: 1e-6,
            absolute_tolerance: AbsoluteTolerance::FromNominals,
            step_size: None,
            max_step: None,
            initial_step: None,
            record_events: false,
            limits: Limits::default(),
            chattering: ChatteringPolicy::Error,
            cancel: None,
        }
    }
}

impl Options {
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
        if !(1e-14..1.0).contains(&rtol) {
            return Err(OptionsError::OutOfRange {
                name: "relative_tolerance",
                value: rtol,
                range: "at least 1e-14 and below 1",
            });
        }
        match &self.absolute_tolerance {
            AbsoluteTolerance::FromNominals => {}
            AbsoluteTolerance::Scalar(v) => positive("absolute_tolerance", Some(*v))?,
            AbsoluteTolerance::PerState(list) => {
                for v in list {
                    positive("absolute_tolerance", Some(*v))?;
                }
            }
        }
        positive("step_size", self.step_size)?;
        positive("max_step", self.max_step)?;
        positive("initial_step", self.initial_step)
    }
}

/// An option that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OptionsError {
    /// A number outside its range.
    #[error("{name} = {value} must be {range}")]
    OutOfRange {
        /// Name of the option.
        name: &'static str,
        /// The value given.
        value: f64,
        /// What it must be.
        range: &'static str,
    },
    /// No method has this name.
    #[error("unknown solver '{0}'; there are: auto, tsit5, rk4, euler")]
    UnknownMethod(String),
    /// The name is reserved for a method that is not there yet.
    #[error("solver '{0}' is not available in this version; there are: auto, tsit5, rk4, euler")]
    MethodNotYet(String),
}
