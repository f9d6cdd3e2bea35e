//! Conversion of dates and times of day to times in s since the first one.

use base::RunContext;
use jiff::Timestamp;
use jiff::civil::{Date, DateTime, Time};
use jiff::fmt::strtime;

use super::clock_change::{ClockChange, clock_change};
use super::time_column::PairUnit;
use crate::findings::display_text::shortened;

/// Number of cells between two checks for cancellation.
const CELLS_PER_LOOK: usize = 4096;

/// Formats in addition to ISO 8601. Text after the seconds is their fraction. MATLAB writes `31-May-2024`.
const DATES: [&str; 8] = [
    "%d.%m.%Y %H:%M:%S%.f",
    "%d.%m.%Y %H:%M",
    "%d.%m.%Y",
    "%Y/%m/%d %H:%M:%S%.f",
    "%Y/%m/%d %H:%M",
    "%d-%b-%Y %H:%M:%S%.f",
    "%d-%b-%Y %H:%M",
    "%d-%b-%Y",
];
const TIME_OF_DAY: &str = "%H:%M:%S%.f";
const NANOSECONDS_PER_DAY: i128 = 86_400_000_000_000;

/// Returns minutes and seconds if one of the first numbers is not an hour of a day or a cell has a fraction.
/// Returns `None` if the cells are ambiguous.
fn pair_of(cells: &[impl AsRef<str>]) -> Option<PairUnit> {
    let cells = || cells.iter().map(AsRef::as_ref);
    let first = |cell: &str| cell.trim().split_once(':').and_then(|(first, _)| first.parse::<u32>().ok());
    let is_no_hour = cells().filter_map(first).any(|first| first > 23);
    (is_no_hour || cells().any(|cell| cell.contains(['.', ',']))).then_some(PairUnit::MinutesSeconds)
}

/// Notation of the times of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// Instant with a time zone.
    Instant,
    /// Date without a time zone; days have 24 h.
    Date,
    TimeOfDay,
    /// Days and a time after them, as pandas writes a duration. The only form that does not count from the
    /// first cell.
    Duration,
    /// Two numbers with a colon between them: hours and minutes, or minutes and seconds.
    Pair,
}

/// Reason why the times cannot be converted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DateError {
    /// Index of an invalid cell, counted from 0, and the problem.
    Cell(usize, String),
    /// The conversion was cancelled.
    Cancelled,
}

/// Returns the times in s since the first one, or durations in s. Also returns a missing hour in times
/// without a zone. All cells must have the format of the first one: a date, a date with a zone, a time of
/// day, or a duration. `pair` specifies the meaning of two numbers (`10:02`). Without `pair`, they are
/// minutes and seconds if they cannot be anything else. The context can end the conversion.
///
/// # Errors
/// Returns the index of an invalid cell and the problem. Two numbers that may be hours and minutes or minutes
/// and seconds are an error, and so is a doubled hour. Also returns [`DateError::Cancelled`].
pub fn date_seconds(
    cells: &[impl AsRef<str>],
    pair: Option<PairUnit>,
    context: &RunContext<'_>,
) -> Result<(Vec<f64>, Option<ClockChange>), DateError> {
    let mut first = None;
    let pair = pair.or_else(|| pair_of(cells));
    let mut seconds = Vec::with_capacity(cells.len());
    for (row, cell) in cells.iter().map(AsRef::as_ref).enumerate() {
        if row % CELLS_PER_LOOK == 0 && context.is_over() {
            return Err(DateError::Cancelled);
        }
        let (form, nanoseconds) = parse(cell, pair).ok_or_else(|| DateError::Cell(row, complaint(cell)))?;
        let start = if form == Form::Duration { 0 } else { nanoseconds };
        let (first_form, start) = *first.get_or_insert((form, start));
        let shown = shortened(cell);
        if form != first_form {
            let other = shortened(cells[0].as_ref());
            return Err(DateError::Cell(
                row,
                format!("'{shown}' has a different format from the first date, '{other}'"),
            ));
        }
        if form == Form::Pair && pair.is_none() {
            let text = format!(
                "'{shown}' may be hours and minutes or minutes and seconds. Name the column 'time [hh:mm]' or 'time [mm:ss]'"
            );
            return Err(DateError::Cell(row, text));
        }
        // Subtract integers so that equal spacing stays exact.
        seconds.push((nanoseconds - start) as f64 / 1e9);
    }
    let change = match first {
        Some((Form::Date, start)) => clock_change(start as f64 / 1e9, &seconds)
            .map_err(|(row, change)| DateError::Cell(row, change.to_string()))?,
        _ => None,
    };
    Ok((seconds, change))
}

fn parse(cell: &str, pair: Option<PairUnit>) -> Option<(Form, i128)> {
    let cell = cell.trim().replace(',', ".");
    if has_leap_second(&cell) {
        return None;
    }
    if let Ok(instant) = cell.parse::<Timestamp>() {
        return Some((Form::Instant, instant.as_nanosecond()));
    }
    let iso = || cell.parse::<DateTime>().ok();
    let other = || {
        DATES.iter().find_map(|format| {
            let parsed = strtime::parse(format, &cell).ok()?;
            parsed.to_datetime().ok().or_else(|| parsed.to_date().ok().map(DateTime::from))
        })
    };
    // Digits alone are a number, not a date.
    if cell.contains(['-', ':', '.', '/'])
        && let Some(date) = iso().or_else(other)
    {
        return Some((Form::Date, nanoseconds(date)?));
    }
    if let Some(duration) = duration(&cell) {
        return Some((Form::Duration, duration));
    }
    match Time::strptime(TIME_OF_DAY, &cell) {
        Ok(time) => Some((Form::TimeOfDay, of_day(time)?)),
        Err(_) => Some((Form::Pair, two_numbers(&cell, pair)?)),
    }
}

/// True if the cell contains a duration, which has no date.
pub(super) fn is_duration(cell: &str) -> bool {
    duration(&cell.trim().replace(',', ".")).is_some()
}

/// Converts a duration as pandas writes it, `1 days 02:03:04.5` or `1 days`, to nanoseconds. The time counts
/// forwards after negative days, too: `-1 days +23:59:59` is -1 s. Other tools count it backwards, so
/// negative days require the sign.
fn duration(cell: &str) -> Option<i128> {
    let (days, rest) = cell.split_once(" day")?;
    let is_negative = days.starts_with('-');
    let days = i128::from(days.parse::<i32>().ok()?);
    let rest = rest.strip_prefix('s').unwrap_or(rest);
    let after = match rest.strip_prefix(' ') {
        Some(time) => match time.strip_prefix('+') {
            Some(time) => of_day(Time::strptime(TIME_OF_DAY, time).ok()?)?,
            None if is_negative => return None,
            None => of_day(Time::strptime(TIME_OF_DAY, time).ok()?)?,
        },
        None if rest.is_empty() => 0,
        None => return None,
    };
    Some(days * NANOSECONDS_PER_DAY + after)
}

/// True if the second of a time is 60, with or without colons. The parsers read it as 59, and times without
/// leap seconds cannot contain it.
fn has_leap_second(cell: &str) -> bool {
    cell.match_indices("60").any(|(at, _)| {
        let (before, after) = (&cell.as_bytes()[..at], &cell.as_bytes()[at + 2..]);
        let is_digit = |byte: &u8| byte.is_ascii_digit();
        let is_compact = before.len() > 4
            && before[before.len() - 4..].iter().all(is_digit)
            && matches!(before[before.len() - 5], b'T' | b't' | b' ');
        !after.first().is_some_and(is_digit) && (before.ends_with(b":") || is_compact)
    })
}

/// Returns the time since midnight in nanoseconds.
fn of_day(time: Time) -> Option<i128> {
    nanoseconds(DateTime::from_parts(Date::constant(1970, 1, 1), time))
}

/// Converts `12:34` or `12:34.5` to nanoseconds.
fn two_numbers(cell: &str, pair: Option<PairUnit>) -> Option<i128> {
    let (first, second) = cell.split_once(':')?;
    let is_plain = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    let (whole, fraction) = second.split_once('.').unwrap_or((second, "0"));
    let are_plain =
        is_plain(first) && first.len() <= 6 && is_plain(whole) && whole.len() == 2 && is_plain(fraction);
    let (first, second): (i128, i128) = (first.parse().ok().filter(|_| are_plain)?, whole.parse().ok()?);
    let fraction: i128 = format!("{fraction:0<9}").get(..9)?.parse().ok()?;
    let unit: i128 = match pair {
        Some(PairUnit::MinutesSeconds) => 1,
        Some(PairUnit::HoursMinutes) if first > 23 || fraction != 0 => return None,
        _ => 60,
    };
    (second < 60).then(|| ((60 * first + second) * unit) * 1_000_000_000 + fraction * unit)
}

fn nanoseconds(date: DateTime) -> Option<i128> {
    date.to_zoned(jiff::tz::TimeZone::UTC).ok().map(|zoned| zoned.timestamp().as_nanosecond())
}

/// True if the cell begins with a number, a hyphen and a letter, such as `31-Mai-2024`.
fn has_named_month(cell: &str) -> bool {
    let is_day = |text: &str| text.trim().parse::<u8>().is_ok();
    cell.split_once('-').is_some_and(|(day, rest)| is_day(day) && rest.starts_with(char::is_alphabetic))
}

fn complaint(cell: &str) -> String {
    let hint = if has_leap_second(cell) {
        " (seconds go from 0 to 59; remove rows with a leap second)"
    } else if cell.trim_start().starts_with('-') && cell.contains(" day") {
        " (after negative days, pandas writes the sign of the time, which counts forwards: -1 days +23:59:48 is -12 s)"
    } else if cell.matches('/').count() == 2 {
        " (day and month are ambiguous)"
    } else if cell.to_lowercase().ends_with('m') && cell.contains(':') {
        " (write hours from 0 to 23)"
    } else if has_named_month(cell) {
        " (expected a date such as 31-May-2024 13:45:10)"
    } else {
        ""
    };
    format!(
        "'{}' is neither a number nor a date{hint}. Write dates as 2024-05-31T13:45:10.5 or 31.05.2024 13:45:10.5, and times of day \
         as 13:45:10.5",
        shortened(cell)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(cells: &[&str]) -> Result<Vec<f64>, (usize, String)> {
        with_pair(cells, None)
    }

    fn with_pair(cells: &[&str], pair: Option<PairUnit>) -> Result<Vec<f64>, (usize, String)> {
        match date_seconds(cells, pair, &RunContext::new()) {
            Ok((seconds, _)) => Ok(seconds),
            Err(DateError::Cell(row, message)) => Err((row, message)),
            Err(DateError::Cancelled) => unreachable!("nothing cancels"),
        }
    }

    #[test]
    fn date_seconds_counts_from_the_first_cell() {
        for cells in [
            ["2024-05-31T23:59:59", "2024-05-31T23:59:59.5", "2024-06-01T00:00:01"],
            ["2024-05-31 23:59:59", "2024-05-31 23:59:59.500", "2024-06-01 00:00:01.0"],
            ["2024-05-31T23:59:59Z", "2024-05-31T23:59:59.5Z", "2024-06-01T02:00:01+02:00"],
            ["31.05.2024 23:59:59", "31.05.2024 23:59:59,5", "01.06.2024 00:00:01"],
            ["2024/05/31 23:59:59", "2024/05/31 23:59:59.5", "2024/06/01 00:00:01"],
            ["31-May-2024 23:59:59", "31-May-2024 23:59:59.500", "01-Jun-2024 00:00:01"],
            ["0 days 00:00:00", "0 days 00:00:00.500000", "0 days 00:00:02"],
            ["10:00:59", "10:00:59.5", "10:01:01"],
        ] {
            assert_eq!(of(&cells).unwrap(), [0.0, 0.5, 2.0], "{cells:?}");
        }
        assert_eq!(of(&["2024-02-28", "2024-03-01"]).unwrap(), [0.0, 2.0 * 86400.0]);
        let pair = |name| with_pair(&["10:00", "10:02"], PairUnit::named(name));
        assert_eq!((pair("hh:mm").unwrap(), pair("mm:ss").unwrap()), (vec![0.0, 120.0], vec![0.0, 2.0]));
        assert!(pair("").unwrap_err().1.contains("'time [hh:mm]' or 'time [mm:ss]'"));
        assert_eq!(of(&["22:58", "23:59", "25:00"]).unwrap(), [0.0, 61.0, 122.0]);
        assert_eq!(of(&["00:00.0", "00:00.5", "01:00.0"]).unwrap(), [0.0, 0.5, 60.0]);
        assert_eq!(with_pair(&["10:00", "24:00"], PairUnit::named("hh:mm")).unwrap_err().0, 1);
        assert_eq!(of(&["31.05.2024 10:00", "31.05.2024 10:02"]).unwrap(), [0.0, 120.0]);
        assert_eq!(of(&["31-May-2024 10:00", "31-May-2024 10:02"]).unwrap(), [0.0, 120.0]);
        assert_eq!(of(&["28-Feb-2024", "01-mar-2024"]).unwrap(), [0.0, 2.0 * 86400.0]);
        // Durations do not count from the first one.
        let durations = of(&["-1 days +23:59:59.5", "0 days 00:00:02", "1 day", "2 days 00:00:01"]).unwrap();
        assert_eq!(durations, [-0.5, 2.0, 86400.0, 2.0 * 86400.0 + 1.0]);
        assert!(is_duration("3 days 00:00:01") && !is_duration("2024-05-31 00:00:01"));
        let tenths = of(&["10:00:00.0", "10:00:00.1", "10:00:00.2", "10:00:00.3"]).unwrap();
        assert_eq!(tenths, [0.0, 0.1, 0.2, 0.3]);
    }

    #[test]
    fn date_seconds_reports_a_clock_change() {
        let days = |hours: [&str; 5]| hours.map(|hour| format!("2024-10-27 {hour}"));
        let found = |cells: &[String]| date_seconds(cells, None, &RunContext::new());
        let (times, change) = found(&days(["01:00", "01:30", "03:00", "03:30", "04:00"])).unwrap();
        assert_eq!(times, [0.0, 1800.0, 7200.0, 9000.0, 10800.0]);
        assert_eq!(change.unwrap().from, "2024-10-27T01:30:00");
        let doubled = found(&days(["02:00", "02:30", "02:00", "02:30", "03:00"])).unwrap_err();
        let DateError::Cell(2, message) = doubled else { panic!("{doubled:?}") };
        assert!(message.contains("an hour is doubled") && message.contains("02:00:00+02:00"), "{message}");
        // No change is assumed for times with a zone.
        let zoned: Vec<String> = days(["01:00", "01:30", "03:00", "03:30", "04:00"]).map(|t| t + "Z").into();
        assert_eq!(found(&zoned).unwrap().1, None);
        assert_eq!(
            date_seconds(&zoned, None, &RunContext::new().polling(&|| true)),
            Err(DateError::Cancelled)
        );
    }

    #[test]
    fn date_seconds_reports_invalid_cells() {
        for (cells, expected) in [
            (&["2024-05-31", "soon"][..], (1, "'soon' is neither a number nor a date. Write dates")),
            (&["05/31/2024 10:00:00"], (0, "day and month are ambiguous")),
            (&["10:00:00 PM"], (0, "hours from 0 to 23")),
            (&["2024-13-31"], (0, "neither")),
            (&["31-Mai-2024 10:00:00"], (0, "expected a date such as 31-May-2024")),
            (&["1 days 25:00:00"], (0, "neither")),
            (&["1 days10:00:00"], (0, "neither")),
            (&["-0 days 00:00:12"], (0, "-1 days +23:59:48 is -12 s")),
            (&["-1 days 23:59:48"], (0, "-1 days +23:59:48 is -12 s")),
            (&["2016-12-31T23:59:59Z", "2016-12-31T23:59:60Z"], (1, "seconds go from 0 to 59")),
            (&["2024-05-31 10:00:60"], (0, "seconds go from 0 to 59")),
            (&["20240531T100060"], (0, "seconds go from 0 to 59")),
            (&["31.05.2024 10:00:60.5"], (0, "seconds go from 0 to 59")),
            (&["31-May-2024 10:00:60"], (0, "seconds go from 0 to 59")),
            (&["10:00:60"], (0, "seconds go from 0 to 59")),
            (&["0 days 00:00:60"], (0, "seconds go from 0 to 59")),
            (
                &["0 days 00:00:00", "00:00:01"],
                (1, "a different format from the first date, '0 days 00:00:00'"),
            ),
            (
                &["2024-05-31", "10:00:00"],
                (1, "'10:00:00' has a different format from the first date, '2024-05-31'"),
            ),
        ] {
            let (row, message) = of(cells).unwrap_err();
            assert_eq!(row, expected.0);
            assert!(message.contains(expected.1), "{message}");
        }
        assert!(["5", "1.5", "20240531", ""].iter().all(|cell| of(&[cell]).is_err()));
    }
}
