//! Sensitivity of the cost to each parameter at the start of a fit, and its accuracy there: each is moved
//! once, and the start is simulated more accurately.

use crate::cost::accuracy::Accuracy;
use crate::cost::residual::sum_of_squares;
use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Origin, sort, table};
use crate::findings::shown_text::{digits, visible_line};
use crate::loaded::calibration::Calibration;
use crate::loaded::simulations_around::{Point, Simulations};
use crate::problem::parameter::{Parameter, inner, outer};
use base::RunContext;
use dfo::{ParameterKind, RobustLoss};
use nalgebra::DMatrix;
use ode::Stats;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::thread::available_parallelism;

/// A parameter is moved by this part of its size.
const MOVE: f64 = 0.01;

/// A change below so many times the error of the simulations is none.
const ABOVE_ERROR: f64 = 3.0;

/// From this correlation on two parameters move the outputs the same way.
const CONFOUNDED: f64 = 0.95;

/// Evaluations that a fit by least squares is expected to take are so many for each parameter and one more:
/// about twice what the fits of the Furuta pendulum and the quadruple tank take.
const EVALUATIONS: usize = 12;

/// Options of a [preflight](Calibration::preflight).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct PreflightOptions {
    /// Where; default: the parameters' start values.
    pub start: Option<Vec<f64>>,
    /// Simulations that run at once; default: all cores.
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
    /// Pairs that move the outputs the same way at the start, with the correlation that their estimates would
    /// have.
    pub confounded: Vec<(usize, usize, f64)>,
    /// Cost at the start.
    pub cost: f64,
    /// The same with a tenth of the relative tolerance, or with half the step; `None` where that
    /// simulation failed.
    pub accurate_cost: Option<f64>,
    /// The difference of both relative to the cost (0 where the residuals are all error of the simulations):
    /// `f_tol` below it asks for what the simulations do not tell.
    pub noise: f64,
    /// The method has a fixed step: the accurate cost is that with half of it, and the difference is no
    /// noise.
    #[serde(default)]
    pub is_step_halved: bool,
    /// The step of the simulations in s, where they have one.
    #[serde(default)]
    pub step_size: Option<f64>,
    /// Wall-clock seconds of an evaluation at the start.
    pub seconds_per_evaluation: f64,
    /// Evaluations that a fit by least squares is expected to take: 12 for each free parameter and one more,
    /// a rule of thumb.
    pub expected_evaluations: usize,
    /// Seconds that they take one after the other.
    pub expected_seconds: f64,
    /// Evaluations that may run at once.
    pub workers: usize,
    /// Findings, those that explain others first; empty if there are none.
    pub findings: Vec<Finding>,
    /// Points that were simulated.
    pub n_simulations: usize,
}

/// Effect of moving one parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct ParameterCheck {
    /// Its name.
    pub name: String,
    /// Its start value.
    pub start: f64,
    /// Where it was moved to; `None`: it is fixed.
    pub moved_to: Option<f64>,
    /// Root of the mean squared change of the residuals for a step of the parameter's size (see
    /// [`Parameter::nominal`]), relative to the root of the mean squared range of the measurements; `None`
    /// where nothing was moved or the simulation failed.
    pub sensitivity: Option<f64>,
    /// True if the parameter moves an output by more than the error of the simulations.
    pub has_effect: bool,
    /// Why the simulation failed.
    pub failure: Option<String>,
}

/// Evaluation at the start of a fit that was made before its search.
#[derive(Debug, Clone)]
pub(crate) struct AtStart {
    /// The residuals as they count.
    pub(crate) residuals: Vec<f64>,
    /// Statistics of its simulations.
    pub(crate) stats: Stats,
}

impl Calibration {
    /// Looks before a fit at what would spoil it: each parameter is moved by a hundredth of its size (one
    /// simulation each, in parallel), and the start is simulated once more with a tenth of the relative
    /// tolerance (with a fixed-step method: half the step). The context is looked at on the calling thread.
    ///
    /// # Errors
    /// The wrong number of start values; the simulation fails at the start; [`CalibrationError::Cancelled`].
    pub fn preflight(
        &self,
        options: &PreflightOptions,
        context: &RunContext<'_>,
    ) -> Result<Preflight, CalibrationError> {
        self.preflight_counted(options, &mut None, context, &mut Stats::default())
    }

    /// The same; what its simulations took is added to `stats`. `known`: the residuals at the start, as they
    /// count, and the seconds that they took, which are not simulated again then, and are handed on.
    pub(crate) fn preflight_counted(
        &self,
        options: &PreflightOptions,
        known: &mut Option<AtStart>,
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> Result<Preflight, CalibrationError> {
        let start = options.start.clone().unwrap_or_else(|| self.start());
        self.check_length(&start)?;
        let workers = options.workers.unwrap_or_else(|| available_parallelism().map_or(1, usize::from));
        let mut simulations = Simulations::new(self, options.loss, workers, context)?;
        let AtStart { residuals, stats: of_start } = match known {
            Some(known) => known.clone(),
            None => {
                let at_start = simulations.residuals(&[Point::new(start.clone())])?.swap_remove(0);
                let residuals = at_start.map_err(|message| self.failed_at(&start, message, None))?;
                known.insert(AtStart { residuals, stats: simulations.stats }).clone()
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
        // That of a fixed step is the same wherever the parameters are.
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
                        // Of a step upward, wherever the bounds let it go.
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
        preflight.findings = preflight.judged();
        preflight.findings.extend(self.gaps_of_inputs());
        sort(&mut preflight.findings);
        Ok(preflight)
    }

    /// A value a hundredth of its size away.
    pub(crate) fn moved_a_little(&self, p: &Parameter, x: f64) -> f64 {
        let (lower, upper, from) = (inner(p, p.lower()), inner(p, p.upper()), inner(p, x));
        let by = match p.value_kind() {
            ParameterKind::Continuous => MOVE * self.size_of(p, x),
            _ => 1.0,
        };
        let to = if upper - from >= from - lower { (from + by).min(upper) } else { (from - by).max(lower) };
        outer(p, to)
    }

    /// Root of the mean squared range of the measurements, times their weights, over all outputs; of the
    /// measurements themselves where they do not vary.
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

/// Pairs of columns that are the same but for their length, as far as the others leave it open: by the
/// correlation that estimates with these derivatives have.
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
    fn judged(&self) -> Vec<Finding> {
        let mut said = Vec::new();
        for check in &self.parameters {
            let ParameterCheck { name, moved_to, failure, has_effect, .. } = check;
            let Some(to) = moved_to else { continue };
            match failure {
                Some(reason) => {
                    let sentence = format!("the simulation with {name} = {} fails: {reason}", digits(*to));
                    said.push(Finding::warning(name, sentence, ""));
                }
                None if !has_effect => said.push(
                    Finding::warning(
                        name,
                        format!("{name} moves no output that was measured: a fit cannot find it from here"),
                        "fix it, or measure what it moves",
                    )
                    .of(Origin::Search),
                ),
                None => {}
            }
        }
        for (i, j, correlation) in &self.confounded {
            let (a, b) = (&self.parameters[*i].name, &self.parameters[*j].name);
            let sentence = format!(
                "{a} and {b} move the outputs the same way at the start: correlation {correlation:.2}"
            );
            let finding = Finding::warning(
                format!("{a} and {b}"),
                sentence,
                "the standard errors of the fit say how well each is told; where that is not enough, fix one, give it a prior, or record what tells them apart",
            );
            said.push(finding.of(Origin::Search));
        }
        if self.noise > 1e-3 {
            let remedy = match self.is_step_halved {
                true => {
                    let smaller = Accuracy::smaller_step(self.step_size);
                    format!("{smaller}, or a solver that chooses its steps")
                }
                false => "give a smaller relative_tolerance, or f_tol above that".to_owned(),
            };
            let sentence = format!(
                "the cost at the start changes by {} of its value with {}",
                digits(self.noise),
                Accuracy::words(self.is_step_halved)
            );
            said.push(Finding::warning("cost", sentence, remedy));
        }
        sort(&mut said);
        said
    }

    /// A tolerance of the cost, relative to it, that the simulations can meet: this one, or their noise.
    /// Those of a fixed step have none.
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
            let said = match (&check.failure, check.sensitivity, check.moved_to) {
                (_, _, None) => "fixed".to_owned(),
                (Some(_), ..) => "the simulation fails".to_owned(),
                (_, Some(sensitivity), _) if check.has_effect => digits(sensitivity).to_string(),
                _ => "moves no output".to_owned(),
            };
            writeln!(f, "{:<width$}  {:>12}  {said}", name(&check.name), digits(check.start).to_string())?;
        }
        write!(f, "cost {}", digits(self.cost))?;
        if let Some(accurate) = self.accurate_cost {
            write!(f, ", {} with {}", digits(accurate), Accuracy::words(self.is_step_halved))?;
        }
        writeln!(
            f,
            "\n{} s per evaluation; a fit by least squares of about {} evaluations takes {} s, one after the other ({} workers)",
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
