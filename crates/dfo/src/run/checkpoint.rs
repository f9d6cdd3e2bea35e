//! Checkpoints: the whole state of a run in a file, so that a resumed run is the uninterrupted one, bit for
//! bit.
//!
//! The file is a mark, the format, and blocks: length, checksum, and a map in CBOR (RFC 8949) that names all
//! its parts, the version of the code that wrote it first. Each block is the state of the run at some time,
//! but for the trace, of which it has what came after the block before. A run adds blocks, so that its trace
//! is written once. The first block is written to a temporary file that is renamed, as is the whole file
//! where states that have been replaced fill half of it. What follows a block that is not whole (the process
//! was killed, or the power failed) counts as not there: there is always a state to go on from. What
//! identifies a run (the fingerprint) is stored in words; a file of another run is refused by naming the
//! difference, and left as it is.
//!
//! A batch that was cut short by the end of a run is not told to the stored state: the outcomes that were
//! known are kept beside it and given again when the resumed run asks.

use crate::error::Error;
use crate::evaluation::counted_batch::CountedBatch;
use crate::evaluation::ledger::Ledger;
use crate::evaluation::store::{EarlyOutcome, Store};
use crate::method_interface::interface::{Method, Setup};
use crate::outcome::trace::{LaterPart, Trace, TraceLength};
use crate::problem::option_texts;
use crate::values::encoding::{decode, encode};
use base::files::{self, AtomicFile, Claim};
use crc32fast::Hasher;
use serde::{Deserialize, Serialize};
use std::fs::{File, Metadata};
use std::io::{BufWriter, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// First bytes of a checkpoint; then comes the format, one byte.
const MARK: &[u8; 15] = b"dfo checkpoint\0";

/// The format that this version reads and writes. It changes with everything that a file holds.
const FORMAT: u8 = 13;

/// Bytes before a block: its length and its checksum.
const BLOCK_HEAD: usize = 12;

/// Version of the code, which every file names.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Treatment of a checkpoint that is there already.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Resume {
    /// Continue if there is one, else start.
    #[default]
    Auto,
    /// Start anew, whatever there is.
    Never,
    /// Continue; an error if there is none.
    Require,
}

/// Where and how often a run writes its state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Checkpoint {
    /// The file.
    pub path: PathBuf,
    /// Default [`Resume::Auto`].
    pub resume: Resume,
    /// Least time between two writes while the run goes on; default 0.2 s. The end of a run is always
    /// written.
    pub interval: Duration,
    /// Further identity of the run, by name: what the objective is made from, for example.
    pub tags: Vec<(String, String)>,
    /// Name of the function that is minimised, see [`function`](Self::function).
    #[serde(default)]
    pub function: Option<String>,
}

/// Name of the function among what identifies a run.
const FUNCTION: &str = "function";

impl Checkpoint {
    /// Writes to this file and resumes from it, if it is there.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            resume: Resume::Auto,
            interval: Duration::from_millis(200),
            tags: Vec::new(),
            function: None,
        }
    }

    /// Sets the name of the function that is minimised. With [`Resume::Auto`] a file of a function with
    /// another name is refused; with [`Resume::Require`] the user says that it is the right one. Whether the
    /// function computes the same as before, the user decides.
    #[must_use]
    pub fn function(mut self, name: impl Into<String>) -> Self {
        self.function = Some(name.into());
        self
    }

    /// Sets what to do with a file that is there already.
    #[must_use]
    pub fn resume(mut self, resume: Resume) -> Self {
        self.resume = resume;
        self
    }

    /// Sets the least time between two writes.
    #[must_use]
    pub fn interval(mut self, interval: Duration) -> Self {
        self.interval = interval;
        self
    }

    /// Identity of the run in the file, by name, its tags among it; `None` where there is no file, or where
    /// it will not be continued.
    ///
    /// # Errors
    /// The file cannot be read, or is no checkpoint, or there is none and one is required.
    pub fn stored_identity(&self) -> Result<Option<Vec<(String, String)>>, Error> {
        Ok(load(self)?.map(|snapshot| snapshot.fingerprint))
    }

    /// Adds something that identifies the run: a file with another value is refused.
    #[must_use]
    pub fn tag(mut self, name: impl Into<String>, value: impl Into<String>) -> Self {
        self.tags.push((name.into(), value.into()));
        self
    }
}

/// The whole state of a run.
#[derive(Debug, Deserialize)]
pub(crate) struct Snapshot {
    pub(crate) fingerprint: Vec<(String, String)>,
    #[serde(with = "serde_bytes")]
    pub(crate) method: Vec<u8>,
    pub(crate) ledger: Ledger,
    trace: Trace,
    /// Length of what the run has dropped of its trace.
    dropped: TraceLength,
    pub(crate) store: Store,
    pub(crate) stale: usize,
    /// Evaluations so far of the batch that the method waits for.
    pub(crate) known: Vec<EarlyOutcome>,
    pub(crate) observed: Option<usize>,
    pub(crate) first_recent: usize,
    pub(crate) seconds: f64,
    pub(crate) seed: Option<u64>,
}

/// Who wrote a file, whatever else it holds.
#[derive(Debug, Deserialize)]
struct Written {
    version: String,
}

/// A [`Snapshot`] with borrowed fields, for writing.
#[derive(Serialize)]
struct SnapshotRef<'a> {
    version: &'a str,
    fingerprint: &'a [(String, String)],
    #[serde(with = "serde_bytes")]
    method: &'a [u8],
    ledger: &'a Ledger,
    trace: LaterPart<'a>,
    dropped: TraceLength,
    store: &'a Store,
    stale: usize,
    known: &'a [EarlyOutcome],
    observed: Option<usize>,
    first_recent: usize,
    seconds: f64,
    seed: Option<u64>,
}

/// Identity of a run, as text.
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
    // After the tags, which say in words what a hash cannot.
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
    // The system's number says less than its words.
    let message = text.split(" (os error").next().unwrap_or(&text).to_owned();
    Error::CheckpointFile { path: path.display().to_string(), kind: e.kind(), message }
}

/// The state in the file that a run is to continue from, if it is to; whatever run it is of.
fn load(options: &Checkpoint) -> Result<Option<Snapshot>, Error> {
    let path = &options.path;
    let is_required = options.resume == Resume::Require;
    if path.as_os_str().is_empty() {
        return Err(failed(path, "its path is empty; give that of a file"));
    }
    let file = match base::files::open_regular(path) {
        Ok(file) => file,
        Err(e) if e.kind() == ErrorKind::NotFound && !is_required => return Ok(None),
        Err(e) if matches!(e.kind(), ErrorKind::InvalidInput | ErrorKind::IsADirectory) => {
            return Err(failed(path, "this is no regular file"));
        }
        Err(e) => return Err(file_failed(path, &e)),
    };
    let mut bytes = Vec::new();
    // Of a file that will be replaced only the mark: one of somebody else's is not.
    let most = if options.resume == Resume::Never { MARK.len() as u64 + 1 } else { u64::MAX };
    file.take(most).read_to_end(&mut bytes).map_err(|e| file_failed(path, &e))?;
    let Some((format, rest)) = bytes.strip_prefix(&MARK[..]).and_then(|rest| rest.split_first()) else {
        if bytes.is_empty() && options.resume == Resume::Never {
            return Ok(None);
        }
        return Err(failed(path, "this is no checkpoint, and it is left as it is; give another path"));
    };
    if options.resume == Resume::Never {
        return Ok(None);
    }
    if *format != FORMAT {
        let age = if *format < FORMAT { "an earlier" } else { "a later" };
        return Err(failed(
            path,
            format!(
                "it has format {format} of {age} version, this version reads format {FORMAT}; go on with the version \
                 that wrote it, or start anew (resume never)"
            ),
        ));
    }
    let mut snapshot: Option<Snapshot> = None;
    let mut rest = rest;
    while !rest.is_empty() {
        let Some((block, later)) = next_block(rest) else {
            if snapshot.is_none() {
                return Err(failed(
                    path,
                    "the file is damaged: its checksum does not fit; go on with a copy of it, or start anew (resume never)",
                ));
            }
            let (path, n) = (path.display(), rest.len());
            log::warn!(
                "checkpoint '{path}': its last {n} bytes are no whole state; it goes on from the state before"
            );
            break;
        };
        let mut next: Snapshot = decode(block).map_err(|e| {
            let writer =
                decode::<Written>(block).map_or_else(|_| "another".to_owned(), |written| written.version);
            failed(path, format!("version {writer} wrote it, {VERSION} cannot read it: {e}"))
        })?;
        let mut trace = snapshot.map_or_else(|| Trace::new(next.trace.n()), |before| before.ledger.trace);
        if !trace.go_on(std::mem::take(&mut next.trace)) {
            return Err(failed(path, "the parts of the file do not fit together"));
        }
        trace.drop_before(next.dropped);
        next.ledger.trace = trace;
        snapshot = Some(next);
        rest = later;
    }
    snapshot.map(Some).ok_or_else(|| failed(path, "the file ends after its head"))
}

/// The first block and what follows it; `None` if there is no whole one.
fn next_block(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<8>()?;
    let (sum, rest) = rest.split_first_chunk::<4>()?;
    let (block, later) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    (u32::from_le_bytes(*sum) == crc32fast::hash(block) && !block.is_empty()).then_some((block, later))
}

/// The words of users for what identifies a run.
pub(crate) fn words(name: &str) -> &str {
    match name {
        "measure" => "tolerances",
        "sizes" => "sizes of the parameters (nominal, start or bounds)",
        "option scheme" => "options of differential evolution",
        _ => name,
    }
}

/// Reads the checkpoint that a run is to continue from, if it is to.
pub(crate) fn read(
    options: &Checkpoint,
    fingerprint: &[(String, String)],
    seed: Option<u64>,
    n: usize,
) -> Result<Option<Snapshot>, Error> {
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
            "it belongs to another function, {stored} instead of {given}; give resume=\"require\" to continue it all the same, or \
             resume=\"never\" to begin anew"
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
        && snapshot.known.iter().all(|early| early.entry.x.len() == n && early.is_of_path)
        && snapshot.seconds >= 0.0
        && snapshot.seconds.is_finite())
    {
        return Err(failed(path, "the parts of the file do not fit together"));
    }
    Ok(Some(snapshot))
}

/// A file with the checksum of what is written to it.
struct Summed<'a> {
    file: &'a File,
    sum: Hasher,
    length: u64,
}

impl Write for Summed<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let n = self.file.write(bytes)?;
        self.sum.update(&bytes[..n]);
        self.length += n as u64;
        Ok(n)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

/// Time that a run lasts before it writes again: all writes take at most a tenth of it, also where long
/// states take long to write, with the next, and one at the end, each up to half as long again as the last.
fn least_time(spent: Duration, last: Duration) -> Duration {
    10 * (spent + 3 * last)
}

/// Writes a block at the end of a file. Its length and checksum come last, once they are known.
fn write_block(mut file: &File, snapshot: &SnapshotRef<'_>) -> std::io::Result<u64> {
    let head = file.seek(SeekFrom::End(0))?;
    file.write_all(&[0; BLOCK_HEAD])?;
    let mut summed = BufWriter::new(Summed { file, sum: Hasher::new(), length: 0 });
    ciborium::into_writer(snapshot, &mut summed).map_err(|e| match e {
        ciborium::ser::Error::Io(e) => e,
        other => std::io::Error::other(other.to_string()),
    })?;
    let Summed { sum, length, .. } = summed.into_inner().map_err(|e| e.into_error())?;
    file.seek(SeekFrom::Start(head))?;
    file.write_all(&length.to_le_bytes())?;
    file.write_all(&sum.finalize().to_le_bytes())?;
    Ok(length)
}

/// A file with blocks.
#[derive(Debug)]
struct Blocks {
    file: File,
    n_bytes: u64,
    /// Bytes of the last state, and of all, beside those of the trace.
    n_state: u64,
    n_states: u64,
    /// Length of the trace that is in it.
    extent: TraceLength,
}

impl Blocks {
    /// True if the states that have been replaced, and what the run has dropped of its trace, fill more than
    /// half of it.
    fn is_wasteful(&self, trace: &Trace) -> bool {
        let kept = trace.len() as f64 / trace.extent().path.max(1) as f64;
        let whole = (self.n_bytes - self.n_states) as f64 * kept + self.n_state as f64;
        (self.n_bytes + self.n_state) as f64 > 2.0 * whole
    }

    /// True if it is still the file at a place, as it was written, and may be written to.
    fn is_at(&self, path: &Path) -> bool {
        let is_whole = |file: Metadata| file.len() == self.n_bytes && !file.permissions().readonly();
        files::is_at(&self.file, &files::followed(path)).unwrap_or(false)
            && self.file.metadata().is_ok_and(is_whole)
    }
}

/// Writes snapshots, not too often.
#[derive(Debug)]
pub(crate) struct Writer {
    options: Checkpoint,
    fingerprint: Vec<(String, String)>,
    began: Instant,
    next: Instant,
    /// Time of all writes.
    spent: Duration,
    /// What this process has written so far, where the next block goes on.
    written: Option<Blocks>,
    /// No other run writes to the file.
    _claim: Claim,
}

impl Writer {
    /// Checks that there is a place to write to, before anything is computed. `by_hand`: of a run that stands
    /// still where nobody asks it, so that another one of this process may go on with its file.
    pub(crate) fn new(
        options: Checkpoint,
        fingerprint: Vec<(String, String)>,
        by_hand: bool,
    ) -> Result<Self, Error> {
        let path = &options.path;
        base::files::remove_unfinished(path);
        AtomicFile::new(path).map_err(|e| file_failed(path, &e))?;
        let claim = Claim::new(path, by_hand).map_err(|e| match e.kind() {
            ErrorKind::ResourceBusy => failed(path, format!("{e}: wait for its end, or give another path")),
            _ => file_failed(path, &e),
        })?;
        let began = Instant::now();
        let next = began + options.interval;
        Ok(Self { began, next, spent: Duration::ZERO, written: None, options, fingerprint, _claim: claim })
    }

    /// True if it is time for the next write.
    pub(crate) fn is_due(&self) -> bool {
        Instant::now() >= self.next
    }

    /// Adds a block to the file, or puts a whole one in its place. `known`: what is known of the batch that
    /// the method waits for; `observed`: the iteration that the observer saw last, and where the trace stood
    /// then.
    pub(crate) fn write<M: Method + ?Sized>(
        &mut self,
        method: &M,
        round: &CountedBatch,
        known: &[EarlyOutcome],
        observed: Option<usize>,
        first_recent: usize,
        seconds: f64,
    ) -> Result<(), Error> {
        let path = &self.options.path;
        let begin = Instant::now();
        let state = method.save().ok_or_else(|| failed(path, "this method cannot be continued"))?;
        let trace = &round.ledger.trace;
        let before = self.written.take().filter(|blocks| !blocks.is_wasteful(trace) && blocks.is_at(path));
        let extent = before.as_ref().map_or(TraceLength::default(), |blocks| blocks.extent);
        let snapshot = SnapshotRef {
            version: VERSION,
            fingerprint: &self.fingerprint,
            method: &state,
            ledger: &round.ledger,
            trace: trace.since(extent),
            dropped: trace.dropped_extent(),
            store: &round.store,
            stale: round.stale,
            known,
            observed,
            first_recent,
            seconds,
            seed: method.details().seed,
        };
        let written = match before {
            Some(blocks) => write_block(&blocks.file, &snapshot)
                .inspect_err(|_| _ = blocks.file.set_len(blocks.n_bytes))
                .map(|n| (n, Some(blocks.file), blocks.n_states)),
            None => AtomicFile::new(path).and_then(|unfinished| {
                unfinished.file().write_all(&[&MARK[..], &[FORMAT]].concat())?;
                let n = write_block(unfinished.file(), &snapshot)?;
                Ok((n, unfinished.finish_open()?, 0))
            }),
        };
        let written = written.and_then(|(length, file, n_states)| {
            let Some(file) = file else { return Ok(()) };
            let n_state = length.saturating_sub(snapshot.trace.n_bytes());
            let n_bytes = file.metadata()?.len();
            let (n_states, extent) = ((n_states + n_state).min(n_bytes), trace.extent());
            self.written = Some(Blocks { file, n_bytes, n_state, n_states, extent });
            Ok(())
        });
        // What could not be written is tried again.
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
    fn all_writes_take_a_tenth_of_a_run_whatever_one_of_them_takes() {
        // The same for each write, growing with the trace, one slow write among fast ones.
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
                // Wherever the run ends, with its last write.
                assert!(spent + last <= 0.1001 * now, "{now}: {spent}");
            }
            assert!(n > 15, "{n} writes");
        }
    }
}
