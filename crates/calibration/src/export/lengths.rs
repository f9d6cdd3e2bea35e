//! Consistency checks of the lengths of the parts of a loaded fit.

use crate::fit::one_stage::Fit;
use crate::uncertainty::preflight::Preflight;
use crate::uncertainty::result::Uncertainty;

/// Returns an error if a part of a fit has a length that does not match its parameters and residuals. The
/// message contains the name of the first such part.
pub(super) fn check_lengths(fit: &Fit) -> Result<(), String> {
    check_fit(fit, "fit")
}

fn check_fit(fit: &Fit, place: &str) -> Result<(), String> {
    let n = fit.x.len();
    let Fit { names, start, units, bounds, report, at_bound, without_effect, preflight, stages, .. } = fit;
    let lengths = [
        ("names", names.len()),
        ("shown_names", fit.shown_names().len()),
        ("start", start.len()),
        ("units", units.len()),
        ("bounds", bounds.len()),
        ("report.x", report.x.len()),
    ];
    lengths.into_iter().try_for_each(|(field, found)| same(place, field, found, n))?;
    for (k, derived) in fit.derived.iter().enumerate() {
        same(place, &format!("derived[{k}].slopes"), derived.slopes.len(), n)?;
    }
    let at_bound: Vec<usize> = at_bound.iter().map(|(index, _)| *index).collect();
    below(place, "at_bound", &at_bound, n)?;
    below(place, "without_effect", without_effect, n)?;
    for (k, optimum) in report.optima.iter().enumerate() {
        same(place, &format!("report.optima[{k}].x"), optimum.x.len(), n)?;
    }
    if !report.is_sound() {
        return Err(format!("the parts of {place}.report (trace, residuals, jacobian) are inconsistent"));
    }
    preflight
        .iter()
        .try_for_each(|preflight| check_preflight(preflight, n, &format!("{place}.preflight")))?;
    fit.uncertainty
        .iter()
        .try_for_each(|uncertainty| check_uncertainty(uncertainty, n, &format!("{place}.uncertainty")))?;
    if fit.uncertainty.as_ref().is_some_and(|uncertainty| uncertainty.names != *names) {
        return Err(format!("{place}.uncertainty.names differ from {place}.names"));
    }
    let stage = |(k, stage): (usize, &Fit)| check_fit(stage, &format!("{place}.stages[{k}]"));
    stages.iter().enumerate().try_for_each(stage)
}

impl Uncertainty {
    /// Returns an error if a part of a loaded uncertainty has a length that does not match its parameters and
    /// residuals.
    ///
    /// # Errors
    /// Returns a message with the name of the first such part.
    pub fn check_lengths(&self) -> Result<(), String> {
        check_uncertainty(self, self.x.len(), "uncertainty")
    }
}

fn check_uncertainty(uncertainty: &Uncertainty, n: usize, place: &str) -> Result<(), String> {
    let m = uncertainty.residuals.len();
    let lengths = [
        ("names", uncertainty.names.len(), n),
        ("x", uncertainty.x.len(), n),
        ("is_log", uncertainty.is_log.len(), n),
        ("covariance", uncertainty.covariance.len(), n * n),
        ("standard_errors", uncertainty.standard_errors.len(), n),
        ("correlation", uncertainty.correlation.len(), n * n),
        (
            "uncorrected_covariance",
            uncertainty.uncorrected_covariance.as_ref().map_or(n * n, Vec::len),
            n * n,
        ),
        ("autocorrelations", uncertainty.autocorrelations.len(), uncertainty.residual_checks.len()),
        ("effective_degrees_of_freedom", uncertainty.effective_degrees_of_freedom.len(), n),
        ("jacobian", uncertainty.jacobian.len(), m * n),
    ];
    lengths.into_iter().try_for_each(|(field, found, wanted)| same(place, field, found, wanted))?;
    let n_outputs = uncertainty.residual_checks.len();
    for (field, joint) in [
        ("joint", Some(&uncertainty.joint).filter(|joint| !joint.is_empty())),
        ("uncorrected_joint", uncertainty.uncorrected_joint.as_ref()),
    ] {
        if joint.is_some_and(|joint| !joint.is_sound(n, n_outputs)) {
            return Err(format!("the parts of {place}.{field} are inconsistent"));
        }
    }
    let lists = [
        ("held", &uncertainty.held),
        ("undetermined", &uncertainty.undetermined),
        ("without_effect", &uncertainty.without_effect),
        ("weakest", &uncertainty.weakest),
        ("identifiable", &uncertainty.identifiable),
        ("confounded", &pairs(&uncertainty.confounded)),
    ];
    lists.into_iter().try_for_each(|(field, indices)| below(place, field, indices, n))
}

fn check_preflight(preflight: &Preflight, n: usize, place: &str) -> Result<(), String> {
    same(place, "parameters", preflight.parameters.len(), n)?;
    below(place, "confounded", &pairs(&preflight.confounded), n)
}

fn pairs(confounded: &[(usize, usize, f64)]) -> Vec<usize> {
    confounded.iter().flat_map(|(a, b, _)| [*a, *b]).collect()
}

fn same(place: &str, field: &str, found: usize, wanted: usize) -> Result<(), String> {
    match found == wanted {
        true => Ok(()),
        false => Err(format!(
            "{place}.{field} has {found} entries; expected {wanted}. The parts of the result are inconsistent"
        )),
    }
}

fn below(place: &str, field: &str, indices: &[usize], n: usize) -> Result<(), String> {
    match indices.iter().find(|index| **index >= n) {
        None => Ok(()),
        Some(index) => Err(format!(
            "{place}.{field} contains the parameter index {index}; expected less than {n}. The parts of the result are inconsistent"
        )),
    }
}
