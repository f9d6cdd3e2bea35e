//! Units: SI exponents with factor and offset, and the display units derived from them.

use serde::Serialize;

/// Unit used by the variables of a model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Unit {
    /// Name by which variables refer to the unit.
    pub name: String,
    /// Exponents of the SI base units, factor and offset; `None` if the file does not specify them.
    pub base: Option<BaseUnit>,
    /// Units in which values can be displayed.
    pub display_units: Vec<DisplayUnit>,
}

/// Exponents of the SI base units (and radian), with `base value = factor * value + offset`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BaseUnit {
    /// Exponent of the kilogram.
    pub kg: i32,
    /// Exponent of the meter.
    pub m: i32,
    /// Exponent of the second.
    pub s: i32,
    /// Exponent of the ampere.
    pub a: i32,
    /// Exponent of the kelvin.
    pub k: i32,
    /// Exponent of the mole.
    pub mol: i32,
    /// Exponent of the candela.
    pub cd: i32,
    /// Exponent of the radian.
    pub rad: i32,
    /// Factor from this unit to the base unit.
    pub factor: f64,
    /// Offset in the base unit.
    pub offset: f64,
}

impl Default for BaseUnit {
    fn default() -> Self {
        BaseUnit { kg: 0, m: 0, s: 0, a: 0, k: 0, mol: 0, cd: 0, rad: 0, factor: 1.0, offset: 0.0 }
    }
}

impl BaseUnit {
    /// Converts a value in this unit to the base unit: `factor * value + offset`.
    pub fn to_base(&self, value: f64) -> f64 {
        self.factor * value + self.offset
    }

    /// Converts a value in the base unit to this unit.
    pub fn from_base(&self, value: f64) -> f64 {
        (value - self.offset) / self.factor
    }
}

/// Unit for displaying values, with `shown value = factor * value + offset`. If `inverse` is true, the shown
/// value is `factor / value` (FMI 3.0).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DisplayUnit {
    /// Name by which variables refer to the display unit.
    pub name: String,
    /// Factor from the unit to the display unit.
    pub factor: f64,
    /// Offset in the display unit.
    pub offset: f64,
    /// True if the shown value is `factor / value` (FMI 3.0; the offset is then 0).
    pub inverse: bool,
}

impl DisplayUnit {
    /// Converts a value in the unit to the display unit.
    pub fn show(&self, value: f64) -> f64 {
        if self.inverse { self.factor / value } else { self.factor * value + self.offset }
    }

    /// Converts a displayed value back to the unit.
    pub fn read(&self, shown: f64) -> f64 {
        if self.inverse { self.factor / shown } else { (shown - self.offset) / self.factor }
    }
}
