//! One input as a table with linear interpolation or held values, and the times at which it is not smooth.

use crate::description::VariableKind;
use crate::instance::integer_codec;
use ode::InputStop;
use std::collections::HashMap;
use std::sync::Arc;

/// Input as a table of times and values.
#[derive(Debug, Clone)]
pub(crate) struct InputTable {
    pub(crate) times: Arc<[f64]>,
    pub(crate) values: Arc<[f64]>,
}

impl InputTable {
    /// Returns the table with all values multiplied by a factor.
    pub(crate) fn times(self, factor: f64) -> Self {
        if factor == 1.0 {
            return self;
        }
        Self { values: self.values.iter().map(|value| factor * value).collect(), ..self }
    }

    /// Returns the table with 0 and 1 swapped.
    pub(crate) fn flipped(self) -> Self {
        Self { values: self.values.iter().map(|value| 1.0 - value).collect(), ..self }
    }

    /// Appends the times at which the piecewise linear function jumps or changes its slope.
    pub(crate) fn linear_stops(&self, time_tolerance: f64, stops: &mut Vec<InputStop>) {
        let (times, values) = (&self.times, &self.values);
        // Slope before the current row and its rounding error. The value is held before the first row.
        let mut slope = (0.0, 0.0);
        let mut row = 0;
        while row < times.len() {
            let time = times[row];
            let mut last = row;
            while last + 1 < times.len() && times[last + 1] - time <= time_tolerance {
                last += 1;
            }
            let next = if last + 1 < times.len() {
                let dt = times[last + 1] - times[last];
                let (a, b) = (values[last], values[last + 1]);
                ((b - a) / dt, f64::EPSILON * (a.abs() + b.abs() + (b - a).abs() * (time.abs() / dt)) / dt)
            } else {
                (0.0, 0.0)
            };
            let jump = values[row..=last].iter().any(|v| *v != values[row]);
            let kink = (next.0 - slope.0).abs() > 4.0 * (next.1 + slope.1);
            if jump || kink {
                stops.push(InputStop { time: times[last], jump });
            }
            slope = next;
            row = last + 1;
        }
    }

    /// Returns the times of the rows whose value differs from the previous row.
    pub(crate) fn changes(&self) -> impl Iterator<Item = f64> + '_ {
        let rows = self.values.windows(2).zip(&self.times[1..]);
        rows.filter(|(pair, _)| pair[0] != pair[1]).map(|(_, time)| *time)
    }

    /// Appends the times at which the held value changes.
    pub(crate) fn held_stops(&self, stops: &mut Vec<InputStop>) {
        stops.extend(self.changes().map(|time| InputStop { time, jump: true }));
    }

    /// Moves rows that are within `time_tolerance` of one of the instants to that instant.
    pub(crate) fn snap(&mut self, instants: &[f64], time_tolerance: f64) {
        let target = |time: f64| {
            let at = instants.partition_point(|instant| *instant < time - time_tolerance);
            instants
                .get(at)
                .copied()
                .filter(|instant| (instant - time).abs() <= time_tolerance)
                .unwrap_or(time)
        };
        if self.times.iter().any(|time| target(*time) != *time) {
            self.times = self.times.iter().map(|time| target(*time)).collect();
        }
    }

    /// Returns the value of the linear interpolant at `t`, or its limit from the left if `left` is true.
    /// `cursor` caches the row index.
    pub(crate) fn linear(&self, t: f64, left: bool, cursor: &mut usize) -> f64 {
        let (times, values) = (&*self.times, &*self.values);
        let passed = |row: f64| if left { row < t } else { row <= t };
        let fits = |k: usize| (k == 0 || passed(times[k - 1])) && (k == times.len() || !passed(times[k]));
        let mut k = *cursor;
        if !fits(k) {
            k = if k < times.len() && fits(k + 1) {
                k + 1
            } else {
                times.partition_point(|row| passed(*row))
            };
            *cursor = k;
        }
        if k == 0 {
            return values[0];
        }
        let (t0, v0) = (times[k - 1], values[k - 1]);
        match (times.get(k), values.get(k)) {
            (Some(&t1), Some(&v1)) if t < t1 => v0 + (v1 - v0) * ((t - t0) / (t1 - t0)),
            (Some(_), Some(&v1)) => v1,
            _ => v0,
        }
    }

    /// Returns the value that is held from `t` onward.
    pub(crate) fn held(&self, t: f64) -> f64 {
        let rows = self.times.partition_point(|row| *row <= t);
        self.values[rows.max(1) - 1]
    }
}

/// Column that is held between rows, for inputs of any type.
#[derive(Debug, Clone)]
pub(crate) struct HeldTable {
    /// Values. If a double cannot represent the values, these are indices into `words`.
    pub(crate) column: InputTable,
    words: Option<Arc<[i64]>>,
}

impl From<InputTable> for HeldTable {
    fn from(column: InputTable) -> Self {
        Self { column, words: None }
    }
}

impl HeldTable {
    /// Creates a column from words, one for each time.
    pub(crate) fn of_words(times: &Arc<[f64]>, words: &[i64]) -> Self {
        let mut numbers: HashMap<i64, f64> = HashMap::new();
        let mut distinct: Vec<i64> = Vec::new();
        let values = words.iter().map(|word| {
            *numbers.entry(*word).or_insert_with(|| {
                distinct.push(*word);
                (distinct.len() - 1) as f64
            })
        });
        let column = InputTable { values: values.collect(), times: Arc::clone(times) };
        Self { column, words: Some(distinct.into()) }
    }

    /// Returns the column with opposite values, for a variable of this kind.
    pub(crate) fn negated(self, kind: VariableKind) -> Self {
        let Self { column, words } = self;
        match (words, kind) {
            (Some(words), _) => {
                Self { column, words: Some(words.iter().map(|word| word.wrapping_neg()).collect()) }
            }
            (None, VariableKind::Boolean) => column.flipped().into(),
            (None, _) => column.times(-1.0).into(),
        }
    }

    /// Returns the word that is held from `t` onward, for a variable of this kind.
    pub(crate) fn word(&self, kind: VariableKind, t: f64) -> i64 {
        let value = self.column.held(t);
        let word = match &self.words {
            Some(words) => words.get(value as usize).copied(),
            None => integer_codec::word_of_number(kind, value),
        };
        word.unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(times: &[f64], values: &[f64]) -> InputTable {
        InputTable { times: times.into(), values: values.into() }
    }

    fn stops_of(column: &InputTable) -> Vec<(f64, bool)> {
        let mut stops = Vec::new();
        column.linear_stops(1e-14, &mut stops);
        stops.into_iter().map(|stop| (stop.time, stop.jump)).collect()
    }

    #[test]
    fn linear_interpolates_between_rows_and_holds_outside() {
        let c = column(&[1.0, 2.0, 4.0], &[10.0, 20.0, 0.0]);
        let mut cursor = 0;
        for (t, value) in
            [(0.0, 10.0), (1.0, 10.0), (1.5, 15.0), (3.0, 10.0), (4.0, 0.0), (9.0, 0.0), (1.25, 12.5)]
        {
            assert_eq!(c.linear(t, false, &mut cursor), value, "t = {t}");
            assert_eq!(c.linear(t, true, &mut cursor), value, "t = {t}");
        }
    }

    #[test]
    fn linear_returns_both_limits_of_a_time_listed_twice() {
        let c = column(&[0.0, 1.0, 1.0, 2.0], &[0.0, 1.0, 5.0, 5.0]);
        let mut cursor = 0;
        assert_eq!(c.linear(1.0, true, &mut cursor), 1.0);
        assert_eq!(c.linear(1.0, false, &mut cursor), 5.0);
        assert_eq!(stops_of(&c), [(0.0, false), (1.0, true)]);
    }

    #[test]
    fn linear_stops_reports_only_changes_of_slope() {
        let times: Vec<f64> = (0..100).map(|k| 0.1 * f64::from(k)).collect();
        let ramp: Vec<f64> = times.iter().map(|t| 3.0 - 0.7 * t).collect();
        assert_eq!(stops_of(&column(&times, &ramp)), [(0.0, false), (times[99], false)]);
        let bent: Vec<f64> = times.iter().map(|t| (t - 5.0).max(0.0)).collect();
        assert_eq!(stops_of(&column(&times, &bent)), [(times[50], false), (times[99], false)]);
    }
}
