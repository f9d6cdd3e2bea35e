//! Which column of a table holds the times, and in which unit.

type Unit = (&'static [&'static str], &'static [&'static str], (f64, f64));

/// Units of time: symbols, which are compared exactly (S is siemens, M is mega), words, which are compared without regard to
/// case, and the length in s as a fraction of two whole numbers: dividing by a thousand has no rounding error beyond its own.
const UNITS: [Unit; 7] = [
    (&["s"], &["sec", "second", "seconds"], (1.0, 1.0)),
    (&["ms"], &["msec", "millisecond", "milliseconds"], (1.0, 1e3)),
    // both letters that look like a Greek mu
    (&["us", "\u{b5}s", "\u{3bc}s"], &["microsecond", "microseconds"], (1.0, 1e6)),
    (&["ns"], &["nanosecond", "nanoseconds"], (1.0, 1e9)),
    (&["min"], &["minute", "minutes"], (60.0, 1.0)),
    (&["h"], &["hr", "hour", "hours"], (3600.0, 1.0)),
    (&["d"], &["day", "days"], (86400.0, 1.0)),
];

/// Names beyond these are counted only.
const MOST_LISTED: usize = 20;

/// The column that holds the times, and their unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeColumn {
    /// Position among the columns.
    pub index: usize,
    /// Length of its unit in s: numerator and denominator.
    pub unit: (f64, f64),
}

impl TimeColumn {
    /// Finds it by name: the one that is called `named`, or, where nothing is named, `time` in any case. A unit may follow
    /// in brackets or parentheses: `time [ms]`, `Time (min)`.
    ///
    /// # Errors
    /// There is none, there are several, or its unit is unknown; the message lists the columns.
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
            // What the user names in full is meant, whatever else there is.
            let whole = found(&|name| name == wanted);
            candidates = if whole.is_empty() { candidates } else { whole };
        }
        match candidates[..] {
            [(index, name)] => Ok(Self { index, unit: unit(name)? }),
            [] if named.is_some() => {
                Err(format!("there is no column '{wanted}'; there are: {}", listed(names)))
            }
            [] => Err(format!(
                "there is no column 'time'; there are: {}. Name the one that holds the times (time=\"...\"), or call it \
                 'time'; a unit may follow, as in 'time [ms]'",
                listed(names)
            )),
            _ => {
                let several = listed(candidates.iter().map(|(_, name)| *name));
                Err(format!(
                    "several columns could hold the times: {several}; name one of them (time=\"...\")"
                ))
            }
        }
    }

    /// A time of the column in s.
    pub fn seconds(&self, time: f64) -> f64 {
        time * self.unit.0 / self.unit.1
    }
}

/// Name and unit of a column: what stands in brackets or parentheses at its end.
pub(crate) fn parts(name: &str) -> (&str, Option<&str>) {
    let name = name.trim();
    let pair = [('[', ']'), ('(', ')')].into_iter().find(|(_, close)| name.ends_with(*close));
    let Some((stem, rest)) = pair.and_then(|(open, _)| name.rsplit_once(open)) else { return (name, None) };
    let unit = &rest[..rest.len() - 1];
    (stem.trim_end(), Some(unit.trim()))
}

fn unit(name: &str) -> Result<(f64, f64), String> {
    let Some(given) = parts(name).1 else { return Ok((1.0, 1.0)) };
    let is_it = |(symbols, words, _): &&Unit| {
        symbols.contains(&given) || words.contains(&given.to_lowercase().as_str())
    };
    UNITS.iter().find(is_it).map(|(_, _, length)| *length).ok_or_else(|| {
        let case = given.to_lowercase();
        let is_known = UNITS.iter().any(|(symbols, _, _)| symbols.contains(&case.as_str()));
        let hint = if is_known { format!("; units are case-sensitive: '{case}'?") } else { String::new() };
        format!("column '{name}': the unit '{given}' is none of s, ms, us, ns, min, h, d{hint}")
    })
}

/// Names in quotes, not too many of them.
pub(crate) fn listed<'a>(names: impl Iterator<Item = &'a str> + Clone) -> String {
    let shown = names.clone().take(MOST_LISTED).map(|n| format!("'{n}'")).collect::<Vec<_>>().join(", ");
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
    fn the_column_is_called_time_or_is_named() {
        assert_eq!(find(&["y", "TIME"], None), Ok((1, 3.0)));
        assert_eq!(find(&["y", "Time", "time"], Some("time")), Ok((2, 3.0)));
        assert_eq!(find(&["time", "t"], Some("t")), Ok((1, 3.0)));
        assert_eq!(find(&["time", "t [ms]"], Some("t")), Ok((1, 3.0 / 1e3)));
        assert_eq!(find(&["t [h]"], Some("t [h]")), Ok((0, 3.0 * 3600.0)));
        for (names, named, expected) in [
            (&["", "phi"][..], None, "there is no column 'time'; there are: '', 'phi'. Name"),
            (&["time", "y"], Some("t"), "there is no column 't'; there are: 'time', 'y'"),
            (&["Time", "TIME"], None, "several columns could hold the times: 'Time', 'TIME'"),
            (&["time", "Time [ms]"], None, "several columns could hold the times: 'time', 'Time [ms]'"),
            (&["time [furlong]"], None, "the unit 'furlong' is none of s, ms"),
            (
                &["time [MS]"],
                None,
                "the unit 'MS' is none of s, ms, us, ns, min, h, d; units are case-sensitive: 'ms'?",
            ),
            (&["time (S)"], None, "the unit 'S' is none of"),
        ] {
            let message = find(names, named).unwrap_err();
            assert!(message.contains(expected), "{message}");
        }
        let many: Vec<String> = (0..150).map(|k| format!("c{k}")).collect();
        let message = find(&many.iter().map(String::as_str).collect::<Vec<_>>(), None).unwrap_err();
        assert!(message.contains("'c19' and 130 more"), "{message}");
    }

    #[test]
    fn units_are_converted() {
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
}
