//! Comparisons of the answers of used and fresh worker processes. They show whether a model can be reset
//! between two simulations.

use crate::cost::failure::ReportedCostFailure;
use crate::cost::request::Evaluated;
use dfo::FailureKind;
use fmi::worker::{AnswerLimits, Frame, Question};
use fmi::{FmiError, Reuse};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};

/// Process that answers a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ProcessChoice {
    /// Any process that has loaded the problem.
    Any,
    /// The process that has been idle longest among the processes that have loaded the problem.
    LongestIdle,
    /// Any process. If a used process answers, the very first question is repeated and compared, until one
    /// comparison agrees. Use it in searches, which compare the best point at their end.
    ComparedFirst,
    /// Any process. After the first comparison that agrees, the first, second, fourth, eighth ... of the next
    /// answers are also followed by a comparison.
    Compared,
    /// A new process.
    Fresh,
}

/// Message about a model whose answers in fresh processes differ.
pub(crate) const NOT_REPRODUCED: &str =
    "two runs of the same simulation in fresh processes differ. No result can be reproduced";

/// The very first question, and the answer of an unused process.
#[derive(Debug, Clone)]
pub(super) struct FirstQuestion {
    pub(super) requested: Frame,
    pub(super) limits: AnswerLimits,
    /// The question without parameter values. A question with a different shape replaces the first one,
    /// because the first one may take longer.
    pub(super) shape: Frame,
    /// Number of changes of the environment before the question.
    pub(super) n_changes: u64,
    pub(super) bits: Vec<u64>,
}

impl FirstQuestion {
    /// Returns the question, to be repeated during another one.
    pub(super) fn during<'a>(&'a self, other: &Question<'a>) -> Question<'a> {
        Question { requested: &self.requested, limits: self.limits, is_repetition: true, ..*other }
    }
}

/// Results of comparisons of used with fresh processes.
#[derive(Debug, Default)]
pub(super) struct Comparisons {
    /// Index of the way of resetting that has passed a comparison, plus one.
    passed: AtomicU8,
    pub(super) first: Mutex<Option<FirstQuestion>>,
    /// Number of answers of used processes since that comparison.
    n_accepted: AtomicU64,
    /// True if answers of fresh processes differ from each other.
    pub(super) is_random: AtomicBool,
}

impl Comparisons {
    pub(super) fn has_passed(&self, reuse: Reuse) -> bool {
        self.passed.load(Ordering::Relaxed) == reuse as u8 + 1
    }

    pub(super) fn note_passed(&self, reuse: Reuse) {
        if self.passed.swap(reuse as u8 + 1, Ordering::Relaxed) != reuse as u8 + 1 {
            self.n_accepted.store(0, Ordering::Relaxed);
        }
    }

    /// True if the next answer must be compared.
    pub(super) fn is_due(&self, reuse: Reuse, process: ProcessChoice) -> bool {
        if self.is_random.load(Ordering::Relaxed) {
            return false;
        }
        if !self.has_passed(reuse) {
            return true;
        }
        process == ProcessChoice::Compared
            && (self.n_accepted.fetch_add(1, Ordering::Relaxed) + 1).is_power_of_two()
    }
}

/// Returns the bits of an answer; empty for a failed simulation. Returns `None` if the answer depends
/// on the clock, because the context or a time limit may have ended the simulation.
pub(super) fn bits_of<T>(
    reported: &Result<T, FmiError>,
    answer: &Frame,
    question: &Question<'_>,
) -> Option<Vec<u64>> {
    if question.context.is_over() {
        return None;
    }
    match reported {
        Ok(_) if answer.numbers.is_empty() => match answer.head::<Evaluated>().ok()?.cost {
            Err(ReportedCostFailure::Failed { kind: FailureKind::TimedOut, .. }) => None,
            _ => Some(Vec::new()),
        },
        Ok(_) => Some(answer.numbers.iter().map(|number| number.to_bits()).collect()),
        Err(FmiError::ReportedError(reported))
            if !reported.is_of_process() && question.limits.run.is_none() =>
        {
            Some(Vec::new())
        }
        Err(_) => None,
    }
}
