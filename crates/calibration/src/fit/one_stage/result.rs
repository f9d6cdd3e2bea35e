//! Result of a fit.

use super::noise::FitNoise;
use super::tolerance::ChosenTolerance;
use crate::findings::finding::{Finding, Origin, Severity, sort};
use crate::findings::shown_text::digits;
use crate::fit::output_fit::OutputFit;
use crate::fit::phase::PhaseCost;
use crate::loaded::calibration::Calibration;
use crate::problem::residual_layout::ResidualLayout;
use crate::uncertainty::preflight::Preflight;
use crate::uncertainty::result::Uncertainty;
use crate::uncertainty::stuck_parameters::BoundSide;
use base::Number;
use dfo::{Record, Report, Termination};
use ode::{Method, Stats};
use serde::{Deserialize, Serialize};

/// Stages after which a step in all parameters takes away more than this part of the cost have not fitted
/// them.
const MUCH_OF_COST: f64 = 0.25;

/// The result of a fit. `Display` prints a summary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Fit {
    /// Fitted values, one per parameter, user's order and units; fixed ones included.
    pub x: Vec<f64>,
    /// Names of the parameters, in the same order.
    pub names: Vec<String>,
    /// Names of the parameters in reports and figures, in the same order (see
    /// [`Parameter::display_name`](crate::Parameter::display_name)); empty: the same as `names`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shown_names: Vec<String>,
    /// Values of the parameters that are tied to others, by name.
    pub tied: Vec<(String, f64)>,
    /// Where the fit started.
    pub start: Vec<f64>,
    /// Units of the parameters, where they are known, in the same order.
    pub units: Vec<Option<String>>,
    /// Lower and upper bounds of the parameters, in the same order; both the same where one is fixed.
    pub bounds: Vec<(f64, f64)>,
    /// Name of the model.
    pub model: String,
    /// Why the FMU ran in this process, where one of its own was asked for (see
    /// [`Calibration::isolation`](crate::Calibration::isolation)).
    #[serde(default)]
    pub in_this_process: Option<String>,
    /// Number of measurements that count.
    pub n_measurements: usize,
    /// Cost there: the sum of the squared weighted residuals, by the weights of the [noise](Self::noise)
    /// where that was estimated; with a loss, of what they count.
    pub cost: f64,
    /// Root of the mean squared weighted residual of the measurements there, by the weights of the
    /// calibration, before a loss.
    pub rms: f64,
    /// Name of the cost, see [`CostKind::name`](crate::CostKind::name).
    pub objective: String,
    /// The options that were asked for, by the names that users write (see
    /// [`FitOptions::record`](crate::FitOptions::record)); of a stage with its `parameters` and `windows`.
    pub options: Record,
    /// Where the noise of the measurements was taken from, beside which priors count; `None`: nothing
    /// depended on it (no priors, or a cost that is no sum of squares), or there was no time for a search.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<FitNoise>,
    /// The relative tolerance that was chosen for the simulations; `None`: it was given, or that of the
    /// calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<ChosenTolerance>,
    /// Cost at the start, if the simulation did not fail there.
    pub start_cost: Option<f64>,
    /// RMS at the start, if the simulation did not fail there.
    pub start_rms: Option<f64>,
    /// The fit of each stage, see [`Calibration::fit_stages`](crate::Calibration::fit_stages); empty if there
    /// were none.
    pub stages: Vec<Fit>,
    /// Parameters that ended at a bound, by number: the best values may lie beyond.
    pub at_bound: Vec<(usize, BoundSide)>,
    /// Parameters that did not change the cost (by more than the relative tolerance of the simulations), by
    /// number: their values say nothing.
    pub without_effect: Vec<usize>,
    /// Simulations made after the run to find out about both: at the bound, for each parameter that ended as
    /// near to it as `x_tol`; with the parameter moved, for each that an evaluation has shown not to change
    /// the cost, and without standard errors, which show it, for each that none has shown to change it (those
    /// of a first simplex show it, because they differ in one parameter alone). They are none of the run's
    /// evaluations, which its budget counts, are not made after an interrupt or when the time is up, and are
    /// part of `stats`.
    pub n_checks: usize,
    /// What was not looked at after the search because the search was short: all that is simulated besides
    /// the search and the standard errors takes at most a quarter of the evaluations of the search, and
    /// no more than four simulations of the result. Empty: nothing was skipped.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub skipped: Vec<String>,
    /// Quality of fit of each output, in the order of the residual vector; empty where the run was ended from
    /// outside.
    pub outputs: Vec<OutputFit>,
    /// Result of the preflight, where it was requested.
    pub preflight: Option<Preflight>,
    /// Findings of a [check](crate::Calibration::check) of the problem beyond notes, evaluated again with the
    /// fitted values (only where the uncertainty is requested), and findings about the run. [`Fit::findings`]
    /// has all.
    pub setup_findings: Vec<Finding>,
    /// Uncertainty of the fit; `None` where it was not requested, or the run was ended from outside.
    pub uncertainty: Option<Uncertainty>,
    /// Statistics of all simulations of the fit: right-hand sides, steps, events, seconds (added up over all
    /// workers), from the search to the standard errors. Those that
    /// failed or were given up count, those of a resumed fit from before do not. The best point evaluated
    /// again, in a fresh process and in those used, is among the [checks](Stats::checks).
    pub stats: Stats,
    /// What its phases took: the simulations that `stats` counts, and wall-clock time.
    #[serde(default)]
    pub phases: Vec<PhaseCost>,
    /// The integration method of all simulations.
    pub solver: Method,
    /// Report of the optimiser: counts, reason to end, trace.
    pub report: Report,
}

impl Fit {
    /// True if the search was a success (see [`Report::is_success`](dfo::Report::is_success)) and no step
    /// from its result gains more, as the uncertainty has found out; after several stages: no step that gains
    /// more than a quarter of the cost.
    pub fn is_success(&self) -> bool {
        let most = if self.stages.is_empty() { 0.0 } else { MUCH_OF_COST };
        self.report.is_success() && self.left_to_gain() <= most
    }

    /// The part of the cost that a step of least squares from the result takes away, where that is more than
    /// noise.
    fn left_to_gain(&self) -> f64 {
        self.uncertainty.as_ref().map_or(0.0, |uncertainty| uncertainty.left_to_gain)
    }

    /// Says so in the report if the search has ended before its minimum. Not for stages: these hold what
    /// others have freed.
    pub(crate) fn note_end_before_minimum(&mut self) {
        let left = self.left_to_gain();
        if left > 0.0 && matches!(self.report.termination, Termination::Converged | Termination::Noise) {
            self.report.message = format!(
                "not converged: one more step of least squares takes away {} % of the cost; {}",
                digits(100.0 * left),
                self.report.message
            );
            self.report.termination = Termination::BeforeMinimum;
        }
    }

    /// True if each of several stages may be at its minimum, and all parameters together are not.
    pub(crate) fn is_conditional(&self) -> bool {
        !self.stages.is_empty() && self.left_to_gain() > 0.0
    }

    /// Meaning of each entry of the residual vector of this fit, with the weights that the fit had: those of
    /// the calibration, or those over the [noise](Fit::noise) that was estimated.
    pub fn residual_layout(&self, calibration: &Calibration) -> ResidualLayout {
        let mut layout = calibration.residual_layout().clone();
        if let Some(noise) = self.noise.as_ref().and_then(FitNoise::estimated) {
            noise.weigh_layout(calibration.problem(), &mut layout);
        }
        layout
    }

    /// Names of the parameters in reports and figures.
    pub fn shown_names(&self) -> &[String] {
        if self.shown_names.is_empty() { &self.names } else { &self.shown_names }
    }

    /// True if no finding is an error: the values may be used, with what the warnings say about them.
    pub fn is_usable(&self) -> bool {
        self.findings().iter().all(|finding| finding.severity != Severity::Error)
    }

    /// Findings about the fit, those that explain others first, notes last: findings of a check, parameters
    /// at a bound or that the data do not determine, properties of the residuals.
    pub fn findings(&self) -> Vec<Finding> {
        self.findings_with(&self.names)
    }

    /// The same with other names of the parameters.
    pub(crate) fn findings_with(&self, names: &[String]) -> Vec<Finding> {
        let at_bound = |(i, side): &(usize, BoundSide)| {
            let bound = match side {
                BoundSide::Lower => self.bounds[*i].0,
                BoundSide::Upper => self.bounds[*i].1,
            };
            let sentence = format!(
                "{} is at its {} bound {}: the best value may lie beyond",
                names[*i],
                side.name(),
                Number(bound)
            );
            Finding::warning(&names[*i], sentence, "").of(Origin::Search)
        };
        let without_effect = |i: &usize| {
            let sentence = format!("{} did not change the cost: its value says nothing", names[*i]);
            Finding::warning(&names[*i], sentence, "").of(Origin::Search)
        };
        let is_said = |i: &&usize| {
            !self.uncertainty.as_ref().is_some_and(|uncertainty| uncertainty.undetermined.contains(i))
        };
        let mut all: Vec<Finding> = self.at_bound.iter().map(at_bound).collect();
        all.extend(self.without_effect.iter().filter(is_said).map(without_effect));
        all.extend(self.setup_findings.iter().cloned());
        all.extend(self.open_minima());
        all.extend(self.lost_answers());
        all.extend(self.uncertainty.iter().flat_map(|uncertainty| uncertainty.findings_with(names)));
        sort(&mut all);
        all
    }

    /// Minima of a search from several starts that has ended before it could say that these are all.
    fn open_minima(&self) -> Option<Finding> {
        let optima = &self.report.optima;
        let best = optima
            .first()
            .filter(|best| !self.report.is_success() && (optima.len() > 1 || self.report.fun < best.cost))?;
        let n_searches: usize = optima.iter().map(|optimum| optimum.n_starts).sum();
        let n_minima = optima.len();
        let sentence = match self.report.fun < best.cost {
            true => format!(
                "{n_searches} local searches have ended at {n_minima} minima, and the result is better than all of them: the search from \
                 it was cut off, and its minimum is lower"
            ),
            false => format!(
                "{n_searches} local searches have ended at {n_minima} minima, {} of them at the lowest: by these numbers there are more, \
                 and one may be lower",
                best.n_starts
            ),
        };
        let remedy = "compare the minima (optima); a larger max_evaluations lets more searches start";
        Some(Finding::note("search", sentence, remedy).of(Origin::Search))
    }

    /// Answers that the executor lost.
    fn lost_answers(&self) -> Option<Finding> {
        let n = self.report.n_lost;
        let sentence = format!(
            "the executor lost {n} answers; their points were evaluated again, which changes no result"
        );
        (n > 0).then(|| Finding::note("executor", sentence, "").of(Origin::Search))
    }

    /// The RMS over that at the start, on the same measurements; `None` if the simulation failed at the
    /// start.
    pub fn scaled_rms(&self) -> Option<f64> {
        self.start_rms.map(|start| self.rms / start)
    }
}
