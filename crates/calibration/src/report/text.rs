//! The summary of a fit as plain text.

use super::summary::{OutputRow, ParameterRow, Summary};
use crate::findings::display_text::visible_line;
use crate::findings::finding::table;
use crate::fit::one_stage::Fit;
use std::fmt::{self, Write};

/// Longest name; longer names are shortened in the middle, so that a row fits into one line.
const LONGEST: usize = 48;

impl fmt::Display for Fit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write(f, &Summary::new(self))
    }
}

fn write(f: &mut impl Write, summary: &Summary) -> fmt::Result {
    writeln!(f, "{}\n{}\n", visible_line(&summary.title), visible_line(&summary.sentence))?;
    lines(f, &parameters(summary), &PARAMETER_SIDES)?;
    if !summary.outputs.is_empty() {
        writeln!(f)?;
        lines(f, &outputs(summary), &OUTPUT_SIDES)?;
    }
    if !summary.findings.is_empty() {
        writeln!(f, "{}", table(&summary.findings))?;
    }
    let width = summary.facts.iter().map(|fact| fact.name.len()).max().unwrap_or(0);
    for fact in &summary.facts {
        write!(f, "\n{:width$}  {}", fact.name, visible_line(&fact.value))?;
    }
    Ok(())
}

/// Right alignment of the columns of the parameters: name, start, value, error, unit, remark.
const PARAMETER_SIDES: [bool; 6] = [false, true, false, false, false, false];

fn parameters(summary: &Summary) -> Vec<[String; 6]> {
    let row = |p: &ParameterRow| {
        let error = match (p.error.is_empty(), p.uncorrected_error.is_empty()) {
            (true, _) => String::new(),
            (false, true) => format!("+- {}", p.error),
            (false, false) => format!("+- {} (uncorrected {})", p.error, p.uncorrected_error),
        };
        let error = error
            .replace("+- none", "")
            .replace("+- not determined", "(not determined)")
            .replace("+- error unknown", "(error unknown)");
        [short(&p.name), p.start.clone(), format!("-> {}", p.value), error, p.unit.clone(), p.remark.clone()]
    };
    summary.parameters.iter().map(row).collect()
}

/// Right alignment of the columns of the outputs: name, RMS, RMS at the start, fit percentage, number of
/// measurements.
const OUTPUT_SIDES: [bool; 5] = [false, false, false, false, false];

fn outputs(summary: &Summary) -> Vec<[String; 5]> {
    let row = |o: &OutputRow| {
        let experiment = match summary.has_several_experiments {
            true => format!("{}: ", o.experiment),
            false => String::new(),
        };
        let unit = if o.unit.is_empty() { String::new() } else { format!(" {}", o.unit) };
        [
            short(&format!("{experiment}{}", o.variable)),
            format!("RMS {}{unit}", o.rms),
            format!("(start {})", o.start_rms),
            format!("fit {}", o.fit_percent),
            format!("n {}", o.n),
        ]
    };
    summary.outputs.iter().map(row).collect()
}

/// Writes the rows in columns as wide as their widest cells, without empty columns.
fn lines<const N: usize>(f: &mut impl Write, rows: &[[String; N]], to_right: &[bool; N]) -> fmt::Result {
    let rows: Vec<_> = rows.iter().map(|row| row.each_ref().map(|cell| visible_line(cell))).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: [usize; N] = std::array::from_fn(width);
    for row in &rows {
        let mut line = String::new();
        for ((cell, width), to_right) in row.iter().zip(widths).zip(to_right).filter(|((_, w), _)| *w > 0) {
            line += "  ";
            line += &if *to_right { format!("{cell:>width$}") } else { format!("{cell:width$}") };
        }
        writeln!(f, "{}", line.trim_end())?;
    }
    Ok(())
}

/// Shortens a long name in the middle.
fn short(name: &str) -> String {
    let n = name.chars().count();
    if n <= LONGEST {
        return name.to_owned();
    }
    let part = (LONGEST - 3) / 2;
    name.chars().take(part).chain("...".chars()).chain(name.chars().skip(n - part)).collect()
}
