//! Units of measurement: exponents of the SI base units, factor and offset, and conversion to the unit of a
//! variable.

use super::unit_symbols::{
    self, ACCELERATION, ANGULAR_SPEED, Exponents, FREQUENCY, NONE, SYMBOLS_OF_BASE, TEMPERATURE, TIME,
    reduced,
};
use fmi::ModelDescription;
use fmi::description::{BaseUnit, Variable};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use std::fmt;

/// Unit of measurement: `base value = value * numerator / denominator + offset`. The base value is in SI base
/// units and radians. Factors are fractions so that a conversion from mm to m divides by 1000, without
/// further rounding.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Unit {
    exponents: Exponents,
    numerator: f64,
    denominator: f64,
    offset: f64,
}

/// Conversion of values from one unit to another: `value * factor.0 / factor.1 + offset`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct UnitConversion {
    /// Numerator and denominator of the factor.
    pub factor: (f64, f64),
    /// Offset in the target unit.
    pub offset: f64,
}

/// Reason why a conversion is impossible.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum UnitError {
    /// The name is not a known unit.
    #[error("'{name}' is not a known unit{hint}")]
    Unknown {
        /// Unknown name.
        name: String,
        /// Hint at the intended unit; either empty or beginning with a semicolon.
        hint: String,
    },
    /// The units measure different quantities.
    #[error("'{from}' ({from_dimension}) cannot be converted to '{to}' ({to_dimension}){hint}")]
    Dimension {
        /// Given unit.
        from: String,
        /// Base units of the given unit.
        from_dimension: String,
        /// Target unit.
        to: String,
        /// Base units of the target unit.
        to_dimension: String,
        /// Hint at the intended unit; either empty or beginning with a semicolon.
        hint: String,
    },
    /// The model declares no unit for the variable.
    #[error("the model declares no unit for '{variable}'")]
    NotStated {
        /// Name of the variable.
        variable: String,
    },
}

impl UnitConversion {
    /// Identity conversion.
    pub const IDENTITY: Self = Self { factor: (1.0, 1.0), offset: 0.0 };

    /// Converts a value.
    pub fn apply(&self, value: f64) -> f64 {
        value * self.factor.0 / self.factor.1 + self.offset
    }

    /// Converts a value back.
    pub fn invert(&self, value: f64) -> f64 {
        (value - self.offset) * self.factor.1 / self.factor.0
    }

    /// Converts a difference of two values, without the offset.
    pub fn apply_to_difference(&self, difference: f64) -> f64 {
        difference * self.factor.0 / self.factor.1
    }

    /// True if the conversion does not change values.
    pub fn is_identity(&self) -> bool {
        *self == Self::IDENTITY
    }

    /// Returns the conversion from a named unit to the unit of a variable, which applies to its values,
    /// bounds and start value. Definitions of the model take precedence: the display units of the variable's
    /// unit, and the units of the model description with these names.
    ///
    /// # Errors
    /// Returns [`UnitError::NotStated`], [`UnitError::Unknown`] (for either unit) or
    /// [`UnitError::Dimension`].
    pub fn to_variable(
        from: &str,
        variable: &Variable,
        description: &ModelDescription,
    ) -> Result<Self, UnitError> {
        Self::from_defined(from, None, variable, description)
    }

    /// Returns the conversion as [`to_variable`](Self::to_variable) does, from a unit that is defined outside
    /// the model.
    pub(super) fn from_defined(
        from: &str,
        given_unit: Option<&Unit>,
        variable: &Variable,
        description: &ModelDescription,
    ) -> Result<Self, UnitError> {
        let stated = variable.unit.as_deref().map(str::trim).filter(|unit| !unit.is_empty());
        let to = stated.ok_or_else(|| UnitError::NotStated { variable: variable.name.clone() })?;
        let from = from.trim();
        let without_offset = |conversion: Self| match variable.relative_quantity {
            true => Self { offset: 0.0, ..conversion },
            false => conversion,
        };
        if from == to && given_unit.is_none() {
            return Ok(Self::IDENTITY);
        }
        let defined = |name: &str| description.units.iter().find(|unit| unit.name == name);
        let shown = defined(to).and_then(|unit| unit.display_units.iter().find(|d| d.name == from));
        if let Some(display) = shown.filter(|d| given_unit.is_none() && !d.inverse && d.factor != 0.0) {
            // shown = factor * value + offset
            let offset = -display.offset / display.factor;
            return Ok(without_offset(Self { factor: (1.0, display.factor), offset }));
        }
        let unit = |name: &str| match defined(name).and_then(|unit| unit.base) {
            Some(base) => Ok(Unit::of_base(&base)),
            None => Unit::parse(name),
        };
        let target = match (unit(to), given_unit) {
            // An unknown name on both sides denotes one unit.
            (Err(_), Some(_)) if from == to => return Ok(Self::IDENTITY),
            (target, _) => target?,
        };
        let given_unit = given_unit.copied().map_or_else(|| unit(from), Ok)?;
        match given_unit == target {
            true => Ok(Self::IDENTITY),
            false => Unit::conversion(from, given_unit, to, target).map(without_offset),
        }
    }

    /// Returns the conversion between two named units.
    ///
    /// # Errors
    /// Returns [`UnitError::Unknown`] (for either unit) or [`UnitError::Dimension`].
    pub fn between(from: &str, to: &str) -> Result<Self, UnitError> {
        Unit::conversion(from, Unit::parse(from)?, to, Unit::parse(to)?)
    }
}

impl Unit {
    fn of_base(base: &BaseUnit) -> Self {
        let BaseUnit { kg, m, s, a, k, mol, cd, rad, factor, offset } = *base;
        Self { exponents: [kg, m, s, a, k, mol, cd, rad], numerator: factor, denominator: 1.0, offset }
    }

    /// Returns a unit from its definition, if the definition is valid.
    pub(super) fn defined(base: &BaseUnit) -> Option<Self> {
        Some(Self::of_base(base)).filter(|unit| unit.is_usable() && unit.offset.is_finite())
    }

    /// Parses the name of a unit. Supported are SI symbols with prefixes, other common symbols (`mm`, `bar`,
    /// `degC`, `rpm`, `kWh`, `%`), and words for simple units (`seconds`, in upper or lower case). Products
    /// (`N.m`, `kg*m2`, `kg m2`) and quotients (`W/K`, `J/(kg.K)`) may contain powers (`m2`, `m^2`, `s-1`).
    /// `degC` alone is a temperature; in a product, it is a temperature difference.
    ///
    /// # Errors
    /// Returns [`UnitError::Unknown`] if the name is not a unit.
    pub fn parse(name: &str) -> Result<Self, UnitError> {
        let name = name.trim();
        let unknown = |hint: &str| UnitError::Unknown { name: shortened(name), hint: hint.to_owned() };
        if let Some(unit) = unit_named(name) {
            return Ok(unit);
        }
        let mut parser = Parser { rest: name, depth: 0 };
        match parser.expression() {
            _ if parser.depth > DEEPEST => {
                Err(unknown(&format!("; its parentheses are nested more than {DEEPEST} deep")))
            }
            Some(unit) if parser.rest.is_empty() && unit.is_usable() => Ok(unit),
            _ if parser.rest.starts_with(PRODUCT) || parser.rest.starts_with(' ') => {
                Err(unknown("; write the divisor in parentheses, as in 'J/(kg.K)'"))
            }
            _ => Err(unknown(&hint(name))),
        }
    }

    /// Returns the length in s, as numerator and denominator, if the unit is a pure unit of time.
    pub(crate) fn time_factor(&self) -> Option<(f64, f64)> {
        (self.exponents == TIME && self.offset == 0.0).then_some((self.numerator, self.denominator))
    }

    /// True if the unit is a product of base units without a factor.
    pub(crate) fn is_coherent(&self) -> bool {
        self.numerator == self.denominator && self.offset == 0.0
    }

    fn is_usable(&self) -> bool {
        let factor = self.numerator / self.denominator;
        factor.is_finite() && factor > 0.0
    }

    /// Returns the conversion between two units with names. Radians are pure numbers, except in frequencies:
    /// a frequency counts cycles, and an angular speed has 2 pi radians per cycle.
    fn conversion(from: &str, unit: Self, to: &str, target: Self) -> Result<UnitConversion, UnitError> {
        let plain = |u: &Self| {
            let mut exponents = u.exponents;
            exponents[7] = 0;
            exponents
        };
        let dimension = |hint: &str| UnitError::Dimension {
            from: from.to_owned(),
            from_dimension: unit.dimension(),
            to: to.to_owned(),
            to_dimension: target.dimension(),
            hint: hint.to_owned(),
        };
        if plain(&unit) != plain(&target) {
            let hint = match from {
                "C" if target.exponents == TEMPERATURE => "; 'C' is the coulomb, degrees Celsius are 'degC'",
                "F" if target.exponents == TEMPERATURE => "; 'F' is the farad, degrees Fahrenheit are 'degF'",
                "g" if target.exponents == ACCELERATION => "; 'g' is the gram, the acceleration is 'gn'",
                _ => "",
            };
            return Err(dimension(hint));
        }
        let mut factor = (unit.numerator * target.denominator, unit.denominator * target.numerator);
        let is_cycles =
            |u: &Self, name: &str| u.exponents == FREQUENCY && (name.ends_with("Hz") || name.contains("min"));
        match (unit.exponents, target.exponents) {
            (FREQUENCY, ANGULAR_SPEED) if is_cycles(&unit, from) => factor.0 *= 2.0 * PI,
            (ANGULAR_SPEED, FREQUENCY) if is_cycles(&target, to) => factor.1 *= 2.0 * PI,
            (FREQUENCY, ANGULAR_SPEED) | (ANGULAR_SPEED, FREQUENCY) => {
                return Err(dimension("; 1/s may be revolutions or radians: write rev/s, Hz, rpm or rad/s"));
            }
            _ => {}
        }
        let offset = (unit.offset - target.offset) * target.denominator / target.numerator;
        Ok(UnitConversion { factor: reduced(factor), offset })
    }

    /// Returns the base units of the unit.
    fn dimension(&self) -> String {
        let power = |(symbol, exponent): (&&str, &i32)| match exponent {
            0 => None,
            1 => Some((*symbol).to_owned()),
            n => Some(format!("{symbol}{n}")),
        };
        let powers: Vec<String> = SYMBOLS_OF_BASE.iter().zip(&self.exponents).filter_map(power).collect();
        if powers.is_empty() { "a pure number".to_owned() } else { powers.join(".") }
    }

    /// Returns the product with a power of a different unit, without offsets.
    fn times(self, other: Self, power: i32) -> Self {
        let mut exponents = self.exponents;
        for (exponent, others) in exponents.iter_mut().zip(other.exponents) {
            *exponent = exponent.saturating_add(others.saturating_mul(power));
        }
        let (n, d) = (other.numerator.powi(power.abs()), other.denominator.powi(power.abs()));
        let (n, d) = if power < 0 { (d, n) } else { (n, d) };
        let (numerator, denominator) = reduced((self.numerator * n, self.denominator * d));
        Self { exponents, numerator, denominator, offset: 0.0 }
    }

    const ONE: Self = Self { exponents: NONE, numerator: 1.0, denominator: 1.0, offset: 0.0 };
}

impl fmt::Display for UnitConversion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "times {}", base::Number(self.factor.0 / self.factor.1))?;
        if self.offset == 0.0 { Ok(()) } else { write!(f, " plus {}", base::Number(self.offset)) }
    }
}

/// Returns the unit of a symbol, with or without a prefix, or of a word.
fn unit_named(name: &str) -> Option<Unit> {
    let (exponents, (numerator, denominator), offset) = unit_symbols::find(name)?;
    Some(Unit { exponents, numerator, denominator, offset })
}

fn hint(name: &str) -> String {
    match name.to_lowercase().as_str() {
        "barg" | "bar(g)" | "bar g" | "psig" => {
            "; convert a gauge pressure to an absolute pressure in 'bar' or 'psi'".to_owned()
        }
        "db" => "; decibels are not a linear unit".to_owned(),
        _ => {
            let nearest = unit_symbols::nearest(name).map_or_else(String::new, |near| format!("; '{near}'?"));
            format!("{nearest}; write units as 'mm', 'degC', 'rpm', 'kW/K', 'J/(kg.K)', 'm^3/h'")
        }
    }
}

/// Returns the name for an error message, truncated if it is long.
fn shortened(name: &str) -> String {
    match name.char_indices().nth(LONGEST_SHOWN) {
        Some((end, _)) => format!("{}...", &name[..end]),
        None => name.to_owned(),
    }
}

/// Maximum number of characters of a name in an error message.
const LONGEST_SHOWN: usize = 60;

/// Maximum nesting of parentheses. Real units need no nesting.
const DEEPEST: usize = 16;

const PRODUCT: [char; 5] = ['.', '*', '\u{b7}', '\u{22c5}', '\u{d7}'];

/// Parser of `factor { product-sign factor } [ "/" factor { "/" factor } ]`. A factor is a number, a symbol
/// with an exponent, or an expression in parentheses.
struct Parser<'a> {
    rest: &'a str,
    /// Number of open parentheses. It stays above `DEEPEST` after exceeding it.
    depth: usize,
}

impl Parser<'_> {
    fn expression(&mut self) -> Option<Unit> {
        let mut unit = self.factor()?;
        loop {
            let rest = self.rest.trim_start();
            let is_space = rest.len() < self.rest.len();
            if let Some(after) = rest.strip_prefix(PRODUCT) {
                self.rest = after.strip_prefix('*').unwrap_or(after).trim_start();
            } else if rest.is_empty() || rest.starts_with(['/', ')']) || !is_space {
                self.rest = rest;
                break;
            } else {
                self.rest = rest;
            }
            unit = unit.times(self.factor()?, 1);
        }
        while let Some(rest) = self.rest.strip_prefix('/') {
            self.rest = rest.trim_start();
            unit = unit.times(self.factor()?, -1);
            // Keep other spaces so that the error can suggest parentheses for a product.
            if self.rest.trim_start().starts_with(['/', ')']) {
                self.rest = self.rest.trim_start();
            }
        }
        Some(unit)
    }

    fn factor(&mut self) -> Option<Unit> {
        let factor = if let Some(rest) = self.rest.strip_prefix('(') {
            self.rest = rest.trim_start();
            self.depth += 1;
            if self.depth > DEEPEST {
                return None;
            }
            let inner = self.expression()?;
            self.rest = self.rest.strip_prefix(')')?;
            self.depth -= 1;
            inner
        } else if self.rest.starts_with(|c: char| c.is_ascii_digit()) {
            self.number()?
        } else {
            let is_end = |c: char| {
                c.is_whitespace()
                    || c.is_ascii_digit()
                    || PRODUCT.contains(&c)
                    || matches!(c, '/' | '(' | ')' | '^' | '-' | '+')
                    || superscript(c).is_some()
            };
            let end = self.rest.find(is_end).unwrap_or(self.rest.len());
            let (name, rest) = self.rest.split_at(end);
            self.rest = rest;
            unit_named(name)?
        };
        let power = self.power()?;
        Some(Unit::ONE.times(factor, power))
    }

    /// Parses a number with a decimal point and an exponent, as in `1e-6 m2`.
    fn number(&mut self) -> Option<Unit> {
        let longest = (1..=self.rest.len().min(24)).rev().filter(|&end| self.rest.is_char_boundary(end));
        let is_number = |text: &str| text.ends_with(|c: char| c.is_ascii_digit());
        let (end, value) = longest
            .filter(|&end| is_number(&self.rest[..end]))
            .find_map(|end| Some((end, self.rest[..end].parse::<f64>().ok()?)))?;
        self.rest = &self.rest[end..];
        Some(Unit { numerator: value, ..Unit::ONE })
    }

    /// Parses the following exponent, or returns 1 if there is none. Returns `None` if the exponent is out of
    /// range or not an integer.
    fn power(&mut self) -> Option<i32> {
        let marked = self.rest.strip_prefix('^').or_else(|| self.rest.strip_prefix("**"));
        if let Some(rest) = marked {
            self.rest = rest;
        }
        let parenthesised = marked.is_some() && self.rest.starts_with('(');
        if parenthesised {
            self.rest = &self.rest[1..];
        }
        let digits: String = self
            .rest
            .chars()
            .map_while(|c| superscript(c).or(matches!(c, '0'..='9' | '-' | '+').then_some(c)))
            .collect();
        if digits.is_empty() {
            return marked.is_none().then_some(1);
        }
        let taken = self.rest.chars().take(digits.chars().count()).map(char::len_utf8).sum();
        self.rest = &self.rest[taken..];
        if parenthesised {
            self.rest = self.rest.strip_prefix(')')?;
        }
        digits.parse().ok().filter(|power: &i32| (-12..=12).contains(power) && *power != 0)
    }
}

/// Returns the digit or sign of a superscript character.
fn superscript(c: char) -> Option<char> {
    Some(match c {
        '\u{2070}' => '0',
        '\u{b9}' => '1',
        '\u{b2}' => '2',
        '\u{b3}' => '3',
        '\u{2074}'..='\u{2079}' => char::from_digit(c as u32 - 0x2070, 10)?,
        '\u{207b}' => '-',
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conversion_between_units_of_one_quantity_is_accurate() {
        for (value, from, to, expected) in [
            (5.0, "mm", "m", 0.005),
            (6.27155, "cm", "m", 6.27155 / 100.0),
            (1.0, "in", "mm", 25.4),
            (3.0, "ft", "m", 0.9144),
            (1.5, "bar", "Pa", 1.5e5),
            (1.5, "mbar", "hPa", 1.5),
            (2.0, "MPa", "kPa", 2000.0),
            (1.0, "psi", "Pa", 6894.757293168),
            (25.0, "degC", "K", 298.15),
            (25.0, "\u{b0}C", "degF", 77.0),
            (212.0, "degF", "degC", 100.0),
            (60.0, "rpm", "rad/s", 2.0 * PI),
            (60.0, "1/min", "rad/s", 2.0 * PI),
            (60.0, "min-1", "rpm", 60.0),
            (2.0, "Hz", "rad/s", 4.0 * PI),
            (1.0, "rev/s", "rpm", 60.0),
            (180.0, "deg", "rad", PI),
            (180.0, "deg", "1", PI),
            (90.0, "deg/s", "rad/s", PI / 2.0),
            (2.0, "kN", "N", 2000.0),
            (2.0, "Nm", "N.m", 2.0),
            (2.0, "N m", "N.m", 2.0),
            (2.0, "N*m.s/rad", "N.m.s", 2.0),
            (1.0, "kWh", "J", 3.6e6),
            (1.0, "kWh", "MJ", 3.6),
            (3.0, "g/s", "kg/s", 0.003),
            (6.0, "l/min", "m3/s", 1e-4),
            (3600.0, "m3/h", "m\u{b3}/s", 1.0),
            (1.0, "m^3/h", "L/h", 1000.0),
            (5.0, "mV", "V", 0.005),
            (5.0, "\u{b5}A", "mA", 0.005),
            (50.0, "%", "1", 0.5),
            (50.0, "percent", "-", 0.5),
            (2.0, "kW/K", "W/K", 2000.0),
            (2.0, "kW/degC", "W/K", 2000.0),
            (2.0, "kg.m2/s2", "J", 2.0),
            (2.0, "kg m\u{b2} s\u{207b}\u{b2}", "J", 2.0),
            (2.0, "J/(kg.K)", "J/kg/K", 2.0),
            (2.0, "kJ/(kg K)", "m2/(s2.K)", 2000.0),
            (36.0, "km/h", "m/s", 10.0),
            (3.0, "1e-6 m2", "mm2", 3.0),
            (3.0, "1e-6.m2", "m^(2)", 3e-6),
            (1.0, "gn", "m/s2", 9.80665),
            (1.0, "V.A", "W", 1.0),
            (1.0, "Ohm", "V/A", 1.0),
            (1.0, "uF", "A.s/V", 1e-6),
            (2.0, "min", "s", 120.0),
            (1.0, "Torr", "mmHg", 1.0),
        ] {
            let conversion = UnitConversion::between(from, to).unwrap();
            let found = conversion.apply(value);
            assert!((found - expected).abs() <= 3e-7 * expected.abs(), "{value} {from} = {found} {to}");
            assert!((conversion.invert(found) - value).abs() <= 1e-13 * value.abs(), "{from} to {to}");
        }
        // The result equals a direct division.
        assert_eq!(UnitConversion::between("cm", "m").unwrap().apply(6.27155), 6.27155 / 100.0);
        assert_eq!(UnitConversion::between("mbar", "Pa").unwrap().apply(1013.3), 1013.3 * 100.0);
        assert_eq!(UnitConversion::between("degC", "K").unwrap().apply_to_difference(3.0), 3.0);
    }

    #[test]
    fn unit_errors_report_dimensions_and_hints() {
        for (from, to, expected) in [
            ("mm", "s", "'mm' (m) cannot be converted to 's' (s)"),
            ("Pa", "K", "'Pa' (kg.m-1.s-2) cannot be converted to 'K' (K)"),
            ("1", "m", "'1' (a pure number) cannot be converted to 'm' (m)"),
            ("C", "K", "degrees Celsius are 'degC'"),
            ("1/s", "rad/s", "write rev/s, Hz, rpm or rad/s"),
            ("furlong", "m", "'furlong' is not a known unit"),
            ("m", "MW/QQ", "'MW/QQ' is not a known unit"),
            ("W/m2.K", "W/(m2.K)", "in parentheses, as in 'J/(kg.K)'"),
            ("barg", "Pa", "to an absolute pressure"),
            ("dB", "1", "decibels are not a linear unit"),
        ] {
            let message = UnitConversion::between(from, to).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        for name in [
            "",
            "/",
            "m/",
            "(m",
            "m)",
            "m^",
            "m^x",
            "m99999999999",
            "m0",
            "1e999 m",
            "\u{b2}",
            "m..s",
            "raw",
            "\u{1f980}",
        ] {
            assert!(matches!(Unit::parse(name), Err(UnitError::Unknown { .. })), "{name}");
        }
    }

    #[test]
    fn parse_ignores_case_when_the_spelling_is_unique() {
        for (name, expected) in [
            ("RPM", "rpm"),
            ("DEGC", "degC"),
            ("oC", "degC"),
            ("U/min", "rpm"),
            ("KPA", "kPa"),
            ("Bar", "bar"),
            ("KG/s", "kg/s"),
        ] {
            assert_eq!(Unit::parse(name).ok(), Unit::parse(expected).ok(), "{name}");
        }
        // mm and Mm, mN and MN are ambiguous.
        assert!(Unit::parse("MM").is_err() && Unit::parse("mn").is_err());
        let message = Unit::parse("rmp").unwrap_err().to_string();
        assert!(message.contains("'rpm'?"), "{message}");
    }

    #[test]
    fn parse_limits_nesting_of_parentheses() {
        assert!(Unit::parse(&format!("{}m{}", "(".repeat(16), ")".repeat(16))).is_ok());
        for n in [17, 100_000] {
            for name in ["(".repeat(n), format!("{}m{}", "(".repeat(n), ")".repeat(n))] {
                let message = Unit::parse(&name).unwrap_err().to_string();
                assert!(message.contains("nested more than 16 deep") && message.len() < 200, "{message}");
            }
        }
    }
}
