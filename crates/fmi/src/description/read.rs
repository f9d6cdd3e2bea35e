//! From an archive or from bytes to a description that was checked; its sizes.

use super::checks;
use super::limits::{DescriptionLimits, name_limit};
use super::model::ModelDescription;
use super::parse::parse;
use super::structure::Structure;
use super::variable::Variable;
use crate::archive::Archive;
use crate::cancel_request::CancelRequest;
use crate::error::Result;

impl ModelDescription {
    /// Parses the bytes of a `modelDescription.xml` of any version.
    ///
    /// Lenient: what the standard does not know is ignored, and where a file departs from it in a way that
    /// can be worked with, the departure is listed in [`quirks`](Self::quirks).
    ///
    /// Errors: [`FmiError::Description`](crate::FmiError::Description) with a line for what is no model
    /// description, is dangerous (document type definitions, bottomless nesting, model identifiers with path
    /// separators) or cannot be worked with; [`FmiError::UnknownVersion`](crate::FmiError::UnknownVersion)
    /// for versions other than 1, 2 and 3.
    pub fn parse(bytes: &[u8]) -> Result<ModelDescription> {
        parse(bytes.into(), &DescriptionLimits::default(), &CancelRequest::default()).and_then(checks::finish)
    }

    /// Reads and parses `modelDescription.xml` of an archive; nothing else of it is read.
    ///
    /// # Errors
    /// As [`parse`](Self::parse), and those of reading.
    pub fn read(archive: &Archive) -> Result<ModelDescription> {
        Self::read_with(archive, &DescriptionLimits::default(), &CancelRequest::default())
    }

    /// The same with other limits; ends early when `cancel` asks for it.
    ///
    /// # Errors
    /// As [`read`](Self::read), and [`FmiError::Cancelled`](crate::FmiError::Cancelled).
    pub fn read_with(
        archive: &Archive,
        limits: &DescriptionLimits,
        cancel: &CancelRequest,
    ) -> Result<ModelDescription> {
        let bytes = archive.description(limits.bytes, cancel).map_err(name_limit)?;
        parse(bytes.into(), limits, cancel).and_then(checks::finish)
    }

    /// Refuses a description that departs from the standard anywhere
    /// ([`FmiError::NotConforming`](crate::FmiError::NotConforming)).
    pub fn require_conforming(&self) -> Result<()> {
        checks::require_conforming(&self.quirks)
    }

    /// Number of continuous states: the elements of the derivatives in the model structure, where there is
    /// one; with structural parameters at their start values.
    pub fn n_states(&self) -> usize {
        Structure::default().states(self)
    }

    /// Names of the variables that are continuous states, in the order of the state vector; `None` where the
    /// file does not tell. Empty for FMI 1.0, where the FMU tells them when it runs
    /// ([`Instance::state_names`](crate::Instance::state_names)).
    pub fn state_names(&self) -> Vec<Option<&str>> {
        let derivatives = self.structure.derivatives.iter().map(|unknown| &self.variables[unknown.index]);
        derivatives.map(|v| v.derivative.map(|state| self.variables[state].name.as_str())).collect()
    }

    /// Extents of an array, with structural parameters at their start values; empty for a single value.
    pub fn extents(&self, variable: &Variable) -> Vec<usize> {
        Structure::default().extents(self, variable)
    }
}
