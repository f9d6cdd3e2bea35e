//! Test problems with reference values. The values were computed in quadruple precision with Radau IIA of
//! order 19, at two tolerances that agree in all digits shown. They agree with the published values of the
//! test set of Bari and CWI (F. Mazzia, C. Magherini) within the accuracy of those values.
#![allow(dead_code, unreachable_pub)]

pub mod hybrid;
pub mod large;
pub mod nonstiff;
pub mod stiff;
pub mod tuning;

use ode::*;
use std::ops::ControlFlow;

/// A smooth initial value problem with the state at its end.
#[derive(Debug, Clone)]
pub struct Problem {
    pub name: &'static str,
    pub x0: Vec<f64>,
    pub end: f64,
    pub f: fn(f64, &[f64], &mut [f64]),
    /// Sparsity pattern of the Jacobian, if known.
    pub pattern: Option<JacobianPattern>,
    /// Every `stride`-th state at the end.
    pub reference: Vec<f64>,
    pub stride: usize,
    /// Ratio of absolute to relative tolerance.
    pub atol: f64,
    /// True if the error is the largest error divided by the largest component, instead of the largest
    /// relative error.
    pub by_largest: bool,
}

impl Default for Problem {
    fn default() -> Self {
        Self {
            name: "",
            x0: Vec::new(),
            end: 1.0,
            f: |_, _, _| {},
            pattern: None,
            reference: Vec::new(),
            stride: 1,
            atol: 1.0,
            by_largest: false,
        }
    }
}

impl HybridSystem for Problem {
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
    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        self.pattern.as_ref()
    }
}

/// Stores the last sample.
struct Last(Vec<f64>);

impl Observer for Last {
    fn sample(&mut self, s: &Sample<'_>) -> ControlFlow<()> {
        self.0.clear();
        self.0.extend_from_slice(s.states);
        ControlFlow::Continue(())
    }
}

impl Problem {
    pub fn options(&self, method: Method, rtol: f64) -> Options {
        let absolute_tolerance = AbsoluteTolerance::Scalar(rtol * self.atol);
        Options { method, relative_tolerance: rtol, absolute_tolerance, ..Options::default() }
    }

    pub fn digits(&self, x: &[f64]) -> f64 {
        let largest = self.reference.iter().fold(0.0f64, |a, r| a.max(r.abs()));
        let error = |(r, x): (&f64, &f64)| (x - r).abs() / if self.by_largest { largest } else { r.abs() };
        -self
            .reference
            .iter()
            .zip(x.iter().step_by(self.stride))
            .map(error)
            .fold(0.0, f64::max)
            .max(1e-17)
            .log10()
    }

    /// Runs the problem. Returns the state at the end and the cost.
    pub fn end_state(&self, options: Options) -> Result<(Vec<f64>, Stats), Box<SimulationError>> {
        let mut last = Last(Vec::new());
        let mut driver = Driver::new(options).unwrap();
        let report = driver.run(&mut self.clone(), 0.0, self.end, &[self.end], &mut last)?;
        Ok((last.0, report.stats))
    }

    /// Runs the problem. Returns the correct digits and the cost.
    pub fn solve(&self, options: Options) -> Result<(f64, Stats), Box<SimulationError>> {
        let (x, stats) = self.end_state(options)?;
        Ok((self.digits(&x), stats))
    }

    pub fn run(&self, method: Method, rtol: f64) -> (f64, Stats) {
        match self.solve(self.options(method, rtol)) {
            Ok(done) => done,
            Err(e) => panic!("{} by {} at {rtol:e}: {e} {:?}", self.name, method.name(), e.stats),
        }
    }
}

/// Returns the problems on which `auto` is compared with the best method.
pub fn judging() -> Vec<Problem> {
    use {large::*, nonstiff::*, stiff::*};
    vec![
        hires(),
        rober(),
        orego(),
        vdpol(),
        vdpolm(),
        e5_1e3(),
        e5_1e5(),
        pollu(),
        ring_modulator(),
        medical_akzo(),
        brusselator(),
        brusselator_line(),
        heat(),
        beam(),
        pleiades(),
        two_body(),
        lorenz(),
        van_der_pol(),
    ]
}
