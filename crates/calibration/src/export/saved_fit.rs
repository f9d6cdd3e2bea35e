//! A fit in a file: the result, the problem with its recordings, and the description of the model.
//!
//! A sequence of CBOR items (RFC 8949, RFC 8742): a header with the hash of what follows; the fit, its
//! problem and the options of the model; `modelDescription.xml`, by which the fit can be shown where the
//! model is not at hand.

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

/// The format that this version reads and writes. It changes with everything that a file holds.
const FORMAT_VERSION: u64 = 5;

/// First item of a file.
#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    format_version: u64,
    written_by: String,
    /// SHA-256 of the items that follow.
    hash: String,
}

/// A fit that was read from a file, and what it is a fit of.
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
    /// The result.
    pub fit: Fit,
    /// Problem that was fitted: model, recordings and parameters.
    pub problem: Problem,
    /// The version of the code that wrote the file.
    pub written_by: String,
    /// Options that the model was opened with.
    pub open_options: OpenOptions,
    description: Vec<u8>,
}

impl Fit {
    /// Writes the fit and what it is a fit of to a file, in one step: with the recordings by value and the
    /// model by its place, the hash of its content and its description. All numbers keep their bits. See
    /// [`SavedFit`].
    ///
    /// # Errors
    /// [`CalibrationError::Setup`] if it is no fit of this calibration; [`FmiError::Io`] for what the system
    /// refuses.
    pub fn save(&self, calibration: &Calibration, path: impl AsRef<Path>) -> Result<(), CalibrationError> {
        write(path.as_ref(), calibration, &self.to_bytes(calibration)?)
    }

    /// The bytes of the file that [`save`](Self::save) writes. The same fit gives the same bytes.
    ///
    /// # Errors
    /// As [`save`](Self::save).
    pub fn to_bytes(&self, calibration: &Calibration) -> Result<Vec<u8>, CalibrationError> {
        check_belongs(self, calibration)?;
        let fmu = calibration.fmu();
        let description = fmu.description_file()?;
        to_bytes(env!("CARGO_PKG_VERSION"), &(self, calibration.problem(), fmu.options()), description)
            .map_err(|e| CalibrationError::Setup(format!("the fit cannot be stored: {e}")))
    }
}

impl SavedFit {
    /// Reads a file that [`Fit::save`] has written. The model is not opened.
    ///
    /// # Errors
    /// [`FmiError::Io`]; [`CalibrationError::SavedFit`] for a file that is cut, damaged, of another kind or
    /// of another format.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, CalibrationError> {
        let path = path.as_ref();
        let bytes = base::files::read_regular(path).map_err(FmiError::io("read", path))?;
        Self::from_bytes(&bytes, &path.display().to_string())
    }

    /// The same from the bytes of a file; `name` stands in errors.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn from_bytes(bytes: &[u8], name: &str) -> Result<Self, CalibrationError> {
        let bad = |message: String| CalibrationError::SavedFit { name: name.to_owned(), message };
        let read = || -> Result<Self, String> {
            let (Header { written_by, .. }, mut rest) = header(bytes)?;
            let (fit, problem, open_options) = item(&mut rest)?;
            let description = item::<Value>(&mut rest)?.into_bytes();
            let description =
                description.map_err(|_| "its model description is something else".to_owned())?;
            let saved = Self { fit, problem, written_by, open_options, description };
            saved.check()?;
            let parts = (&saved.fit, &saved.problem, &saved.open_options);
            match to_bytes(&saved.written_by, &parts, saved.description.clone())? == bytes {
                true => Ok(saved),
                false => Err("it holds something that this version does not read".to_owned()),
            }
        };
        read().map_err(bad)
    }

    /// Refuses parts that do not fit together.
    fn check(&self) -> Result<(), String> {
        check_lengths(&self.fit)?;
        self.problem.experiments.iter().try_for_each(|e| e.data().check()).map_err(|e| e.to_string())
    }

    /// The calibration with its model, where that is at its place with the content it had. Else one without:
    /// it shows all that it is made of, and what simulates fails with [`FmiError::Absent`], which names the
    /// file and the hash of its content.
    ///
    /// # Errors
    /// As [`Calibration::from_problem`].
    pub fn calibration(&self) -> Result<Calibration, CalibrationError> {
        self.calibration_from(Fmu::open_with(&self.problem.model.path, &self.open_options))
    }

    /// As [`calibration`](Self::calibration), with the outcome of opening the model's file.
    ///
    /// # Errors
    /// As [`calibration`](Self::calibration).
    pub fn calibration_from(&self, opened: Result<Fmu, FmiError>) -> Result<Calibration, CalibrationError> {
        let ModelFile { path, content_hash } = &self.problem.model;
        let present = opened.and_then(|fmu| fmu.content_hash().map(str::to_owned).map(|hash| (fmu, hash)));
        let why_not = match present {
            Ok((fmu, hash)) if hash == *content_hash => return self.calibration_with(fmu),
            Ok((_, hash)) => format!("what is there now has the content {hash}"),
            Err(FmiError::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                "it is not there any more".to_owned()
            }
            Err(FmiError::Cancelled) => return Err(CalibrationError::Cancelled),
            Err(error) => error.to_string(),
        };
        let reason = format!("{why_not}; load the fit with the place of a file that has it");
        let (description, hash) = (self.description.clone(), content_hash.clone());
        self.calibration_with(Fmu::absent(path, description, hash, reason, &self.open_options)?)
    }

    /// The calibration with a model of the same content at another place.
    ///
    /// # Errors
    /// [`CalibrationError::OtherModel`]: the model has another content. As [`Calibration::from_problem`].
    pub fn calibration_with(&self, fmu: Fmu) -> Result<Calibration, CalibrationError> {
        self.problem.model.check(&fmu)?;
        let problem = Problem { model: ModelFile::of(&fmu)?, ..self.problem.clone() };
        let calibration = Calibration::from_problem(fmu, problem)?;
        check_belongs(&self.fit, &calibration)?;
        Ok(calibration)
    }
}

/// The bytes of a file.
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

/// The header of a file, and what follows; refuses other kinds of files, other formats than this version
/// knows, and what is damaged.
fn header(mut bytes: &[u8]) -> Result<(Header, &[u8]), String> {
    let found = item::<Header>(&mut bytes).ok().filter(|header| header.format == FORMAT);
    let header = found.ok_or("this is no saved fit")?;
    if header.format_version != FORMAT_VERSION {
        let (by, own) = (&header.written_by, env!("CARGO_PKG_VERSION"));
        return Err(format!(
            "it was written by version {by} in format {}; this is version {own}, which reads format {FORMAT_VERSION}: use \
             version {by}, or make the fit again",
            header.format_version
        ));
    }
    match header.hash == hash_of_bytes(bytes) {
        true => Ok((header, bytes)),
        false => Err("the file is cut off or damaged".to_owned()),
    }
}

/// The next item.
fn item<T: DeserializeOwned>(bytes: &mut &[u8]) -> Result<T, String> {
    ciborium::from_reader(bytes).map_err(|error| match error {
        ciborium::de::Error::Semantic(_, what) => what,
        error => error.to_string(),
    })
}
