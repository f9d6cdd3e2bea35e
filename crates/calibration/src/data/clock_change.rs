//! Detection of a missing or doubled hour in times without a zone, due to daylight saving time.

use super::series::sampling_interval;
use jiff::Timestamp;
use jiff::tz::TimeZone;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Length of an hour in s.
const HOUR: f64 = 3600.0;

/// Length of a day in s.
pub(super) const DAY: f64 = 24.0 * HOUR;

/// Hours of a day at which the missing or doubled hour may begin.
const HOURS: std::ops::RangeInclusive<i64> = 0..=3;

/// Minimum time between two changes in the same direction, in s. Clocks change to summer time once a year.
const LEAST_APART: f64 = 200.0 * DAY;

/// Limits of the tolerance in s. The tolerance is half the sampling interval. It applies to the deviation of
/// a spacing from the sampling interval plus or minus an hour.
const TOLERANCE: (f64, f64) = (2.0, 300.0);

/// Probable change of the clock by an hour between two rows.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClockChange {
    /// Local time of the row before the change.
    pub from: String,
    /// Local time of the row after the change.
    pub to: String,
    /// True if an hour is doubled; false if it is missing.
    pub is_doubled: bool,
}

impl fmt::Display for ClockChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}. {}", self.symptom(), self.remedy())
    }
}

impl ClockChange {
    /// Returns the change of the clock as text.
    pub(crate) fn symptom(&self) -> String {
        let Self { from, to, is_doubled } = self;
        let (what, way) = if *is_doubled { ("is doubled", "from") } else { ("is missing", "to") };
        format!(
            "between {from} and {to} an hour {what}, as if the clock changes {way} summer time, and the times have no zone"
        )
    }

    /// Returns the remedy if the clock was changed.
    pub(crate) fn remedy(&self) -> String {
        let to = &self.to;
        format!("If the clock was changed, write the times with their offset ({to}+02:00) or in UTC ({to}Z)")
    }
}

/// Finds a missing or doubled hour in times in s without a zone. `start` is the first time in s since 1970.
/// One row spacing must be an hour longer or shorter than the sampling interval, in the first hours of a day.
///
/// # Errors
/// Returns the row whose time is before the previous row, because an hour is doubled.
pub fn clock_change(start: f64, times: &[f64]) -> Result<Option<ClockChange>, (usize, ClockChange)> {
    let Some(usual) = sampling_interval(times) else { return Ok(None) };
    let tolerance = (usual / 2.0).clamp(TOLERANCE.0, TOLERANCE.1);
    let change = |row: usize| {
        let excess = times[row] - times[row - 1] - usual;
        let is_doubled = excess < 0.0;
        // Range of full hours that the clock would pass without the change.
        let before = start + times[row - 1];
        let first = (before / HOUR).floor() as i64 + 1;
        let last = ((before + usual + tolerance) / HOUR).floor() as i64;
        let hour = |whole: i64| (whole - i64::from(is_doubled)).rem_euclid(24);
        let is_early = (first..=last.min(first + 23)).any(|whole| HOURS.contains(&hour(whole)));
        ((excess.abs() - HOUR).abs() <= tolerance && is_early).then(|| ClockChange {
            from: local(before),
            to: local(start + times[row]),
            is_doubled,
        })
    };
    let mut found = (1..times.len()).filter_map(|row| Some((row, change(row)?)));
    let mut first: Option<(usize, ClockChange)> = None;
    let mut last = f64::NEG_INFINITY;
    for (row, change) in &mut found {
        if times[row] < times[row - 1] {
            return Err((row, change));
        }
        // More frequent changes have another cause.
        if times[row] - last < LEAST_APART
            && first.as_ref().is_some_and(|(_, c)| c.is_doubled == change.is_doubled)
        {
            return Ok(None);
        }
        last = times[row];
        first.get_or_insert((row, change));
    }
    Ok(first.map(|(_, change)| change))
}

/// Returns a local time in s since 1970 in ISO 8601 format.
fn local(seconds: f64) -> String {
    let time = Timestamp::from_nanosecond((seconds * 1e9).round() as i128);
    time.map_or_else(|_| format!("{seconds} s"), |time| time.to_zoned(TimeZone::UTC).datetime().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns times from 2024-03-31T00:00:00, with a jump of the clock at a time of day.
    fn rows(interval: f64, jump: (f64, f64)) -> Vec<f64> {
        let all = (0..(6.0 * HOUR / interval) as u32).map(|k| interval * f64::from(k));
        all.map(|t| if t >= jump.0 { t + jump.1 } else { t }).collect()
    }

    /// 2024-03-31T00:00:00 in s since 1970.
    const START: f64 = 1_711_843_200.0;

    #[test]
    fn clock_change_finds_missing_and_doubled_hours() {
        for (interval, at) in [(60.0, 2.0), (1.0, 1.0), (900.0, 3.0), (3600.0, 2.0), (0.5, 2.0)] {
            let change = clock_change(START, &rows(interval, (at * HOUR, HOUR))).unwrap().unwrap();
            let to = format!("2024-03-31T{:02}:00:00", at + 1.0);
            assert_eq!((change.to.as_str(), change.is_doubled), (to.as_str(), false), "{interval}");
        }
        let (row, change) = clock_change(START, &rows(60.0, (3.0 * HOUR, -HOUR))).unwrap_err();
        assert_eq!((row, change.to.as_str(), change.is_doubled), (180, "2024-03-31T02:00:00", true));
        assert!(clock_change(START, &rows(HOUR, (3.0 * HOUR, -HOUR))).unwrap().unwrap().is_doubled);
    }

    #[test]
    fn clock_change_ignores_other_gaps() {
        for (interval, jump) in
            [(60.0, (4.5 * HOUR, HOUR)), (60.0, (5.0 * HOUR, HOUR)), (60.0, (2.0 * HOUR, 2.0 * HOUR))]
        {
            assert_eq!(clock_change(START, &rows(interval, jump)), Ok(None), "{jump:?}");
        }
        assert_eq!(clock_change(START, &rows(60.0, (2.0 * HOUR, 0.0))), Ok(None));
        // The jump occurs every night.
        let nights: Vec<f64> = (0..3)
            .flat_map(|day| rows(60.0, (2.0 * HOUR, HOUR)).into_iter().map(move |t| t + f64::from(day) * DAY))
            .collect();
        assert_eq!(clock_change(START, &nights), Ok(None));
        assert_eq!((clock_change(START, &[]), clock_change(START, &[0.0])), (Ok(None), Ok(None)));
    }
}
