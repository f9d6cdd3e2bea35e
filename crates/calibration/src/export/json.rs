//! The numbers of a fit as JSON for other programs: valid JSON, in which null stands for what is no finite
//! number.

use super::files::check_belongs;
use super::tables::unit_of;
use crate::cost::calibration::Calibration;
use crate::error::CalibrationError;
use crate::fit::stage::Fit;
use crate::uncertainty::estimate::Uncertainty;
use serde_json::{Value as Json, json};
use std::collections::BTreeMap;

impl Fit {
    /// Results of the fit as JSON: parameters with errors, start, bounds and units, those that are tied last;
    /// cost and RMS; quality of fit of each output; uncertainty of the fit; its method and settings. Neither
    /// the trace nor the recordings: [`Fit::save`] keeps all. Numbers that are not finite are null.
    ///
    /// # Errors
    /// [`CalibrationError::Setup`] if it is no fit of this calibration.
    pub fn to_json(&self, calibration: &Calibration) -> Result<String, CalibrationError> {
        check_belongs(self, calibration)?;
        let failed = |e: serde_json::Error| CalibrationError::Setup(format!("no JSON can be made: {e}"));
        serde_json::to_string_pretty(&self.json(calibration).map_err(failed)?).map_err(failed)
    }

    fn json(&self, calibration: &Calibration) -> Result<Json, serde_json::Error> {
        let mut uncertainty = serde_json::to_value(&self.uncertainty)?;
        if let Some(fields) = uncertainty.as_object_mut() {
            // As long as the recordings.
            fields.remove("jacobian");
            fields.remove("residuals");
            // Those of the fit have them.
            fields.remove("findings");
            fields.insert("verdict".to_owned(), self.uncertainty.as_ref().map(Uncertainty::verdict).into());
        }
        let parameters = calibration.parameters().iter().enumerate().map(|(k, p)| {
            let side = self.at_bound.iter().find(|(index, _)| *index == k).map(|(_, side)| side.name());
            json!({
                "name": p.name(),
                "value": self.x[k],
                "standard_error": self.uncertainty.as_ref().map(|uncertainty| uncertainty.standard_errors[k]),
                "start": self.start[k],
                "lower": p.lower(),
                "upper": p.upper(),
                "unit": unit_of(p, calibration),
                "fixed": p.is_fixed(),
                "at_bound": side,
                "without_effect": self.without_effect.contains(&k),
            })
        });
        let tied = self.tied_parameters(calibration).into_iter().map(|tied| {
            json!({
                "name": tied.name,
                "value": tied.value,
                "standard_error": tied.standard_error,
                "start": tied.start,
                "unit": tied.unit,
                "tied_to": tied.to,
            })
        });
        let report = &self.report;
        let model = &calibration.problem().model;
        Ok(json!({
            "written_by": format!("fmufit {}", env!("CARGO_PKG_VERSION")),
            "model": {
                "name": calibration.fmu().description().model_name,
                "path": model.path.display().to_string(),
                "sha256": model.content_hash,
            },
            "parameters": parameters.chain(tied).collect::<Vec<_>>(),
            "cost": self.cost,
            "rms": self.rms,
            "start_cost": self.start_cost,
            "start_rms": self.start_rms,
            "outputs": serde_json::to_value(&self.outputs)?,
            "noise": serde_json::to_value(&self.noise)?,
            "tolerance": serde_json::to_value(self.tolerance)?,
            "uncertainty": uncertainty,
            "success": self.is_success(),
            "termination": report.termination.name(),
            "message": report.message,
            "findings": serde_json::to_value(self.findings())?,
            "method": report.method,
            "options": report.options.iter().cloned().collect::<BTreeMap<_, _>>(),
            "solver": self.solver.method.name(),
            "n_evaluations": report.n_evaluations,
            "n_iterations": report.n_iterations,
            "n_failed": report.n_failed,
            "seconds": report.seconds,
            "seed": report.seed,
            "stats": serde_json::to_value(self.stats)?,
        }))
    }
}
