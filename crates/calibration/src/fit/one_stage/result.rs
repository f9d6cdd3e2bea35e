//! Result of a fit.

use super::noise::FitNoise;
use super::tolerance::ChosenTolerance;
use crate::findings::display_text::digits;
use crate::findings::finding::{Finding, Origin, Severity, sort};
use crate::findings::identifier::FindingId;
use crate::fit::output_fit::OutputFit;
use crate::fit::phase::PhaseCost;
use crate::loaded::calibration::Calibration;
use crate::problem::prior::Prior;
use crate::problem::residual_layout::ResidualLayout;
use crate::uncertainty::derived_value::DerivedValue;
use crate::uncertainty::inactive_parameters::BoundSide;
use crate::uncertainty::preflight::Preflight;
use crate::uncertainty::result::Uncertainty;
use base::Number;
use dfo::{Record, Report, Termination};
use ode::{Method, Stats};
use serde::{Deserialize, Serialize};

/// Result of a fit. `Display` prints a summary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Fit {
    /// Fitted values of all parameters, including fixed ones, in the user's order and units.
    pub x: Vec<f64>,
    /// Names of the parameters, in the same order.
    pub names: Vec<String>,
    /// Names of the parameters in reports and figures, in the same order (see
    /// [`Parameter::display_name`](crate::Parameter::display_name)). If empty, use `names`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shown_names: Vec<String>,
    /// Parameters that are tied to others or derived from them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub derived: Vec<DerivedValue>,
    /// Start values of the parameters.
    pub start: Vec<f64>,
    /// Units of the parameters in the same order, if they are known.
    pub units: Vec<Option<String>>,
    /// Priors of the parameters that are not fixed, by index.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub priors: Vec<(usize, Prior)>,
    /// Lower and upper bounds of the parameters in the same order. Both are equal for a fixed parameter.
    pub bounds: Vec<(f64, f64)>,
    /// Number of independent equalities between the fitted parameters. Each reduces the number of parameters
    /// that the measurements determine.
    #[serde(default)]
    pub n_equalities: usize,
    /// Name of the model.
    pub model: String,
    /// Reason why the FMU ran in this process although a separate process was requested (see
    /// [`Calibration::isolation`](crate::Calibration::isolation)).
    #[serde(default)]
    pub in_this_process: Option<String>,
    /// Number of measurements that count.
    pub n_measurements: usize,
    /// Cost at the result: the sum of the squared weighted residuals. If the [noise](Self::noise) was
    /// estimated, it determines the weights. With a loss, the cost is the sum of the contributions by the
    /// loss.
    pub cost: f64,
    /// Root of the mean squared weighted residual of the measurements at the result. Uses the weights of the
    /// calibration and no loss.
    pub rms: f64,
    /// Name of the cost, see [`CostKind::name`](crate::CostKind::name).
    pub objective: String,
    /// Requested options, with the names that users write (see
    /// [`FitOptions::record`](crate::FitOptions::record)). The options of a stage include its `parameters`
    /// and `windows`.
    pub options: Record,
    /// Source of the noise of the measurements, which determines the weight of the priors. `None` if there
    /// are no priors and no estimate, the cost is not a sum of squares, or there was no time for a search.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<FitNoise>,
    /// Relative tolerance chosen for the simulations. `None` if the user specified it, or if the fit
    /// used the tolerance of the calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<ChosenTolerance>,
    /// Cost at the start, if the simulation did not fail there.
    pub start_cost: Option<f64>,
    /// RMS at the start, if the simulation did not fail there.
    pub start_rms: Option<f64>,
    /// Fits of the stages, see [`Calibration::fit_stages`](crate::Calibration::fit_stages). Empty if there
    /// were no stages.
    pub stages: Vec<Fit>,
    /// Parameters that ended at a bound, by index. Their best values may be beyond the bound.
    pub at_bound: Vec<(usize, BoundSide)>,
    /// Parameters, by index, that did not change the cost by more than the relative tolerance of the
    /// simulations. Their values are meaningless.
    pub without_effect: Vec<usize>,
    /// Number of simulations after the run to detect parameters at a bound or without effect.
    ///
    /// A parameter that ended within `x_tol` of a bound requires a simulation at the bound. A parameter that
    /// did not change the cost in an evaluation requires a simulation with the parameter moved. Without
    /// standard errors, which show the effect, each parameter whose effect no evaluation has shown also
    /// requires one. A first simplex shows the effects, because its points differ in one parameter only.
    ///
    /// The simulations are part of `stats` but do not count as evaluations of the run. They are skipped after
    /// an interrupt or when the time limit has expired.
    pub n_checks: usize,
    /// Checks skipped because the search was short. Empty if nothing was skipped. Simulations outside
    /// the search and the standard errors are limited to a quarter of the evaluations of the
    /// search. They are also limited to four simulations of the result.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub skipped: Vec<String>,
    /// Quality of fit of each output, in the order of the residual vector. Empty if the run was interrupted.
    pub outputs: Vec<OutputFit>,
    /// Result of the preflight, if it was requested.
    pub preflight: Option<Preflight>,
    /// Findings about the run, and findings of a [check](crate::Calibration::check) of the problem with the
    /// fitted values. The check is made only if the uncertainty is requested, and its notes are omitted.
    /// [`Fit::findings`] returns all findings.
    pub setup_findings: Vec<Finding>,
    /// Uncertainty of the fit. `None` if it was not requested or the run was interrupted.
    pub uncertainty: Option<Uncertainty>,
    /// Statistics of all simulations of the fit, from the search to the standard errors: right-hand sides,
    /// steps, events, and seconds summed over all workers. Failed and stopped simulations count. Simulations
    /// before a resume do not count. The repeated evaluations of the best point, in a fresh process and in
    /// used processes, are among the [checks](Stats::checks).
    pub stats: Stats,
    /// Cost of the phases: the simulations that `stats` counts, and wall-clock time.
    #[serde(default)]
    pub phases: Vec<PhaseCost>,
    /// Integration method of all simulations.
    pub solver: Method,
    /// Report of the optimiser: counts, termination reason, trace.
    pub report: Report,
}

impl Fit {
    /// True if the search succeeded (see [`Report::is_success`](dfo::Report::is_success)) and the uncertainty
    /// found no step of all parameters together that lowers the cost further.
    pub fn is_success(&self) -> bool {
        self.report.is_success() && self.achievable_decrease() == 0.0
    }

    /// Returns the part of the cost that one step of least squares from the result removes, if it exceeds the
    /// noise.
    fn achievable_decrease(&self) -> f64 {
        self.uncertainty.as_ref().map_or(0.0, |uncertainty| uncertainty.achievable_decrease)
    }

    /// Marks the report as not converged if the search ended before its minimum. Not for a single stage,
    /// because its fixed parameters are free in other stages.
    pub(crate) fn note_end_before_minimum(&mut self) {
        let left = self.achievable_decrease();
        if left > 0.0 && matches!(self.report.termination, Termination::Converged | Termination::Noise) {
            self.report.message = format!(
                "not converged: one more least-squares step removes {} % of the cost; {}",
                digits(100.0 * left),
                self.report.message
            );
            self.report.termination = Termination::BeforeMinimum;
        }
    }

    /// True if each stage may be at its minimum but all parameters together are not.
    pub(crate) fn is_conditional(&self) -> bool {
        let mut findings = self.uncertainty.iter().flat_map(|uncertainty| &uncertainty.findings);
        findings.any(|finding| finding.id == FindingId::StagesApart)
    }

    /// Returns the meaning of each entry of the residual vector of this fit, with the weights that the fit
    /// used. These are the weights of the calibration, or the weights from the estimated [noise](Fit::noise).
    pub fn residual_layout(&self, calibration: &Calibration) -> ResidualLayout {
        let mut layout = calibration.residual_layout().clone();
        if let Some(noise) = self.noise.as_ref().and_then(FitNoise::estimated) {
            noise.weigh_layout(calibration.problem(), &mut layout);
        }
        layout
    }

    /// Returns the names of the parameters in reports and figures.
    pub fn shown_names(&self) -> &[String] {
        if self.shown_names.is_empty() { &self.names } else { &self.shown_names }
    }

    /// True if no finding is an error. The values are usable within the limits that the warnings describe.
    pub fn is_usable(&self) -> bool {
        self.findings().iter().all(|finding| finding.severity != Severity::Error)
    }

    /// Returns the findings about the fit: findings of a check, parameters that are at a bound or not
    /// determined by the data, and properties of the residuals. Findings that explain others come first,
    /// notes last.
    pub fn findings(&self) -> Vec<Finding> {
        self.findings_with(&self.names)
    }

    /// Returns the findings with other names of the parameters.
    pub(crate) fn findings_with(&self, names: &[String]) -> Vec<Finding> {
        let at_bound = |(i, side): &(usize, BoundSide)| {
            let bound = match side {
                BoundSide::Lower => self.bounds[*i].0,
                BoundSide::Upper => self.bounds[*i].1,
            };
            let sentence = format!(
                "{} is at its {} bound {}. The best value may lie beyond",
                names[*i],
                side.name(),
                Number(bound)
            );
            let remedy = "Widen the bound if larger or smaller values are possible";
            Finding::warning(FindingId::AtBound, &names[*i], sentence, remedy).of(Origin::Search)
        };
        let without_effect = |i: &usize| {
            let sentence = format!("{} did not change the cost. Its value is meaningless", names[*i]);
            let remedy = "Fix it, or record an experiment in which it acts";
            Finding::warning(FindingId::ParameterWithoutEffect, &names[*i], sentence, remedy)
                .of(Origin::Search)
        };
        let is_reported = |i: &&usize| {
            !self.uncertainty.as_ref().is_some_and(|uncertainty| uncertainty.undetermined.contains(i))
        };
        let mut all: Vec<Finding> = self.at_bound.iter().map(at_bound).collect();
        all.extend(self.without_effect.iter().filter(is_reported).map(without_effect));
        all.extend(self.setup_findings.iter().cloned());
        all.extend(self.open_minima());
        all.extend(self.lost_answers());
        all.extend(self.uncertainty.iter().flat_map(|uncertainty| uncertainty.findings_with(names)));
        sort(&mut all);
        all
    }

    /// Returns a finding if a search from several starts ended before it had found all minima.
    fn open_minima(&self) -> Option<Finding> {
        let optima = &self.report.optima;
        let best = optima
            .first()
            .filter(|best| !self.report.is_success() && (optima.len() > 1 || self.report.fun < best.cost))?;
        let n_searches: usize = optima.iter().map(|optimum| optimum.n_starts).sum();
        let n_minima = optima.len();
        let sentence = match self.report.fun < best.cost {
            true => format!(
                "{n_searches} local searches ended at {n_minima} minima, and the result is below all of them. A limit ended the search from \
                 it, so its minimum is lower"
            ),
            false => format!(
                "{n_searches} local searches ended at {n_minima} minima, {} of them at the lowest. These numbers suggest more minima, and one \
                 may be lower",
                best.n_starts
            ),
        };
        let remedy = "Compare the minima (optima), and set a larger max_evaluations for more searches";
        Some(Finding::note(FindingId::OpenMinima, "search", sentence, remedy).of(Origin::Search))
    }

    /// Returns a finding about answers that the executor lost.
    fn lost_answers(&self) -> Option<Finding> {
        let n = self.report.n_lost;
        let sentence = format!(
            "the executor lost {n} answers. Their points were evaluated again, so the result is unaffected"
        );
        (n > 0).then(|| Finding::note(FindingId::LostAnswers, "executor", sentence, "").of(Origin::Search))
    }

    /// Returns the RMS relative to the RMS at the start, on the same measurements. Returns `None` if the
    /// simulation failed at the start.
    pub fn scaled_rms(&self) -> Option<f64> {
        self.start_rms.map(|start| self.rms / start)
    }
}
