//! Points of a fit in a folder: taking them, evaluating them and storing their answers.

use super::folder::{ANSWERS, CLAIMS, JobFolder, LOST, POINTS, PROBLEMS, read, write};
use crate::cost::residual::sum_of_squares;
use crate::error::CalibrationError;
use crate::loaded::calibration::Calibration;
use crate::problem::definition::Problem;
use crate::problem::fingerprint::hash_of_bytes;
use dfo::{Answer, EvaluationKind, Failure, FailureKind, Outcome, Query, RobustLoss};
use fmi::Fmu;
use ode::Stats;
use serde::{Deserialize, Serialize};
use std::fs::OpenOptions;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant, SystemTime};

/// Interval between two checks of a request to end.
const POLL: Duration = Duration::from_millis(50);

/// Increasing times between two looks at a folder that has not changed, from a disk access to a second.
#[derive(Debug)]
pub(super) struct Pause {
    last: Duration,
    next: Instant,
}

impl Pause {
    const SHORTEST: Duration = Duration::from_millis(5);
    const LONGEST: Duration = Duration::from_secs(1);

    pub(super) fn new() -> Self {
        Self { last: Self::SHORTEST, next: Instant::now() }
    }

    /// Called after a look that has found nothing.
    pub(super) fn extend(&mut self) {
        self.next = Instant::now() + self.last;
        self.last = (2 * self.last).min(Self::LONGEST);
    }

    /// Waits until the next look, at most until `end`. Returns true if it is time for the look.
    pub(super) fn wait(&self, end: Instant) -> bool {
        std::thread::sleep(self.next.min(end).saturating_duration_since(Instant::now()));
        Instant::now() >= self.next
    }
}

/// Content of the file of a point.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct StoredPoint {
    pub(super) x: Vec<f64>,
    pub(super) cutoff: f64,
}

/// Identity of a point in the folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct PointName {
    pub(super) problem: usize,
    id: u64,
    pub(super) key: String,
}

impl PointName {
    pub(super) fn new(problem: usize, id: u64, point: &StoredPoint) -> Self {
        let numbers = point.x.iter().chain([&point.cutoff]);
        let bytes: Vec<u8> = numbers.flat_map(|number| number.to_bits().to_le_bytes()).collect();
        let mut key = hash_of_bytes(&bytes);
        key.truncate(32);
        Self { problem, id, key }
    }

    /// Returns the name of the file of the point. Names sort in the order of submission, points of the path
    /// before speculative points.
    pub(super) fn point(&self) -> String {
        format!("{:04}-{:016x}-{}", self.problem, self.id, self.key)
    }

    fn claim(&self, lease: Duration) -> String {
        format!("{}.{}", self.point(), lease.as_secs())
    }

    pub(super) fn answer(&self) -> String {
        format!("{:04}-{}", self.problem, self.key)
    }

    /// Reads the name of a point or a claim. The lease of a point is 0.
    pub(super) fn parse(name: &str) -> Option<(Self, Duration)> {
        let (name, lease) = name.split_once('.').unwrap_or((name, "0"));
        let mut parts = name.splitn(3, '-');
        let problem = parts.next()?.parse().ok()?;
        let id = u64::from_str_radix(parts.next()?, 16).ok()?;
        let key = parts.next()?.to_owned();
        Some((Self { problem, id, key }, Duration::from_secs(lease.parse().ok()?)))
    }
}

/// A point that this process has claimed.
#[derive(Debug)]
pub struct JobPoint {
    name: PointName,
    claim: String,
    point: StoredPoint,
}

impl JobPoint {
    /// Returns the name of the claim, for [`JobFolder::claimed`].
    pub fn name(&self) -> &str {
        &self.claim
    }

    /// Returns the values of the parameters.
    pub fn x(&self) -> &[f64] {
        &self.point.x
    }
}

impl JobFolder {
    /// Claims the first waiting point for a time; `None` if there is none.
    ///
    /// # Errors
    /// Returns an error if the folder cannot be read or written, or if the file of the point is damaged.
    pub fn take(&self, lease: Duration) -> Result<Option<JobPoint>, CalibrationError> {
        for file in self.names(POINTS)? {
            let Some((name, _)) = PointName::parse(&file) else { continue };
            let claim = name.claim(lease);
            let place = self.file(CLAIMS, &claim);
            if self.move_file(&self.file(POINTS, &file), &place)?
                && let Some(point) = read(&place)?
            {
                return Ok(Some(JobPoint { name, claim, point }));
            }
        }
        Ok(None)
    }

    /// Returns a claimed point by its name.
    ///
    /// # Errors
    /// Returns an error if no process has claimed a point of this name.
    pub fn claimed(&self, claim: &str) -> Result<JobPoint, CalibrationError> {
        let none = || {
            let names = self.names(CLAIMS).unwrap_or_default().join(", ");
            let names = if names.is_empty() { "none".to_owned() } else { names };
            CalibrationError::Setup(format!("point '{claim}' is not claimed; claimed points: {names}"))
        };
        let (name, _) = PointName::parse(claim).filter(|_| !claim.contains(['/', '\\'])).ok_or_else(none)?;
        let point = read(&self.file(CLAIMS, claim))?.ok_or_else(none)?;
        Ok(JobPoint { name, claim: claim.to_owned(), point })
    }

    /// Returns a point to the waiting points.
    ///
    /// # Errors
    /// Returns an error if the folder cannot be written.
    pub fn give_back(&self, point: &JobPoint) -> Result<(), CalibrationError> {
        self.move_file(&self.file(CLAIMS, &point.claim), &self.file(POINTS, &point.name.point())).map(drop)
    }

    /// Stores the residuals of a point, before the loss of the fit, or the reason of its failure.
    ///
    /// # Errors
    /// Returns an error if the number of residuals is wrong or the folder cannot be written.
    pub fn tell(
        &self,
        point: &JobPoint,
        fmu: &Fmu,
        residuals: Result<Vec<f64>, String>,
    ) -> Result<(), CalibrationError> {
        let failed = |kind, message| Outcome::Failed(Failure { kind, message });
        let answer = match residuals {
            Err(reason) => failed(FailureKind::Error, reason).into(),
            Ok(mut residuals) => {
                let (calibration, loss) = self.problem(point.name.problem, fmu)?;
                let (n, got) = (calibration.n_values(), residuals.len());
                if got != n {
                    let what = match n == calibration.n_residuals() {
                        true => "residuals",
                        false => "residuals and values of constraints",
                    };
                    return Err(CalibrationError::Setup(format!(
                        "{got} {what} given for point '{}', expected {n}",
                        point.claim
                    )));
                }
                let n = calibration.n_residuals();
                loss.transform_all(&mut residuals[..n]);
                match sum_of_squares(&residuals[..n]) {
                    cost if cost.is_finite() => Answer { residuals, ..Outcome::Value(cost).into() },
                    cost => failed(FailureKind::NotFinite, format!("the cost is {cost}")).into(),
                }
            }
        };
        self.store(point, &answer, Stats::default())
    }

    /// Evaluates waiting points until the fit has ended or `is_over` is set. Returns the number of points.
    ///
    /// # Errors
    /// Returns an error if the folder cannot be used, or if this process can no longer simulate. Its point
    /// then waits for another process.
    pub fn evaluate(&self, fmu: &Fmu, is_over: &AtomicBool) -> Result<usize, CalibrationError> {
        let (mut n, mut pause, mut loaded) = (0, Pause::new(), None);
        while !is_over.load(Ordering::Relaxed) {
            if !pause.wait(Instant::now() + POLL) {
                continue;
            }
            if self.is_done() {
                break;
            }
            let Some(point) = self.take(self.lease())? else {
                pause.extend();
                continue;
            };
            pause = Pause::new();
            let evaluated = self.evaluate_point(&point, fmu, &mut loaded, is_over);
            match evaluated {
                Ok(Some((answer, stats))) => {
                    self.store(&point, &answer, stats)?;
                    n += 1;
                }
                Ok(None) => self.give_back(&point)?,
                Err(error) => {
                    self.give_back(&point)?;
                    return Err(error);
                }
            }
        }
        Ok(n)
    }

    /// Evaluates a point; `None` if the evaluation was cancelled. `loaded` is the last problem used.
    fn evaluate_point(
        &self,
        point: &JobPoint,
        fmu: &Fmu,
        loaded: &mut Option<(usize, Calibration, RobustLoss)>,
        is_over: &AtomicBool,
    ) -> Result<Option<(Answer, Stats)>, CalibrationError> {
        let k = point.name.problem;
        let (_, calibration, loss) = match loaded.take_if(|(position, ..)| *position == k) {
            Some(kept) => loaded.insert(kept),
            None => {
                let (calibration, loss) = self.problem(k, fmu)?;
                loaded.insert((k, calibration, loss))
            }
        };
        let mut stats = Stats::default();
        let (is_cancelled, (sender, receiver)) = (AtomicBool::new(false), channel::<()>());
        let place = &self.file(CLAIMS, &point.claim);
        let answer = std::thread::scope(|scope| {
            let is_cancelled = &is_cancelled;
            scope.spawn(move || self.show_life(place, receiver, is_over, is_cancelled));
            let query = Query::new(0, 0, point.point.cutoff).kind(EvaluationKind::Residuals);
            let query = query.cancellable(is_cancelled, None);
            let answer = calibration.answer_counted(&point.point.x, &query, *loss, &mut stats);
            drop(sender);
            answer
        });
        match &answer.outcome {
            Outcome::Abort(reason) => Err(CalibrationError::Setup(reason.clone())),
            Outcome::Value(_) | Outcome::Above(_) => Ok(Some((answer, stats))),
            Outcome::Failed(failure) if failure.kind.is_of_point() => Ok(Some((answer, stats))),
            Outcome::Failed(_) | Outcome::Skipped => Ok(None),
        }
    }

    /// Keeps a claim alive until the sender of the channel is dropped. Cancels the evaluation if the driver
    /// has withdrawn the claim or `is_over` is set.
    fn show_life(&self, claim: &Path, ended: Receiver<()>, is_over: &AtomicBool, is_cancelled: &AtomicBool) {
        let mut next = Instant::now() + self.lease() / 4;
        while ended.recv_timeout(POLL) == Err(RecvTimeoutError::Timeout) {
            if is_over.load(Ordering::Relaxed) {
                is_cancelled.store(true, Ordering::Relaxed);
            }
            if Instant::now() >= next {
                next += self.lease() / 4;
                let file = OpenOptions::new().write(true).open(claim);
                match file.and_then(|file| file.set_modified(SystemTime::now())) {
                    Err(error) if error.kind() == ErrorKind::NotFound => {
                        is_cancelled.store(true, Ordering::Relaxed)
                    }
                    // The next attempt may succeed. Otherwise, the driver counts the claim as lost.
                    _ => {}
                }
            }
        }
    }

    /// Loads a problem of the fit.
    fn problem(&self, k: usize, fmu: &Fmu) -> Result<(Calibration, RobustLoss), CalibrationError> {
        let path = self.problem_path(k);
        let (problem, loss): (Problem, RobustLoss) = read(&path)?.ok_or_else(|| {
            CalibrationError::Setup(format!("{} does not exist, but a point belongs to it", path.display()))
        })?;
        Ok((Calibration::from_problem(fmu.clone(), problem)?, loss))
    }

    pub(super) fn problem_path(&self, k: usize) -> PathBuf {
        self.file(PROBLEMS, &format!("{k:04}"))
    }

    /// Stores an answer, unless there is one, and ends the claim.
    fn store(&self, point: &JobPoint, answer: &Answer, stats: Stats) -> Result<(), CalibrationError> {
        let place = self.file(ANSWERS, &point.name.answer());
        if !place.exists() {
            write(&place, &(answer, stats))?;
        }
        self.remove(&self.file(CLAIMS, &point.claim)).map(drop)
    }

    /// Moves a claim to the lost claims. Returns false if it has ended in another way.
    pub(super) fn lose(&self, claim: &str, name: &PointName) -> Result<bool, CalibrationError> {
        let answer = name.answer();
        let prefix = format!("{answer}.");
        let n = self.names(LOST)?.iter().filter(|lost| lost.starts_with(&prefix)).count();
        self.move_file(&self.file(CLAIMS, claim), &self.file(LOST, &format!("{prefix}{n}")))
    }
}
