//! Small hybrid systems with closed forms, and a recorder.
#![allow(dead_code, unreachable_pub)]

use ode::*;
use std::ops::ControlFlow;

/// Stores all reports of the driver.
#[derive(Default)]
pub struct Recorder {
    pub rows: Vec<(f64, Option<usize>, Side, Vec<f64>)>,
    pub events: Vec<EventRecord>,
    pub stop_after: Option<usize>,
}

impl Observer for Recorder {
    fn sample(&mut self, s: &Sample<'_>) -> ControlFlow<()> {
        let mut row = s.states.to_vec();
        row.extend_from_slice(s.outputs);
        self.rows.push((s.time, s.index, s.side, row));
        if self.stop_after.is_some_and(|n| self.rows.len() >= n) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    }
    fn event(&mut self, e: &EventRecord) {
        self.events.push(*e);
    }
}

impl Recorder {
    pub fn event_times(&self) -> Vec<f64> {
        self.events.iter().map(|e| e.time).collect()
    }
}

/// A smooth system from closures.
pub struct Smooth<F> {
    pub x0: Vec<f64>,
    pub f: F,
}

impl<F: FnMut(f64, &[f64], &mut [f64])> HybridSystem for Smooth<F> {
    fn n_states(&self) -> usize {
        self.x0.len()
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&self.x0);
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        (self.f)(t, x, dx);
        Ok(())
    }
}

/// The ball of the FMI reference models: bounces with restitution `e` until it is slower than `v_min`.
pub struct Ball {
    pub v_min: f64,
    pub resting: bool,
}

impl HybridSystem for Ball {
    fn n_states(&self) -> usize {
        2
    }
    fn n_event_indicators(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&[1.0, 0.0]);
        self.resting = false;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&if self.resting { [0.0, 0.0] } else { [x[1], -9.81] });
        Ok(())
    }
    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = if self.resting || (x[0] == 0.0 && x[1] > 0.0) { 1.0 } else { x[0] };
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        assert_eq!(visit.crossings, [-1]);
        x[0] = 0.0;
        x[1] *= -0.7;
        if x[1] < self.v_min {
            x[1] = 0.0;
            self.resting = true;
        }
        Ok(EventOutcome { states_changed: true, ..EventOutcome::default() })
    }
}

/// Returns the bounce times of [`Ball`] in closed form.
pub fn bounce_times(v_min: f64, most: usize) -> Vec<f64> {
    let (g, e) = (9.81_f64, 0.7);
    let mut v = (2.0 * g).sqrt();
    let mut t = v / g;
    let mut times = vec![t];
    while times.len() < most {
        v *= e;
        if v < v_min {
            break;
        }
        t += 2.0 * v / g;
        times.push(t);
    }
    times
}

/// A congruential generator (D. E. Knuth, The Art of Computer Programming 2, 3.3.4, line 26); numbers in [0, 1).
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
    pub fn of<T: Copy>(&mut self, list: &[T]) -> T {
        list[(self.next() * list.len() as f64) as usize]
    }
}
