//! Values of criteria, computed from the signals of a simulation.

use super::pieces::{Pieces, SignalPieces, larger};
use crate::expression::Functional;

/// Fraction of a step within which the response has settled, unless another one is given; the default of
/// `stepinfo` in MATLAB.
pub(super) const BAND: f64 = 0.02;

/// Criterion over the signals with these indices.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Resolved {
    pub(super) functional: Functional,
    /// Index of the signal. A functional that compares with a reference at each time has the difference as
    /// its signal.
    pub(super) signal: usize,
    /// Index of the reference of a step response; without one, the final value is the reference.
    pub(super) reference: Option<usize>,
    /// Fraction of the step within which a response has settled.
    pub(super) band: f64,
}

impl Resolved {
    /// Returns the value of the criterion. `at_end`: right limits of the signals at the end.
    pub(super) fn value(&self, pieces: &Pieces, at_end: &[f64]) -> f64 {
        let signal = pieces.signal(self.signal);
        let last = at_end.get(self.signal).copied().unwrap_or(f64::NAN);
        let Some((start, end)) = signal.span() else {
            return if self.functional == Functional::Final { last } else { f64::NAN };
        };
        let length = end - start;
        match self.functional {
            Functional::Final => last,
            Functional::Max => signal.max(),
            Functional::Min => signal.min(),
            Functional::Integral => signal.integral(|_, y| y),
            Functional::Mean => signal.integral(|_, y| y) / length,
            Functional::Energy | Functional::Ise => signal.integral(|_, y| y * y),
            Functional::Rms => (signal.integral(|_, y| y * y) / length).sqrt(),
            Functional::Iae => signal.integral_between_zeros(|_, y| y.abs()),
            Functional::Itae => signal.integral_between_zeros(|t, y| (t - start) * y.abs()),
            Functional::CrossingTime => signal.first_crossing(0.0).unwrap_or(end),
            Functional::Overshoot | Functional::RiseTime | Functional::SettlingTime => {
                let reference =
                    self.reference.map_or(last, |index| at_end.get(index).copied().unwrap_or(f64::NAN));
                self.of_step(signal, reference, end)
            }
        }
    }

    /// Returns a property of the response to a step from the initial value of the signal to the reference.
    fn of_step(&self, signal: SignalPieces<'_>, reference: f64, end: f64) -> f64 {
        let (begin, initial) = (signal.span().map_or(end, |(start, _)| start), signal.first());
        let step = reference - initial;
        if step == 0.0 || !step.is_finite() {
            return f64::NAN;
        }
        match self.functional {
            Functional::Overshoot => {
                let peak = if step > 0.0 { signal.max() } else { signal.min() };
                100.0 * larger((peak - reference) / step, 0.0)
            }
            Functional::SettlingTime => {
                signal.last_outside(reference, self.band * step.abs()).map_or(0.0, |last| last - begin)
            }
            _ => {
                let time = |fraction: f64| signal.first_crossing(initial + fraction * step).unwrap_or(end);
                time(0.9)
                    - if signal.first_crossing(initial + 0.1 * step).is_some() { time(0.1) } else { begin }
            }
        }
    }
}
