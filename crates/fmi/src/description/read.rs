//! Reading of model descriptions from an archive or from bytes, their checks and their sizes.

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
    /// Parses the bytes of a `modelDescription.xml` of any FMI version.
    ///
    /// The parser is lenient: it ignores unknown content. Tolerable deviations from the standard are listed
    /// in [`quirks`](Self::quirks).
    ///
    /// # Errors
    /// - [`FmiError::Description`](crate::FmiError::Description), with a line number, if the bytes are not a
    ///   model description or cannot be used. Dangerous content also causes this error: document type
    ///   definitions, excessive nesting, and model identifiers with path separators.
    /// - [`FmiError::UnknownVersion`](crate::FmiError::UnknownVersion) for versions other than 1, 2 and 3.
    pub fn parse(bytes: &[u8]) -> Result<ModelDescription> {
        parse(bytes.into(), &DescriptionLimits::default(), &CancelRequest::default()).and_then(checks::finish)
    }

    /// Reads and parses `modelDescription.xml` from an archive. Reads no other file of the archive.
    ///
    /// # Errors
    /// Returns the errors of [`parse`](Self::parse), and read errors.
    pub fn read(archive: &Archive) -> Result<ModelDescription> {
        Self::read_with(archive, &DescriptionLimits::default(), &CancelRequest::default())
    }

    /// Reads a description as [`read`](Self::read) does, with other limits. Ends early if `cancel` requests
    /// it.
    ///
    /// # Errors
    /// Returns the errors of [`read`](Self::read), and [`FmiError::Cancelled`](crate::FmiError::Cancelled).
    pub fn read_with(
        archive: &Archive,
        limits: &DescriptionLimits,
        cancel: &CancelRequest,
    ) -> Result<ModelDescription> {
        let bytes = archive.description(limits.bytes, cancel).map_err(name_limit)?;
        parse(bytes.into(), limits, cancel).and_then(checks::finish)
    }

    /// Returns an error ([`FmiError::NotConforming`](crate::FmiError::NotConforming)) if the description
    /// deviates from the standard in any way.
    pub fn require_conforming(&self) -> Result<()> {
        checks::require_conforming(&self.quirks)
    }

    /// Returns the number of continuous states, with structural parameters at their start values. If the
    /// model structure contains derivatives, this is the number of their elements.
    pub fn n_states(&self) -> usize {
        Structure::default().states(self)
    }

    /// Returns the names of the continuous state variables, in the order of the state vector. A name is
    /// `None` if the file does not specify it. The list is empty for FMI 1.0, because the FMU reports its
    /// states only at run time ([`Instance::state_names`](crate::Instance::state_names)).
    pub fn state_names(&self) -> Vec<Option<&str>> {
        let derivatives = self.structure.derivatives.iter().map(|unknown| &self.variables[unknown.index]);
        derivatives.map(|v| v.derivative.map(|state| self.variables[state].name.as_str())).collect()
    }

    /// Returns the extents of an array, with structural parameters at their start values; empty for a scalar.
    pub fn extents(&self, variable: &Variable) -> Vec<usize> {
        Structure::default().extents(self, variable)
    }
}
