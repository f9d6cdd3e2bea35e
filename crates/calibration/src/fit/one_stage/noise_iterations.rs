//! Searches of a fit: one search, or several that alternate with estimates of the noise.

use super::noise::{EstimatedNoise, FitNoise, MOST_ROUNDS, NoiseRule, leverages};
use super::search::{Job, SearchResult, UsedLimits, start_cost_in};
use super::tolerance::ChosenTolerance;
use crate::cost::process::BestPoint;
use crate::cost::residual::sum_of_squares;
use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Origin, Severity};
use crate::fit::output_fit::KeptResiduals;
use crate::fit::phase::FitPhase;
use crate::loaded::budget::Budget;
use crate::loaded::calibration::Calibration;
use crate::loaded::simulations_around::{Point, Simulations};
use crate::problem::definition::Problem;
use crate::problem::parameter::Parameter;
use dfo::{Cause, Checkpoint, Report, Resume, Termination};
use ode::Stats;

/// Last search of a fit, with its calibration, noise and tolerance.
pub(crate) struct FinalSearch {
    /// Calibration with the weights and the tolerance of the fit. `None` if both are
    /// unchanged.
    pub(crate) fitted_calibration: Option<Calibration>,
    pub(crate) searched: SearchResult,
    pub(crate) noise: Option<FitNoise>,
    pub(crate) tolerance: Option<ChosenTolerance>,
}

impl FinalSearch {
    /// Creates the result of a search with the weights and the tolerance of the original calibration.
    pub(crate) fn of(searched: SearchResult) -> Self {
        Self { fitted_calibration: None, searched, noise: None, tolerance: None }
    }

    /// Returns the budget of simulations after the search.
    pub(crate) fn budget(&self) -> Budget {
        let SearchResult { report, inactive, .. } = &self.searched;
        let mut budget = Budget::after(report.n_evaluations);
        budget.take(inactive.n_checks as f64);
        budget
    }

    /// Returns the result of the search, with its residuals if they are known.
    pub(super) fn best(&self, n_residuals: usize, n_values: usize, is_sum_of_squares: bool) -> BestPoint {
        let SearchResult { report, residuals, .. } = &self.searched;
        let residuals = residuals.at(&report.x).map(<[f64]>::to_vec);
        let cost = (is_sum_of_squares && residuals.is_none()).then_some(report.fun);
        BestPoint { x: report.x.clone(), n_residuals, n_values, residuals, cost }
    }
}

/// Returns the checkpoint of one part of a fit with several parts. The file name is the name for the fit with
/// `.stage2`, `.round2` and so on appended. For later parts, [`Resume::Require`] becomes [`Resume::Auto`]
/// because they may not have begun.
pub(crate) fn checkpoint_of(fit: &Checkpoint, part: &str, is_first: bool) -> Checkpoint {
    let mut path = fit.path.clone().into_os_string();
    path.push(part);
    let resume = if !is_first && fit.resume == Resume::Require { Resume::Auto } else { fit.resume };
    let mut checkpoint_of_part = fit.clone().resume(resume);
    checkpoint_of_part.path = path.into();
    checkpoint_of_part
}

/// Returns the termination of a fit whose last part found nothing. Returns `None` if it is an error.
pub(crate) fn ended_by(error: &CalibrationError) -> Option<Termination> {
    match error {
        CalibrationError::Cancelled => Some(Termination::Interrupted),
        CalibrationError::Optimiser(dfo::Error::EndedWithoutPoint { termination, .. }) => {
            Some(termination.clone())
        }
        CalibrationError::Optimiser(dfo::Error::AllStartsFailed(_)) => Some(Termination::AllFailed),
        _ => None,
    }
}

/// Adds the counts of an earlier part of a fit to the report of a later one.
pub(crate) fn add_earlier(report: &mut Report, before: &Report) {
    report.n_evaluations += before.n_evaluations;
    report.n_iterations += before.n_iterations;
    report.n_batches += before.n_batches;
    report.n_failed += before.n_failed;
    report.n_infeasible += before.n_infeasible;
    report.n_lost += before.n_lost;
    report.n_cached += before.n_cached;
    report.n_speculative += before.n_speculative;
    report.seconds += before.seconds;
    for (reason, count) in &before.failures {
        match report.failures.iter_mut().find(|(counted_reason, _)| counted_reason == reason) {
            Some((_, sum)) => *sum += count,
            None => report.failures.push((reason.clone(), *count)),
        }
    }
    report.failures.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
}

/// State of searches that alternate with estimates of the noise.
struct Turns {
    noise: EstimatedNoise,
    /// Previous search and its calibration.
    last: Option<(Calibration, SearchResult)>,
    raised: Vec<Finding>,
    /// Residuals at the start of the fit, with the weights of the original calibration.
    at_start: Option<Vec<f64>>,
}

impl Turns {
    /// Returns the previous search if the current one found nothing, so that its result is not lost. Its
    /// termination becomes the termination of the current search. Returns `None` if there is no previous
    /// search or the error is not a termination.
    fn before(&mut self, error: &CalibrationError, job: &Job<'_>) -> Option<(Calibration, SearchResult)> {
        let termination = ended_by(error)?;
        let (calibration, mut before) = self.last.take()?;
        let is_late = job.context.is_late() && !job.context.is_cancelled();
        end_early(&mut before.report, if is_late { Termination::MaxTime } else { termination });
        self.noise.n_rounds -= 1;
        Some((calibration, before))
    }

    /// Adds the counts and the findings of the previous search to a search.
    fn add_to(&mut self, searched: &mut SearchResult) {
        if let Some((_, before)) = self.last.take() {
            let report = &mut searched.report;
            if report.termination == Termination::MaxEvaluations {
                report.message += &format!(
                    "; the earlier searches with other weights used {} evaluations",
                    before.report.n_evaluations
                );
            }
            add_earlier(report, &before.report);
            searched.inactive.n_checks += before.inactive.n_checks;
            searched.preflight = before.preflight;
        }
        self.raised.append(&mut searched.raised);
    }

    /// True if the next estimate equals the current one, so that no further search is needed.
    fn is_settled_by(&mut self, next: &EstimatedNoise) -> bool {
        self.noise.is_settled = next.is_close(&self.noise);
        for (previous, next) in self.noise.outputs.iter_mut().zip(&next.outputs) {
            previous.is_of_residuals |= self.noise.is_settled && next.is_of_residuals;
        }
        for (previous, next) in self.noise.models.iter_mut().zip(&next.models) {
            previous.is_of_residuals |= self.noise.is_settled && next.is_of_residuals;
        }
        self.noise.is_settled
    }
}

impl Job<'_> {
    /// Returns the limit that the searches so far have used up.
    fn exhausted(&self) -> Option<Termination> {
        let is_spent = |most: Option<usize>, n: usize| most.is_some_and(|most| n >= most);
        match () {
            () if is_spent(self.run.limits.max_evaluations, self.spent.n_evaluations) => {
                Some(Termination::MaxEvaluations)
            }
            () if is_spent(self.run.limits.max_iterations, self.spent.n_iterations) => {
                Some(Termination::MaxIterations)
            }
            () if self.context.is_late() => Some(Termination::MaxTime),
            () => None,
        }
    }

    /// Prepares this job for the round after a search.
    fn go_on_from(&mut self, searched: &SearchResult, checkpoint: Option<&Checkpoint>, round: usize) {
        self.start.clone_from(&searched.report.x);
        self.has_preflight = false;
        self.run.tolerances = searched.tolerances;
        self.run.seed = self.run.seed.or(searched.report.seed);
        // Costs with other weights would only affect the start.
        self.run.evaluated.clear();
        self.run.checkpoint = checkpoint.map(|checkpoint| {
            let checkpoint = checkpoint_of(checkpoint, &format!(".round{round}"), false);
            if searched.report.resumed.is_none() { checkpoint.resume(Resume::Never) } else { checkpoint }
        });
    }
}

/// Records that a fit ended before its noise was known.
fn end_early(report: &mut Report, termination: Termination) {
    report.message += &format!("; the fit ended before the noise settled: {termination}");
    report.termination = termination;
}

impl Calibration {
    /// Derives a calibration with other weights or a different tolerance. Warnings of this calibration are
    /// not repeated.
    fn derived_for_fit(&self, problem: Problem) -> Result<Self, CalibrationError> {
        let mut derived = self.derived(problem)?;
        derived.keep_warnings(self);
        Ok(derived)
    }

    /// Returns a copy with another relative tolerance. Returns `None` if this calibration already uses it.
    pub(crate) fn with_tolerance(
        &self,
        chosen: Option<&ChosenTolerance>,
    ) -> Result<Option<Self>, CalibrationError> {
        let other = chosen.map(|chosen| chosen.used).filter(|used| *used != self.relative_tolerance());
        let derived = other.map(|used| {
            let mut problem = self.problem().clone();
            problem.settings.run.relative_tolerance = Some(used);
            self.derived_for_fit(problem)
        });
        derived.transpose()
    }

    /// Returns a copy with the weights of a fit whose noise was estimated. Returns `None` if the noise was
    /// not estimated.
    pub(crate) fn with_noise(&self, noise: Option<&FitNoise>) -> Result<Option<Self>, CalibrationError> {
        let derived = noise.and_then(FitNoise::estimated).map(|noise| {
            let mut problem = self.problem().clone();
            noise.weigh(&mut problem)?;
            self.derived_for_fit(problem)
        });
        derived.transpose()
    }

    /// Returns a copy with the weights and the tolerance of a fit. Returns `None` if this calibration already
    /// has both.
    pub(crate) fn of_fit(&self, fit: &super::Fit) -> Result<Option<Self>, CalibrationError> {
        let with_tolerance = self.with_tolerance(fit.tolerance.as_ref())?;
        let weighed = with_tolerance.as_ref().unwrap_or(self).with_noise(fit.noise.as_ref())?;
        Ok(weighed.or(with_tolerance))
    }

    /// Computes with the weights and the tolerance of a fit. Worker processes keep their working folder and
    /// environment meanwhile.
    pub(crate) fn as_fitted<T>(
        &self,
        fit: &super::Fit,
        work: impl FnOnce(&Self) -> Result<T, CalibrationError>,
    ) -> Result<T, CalibrationError> {
        let _held = self.hold();
        self.check_length(&fit.x)?;
        work(self.of_fit(fit)?.as_ref().unwrap_or(self))
    }

    /// Runs all searches of a fit, including the steps before them.
    pub(super) fn made(&self, job: &mut Job<'_>, stats: &mut Stats) -> Result<FinalSearch, CalibrationError> {
        let tolerance = if job.is_part { None } else { self.choose_tolerance(job) };
        let with_tolerance = self.with_tolerance(tolerance.as_ref())?;
        let calibration = with_tolerance.as_ref().unwrap_or(self);
        let rule = job.noise;
        let estimates = rule == NoiseRule::Estimated
            || (rule == NoiseRule::Auto
                && calibration.has_priors()
                && job.objective.is_sum_of_squares()
                && job.loss.is_linear());
        let mut made = match EstimatedNoise::first(calibration, rule, estimates)? {
            Some(first) => calibration.take_turns(first, job, stats)?,
            None => {
                let searched = calibration.search(job, stats)?;
                FinalSearch { noise: calibration.known_or_stated_noise(job), ..FinalSearch::of(searched) }
            }
        };
        made.tolerance = tolerance;
        made.fitted_calibration = made.fitted_calibration.or(with_tolerance);
        made.searched.raised.splice(0..0, tolerance.and_then(|chosen| chosen.finding()));
        Ok(made)
    }

    /// Returns the source of noise that is not estimated. Returns `None` if nothing depends on it.
    fn known_or_stated_noise(&self, job: &Job<'_>) -> Option<FitNoise> {
        let is_noise_known = job.noise == NoiseRule::Stated
            || self.residual_layout().outputs.iter().all(|output| output.is_noise_known);
        match job.objective.is_sum_of_squares() {
            true if is_noise_known && job.loss.is_linear() => Some(FitNoise::Known),
            true if self.has_priors() => Some(FitNoise::Stated),
            _ => None,
        }
    }

    pub(super) fn has_priors(&self) -> bool {
        !self.residual_layout().priors.is_empty()
    }

    /// Runs searches that alternate with estimates of the noise.
    fn take_turns(
        &self,
        noise: EstimatedNoise,
        job: &mut Job<'_>,
        stats: &mut Stats,
    ) -> Result<FinalSearch, CalibrationError> {
        let (begun, checkpoint) = (job.start.clone(), job.run.checkpoint.clone());
        let mut turns = Turns { noise, last: None, raised: Vec::new(), at_start: None };
        let (fitted, mut searched) = loop {
            turns.noise.n_rounds += 1;
            let mut problem = self.problem().clone();
            turns.noise.weigh(&mut problem)?;
            let fitted = self.derived_for_fit(problem)?;
            let mut searched = match fitted.search(job, stats) {
                Ok(searched) => searched,
                Err(error) => match turns.before(&error, job) {
                    Some(before) => break before,
                    None => {
                        let at_start = job.at_start.take();
                        *job.at_start.borrow_mut() =
                            at_start.map(|r| self.residual_layout().reweighed(&r, fitted.residual_layout()));
                        return Err(error);
                    }
                },
            };
            turns.add_to(&mut searched);
            // The estimate of the noise counts as part of the search.
            job.enter(FitPhase::Search, stats);
            let (x, residuals) = (&searched.report.x, &searched.residuals);
            let ends = fitted.end_residuals(x, residuals, job.loss, &job.context, stats);
            if turns.noise.n_rounds == 1 {
                turns.at_start = (ends.start).map(|start| {
                    self.residual_layout().reweighed(&start.residuals, fitted.residual_layout())
                });
            }
            let next = match ends.end.filter(|_| searched.report.termination.cause() == Cause::Search) {
                Some(end) => {
                    let leverages = match turns.noise.needs_leverages() {
                        true => fitted.leverages_at(&searched, &end.residuals, job, stats)?,
                        false => Some(Vec::new()),
                    };
                    let next = leverages.map(|leverages| turns.noise.next(self, &end.residuals, &leverages));
                    next.transpose()?
                }
                None => None,
            };
            let Some(next) = next else { break (fitted, searched) };
            if turns.is_settled_by(&next) || turns.noise.n_rounds == MOST_ROUNDS {
                break (fitted, searched);
            }
            job.spent = UsedLimits::of(&searched.report);
            if let Some(termination) = job.exhausted() {
                end_early(&mut searched.report, termination);
                break (fitted, searched);
            }
            job.go_on_from(&searched, checkpoint.as_ref(), turns.noise.n_rounds + 1);
            turns.noise = EstimatedNoise { n_rounds: turns.noise.n_rounds, ..next };
            turns.last = Some((fitted, searched));
        };
        let Turns { noise, raised, at_start, .. } = turns;
        searched.raised = raised;
        searched.raised.extend(noise.findings().into_iter().map(|finding| finding.of(Origin::Residuals)));
        if noise.n_rounds > 1 {
            let at_start = at_start.map(|r| fitted.residual_layout().reweighed(&r, self.residual_layout()));
            let x = &searched.report.x;
            let kept = KeptResiduals::new(&begun, at_start);
            searched.residuals = kept.with(x, searched.residuals.at(x));
        }
        job.start = begun;
        // The last of several searches started from another point.
        let in_trace = start_cost_in(&searched.report, &job.start);
        searched.start_cost = in_trace.or_else(|| searched.residuals.at_start().map(sum_of_squares));
        Ok(FinalSearch {
            fitted_calibration: Some(fitted),
            searched,
            noise: Some(FitNoise::Estimated(noise)),
            tolerance: None,
        })
    }

    /// Returns the leverages of the residuals at the end of a search. Returns `None` if the run was
    /// interrupted or simulations fail.
    fn leverages_at(
        &self,
        searched: &SearchResult,
        residuals: &[f64],
        job: &Job<'_>,
        stats: &mut Stats,
    ) -> Result<Option<Vec<f64>>, CalibrationError> {
        let Some(jacobian) = self.jacobian_at(searched, residuals, job, stats)? else { return Ok(None) };
        match leverages(&jacobian, searched.report.x.len(), &job.context) {
            Err(CalibrationError::Cancelled) => Ok(None),
            found => found.map(Some),
        }
    }

    /// Returns the derivatives of the residuals at the end of a search, m x n. Uses the Jacobian of the
    /// search if available, otherwise one step of each parameter. They only determine the number of fitted
    /// residuals, so the step size does not matter. Returns `None` if the run was interrupted or simulations
    /// fail.
    fn jacobian_at(
        &self,
        searched: &SearchResult,
        residuals: &[f64],
        job: &Job<'_>,
        stats: &mut Stats,
    ) -> Result<Option<Vec<f64>>, CalibrationError> {
        let (report, n) = (&searched.report, searched.report.x.len());
        let is_free = |i: usize, p: &Parameter| {
            let is_held = job.held.contains(&i) || p.is_fixed() || p.lower() == p.upper();
            let is_at_bound = searched.inactive.at_bound.iter().any(|(k, _)| *k == i);
            !is_held && !is_at_bound
        };
        let free: Vec<usize> =
            (self.parameters().iter().enumerate()).filter(|(i, p)| is_free(*i, p)).map(|(i, _)| i).collect();
        let mut jacobian = vec![0.0; residuals.len() * n];
        if let Some(jacobian_of_search) =
            report.jacobian.as_ref().filter(|jacobian_of_search| jacobian_of_search.len() == jacobian.len())
        {
            for (row, jacobian_of_search) in
                jacobian.chunks_exact_mut(n).zip(jacobian_of_search.chunks_exact(n))
            {
                free.iter().for_each(|&i| row[i] = jacobian_of_search[i]);
            }
            return Ok(Some(jacobian));
        }
        let points = free.iter().map(|&i| {
            let mut x = report.x.clone();
            x[i] = self.moved_a_little(&self.parameters()[i], x[i]);
            Point::new(x)
        });
        let points: Vec<Point> = points.collect();
        let (context, workers) = (job.context, job.run.workers.unwrap_or(1));
        let found = Simulations::new(self, job.loss, workers, &context).and_then(|mut simulations| {
            let found = simulations.residuals(&points);
            *stats += simulations.stats;
            found
        });
        let found = match found {
            Err(CalibrationError::Cancelled) => return Ok(None),
            found => found?,
        };
        for (&i, (moved, point)) in free.iter().zip(found.iter().zip(&points)) {
            let Ok(moved) = moved else { return Ok(None) };
            let step = point.x[i] - report.x[i];
            let changes = moved.iter().zip(residuals).map(|(moved, r)| (moved - r) / step);
            jacobian.iter_mut().skip(i).step_by(n).zip(changes).for_each(|(entry, change)| *entry = change);
        }
        Ok(Some(jacobian))
    }

    /// Returns a finding if priors are combined with measurements whose noise is neither stated nor
    /// estimated.
    pub(super) fn unstated_noise(&self, job: &Job<'_>, noise: Option<&FitNoise>) -> Option<Finding> {
        let is_unknown = job.noise == NoiseRule::Auto && noise == Some(&FitNoise::Stated);
        let unstated = crate::check::unstated_noise(self.problem()).filter(|_| is_unknown)?;
        Some(Finding {
            severity: Severity::Warning,
            remedy:
                "Set the weights to 1/sigma, or omit the robust loss, so that the fit estimates the noise"
                    .to_owned(),
            ..unstated
        })
    }
}
