//! Hybrid systems with closed forms.

use ode::*;

/// x' = -sign(x) from 1: slides along x = 0 from t = 1 on.
pub struct Relay(pub f64);

impl HybridSystem for Relay {
    fn n_states(&self) -> usize {
        1
    }
    fn n_event_indicators(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x[0] = 1.0;
        self.0 = 1.0;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, _: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx[0] = -self.0;
        Ok(())
    }
    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = x[0];
        Ok(())
    }
    fn handle_event(&mut self, _: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        self.0 = if x[0] > 0.0 { 1.0 } else { -1.0 };
        Ok(EventOutcome::default())
    }
}

/// x'' = -x - 0.1 sign(x') from 0.95: turns at every multiple of pi, at -.75, .55, -.35, .15, then sticks at .05.
pub struct Coulomb(pub f64);

impl HybridSystem for Coulomb {
    fn n_states(&self) -> usize {
        2
    }
    fn n_event_indicators(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&[0.95, 0.0]);
        self.0 = -1.0;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&if self.0 == 0.0 { [0.0, 0.0] } else { [x[1], -x[0] - 0.1 * self.0] });
        Ok(())
    }
    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = if self.0 == 0.0 { 1.0 } else { self.0 * x[1] + 1e-12 };
        Ok(())
    }
    fn handle_event(&mut self, _: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        x[1] = 0.0;
        self.0 = if x[0].abs() <= 0.1 { 0.0 } else { -x[0].signum() };
        Ok(EventOutcome { states_changed: true, ..EventOutcome::default() })
    }
}

/// (sin 2 pi t, cos 2 pi t) as a state; an indicator `sin 2 pi t + 0.99` and any number of others from a function of time.
pub struct Turning {
    pub also: fn(f64) -> Vec<f64>,
    /// Crossings and their times.
    pub seen: Vec<(f64, Vec<i8>)>,
    /// The next announced time event, once.
    pub announced: Option<f64>,
}

impl HybridSystem for Turning {
    fn n_states(&self) -> usize {
        2
    }
    fn n_event_indicators(&self) -> usize {
        1 + (self.also)(0.0).len()
    }
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        let phase = 2.0 * std::f64::consts::PI * t0;
        x.copy_from_slice(&[phase.sin(), phase.cos()]);
        Ok(EventOutcome { next_time: self.announced, ..EventOutcome::default() })
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        let w = 2.0 * std::f64::consts::PI;
        dx.copy_from_slice(&[w * x[1], -w * x[0]]);
        Ok(())
    }
    fn event_indicators(&mut self, t: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = x[0] + 0.99;
        z[1..].copy_from_slice(&(self.also)(t));
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        self.seen.push((visit.time, visit.crossings.to_vec()));
        self.announced = self.announced.filter(|next| *next > visit.time + 1e-9);
        Ok(EventOutcome { next_time: self.announced, ..EventOutcome::default() })
    }
}
