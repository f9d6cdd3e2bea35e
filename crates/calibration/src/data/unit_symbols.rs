//! Symbols of units with prefixes, and words for units.

use std::f64::consts::PI;

/// Exponents of kg, m, s, A, K, mol, cd and rad.
pub(super) type Exponents = [i32; 8];

pub(super) const SYMBOLS_OF_BASE: [&str; 8] = ["kg", "m", "s", "A", "K", "mol", "cd", "rad"];

pub(super) const NONE: Exponents = [0; 8];
const LENGTH: Exponents = [0, 1, 0, 0, 0, 0, 0, 0];
const AREA: Exponents = [0, 2, 0, 0, 0, 0, 0, 0];
const VOLUME: Exponents = [0, 3, 0, 0, 0, 0, 0, 0];
const MASS: Exponents = [1, 0, 0, 0, 0, 0, 0, 0];
pub(super) const TIME: Exponents = [0, 0, 1, 0, 0, 0, 0, 0];
const CURRENT: Exponents = [0, 0, 0, 1, 0, 0, 0, 0];
pub(super) const TEMPERATURE: Exponents = [0, 0, 0, 0, 1, 0, 0, 0];
const AMOUNT: Exponents = [0, 0, 0, 0, 0, 1, 0, 0];
const LIGHT: Exponents = [0, 0, 0, 0, 0, 0, 1, 0];
const ANGLE: Exponents = [0, 0, 0, 0, 0, 0, 0, 1];
pub(super) const FREQUENCY: Exponents = [0, 0, -1, 0, 0, 0, 0, 0];
pub(super) const ANGULAR_SPEED: Exponents = [0, 0, -1, 0, 0, 0, 0, 1];
const SPEED: Exponents = [0, 1, -1, 0, 0, 0, 0, 0];
pub(super) const ACCELERATION: Exponents = [0, 1, -2, 0, 0, 0, 0, 0];
const FORCE: Exponents = [1, 1, -2, 0, 0, 0, 0, 0];
const PRESSURE: Exponents = [1, -1, -2, 0, 0, 0, 0, 0];
const ENERGY: Exponents = [1, 2, -2, 0, 0, 0, 0, 0];
const POWER: Exponents = [1, 2, -3, 0, 0, 0, 0, 0];
const CHARGE: Exponents = [0, 0, 1, 1, 0, 0, 0, 0];
const VOLTAGE: Exponents = [1, 2, -3, -1, 0, 0, 0, 0];
const FLUX: Exponents = [1, 2, -2, -1, 0, 0, 0, 0];

/// Symbol, prefix flag, exponents, fraction and offset: `base = value * numerator / denominator + offset`.
/// The symbol is case-sensitive because s differs from S. The flag is true if prefixes are permitted.
///
/// Values: BIPM, The International System of Units (9th edition, 2019), tables 4, 7 and 8. Values of units
/// outside the SI: NIST Special Publication 811 (2008), appendix B.8.
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
    ("-", false, NONE, (1.0, 1.0), 0.0),
    ("%", false, NONE, (1.0, 100.0), 0.0),
    ("ppm", false, NONE, (1.0, 1e6), 0.0),
];

/// Words for units, in upper or lower case, and their symbols.
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
    (&["celsius", "oc"], "degC"),
    (&["fahrenheit", "of"], "degF"),
    // Revolutions per minute, as German loggers write them.
    (&["u/min", "upm"], "rpm"),
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
    (&["none", "dimensionless"], "-"),
];

/// Prefixes and their powers of ten.
#[rustfmt::skip]
const PREFIXES: [(&str, i32); 22] = [
    ("da", 1), ("Y", 24), ("Z", 21), ("E", 18), ("P", 15), ("T", 12), ("G", 9), ("M", 6), ("k", 3), ("h", 2), ("d", -1), ("c", -2),
    ("m", -3), ("u", -6), ("\u{b5}", -6), ("\u{3bc}", -6), ("n", -9), ("p", -12), ("f", -15), ("a", -18), ("z", -21), ("y", -24),
];

/// Returns the exponents, the numerator and denominator of the factor, and the offset. `name` is a symbol,
/// with or without a prefix, or a word.
pub(super) fn find(name: &str) -> Option<Meaning> {
    let find = |name: &str| SYMBOLS.iter().find(|(symbol, ..)| *symbol == name).copied();
    let prefixed = || {
        PREFIXES.iter().find_map(|(prefix, power)| {
            let (.., exponents, (n, d), offset) =
                find(name.strip_prefix(prefix)?).filter(|symbol| symbol.1)?;
            let ten = 10f64.powi(power.abs());
            let factor = if *power < 0 { (n, d * ten) } else { (n * ten, d) };
            Some((exponents, reduced(factor), offset))
        })
    };
    let word = || {
        let name = name.to_lowercase();
        WORDS
            .iter()
            .find(|(words, _)| words.contains(&name.as_str()))
            .and_then(|(_, symbol)| self::find(symbol))
    };
    find(name)
        .map(|(.., exponents, factor, offset)| (exponents, factor, offset))
        .or_else(prefixed)
        .or_else(word)
        .or_else(|| in_another_case(name))
}

/// Returns a symbol, with or without a prefix, that differs only in case, if all such symbols denote one
/// unit. It accepts `RPM` but not `MM` (mm or Mm).
fn in_another_case(name: &str) -> Option<Meaning> {
    let lower = name.to_lowercase();
    let is_symbol = |symbol: &str| symbol.len() > 1 && symbol.to_lowercase() == lower;
    let mut found = spellings().filter(|symbol| is_symbol(symbol)).filter_map(|symbol| find(&symbol));
    let first = found.next()?;
    found.all(|other| other == first).then_some(first)
}

/// Returns the symbol or word that differs from a name by one letter or by two exchanged neighbours.
pub(super) fn nearest(name: &str) -> Option<String> {
    let name = name.to_lowercase();
    let words = WORDS.iter().flat_map(|(words, _)| words.iter().map(|word| (*word).to_owned()));
    let is_near = |symbol: &String| symbol.len() > 2 && differs_little(&symbol.to_lowercase(), &name);
    SYMBOLS.iter().map(|symbol| symbol.0.to_owned()).chain(words).find(is_near)
}

/// True if one letter is replaced, missing or added, or two neighbours are exchanged (Damerau, CACM 7, 1964).
fn differs_little(a: &str, b: &str) -> bool {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let (a, b) = if a.len() <= b.len() { (a, b) } else { (b, a) };
    let same = a.iter().zip(&b).take_while(|(a, b)| a == b).count();
    match b.len() - a.len() {
        0 => {
            let is_exchanged = same + 1 < a.len()
                && (a[same], a[same + 1]) == (b[same + 1], b[same])
                && a[same + 2..] == b[same + 2..];
            same == a.len() || is_exchanged || a[same + 1..] == b[same + 1..]
        }
        1 => a[same..] == b[same + 1..],
        _ => false,
    }
}

/// Returns all symbols, with and without prefixes.
fn spellings() -> impl Iterator<Item = String> {
    let prefixed = |symbol: &'static Symbol| {
        let prefixes = PREFIXES.iter().filter(|_| symbol.1).map(|(prefix, _)| *prefix);
        std::iter::once("").chain(prefixes).map(|prefix| format!("{prefix}{}", symbol.0))
    };
    SYMBOLS.iter().flat_map(prefixed)
}

/// Exponents, numerator and denominator of the factor, and offset.
type Meaning = (Exponents, (f64, f64), f64);

/// Reduces a fraction of integers to lowest terms. Returns other fractions unchanged.
pub(super) fn reduced(fraction: (f64, f64)) -> (f64, f64) {
    const EXACT: f64 = 9_007_199_254_740_992.0;
    let (mut n, mut d) = fraction;
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
