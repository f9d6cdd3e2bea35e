//! Checkpoints: the whole state of a run in a file, so that a resumed run is bit-for-bit identical to an
//! uninterrupted one.
//!
//! The file contains a mark, the format, a checksum and a CBOR map (RFC 8949) with named entries. The first
//! entry is the version of the code that wrote the file. Each write replaces the whole file: a temporary file
//! is written and then renamed, so a kill leaves the previous state. Writing takes at most a tenth of the
//! time of a run. The identity of a run (the fingerprint) is stored as text. A file of another run is left
//! unchanged, and the error reports the difference.
//!
//! If the end of a run cuts a batch short, the stored state of the method does not include the batch. The
//! known outcomes are stored separately and are used when the resumed run requests them.

use crate::error::Error;
use crate::evaluation::counted_batch::CountedBatch;
use crate::evaluation::ledger::Ledger;
use crate::evaluation::store::{EarlyOutcome, Store};
use crate::method_interface::interface::{Method, Setup};
use crate::problem::option_texts;
use crate::values::encoding::{decode, encode};
use base::files::{AtomicFile, Claim};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// First bytes of a checkpoint. The format follows in one byte.
const MARK: &[u8; 15] = b"dfo checkpoint\0";

/// Format that this version reads and writes. It changes with the contents of the file.
const FORMAT: u8 = 14;

/// Version of the code, stored in every file.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Treatment of an existing checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Resume {
    /// Continue if a checkpoint exists; otherwise start.
    #[default]
    Auto,
    /// Start from the beginning, even if a checkpoint exists.
    Never,
    /// Continue; it is an error if no checkpoint exists.
    Require,
}

/// Location and frequency of the checkpoints of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Checkpoint {
    /// The file.
    pub path: PathBuf,
    /// Default [`Resume::Auto`].
    pub resume: Resume,
    /// Minimum time between two writes during the run; default 0.2 s. The state at the end of a run is always
    /// written.
    pub interval: Duration,
    /// Additional named properties that identify the run, for example the source of the objective.
    pub tags: Vec<(String, String)>,
    /// Name of the minimised function, see [`function`](Self::function).
    #[serde(default)]
    pub function: Option<String>,
}

/// Name of the fingerprint entry with the name of the function.
const FUNCTION: &str = "function";

impl Checkpoint {
    /// Creates a checkpoint at `path`. The run resumes from this file if it exists.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            resume: Resume::Auto,
            interval: Duration::from_millis(200),
            tags: Vec::new(),
            function: None,
        }
    }

    /// Sets the name of the minimised function. [`Resume::Auto`] rejects a file of a function with another
    /// name. With [`Resume::Require`], the user confirms that the file is the right one. The user is
    /// responsible for the function computing the same values as before.
    #[must_use]
    pub fn function(mut self, name: impl Into<String>) -> Self {
        self.function = Some(name.into());
        self
    }

    /// Sets the treatment of an existing file.
    #[must_use]
    pub fn resume(mut self, resume: Resume) -> Self {
        self.resume = resume;
        self
    }

    /// Sets the minimum time between two writes.
    #[must_use]
    pub fn interval(mut self, interval: Duration) -> Self {
        self.interval = interval;
        self
    }

    /// Returns the identity of the run in the file, by name, including its tags. `None` if the file does not
    /// exist or will not be continued.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read or is not a checkpoint, or if a checkpoint is required and
    /// does not exist.
    pub fn stored_identity(&self) -> Result<Option<Vec<(String, String)>>, Error> {
        Ok(load(self)?.map(|snapshot| snapshot.fingerprint.into_owned()))
    }

    /// Adds a property that identifies the run. A file with another value is rejected.
    #[must_use]
    pub fn tag(mut self, name: impl Into<String>, value: impl Into<String>) -> Self {
        self.tags.push((name.into(), value.into()));
        self
    }
}

/// The whole state of a run.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Snapshot<'a> {
    version: Cow<'a, str>,
    pub(crate) fingerprint: Cow<'a, [(String, String)]>,
    #[serde(with = "serde_bytes")]
    pub(crate) method: Vec<u8>,
    pub(crate) ledger: Cow<'a, Ledger>,
    pub(crate) store: Cow<'a, Store>,
    pub(crate) stale: usize,
    /// Finished evaluations of the batch that the method waits for.
    #[serde(rename = "known")]
    pub(crate) finished: Cow<'a, [EarlyOutcome]>,
    pub(crate) observed: Option<usize>,
    pub(crate) first_recent: usize,
    pub(crate) seconds: f64,
    pub(crate) seed: Option<u64>,
}

/// Version that wrote a file, readable whatever else the file contains.
#[derive(Debug, Deserialize)]
struct Written {
    version: String,
}

/// Returns the identity of a run as text.
pub(crate) fn fingerprint(
    (method, options, budget): (&str, Vec<(String, String)>, bool),
    setup: &Setup,
    (cache, trace_limit, n_pinned): (usize, Option<usize>, usize),
    (problem, place): (Option<&str>, &Checkpoint),
) -> Vec<(String, String)> {
    let Setup { space, tolerances, prior, .. } = setup;
    let named = |name: &str, value: String| (name.to_owned(), value);
    let start = if setup.start_given { option_texts::numbers(space.x0()) } else { "not given".to_owned() };
    let mut all = vec![named("method", method.to_owned())];
    all.extend(options.into_iter().map(|(name, value)| (format!("option {name}"), value)));
    all.push(named("start", start));
    all.extend(space.describe());
    let constraints = &setup.constraints;
    if !constraints.nonlinear.is_empty() {
        all.push(named("nonlinear constraints", option_texts::word(&constraints.nonlinear)));
        all.push(named("constraint_tol", constraints.tolerance.to_string()));
    }
    all.extend(option_texts::fields(tolerances));
    all.push(named("cache", cache.to_string()));
    all.push(named("trace limit", option_texts::limit(trace_limit)));
    if budget {
        all.push(named("max_evaluations", option_texts::limit(setup.max_evaluations)));
    }
    if !prior.is_empty() {
        let bytes = encode(prior).unwrap_or_default();
        all.push(named(
            "warm start",
            format!("{} points, {n_pinned} with costs ({:08x})", prior.len(), crc32fast::hash(&bytes)),
        ));
    }
    all.extend(place.tags.iter().map(|(name, value)| (name.clone(), value.clone())));
    all.extend(place.function.iter().map(|function| named(FUNCTION, function.clone())));
    // The problem comes after the tags, because tags describe a difference more clearly than a hash.
    if let Some(problem) = problem {
        all.push(named("problem", problem.to_owned()));
    }
    all
}

fn failed(path: &Path, message: impl ToString) -> Error {
    Error::Checkpoint { path: path.display().to_string(), message: message.to_string() }
}

fn file_failed(path: &Path, e: &std::io::Error) -> Error {
    let text = e.to_string();
    // Omits the error number of the operating system.
    let message = text.split(" (os error").next().unwrap_or(&text).to_owned();
    Error::CheckpointFile { path: path.display().to_string(), kind: e.kind(), message }
}

/// Reads the state from the file, even if it belongs to another run. `None` if there is nothing to continue
/// from.
fn load(options: &Checkpoint) -> Result<Option<Snapshot<'static>>, Error> {
    let path = &options.path;
    let is_required = options.resume == Resume::Require;
    if path.as_os_str().is_empty() {
        return Err(failed(path, "the path is empty; specify the path of a file"));
    }
    let file = match base::files::open_regular(path) {
        Ok(file) => file,
        Err(e) if e.kind() == ErrorKind::NotFound && !is_required => return Ok(None),
        Err(e) if matches!(e.kind(), ErrorKind::InvalidInput | ErrorKind::IsADirectory) => {
            return Err(failed(path, "it is not a regular file"));
        }
        Err(e) => return Err(file_failed(path, &e)),
    };
    let mut bytes = Vec::new();
    // If the file will be replaced, only its mark is read. A file without the mark must not be replaced.
    let most = if options.resume == Resume::Never { MARK.len() as u64 + 1 } else { u64::MAX };
    file.take(most).read_to_end(&mut bytes).map_err(|e| file_failed(path, &e))?;
    let Some((format, rest)) = bytes.strip_prefix(&MARK[..]).and_then(|rest| rest.split_first()) else {
        if bytes.is_empty() && options.resume == Resume::Never {
            return Ok(None);
        }
        return Err(failed(
            path,
            "the file is not a checkpoint and will not be overwritten; specify another path",
        ));
    };
    if options.resume == Resume::Never {
        return Ok(None);
    }
    if *format != FORMAT {
        let age = if *format < FORMAT { "an earlier" } else { "a later" };
        return Err(failed(
            path,
            format!(
                "the file has format {format} of {age} version, but this version reads format {FORMAT}. \
                 Continue with the version that wrote the file, or restart with resume=\"never\""
            ),
        ));
    }
    let whole = rest.split_first_chunk().filter(|(sum, state)| crc32fast::hash(state).to_le_bytes() == **sum);
    let Some((_, state)) = whole else {
        return Err(failed(
            path,
            "the file is damaged, because its checksum does not match. Continue with a backup copy, or \
             restart with resume=\"never\"",
        ));
    };
    decode(state).map(Some).map_err(|e| {
        let writer =
            decode::<Written>(state).map_or_else(|_| "another".to_owned(), |written| written.version);
        failed(path, format!("version {VERSION} cannot read this file of version {writer}: {e}"))
    })
}

/// Returns the user-facing name of a fingerprint entry.
pub(crate) fn words(name: &str) -> &str {
    match name {
        "measure" => "tolerances",
        "sizes" => "sizes of the parameters (nominal, start or bounds)",
        "option scheme" => "options of differential evolution",
        _ => name,
    }
}

/// Reads and checks the checkpoint to continue from. `None` if there is nothing to continue from.
pub(crate) fn read(
    options: &Checkpoint,
    fingerprint: &[(String, String)],
    seed: Option<u64>,
    n: usize,
) -> Result<Option<Snapshot<'static>>, Error> {
    let path = &options.path;
    let Some(snapshot) = load(options)? else { return Ok(None) };
    let mismatch = |what: &str, stored: &str, given: &str| Error::CheckpointMismatch {
        path: path.display().to_string(),
        what: words(what).to_owned(),
        stored: stored.to_owned(),
        given: given.to_owned(),
    };
    let function = |all: &[(String, String)]| {
        all.iter().find(|(n, _)| n == FUNCTION).map_or_else(|| "none".to_owned(), |(_, name)| name.clone())
    };
    let (stored, given) = (function(&snapshot.fingerprint), function(fingerprint));
    if stored != given && options.resume == Resume::Auto {
        let what = format!(
            "it belongs to another function, {stored} instead of {given}. Set resume=\"require\" to continue \
             anyway, or resume=\"never\" to restart"
        );
        return Err(failed(path, what));
    }
    for (name, given) in fingerprint.iter().filter(|(name, _)| name != FUNCTION) {
        let stored = snapshot.fingerprint.iter().find(|(n, _)| n == name).map(|(_, v)| &v[..]);
        if stored != Some(given) {
            return Err(mismatch(name, stored.unwrap_or("nothing"), given));
        }
    }
    if let Some((name, stored)) =
        (snapshot.fingerprint.iter()).find(|(n, _)| n != FUNCTION && fingerprint.iter().all(|(m, _)| m != n))
    {
        return Err(mismatch(name, stored, "nothing"));
    }
    if let (Some(stored), Some(given)) = (snapshot.seed, seed)
        && stored != given
    {
        return Err(mismatch("seed", &stored.to_string(), &given.to_string()));
    }
    if !(snapshot.ledger.is_sound(n)
        && snapshot.store.is_sound(n)
        && snapshot.finished.iter().all(|early| early.entry.x.len() == n && early.is_of_path)
        && snapshot.seconds >= 0.0
        && snapshot.seconds.is_finite())
    {
        return Err(failed(path, "the contents of the file are inconsistent"));
    }
    Ok(Some(snapshot))
}

/// Returns the elapsed time of a run before its next write. All writes then take at most a tenth of the run,
/// even if states are long. The estimate includes the next write and one at the end, each 1.5 times as long
/// as the last.
fn least_time(spent: Duration, last: Duration) -> Duration {
    10 * (spent + 3 * last)
}

/// Writer of snapshots that limits how often they are written.
#[derive(Debug)]
pub(crate) struct Writer {
    options: Checkpoint,
    fingerprint: Vec<(String, String)>,
    began: Instant,
    next: Instant,
    /// Total time of all writes.
    spent: Duration,
    /// Claim that prevents other runs from writing to the file.
    _claim: Claim,
}

impl Writer {
    /// Checks that the file can be written before anything is computed. `by_hand` marks a run that is idle
    /// between calls, so another run of this process may continue its file.
    pub(crate) fn new(
        options: Checkpoint,
        fingerprint: Vec<(String, String)>,
        by_hand: bool,
    ) -> Result<Self, Error> {
        let path = &options.path;
        base::files::remove_unfinished(path);
        AtomicFile::new(path).map_err(|e| file_failed(path, &e))?;
        let claim = Claim::new(path, by_hand).map_err(|e| match e.kind() {
            ErrorKind::ResourceBusy => {
                failed(path, format!("{e}; wait until it has ended, or specify another path"))
            }
            _ => file_failed(path, &e),
        })?;
        let began = Instant::now();
        let next = began + options.interval;
        Ok(Self { began, next, spent: Duration::ZERO, options, fingerprint, _claim: claim })
    }

    /// True if it is time for the next write.
    pub(crate) fn is_due(&self) -> bool {
        Instant::now() >= self.next
    }

    /// Replaces the file with the current state. `finished` are the outcomes so far of the batch that the
    /// method waits for. `observed` is the last iteration that the observer saw, and `first_recent` is the
    /// length of the trace at that time.
    pub(crate) fn write(
        &mut self,
        method: &dyn Method,
        round: &CountedBatch,
        finished: &[EarlyOutcome],
        observed: Option<usize>,
        first_recent: usize,
        seconds: f64,
    ) -> Result<(), Error> {
        let path = &self.options.path;
        let begin = Instant::now();
        let state = method.save().ok_or_else(|| failed(path, "this method does not support checkpoints"))?;
        let snapshot = Snapshot {
            version: Cow::Borrowed(VERSION),
            fingerprint: Cow::Borrowed(&self.fingerprint),
            method: state,
            ledger: Cow::Borrowed(&round.ledger),
            store: Cow::Borrowed(&round.store),
            stale: round.stale,
            finished: Cow::Borrowed(finished),
            observed,
            first_recent,
            seconds,
            seed: method.details().seed,
        };
        let bytes = encode(&snapshot).map_err(|e| failed(path, e))?;
        let written = AtomicFile::new(path).and_then(|unfinished| {
            let mut file = unfinished.file();
            file.write_all(&[&MARK[..], &[FORMAT], &crc32fast::hash(&bytes).to_le_bytes()].concat())?;
            file.write_all(&bytes)?;
            unfinished.finish()
        });
        // A failed write is tried again when the next write is due.
        self.spent += begin.elapsed();
        let until = self.began + least_time(self.spent, begin.elapsed());
        self.next = until.max(Instant::now() + self.options.interval);
        written.map_err(|e| file_failed(path, &e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn writes_take_at_most_a_tenth_of_a_run() {
        // Constant write times, times that grow with the trace, and one slow period among fast writes.
        let all: [&dyn Fn(f64) -> f64; 3] =
            [&|_| 0.7, &|now| 4e-3 * now, &|now| if (40.0..60.0).contains(&now) { 0.3 } else { 0.01 }];
        for seconds in all {
            let (mut now, mut spent, mut last, mut n) = (0.0, 0.0, seconds(0.0), 0);
            while now < 2000.0 {
                let times = [spent, last].map(Duration::from_secs_f64);
                now = least_time(times[0], times[1]).as_secs_f64().max(now + 1.0);
                last = seconds(now);
                spent += last;
                n += 1;
                // The bound also applies if the run ends here with one last write.
                assert!(spent + last <= 0.1001 * now, "{now}: {spent}");
            }
            assert!(n > 15, "{n} writes");
        }
    }
}
