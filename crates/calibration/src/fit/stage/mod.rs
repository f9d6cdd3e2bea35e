//! The fit: what is asked for, the search, and the uncertainty of its result; parameters with names come out.

mod engine;
mod fresh;
mod noise;
mod options;
mod result;
mod rounds;
mod search;
mod tolerance;

pub use engine::Engine;
pub use noise::{EstimatedNoise, FitNoise, NoiseRule, OutputNoise};
pub use options::{FitObserver, FitOptions};
pub use result::Fit;
pub(crate) use rounds::{add_earlier, checkpoint_of, ended_by};
pub use tolerance::ChosenTolerance;

use crate::cost::batch::Simulations;
use crate::cost::calibration::Calibration;
use crate::cost::residual::{CostRule, sum_of_squares};
use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Severity};
use crate::fit::output_fit::KeptResiduals;
use crate::fit::phase::FitPhase;
use crate::problem::objective::CostKind;
use crate::problem::parameter::{Parameter, Scale};
use crate::problem::residual_layout::ResidualLayout;
use crate::uncertainty::active_bounds::{Findings, is_over};
use crate::uncertainty::estimate::{KnownPoint, SEARCH, Uncertainty, UncertaintyOptions, digits};
use base::RunContext;
use dfo::{Measure, Report, RobustLoss, Termination, Tolerances, typical_size};
use ode::{Number, Stats};
use rounds::Made;
use search::{Job, Searched};

/// With a relative tolerance of this size or more a search ends anywhere.
const LOOSE: f64 = 0.1;

impl Calibration {
    /// Tolerances of the search that mean nothing. An absolute `f_tol` may be above the cost, which is 0
    /// where there is no noise.
    fn loose(&self, tolerances: &Tolerances, x: &[f64]) -> Option<Finding> {
        let Tolerances { x_tol, f_tol, measure, .. } = *tolerances;
        let said: Vec<String> = match measure {
            Measure::Relative => {
                let given =
                    [("x_tol", x_tol, "of the size of each parameter"), ("f_tol", f_tol, "of the cost")];
                let loose = given.into_iter().filter(|(_, tolerance, _)| *tolerance >= LOOSE);
                loose
                    .map(|(name, tolerance, of)| format!("{name} {} is a part {of}", Number(tolerance)))
                    .collect()
            }
            Measure::Absolute => {
                let free = self.parameters().iter().zip(x).filter(|(p, _)| p.lower() < p.upper());
                let sizes = free.map(|(p, x)| (p.name(), self.size_of(p, *x)));
                let loose = sizes.filter(|(_, size)| x_tol >= LOOSE * size);
                let said = |(name, size)| {
                    format!("x_tol {} is absolute, {name} has the size {}", Number(x_tol), digits(size))
                };
                loose.map(said).collect()
            }
        };
        (!said.is_empty()).then(|| {
            let sentence = format!("{}: the search may end far from the minimum", said.join(", "));
            Finding::new(Severity::Warning, "tolerances", sentence, "leave them out, or give 1e-4, relative")
        })
    }

    /// Fits the parameters.
    ///
    /// Simulations run on threads of their own where they are long enough for that; the calling thread
    /// observes and polls. Evaluations that can no longer matter are given up early (see
    /// [`dfo::Outcome::Above`]); this changes no decision.
    ///
    /// # Errors
    /// Options that cannot be used, simulations that fail at every starting point, a run ended before any
    /// point had a cost. Every other end, early ones included, is a [`Fit`] with the best point seen.
    pub fn fit<'a>(&self, options: impl Into<FitOptions<'a>>) -> Result<Fit, CalibrationError> {
        self.fit_and_keep(options.into(), None).map(|(fit, _)| fit)
    }

    /// The same, with the residuals that the run has computed, by the weights of this calibration; within a
    /// time that has begun already, or begins now.
    pub(crate) fn fit_and_keep(
        &self,
        options: FitOptions<'_>,
        within: Option<RunContext<'_>>,
    ) -> Result<(Fit, KeptResiduals), CalibrationError> {
        let mut job = Job::new(self, options, within)?;
        let mut stats = Stats::default();
        let made = self.made(&mut job, &mut stats);
        let Made { own, searched, noise, tolerance } = match made {
            Err(error) if !job.context.is_cancelled() => Made::of(self.start_alone(&job, error)?),
            made => made?,
        };
        // With the weights and the tolerance of the fit.
        let own = own.as_ref().unwrap_or(self);
        let Searched { report, found, residuals, preflight, solver, tolerances, raised } = searched;
        let Job { start, held, objective, loss, context, phase, uncertainty, .. } = &job;
        let mut remarks = raised;
        remarks.extend(self.unstated_noise(&job, noise.as_ref()));
        if let Some(reason) = self.runs_here_by_its_inputs() {
            let sentence = format!("the FMU ran in this process: {reason}");
            remarks.push(Finding::new(Severity::Note, "isolation", sentence, ""));
        }
        remarks.extend(own.loose(&tolerances, &report.x));
        phase.set(FitPhase::Checks);
        let is_whole = uncertainty.is_some() && held.is_empty();
        let (at_start, at_end) =
            own.plain_residuals((start, &report.x), (&residuals, *loss), context, &mut stats);
        if let Some(at_end) = at_end.as_deref().filter(|_| is_whole && is_over(&report.termination)) {
            let (from, to) = ((start.as_slice(), at_start.as_deref()), (report.x.as_slice(), at_end));
            remarks.extend(own.check_after_fit(from, to, context, &mut stats));
        } else if is_whole && report.termination == Termination::MaxTime {
            remarks.extend(own.check_of_setup(&report.x));
        }
        if let Some(at_end) = at_end.as_deref().filter(|_| noise == Some(FitNoise::Stated)) {
            remarks.extend(noise::contradictions_of_stated(own, at_end));
        }
        let outputs =
            at_end.as_deref().map_or_else(Vec::new, |at_end| own.output_fits_of(at_end, at_start.as_deref()));
        phase.set(FitPhase::Uncertainty);
        let uncertainty =
            uncertainty.clone().filter(|_| objective.has_uncertainty()).and_then(|mut options| {
                options.workers = options.workers.or(job.run.workers);
                options.held.extend(held);
                let asked =
                    UncertaintyOptions { loss: *loss, is_likelihood: objective.is_likelihood(), ..options };
                let known = report.residuals.as_deref().or(at_end.as_deref());
                let uncertainty =
                    own.uncertainty_of_fit((&report, &found, known), &tolerances, asked, context, &mut stats);
                if uncertainty.is_none() && is_over(&report.termination) && context.is_late() {
                    let sentence = "the time was up before the standard errors were known";
                    remarks.push(Finding::new(Severity::Warning, "max_time", sentence, ""));
                }
                uncertainty
            });
        if let Some(at_end) =
            at_end.as_deref().filter(|_| own.has_fixed_step() && uncertainty.is_none() && is_whole)
        {
            remarks.extend(own.large_step_after_fit((&report.x, at_end), context, &mut stats));
        }
        let start_cost =
            report.trace.iter().find(|e| e.x == start.as_slice()).and_then(|e| e.outcome.value());
        let is_start = report.trace.is_empty() && report.fun.is_finite();
        let start_cost = start_cost.or(Some(report.fun).filter(|_| is_start));
        let is_estimated = noise.as_ref().is_some_and(|noise| noise.estimated().is_some());
        // The last of several searches began elsewhere.
        let known_start = residuals.at_start().filter(|_| is_estimated).map(sum_of_squares);
        let start_cost = start_cost.or(known_start);
        let mut rms =
            |x: &[f64], cost: Option<f64>| match (objective.is_sum_of_squares() && !is_estimated, cost) {
                (true, cost) => cost.map(|cost| self.rms(x, cost, *loss)),
                // Of another cost, or by other weights, the residuals have to be known.
                (false, None) => None,
                (false, Some(_)) => match residuals.at((x, start)) {
                    Some(known) => Some(self.rms_of(known, own.residual_layout())),
                    None => {
                        let found = own.cost_and_residuals(x, (objective, *loss), context, &mut stats);
                        found.map(|(_, residuals)| self.rms_of(&residuals, own.residual_layout()))
                    }
                },
            };
        let names: Vec<String> = self.parameters().iter().map(|p| p.name().to_owned()).collect();
        let mut shown_names: Vec<String> =
            self.parameters().iter().map(|p| p.shown_name().to_owned()).collect();
        if shown_names == names {
            shown_names.clear();
        }
        let description = self.fmu().description();
        let unit = |p: &Parameter| p.unit(description).map(str::to_owned);
        let fit = Fit {
            units: self.parameters().iter().map(unit).collect(),
            bounds: self.parameters().iter().map(|p| (p.lower(), p.upper())).collect(),
            model: description.model_name.clone(),
            n_measurements: self.n_measurements(),
            in_this_process: self.isolation().1.map(str::to_owned),
            noise,
            tolerance,
            x: report.x.clone(),
            names,
            shown_names,
            outputs,
            preflight,
            setup_findings: remarks,
            uncertainty,
            cost: report.fun,
            rms: rms(&report.x, Some(report.fun)).unwrap_or(f64::NAN),
            tied: self.tied_values(&report.x),
            start_cost,
            start_rms: rms(start, start_cost),
            objective: objective.name().to_owned(),
            start: start.clone(),
            stages: Vec::new(),
            at_bound: found.at_bound,
            without_effect: found.without_effect,
            n_checks: found.n_checks,
            stats,
            solver,
            report,
        };
        let residuals = residuals.reweighed(own.residual_layout(), self.residual_layout());
        Ok((fit, residuals))
    }

    /// The root of the mean squared residual of the measurements by the weights of this calibration, as they
    /// count, from residuals by other weights.
    pub(crate) fn rms_of(&self, residuals: &[f64], weights: &ResidualLayout) -> f64 {
        let own = self.residual_layout().reweighed(residuals, weights);
        let n = self.n_measurements();
        (sum_of_squares(&own[..n]) / n as f64).sqrt()
    }

    /// The cost at `x` and the residuals there, as they count; `None` where the simulation fails.
    pub(crate) fn cost_and_residuals(
        &self,
        x: &[f64],
        (kind, loss): (&CostKind, RobustLoss),
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> Option<(f64, Vec<f64>)> {
        let mut residuals = vec![0.0; self.n_residuals()];
        let sum = self.evaluate_into(x, CostRule::whole(loss, context), &mut residuals, stats).ok()?;
        let outcome = kind.outcome(self.residual_layout(), (sum, &residuals), &mut Vec::new());
        Some((outcome.value()?, residuals))
    }

    /// Uncertainty of the result of a run, from the residuals there, without a loss, where they are known;
    /// `None` where it cannot be estimated, or is not requested.
    pub(crate) fn uncertainty_of_fit(
        &self,
        (report, found, residuals): (&Report, &Findings, Option<&[f64]>),
        tolerances: &Tolerances,
        mut options: UncertaintyOptions,
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> Option<Uncertainty> {
        if !is_over(&report.termination) || context.is_over() {
            return None;
        }
        let workers = options.workers.unwrap_or(1);
        let mut simulations = Simulations::new(self, (RobustLoss::default(), workers), context).ok()?;
        let (inert, criterion) = (&found.without_effect, options.criterion());
        let at_bound = found.at_bound.iter().map(|(index, _)| index);
        options.held.extend(at_bound.filter(|index| !inert.contains(index)));
        let known = KnownPoint {
            // Those of a stage with a window of its own are others.
            residuals: residuals.filter(|r| r.len() == self.n_residuals()),
            jacobian: report.jacobian.as_deref(),
            held: options.held,
            inert,
            f_tol: match tolerances.measure {
                Measure::Relative => tolerances.f_tol,
                Measure::Absolute => tolerances.f_tol / report.fun.abs(),
            },
            criterion,
        };
        let uncertainty = self.uncertainty_of(&report.x, options.estimator, &known, &mut simulations);
        *stats += simulations.stats;
        match uncertainty {
            Ok(mut uncertainty) => {
                // Whoever gives a target wants no minimum.
                if report.termination == Termination::Target {
                    uncertainty.findings.retain(|finding| finding.subject != SEARCH);
                }
                Some(uncertainty)
            }
            Err(error) => {
                log::info!("the uncertainty of the fit could not be found: {error}");
                None
            }
        }
    }

    /// The size that was given for a parameter on a linear scale: what the user said, else the model's
    /// nominal value, but no more than the width of the bounds.
    fn given_size(&self, parameter: &Parameter) -> Option<f64> {
        if parameter.scale_kind() == Scale::Log {
            return None;
        }
        let variable = parameter.variable().and_then(|name| self.fmu().description().variable(name));
        // That of the model is in the unit of the model.
        let nominal = variable.filter(|_| parameter.given_unit().is_none()).and_then(|v| v.nominal);
        let width = parameter.upper() - parameter.lower();
        let of_model = nominal.map(|n| if width > 0.0 { n.abs().min(width) } else { n.abs() });
        parameter.nominal_size().or(of_model).map(f64::abs).filter(|size| size.is_finite() && *size > 0.0)
    }

    /// Typical size of a parameter near a value, by the rule of the search ([`dfo::typical_size`]); of its
    /// logarithm on a logarithmic scale; 1 where nothing is known. A value that has come near zero has the
    /// size that it had at the start.
    pub(crate) fn size_of(&self, parameter: &Parameter, at: f64) -> f64 {
        let (bounds, given) = ((parameter.lower(), parameter.upper()), self.given_size(parameter));
        let largest = at.abs().max(parameter.start().abs());
        typical_size(parameter.scale_kind(), largest, bounds, given).unwrap_or(1.0)
    }
}
