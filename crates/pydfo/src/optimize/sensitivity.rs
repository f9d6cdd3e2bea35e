//! Sensitivity analysis of a Python function, and its result as the fields of `pydfo.Sensitivity`.

use crate::convert::dict::dict;
use crate::convert::error;
use crate::convert::record::PyRecord;
use crate::optimize::minimize::{Call, EndedRun, RunSetup, run};
use dfo::{
    Bounds, Effects, IntervalOptions, MorrisEffects, RobustLoss, RunOptions, Sensitivity, SensitivityDesign,
    SensitivityMethod, SobolIndices,
};
use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict};

/// Method, number of trajectories or rows, levels and second order; None for a default. Then the level of the
/// intervals and the number of resamples.
pub(crate) type PyAnalysis = (String, Option<usize>, Option<usize>, bool, f64, Option<usize>);

/// Returns the method and the intervals of an analysis.
pub(crate) fn method_of(
    py: Python<'_>,
    analysis: PyAnalysis,
) -> PyResult<(SensitivityMethod, IntervalOptions)> {
    let (name, given, levels, second_order, level, n_resamples) = analysis;
    let method = match (name.as_str(), SensitivityMethod::MORRIS, SensitivityMethod::SOBOL) {
        ("morris", SensitivityMethod::Morris { n, levels: usual }, _) => {
            SensitivityMethod::Morris { n: given.unwrap_or(n), levels: levels.unwrap_or(usual) }
        }
        (_, _, SensitivityMethod::Sobol { n, .. }) => {
            SensitivityMethod::Sobol { n: given.unwrap_or(n), second_order }
        }
        _ => return Err(pyo3::exceptions::PyValueError::new_err(name)),
    };
    let usual = IntervalOptions::default();
    let intervals = IntervalOptions { level, n_resamples: n_resamples.unwrap_or(usual.n_resamples) };
    intervals.check().map_err(|e| error::optimiser(py, &e))?;
    Ok((method, intervals))
}

/// Evaluates a Python function that returns a vector at all points of a design, and estimates the effects.
/// The arguments are as in `minimize`. `names` are the names of the parameters, and `outputs` the names of
/// the values; by default, they are numbered. An interrupt or an exception carries the fields of the partial
/// result.
#[pyfunction]
#[pyo3(signature = (func, lower, upper, options, analysis, names, outputs, *, failures_allowed=false, batches=false))]
#[expect(clippy::too_many_arguments, reason = "arguments of a private function")]
pub(crate) fn sensitivity<'py>(
    py: Python<'py>,
    func: Py<PyAny>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    options: PyRecord,
    analysis: PyAnalysis,
    names: Vec<String>,
    outputs: Option<Vec<String>>,
    failures_allowed: bool,
    batches: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let (method, intervals) = method_of(py, analysis)?;
    let requested = options.run(py, RunOptions::default(), lower.len())?;
    let seed = requested.options.seed.or_else(|| requested.options.checkpoint.is_some().then_some(0));
    let design = Bounds::new(&lower, &upper)
        .and_then(|bounds| SensitivityDesign::new(bounds, &requested.scale, &requested.kinds, method, seed))
        .map_err(|e| error::optimiser(py, &e))?;
    let call = Call {
        failures_allowed,
        batches,
        cutoffs: false,
        is_constrained: false,
        loss: Some(RobustLoss::default()),
    };
    let setup = RunSetup::new(None, lower, upper, requested).listed(design.listed());
    let EndedRun { stop, raised, outcome } = run(py, func, call, setup, None)?;
    let raised = raised.or_else(|| stop.take_raised());
    let found = design.evaluations(outcome).and_then(|evaluations| {
        let first = evaluations.values.iter().find(|values| !values.is_empty());
        let numbered = || (0..first.map_or(1, Vec::len)).map(|k| format!("y[{k}]")).collect();
        let outputs: Vec<String> = outputs.unwrap_or_else(numbered);
        design.analyze(&evaluations, &names, &outputs, intervals)
    });
    let fields = match found {
        Ok(found) => Some(fields(py, &found)?.into_any()),
        Err(e) if raised.is_none() && !stop.is_requested() => return Err(error::optimiser(py, &e)),
        Err(_) => None,
    };
    error::ended(py, &stop, raised, fields)
}

/// Returns the fields of `pydfo.Sensitivity`.
pub(crate) fn fields<'py>(py: Python<'py>, found: &Sensitivity) -> PyResult<Bound<'py, PyDict>> {
    let mut effects: Vec<(&str, Vec<Vec<f64>>)> = Vec::new();
    let mut add = |name, values: &[f64]| match effects.iter_mut().find(|(listed, _)| *listed == name) {
        Some((_, rows)) => rows.push(values.to_vec()),
        None => effects.push((name, vec![values.to_vec()])),
    };
    for output in &found.outputs {
        match &output.effects {
            Effects::Morris(MorrisEffects { mu, mu_star, sigma, mu_star_conf }) => {
                let all =
                    [("mu", mu), ("mu_star", mu_star), ("sigma", sigma), ("mu_star_conf", mu_star_conf)];
                all.into_iter().for_each(|(name, values)| add(name, values));
            }
            Effects::Sobol(SobolIndices { s1, s1_conf, st, st_conf, s2, s2_conf }) => {
                let all = [("S1", s1), ("S1_conf", s1_conf), ("ST", st), ("ST_conf", st_conf)];
                let pairs =
                    [("S2", s2), ("S2_conf", s2_conf)].into_iter().filter(|(_, pairs)| !pairs.is_empty());
                all.into_iter().chain(pairs).for_each(|(name, values)| add(name, values));
            }
        }
    }
    let effects = effects.into_iter().map(|(name, rows)| Ok((name, PyArray2::from_vec2(py, &rows)?)));
    let effects = effects.collect::<PyResult<Vec<_>>>()?.into_py_dict(py)?;
    let n_values = found.outputs.len();
    let padded =
        |values: &Vec<f64>| if values.is_empty() { vec![f64::NAN; n_values] } else { values.clone() };
    let values: Vec<Vec<f64>> = found.values.iter().map(padded).collect();
    let reasons = found.outputs.iter().map(|output| output.reason.clone().unwrap_or_default());
    Ok(dict!(py;
        found => level, seed, n_evaluations, n_failed, n_missing;
        "method": found.method.name(),
        "names": found.parameters.clone(),
        "outputs": found.outputs.iter().map(|output| output.name.clone()).collect::<Vec<_>>(),
        "n_used": found.outputs.iter().map(|output| output.n_used).collect::<Vec<_>>(),
        "reasons": reasons.collect::<Vec<_>>(),
        "failures": found.failures.iter().map(|(reason, count)| (reason, count)).into_py_dict(py)?,
        "effects": effects,
        "x": PyArray2::from_vec2(py, &found.points)?,
        "values": PyArray2::from_vec2(py, &values)?,
        "text": found.to_text(|name| calibration::visible_line(name).into_owned()),
    ))
}
