//! File of a fit: the result, the problem with its recordings, and the description of the model.
//!
//! The file is a sequence of CBOR items (RFC 8949, RFC 8742). The first is a header with the hash of the
//! other items. Then follow the fit, its problem and the options of the model. The last is
//! `modelDescription.xml`, which allows the fit to be displayed without the model.

use super::files::{check_belongs, write};
use super::lengths::check_lengths;
use crate::error::CalibrationError;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use crate::problem::definition::{ModelFile, Problem};
use crate::problem::fingerprint::hash_of_bytes;
use ciborium::Value;
use fmi::{FmiError, Fmu, OpenOptions};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Format name in the file.
const FORMAT: &str = "fmufit fit";

/// Format version that this version of the code reads and writes. It changes with any change of the contents.
const FORMAT_VERSION: u64 = 8;

/// First item of a file.
#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    format_version: u64,
    written_by: String,
    /// SHA-256 of the items after the header.
    hash: String,
}

/// Fit read from a file, with its problem.
///
/// ```
/// # use calibration::{Calibration, Data, Experiment, FitOptions, Parameter, SavedFit};
/// # let t = vec![0.0, 0.5, 1.0, 1.5];
/// # let x = t.iter().map(|t: &f64| (-2.0 * t).exp()).collect();
/// # let fmu = fmi::Fmu::open(example_models::example_fmu("dahlquist")?)?;
/// # let calibration = Calibration::builder(fmu)
/// #     .experiment(Experiment::new(Data::from_columns(t, [("x".to_owned(), x)])?).output("x", "x"))
/// #     .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
/// #     .build()?;
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("decay.fit");
/// let fit = calibration.fit(FitOptions::default())?;
/// fit.save(&calibration, &path)?;
/// let saved = SavedFit::load(&path)?;
/// assert_eq!(saved.fit, fit);
/// assert_eq!(saved.calibration()?.cost(&saved.fit.x, &calibration::RunContext::new())?, fit.cost);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct SavedFit {
    /// Result of the fit.
    pub fit: Fit,
    /// Fitted problem: model, recordings and parameters.
    pub problem: Problem,
    /// Version of the code that wrote the file.
    pub written_by: String,
    /// Options used to open the model.
    pub open_options: OpenOptions,
    description: Vec<u8>,
}

impl Fit {
    /// Writes the fit and its problem to a file atomically. The file contains the recordings by value, and
    /// the path, content hash and description of the model. All numbers are stored bit for bit. See
    /// [`SavedFit`].
    ///
    /// # Errors
    /// Returns [`CalibrationError::Setup`] if the fit does not belong to this calibration, or
    /// [`FmiError::Io`] if the file cannot be written.
    pub fn save(&self, calibration: &Calibration, path: impl AsRef<Path>) -> Result<(), CalibrationError> {
        write(path.as_ref(), calibration, &self.to_bytes(calibration)?)
    }

    /// Returns the bytes of the file that [`save`](Self::save) writes. Equal fits give equal bytes.
    ///
    /// # Errors
    /// Returns the errors of [`save`](Self::save).
    pub fn to_bytes(&self, calibration: &Calibration) -> Result<Vec<u8>, CalibrationError> {
        check_belongs(self, calibration)?;
        let fmu = calibration.fmu();
        let description = fmu.description_file()?;
        to_bytes(env!("CARGO_PKG_VERSION"), &(self, calibration.problem(), fmu.options()), description)
            .map_err(|e| CalibrationError::Setup(format!("the fit cannot be stored: {e}")))
    }
}

impl SavedFit {
    /// Reads a file written by [`Fit::save`]. The model is not opened.
    ///
    /// # Errors
    /// Returns [`FmiError::Io`] if the file cannot be read. Returns [`CalibrationError::SavedFit`] if it is
    /// truncated, damaged, of another kind or of another format.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, CalibrationError> {
        let path = path.as_ref();
        let bytes = base::files::read_regular(path).map_err(FmiError::io("read", path))?;
        Self::from_bytes(&bytes, &path.display().to_string())
    }

    /// Reads a fit from the bytes of a file. `name` is its name in errors.
    ///
    /// # Errors
    /// Returns the errors of [`load`](Self::load).
    pub fn from_bytes(bytes: &[u8], name: &str) -> Result<Self, CalibrationError> {
        let bad = |message: String| CalibrationError::SavedFit { name: name.to_owned(), message };
        let read = || -> Result<Self, String> {
            let (Header { written_by, .. }, mut rest) = header(bytes)?;
            let (fit, problem, open_options) = item(&mut rest)?;
            let description = item::<Value>(&mut rest)?.into_bytes();
            let description = description.map_err(|_| "its model description is invalid".to_owned())?;
            let saved = Self { fit, problem, written_by, open_options, description };
            saved.check()?;
            let parts = (&saved.fit, &saved.problem, &saved.open_options);
            match to_bytes(&saved.written_by, &parts, saved.description.clone())? == bytes {
                true => Ok(saved),
                false => Err("it contains data that this version does not support".to_owned()),
            }
        };
        read().map_err(bad)
    }

    /// Returns an error if the parts are inconsistent.
    fn check(&self) -> Result<(), String> {
        check_lengths(&self.fit)?;
        self.problem.experiments.iter().try_for_each(|e| e.data().check()).map_err(|e| e.to_string())
    }

    /// Returns the calibration with its model if the file still exists with the original content. Otherwise
    /// returns a calibration without a model. It shows all settings and data, but simulations fail with
    /// [`FmiError::Absent`], which contains the path and the content hash of the file.
    ///
    /// # Errors
    /// Returns the errors of [`Calibration::from_problem`].
    pub fn calibration(&self) -> Result<Calibration, CalibrationError> {
        self.calibration_from(Fmu::open_with(&self.problem.model.path, &self.open_options))
    }

    /// Returns the calibration as [`calibration`](Self::calibration) does, given the outcome of opening the
    /// model.
    ///
    /// # Errors
    /// Returns the errors of [`calibration`](Self::calibration).
    pub fn calibration_from(&self, opened: Result<Fmu, FmiError>) -> Result<Calibration, CalibrationError> {
        let ModelFile { path, content_hash } = &self.problem.model;
        let present = opened.and_then(|fmu| fmu.content_hash().map(str::to_owned).map(|hash| (fmu, hash)));
        let why_not = match present {
            Ok((fmu, hash)) if hash == *content_hash => return self.calibration_with(fmu),
            Ok((_, hash)) => format!("the file has changed and now has the content {hash}"),
            Err(FmiError::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                "the file no longer exists".to_owned()
            }
            Err(FmiError::Cancelled) => return Err(CalibrationError::Cancelled),
            Err(error) => error.to_string(),
        };
        let reason = format!("{why_not}. Load the fit with the path of the original file");
        let (description, hash) = (self.description.clone(), content_hash.clone());
        self.calibration_with(Fmu::absent(path, description, hash, reason, &self.open_options)?)
    }

    /// Returns the calibration with a model of equal content at another path.
    ///
    /// # Errors
    /// Returns [`CalibrationError::OtherModel`] if the content of the model differs. Also returns the errors
    /// of [`Calibration::from_problem`].
    pub fn calibration_with(&self, fmu: Fmu) -> Result<Calibration, CalibrationError> {
        self.problem.model.check(&fmu)?;
        let problem = Problem { model: ModelFile::of(&fmu)?, ..self.problem.clone() };
        let calibration = Calibration::from_problem(fmu, problem)?;
        check_belongs(&self.fit, &calibration)?;
        Ok(calibration)
    }
}

/// Returns the bytes of a file.
fn to_bytes<T: Serialize>(written_by: &str, parts: &T, description: Vec<u8>) -> Result<Vec<u8>, String> {
    let failed = |e: ciborium::ser::Error<std::io::Error>| e.to_string();
    let mut rest = Vec::new();
    ciborium::into_writer(parts, &mut rest).map_err(failed)?;
    ciborium::into_writer(&Value::Bytes(description), &mut rest).map_err(failed)?;
    let (format, written_by) = (FORMAT.to_owned(), written_by.to_owned());
    let header = Header { format, format_version: FORMAT_VERSION, written_by, hash: hash_of_bytes(&rest) };
    let mut bytes = Vec::new();
    ciborium::into_writer(&header, &mut bytes).map_err(failed)?;
    bytes.append(&mut rest);
    Ok(bytes)
}

/// Returns the header of a file and the remaining bytes. Returns an error if the file is of a different
/// kind or format, or is damaged.
fn header(mut bytes: &[u8]) -> Result<(Header, &[u8]), String> {
    let found = item::<Header>(&mut bytes).ok().filter(|header| header.format == FORMAT);
    let header = found.ok_or("the file is not a saved fit")?;
    if header.format_version != FORMAT_VERSION {
        let (by, program_version) = (&header.written_by, env!("CARGO_PKG_VERSION"));
        return Err(format!(
            "the file was written by version {by} in format {}, but version {program_version} reads format {FORMAT_VERSION}. Use version {by}, \
             or fit again",
            header.format_version
        ));
    }
    match header.hash == hash_of_bytes(bytes) {
        true => Ok((header, bytes)),
        false => Err("the file is truncated or damaged".to_owned()),
    }
}

/// Reads the next item.
fn item<T: DeserializeOwned>(bytes: &mut &[u8]) -> Result<T, String> {
    ciborium::from_reader(bytes).map_err(|error| match error {
        ciborium::de::Error::Semantic(_, what) => what,
        error => error.to_string(),
    })
}
