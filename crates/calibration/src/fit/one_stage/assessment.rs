//! Assessment of the result of a search: findings, quality of fit of each output, and uncertainty.

use super::misfit;
use super::noise::{self, FitNoise};
use super::noise_iterations::FinalSearch;
use super::result::Fit;
use super::search::{Job, SearchResult};
use crate::cost::residual::{CostRule, PointResiduals, sum_of_squares};
use crate::findings::display_text::digits;
use crate::findings::finding::{Finding, Origin};
use crate::findings::identifier::FindingId;
use crate::fit::output_fit::{EndResiduals, KeptResiduals, log_weights};
use crate::fit::phase::FitPhase;
use crate::loaded::budget::{Budget, Extra};
use crate::loaded::calibration::Calibration;
use crate::loaded::simulations_around::Simulations;
use crate::problem::objective::{CostKind, NamedCost, likelihood_variances};
use crate::problem::parameter::Parameter;
use crate::problem::residual_layout::{OutputResiduals, ResidualLayout};
use crate::uncertainty::diagnostics::residual_check::ResidualCheck;
use crate::uncertainty::estimate::EvaluatedPoint;
use crate::uncertainty::result::{Uncertainty, UncertaintyOptions};
use base::RunContext;
use dfo::{Cause, RobustLoss, Termination, ToleranceMeasure};
use ode::Stats;

/// Below this total number of right-hand sides, simulations run sequentially. They take about as long as
/// starting a process and threads, 1 to 2 ms (`benches/whole_fits.md`).
const FEW_RIGHT_HAND_SIDES: u64 = 20_000;

/// Finding about a fit interrupted after its search had ended normally.
const ENDED_EARLY: &str =
    "the fit ended during the checks after the search. Findings and standard errors may be missing";

impl Calibration {
    /// Returns the fit for completed searches. Also returns their residuals with the weights of this
    /// calibration. `fitted` is the calibration with the weights and the tolerance of the fit. `stats` counts
    /// the simulations of the searches, and `budget` limits further simulations.
    pub(crate) fn assessed(
        &self,
        fitted: &Self,
        job: &Job<'_>,
        made: FinalSearch,
        mut stats: Stats,
        mut budget: Budget,
    ) -> (Fit, KeptResiduals) {
        let SearchResult { report, residuals, start_cost, .. } = &made.searched;
        let Job { start, objective, loss, context, .. } = job;
        job.enter(FitPhase::Checks, &stats);
        let ends = fitted.end_residuals(&report.x, residuals, *loss, context, &mut stats);
        let mut findings = fitted.findings_of_search(job, &made, &ends, &mut budget, &mut stats);
        let mut outputs =
            ends.end.as_ref().map_or_else(Vec::new, |end| fitted.output_fits(end, ends.start.as_ref()));
        // The fit may have divided the weights by estimates of the noise.
        for (fit, output) in outputs.iter_mut().zip(&self.residual_layout().outputs) {
            fit.log_weights = log_weights(output);
        }
        job.enter(FitPhase::Uncertainty, &stats);
        let uncertainty = fitted.uncertainty_of_fit(job, &made, &ends, &mut budget, &mut stats);
        // The search ended normally, but the steps after it did not.
        if context.is_cancelled() && report.termination != Termination::Interrupted {
            let remedy = "Resume from the checkpoint, or fit again";
            let finding = Finding::warning(FindingId::IncompleteAssessment, "fit", ENDED_EARLY, remedy);
            findings.push(finding.of(Origin::Search));
        }
        if uncertainty.is_none() {
            let found =
                fitted.findings_without_uncertainty(job, &made.searched, &ends, &mut budget, &mut stats);
            findings.extend(found);
        }
        let is_estimated = made.noise.as_ref().is_some_and(|noise| noise.estimated().is_some());
        let noise = made.noise.as_ref();
        let mut rms = |x: &[f64], cost: f64| match residuals.at(x) {
            _ if objective.is_sum_of_squares() && !is_estimated => Some(self.rms(x, cost)),
            // With another cost or other weights, the residuals must be known.
            Some(residuals) => Some(self.rms_of(residuals, fitted.residual_layout(), noise)),
            None => {
                let found = fitted.cost_and_residuals(x, objective, *loss, context, &mut stats);
                found.map(|(_, residuals)| self.rms_of(&residuals, fitted.residual_layout(), noise))
            }
        };
        let (rms, start_rms) = match job.loss.is_linear() {
            true => (rms(&report.x, report.fun), start_cost.and_then(|cost| rms(start, cost))),
            // The cost with a loss does not determine the differences.
            false => {
                let plain = |at: &Option<PointResiduals>| {
                    at.as_ref().map(|at| self.rms_of(&at.residuals, fitted.residual_layout(), noise))
                };
                (plain(&ends.end), plain(&ends.start))
            }
        };
        let parameters = self.parameters();
        let names: Vec<String> = parameters.iter().map(|p| p.name().to_owned()).collect();
        let shown_names: Vec<String> = parameters.iter().map(|p| p.shown_name().to_owned()).collect();
        let description = self.fmu().description();
        let unit = |p: &Parameter| p.unit(description).map(str::to_owned);
        let kept_by = fitted.residual_layout().clone();
        let SearchResult { report, inactive, residuals, start_cost, preflight, .. } = made.searched;
        budget.add_skipped(&inactive.skipped);
        let mut without_effect = inactive.without_effect;
        without_effect.extend(uncertainty.iter().flat_map(|uncertainty| &uncertainty.without_effect));
        without_effect.sort_unstable();
        without_effect.dedup();
        job.enter(FitPhase::FreshProcess, &stats);
        let free: Vec<usize> = (0..parameters.len())
            .filter(|i| parameters[*i].lower() < parameters[*i].upper() && !job.held.contains(i))
            .collect();
        let fit = Fit {
            n_equalities: self.constraints().n_equalities(&report.x, &free),
            units: parameters.iter().map(unit).collect(),
            priors: parameters
                .iter()
                .enumerate()
                .filter(|(_, p)| p.lower() < p.upper())
                .filter_map(|(i, p)| Some((i, *p.stated_prior()?)))
                .collect(),
            bounds: parameters.iter().map(|p| (p.lower(), p.upper())).collect(),
            model: description.model_name.clone(),
            n_measurements: self.n_measurements(),
            in_this_process: self.isolation().1.map(str::to_owned),
            noise: made.noise,
            tolerance: made.tolerance,
            x: report.x.clone(),
            shown_names: if shown_names == names { Vec::new() } else { shown_names },
            names,
            outputs,
            preflight,
            setup_findings: findings,
            cost: report.fun,
            rms: rms.unwrap_or(f64::NAN),
            derived: self.derived_at(&report.x, start),
            start_cost,
            start_rms,
            objective: objective.name().to_owned(),
            options: job.requested.clone(),
            start: start.clone(),
            stages: Vec::new(),
            phases: Vec::new(),
            uncertainty,
            at_bound: inactive.at_bound,
            without_effect,
            n_checks: inactive.n_checks,
            skipped: budget
                .skipped()
                .iter()
                .filter(|_| !job.is_part)
                .map(|extra| extra.name().to_owned())
                .collect(),
            stats,
            solver: self.solver(),
            report,
        };
        (fit, residuals.reweighed(&kept_by, self.residual_layout()))
    }

    /// Returns the findings of the search and of the problem at its result, without duplicates.
    fn findings_of_search(
        &self,
        job: &Job<'_>,
        made: &FinalSearch,
        ends: &EndResiduals,
        budget: &mut Budget,
        stats: &mut Stats,
    ) -> Vec<Finding> {
        let SearchResult { report, raised, .. } = &made.searched;
        let mut found = raised.clone();
        found.extend(self.unstated_noise(job, made.noise.as_ref()));
        if job.is_checked() {
            match &ends.end {
                Some(end) if report.termination.cause().allows_evaluations() => {
                    found.extend(self.check_after_fit(ends.start.as_ref(), end));
                    if let Some(start) = &ends.start {
                        found.extend(self.other_time_unit_at_start(start, &job.context, stats));
                    }
                    if self.is_co_simulation() && budget.allows(Extra::Accuracy, self.price_of_accurate()) {
                        found.extend(self.large_step_after_fit(end, &job.context, stats));
                    }
                }
                _ if *report.termination.ended() == Termination::MaxTime => {
                    found.extend(self.check_of_setup(&report.x));
                }
                _ => {}
            }
        }
        if let Some(end) = &ends.end {
            let contradictions = self.contradictions_of_stated_noise(job, made, &end.residuals);
            found.extend(contradictions.into_iter().map(|finding| finding.of(Origin::Residuals)));
            found.extend(misfit::findings(self, &end.residuals));
            if job.objective.is_likelihood() {
                found.extend(self.noise_below_accuracy(&end.residuals));
            }
        }
        let mut once: Vec<Finding> = Vec::with_capacity(found.len());
        found.into_iter().for_each(|finding| {
            if !once.contains(&finding) {
                once.push(finding);
            }
        });
        once
    }

    /// Returns findings about outputs whose variance in the likelihood is limited by the accuracy of the
    /// simulation.
    fn noise_below_accuracy(&self, residuals: &[f64]) -> Vec<Finding> {
        let layout = self.residual_layout();
        let mut found: Vec<Finding> = Vec::new();
        for (output, (variance, is_limited)) in
            layout.outputs.iter().zip(likelihood_variances(layout, residuals))
        {
            let subject = format!("noise of {}", output.variable);
            if !is_limited || found.iter().any(|finding| finding.subject == subject) {
                continue;
            }
            let same = layout.outputs.iter().filter(|o| o.variable == output.variable);
            let rows: Vec<usize> = same.flat_map(OutputResiduals::noisy_rows).collect();
            let squares: f64 = rows.iter().map(|row| residuals[*row] * residuals[*row]).sum();
            let of_residuals = (squares / rows.len().max(1) as f64).sqrt();
            let sentence = format!(
                "the weighted residuals of '{}' have the standard deviation {}, which is below the error of its simulation, about {}. The fit \
                 uses this error as the noise of the output",
                output.variable,
                digits(of_residuals),
                digits(variance.sqrt())
            );
            let remedy = "Set a smaller relative_tolerance if the output is measured so accurately";
            let finding = Finding::note(FindingId::NoiseBelowAccuracy, subject, sentence, remedy);
            found.push(finding.of(Origin::Residuals));
        }
        found
    }

    /// Returns findings about residuals that contradict the noise stated by the weights. This applies to fits
    /// with priors and to sums of squares whose search has converged.
    fn contradictions_of_stated_noise(
        &self,
        job: &Job<'_>,
        made: &FinalSearch,
        residuals: &[f64],
    ) -> Vec<Finding> {
        let has_priors = made.noise == Some(FitNoise::Stated);
        let is_compared = job.objective.is_sum_of_squares()
            && job.loss.is_linear()
            && job.is_whole
            && made.searched.report.termination.cause() == Cause::Search
            && !self.is_within_tolerance(sum_of_squares(residuals));
        let mut found = match has_priors || (is_compared && made.noise.is_none()) {
            true => noise::contradictions_of_stated(self, residuals, has_priors),
            false => Vec::new(),
        };
        if is_compared {
            let is_noise_known = made.noise.as_ref().is_some_and(FitNoise::is_known);
            let is_free = |(i, p): (usize, &Parameter)| {
                let is_at_bound = made.searched.inactive.at_bound.iter().any(|(k, _)| *k == i);
                !(p.is_fixed() || p.lower() == p.upper() || job.held.contains(&i) || is_at_bound)
            };
            let n_free = self.parameters().iter().enumerate().filter(|(i, p)| is_free((*i, p))).count();
            found.extend(noise::contradiction_of_known_noise(
                self.residual_layout(),
                residuals,
                n_free,
                is_noise_known,
            ));
        }
        found
    }

    /// Returns the findings of a fit without uncertainty: the reason if it was requested, and findings that
    /// do not require it.
    fn findings_without_uncertainty(
        &self,
        job: &Job<'_>,
        searched: &SearchResult,
        ends: &EndResiduals,
        budget: &mut Budget,
        stats: &mut Stats,
    ) -> Vec<Finding> {
        let mut found = Vec::new();
        let is_requested = job.has_uncertainty();
        if is_requested && searched.report.termination.cause().allows_evaluations() && job.context.is_late() {
            let sentence = "the time limit ended the fit before the standard errors were estimated";
            let (id, remedy) = (FindingId::IncompleteAssessment, "Set a larger max_time");
            found.push(Finding::warning(id, "max_time", sentence, remedy).of(Origin::Search));
        }
        let end = ends.end.as_ref().filter(|_| self.has_fixed_step() && job.is_checked());
        if let Some(end) = end.filter(|_| budget.allows(Extra::Accuracy, self.price_of_accurate())) {
            found.extend(self.large_step_after_fit(end, &job.context, stats));
        }
        // If a search was interrupted, other values could remove the pattern in the residuals.
        let is_at_end = searched.report.termination.cause() == Cause::Search;
        let at_end = ends.end.as_ref().filter(|_| job.is_whole && is_at_end);
        if let Some(end) = at_end.filter(|end| !self.is_within_tolerance(sum_of_squares(&end.residuals))) {
            let names = self.problem().experiment_names();
            let checks = ResidualCheck::all(self.residual_layout(), &names, &end.residuals, &job.context);
            // A run whose time has expired has no findings.
            let checks = checks.unwrap_or_default();
            let has_loss = !job.loss.is_linear() || matches!(job.objective, CostKind::Named(NamedCost::Mae));
            found.extend(ResidualCheck::all_findings(&checks, has_loss, false));
        }
        found
    }

    /// Returns the root of the mean squared residual of the measurements with the weights of this
    /// calibration. `residuals` have the weights of another layout. Outputs with an error model keep the
    /// weights of the fit.
    pub(crate) fn rms_of(
        &self,
        residuals: &[f64],
        weights: &ResidualLayout,
        noise: Option<&FitNoise>,
    ) -> f64 {
        let mut layout = self.residual_layout().clone();
        if let Some(noise) = noise.and_then(FitNoise::estimated) {
            noise.weigh_models(self.problem(), &mut layout);
        }
        let reweighed = layout.reweighed(residuals, weights);
        let n = self.n_measurements();
        (sum_of_squares(&reweighed[..n]) / n as f64).sqrt()
    }

    /// Returns the cost and the residuals, with weights and loss, at `x`. Returns `None` if the simulation
    /// fails.
    pub(crate) fn cost_and_residuals(
        &self,
        x: &[f64],
        kind: &CostKind,
        loss: RobustLoss,
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> Option<(f64, Vec<f64>)> {
        let mut residuals = vec![0.0; self.n_values()];
        let sum = self.evaluate_into(x, CostRule::whole(loss, context), &mut residuals, stats).ok()?;
        residuals.truncate(self.n_residuals());
        let outcome = kind.outcome(self.residual_layout(), sum, &residuals, &mut Vec::new());
        Some((outcome.value()?, residuals))
    }

    /// Returns the uncertainty of the result of a search. Returns `None` if it cannot be estimated or is not
    /// requested.
    fn uncertainty_of_fit(
        &self,
        job: &Job<'_>,
        FinalSearch { searched, noise, .. }: &FinalSearch,
        ends: &EndResiduals,
        budget: &mut Budget,
        stats: &mut Stats,
    ) -> Option<Uncertainty> {
        let SearchResult { report, inactive, tolerances, .. } = searched;
        let options = job.uncertainty.as_ref().filter(|_| job.objective.has_uncertainty())?;
        if !report.termination.cause().allows_evaluations() || job.context.is_over() {
            return None;
        }
        // Two simulations for each parameter.
        let n_simulations = (2 * self.parameters().len() * self.problem().experiments.len()) as u64;
        let work = stats.right_hand_sides / stats.runs.max(1) * n_simulations;
        let is_little = work < FEW_RIGHT_HAND_SIDES && stats.right_hand_sides > 0;
        let workers = if is_little { Some(1) } else { options.workers.or(job.run.workers) };
        let workers = workers.unwrap_or(1);
        let mut simulations = Simulations::new(self, RobustLoss::default(), workers, &job.context).ok()?;
        let is_likelihood = job.objective.is_likelihood();
        let criterion = UncertaintyOptions { loss: job.loss, is_likelihood, ..options.clone() }.criterion();
        let at_bound = inactive.at_bound.iter().map(|(index, _)| *index);
        let held = at_bound.filter(|index| !inactive.without_effect.contains(index));
        // The residuals of a stage with a separate window have another length.
        let of_report = report.residuals.as_deref().filter(|r| r.len() == self.n_residuals());
        let evaluated_point = EvaluatedPoint {
            residuals: of_report.or(ends.end.as_ref().map(|end| end.residuals.as_slice())),
            jacobian: report.jacobian.as_deref(),
            held: options.held.iter().chain(&job.held).copied().chain(held).collect(),
            inert: &inactive.without_effect,
            f_tol: match tolerances.measure {
                ToleranceMeasure::Relative => tolerances.f_tol,
                ToleranceMeasure::Absolute => tolerances.f_tol / report.fun.abs(),
            },
            criterion,
            is_noise_known: options.is_noise_known || noise.as_ref().is_some_and(FitNoise::is_known),
        };
        // For several stages, the assessment after the last stage includes the accuracy.
        if job.is_part {
            *budget = Budget::after(0);
        }
        std::mem::swap(budget, &mut simulations.budget);
        let uncertainty =
            self.uncertainty_of(&report.x, options.estimator, &evaluated_point, &mut simulations);
        std::mem::swap(budget, &mut simulations.budget);
        *stats += simulations.stats;
        let mut phases = job.phases.borrow_mut();
        phases.enter(FitPhase::Checks, stats);
        phases.move_part(simulations.extras, FitPhase::Uncertainty, FitPhase::Checks);
        drop(phases);
        match uncertainty {
            Ok(mut uncertainty) => {
                // A user who sets a target does not request a minimum.
                if *report.termination.ended() == Termination::Target {
                    let is_early = [FindingId::BeforeMinimum, FindingId::MinimumBeyondFailures];
                    uncertainty.findings.retain(|finding| !is_early.contains(&finding.id));
                }
                if !job.run.method.is_global() {
                    uncertainty.found_by_local_search();
                }
                Some(uncertainty)
            }
            Err(error) => {
                log::info!("the uncertainty of the fit could not be computed: {error}");
                None
            }
        }
    }
}
