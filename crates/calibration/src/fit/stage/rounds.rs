//! The searches of a fit: one, or several that take turns with estimates of the noise.

use super::noise::{EstimatedNoise, FitNoise, MOST_ROUNDS, NoiseRule, leverages};
use super::search::{Job, Searched, Spent};
use super::tolerance::{AtStart, ChosenTolerance};
use crate::cost::batch::{Point, Simulations};
use crate::cost::calibration::Calibration;
use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Severity};
use crate::fit::output_fit::KeptResiduals;
use crate::fit::phase::FitPhase;
use crate::problem::definition::Problem;
use crate::problem::parameter::Parameter;
use crate::problem::residual_layout::OutputResiduals;
use dfo::{Checkpoint, Report, Resume, Termination};
use ode::Stats;

/// The last search of a fit, and what it was made with.
pub(super) struct Made {
    /// The calibration with the fit's own weights and tolerance; `None`: it is the one that was asked.
    pub(super) own: Option<Calibration>,
    pub(super) searched: Searched,
    pub(super) noise: Option<FitNoise>,
    pub(super) tolerance: Option<ChosenTolerance>,
}

impl Made {
    /// A search with the weights and the tolerance of the calibration that was asked.
    pub(super) fn of(searched: Searched) -> Self {
        Self { own: None, searched, noise: None, tolerance: None }
    }
}

/// The checkpoint of a part of a fit that has several: the file of the fit with `.stage2`, `.round2` and so
/// on appended. Later parts of a file that is required may not have begun.
pub(crate) fn checkpoint_of(fit: &Checkpoint, part: &str, is_first: bool) -> Checkpoint {
    let mut path = fit.path.clone().into_os_string();
    path.push(part);
    let resume = if !is_first && fit.resume == Resume::Require { Resume::Auto } else { fit.resume };
    let mut own = fit.clone().resume(resume);
    own.path = path.into();
    own
}

/// Termination of a fit whose last part has found nothing; `None`: it is an error.
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

/// Adds what an earlier part of a fit took to the report of a later one.
pub(crate) fn add_earlier(report: &mut Report, before: &Report) {
    report.n_evaluations += before.n_evaluations;
    report.n_iterations += before.n_iterations;
    report.n_batches += before.n_batches;
    report.n_failed += before.n_failed;
    report.n_cached += before.n_cached;
    report.n_speculative += before.n_speculative;
    report.seconds += before.seconds;
    for (reason, count) in &before.failures {
        match report.failures.iter_mut().find(|(known, _)| known == reason) {
            Some((_, known)) => *known += count,
            None => report.failures.push((reason.clone(), *count)),
        }
    }
    report.failures.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
}

impl Calibration {
    /// The same measurements with other weights or another tolerance: what it warned of is said once.
    fn derived_for_fit(&self, problem: Problem) -> Result<Self, CalibrationError> {
        let mut own = self.derived(problem)?;
        own.keep_warnings(self);
        Ok(own)
    }

    /// With another relative tolerance; `None`: it has that one.
    pub(crate) fn with_tolerance(
        &self,
        chosen: Option<&ChosenTolerance>,
    ) -> Result<Option<Self>, CalibrationError> {
        let other = chosen.map(|chosen| chosen.used).filter(|used| *used != self.relative_tolerance());
        let derived = other.map(|used| {
            let mut problem = self.problem().clone();
            problem.settings.relative_tolerance = Some(used);
            self.derived_for_fit(problem)
        });
        derived.transpose()
    }

    /// With the weights of a fit of which the noise was estimated; `None`: its weights are those of the fit.
    pub(crate) fn with_noise(&self, noise: Option<&FitNoise>) -> Result<Option<Self>, CalibrationError> {
        let derived = noise.and_then(FitNoise::estimated).map(|noise| {
            let mut problem = self.problem().clone();
            noise.weigh(&mut problem)?;
            self.derived_for_fit(problem)
        });
        derived.transpose()
    }

    /// With the weights and the tolerance of a fit; `None`: it has both.
    pub(crate) fn of_fit(&self, fit: &super::Fit) -> Result<Option<Self>, CalibrationError> {
        let tolerant = self.with_tolerance(fit.tolerance.as_ref())?;
        let weighed = tolerant.as_ref().unwrap_or(self).with_noise(fit.noise.as_ref())?;
        Ok(weighed.or(tolerant))
    }

    /// Chooses the solver; with the residuals at the start, as they count, where that has made them known.
    fn start_by_solver(&self, job: &Job<'_>, stats: &mut Stats) -> Result<AtStart, CalibrationError> {
        if let Some(checkpoint) = &job.run.checkpoint {
            self.adopt_solver(checkpoint)?;
        }
        job.phase.set(FitPhase::Solver);
        let (_, raced) = self.solver_counted(&job.context, stats)?;
        let raced = raced.filter(|_| job.start == self.start());
        let counted =
            |plain: Vec<f64>| plain.into_iter().map(|r| job.loss.transform(r)).collect::<Vec<f64>>();
        Ok(raced.map(|raced| (counted(raced.residuals), raced.seconds)))
    }

    /// All searches of a fit, with what comes before them.
    pub(super) fn made(&self, job: &mut Job<'_>, stats: &mut Stats) -> Result<Made, CalibrationError> {
        let mut at_start = self.start_by_solver(job, stats)?;
        *job.at_start.borrow_mut() = at_start.as_ref().map(|(residuals, _)| residuals.clone());
        let chosen = match job.is_part {
            true => None,
            false => {
                let asked = (job.loss, &job.run.tolerances);
                self.choose_tolerance((&job.start, at_start.take()), asked, &job.context, stats)?
            }
        };
        let (tolerance, known) = chosen.unzip();
        let tolerant = self.with_tolerance(tolerance.as_ref())?;
        let at_start = at_start.or(known.flatten());
        let this = tolerant.as_ref().unwrap_or(self);
        let rule = job.noise;
        let estimates = rule == NoiseRule::Estimated
            || (rule == NoiseRule::Auto
                && this.has_priors()
                && job.objective.is_sum_of_squares()
                && job.loss.is_linear());
        let first = if estimates { EstimatedNoise::first(this, rule) } else { None };
        let mut made = match first {
            Some(first) => this.take_turns(first, job, at_start, stats)?,
            None => {
                let searched = this.search(job, at_start, stats)?;
                let is_weighed = job.objective.is_sum_of_squares() && this.has_priors();
                Made { noise: is_weighed.then_some(FitNoise::Stated), ..Made::of(searched) }
            }
        };
        made.tolerance = tolerance;
        made.own = made.own.or(tolerant);
        made.searched.raised.splice(0..0, tolerance.and_then(|chosen| chosen.finding()));
        Ok(made)
    }

    fn has_priors(&self) -> bool {
        !self.residual_layout().priors.is_empty()
    }

    /// Searches that take turns with estimates of the noise.
    fn take_turns(
        &self,
        mut noise: EstimatedNoise,
        job: &mut Job<'_>,
        mut at_start: AtStart,
        stats: &mut Stats,
    ) -> Result<Made, CalibrationError> {
        let (begun, checkpoint) = (job.start.clone(), job.run.checkpoint.clone());
        // The residuals at the start of the fit, by the weights of this calibration.
        let mut first_start: Option<Vec<f64>> = None;
        let mut last: Option<(Calibration, Searched)> = None;
        let mut raised: Vec<Finding> = Vec::new();
        let (own, mut searched) = loop {
            noise.n_rounds += 1;
            let mut problem = self.problem().clone();
            noise.weigh(&mut problem)?;
            let own = self.derived_for_fit(problem)?;
            // A product with one is exact: it has the bits of a simulation with these weights.
            let is_one = |o: &OutputResiduals| o.weights.iter().all(|weight| *weight == 1.0);
            let is_exact = |_: &(Vec<f64>, f64)| self.residual_layout().outputs.iter().all(is_one);
            let here = at_start.take().filter(is_exact).map(|(residuals, seconds)| {
                (own.residual_layout().reweighed(&residuals, self.residual_layout()), seconds)
            });
            let found = own.search(job, here, stats);
            let mut searched = match (found, last.take()) {
                (Ok(mut searched), before) => {
                    if let Some((_, before)) = &before {
                        add_earlier(&mut searched.report, &before.report);
                        searched.found.n_checks += before.found.n_checks;
                        searched.preflight = before.preflight.clone();
                    }
                    searched
                }
                // What the search before has found is not lost.
                (Err(error), Some((own, mut before))) => match ended_by(&error) {
                    Some(termination) => {
                        let is_late = job.context.is_late() && !job.context.is_cancelled();
                        let ended = if is_late { Termination::MaxTime } else { termination };
                        before.report.message +=
                            &format!("; the fit ended before its noise was known to 1 %: {ended}");
                        before.report.termination = ended;
                        noise.n_rounds -= 1;
                        break (own, before);
                    }
                    None => return Err(error),
                },
                (Err(error), None) => {
                    let known = job.at_start.take();
                    *job.at_start.borrow_mut() =
                        known.map(|r| self.residual_layout().reweighed(&r, own.residual_layout()));
                    return Err(error);
                }
            };
            raised.append(&mut searched.raised);
            let start = if noise.n_rounds == 1 { &begun } else { &job.start };
            let known = (&searched.residuals, job.loss);
            let (of_start, of_end) =
                own.plain_residuals((start, &searched.report.x), known, &job.context, stats);
            if noise.n_rounds == 1 {
                first_start = of_start.map(|r| self.residual_layout().reweighed(&r, own.residual_layout()));
            }
            let next = match of_end.filter(|_| is_at_end(&searched.report.termination)) {
                Some(residuals) => {
                    let jacobian = own.jacobian_at(&searched, &residuals, job, stats)?;
                    jacobian.map(|jacobian| {
                        let fitted = leverages(&jacobian, searched.report.x.len());
                        noise.next(self, &residuals, &fitted)
                    })
                }
                None => None,
            };
            let Some(next) = next else { break (own, searched) };
            noise.is_settled = next.is_close(&noise);
            for (own, next) in noise.outputs.iter_mut().zip(&next.outputs) {
                own.is_of_residuals |= noise.is_settled && next.is_of_residuals;
            }
            if noise.is_settled || noise.n_rounds == MOST_ROUNDS {
                break (own, searched);
            }
            let report = &searched.report;
            job.spent = Spent {
                n_evaluations: report.n_evaluations,
                n_iterations: report.n_iterations,
                seconds: report.seconds,
            };
            let is_spent = |most: Option<usize>, n: usize| most.is_some_and(|most| n >= most);
            let limits = job.run.limits;
            let ended = match () {
                () if is_spent(limits.max_evaluations, report.n_evaluations) => {
                    Some(Termination::MaxEvaluations)
                }
                () if is_spent(limits.max_iterations, report.n_iterations) => {
                    Some(Termination::MaxIterations)
                }
                () if job.context.is_late() => Some(Termination::MaxTime),
                () => None,
            };
            if let Some(termination) = ended {
                searched.report.message +=
                    &format!("; the fit ended before its noise was known to 1 %: {termination}");
                searched.report.termination = termination;
                break (own, searched);
            }
            job.start.clone_from(&report.x);
            job.wants_preflight = false;
            job.run.tolerances = searched.tolerances;
            job.run.seed = job.run.seed.or(report.seed);
            // Points of other weights would only say where to start.
            job.run.known.clear();
            let part = format!(".round{}", noise.n_rounds + 1);
            job.run.checkpoint = checkpoint.as_ref().map(|checkpoint| {
                let own = checkpoint_of(checkpoint, &part, false);
                if report.resumed.is_none() { own.resume(Resume::Never) } else { own }
            });
            (noise, last) = (EstimatedNoise { n_rounds: noise.n_rounds, ..next }, Some((own, searched)));
        };
        job.start = begun;
        searched.raised = raised;
        searched.raised.extend(noise.findings());
        let at_start = first_start.map(|r| own.residual_layout().reweighed(&r, self.residual_layout()));
        let x = searched.report.x.clone();
        if noise.n_rounds > 1 {
            let best = searched.residuals.at((&x, &[])).map(|residuals| (x.as_slice(), residuals));
            searched.residuals = KeptResiduals::of_both(at_start.as_deref(), best);
        }
        Ok(Made { own: Some(own), searched, noise: Some(FitNoise::Estimated(noise)), tolerance: None })
    }

    /// Derivatives of the residuals at the end of a search, m x n: those that it had, else of one step of
    /// each parameter. They say how many of the residuals are fitted, for which the length of a step does not
    /// matter. `None`: the search was interrupted meanwhile, or simulations fail.
    fn jacobian_at(
        &self,
        searched: &Searched,
        residuals: &[f64],
        job: &Job<'_>,
        stats: &mut Stats,
    ) -> Result<Option<Vec<f64>>, CalibrationError> {
        let (report, n) = (&searched.report, searched.report.x.len());
        let is_free = |i: usize, p: &Parameter| {
            let is_held = job.held.contains(&i) || p.is_fixed() || p.lower() == p.upper();
            let is_at_bound = searched.found.at_bound.iter().any(|(k, _)| *k == i);
            !is_held && !is_at_bound
        };
        let free: Vec<usize> =
            (self.parameters().iter().enumerate()).filter(|(i, p)| is_free(*i, p)).map(|(i, _)| i).collect();
        let mut jacobian = vec![0.0; residuals.len() * n];
        if let Some(known) = report.jacobian.as_ref().filter(|known| known.len() == jacobian.len()) {
            for (row, known) in jacobian.chunks_exact_mut(n).zip(known.chunks_exact(n)) {
                free.iter().for_each(|&i| row[i] = known[i]);
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
        let found = Simulations::new(self, (job.loss, workers), &context).and_then(|mut simulations| {
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

    /// Finding for priors that count beside measurements whose noise nothing states, and which the fit does
    /// not estimate.
    pub(super) fn unstated_noise(&self, job: &Job<'_>, noise: Option<&FitNoise>) -> Option<Finding> {
        let is_unknown = job.noise == NoiseRule::Auto && noise == Some(&FitNoise::Stated);
        let unstated = crate::check::unstated_noise(self.problem()).filter(|_| is_unknown)?;
        Some(Finding {
            severity: Severity::Warning,
            remedy: "give weights of 1/sigma, or leave out the robust loss: then the noise is estimated with the parameters".to_owned(),
            ..unstated
        })
    }
}

/// True if the search has come to its end: nothing from outside ended it.
fn is_at_end(termination: &Termination) -> bool {
    matches!(
        termination,
        Termination::Converged
            | Termination::Noise
            | Termination::ConstantCost
            | Termination::Collapsed
            | Termination::Stalled
            | Termination::AllFixed
    )
}
