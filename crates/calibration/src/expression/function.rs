//! Functions and constants of formulas, with their derivatives.

use std::f64::consts::LN_10;

macro_rules! functions {
    ($($variant:ident $name:literal),* $(,)?) => {
        /// Function of an expression.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(super) enum Function {
            $($variant),*
        }

        impl Function {
            const ALL: &[(&str, Self)] = &[$(($name, Self::$variant)),*];
        }
    };
}

functions! {
    Sqrt "sqrt", Exp "exp", Log "log", Log10 "log10", Abs "abs", Min "min", Max "max", Sin "sin", Cos "cos",
    Tan "tan", Asin "asin", Acos "acos", Atan "atan", Atan2 "atan2", Sinh "sinh", Cosh "cosh", Tanh "tanh",
}

/// Names of other languages.
const SPELLINGS: [(&str, &str); 9] = [
    ("ln", "log"),
    ("lg", "log10"),
    ("fabs", "abs"),
    ("pow", "**"),
    ("arcsin", "asin"),
    ("arccos", "acos"),
    ("arctan", "atan"),
    ("arctan2", "atan2"),
    ("square", "** 2"),
];

impl Function {
    pub(super) fn of_name(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(known, _)| *known == name).map(|(_, function)| *function)
    }

    pub(super) fn names() -> impl Iterator<Item = &'static str> {
        Self::ALL.iter().map(|(name, _)| *name)
    }

    /// Returns the name of a function of another language.
    pub(super) fn spelled(name: &str) -> Option<&'static str> {
        SPELLINGS.iter().find(|(other, _)| *other == name).map(|(_, listed)| *listed)
    }

    /// Returns the least number of arguments, and the largest if there is one.
    pub(super) fn n_arguments(self) -> (usize, Option<usize>) {
        match self {
            Self::Min | Self::Max => (2, None),
            Self::Atan2 => (2, Some(2)),
            _ => (1, Some(1)),
        }
    }

    /// True if the function takes two operands from the stack. More arguments of `min` and `max` are several
    /// calls.
    pub(super) fn is_binary(self) -> bool {
        matches!(self, Self::Min | Self::Max | Self::Atan2)
    }

    /// Returns the value. `b` is unused for functions of one argument.
    pub(super) fn value(self, a: f64, b: f64) -> f64 {
        match self {
            Self::Sqrt => a.sqrt(),
            Self::Exp => a.exp(),
            Self::Log => a.ln(),
            Self::Log10 => a.log10(),
            Self::Abs => a.abs(),
            // Unlike f64::min, NaN is never hidden.
            Self::Min if a.is_nan() || b.is_nan() => f64::NAN,
            Self::Max if a.is_nan() || b.is_nan() => f64::NAN,
            Self::Min => a.min(b),
            Self::Max => a.max(b),
            Self::Sin => a.sin(),
            Self::Cos => a.cos(),
            Self::Tan => a.tan(),
            Self::Asin => a.asin(),
            Self::Acos => a.acos(),
            Self::Atan => a.atan(),
            Self::Atan2 => a.atan2(b),
            Self::Sinh => a.sinh(),
            Self::Cosh => a.cosh(),
            Self::Tanh => a.tanh(),
        }
    }

    /// Returns the partial derivatives. At a kink, they are the ones of the first of equal arguments, and 0
    /// for the absolute value of 0.
    pub(super) fn derivatives(self, a: f64, b: f64) -> (f64, f64) {
        let of_one = match self {
            Self::Sqrt => 0.5 / a.sqrt(),
            Self::Exp => a.exp(),
            Self::Log => 1.0 / a,
            Self::Log10 => 1.0 / (a * LN_10),
            Self::Abs if a == 0.0 => 0.0,
            Self::Abs => a.signum(),
            Self::Min => return if a <= b { (1.0, 0.0) } else { (0.0, 1.0) },
            Self::Max => return if a >= b { (1.0, 0.0) } else { (0.0, 1.0) },
            Self::Sin => a.cos(),
            Self::Cos => -a.sin(),
            Self::Tan => 1.0 + a.tan().powi(2),
            Self::Asin => 1.0 / ((1.0 - a) * (1.0 + a)).sqrt(),
            Self::Acos => -1.0 / ((1.0 - a) * (1.0 + a)).sqrt(),
            Self::Atan => 1.0 / (1.0 + a * a),
            Self::Atan2 => {
                let squares = a * a + b * b;
                return (b / squares, -a / squares);
            }
            Self::Sinh => a.cosh(),
            Self::Cosh => a.sinh(),
            Self::Tanh => 1.0 - a.tanh().powi(2),
        };
        (of_one, 0.0)
    }
}

/// Returns the value of a constant.
pub(super) fn constant(name: &str) -> Option<(&'static str, f64)> {
    match name {
        "pi" => Some(("pi", std::f64::consts::PI)),
        "e" => Some(("e", std::f64::consts::E)),
        _ => None,
    }
}

/// Returns the most similar name if it differs by a third of its letters or less, or only by case.
pub(crate) fn nearest<'a>(name: &str, names: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let lower = name.to_lowercase();
    let distance = |other: &str| distance(&lower, &other.to_lowercase());
    let candidates = names.into_iter().map(|other| (distance(other), other));
    let (n, best) = candidates.min_by_key(|(n, _)| *n)?;
    (3 * n <= best.chars().count().max(3)).then_some(best)
}

/// Returns the number of letters to insert, delete, replace or swap with their neighbour (optimal string
/// alignment: Damerau, Communications of the ACM 7, 1964).
fn distance(one: &str, other: &str) -> usize {
    let [one, other] = [one, other].map(|text| text.chars().collect::<Vec<char>>());
    let mut rows: Vec<Vec<usize>> = vec![(0..=other.len()).collect()];
    for i in 1..=one.len() {
        let mut row = vec![i];
        for j in 1..=other.len() {
            let is_equal = one[i - 1] == other[j - 1];
            let replaced = rows[i - 1][j - 1] + usize::from(!is_equal);
            let mut best = replaced.min(rows[i - 1][j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && one[i - 1] == other[j - 2] && one[i - 2] == other[j - 1] {
                best = best.min(rows[i - 2][j - 2] + 1);
            }
            row.push(best);
        }
        rows.push(row);
    }
    rows.last().and_then(|row| row.last()).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_name_differs_by_few_letters() {
        let names = ["tau1", "tau2", "k", "armFriction"];
        for (name, expected) in [
            ("tua2", Some("tau2")),
            ("kk", Some("k")),
            ("armfriction", Some("armFriction")),
            ("armFricton", Some("armFriction")),
            ("mass", None),
        ] {
            assert_eq!(nearest(name, names), expected, "{name}");
        }
    }
}
