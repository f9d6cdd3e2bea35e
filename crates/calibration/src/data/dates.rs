//! Dates and times of day as times in s since the first of them.

use jiff::Timestamp;
use jiff::civil::{Date, DateTime, Time};
use jiff::fmt::strtime;

/// Formats beside those of ISO 8601; what comes after the seconds is a fraction of them.
const DATES: [&str; 5] =
    ["%d.%m.%Y %H:%M:%S%.f", "%d.%m.%Y %H:%M", "%d.%m.%Y", "%Y/%m/%d %H:%M:%S%.f", "%Y/%m/%d %H:%M"];
const TIMES_OF_DAY: [&str; 2] = ["%H:%M:%S%.f", "%H:%M"];

/// How the times of a column are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// With a zone: an instant.
    Instant,
    /// Without: days have 24 h.
    Date,
    TimeOfDay,
}

/// The times in s since the first. All are written as the first is: as dates, dates with a zone, or times of day.
///
/// # Errors
/// The index of a cell that is none, and what is wrong with it.
pub fn date_seconds(cells: &[String]) -> Result<Vec<f64>, (usize, String)> {
    let mut first = None;
    cells
        .iter()
        .enumerate()
        .map(|(row, cell)| {
            let (form, nanoseconds) = parse(cell).ok_or_else(|| (row, complaint(cell)))?;
            let (known, start) = *first.get_or_insert((form, nanoseconds));
            if form != known {
                let text = format!("'{cell}' is not written like the first, '{}'", cells[0]);
                return Err((row, text));
            }
            // Whole numbers until here: times of equal distance stay so.
            Ok((nanoseconds - start) as f64 / 1e9)
        })
        .collect()
}

fn parse(cell: &str) -> Option<(Form, i128)> {
    let cell = cell.trim().replace(',', ".");
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
    // Digits alone are a number.
    if cell.contains(['-', ':', '.', '/'])
        && let Some(date) = iso().or_else(other)
    {
        return Some((Form::Date, nanoseconds(date)?));
    }
    let time = TIMES_OF_DAY.iter().find_map(|format| Time::strptime(format, &cell).ok())?;
    Some((Form::TimeOfDay, nanoseconds(DateTime::from_parts(Date::constant(1970, 1, 1), time))?))
}

fn nanoseconds(date: DateTime) -> Option<i128> {
    date.to_zoned(jiff::tz::TimeZone::UTC).ok().map(|zoned| zoned.timestamp().as_nanosecond())
}

fn complaint(cell: &str) -> String {
    let hint = if cell.matches('/').count() == 2 {
        " (which of them is the month cannot be told)"
    } else if cell.to_lowercase().ends_with('m') && cell.contains(':') {
        " (write hours from 0 to 23)"
    } else {
        ""
    };
    format!(
        "'{cell}' is neither a number nor a date{hint}: dates are written as 2024-05-31T13:45:10.5 or 31.05.2024 13:45:10.5, \
         times of day as 13:45:10.5"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(cells: &[&str]) -> Result<Vec<f64>, (usize, String)> {
        date_seconds(&cells.iter().map(|c| (*c).to_owned()).collect::<Vec<_>>())
    }

    #[test]
    fn times_count_from_the_first() {
        for cells in [
            ["2024-05-31T23:59:59", "2024-05-31T23:59:59.5", "2024-06-01T00:00:01"],
            ["2024-05-31 23:59:59", "2024-05-31 23:59:59.500", "2024-06-01 00:00:01.0"],
            ["2024-05-31T23:59:59Z", "2024-05-31T23:59:59.5Z", "2024-06-01T02:00:01+02:00"],
            ["31.05.2024 23:59:59", "31.05.2024 23:59:59,5", "01.06.2024 00:00:01"],
            ["2024/05/31 23:59:59", "2024/05/31 23:59:59.5", "2024/06/01 00:00:01"],
            ["10:00:59", "10:00:59.5", "10:01:01"],
        ] {
            assert_eq!(of(&cells).unwrap(), [0.0, 0.5, 2.0], "{cells:?}");
        }
        assert_eq!(of(&["2024-02-28", "2024-03-01"]).unwrap(), [0.0, 2.0 * 86400.0]);
        assert_eq!(of(&["10:00", "10:02"]).unwrap(), [0.0, 120.0]);
        assert_eq!(of(&["31.05.2024 10:00", "31.05.2024 10:02"]).unwrap(), [0.0, 120.0]);
        let tenths = of(&["10:00:00.0", "10:00:00.1", "10:00:00.2", "10:00:00.3"]).unwrap();
        assert_eq!(tenths, [0.0, 0.1, 0.2, 0.3]);
    }

    #[test]
    fn what_is_no_date_is_named() {
        for (cells, expected) in [
            (&["2024-05-31", "soon"][..], (1, "'soon' is neither a number nor a date: dates are")),
            (&["05/31/2024 10:00:00"], (0, "which of them is the month")),
            (&["10:00:00 PM"], (0, "hours from 0 to 23")),
            (&["2024-13-31"], (0, "neither")),
            (&["2024-05-31", "10:00:00"], (1, "'10:00:00' is not written like the first, '2024-05-31'")),
        ] {
            let (row, message) = of(cells).unwrap_err();
            assert_eq!(row, expected.0);
            assert!(message.contains(expected.1), "{message}");
        }
        assert!(["5", "1.5", "20240531", ""].iter().all(|cell| of(&[cell]).is_err()));
    }
}
