//! Findings about the uncertainty as text: parameters that the data do not determine, individually, in pairs
//! or in larger combinations.

use crate::cost::accuracy::Accuracy;
use crate::error::CalibrationError;
use crate::findings::display_text::digits;
use crate::findings::finding::{Finding, Origin, Severity};
use crate::findings::identifier::FindingId;
use crate::uncertainty::covariance::matrix::{Factors, compressed};
use crate::uncertainty::covariance::noise::Noise;
use crate::uncertainty::diagnostics::residual_check::ResidualCheck;
use crate::uncertainty::differences::{Differences, ResidualBend};
use crate::uncertainty::result::{Uncertainty, errors_and_correlation};
use crate::uncertainty::row_blocks::triangle;
use base::RunContext;
use nalgebra::DMatrix;
use std::ops::Range;

/// Minimum absolute correlation of two confounded parameters. Less than a fifth of the variance of each is
/// then independent of the other.
const CONFOUNDED: f64 = 0.9;

/// Condition index above which a dependency among the columns of the Jacobian is harmful. The columns have
/// unit length. A parameter is part of the dependency if its share of variance exceeds the second constant
/// (Belsley, Kuh and Welsch, Regression Diagnostics, 1980, section 3.2).
const CONDITION_INDEX: f64 = 10.0;
const VARIANCE_SHARE: f64 = 0.5;

/// Relative standard error above which the data hardly determine a parameter.
const RELATIVE_ERROR: f64 = 0.5;

/// Effect on an output, relative to the strongest effect, above which a parameter counts as moving the
/// output. Each parameter is moved by its size.
const MOVES: f64 = 1e-8;

/// Ratio of the derivatives of the data to the derivative of the prior below which a parameter is known only
/// from its prior.
const PRIOR_ALONE: f64 = 1e-3;

/// Ratio below which two factors are reported as one.
const SAME_FACTOR: f64 = 1.05;

/// Shift by simulation errors, in standard errors, below which the errors do not matter.
const SHIFTED: f64 = 0.1;

/// Relative size of residual changes by simulation errors above which the effect of a parameter may be
/// hidden.
const ROUGH: f64 = 0.01;

impl Uncertainty {
    fn n(&self) -> usize {
        self.x.len()
    }

    /// Returns the size of a parameter.
    fn size(&self, i: usize) -> f64 {
        self.sizes.get(i).copied().unwrap_or(self.x[i].abs())
    }

    /// Returns the standard error relative to the size.
    fn relative_error(&self, i: usize) -> f64 {
        self.standard_errors[i] / self.size(i)
    }

    /// Returns the lengths of the columns of the Jacobian within these rows.
    fn lengths(&self, rows: Range<usize>) -> Vec<f64> {
        let n = self.n();
        let mut squares = vec![0.0; n];
        for row in self.jacobian[rows.start * n..rows.end * n].chunks_exact(n.max(1)) {
            squares.iter_mut().zip(row).for_each(|(sum, entry)| *sum += entry * entry);
        }
        squares.into_iter().map(f64::sqrt).collect()
    }

    /// True if a parameter moves the rows in which the columns of the Jacobian have these lengths.
    fn moves(&self, i: usize, lengths: &[f64]) -> bool {
        // A value of zero has no size, so any effect counts.
        let effect = |k: usize| lengths[k] * self.x[k].abs();
        let most = (0..self.n()).map(effect).fold(0.0, f64::max);
        let effect_of_parameter = if self.x[i] == 0.0 { f64::INFINITY } else { effect(i) };
        lengths[i] > 0.0 && effect_of_parameter > MOVES * most
    }

    /// Returns the rows of each output of each experiment.
    fn rows(&self) -> Vec<Range<usize>> {
        let ends = self.residual_checks.iter().scan(0, |end, check| {
            *end += check.n;
            Some(*end - check.n..*end)
        });
        ends.collect()
    }

    /// Returns the parameters that have a prior and that the data do not move away from it.
    fn determined_by_prior(&self) -> Vec<usize> {
        let measured = 0..self.rows().last().map_or(0, |rows| rows.end);
        let of_priors = self.lengths(measured.end..self.residuals.len());
        if of_priors.iter().all(|length| *length == 0.0) {
            return Vec::new();
        }
        let of_data = self.lengths(measured);
        let is_prior_alone = |i: &usize| {
            let (of_prior, of_measurements) = (of_priors[*i], of_data[*i]);
            of_prior > 0.0 && (of_measurements <= PRIOR_ALONE * of_prior || !self.moves(*i, &of_data))
        };
        (0..self.n()).filter(|i| !self.held.contains(i)).filter(is_prior_alone).collect()
    }

    /// Finds combinations of the parameters that the data determine badly, and parameters that they determine
    /// well. The `jacobian` belongs to the residuals, the `differences` to the working residuals. Both are
    /// with respect to the coordinates of the search.
    pub(crate) fn find_combinations(
        &mut self,
        jacobian: &DMatrix<f64>,
        differences: &Differences,
        noise: &Noise,
        free: &[usize],
        sizes: &[f64],
        context: &RunContext<'_>,
    ) -> Result<(), CalibrationError> {
        self.find_confounded();
        self.find_weakest(&triangle(jacobian, std::slice::from_ref(&(0..jacobian.nrows())), context)?, free);
        let weighted = differences.jacobian(context)?;
        self.find_identifiable(&weighted, noise, differences.noise, free, sizes, context)
    }

    /// Finds pairs with a high correlation that both move the same output. The correlation assumes
    /// independent residuals, because similar effects do not depend on the noise.
    fn find_confounded(&mut self) {
        let n = self.n();
        let correlation = match &self.uncorrected_covariance {
            Some(covariance) => errors_and_correlation(covariance, n).1,
            None => self.correlation.clone(),
        };
        let outputs: Vec<Vec<f64>> = self.rows().into_iter().map(|rows| self.lengths(rows)).collect();
        let share = |i, j| outputs.iter().any(|output| self.moves(i, output) && self.moves(j, output));
        let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j)));
        let mut found: Vec<(usize, usize, f64)> = pairs
            .map(|(i, j)| (i, j, correlation[i * n + j]))
            .filter(|(i, j, correlation)| correlation.abs() >= CONFOUNDED && share(*i, *j))
            .collect();
        found.sort_by(|a, b| b.2.abs().total_cmp(&a.2.abs()));
        self.confounded = found;
    }

    /// Finds the combination of parameters that the data determine worst, from the singular values of the
    /// Jacobian with columns of unit length. The `triangle` is the triangle of the Jacobian.
    fn find_weakest(&mut self, triangle: &DMatrix<f64>, free: &[usize]) {
        let determined: Vec<usize> =
            (0..free.len()).filter(|k| !self.undetermined.contains(&free[*k])).collect();
        let p = determined.len();
        if p < 3 || triangle.nrows() < p {
            return;
        }
        let mut columns = triangle.select_columns(&determined);
        columns.column_iter_mut().for_each(|mut column| {
            column.try_normalize_mut(0.0);
        });
        let Some(svd) = columns.qr().r().try_svd(false, true, f64::EPSILON, 10_000) else { return };
        let Some(v_t) = svd.v_t else { return };
        let values = svd.singular_values;
        if values[0] < CONDITION_INDEX * values[p - 1] {
            return;
        }
        let part = |a: usize, k: usize| (v_t[(k, a)] / values[k]).powi(2);
        let share = |a: usize| part(a, p - 1) / (0..p).map(|k| part(a, k)).sum::<f64>();
        let weakest: Vec<usize> =
            (0..p).filter(|a| share(*a) > VARIANCE_SHARE).map(|a| free[determined[a]]).collect();
        if weakest.len() > 2 {
            self.weakest = weakest;
        }
    }

    /// Finds the identifiable parameters. The `jacobian` is in the coordinates of the search, m x p. The
    /// `noise` is the noise of the residuals, and changes with a norm below `of_changes` are noise.
    fn find_identifiable(
        &mut self,
        jacobian: &DMatrix<f64>,
        noise: &Noise,
        of_changes: f64,
        free: &[usize],
        sizes: &[f64],
        context: &RunContext<'_>,
    ) -> Result<(), CalibrationError> {
        if noise.degrees_of_freedom == 0.0 {
            return Ok(());
        }
        let is_about_zero = |k: usize| self.is_about_zero.get(free[k]).copied().unwrap_or_default();
        let (mut scaled, variances) = compressed(jacobian, &noise.variances, context)?;
        for (k, mut column) in scaled.column_iter_mut().enumerate() {
            // Logarithmic coordinates of the search are relative already.
            column *= match (self.is_log[free[k]], self.size(free[k])) {
                (true, _) => 1.0,
                (false, 0.0) => sizes[k],
                (false, size) => size,
            };
        }
        let mut chosen: Vec<usize> = Vec::new();
        for k in pivots(scaled.clone()) {
            chosen.push(k);
            let p = chosen.len();
            let changes = scaled.select_columns(&chosen);
            let part = Differences::of(changes, DMatrix::identity(p, p), of_changes);
            let factors = Factors::new(&part, context)?;
            let covariance = factors.covariance(&variances, context)?;
            let error = |a: usize| covariance[(a, a)].sqrt();
            let correlation = |a: usize, b: usize| covariance[(a, b)] / (error(a) * error(b));
            let are_determined = (0..p).all(|a| {
                (error(a) < RELATIVE_ERROR || is_about_zero(chosen[a]))
                    && (0..a).all(|b| correlation(a, b).abs() < CONFOUNDED)
            });
            // The variance of a combination below the noise is missing in this covariance.
            let is_whole = !factors.is_undetermined.contains(&true);
            if !(are_determined && is_whole) {
                chosen.pop();
                break;
            }
        }
        self.identifiable = chosen.iter().map(|k| free[*k]).collect();
        self.identifiable.sort_unstable();
        Ok(())
    }

    /// Returns the names as text, for example "C1, G1 and C2".
    fn list(&self, parameters: &[usize]) -> String {
        let names: Vec<&str> = parameters.iter().map(|i| self.names[*i].as_str()).collect();
        match names.split_last() {
            Some((last, [])) => (*last).to_owned(),
            Some((last, others)) => format!("{} and {last}", others.join(", ")),
            None => String::new(),
        }
    }

    /// Returns findings about parameters that the data do not determine.
    pub(crate) fn undetermined_findings(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        let mut find = |id, names: String, sentence: String, remedy: &str| {
            findings.push(Finding::warning(id, names, sentence, remedy).of(Origin::Search));
        };
        if self.degrees_of_freedom == 0.0 && self.held.len() < self.n() {
            let sentence = "the number of residuals does not exceed the number of parameters, so standard errors cannot be estimated";
            find(
                FindingId::NoDegreesOfFreedom,
                "parameters".to_owned(),
                sentence.to_owned(),
                "Fit fewer parameters, or record more data",
            );
        }
        let inert = &self.without_effect;
        // Changes below the simulation error do not count.
        let (limit, remedy) = match self.simulation_noise > ROUGH {
            true => (
                format!(
                    " within the simulation error of {} % of the residuals",
                    digits(100.0 * self.simulation_noise)
                ),
                Some("Set a smaller relative_tolerance (or step_size), so that smaller changes count"),
            ),
            false => (String::new(), None),
        };
        if !inert.is_empty() {
            let (change, values) = match inert.len() {
                1 => ("it changes", "Its value is"),
                _ => ("they change", "Their values are"),
            };
            let names = self.list(inert);
            let beyond = limit.replacen("within", "beyond", 1);
            let sentence = format!(
                "the data do not determine {names}: {change} no measured output{beyond}. {values} meaningless"
            );
            let remedy = remedy.unwrap_or("Fix such parameters, or record an experiment in which they act");
            find(FindingId::ParameterWithoutEffect, names, sentence, remedy);
        }
        let together: Vec<usize> = self.undetermined.iter().copied().filter(|i| !inert.contains(i)).collect();
        let names = self.list(&together);
        match together.len() {
            0 => {}
            1 => find(
                FindingId::UndeterminedParameter,
                names.clone(),
                format!("the data do not determine {names}: other values fit equally well{limit}"),
                remedy.unwrap_or("Fix it, add a prior, or record an experiment that determines it"),
            ),
            _ => find(
                FindingId::UndeterminedParameter,
                names.clone(),
                format!(
                    "the data do not determine {names}: other combinations of their values fit equally well{limit}"
                ),
                remedy.unwrap_or("Fix all but one, or combine them"),
            ),
        }
        findings
    }

    /// Returns findings about pairs with a high correlation. Each reports which combination of the pair is
    /// known better and which worse.
    fn confounded_findings(&self) -> impl Iterator<Item = Finding> {
        self.confounded.iter().map(|(i, j, correlation)| {
            let names = self.list(&[*i, *j]);
            // Relative changes are changes of logarithms: they add up in a product and cancel in a
            // quotient.
            let relative = [*i, *j].map(|k| self.standard_errors[k] / self.x[k]);
            let are_relative = relative.iter().all(|error| error.abs() < RELATIVE_ERROR);
            let [a, b] = if are_relative { relative } else { [*i, *j].map(|k| self.standard_errors[k]) };
            let error = |sign: f64| (a * a + b * b + sign * 2.0 * correlation * a * b).max(0.0).sqrt();
            let (sum, difference) = (error(1.0), error(-1.0));
            let [of_sum, of_difference] =
                if are_relative { ["product", "quotient"] } else { ["sum", "difference"] };
            let (worse, better) = match sum > difference {
                true => (of_sum, of_difference),
                false => (of_difference, of_sum),
            };
            let factor = digits(sum.max(difference) / sum.min(difference));
            let sentence = format!(
                "{names} change the outputs in the same way (correlation {correlation:.2}), and their {worse} is {factor} times less certain \
                 than their {better}. Their standard errors include this"
            );
            let remedy = "If the standard errors are too large, fix one, add a prior, or record an experiment that distinguishes them";
            Finding::note(FindingId::CorrelatedParameters, names, sentence, remedy)
        })
    }

    /// Returns a finding if a different accuracy of the simulations changes the cost and the parameters
    /// significantly. A cost that is only simulation error is excluded.
    fn accuracy_finding(&self, f_tol: f64) -> Option<Finding> {
        let accurate = self.accurate_cost?;
        let difference = (accurate - self.cost).abs();
        let size = self.cost.abs().max(accurate.abs());
        let is_moved = self.shift_by_accuracy > SHIFTED;
        (difference > f_tol * size && is_moved && !self.is_exact).then(|| {
            let (subject, remedy) = match self.is_step_halved {
                true => {
                    let smaller = Accuracy::smaller_step(self.step_size);
                    ("step", format!("{smaller}, or use a solver that chooses its steps"))
                }
                false => ("relative tolerance", "Set a smaller relative_tolerance".to_owned()),
            };
            let sentence = format!(
                "the cost {} changes by {} with {}, which is {} of its value (f_tol is {}). A parameter changes by {} standard errors",
                digits(self.cost),
                digits(accurate - self.cost),
                Accuracy::words(self.is_step_halved),
                digits(difference / size),
                digits(f_tol),
                digits(self.shift_by_accuracy),
            );
            Finding::warning(FindingId::InaccurateSimulation, subject, sentence, remedy).of(Origin::Search)
        })
    }

    /// Returns a finding if the cost is not smooth, so that a local search finds an arbitrary minimum.
    fn rough_cost(&self) -> Option<Finding> {
        self.roughness.map(|ResidualBend { bend, bend_of_part }| {
            let sentence = format!(
                "the cost is not smooth: the residuals bend by {} % of their change over about one standard error, and by {} % over a sixteenth \
                 of it, where a smooth model bends a sixteenth as much. The standard errors are unreliable, and a local search may have \
                 ended at any of many minima",
                digits((100.0 * bend).round()),
                digits((100.0 * bend_of_part).round())
            );
            let remedy = "Use search=\"global\" or better start values, and check whether the model switches at times that depend on the \
                          parameters. At the right minimum the RMS is close to the noise of the sensors";
            Finding::warning(FindingId::RoughCost, "the cost", sentence, remedy).of(Origin::Search)
        })
    }

    /// Returns a finding if a search ended before its minimum.
    fn not_at_minimum(&self) -> Option<Finding> {
        let percent = digits(100.0 * self.achievable_decrease);
        let (id, sentence, remedy) = match self.is_at_failures {
            _ if self.achievable_decrease == 0.0 => return None,
            true => (
                FindingId::MinimumBeyondFailures,
                format!(
                    "the cost decreases towards values that cannot be simulated (one more least-squares step would remove {percent} % of it). \
                     The search ended next to them, before the minimum"
                ),
                "Look at the reasons of the failures, and set bounds that exclude these values if they are meaningless",
            ),
            false => (
                FindingId::BeforeMinimum,
                format!(
                    "one more least-squares step removes {percent} % of the cost. The search ended before the minimum"
                ),
                "Set smaller x_tol and f_tol or larger limits, and start from the result",
            ),
        };
        Some(Finding::warning(id, "search", sentence, remedy).of(Origin::Search))
    }

    /// Raises the severity of the smoothness finding for a local search. If the cost is not smooth, the
    /// result is one of many minima that no measurement distinguishes.
    pub(crate) fn found_by_local_search(&mut self) {
        let rough = self.findings.iter_mut().filter(|finding| finding.id == FindingId::RoughCost);
        rough.for_each(|finding| finding.severity = Severity::Error);
    }

    /// Rewrites the finding about an early end for a last stage that holds parameters of other stages.
    pub(crate) fn found_in_stages(&mut self) {
        let percent = digits(100.0 * self.achievable_decrease);
        for finding in self.findings.iter_mut().filter(|finding| finding.id == FindingId::BeforeMinimum) {
            finding.id = FindingId::StagesApart;
            finding.sentence = format!(
                "one least-squares step in all parameters together removes {percent} % of the cost, although each stage ended normally. The \
                 values depend on what the stages held fixed, and are off by more than their standard errors"
            );
            finding.remedy =
                "Add a last stage with all parameters, because smaller tolerances do not help".to_owned();
        }
    }

    /// Returns a finding about standard errors corrected for autocorrelation, with the factor.
    fn correction(&self) -> Option<Finding> {
        let uncorrected = self.uncorrected_errors()?;
        let factors =
            self.standard_errors.iter().zip(uncorrected).map(|(corrected, without)| corrected / without);
        let (low, high) = factors
            .filter(|factor| factor.is_finite())
            .fold((f64::INFINITY, 0.0_f64), |(low, high), factor| (low.min(factor), high.max(factor)));
        let largest = self.autocorrelations.iter().copied().fold(0.0, f64::max);
        let times = match high / low < SAME_FACTOR {
            true => digits(high).to_string(),
            false => format!("{} to {}", digits(low), digits(high)),
        };
        (high > 0.0).then(|| {
            let sentence = format!(
                "the standard errors are {times} times the errors of independent residuals. They are corrected for autocorrelation ({largest:.2} \
                 at lag one)"
            );
            Finding::note(FindingId::CorrectedStandardErrors, "standard errors", sentence, "")
        })
    }

    /// Returns all findings.
    pub(crate) fn all_findings(&self, f_tol: f64) -> Vec<Finding> {
        let mut findings = self.undetermined_findings();
        let mut note = |id, subject: String, sentence: String, remedy: &str| {
            findings.push(Finding::note(id, subject, sentence, remedy));
        };
        for i in self.determined_by_prior() {
            let name = &self.names[i];
            let sentence = format!(
                "{name} is known from its prior alone. The data are much less accurate or contain no information about it"
            );
            let remedy = "Record an experiment in which it acts, or widen the prior";
            note(FindingId::PriorOnly, name.clone(), sentence, remedy);
        }
        if !self.weakest.is_empty() {
            let names = self.list(&self.weakest);
            let sentence = format!(
                "{names} can be changed together with little change of the outputs. Their standard errors include this"
            );
            let remedy = "If the standard errors are too large, fix one, or record an experiment that distinguishes them";
            note(FindingId::WeakCombination, names, sentence, remedy);
        }
        findings.extend(self.confounded_findings());
        for i in (0..self.n()).filter(|i| self.standard_errors[*i].is_finite() && self.size(*i) != 0.0) {
            let error = self.relative_error(i);
            let is_about_zero = self.is_about_zero.get(i).copied().unwrap_or_default();
            if error > RELATIVE_ERROR && !is_about_zero {
                let (name, percent) = (&self.names[i], digits((100.0 * error).round()));
                let of = if self.size(i) == self.x[i].abs() { "value" } else { "size" };
                let sentence = format!(
                    "the standard error of {name} is {percent} % of its {of}. The data contain little information about it"
                );
                let remedy = "Fix it, add a prior, or record more data";
                findings.push(Finding::warning(FindingId::LargeStandardError, name, sentence, remedy));
            }
        }
        let n_free = self.n() - self.held.len();
        // Exact residuals provide no variance that values could be compared with.
        if self.identifiable.len() < n_free && self.degrees_of_freedom > 0.0 && !self.is_exact {
            let (severity, sentence, remedy) = match self.identifiable.is_empty() {
                true => (
                    Severity::Warning,
                    "the data determine no parameter to half of its value".to_owned(),
                    "Record another experiment, or add priors",
                ),
                false => (
                    Severity::Note,
                    format!(
                        "with the other parameters fixed, the data determine {} (standard errors below half of the values, correlations \
                         below {CONFOUNDED})",
                        self.list(&self.identifiable)
                    ),
                    "",
                ),
            };
            findings.push(Finding::new(severity, FindingId::IdentifiableParameters, "", sentence, remedy));
        }
        if self.is_exact {
            let sentence = "the measurements are reproduced to the accuracy of the simulations. Standard errors are then meaningless";
            findings.push(Finding::note(FindingId::ExactMeasurements, "measurements", sentence, ""));
        }
        if !self.is_exact {
            findings.extend(ResidualCheck::all_findings(&self.residual_checks, self.has_loss, true));
            findings.extend(self.lack_of_fit.and_then(|test| test.finding()));
            findings.extend(self.correction());
        }
        findings.extend(self.accuracy_finding(f_tol));
        findings.extend(self.rough_cost());
        findings.extend(self.not_at_minimum());
        findings.extend(self.prior_conflicts.iter().map(|c| c.finding(&self.names[c.parameter])));
        // Findings about the parameters themselves explain the others.
        let rest = findings.iter_mut().filter(|finding| finding.origin == Origin::Problem);
        rest.for_each(|finding| finding.origin = Origin::Residuals);
        findings
    }
}

/// Returns the order in which each column is most independent of the columns before it (QR with column
/// pivoting).
fn pivots(mut columns: DMatrix<f64>) -> Vec<usize> {
    let p = columns.ncols();
    let mut order: Vec<usize> = Vec::with_capacity(p);
    while order.len() < p {
        let left = (0..p).filter(|k| !order.contains(k));
        let longest = left.map(|k| (k, columns.column(k).norm())).fold(
            None,
            |best: Option<(usize, f64)>, (k, norm)| match best {
                Some((_, longest)) if longest >= norm => best,
                _ => Some((k, norm)),
            },
        );
        let Some((k, norm)) = longest else { break };
        order.push(k);
        if norm > 0.0 {
            let direction = columns.column(k) / norm;
            for other in (0..p).filter(|other| !order.contains(other)) {
                let along = direction.dot(&columns.column(other));
                columns.column_mut(other).axpy(-along, &direction, 1.0);
            }
        }
    }
    order
}
