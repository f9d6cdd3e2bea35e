//! Sensitivity of the cost to each parameter at the start of a fit, and its accuracy there. Each parameter is
//! moved once, and the start is simulated once more with higher accuracy.

use crate::cost::accuracy::Accuracy;
use crate::cost::residual::sum_of_squares;
use crate::error::CalibrationError;
use crate::findings::display_text::{digits, visible_line};
use crate::findings::finding::{Finding, Origin, sort, table};
use crate::findings::identifier::FindingId;
use crate::loaded::calibration::Calibration;
use crate::loaded::simulations_around::{Point, Simulations};
use crate::problem::parameter::{Parameter, inner, outer};
use base::RunContext;
use dfo::{ParameterKind, RobustLoss};
use nalgebra::DMatrix;
use ode::Stats;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Relative size of the step of a parameter.
const MOVE: f64 = 0.01;

/// A change counts as an effect if it exceeds this multiple of the simulation error.
const ABOVE_ERROR: f64 = 3.0;

/// Correlation from which two parameters count as confounded.
const CONFOUNDED: f64 = 0.95;

/// Expected evaluations of a least-squares fit, for each parameter and one more. It is about twice the number
/// that the fits of the Furuta pendulum and the quadruple tank need.
const EVALUATIONS: usize = 12;

/// Options of a [preflight](Calibration::preflight).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct PreflightOptions {
    /// Point to check; default: the start values of the parameters.
    pub start: Option<Vec<f64>>,
    /// Number of parallel simulations; default: all cores.
    pub workers: Option<usize>,
    /// Loss function: the contribution of a residual to the cost.
    pub loss: RobustLoss,
}

/// Result of a preflight. `Display` prints a table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct Preflight {
    /// One entry per parameter.
    pub parameters: Vec<ParameterCheck>,
    /// Pairs of parameters with similar effects on the outputs at the start, and the correlation that their
    /// estimates would have.
    pub confounded: Vec<(usize, usize, f64)>,
    /// Cost at the start.
    pub cost: f64,
    /// Cost at the start with a tenth of the relative tolerance, or with half the step; `None` if that
    /// simulation failed.
    pub accurate_cost: Option<f64>,
    /// Difference of the two costs relative to the cost; 0 if the residuals are only simulation error. An
    /// `f_tol` below it cannot be reached.
    pub noise: f64,
    /// True if the method uses a fixed step. The accurate cost is then the cost with half the step, and the
    /// difference is not noise.
    #[serde(default)]
    pub is_step_halved: bool,
    /// Step of the simulations in s, if they have one.
    #[serde(default)]
    pub step_size: Option<f64>,
    /// Wall-clock time of an evaluation at the start, in s.
    pub seconds_per_evaluation: f64,
    /// Expected evaluations of a least-squares fit: 12 for each free parameter and one more, a rule of thumb.
    pub expected_evaluations: usize,
    /// Expected run time of the evaluations in s, run one after the other.
    pub expected_seconds: f64,
    /// Number of evaluations that may run in parallel.
    pub workers: usize,
    /// Findings, sorted so that causes come first; empty if there are none.
    pub findings: Vec<Finding>,
    /// Number of simulated points.
    pub n_simulations: usize,
}

/// Effect of moving one parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct ParameterCheck {
    /// Name of the parameter.
    pub name: String,
    /// Start value of the parameter.
    pub start: f64,
    /// Value after the step; `None` if the parameter is fixed.
    pub moved_to: Option<f64>,
    /// Root mean square of the change of the residuals for a step of the parameter's size (see
    /// [`Parameter::nominal`]). It is relative to the root mean square of the ranges of the measurements.
    /// `None` if nothing was moved or the simulation failed.
    pub sensitivity: Option<f64>,
    /// True if the parameter changes an output by more than the simulation error.
    pub has_effect: bool,
    /// Reason for the failure of the simulation; `None` if it succeeded.
    pub failure: Option<String>,
}

/// Evaluation at the start of a fit, made before its search.
#[derive(Debug, Clone)]
pub(crate) struct AtStart {
    /// Residuals as they count in the cost.
    pub(crate) residuals: Vec<f64>,
    /// Statistics of the simulations.
    pub(crate) stats: Stats,
}

impl Calibration {
    /// Checks the start of a fit for problems. Each parameter is moved by a hundredth of its size, with one
    /// simulation each, in parallel. The start is simulated once more with a tenth of the relative tolerance
    /// (half the step for a fixed-step method). The context is checked on the calling thread.
    ///
    /// # Errors
    /// Returns an error if the number of start values is wrong, if the simulation fails at the start, or for
    /// a design, which has no recordings. Returns [`CalibrationError::Cancelled`] if the context has ended.
    pub fn preflight(
        &self,
        options: &PreflightOptions,
        context: &RunContext<'_>,
    ) -> Result<Preflight, CalibrationError> {
        if !self.problem().goals.is_empty() {
            let message = "preflight: a design has no recordings. Estimate the effects of the parameters by a sensitivity analysis";
            return Err(CalibrationError::Setup(message.to_owned()));
        }
        self.preflight_counted(options, &mut None, context, &mut Stats::default())
    }

    /// Checks the start and adds the statistics of its simulations to `stats`. If `at_start` contains the
    /// evaluation at the start, it is not simulated again. Otherwise the evaluation is stored in `at_start`.
    pub(crate) fn preflight_counted(
        &self,
        options: &PreflightOptions,
        at_start: &mut Option<AtStart>,
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> Result<Preflight, CalibrationError> {
        let start = options.start.clone().unwrap_or_else(|| self.start());
        self.check_length(&start)?;
        let workers = options.workers.unwrap_or_else(base::available_cores);
        let mut simulations = Simulations::new(self, options.loss, workers, context)?;
        let AtStart { residuals, stats: of_start } = match at_start {
            Some(at_start) => at_start.clone(),
            None => {
                let evaluated = simulations.residuals(&[Point::new(start.clone())])?.swap_remove(0);
                let residuals = evaluated.map_err(|message| self.failed_at(&start, message, None))?;
                at_start.insert(AtStart { residuals, stats: simulations.stats }).clone()
            }
        };
        let seconds_per_evaluation = of_start.seconds.get();
        let parameters = self.parameters();
        let free: Vec<usize> =
            (0..start.len()).filter(|&i| parameters[i].lower() < parameters[i].upper()).collect();
        let mut points = vec![Point { x: start.clone(), is_accurate: true }];
        points.extend(free.iter().map(|&i| {
            let mut x = start.clone();
            x[i] = self.moved_a_little(&parameters[i], start[i]);
            Point::new(x)
        }));
        let mut found = simulations.residuals(&points)?;
        *stats += simulations.stats;
        let moved = found.split_off(1);
        let accurate = found.swap_remove(0).ok();
        let norm = |changed: &[f64]| {
            changed.iter().zip(&residuals).map(|(c, r)| (c - r) * (c - r)).sum::<f64>().sqrt()
        };
        let is_step_halved = self.has_fixed_step();
        // The error of a fixed step is the same for all parameter values.
        let error = accurate.as_deref().filter(|_| !is_step_halved).map_or(0.0, norm);
        let n_root = (residuals.len() as f64).sqrt();
        let range = self.range_of_measurements();
        let mut checks: Vec<ParameterCheck> = (parameters.iter().zip(&start))
            .map(|(p, x)| ParameterCheck {
                name: p.name().to_owned(),
                start: *x,
                moved_to: None,
                sensitivity: None,
                has_effect: false,
                failure: None,
            })
            .collect();
        let mut columns: Vec<(usize, Vec<f64>)> = Vec::new();
        for ((&i, found), point) in free.iter().zip(&moved).zip(&points[1..]) {
            let (p, check) = (&parameters[i], &mut checks[i]);
            check.moved_to = Some(point.x[i]);
            match found {
                Ok(changed) => {
                    let step = inner(p, point.x[i]) - inner(p, start[i]);
                    let change = norm(changed);
                    check.sensitivity =
                        Some(change / n_root / (step.abs() / self.size_of(p, start[i])) / range);
                    check.has_effect = change > ABOVE_ERROR * error && change > 0.0;
                    if check.has_effect {
                        // The change is converted to an upward step, whichever direction the bounds
                        // allowed.
                        let by = |(c, r): (&f64, &f64)| step.signum() * (c - r);
                        columns.push((i, changed.iter().zip(&residuals).map(by).collect()));
                    }
                }
                Err(reason) => check.failure = Some(reason.clone()),
            }
        }
        let (cost, accurate_cost) = (sum_of_squares(&residuals), accurate.as_deref().map(sum_of_squares));
        let expected_evaluations = EVALUATIONS * (free.len() + 1);
        let mut preflight = Preflight {
            parameters: checks,
            confounded: confounded(&columns),
            cost,
            accurate_cost,
            noise: match accurate_cost {
                Some(accurate) if !self.is_within_tolerance(cost) => (accurate - cost).abs() / cost,
                _ => 0.0,
            },
            is_step_halved,
            step_size: self.step_in_use(),
            seconds_per_evaluation,
            expected_evaluations,
            expected_seconds: seconds_per_evaluation * expected_evaluations as f64,
            workers,
            findings: Vec::new(),
            n_simulations: simulations.n,
        };
        preflight.findings = preflight.assessed();
        preflight.findings.extend(self.gaps_of_inputs());
        sort(&mut preflight.findings);
        Ok(preflight)
    }

    /// Returns a value that differs by a hundredth of its size.
    pub(crate) fn moved_a_little(&self, p: &Parameter, x: f64) -> f64 {
        let (lower, upper, from) = (inner(p, p.lower()), inner(p, p.upper()), inner(p, x));
        let by = match p.value_kind() {
            ParameterKind::Continuous => MOVE * self.size_of(p, x),
            _ => 1.0,
        };
        let to = if upper - from >= from - lower { (from + by).min(upper) } else { (from - by).max(lower) };
        outer(p, to)
    }

    /// Returns the root mean square of the weighted ranges of the measurements over all outputs. If the
    /// measurements are constant, their absolute values are used instead.
    fn range_of_measurements(&self) -> f64 {
        let mean_square = |of_output: &dyn Fn(&[f64]) -> f64| {
            let outputs = self.residual_layout().outputs.iter();
            let squares: Vec<f64> = outputs
                .map(|o| {
                    let weighted: Vec<f64> = o.measured.iter().zip(&o.weights).map(|(y, w)| y * w).collect();
                    of_output(&weighted).powi(2)
                })
                .collect();
            (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
        };
        let extent = |y: &[f64]| {
            let (low, high) =
                y.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), y| (l.min(*y), h.max(*y)));
            if high > low { high - low } else { 0.0 }
        };
        let size = |y: &[f64]| y.iter().fold(0.0, |size: f64, y| size.max(y.abs()));
        [mean_square(&extent), mean_square(&size)].into_iter().find(|range| *range > 0.0).unwrap_or(1.0)
    }
}

/// Returns the pairs of nearly parallel columns, given the other columns. The measure is the correlation of
/// estimates with these derivatives.
fn confounded(columns: &[(usize, Vec<f64>)]) -> Vec<(usize, usize, f64)> {
    let p = columns.len();
    let unit = |column: &[f64]| {
        let length = column.iter().map(|c| c * c).sum::<f64>().sqrt();
        column.iter().map(|c| c / length).collect::<Vec<f64>>()
    };
    let units: Vec<Vec<f64>> = columns.iter().map(|(_, column)| unit(column)).collect();
    let dot = |a: usize, b: usize| units[a].iter().zip(&units[b]).map(|(a, b)| a * b).sum::<f64>();
    let gram = DMatrix::from_fn(p, p, dot);
    let inverse = gram.clone().try_inverse();
    let correlation = |a: usize, b: usize| {
        let along = -gram[(a, b)];
        let Some(inverse) = &inverse else { return along };
        let scale = (inverse[(a, a)] * inverse[(b, b)]).sqrt();
        let found = inverse[(a, b)] / scale;
        if found.is_finite() && found.abs() > along.abs() { found.clamp(-1.0, 1.0) } else { along }
    };
    (0..p)
        .flat_map(|a| (a + 1..p).map(move |b| (a, b)))
        .map(|(a, b)| (columns[a].0, columns[b].0, correlation(a, b)))
        .filter(|(_, _, correlation)| correlation.abs() >= CONFOUNDED)
        .collect()
}

impl Preflight {
    fn assessed(&self) -> Vec<Finding> {
        let mut reported = Vec::new();
        for check in &self.parameters {
            let ParameterCheck { name, moved_to, failure, has_effect, .. } = check;
            let Some(to) = moved_to else { continue };
            match failure {
                Some(reason) => {
                    let sentence = format!("the simulation with {name} = {} fails: {reason}", digits(*to));
                    let remedy = "Choose another start value, or bounds that exclude such values";
                    reported.push(Finding::warning(FindingId::FailedNearStart, name, sentence, remedy));
                }
                None if !has_effect => reported.push(
                    Finding::warning(
                        FindingId::ParameterWithoutEffect,
                        name,
                        format!("{name} changes no measured output at the start. A fit cannot determine it from there"),
                        "Fix it, or measure an output that it changes",
                    )
                    .of(Origin::Search),
                ),
                None => {}
            }
        }
        for (i, j, correlation) in &self.confounded {
            let (a, b) = (&self.parameters[*i].name, &self.parameters[*j].name);
            let sentence = format!(
                "{a} and {b} change the outputs in the same way at the start (correlation {correlation:.2}). The data may determine only a \
                 combination of them"
            );
            let finding = Finding::warning(
                FindingId::CorrelatedParameters,
                format!("{a} and {b}"),
                sentence,
                "If their standard errors are too large after the fit, fix one, add a prior, or record an experiment that distinguishes them",
            );
            reported.push(finding.of(Origin::Search));
        }
        if self.noise > 1e-3 {
            let remedy = match self.is_step_halved {
                true => {
                    let smaller = Accuracy::smaller_step(self.step_size);
                    format!("{smaller}, or use a solver that chooses its steps")
                }
                false => "Set a smaller relative_tolerance, or a larger f_tol".to_owned(),
            };
            let sentence = format!(
                "the cost at the start changes by {} of its value with {}. Smaller changes of the cost are simulation errors",
                digits(self.noise),
                Accuracy::words(self.is_step_halved)
            );
            reported.push(Finding::warning(FindingId::InaccurateSimulation, "cost", sentence, remedy));
        }
        sort(&mut reported);
        reported
    }

    /// Returns a relative tolerance of the cost that the simulations can meet: the larger of `f_tol` and
    /// their noise. With a fixed step, it is `f_tol`.
    pub fn f_tol_above_noise(&self, f_tol: f64) -> f64 {
        if self.is_step_halved { f_tol } else { f_tol.max(self.noise) }
    }
}

impl fmt::Display for Preflight {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |name: &str| visible_line(name).into_owned();
        let width = self.parameters.iter().map(|p| name(&p.name).len()).max().unwrap_or(0).max(9);
        writeln!(f, "{:<width$}  {:>12}  sensitivity", "parameter", "start")?;
        for check in &self.parameters {
            let reported = match (&check.failure, check.sensitivity, check.moved_to) {
                (_, _, None) => "fixed".to_owned(),
                (Some(_), ..) => "the simulation fails".to_owned(),
                (_, Some(sensitivity), _) if check.has_effect => digits(sensitivity).to_string(),
                _ => "changes no output".to_owned(),
            };
            writeln!(
                f,
                "{:<width$}  {:>12}  {reported}",
                name(&check.name),
                digits(check.start).to_string()
            )?;
        }
        write!(f, "cost {}", digits(self.cost))?;
        if let Some(accurate) = self.accurate_cost {
            write!(f, ", {} with {}", digits(accurate), Accuracy::words(self.is_step_halved))?;
        }
        writeln!(
            f,
            "\n{} s per evaluation; a least-squares fit of about {} evaluations takes {} s without parallel simulations ({} workers)",
            digits(self.seconds_per_evaluation),
            self.expected_evaluations,
            digits(self.expected_seconds),
            self.workers
        )?;
        match self.findings.is_empty() {
            true => Ok(()),
            false => writeln!(f, "{}", table(&self.findings).trim_start()),
        }
    }
}
