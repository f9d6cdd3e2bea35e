//! A fit in a file: the result, the problem with its recordings, and the description of the model.
//!
//! A zip archive: `fit.json` for people and programs, `arrays/*.npy` with the series of numbers that it
//! refers to, and `modelDescription.xml`, by which the fit can be shown where the model is not at hand.

use super::document::{Document, from_npy, to_npy};
use super::files::{check_belongs, write};
use super::lengths::check_lengths;
use crate::cost::calibration::Calibration;
use crate::error::CalibrationError;
use crate::fit::stage::Fit;
use crate::problem::definition::{ModelFile, Problem};
use fmi::{FmiError, Fmu, OpenOptions};
use serde_json::Value as Json;
use std::io::{Cursor, Read, Seek, Write};
use std::path::Path;
use zip::write::{SimpleFileOptions, ZipWriter};
use zip::{CompressionMethod, ZipArchive};

/// Format name in the file.
const FORMAT: &str = "fmufit fit";

/// The format that this version reads and writes. It changes with everything that a file holds.
const FORMAT_VERSION: u64 = 2;

const TEXT: &str = "fit.json";
const DESCRIPTION: &str = "modelDescription.xml";

/// Largest ratio of the content of a file to its size, where it is more than [`LEAST_BYTES`]; content that
/// compresses better is stored as it is.
const MOST_COMPRESSED: u64 = 8;

/// So many bytes may every file hold.
const LEAST_BYTES: u64 = 8 << 20;

/// So many values may the text of every file have, of a larger file one for so many bytes.
const LEAST_VALUES: u64 = 1 << 18;
const BYTES_PER_VALUE: u64 = 4;

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
        let document = document(self, calibration.problem(), calibration.fmu().options())
            .map_err(|e| CalibrationError::Setup(format!("the fit cannot be stored: {e}")))?;
        let description = calibration.fmu().description_file()?;
        let failed =
            |e: zip::result::ZipError| CalibrationError::Setup(format!("the fit cannot be packed: {e}"));
        pack(&document, &description).map_err(failed)
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
        let (document, description) = unpack(bytes).map_err(bad)?;
        let read = || -> Result<Self, String> {
            let saved = Self {
                fit: document.get("fit")?,
                problem: document.get("problem")?,
                written_by: document.get("written_by")?,
                open_options: document.get("open_options")?,
                description,
            };
            saved.check()?;
            let again = document_of(&saved)?;
            if let Some(place) = difference(&again, &document) {
                return Err(format!("what stands at {place} is not what this version reads there"));
            }
            Ok(saved)
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
        calibration.set_solver(self.fit.solver.clone())?;
        Ok(calibration)
    }
}

fn document_of(saved: &SavedFit) -> Result<Document, String> {
    let mut document = document(&saved.fit, &saved.problem, &saved.open_options)?;
    document.insert("written_by", &saved.written_by)?;
    Ok(document)
}

fn document(fit: &Fit, problem: &Problem, open_options: &OpenOptions) -> Result<Document, String> {
    let mut document = Document::default();
    document.insert("format", &FORMAT)?;
    document.insert("format_version", &FORMAT_VERSION)?;
    document.insert("written_by", &env!("CARGO_PKG_VERSION"))?;
    document.insert("fit", fit)?;
    document.insert("problem", problem)?;
    document.insert("open_options", open_options)?;
    Ok(document)
}

fn pack(document: &Document, description: &[u8]) -> Result<Vec<u8>, zip::result::ZipError> {
    let text = serde_json::to_vec_pretty(&document.text).map_err(std::io::Error::from)?;
    let mut files = vec![(TEXT, text), (DESCRIPTION, description.to_vec())];
    files.extend(document.arrays.iter().map(|(name, numbers)| (name.as_str(), to_npy(numbers))));
    let packed = zipped(&files, CompressionMethod::Deflated)?;
    let (total, length) = (files.iter().map(|(_, bytes)| bytes.len() as u64).sum(), packed.len() as u64);
    match check_size(total, length).and_then(|()| check_text(&files[0].1, length)) {
        Ok(()) => Ok(packed),
        Err(_) => zipped(&files, CompressionMethod::Stored),
    }
}

fn zipped(files: &[(&str, Vec<u8>)], method: CompressionMethod) -> Result<Vec<u8>, zip::result::ZipError> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        // Without a time: the same fit gives the same bytes.
        let options = SimpleFileOptions::default()
            .compression_method(method)
            .last_modified_time(zip::DateTime::default())
            .large_file(bytes.len() as u64 >= u64::from(u32::MAX))
            .unix_permissions(0o644);
        archive.start_file(*name, options)?;
        archive.write_all(bytes)?;
    }
    Ok(archive.finish()?.into_inner())
}

/// The document and the description of the model.
fn unpack(bytes: &[u8]) -> Result<(Document, Vec<u8>), String> {
    let mut archive = match ZipArchive::new(Cursor::new(bytes)) {
        Ok(archive) => archive,
        Err(_) if bytes.starts_with(b"PK\x03\x04") => return Err("the file is cut off or damaged".to_owned()),
        Err(_) => return Err("this is no saved fit".to_owned()),
    };
    let names: Vec<String> = archive.file_names().filter_map(|name| Some(name.ok()?.into_owned())).collect();
    if !names.iter().any(|name| name == TEXT) {
        return Err(format!("this is no saved fit: it holds no {TEXT}"));
    }
    let (mut total, file) = (0u64, bytes.len() as u64);
    for k in 0..archive.len() {
        let entry = archive.by_index_raw(k).map_err(|e| format!("the file is damaged: {e}"))?;
        total = total.saturating_add(entry.size());
    }
    check_size(total, file)?;
    let text = entry(&mut archive, TEXT)?;
    check_text(&text, file)?;
    let text = serde_json::from_slice(&text).map_err(|e| format!("{TEXT} is damaged: {e}"))?;
    let Json::Object(text) = text else {
        return Err(format!("this is no saved fit: {TEXT} is something else"));
    };
    let mut document = Document { text, ..Document::default() };
    check_format(&document)?;
    document.check_references()?;
    for name in names.iter().filter(|name| name.starts_with("arrays/")) {
        let numbers = from_npy(&entry(&mut archive, name)?).map_err(|e| format!("{name} is damaged: {e}"))?;
        document.arrays.insert(name.clone(), numbers);
    }
    let description = entry(&mut archive, DESCRIPTION)?;
    Ok((document, description))
}

/// Refuses other kinds of files, and other formats than this version knows.
fn check_format(document: &Document) -> Result<(), String> {
    if document.text.get("format").and_then(Json::as_str) != Some(FORMAT) {
        return Err(format!("this is no saved fit: {TEXT} is something else"));
    }
    match document.text.get("format_version").and_then(Json::as_u64) {
        Some(FORMAT_VERSION) => Ok(()),
        found => {
            let found =
                found.map_or_else(|| "an unknown format".to_owned(), |version| format!("format {version}"));
            let by = document.text.get("written_by").and_then(Json::as_str).unwrap_or("?");
            let own = env!("CARGO_PKG_VERSION");
            Err(format!(
                "it was written by version {by} in {found}; this is version {own}, which reads format {FORMAT_VERSION}: use \
                 version {by}, or make the fit again"
            ))
        }
    }
}

/// Refuses a file that holds more than its size allows: it would take many times its size in memory.
fn check_size(total: u64, file: u64) -> Result<(), String> {
    let most = LEAST_BYTES.max(file.saturating_mul(MOST_COMPRESSED));
    match total > most {
        true => Err(format!(
            "it is said to hold {total} bytes, more than the {most} that a file of {file} bytes may"
        )),
        false => Ok(()),
    }
}

/// The same for the number of values in its text.
fn check_text(text: &[u8], file: u64) -> Result<(), String> {
    let most = LEAST_VALUES.max(file / BYTES_PER_VALUE);
    let found = text.iter().filter(|byte| matches!(byte, b',' | b'[' | b'{')).count() as u64;
    match found > most {
        true => Err(format!(
            "{TEXT} has some {found} values, more than the {most} that a file of {file} bytes may"
        )),
        false => Ok(()),
    }
}

fn entry(archive: &mut ZipArchive<impl Read + Seek>, name: &str) -> Result<Vec<u8>, String> {
    let damaged = |e: &dyn std::fmt::Display| format!("{name} is cut off or damaged: {e}");
    let file = archive.by_name(name).map_err(|e| damaged(&e))?;
    let size = file.size();
    let mut bytes = Vec::new();
    file.take(size.saturating_add(1)).read_to_end(&mut bytes).map_err(|e| damaged(&e))?;
    if bytes.len() as u64 == size { Ok(bytes) } else { Err(damaged(&"it has another length than it says")) }
}

/// The first place where two documents differ.
fn difference(one: &Document, two: &Document) -> Option<String> {
    let [a, b] = [one, two].map(|document| Json::Object(document.text.clone()));
    let bits = |numbers: &[f64]| numbers.iter().map(|n| n.to_bits()).collect::<Vec<_>>();
    let differs = |name: &String| match (one.arrays.get(name), two.arrays.get(name)) {
        (Some(a), Some(b)) => bits(a) != bits(b),
        _ => true,
    };
    let names = || one.arrays.keys().chain(two.arrays.keys());
    place_of_difference(&a, &b, String::new()).or_else(|| names().find(|name| differs(name)).cloned())
}

fn place_of_difference(one: &Json, two: &Json, place: String) -> Option<String> {
    match (one, two) {
        (Json::Object(a), Json::Object(b)) => {
            let keys = a.keys().chain(b.keys());
            keys.into_iter().find_map(|key| {
                let place = if place.is_empty() { key.clone() } else { format!("{place}.{key}") };
                match (a.get(key), b.get(key)) {
                    (Some(a), Some(b)) => place_of_difference(a, b, place),
                    _ => Some(place),
                }
            })
        }
        (Json::Array(a), Json::Array(b)) if a.len() == b.len() => a
            .iter()
            .zip(b)
            .enumerate()
            .find_map(|(k, (a, b))| place_of_difference(a, b, format!("{place}[{k}]"))),
        _ => (one != two).then_some(place),
    }
}
