//! Selection of the time column of a table, and its unit.

use super::units::{Unit, UnitConversion, UnitError};
use crate::findings::display_text::shortened;
use fmi::ModelDescription;
use serde::{Deserialize, Serialize};

/// Maximum number of names in a message. Further names are only counted.
pub(crate) const MOST_LISTED: usize = 20;

/// Time column and its unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeColumn {
    /// Index of the column.
    pub index: usize,
    /// Length of the unit in s, as numerator and denominator; `None` if no unit is stated.
    pub unit: Option<(f64, f64)>,
}

/// Unit in which times count.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct TimeUnit {
    pub(crate) name: String,
    /// Length in s, as numerator and denominator; `None` if it is not a unit of time.
    pub(crate) length: Option<(f64, f64)>,
}

impl TimeUnit {
    /// Returns the second.
    pub(crate) fn second() -> Self {
        Self { name: SECOND.to_owned(), length: Some((1.0, 1.0)) }
    }

    /// Returns the unit in which a model counts its time. Definitions of the model take precedence.
    pub(crate) fn of_model(description: &ModelDescription) -> Self {
        Self::named(description.time_unit(), description)
    }

    /// Returns the unit with this name.
    pub(crate) fn named(name: &str, description: &ModelDescription) -> Self {
        let defined = description.units.iter().find(|unit| unit.name == name).and_then(|unit| unit.base);
        let unit = defined.map_or_else(|| Unit::parse(name).ok(), |base| Unit::defined(&base));
        Self { name: name.to_owned(), length: unit.and_then(|unit| unit.time_factor()) }
    }

    /// Returns the conversion from another unit of time, if both are units of time.
    pub(crate) fn conversion_from(&self, other: &str) -> Option<UnitConversion> {
        let ((n, d), (own_n, own_d)) = (Unit::parse(other).ok()?.time_factor()?, self.length?);
        let factor = (n * own_d, d * own_n);
        Some(if factor.0 == factor.1 {
            UnitConversion::IDENTITY
        } else {
            UnitConversion { factor, offset: 0.0 }
        })
    }
}

/// Unit of times if nothing else is stated.
pub(crate) const SECOND: &str = "s";

impl TimeColumn {
    /// Finds the time column by name. It is the column `named`, or `time` (in upper or lower case) if no name
    /// is given. A unit may follow in brackets or parentheses: `time [ms]`, `Time (min)`.
    ///
    /// # Errors
    /// Returns an error if there is no or more than one such column, or its unit is unknown. The message
    /// lists the columns.
    pub fn find<'a>(
        names: impl Iterator<Item = &'a str> + Clone,
        named: Option<&str>,
    ) -> Result<Self, String> {
        let wanted = named.unwrap_or("time");
        let is_stem = |name: &str| match named {
            Some(named) => parts(name).0 == named,
            None => parts(name).0.eq_ignore_ascii_case(wanted),
        };
        let found = |is: &dyn Fn(&str) -> bool| {
            names.clone().enumerate().filter(|(_, name)| is(name)).collect::<Vec<_>>()
        };
        let mut candidates = found(&is_stem);
        if named.is_some() {
            // An exact match of the full name takes precedence.
            let whole = found(&|name| name == wanted);
            candidates = if whole.is_empty() { candidates } else { whole };
        }
        match candidates[..] {
            [(index, name)] => Ok(Self { index, unit: unit(name)? }),
            [] if named.is_some() => {
                Err(format!("column '{wanted}' not found; available: {}", listed(names)))
            }
            [] if names.clone().next().is_some_and(|first| first.trim().is_empty()) => Err(format!(
                "column 'time' not found; the first column has no name, as the index of a pandas table, and the others are {}. If it \
                 contains the times, write index_label=\"time\" in to_csv, or name the column 'time' in the file",
                listed(names.skip(1))
            )),
            [] => Err(format!(
                "column 'time' not found; available: {}. Specify the column of the times (time=\"...\"), or rename it to 'time' or \
                 'time [ms]'",
                listed(names)
            )),
            _ => {
                let several = listed(candidates.iter().map(|(_, name)| *name));
                Err(format!(
                    "several columns may contain the times: {several}. Specify one of them (time=\"...\")"
                ))
            }
        }
    }

    /// Returns the factor that converts times of the column to the time unit of a model, as numerator and
    /// denominator. It is 1 if the column states no unit. Returns `None` if the unit of the model is not a
    /// unit of time.
    pub fn factor_for(&self, description: &ModelDescription) -> Option<(f64, f64)> {
        let Some((n, d)) = self.unit else { return Some((1.0, 1.0)) };
        let (model_n, model_d) = TimeUnit::of_model(description).length?;
        Some((n * model_d, d * model_n))
    }

    /// Converts a time of the column to s.
    pub fn seconds(&self, time: f64) -> f64 {
        self.unit.map_or(time, |(numerator, denominator)| time * numerator / denominator)
    }
}

/// Units of the two numbers in `00:01`, declared after the name of the column: `time [mm:ss]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PairUnit {
    /// Hours and minutes.
    HoursMinutes,
    /// Minutes and seconds.
    MinutesSeconds,
}

impl PairUnit {
    /// Returns the units for `hh:mm` or `mm:ss`, in upper or lower case.
    pub fn named(name: &str) -> Option<Self> {
        match name.to_lowercase().as_str() {
            "hh:mm" | "h:mm" => Some(Self::HoursMinutes),
            "mm:ss" | "m:ss" => Some(Self::MinutesSeconds),
            _ => None,
        }
    }

    /// Returns the units in brackets or parentheses after the name of a column.
    pub fn of_column(name: &str) -> Option<Self> {
        parts(name).1.and_then(Self::named)
    }
}

/// Splits the name of a column into name and unit, which is in brackets or parentheses at its end. Numbers
/// without a preceding space are indices (`x[1]`, `z(2)`) and belong to the name. Numbers after a space (`ch
/// (3)`) distinguish columns and are not units, except 1, the unit of pure numbers. `der(x)` is a derivative.
pub(crate) fn parts(name: &str) -> (&str, Option<&str>) {
    let name = name.trim();
    let Some(open) = opening(name) else { return (name, None) };
    let (stem, unit) = (&name[..open], name[open + 1..name.len() - 1].trim());
    let is_number = unit.chars().all(|c| c.is_ascii_digit() || matches!(c, ',' | ' ' | ':'));
    let is_apart = stem.ends_with(char::is_whitespace);
    if (is_number && !is_apart) || stem.is_empty() || stem == "der" {
        return (name, None);
    }
    (stem.trim_end(), (!is_number || unit == "1").then_some(unit))
}

/// Returns the position of the bracket or parenthesis that matches the one at the end of a name.
fn opening(name: &str) -> Option<usize> {
    let (open, close) = [('[', ']'), ('(', ')')].into_iter().find(|(_, close)| name.ends_with(*close))?;
    let mut depth = 0;
    name.char_indices().rev().find_map(|(at, c)| {
        depth += i32::from(c == close) - i32::from(c == open);
        (depth == 0).then_some(at)
    })
}

/// Returns the index of the column with this name, either in full or without the unit in brackets or
/// parentheses.
///
/// # Errors
/// Returns an error if there is no or more than one such column. The message lists the columns.
pub fn find_column<'a>(names: impl Iterator<Item = &'a str> + Clone, wanted: &str) -> Result<usize, String> {
    let found = |is: &dyn Fn(&str) -> bool| {
        names.clone().enumerate().filter(|(_, name)| is(name)).collect::<Vec<_>>()
    };
    let whole = found(&|name| name == wanted);
    let stems = if whole.is_empty() { found(&|name| parts(name).0 == wanted) } else { Vec::new() };
    match (&whole[..], &stems[..]) {
        ([(index, _)], _) | ([], [(index, _)]) => Ok(*index),
        ([], []) => {
            let cases = found(&|name| parts(name).0.eq_ignore_ascii_case(parts(wanted).0));
            let hint = match &cases[..] {
                [(_, name)] => format!(". Did you mean '{name}'?"),
                _ => String::new(),
            };
            Err(format!("column '{wanted}' not found; available: {}{hint}", listed(names)))
        }
        ([], several) => {
            let several = listed(several.iter().map(|(_, name)| *name));
            Err(format!(
                "several columns are named '{wanted}': {several}. Write the full name of one of them"
            ))
        }
        _ => Err(format!("two columns are named '{wanted}'")),
    }
}

/// Returns the length in s of the time unit in the name of a column, if it states one.
fn unit(name: &str) -> Result<Option<(f64, f64)>, String> {
    parts(name).1.map(|given| time_unit(name, given)).transpose()
}

/// Returns the length of a time unit in s.
pub(super) fn time_unit(name: &str, given: &str) -> Result<(f64, f64), String> {
    if PairUnit::named(given).is_some() {
        return Ok((1.0, 1.0));
    }
    let length = |unit: &str| Unit::parse(unit).ok().and_then(|unit| unit.time_factor());
    length(given).ok_or_else(|| {
        let case = given.to_lowercase();
        let differs_only_in_case = length(&case).is_some();
        let hint = if differs_only_in_case {
            format!(". Units are case-sensitive; did you mean '{case}'?")
        } else {
            String::new()
        };
        format!(
            "column '{name}': unit '{given}' is not a unit of time; expected s, ms, us, ns, min, h or d{hint}"
        )
    })
}

/// True if both names are known units and the units differ.
pub(super) fn is_contradiction(one: &str, other: &str) -> bool {
    match (PairUnit::named(one), PairUnit::named(other)) {
        (Some(one), Some(other)) => one != other,
        (None, None) if one.trim() != other.trim() => {
            let same = |conversion: UnitConversion| {
                let (numerator, denominator) = conversion.factor;
                (numerator / denominator - 1.0).abs() < 1e-9 && conversion.offset.abs() < 1e-9
            };
            match UnitConversion::between(one, other) {
                Ok(conversion) => !same(conversion),
                Err(error) => matches!(error, UnitError::Dimension { .. }),
            }
        }
        _ => false,
    }
}

/// Returns the quoted names, up to a maximum number.
pub(crate) fn listed<'a>(names: impl Iterator<Item = &'a str> + Clone) -> String {
    let shown =
        names.clone().take(MOST_LISTED).map(|n| format!("'{}'", shortened(n))).collect::<Vec<_>>().join(", ");
    match names.count().saturating_sub(MOST_LISTED) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn find(names: &[&str], named: Option<&str>) -> Result<(usize, f64), String> {
        TimeColumn::find(names.iter().copied(), named).map(|column| (column.index, column.seconds(3.0)))
    }

    #[test]
    fn time_column_is_found_by_default_or_given_name() {
        assert_eq!(find(&["y", "TIME"], None), Ok((1, 3.0)));
        assert_eq!(find(&["y", "Time", "time"], Some("time")), Ok((2, 3.0)));
        assert_eq!(find(&["time", "t"], Some("t")), Ok((1, 3.0)));
        assert_eq!(find(&["time", "t [ms]"], Some("t")), Ok((1, 3.0 / 1e3)));
        assert_eq!(find(&["t [h]"], Some("t [h]")), Ok((0, 3.0 * 3600.0)));
        for (names, named, expected) in [
            (
                &["", "phi"][..],
                None,
                "the first column has no name, as the index of a pandas table, and the others are 'phi'. If",
            ),
            (&["time", "y"], Some("t"), "column 't' not found; available: 'time', 'y'"),
            (&["Time", "TIME"], None, "several columns may contain the times: 'Time', 'TIME'"),
            (&["time", "Time [ms]"], None, "several columns may contain the times: 'time', 'Time [ms]'"),
            (&["time [furlong]"], None, "unit 'furlong' is not a unit of time; expected s, ms"),
            (
                &["time [MS]"],
                None,
                "unit 'MS' is not a unit of time; expected s, ms, us, ns, min, h or d. Units are case-sensitive; did you mean 'ms'?",
            ),
            (&["time (S)"], None, "unit 'S' is not a unit of time"),
        ] {
            let message = find(names, named).unwrap_err();
            assert!(message.contains(expected), "{message}");
        }
        let many: Vec<String> = (0..150).map(|k| format!("c{k}")).collect();
        let message = find(&many.iter().map(String::as_str).collect::<Vec<_>>(), None).unwrap_err();
        assert!(message.contains("'c19' and 130 more"), "{message}");
    }

    #[test]
    fn time_column_converts_units() {
        for (name, expected) in [
            ("time [s]", 3.0),
            ("Time(ms)", 3.0 / 1e3),
            ("time [us]", 3.0 / 1e6),
            ("time [\u{b5}s]", 3.0 / 1e6),
            ("TIME (min)", 180.0),
            ("time [ h ]", 10800.0),
            ("time (d)", 259_200.0),
            ("time [ns]", 3.0 / 1e9),
            ("time [Seconds]", 3.0),
            ("time [SEC]", 3.0),
        ] {
            assert_eq!(find(&[name], None), Ok((0, expected)), "{name}");
        }
    }

    #[test]
    fn column_name_splits_into_name_and_unit_or_index() {
        for (name, expected) in [
            ("phi [deg]", ("phi", Some("deg"))),
            ("phi[deg]", ("phi", Some("deg"))),
            ("T (degC)", ("T", Some("degC"))),
            ("c (J/(kg.K))", ("c", Some("J/(kg.K)"))),
            ("slip [1]", ("slip", Some("1"))),
            ("x[1]", ("x[1]", None)),
            ("x[1,2]", ("x[1,2]", None)),
            ("z(2)", ("z(2)", None)),
            ("z [2]", ("z", None)),
            ("ch (3)", ("ch", None)),
            ("x[1] [mm]", ("x[1]", Some("mm"))),
            ("der(x)", ("der(x)", None)),
            ("der(x) [m/s]", ("der(x)", Some("m/s"))),
            ("[m]", ("[m]", None)),
            ("x]", ("x]", None)),
        ] {
            assert_eq!(parts(name), expected, "{name}");
        }
        let names = ["time", "phi [deg]", "x", "x [mm]", "y [mm]", "y [m]"];
        let find = |wanted| find_column(names.into_iter(), wanted);
        assert_eq!((find("phi"), find("phi [deg]"), find("x")), (Ok(1), Ok(1), Ok(2)));
        assert!(find("y").unwrap_err().contains("several columns are named 'y': 'y [mm]', 'y [m]'"));
        assert!(find("Phi").unwrap_err().contains("Did you mean 'phi [deg]'?"));
    }
}
