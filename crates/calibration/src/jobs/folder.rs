//! The folder that the processes of a fit share, and its files.
//!
//! | name | content |
//! |---|---|
//! | `fit` | identity of the fit, its options and the lease of claims |
//! | `problems/K` | problem number K of the fit, with its loss |
//! | `points/K-ID-KEY` | a point of problem K that waits for its evaluation |
//! | `claims/K-ID-KEY.S` | the same file while a process evaluates the point, with a lease of S seconds |
//! | `answers/K-KEY` | the answer at a point |
//! | `lost/K-KEY.N` | a claim that ended without an answer |
//! | `result.fit` | the saved fit |
//!
//! Every file is written atomically and has a checksum. Only renaming distributes points, so a point has at
//! most one claim. A point that two processes evaluate nevertheless has the same answer.

use crate::error::CalibrationError;
use crate::fit::one_stage::FitOptions;
use crate::fit::several_stages::Stage;
use crate::loaded::calibration::Calibration;
use crate::problem::fingerprint::hash_of_bytes;
use base::files::{Claim, read_regular, write_atomically};
use dfo::Record;
use fmi::FmiError;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// First line of every file.
const MARK: &str = "fmufit jobs 1\n";

/// Length of a hash in hexadecimal.
const HASH: usize = 64;

pub(super) const PROBLEMS: &str = "problems";
pub(super) const POINTS: &str = "points";
pub(super) const CLAIMS: &str = "claims";
pub(super) const ANSWERS: &str = "answers";
pub(super) const LOST: &str = "lost";

/// Folder that the processes of a fit share.
#[derive(Debug, Clone)]
pub struct JobFolder {
    path: PathBuf,
    header: Header,
}

/// Content of the file `fit`.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Header {
    identity: Vec<(String, String)>,
    options: Record,
    /// Seconds.
    lease: u64,
}

/// Progress of a fit in a folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct JobStatus {
    /// True if the fit has ended.
    pub is_done: bool,
    /// True if a process drives the fit at this moment.
    pub is_driven: bool,
    /// Number of answers.
    pub n_answers: usize,
    /// Number of points that wait for a process.
    pub n_waiting: usize,
    /// Number of points that processes evaluate.
    pub n_claimed: usize,
    /// Number of claims that ended without an answer.
    pub n_lost: usize,
}

impl JobFolder {
    /// Lease of a claim in seconds: twice the longest time for which NFS may show an old state of a file
    /// (`acregmax` and `acdirmax`, nfs(5)).
    pub const DEFAULT_LEASE: u64 = 120;

    /// Creates the folder of a fit. `identity` is the result of [`identity`](Self::identity). `options` are
    /// options of the fit that its processes need before they know their problem. `lease` is the time in
    /// seconds without a sign of life after which a process counts as lost.
    ///
    /// # Errors
    /// Returns an error if the folder exists or cannot be written.
    pub fn create(
        path: &Path,
        identity: Vec<(String, String)>,
        options: Record,
        lease: u64,
    ) -> Result<Self, CalibrationError> {
        let folder = Self { path: path.to_owned(), header: Header { identity, options, lease } };
        fs::create_dir(path).map_err(write_error(path))?;
        for name in [PROBLEMS, POINTS, CLAIMS, ANSWERS, LOST] {
            let path = path.join(name);
            fs::create_dir(&path).map_err(write_error(&path))?;
        }
        // Written last, so that a folder with this file is complete.
        write(&folder.header_path(), &folder.header)?;
        Ok(folder)
    }

    /// Opens the folder of a fit.
    ///
    /// # Errors
    /// Returns an error if the folder does not exist or is not the folder of a fit.
    pub fn open(path: &Path) -> Result<Self, CalibrationError> {
        let header = read(&path.join("fit"))?.ok_or_else(|| {
            let path = path.display();
            CalibrationError::Setup(format!("{path} is not the folder of a fit; create it with jobs init"))
        })?;
        Ok(Self { path: path.to_owned(), header })
    }

    /// Returns the identity of a fit: names and values of everything that its result depends on.
    ///
    /// # Errors
    /// Returns an error if the options cannot be serialised.
    pub fn identity(
        calibration: &Calibration,
        options: &FitOptions<'_>,
        stages: &[Stage],
    ) -> Result<Vec<(String, String)>, CalibrationError> {
        let mut all = vec![("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned())];
        all.extend(calibration.tags().map(|(name, value)| (name.to_owned(), value.to_owned())));
        for parameter in calibration.parameters() {
            let (name, lower, upper) = (parameter.name(), parameter.lower(), parameter.upper());
            all.push((format!("start value of parameter {name}"), format!("{:?}", parameter.start())));
            all.push((format!("bounds of parameter {name}"), format!("{lower:?} to {upper:?}")));
        }
        all.extend(options.record()?.into_iter().map(|(name, value)| (name, value.to_string())));
        all.extend(
            stages.iter().enumerate().map(|(k, stage)| (format!("stage {}", k + 1), format!("{stage:?}"))),
        );
        Ok(all)
    }

    /// Returns an error with the first difference if the folder belongs to another fit.
    ///
    /// # Errors
    /// Returns the difference.
    pub fn check(&self, identity: &[(String, String)]) -> Result<(), CalibrationError> {
        let find = |all: &[(String, String)], name: &str| {
            all.iter()
                .find(|(n, _)| n == name)
                .map_or_else(|| "nothing".to_owned(), |(_, value)| value.clone())
        };
        let stored_identity = &self.header.identity;
        let names = stored_identity.iter().chain(identity).map(|(name, _)| name);
        for name in names {
            let (stored, given) = (find(stored_identity, name), find(identity, name));
            if stored != given {
                return Err(CalibrationError::Setup(format!(
                    "{} belongs to another fit: {name} is {stored} there and {given} here. Use the same \
                     problem and version, or create another folder",
                    self.path.display()
                )));
            }
        }
        Ok(())
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the options passed to [`create`](Self::create).
    pub fn options(&self) -> &Record {
        &self.header.options
    }

    /// Returns the path of the saved fit, which exists after the end of the fit.
    pub fn result(&self) -> PathBuf {
        self.path.join("result.fit")
    }

    /// True if the fit has ended.
    pub fn is_done(&self) -> bool {
        self.result().exists()
    }

    /// Returns the time without a sign of life after which a process counts as lost.
    pub fn lease(&self) -> Duration {
        Duration::from_secs(self.header.lease)
    }

    /// Returns the progress of the fit.
    ///
    /// # Errors
    /// Returns an error if the folder cannot be read.
    pub fn status(&self) -> Result<JobStatus, CalibrationError> {
        Ok(JobStatus {
            is_done: self.is_done(),
            is_driven: self.claim_drive()?.is_none(),
            n_answers: self.names(ANSWERS)?.len(),
            n_waiting: self.names(POINTS)?.len(),
            n_claimed: self.names(CLAIMS)?.len(),
            n_lost: self.names(LOST)?.len(),
        })
    }

    /// Claims the right to drive the fit. Returns `None` if another process drives it. On a file system
    /// without locks, several processes may drive the fit. They then do the same work, and the result is the
    /// same.
    ///
    /// # Errors
    /// Returns an error if the lock cannot be written.
    pub fn claim_drive(&self) -> Result<Option<Claim>, CalibrationError> {
        let path = self.path.join("driver");
        match Claim::new(&path, false) {
            Ok(claim) => Ok(Some(claim)),
            Err(error) if error.kind() == ErrorKind::ResourceBusy => Ok(None),
            Err(error) => Err(write_error(&path)(error)),
        }
    }

    fn header_path(&self) -> PathBuf {
        self.path.join("fit")
    }

    /// Returns the path of a file.
    pub(super) fn file(&self, folder: &str, name: &str) -> PathBuf {
        self.path.join(folder).join(name)
    }

    /// Returns the names in a folder, sorted, without files that are being written.
    pub(super) fn names(&self, folder: &str) -> Result<Vec<String>, CalibrationError> {
        let path = self.path.join(folder);
        let mut names = Vec::new();
        for entry in fs::read_dir(&path).map_err(read_error(&path))? {
            let name = entry.map_err(read_error(&path))?.file_name();
            names.extend(name.into_string().ok().filter(|name| !name.starts_with('.')));
        }
        names.sort();
        Ok(names)
    }

    /// Moves a file. Returns false if it no longer exists, because another process has moved or removed it.
    pub(super) fn move_file(&self, from: &Path, to: &Path) -> Result<bool, CalibrationError> {
        gone(fs::rename(from, to), to)
    }

    /// Removes a file. Returns false if it does not exist.
    pub(super) fn remove(&self, path: &Path) -> Result<bool, CalibrationError> {
        gone(fs::remove_file(path), path)
    }
}

/// True on success, false if the file does not exist.
fn gone(result: io::Result<()>, path: &Path) -> Result<bool, CalibrationError> {
    match result {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(false),
        Err(error) => Err(write_error(path)(error)),
    }
}

pub(super) fn write_error(path: &Path) -> impl Fn(io::Error) -> CalibrationError {
    move |error| FmiError::io("write", path)(error).into()
}

fn read_error(path: &Path) -> impl Fn(io::Error) -> CalibrationError {
    move |error| FmiError::io("read", path)(error).into()
}

/// Returns the bytes of a file with this content.
pub(super) fn encode<T: Serialize>(value: &T) -> Result<Vec<u8>, CalibrationError> {
    let mut content = Vec::new();
    ciborium::into_writer(value, &mut content)
        .map_err(|error| CalibrationError::Setup(format!("the fit cannot be stored: {error}")))?;
    Ok([MARK.as_bytes(), hash_of_bytes(&content).as_bytes(), &content].concat())
}

/// Writes a file atomically.
pub(super) fn write<T: Serialize>(path: &Path, value: &T) -> Result<(), CalibrationError> {
    write_atomically(path, &encode(value)?).map_err(write_error(path))
}

/// Reads a file; `None` if it does not exist.
pub(super) fn read<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, CalibrationError> {
    let bytes = match read_regular(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(read_error(path)(error)),
    };
    let damaged = |what: &str| {
        let message =
            format!("{} is damaged: {what}. Remove the file, and run the jobs again", path.display());
        CalibrationError::Setup(message)
    };
    let rest = bytes.strip_prefix(MARK.as_bytes());
    let (hash, content) = rest
        .and_then(|rest| rest.split_at_checked(HASH))
        .ok_or_else(|| damaged("it does not begin like a file of this version"))?;
    if hash_of_bytes(content).as_bytes() != hash {
        return Err(damaged("its checksum does not match"));
    }
    ciborium::from_reader(content).map(Some).map_err(|error| damaged(&error.to_string()))
}
