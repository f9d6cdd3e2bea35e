//! Parses the elements `<Clock>` and `<ClockType>`: timing of clocks (FMI 3.0.x, sections 2.2.8.3 and 2.4.4).

use super::attributes::Attributes;
use crate::description::clock::{ClockKind, ClockTiming, Interval};
use crate::description::draft::Draft;
use crate::description::limits::Reading;
use crate::description::model::QuirkKind;
use std::collections::HashMap;

/// Attributes as in the file.
#[derive(Debug, Clone, Copy)]
pub(super) struct ClockAttributes {
    line: u32,
    kind: Option<ClockKind>,
    can_be_deactivated: Option<bool>,
    supports_fraction: Option<bool>,
    resolution: Option<u64>,
    interval: Span,
    shift: Span,
}

/// Time span, as a number and as the counter of a fraction.
#[derive(Debug, Clone, Copy)]
struct Span {
    decimal: Option<f64>,
    counter: Option<u64>,
}

impl Span {
    fn is_given(self) -> bool {
        self.decimal.is_some() || self.counter.is_some()
    }

    /// Returns the interval. A fraction takes precedence over a number because it is more exact.
    fn resolved(self, resolution: Option<u64>) -> Option<Interval> {
        let fraction = self.counter.zip(resolution).map(|(counter, of)| Interval::Fraction(counter, of));
        fraction.or(self.decimal.map(Interval::Decimal))
    }
}

impl ClockAttributes {
    pub(super) fn of(attributes: &Attributes<'_>) -> Self {
        let counter = |name| attributes.wide_integer(name).and_then(|counter| u64::try_from(counter).ok());
        let resolution = counter("resolution").filter(|resolution| *resolution > 0);
        let counters = (counter("intervalCounter"), counter("shiftCounter"));
        Self {
            line: attributes.line,
            kind: match attributes.get("intervalVariability") {
                // Word from drafts of the standard. The importer reads the interval from the model, as it
                // does for `fixed` without an interval.
                Some("calculated") => Some(ClockKind::Fixed),
                _ => attributes.choice("intervalVariability", ClockKind::WORDS),
            },
            can_be_deactivated: attributes.boolean("canBeDeactivated"),
            supports_fraction: attributes.boolean("supportsFraction"),
            resolution,
            interval: Span { decimal: attributes.real("intervalDecimal"), counter: counters.0 },
            shift: Span { decimal: attributes.real("shiftDecimal"), counter: counters.1 },
        }
    }

    /// Fills in attributes that the variable does not specify from its type.
    fn inherit(&mut self, of_type: &Self) {
        self.kind = self.kind.or(of_type.kind);
        self.can_be_deactivated = self.can_be_deactivated.or(of_type.can_be_deactivated);
        self.supports_fraction = self.supports_fraction.or(of_type.supports_fraction);
        self.resolution = self.resolution.or(of_type.resolution);
        for (field, inherited) in [(&mut self.interval, of_type.interval), (&mut self.shift, of_type.shift)] {
            if !field.is_given() {
                *field = inherited;
            }
        }
    }

    fn timing(self, reading: &Reading) -> ClockTiming {
        if self.kind.is_none() {
            reading.quirk(QuirkKind::Missing, self.line, || {
                "a clock has no intervalVariability; assumed to be triggered".to_owned()
            });
        }
        let interval = self.interval.resolved(self.resolution);
        let none = match interval {
            Some(Interval::Fraction(_, resolution)) => Interval::Fraction(0, resolution),
            _ => Interval::Decimal(0.0),
        };
        ClockTiming {
            kind: self.kind.unwrap_or(ClockKind::Triggered),
            can_be_deactivated: self.can_be_deactivated.unwrap_or(false),
            supports_fraction: self.supports_fraction.unwrap_or(false),
            interval,
            shift: self.shift.resolved(self.resolution).unwrap_or(none),
        }
    }
}

/// Clocks of a description and their types, in any order.
#[derive(Debug, Default)]
pub(super) struct Clocks {
    pub(super) types: HashMap<String, ClockAttributes>,
    /// Clock attributes with the variable index.
    pub(super) variables: Vec<(usize, ClockAttributes)>,
}

impl Clocks {
    /// Sets the timing of the clock variables.
    pub(super) fn finish(self, draft: &mut Draft) {
        for (position, mut attributes) in self.variables {
            let Some(variable) = draft.model.variables.get_mut(position) else { continue };
            if let Some(of_type) = variable.declared_type.as_ref().and_then(|name| self.types.get(name)) {
                attributes.inherit(of_type);
            }
            variable.clock = Some(Box::new(attributes.timing(&draft.reading)));
        }
    }
}
