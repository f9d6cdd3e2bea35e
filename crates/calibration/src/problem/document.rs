//! The problem of a fit as a document for other programs, without the numbers of its recordings.

use crate::data::Data;
use crate::problem::definition::Problem;
use crate::problem::experiment::Experiment;
use serde_json::{Error, Value as Json, json};

impl Problem {
    /// Returns the fields of the problem as JSON. Recordings are replaced by a summary, and row weights by
    /// their number. The time limit is in s.
    ///
    /// # Errors
    /// Returns an error if the problem cannot be serialised.
    pub(crate) fn document(&self) -> Result<Json, Error> {
        let without = |e: &Experiment| Experiment { data: Data::default(), ..e.clone() };
        let experiments = self.experiments.iter().map(without).collect();
        let mut document = serde_json::to_value(Self { experiments, ..self.clone() })?;
        for (k, (experiment, name)) in self.experiments.iter().zip(self.experiment_names()).enumerate() {
            let described = &mut document["experiments"][k];
            described["name"] = name.into();
            described["data"] = serde_json::to_value(experiment.data.summary())?;
            for output in described["outputs"].as_array_mut().into_iter().flatten() {
                if let Some(n) = output["weight"]["Rows"].as_array().map(Vec::len) {
                    output["weight"] = json!({ "Rows": n });
                }
            }
        }
        if let Some(timeout) = self.settings.run.timeout {
            document["settings"]["timeout"] = timeout.as_secs_f64().into();
        }
        Ok(document)
    }
}
