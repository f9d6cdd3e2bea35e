//! Failures of runs by their sorts: which of them are looked into.

use crate::error::{FmiError, Status};
use ode::ErrorKind;
use std::mem::{Discriminant, discriminant};

/// Failures of a sort that are all looked into.
const ALWAYS: u64 = 4;

/// What tells one sort of failures from another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sort {
    error: Discriminant<FmiError>,
    of_simulation: Option<Discriminant<ErrorKind>>,
    call: Option<(&'static str, Status)>,
}

impl Sort {
    pub(super) fn of(error: &FmiError) -> Self {
        let of_simulation = match error {
            FmiError::Simulation(error) => Some(discriminant(&error.kind)),
            _ => None,
        };
        let call = error.call_failure().map(|failure| (failure.call, failure.status));
        Self { error: discriminant(error), of_simulation, call }
    }
}

/// The failures of a library's runs, by their sorts.
#[derive(Debug, Default)]
pub(crate) struct Failures {
    counts: Vec<(Sort, u64)>,
}

impl Failures {
    /// Notes a failure; whether it is one of those to be looked into.
    pub(super) fn note(&mut self, sort: Sort) -> bool {
        let place = self.counts.iter().position(|(known, _)| *known == sort).unwrap_or_else(|| {
            self.counts.push((sort, 0));
            self.counts.len() - 1
        });
        let (_, count) = &mut self.counts[place];
        *count += 1;
        *count <= ALWAYS || count.is_power_of_two()
    }
}
