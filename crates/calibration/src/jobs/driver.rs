//! The search of a fit, whose simulations other processes do.

use super::folder::{ANSWERS, CLAIMS, JobFolder, LOST, POINTS, encode, read, write, write_error};
use super::points::{Pause, PointName, StoredPoint};
use crate::error::CalibrationError;
use crate::fit::one_stage::SimulationExecutor;
use crate::loaded::calibration::Calibration;
use base::files::{read_regular, write_atomically};
use dfo::{Answer, Evaluator, Outcome, PollResult, Query, RobustLoss, Wait};
use ode::Stats;
use std::cell::{Cell, RefCell};
use std::collections::{HashMap, VecDeque};
use std::fs;
use std::rc::Rc;
use std::time::{Duration, Instant, SystemTime};

/// A submitted point.
#[derive(Debug)]
struct Submitted {
    id: u64,
    name: PointName,
    point: StoredPoint,
}

/// Executor of a fit that writes points to a folder and reads their answers.
#[derive(Debug)]
pub struct JobDriver {
    folder: JobFolder,
    width: usize,
    /// Problem of the submitted points, and the number of the next problem.
    problem: usize,
    next_problem: usize,
    submitted: Vec<Submitted>,
    /// Cancelled points.
    skipped: VecDeque<u64>,
    /// Claims with the time of their last sign of life, and the time at which this process first saw it.
    /// Clocks of two machines are never compared.
    seen: HashMap<String, (SystemTime, Instant)>,
    next_check: Instant,
    pause: Pause,
    stats: Stats,
    shared: Rc<JobDriverState>,
}

/// State of a driver for the code that runs the fit.
#[derive(Debug, Default)]
pub struct JobDriverState {
    /// True if the driver must leave its points to the next driver. The caller sets it when it interrupts the
    /// fit.
    pub is_leaving: Cell<bool>,
    /// True if the driver has found no answer in its last look.
    pub is_waiting: Cell<bool>,
    /// Error of the folder, which has ended the search.
    pub error: RefCell<Option<CalibrationError>>,
}

impl JobDriver {
    /// Creates the driver of a fit that plans for `width` processes.
    pub fn new(folder: JobFolder, width: usize) -> Self {
        Self {
            folder,
            width,
            problem: 0,
            next_problem: 0,
            submitted: Vec::new(),
            skipped: VecDeque::new(),
            seen: HashMap::new(),
            next_check: Instant::now(),
            pause: Pause::new(),
            stats: Stats::default(),
            shared: Rc::default(),
        }
    }

    /// Returns the state of the driver.
    pub fn state(&self) -> Rc<JobDriverState> {
        Rc::clone(&self.shared)
    }

    /// Keeps the first error. It ends the search with the next answer.
    fn note<T>(&self, result: Result<T, CalibrationError>) -> Option<T> {
        result.map_err(|error| _ = self.shared.error.borrow_mut().get_or_insert(error)).ok()
    }

    fn begin_problem(&mut self, calibration: &Calibration, loss: RobustLoss) -> Result<(), CalibrationError> {
        (self.problem, self.next_problem) = (self.next_problem, self.next_problem + 1);
        let path = self.folder.problem_path(self.problem);
        let bytes = encode(&(calibration.problem(), loss))?;
        match read_regular(&path) {
            Ok(stored) if stored == bytes => {}
            Ok(_) => {
                return Err(CalibrationError::Setup(format!(
                    "{} differs from the problem that this process has found at the same stage of the fit. \
                     Run all jobs with the same model and on the same kind of machine",
                    path.display()
                )));
            }
            Err(_) => write_atomically(&path, &bytes).map_err(write_error(&path))?,
        }
        // This driver writes the points that it needs again.
        for name in self.folder.names(POINTS)? {
            self.folder.remove(&self.folder.file(POINTS, &name))?;
        }
        Ok(())
    }

    /// Writes a point unless its answer is known or a process evaluates it.
    fn offer(&self, name: &PointName, point: &StoredPoint) -> Result<(), CalibrationError> {
        if self.folder.file(ANSWERS, &name.answer()).exists() || self.claim_of(name)?.is_some() {
            return Ok(());
        }
        write(&self.folder.file(POINTS, &name.point()), point)
    }

    /// Returns the claim of a point and its lease. A claim may carry the id of an earlier driver.
    fn claim_of(&self, name: &PointName) -> Result<Option<(String, Duration)>, CalibrationError> {
        let is_it = |file: &String| {
            let (found, lease) = PointName::parse(file)?;
            let is_it = found.problem == name.problem && found.key == name.key;
            is_it.then(|| (file.clone(), lease))
        };
        Ok(self.folder.names(CLAIMS)?.iter().find_map(is_it))
    }

    /// Takes an answer, if there is one.
    fn look(&mut self, answer: &mut Answer) -> Result<Option<u64>, CalibrationError> {
        for k in 0..self.submitted.len() {
            let path = self.folder.file(ANSWERS, &self.submitted[k].name.answer());
            if let Some((found, stats)) = read::<(Answer, Stats)>(&path)? {
                *answer = found;
                self.stats += stats;
                return Ok(Some(self.submitted.remove(k).id));
            }
        }
        if Instant::now() >= self.next_check {
            self.check_claims()?;
            self.next_check = Instant::now() + self.folder.lease() / 4;
        }
        Ok(None)
    }

    /// Offers points again whose process has ended.
    fn check_claims(&mut self) -> Result<(), CalibrationError> {
        let now = Instant::now();
        for Submitted { name, point, .. } in &self.submitted {
            let is_offered = self.folder.file(POINTS, &name.point()).exists();
            if let Some((claim, lease)) = self.claim_of(name)? {
                let sign = fs::metadata(self.folder.file(CLAIMS, &claim)).and_then(|file| file.modified());
                let Ok(sign) = sign else { continue };
                let seen = self.seen.entry(claim.clone()).or_insert((sign, now));
                if seen.0 != sign {
                    *seen = (sign, now);
                }
                if now.duration_since(seen.1) < lease || !self.folder.lose(&claim, name)? {
                    continue;
                }
                self.seen.remove(&claim);
            } else if is_offered {
                continue;
            }
            self.offer(name, point)?;
        }
        Ok(())
    }
}

impl Evaluator for JobDriver {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        let point = StoredPoint { x: x.to_vec(), cutoff: query.cutoff };
        let name = PointName::new(self.problem, query.id, &point);
        self.note(self.offer(&name, &point));
        self.submitted.push(Submitted { id: query.id, name, point });
    }

    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> PollResult {
        answer.clear();
        if let Some(id) = self.skipped.pop_front() {
            return PollResult::Answered(id);
        }
        if self.submitted.is_empty() {
            return PollResult::Idle;
        }
        while self.pause.wait(wait.until) {
            let found = self.look(answer);
            let found = self.note(found).flatten();
            if let Some(error) = &*self.shared.error.borrow() {
                answer.clear();
                answer.outcome = Outcome::Abort(error.to_string());
                return PollResult::Answered(self.submitted.remove(0).id);
            }
            self.shared.is_waiting.set(found.is_none());
            if let Some(id) = found {
                self.pause = Pause::new();
                return PollResult::Answered(id);
            }
            self.pause.extend();
        }
        PollResult::Waiting
    }

    fn cancel(&mut self, id: u64) {
        let Some(k) = self.submitted.iter().position(|submitted| submitted.id == id) else { return };
        let Submitted { name, .. } = self.submitted.remove(k);
        self.skipped.push_back(id);
        if !self.shared.is_leaving.get() {
            let claim = self.note(self.claim_of(&name)).flatten();
            let claim = claim.map(|(claim, _)| self.folder.file(CLAIMS, &claim));
            for path in [Some(self.folder.file(POINTS, &name.point())), claim].into_iter().flatten() {
                self.note(self.folder.remove(&path));
            }
        }
    }

    fn width(&self) -> usize {
        self.width
    }

    fn leave(&mut self) -> bool {
        true
    }

    fn n_lost(&self) -> usize {
        let prefix = format!("{:04}-", self.problem);
        self.folder.names(LOST).unwrap_or_default().iter().filter(|name| name.starts_with(&prefix)).count()
    }
}

impl SimulationExecutor for JobDriver {
    fn begin(&mut self, calibration: &Calibration, loss: RobustLoss) {
        self.submitted.clear();
        self.skipped.clear();
        let begun = self.begin_problem(calibration, loss);
        self.note(begun);
    }

    fn take_stats(&mut self) -> Stats {
        std::mem::take(&mut self.stats)
    }
}
