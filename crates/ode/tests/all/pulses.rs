//! A force that acts between two events. No method may step over it.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::*;
use ode::*;

/// Method by which the right-hand side detects the force and the two instants are declared.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    /// The right-hand side reads the time; indicators `t - a`, `t - b`.
    Rising,
    /// As `Rising`, with `a - t`, `b - t`: zero already belongs to the new domain.
    Falling,
    /// The right-hand side reads the time, and the force acts at both instants.
    Closed,
    /// One indicator, negative between the instants, and an event that sets a mode.
    Mode,
    /// Announced time events; the right-hand side reads the time.
    Clock,
    /// Announced time events that set a mode.
    ClockMode,
    /// One indicator that depends on a state; the right-hand side reads that state.
    State,
}

/// `x_i' = -(x_i - u_i)`, where only the last has a force `u`, and a state that equals the time.
struct Pulse {
    kind: Kind,
    n: usize,
    span: (f64, f64),
    amplitude: f64,
    acts: bool,
    visits: Vec<(f64, Vec<i8>)>,
}

impl HybridSystem for Pulse {
    fn n_states(&self) -> usize {
        self.n + 1
    }
    fn n_event_indicators(&self) -> usize {
        match self.kind {
            Kind::Rising | Kind::Falling | Kind::Closed => 2,
            Kind::Mode | Kind::State => 1,
            Kind::Clock | Kind::ClockMode => 0,
        }
    }
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.fill(0.0);
        x[self.n] = t0;
        self.acts = false;
        self.visits.clear();
        let next_time = matches!(self.kind, Kind::Clock | Kind::ClockMode).then_some(self.span.0);
        Ok(EventOutcome { next_time, ..EventOutcome::default() })
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        let (a, b) = self.span;
        let acts = match self.kind {
            Kind::Rising | Kind::Falling | Kind::Clock => a < t && t < b,
            Kind::Closed => a <= t && t <= b,
            Kind::State => a < x[self.n] && x[self.n] < b,
            Kind::Mode | Kind::ClockMode => self.acts,
        };
        dx.iter_mut().zip(x).for_each(|(d, x)| *d = -x);
        dx[self.n - 1] += if acts { self.amplitude } else { 0.0 };
        dx[self.n] = 1.0;
        Ok(())
    }
    fn event_indicators(&mut self, t: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        let (a, b) = self.span;
        match self.kind {
            Kind::Rising | Kind::Closed => z.copy_from_slice(&[t - a, t - b]),
            Kind::Falling => z.copy_from_slice(&[a - t, b - t]),
            Kind::Mode => z[0] = (t - a) * (t - b),
            Kind::State => z[0] = (x[self.n] - a) * (x[self.n] - b),
            Kind::Clock | Kind::ClockMode => {}
        }
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        self.visits.push((visit.time, visit.crossings.to_vec()));
        self.acts = !self.acts;
        let clock = matches!(self.kind, Kind::Clock | Kind::ClockMode) && self.visits.len() == 1;
        Ok(EventOutcome { next_time: clock.then_some(self.span.1), ..EventOutcome::default() })
    }
}

const ADAPTIVE: [Method; 5] = [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf];
const KINDS: [Kind; 7] =
    [Kind::Rising, Kind::Falling, Kind::Closed, Kind::Mode, Kind::Clock, Kind::ClockMode, Kind::State];

#[test]
fn force_between_two_events_is_integrated() {
    let mut wrong = Vec::new();
    for method in ADAPTIVE.into_iter().chain([Method::Rk4, Method::Euler]) {
        for kind in KINDS {
            for (length, area) in [(10.0, 10.0), (1.0, 1.0), (1e-2, 1.0), (1e-5, 0.5), (1e-7, 0.5)] {
                for n in [1, 40] {
                    for rtol in [1e-3, 1e-6, 1e-9] {
                        // Instants are known only to 1e-14, so the area of such a short pulse is not accurate
                        // to nine digits.
                        let too_short = length < 1e-6 && rtol < 1e-6;
                        if too_short || method.is_fixed_step() && (length < 1.0 || rtol != 1e-6) {
                            continue;
                        }
                        let span = (5.0, 5.0 + length);
                        let end = span.1 + 4.0;
                        let amplitude = area / length;
                        let mut pulse = Pulse { kind, n, span, amplitude, acts: false, visits: Vec::new() };
                        let options = Options { method, relative_tolerance: rtol, ..Options::default() };
                        let mut seen = Recorder::default();
                        let mut driver = Driver::new(options).unwrap();
                        let report = driver.run(&mut pulse, 0.0, end, &[end], &mut seen);
                        let name = format!("{} {kind:?} {length:e} n {n} at {rtol:e}", method.name());
                        let Ok(report) = report.map_err(|e| wrong.push(format!("{name}: {e}"))) else {
                            continue;
                        };
                        let exact = amplitude * -(-length).exp_m1() * (span.1 - end).exp();
                        let off = (seen.rows[0].3[n - 1] - exact).abs();
                        let most = if method.is_fixed_step() { 0.02 } else { 100.0 * rtol };
                        if off > most || report.stats.events != 2 {
                            wrong.push(format!("{name}: off by {off:e} of {exact}, {:?}", report.stats));
                        }
                        for ((t, crossings), expected) in pulse.visits.iter().zip([span.0, span.1]) {
                            assert!((t - expected).abs() < 1e-9 * end, "{name}: event at {t}");
                            assert!(
                                matches!(kind, Kind::Clock | Kind::ClockMode)
                                    || crossings.iter().any(|c| *c != 0)
                            );
                        }
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{} wrong:\n{}", wrong.len(), wrong[..wrong.len().min(20)].join("\n"));
}
