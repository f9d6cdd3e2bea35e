//! Units of measurement by their names: exponents of the SI base units, factor and offset; conversion into the unit of a variable.

use fmi::ModelDescription;
use fmi::description::{BaseUnit, Variable};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use std::fmt;

/// Exponents of kg, m, s, A, K, mol, cd and rad.
type Exponents = [i32; 8];

const SYMBOLS_OF_BASE: [&str; 8] = ["kg", "m", "s", "A", "K", "mol", "cd", "rad"];

const NONE: Exponents = [0; 8];
const LENGTH: Exponents = [0, 1, 0, 0, 0, 0, 0, 0];
const AREA: Exponents = [0, 2, 0, 0, 0, 0, 0, 0];
const VOLUME: Exponents = [0, 3, 0, 0, 0, 0, 0, 0];
const MASS: Exponents = [1, 0, 0, 0, 0, 0, 0, 0];
const TIME: Exponents = [0, 0, 1, 0, 0, 0, 0, 0];
const CURRENT: Exponents = [0, 0, 0, 1, 0, 0, 0, 0];
const TEMPERATURE: Exponents = [0, 0, 0, 0, 1, 0, 0, 0];
const AMOUNT: Exponents = [0, 0, 0, 0, 0, 1, 0, 0];
const LIGHT: Exponents = [0, 0, 0, 0, 0, 0, 1, 0];
const ANGLE: Exponents = [0, 0, 0, 0, 0, 0, 0, 1];
const FREQUENCY: Exponents = [0, 0, -1, 0, 0, 0, 0, 0];
const ANGULAR_SPEED: Exponents = [0, 0, -1, 0, 0, 0, 0, 1];
const SPEED: Exponents = [0, 1, -1, 0, 0, 0, 0, 0];
const ACCELERATION: Exponents = [0, 1, -2, 0, 0, 0, 0, 0];
const FORCE: Exponents = [1, 1, -2, 0, 0, 0, 0, 0];
const PRESSURE: Exponents = [1, -1, -2, 0, 0, 0, 0, 0];
const ENERGY: Exponents = [1, 2, -2, 0, 0, 0, 0, 0];
const POWER: Exponents = [1, 2, -3, 0, 0, 0, 0, 0];
const CHARGE: Exponents = [0, 0, 1, 1, 0, 0, 0, 0];
const VOLTAGE: Exponents = [1, 2, -3, -1, 0, 0, 0, 0];
const FLUX: Exponents = [1, 2, -2, -1, 0, 0, 0, 0];

/// Symbol (compared exactly: s is not S), whether prefixes may stand before it, exponents, and `base = value * numerator /
/// denominator + offset`. Values: BIPM, The International System of Units (9th edition, 2019), tables 4, 7 and 8; NIST Special
/// Publication 811 (2008), appendix B.8, for those that are not of the SI.
type Symbol = (&'static str, bool, Exponents, (f64, f64), f64);

const SYMBOLS: &[Symbol] = &[
    ("m", true, LENGTH, (1.0, 1.0), 0.0),
    ("g", true, MASS, (1.0, 1e3), 0.0),
    ("s", true, TIME, (1.0, 1.0), 0.0),
    ("A", true, CURRENT, (1.0, 1.0), 0.0),
    ("K", true, TEMPERATURE, (1.0, 1.0), 0.0),
    ("mol", true, AMOUNT, (1.0, 1.0), 0.0),
    ("cd", true, LIGHT, (1.0, 1.0), 0.0),
    ("lm", true, LIGHT, (1.0, 1.0), 0.0),
    ("lx", true, [0, -2, 0, 0, 0, 0, 1, 0], (1.0, 1.0), 0.0),
    ("rad", true, ANGLE, (1.0, 1.0), 0.0),
    ("sr", false, NONE, (1.0, 1.0), 0.0),
    ("Hz", true, FREQUENCY, (1.0, 1.0), 0.0),
    ("Bq", true, FREQUENCY, (1.0, 1.0), 0.0),
    ("N", true, FORCE, (1.0, 1.0), 0.0),
    ("Pa", true, PRESSURE, (1.0, 1.0), 0.0),
    ("J", true, ENERGY, (1.0, 1.0), 0.0),
    ("W", true, POWER, (1.0, 1.0), 0.0),
    ("C", true, CHARGE, (1.0, 1.0), 0.0),
    ("V", true, VOLTAGE, (1.0, 1.0), 0.0),
    ("F", true, [-1, -2, 4, 2, 0, 0, 0, 0], (1.0, 1.0), 0.0),
    ("Ohm", true, [1, 2, -3, -2, 0, 0, 0, 0], (1.0, 1.0), 0.0),
    ("\u{3a9}", true, [1, 2, -3, -2, 0, 0, 0, 0], (1.0, 1.0), 0.0),
    ("\u{2126}", true, [1, 2, -3, -2, 0, 0, 0, 0], (1.0, 1.0), 0.0),
    ("S", true, [-1, -2, 3, 2, 0, 0, 0, 0], (1.0, 1.0), 0.0),
    ("Wb", true, FLUX, (1.0, 1.0), 0.0),
    ("T", true, [1, 0, -2, -1, 0, 0, 0, 0], (1.0, 1.0), 0.0),
    ("H", true, [1, 2, -2, -2, 0, 0, 0, 0], (1.0, 1.0), 0.0),
    ("Nm", true, ENERGY, (1.0, 1.0), 0.0),
    ("Ns", true, [1, 1, -1, 0, 0, 0, 0, 0], (1.0, 1.0), 0.0),
    ("Ws", true, ENERGY, (1.0, 1.0), 0.0),
    ("Wh", true, ENERGY, (3600.0, 1.0), 0.0),
    ("Ah", true, CHARGE, (3600.0, 1.0), 0.0),
    ("As", true, CHARGE, (1.0, 1.0), 0.0),
    ("Vs", true, FLUX, (1.0, 1.0), 0.0),
    ("VA", true, POWER, (1.0, 1.0), 0.0),
    ("var", true, POWER, (1.0, 1.0), 0.0),
    ("min", false, TIME, (60.0, 1.0), 0.0),
    ("h", false, TIME, (3600.0, 1.0), 0.0),
    ("d", false, TIME, (86400.0, 1.0), 0.0),
    ("deg", false, ANGLE, (PI, 180.0), 0.0),
    ("\u{b0}", false, ANGLE, (PI, 180.0), 0.0),
    ("rev", false, ANGLE, (2.0 * PI, 1.0), 0.0),
    ("rpm", false, ANGULAR_SPEED, (PI, 30.0), 0.0),
    ("degC", false, TEMPERATURE, (1.0, 1.0), 273.15),
    ("\u{b0}C", false, TEMPERATURE, (1.0, 1.0), 273.15),
    ("\u{2103}", false, TEMPERATURE, (1.0, 1.0), 273.15),
    ("degF", false, TEMPERATURE, (5.0, 9.0), 459.67 * 5.0 / 9.0),
    ("\u{b0}F", false, TEMPERATURE, (5.0, 9.0), 459.67 * 5.0 / 9.0),
    ("degK", false, TEMPERATURE, (1.0, 1.0), 0.0),
    ("l", true, VOLUME, (1.0, 1e3), 0.0),
    ("L", true, VOLUME, (1.0, 1e3), 0.0),
    ("ha", false, AREA, (1e4, 1.0), 0.0),
    ("t", false, MASS, (1e3, 1.0), 0.0),
    ("bar", true, PRESSURE, (1e5, 1.0), 0.0),
    ("atm", false, PRESSURE, (101_325.0, 1.0), 0.0),
    ("mmHg", false, PRESSURE, (133.322_387_415, 1.0), 0.0),
    ("Torr", false, PRESSURE, (101_325.0, 760.0), 0.0),
    ("psi", false, PRESSURE, (6_894.757_293_168, 1.0), 0.0),
    ("in", false, LENGTH, (127.0, 5000.0), 0.0),
    ("ft", false, LENGTH, (381.0, 1250.0), 0.0),
    ("mi", false, LENGTH, (1_609.344, 1.0), 0.0),
    ("mph", false, SPEED, (1_609.344, 3600.0), 0.0),
    ("kph", false, SPEED, (5.0, 18.0), 0.0),
    ("lb", false, MASS, (0.453_592_37, 1.0), 0.0),
    ("lbm", false, MASS, (0.453_592_37, 1.0), 0.0),
    ("lbf", false, FORCE, (4.448_221_615_260_5, 1.0), 0.0),
    ("gn", false, ACCELERATION, (9.806_65, 1.0), 0.0),
    ("g_n", false, ACCELERATION, (9.806_65, 1.0), 0.0),
    ("gal", false, VOLUME, (3.785_411_784e-3, 1.0), 0.0),
    ("cal", true, ENERGY, (4.184, 1.0), 0.0),
    ("eV", true, ENERGY, (1.602_176_634e-19, 1.0), 0.0),
    ("BTU", false, ENERGY, (1_055.055_852_62, 1.0), 0.0),
    ("hp", false, POWER, (745.699_871_582_270_2, 1.0), 0.0),
    ("PS", false, POWER, (735.498_75, 1.0), 0.0),
    ("%", false, NONE, (1.0, 100.0), 0.0),
    ("ppm", false, NONE, (1.0, 1e6), 0.0),
];

/// Words for units, in any case, and their symbols.
const WORDS: &[(&[&str], &str)] = &[
    (&["sec", "second", "seconds"], "s"),
    (&["msec", "millisecond", "milliseconds"], "ms"),
    (&["microsecond", "microseconds"], "us"),
    (&["nanosecond", "nanoseconds"], "ns"),
    (&["minute", "minutes"], "min"),
    (&["hr", "hour", "hours"], "h"),
    (&["day", "days"], "d"),
    (&["metre", "metres", "meter", "meters"], "m"),
    (&["millimetre", "millimetres", "millimeter", "millimeters"], "mm"),
    (&["inch", "inches"], "in"),
    (&["foot", "feet"], "ft"),
    (&["kilogram", "kilograms"], "kg"),
    (&["litre", "litres", "liter", "liters"], "l"),
    (&["kelvin"], "K"),
    (&["celsius"], "degC"),
    (&["fahrenheit"], "degF"),
    (&["degree", "degrees"], "deg"),
    (&["radian", "radians"], "rad"),
    (&["revolution", "revolutions", "turn", "turns"], "rev"),
    (&["hertz"], "Hz"),
    (&["newton", "newtons"], "N"),
    (&["pascal", "pascals"], "Pa"),
    (&["joule", "joules"], "J"),
    (&["watt", "watts"], "W"),
    (&["volt", "volts"], "V"),
    (&["ampere", "amperes", "amp", "amps"], "A"),
    (&["ohm", "ohms"], "Ohm"),
    (&["percent"], "%"),
    (&["-", "none", "dimensionless"], "1"),
];

/// Prefixes and their powers of ten.
const PREFIXES: [(&str, i32); 21] = [
    ("da", 1),
    ("Y", 24),
    ("Z", 21),
    ("E", 18),
    ("P", 15),
    ("T", 12),
    ("G", 9),
    ("M", 6),
    ("k", 3),
    ("h", 2),
    ("d", -1),
    ("c", -2),
    ("m", -3),
    ("u", -6),
    ("\u{b5}", -6),
    ("\u{3bc}", -6),
    ("n", -9),
    ("p", -12),
    ("f", -15),
    ("a", -18),
    ("z", -21),
];

/// A unit of measurement: `base value = value * numerator / denominator + offset`, the base value in SI base units and radians. Factors
/// are fractions, so that from mm to m a value is divided by 1000, without another rounding.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Unit {
    exponents: Exponents,
    numerator: f64,
    denominator: f64,
    offset: f64,
}

/// How values in one unit become values in another: `value * factor.0 / factor.1 + offset`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct UnitConversion {
    /// Numerator and denominator of the factor.
    pub factor: (f64, f64),
    /// The offset, in the unit that values are converted to.
    pub offset: f64,
}

/// Why there is no conversion.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum UnitError {
    /// A name that is no unit, as far as known here.
    #[error("'{name}' is no unit that is known here{hint}")]
    Unknown {
        /// The name.
        name: String,
        /// How it may be meant; empty, or beginning with a semicolon.
        hint: String,
    },
    /// Units of different quantities.
    #[error("'{from}' ({from_dimension}) cannot be converted to '{to}' ({to_dimension}){hint}")]
    Dimension {
        /// The unit that is given.
        from: String,
        /// What it consists of.
        from_dimension: String,
        /// The unit that is wanted.
        to: String,
        /// What it consists of.
        to_dimension: String,
        /// How it may be meant; empty, or beginning with a semicolon.
        hint: String,
    },
    /// The model states no unit for the variable.
    #[error("the model states no unit for '{variable}'")]
    NotStated {
        /// The variable.
        variable: String,
    },
}

impl UnitConversion {
    /// The conversion that changes nothing.
    pub const IDENTITY: Self = Self { factor: (1.0, 1.0), offset: 0.0 };

    /// Converts a value.
    pub fn apply(&self, value: f64) -> f64 {
        value * self.factor.0 / self.factor.1 + self.offset
    }

    /// Converts a value back.
    pub fn invert(&self, value: f64) -> f64 {
        (value - self.offset) * self.factor.1 / self.factor.0
    }

    /// Converts a difference of two values: the offset does not count.
    pub fn apply_to_difference(&self, difference: f64) -> f64 {
        difference * self.factor.0 / self.factor.1
    }

    /// Whether it changes nothing.
    pub fn is_identity(&self) -> bool {
        *self == Self::IDENTITY
    }

    /// From a unit given by its name to that of a variable, in which its values, bounds and start value are. What the model defines
    /// counts first: the display units of the variable's unit, and the units of the description by their names.
    ///
    /// # Errors
    /// [`UnitError::NotStated`], [`UnitError::Unknown`] (of either unit) or [`UnitError::Dimension`].
    pub fn to_variable(
        from: &str,
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
        if from == to {
            return Ok(Self::IDENTITY);
        }
        let defined = |name: &str| description.units.iter().find(|unit| unit.name == name);
        let shown = defined(to).and_then(|unit| unit.display_units.iter().find(|d| d.name == from));
        if let Some(display) = shown.filter(|d| !d.inverse && d.factor != 0.0) {
            // shown = factor * value + offset
            let offset = -display.offset / display.factor;
            return Ok(without_offset(Self { factor: (1.0, display.factor), offset }));
        }
        let unit = |name: &str| match defined(name).and_then(|unit| unit.base) {
            Some(base) => Ok(Unit::of_base(&base)),
            None => Unit::parse(name),
        };
        Unit::conversion((from, unit(from)?), (to, unit(to)?)).map(without_offset)
    }

    /// Between two units given by their names.
    ///
    /// # Errors
    /// [`UnitError::Unknown`] (of either unit) or [`UnitError::Dimension`].
    pub fn between(from: &str, to: &str) -> Result<Self, UnitError> {
        Unit::conversion((from, Unit::parse(from)?), (to, Unit::parse(to)?))
    }
}

impl Unit {
    fn of_base(base: &BaseUnit) -> Self {
        let BaseUnit { kg, m, s, a, k, mol, cd, rad, factor, offset } = *base;
        Self { exponents: [kg, m, s, a, k, mol, cd, rad], numerator: factor, denominator: 1.0, offset }
    }

    /// Parses a name: symbols of the SI with prefixes and common ones beside it (`mm`, `bar`, `degC`, `rpm`, `kWh`, `%`), products
    /// (`N.m`, `kg*m2`, `kg m2`) and quotients (`W/K`, `J/(kg.K)`) of their powers (`m2`, `m^2`, `s-1`), and words for the simple ones
    /// (`seconds`, in any case). `degC` is a temperature alone, and a difference of temperatures in a product.
    ///
    /// # Errors
    /// [`UnitError::Unknown`].
    pub fn parse(name: &str) -> Result<Self, UnitError> {
        let name = name.trim();
        let unknown = |hint: &str| UnitError::Unknown { name: name.to_owned(), hint: hint.to_owned() };
        if let Some(unit) = symbol(name).or_else(|| word(name)) {
            return Ok(unit);
        }
        let mut parser = Parser { rest: name };
        match parser.expression() {
            Some(unit) if parser.rest.is_empty() && unit.is_usable() => Ok(unit),
            _ if parser.rest.starts_with(PRODUCT) || parser.rest.starts_with(' ') => {
                Err(unknown("; put what it is divided by in parentheses, as in 'J/(kg.K)'"))
            }
            _ => Err(unknown(hint(name))),
        }
    }

    /// Whether it is one of time, and not of anything else.
    pub(crate) fn time_factor(&self) -> Option<(f64, f64)> {
        (self.exponents == TIME && self.offset == 0.0).then_some((self.numerator, self.denominator))
    }

    fn is_usable(&self) -> bool {
        let factor = self.numerator / self.denominator;
        factor.is_finite() && factor > 0.0
    }

    /// Between two units with their names. Radians are pure numbers where it is no frequency: a frequency has cycles, of which an angular
    /// speed has 2 pi radians each.
    fn conversion(
        (from, unit): (&str, Self),
        (to, target): (&str, Self),
    ) -> Result<UnitConversion, UnitError> {
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

    /// The base units it consists of.
    fn dimension(&self) -> String {
        let power = |(symbol, exponent): (&&str, &i32)| match exponent {
            0 => None,
            1 => Some((*symbol).to_owned()),
            n => Some(format!("{symbol}{n}")),
        };
        let powers: Vec<String> = SYMBOLS_OF_BASE.iter().zip(&self.exponents).filter_map(power).collect();
        if powers.is_empty() { "a pure number".to_owned() } else { powers.join(".") }
    }

    /// The product with a power of another unit; offsets do not count in it.
    fn times(self, other: Self, power: i32) -> Self {
        let mut exponents = self.exponents;
        for (own, others) in exponents.iter_mut().zip(other.exponents) {
            *own = own.saturating_add(others.saturating_mul(power));
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
        write!(f, "times {}", ode::Number(self.factor.0 / self.factor.1))?;
        if self.offset == 0.0 { Ok(()) } else { write!(f, " plus {}", ode::Number(self.offset)) }
    }
}

/// A fraction of whole numbers in lowest terms; others as they are.
fn reduced((mut n, mut d): (f64, f64)) -> (f64, f64) {
    const EXACT: f64 = 9_007_199_254_740_992.0;
    if n == d {
        return (1.0, 1.0);
    }
    if [n, d].iter().all(|v| v.fract() == 0.0 && (1.0..EXACT).contains(v)) {
        let (mut a, mut b) = (n, d);
        while b != 0.0 {
            (a, b) = (b, a % b);
        }
        (n, d) = (n / a, d / a);
    }
    (n, d)
}

/// A symbol, with a prefix or without.
fn symbol(name: &str) -> Option<Unit> {
    let find = |name: &str| SYMBOLS.iter().find(|(symbol, ..)| *symbol == name);
    let unit = |&(_, _, exponents, (numerator, denominator), offset): &Symbol| Unit {
        exponents,
        numerator,
        denominator,
        offset,
    };
    find(name).map(unit).or_else(|| {
        PREFIXES.iter().find_map(|(prefix, power)| {
            let symbol = find(name.strip_prefix(prefix)?).filter(|symbol| symbol.1)?;
            let ten = Unit { numerator: 10.0, ..Unit::ONE };
            Some(unit(symbol).times(ten, *power))
        })
    })
}

fn word(name: &str) -> Option<Unit> {
    let name = name.to_lowercase();
    let found = WORDS.iter().find(|(words, _)| words.contains(&name.as_str()));
    found.and_then(|(_, of)| if *of == "1" { Some(Unit::ONE) } else { symbol(of) })
}

fn hint(name: &str) -> &'static str {
    match name.to_lowercase().as_str() {
        "barg" | "bar(g)" | "bar g" | "psig" => "; a gauge pressure must be made absolute, in 'bar' or 'psi'",
        "db" => "; decibels are no linear unit",
        _ => "; see Unit::parse for those that are: 'mm', 'degC', 'rpm', 'kW/K', 'J/(kg.K)', 'm^3/h'",
    }
}

const PRODUCT: [char; 5] = ['.', '*', '\u{b7}', '\u{22c5}', '\u{d7}'];

/// Reads `factor { product-sign factor } [ "/" factor { "/" factor } ]`, where a factor is a number, a symbol with an exponent or an
/// expression in parentheses.
struct Parser<'a> {
    rest: &'a str,
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
            // What comes after a space is told apart from a product in an error.
            if self.rest.trim_start().starts_with(['/', ')']) {
                self.rest = self.rest.trim_start();
            }
        }
        Some(unit)
    }

    fn factor(&mut self) -> Option<Unit> {
        let factor = if let Some(rest) = self.rest.strip_prefix('(') {
            self.rest = rest.trim_start();
            let inner = self.expression()?;
            self.rest = self.rest.strip_prefix(')')?;
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
            symbol(name).or_else(|| word(name))?
        };
        let power = self.power()?;
        Some(Unit::ONE.times(factor, power))
    }

    /// A number with a decimal point and an exponent, as in `1e-6 m2`.
    fn number(&mut self) -> Option<Unit> {
        let longest = (1..=self.rest.len().min(24)).rev().filter(|&end| self.rest.is_char_boundary(end));
        let is_number = |text: &str| text.ends_with(|c: char| c.is_ascii_digit());
        let (end, value) = longest
            .filter(|&end| is_number(&self.rest[..end]))
            .find_map(|end| Some((end, self.rest[..end].parse::<f64>().ok()?)))?;
        self.rest = &self.rest[end..];
        Some(Unit { numerator: value, ..Unit::ONE })
    }

    /// The exponent that follows, 1 where there is none; `None` if it is too large or no whole number.
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

/// The digit or sign that a raised one stands for.
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
    fn values_are_converted_between_units_of_one_quantity() {
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
        // As a user would divide.
        assert_eq!(UnitConversion::between("cm", "m").unwrap().apply(6.27155), 6.27155 / 100.0);
        assert_eq!(UnitConversion::between("mbar", "Pa").unwrap().apply(1013.3), 1013.3 * 100.0);
        assert_eq!(UnitConversion::between("degC", "K").unwrap().apply_to_difference(3.0), 3.0);
    }

    #[test]
    fn what_does_not_fit_is_named() {
        for (from, to, expected) in [
            ("mm", "s", "'mm' (m) cannot be converted to 's' (s)"),
            ("Pa", "K", "'Pa' (kg.m-1.s-2) cannot be converted to 'K' (K)"),
            ("1", "m", "'1' (a pure number) cannot be converted to 'm' (m)"),
            ("C", "K", "degrees Celsius are 'degC'"),
            ("1/s", "rad/s", "write rev/s, Hz, rpm or rad/s"),
            ("furlong", "m", "'furlong' is no unit that is known here"),
            ("m", "MW/QQ", "'MW/QQ' is no unit"),
            ("W/m2.K", "W/(m2.K)", "in parentheses, as in 'J/(kg.K)'"),
            ("barg", "Pa", "must be made absolute"),
            ("dB", "1", "decibels are no linear unit"),
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
}
