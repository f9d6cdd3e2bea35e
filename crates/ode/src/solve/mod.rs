//! Integration of equations given as closures, with a stored solution.

mod dense;
mod system;

pub use dense::DenseOutput;
pub use system::Event;

use crate::driver::Driver;
use crate::error::{Report, SimulationError};
use crate::observer::{Observer, Sample, StepView};
use crate::options::{AbsoluteTolerance, Method, Options, OptionsError};
use crate::sparsity::JacobianPattern;
use crate::system::{Argument, Direction};
use std::ops::{ControlFlow, Range};
use system::{ClosureSystem, Form, Rows};

/// Integrates `x' = f(t, x)`: `rhs(t, x, dx)` fills in the right-hand side. The span may lead backward
/// (`1.0..0.0`). If the right-hand side is NaN or infinite, a smaller step is tried.
///
/// ```
/// use ode::{Event, Method};
/// let solution = ode::solve(|_, x, dx| dx.copy_from_slice(&[x[1], -9.81]), 0.0..1.0, &[1.0, 0.0])
///     .method(Method::Tsit5)
///     .times(&[0.1, 0.2])
///     .event(Event::new(|_, x| x[0]).terminal(1))
///     .run()?;
/// assert!((solution.states[1][0] - (1.0 - 0.5 * 9.81 * 0.04)).abs() < 1e-9);
/// assert!((solution.events[0][0].0 - (2.0 / 9.81f64).sqrt()).abs() < 1e-9);
/// # Ok::<(), ode::SolveError>(())
/// ```
pub fn solve<'a>(rhs: impl FnMut(f64, &[f64], &mut [f64]) + 'a, span: Range<f64>, x0: &[f64]) -> Solve<'a> {
    Solve::new(Form::Explicit(Box::new(rhs)), span, x0.to_vec(), Options::default())
}

/// Integrates `F(t, x, x') = 0` (index 0 or 1): `residual(t, x, dx, r)` fills in `F`. The method is
/// [`Method::Bdf`].
///
/// The values of `x0` are used for states whose derivative appears in the equations. The other values of `x0`
/// and all of `dx0` are guesses, which are corrected until the equations hold.
///
/// A system of a higher index ends with [`ErrorKind::HigherIndex`](crate::ErrorKind), which reports the
/// states concerned (except with sparse matrices of more than 500 states). If `dF/dx'` is singular at the
/// guess but regular near it, the run ends with [`ErrorKind::InconsistentSlopes`](crate::ErrorKind).
///
/// ```
/// // x' = -y with y = 2 x, from a wrong guess of y.
/// let residual = |_: f64, x: &[f64], dx: &[f64], r: &mut [f64]| {
///     r[0] = dx[0] + x[1];
///     r[1] = x[1] - 2.0 * x[0];
/// };
/// let solution = ode::solve_dae(residual, 0.0..1.0, &[1.0, 0.0], &[0.0, 0.0]).relative_tolerance(1e-8).run()?;
/// assert!((solution.last()[0] - (-2f64).exp()).abs() < 1e-7);
/// assert!((solution.states[0][1] - 2.0).abs() < 1e-12);
/// # Ok::<(), ode::SolveError>(())
/// ```
pub fn solve_dae<'a>(
    residual: impl FnMut(f64, &[f64], &[f64], &mut [f64]) + 'a,
    span: Range<f64>,
    x0: &[f64],
    dx0: &[f64],
) -> Solve<'a> {
    let options = Options { method: Method::Bdf, ..Options::default() };
    Solve::new(Form::Residual(Box::new(residual), dx0.to_vec()), span, x0.to_vec(), options)
}

/// Integrates `x'' = f(t, x, x')`: `acceleration(t, x, v, a)` fills in `a`. The states of the solution are
/// `[x, v]`.
///
/// ```
/// let solution = ode::solve_second_order(|_, x, _, a| a[0] = -x[0], 0.0..1.0, &[1.0], &[0.0]).run()?;
/// assert!((solution.last()[0] - 1f64.cos()).abs() < 1e-5 && (solution.last()[1] + 1f64.sin()).abs() < 1e-5);
/// # Ok::<(), ode::SolveError>(())
/// ```
pub fn solve_second_order<'a>(
    acceleration: impl FnMut(f64, &[f64], &[f64], &mut [f64]) + 'a,
    span: Range<f64>,
    x0: &[f64],
    v0: &[f64],
) -> Solve<'a> {
    let mut acceleration = acceleration;
    let n = x0.len();
    let rhs = move |t: f64, x: &[f64], dx: &mut [f64]| {
        let ((x, v), (dx, dv)) = (x.split_at(n), dx.split_at_mut(n));
        dx.copy_from_slice(v);
        acceleration(t, x, v, dv);
    };
    let mut solve = Solve::new(Form::Explicit(Box::new(rhs)), span, [x0, v0].concat(), Options::default());
    if v0.len() != n {
        solve.wrong_length = Some(("v0", v0.len(), n));
    }
    solve
}

/// Builder of an integration, returned by [`solve`], [`solve_dae`] and [`solve_second_order`].
#[must_use = "nothing is integrated before `run`"]
pub struct Solve<'a> {
    system: ClosureSystem<'a>,
    span: Range<f64>,
    options: Options,
    times: Option<Vec<f64>>,
    keeps_steps: bool,
    wrong_length: Option<(&'static str, usize, usize)>,
}

/// Reason why [`Solve::run`] failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SolveError {
    /// An option is invalid.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// The length of an argument differs from the number of states.
    #[error("{name}: expected {wanted} values, got {given}")]
    Length {
        /// Name of the argument.
        name: &'static str,
        /// Number of values given.
        given: usize,
        /// Number of values expected.
        wanted: usize,
    },
    /// The integration failed.
    #[error(transparent)]
    Simulation(#[from] Box<SimulationError>),
}

/// Result of an integration.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Requested times, or the ends of the steps if no times were requested. If an event changed the states,
    /// both sides of the event are listed.
    pub times: Vec<f64>,
    /// States at these times.
    pub states: Vec<Vec<f64>>,
    /// Times and preceding states of the occurrences of each event function.
    pub events: Vec<Vec<(f64, Vec<f64>)>>,
    /// Reason of the end and cost of the run.
    pub report: Report,
    /// The solution as a function of time, if [requested](Solve::dense_output).
    pub dense: Option<DenseOutput>,
}

impl Solution {
    /// States at the last of the times; empty if there are no times.
    pub fn last(&self) -> &[f64] {
        self.states.last().map_or(&[], Vec::as_slice)
    }
}

impl<'a> Solve<'a> {
    fn new(form: Form<'a>, span: Range<f64>, x0: Vec<f64>, options: Options) -> Self {
        let system = ClosureSystem::new(form, x0);
        Self { system, span, options, times: None, keeps_steps: false, wrong_length: None }
    }

    /// Sets the method; default [`Method::Auto`].
    pub fn method(mut self, method: Method) -> Self {
        self.options.method = method;
        self
    }

    /// Sets the relative tolerance; default 1e-6.
    pub fn relative_tolerance(mut self, tolerance: f64) -> Self {
        self.options.relative_tolerance = tolerance;
        self
    }

    /// Sets the absolute tolerance of all states; default a hundredth of the relative tolerance.
    pub fn absolute_tolerance(mut self, tolerance: f64) -> Self {
        self.options.absolute_tolerance = AbsoluteTolerance::Scalar(tolerance);
        self
    }

    /// Sets the absolute tolerances, one per state.
    pub fn absolute_tolerances(mut self, tolerances: &[f64]) -> Self {
        self.options.absolute_tolerance = AbsoluteTolerance::PerState(tolerances.to_vec());
        self
    }

    /// Changes any of the options.
    pub fn options(mut self, change: impl FnOnce(&mut Options)) -> Self {
        change(&mut self.options);
        self
    }

    /// Sets the times of the solution, in the order of the integration and within the span; default: the ends
    /// of the steps.
    pub fn times(mut self, times: &[f64]) -> Self {
        self.times = Some(times.to_vec());
        self
    }

    /// Also stores the solution as a function of time.
    pub fn dense_output(mut self) -> Self {
        self.keeps_steps = true;
        self
    }

    /// Adds an event function.
    pub fn event(mut self, event: Event<'a>) -> Self {
        self.system.events.push(event);
        self
    }

    /// Sets the function that is called at events: `change(t, x, which)` may change the states `x`. `which`
    /// contains the positions of the event functions that have crossed.
    pub fn on_event(mut self, change: impl FnMut(f64, &mut [f64], &[usize]) + 'a) -> Self {
        self.system.on_event = Some(Box::new(change));
        self
    }

    /// Sets the Jacobian of the right-hand side: `jacobian(t, x, j)` fills in `j[i + n k] = d f_i / d x_k`.
    /// The entries are zero on entry. Default: finite differences.
    pub fn jacobian(mut self, mut jacobian: impl FnMut(f64, &[f64], &mut [f64]) + 'a) -> Self {
        self.system.jacobian = Some(Box::new(move |t, x, _, _, j| jacobian(t, x, j)));
        self
    }

    /// Sets the Jacobians of a residual: `jacobian(t, x, dx, argument, j)` fills in the Jacobian with respect
    /// to `argument`, by columns. The entries are zero on entry. Default: finite differences.
    pub fn residual_jacobian(
        mut self,
        jacobian: impl FnMut(f64, &[f64], &[f64], Argument, &mut [f64]) + 'a,
    ) -> Self {
        self.system.jacobian = Some(Box::new(jacobian));
        self
    }

    /// Sets the positions `(i, k)` at which equation `i` depends on state `k` (or its derivative). Columns
    /// without a common row are computed from a single difference.
    pub fn pattern(mut self, pattern: JacobianPattern) -> Self {
        self.system.pattern = Some(pattern);
        self
    }

    /// Sets the constant matrix `M` of `M x' = f(t, x)`, by columns; see
    /// [`mass_matrix`](crate::HybridSystem::mass_matrix).
    pub fn mass_matrix(mut self, mass: &[f64]) -> Self {
        self.system.mass = Some(mass.to_vec());
        self
    }

    /// Runs the integration.
    ///
    /// # Errors
    /// Returns an error if an option or argument is invalid, or if the integration fails. The error contains
    /// the reason, the point of failure and the numbers at that point.
    pub fn run(self) -> Result<Solution, SolveError> {
        let Self { mut system, span, options, times, keeps_steps, wrong_length } = self;
        let n = system.x0.len();
        let of_slopes = match &system.form {
            Form::Residual(_, dx0) if dx0.len() != n => Some(("dx0", dx0.len(), n)),
            _ => wrong_length,
        };
        if let Some((name, given, wanted)) = of_slopes {
            return Err(SolveError::Length { name, given, wanted });
        }
        system.keeps_rows = times.is_none();
        let dense = keeps_steps.then(|| DenseOutput::new(n));
        let mut kept = Kept { rows: Rows::default(), dense };
        let mut driver = Driver::new(options)?;
        let times = times.unwrap_or_default();
        let report = driver.run(&mut system, span.start, span.end, &times, &mut kept)?;
        let Rows { times, states, .. } = if system.keeps_rows { system.rows } else { kept.rows };
        let events = system.events.into_iter().map(|event| event.occurrences).collect();
        Ok(Solution { times, states, events, report, dense: kept.dense })
    }
}

/// Record of the samples and steps that the driver reports.
struct Kept {
    rows: Rows,
    dense: Option<DenseOutput>,
}

impl Observer for Kept {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        self.rows.push(sample.time, sample.states);
        ControlFlow::Continue(())
    }
    fn needs_steps(&self) -> bool {
        self.dense.is_some()
    }
    fn step(&mut self, step: &StepView<'_>) {
        if let Some(dense) = &mut self.dense {
            dense.push(step);
        }
    }
}

impl<'a> Event<'a> {
    /// Creates an event that occurs when `function(t, x)` becomes positive or stops being positive.
    pub fn new(function: impl FnMut(f64, &[f64]) -> f64 + 'a) -> Self {
        Self {
            function: Box::new(function),
            direction: Direction::Either,
            terminal: 0,
            occurrences: Vec::new(),
        }
    }

    /// Sets the crossings that count as events, in the direction of the integration.
    pub fn direction(mut self, direction: Direction) -> Self {
        self.direction = direction;
        self
    }

    /// Ends the run at this occurrence (1: the first).
    pub fn terminal(mut self, occurrence: usize) -> Self {
        self.terminal = occurrence;
        self
    }
}
