//! Functionals of criteria in formulas, such as `max(T)` or `settling_time(y, 1)`.

macro_rules! functionals {
    ($($variant:ident $name:literal $least:literal $most:literal),* $(,)?) => {
        /// Functional that maps a simulated signal to a number.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub(crate) enum Functional {
            $($variant),*
        }

        impl Functional {
            /// Names with the least and the largest number of arguments.
            const ALL: &[(&str, Self, usize, usize)] = &[$(($name, Self::$variant, $least, $most)),*];
        }
    };
}

functionals! {
    Final "final" 1 1, Max "max" 1 1, Min "min" 1 1, Mean "mean" 1 1, Integral "integral" 1 1, Rms "rms" 1 1,
    Energy "energy" 1 1, Ise "ise" 1 2, Iae "iae" 1 2, Itae "itae" 1 2, Overshoot "overshoot" 1 2,
    RiseTime "rise_time" 1 2, SettlingTime "settling_time" 1 3, CrossingTime "crossing_time" 2 2,
}

/// Names of other tools and languages.
const SPELLINGS: [(&str, &str); 7] = [
    ("maximum", "max"),
    ("minimum", "min"),
    ("last", "final"),
    ("end", "final"),
    ("average", "mean"),
    ("int", "integral"),
    ("ts", "settling_time"),
];

impl Functional {
    pub(super) fn of_name(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(listed, ..)| *listed == name).map(|(_, functional, ..)| *functional)
    }

    pub(crate) fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, functional, ..)| *functional == self).map_or("", |(name, ..)| name)
    }

    pub(super) fn names() -> impl Iterator<Item = &'static str> {
        Self::ALL.iter().map(|(name, ..)| *name)
    }

    pub(super) fn spelled(name: &str) -> Option<&'static str> {
        SPELLINGS.iter().find(|(other, _)| *other == name).map(|(_, listed)| *listed)
    }

    /// Returns the least and the largest number of arguments.
    pub(super) fn n_arguments(self) -> (usize, usize) {
        let found = Self::ALL.iter().find(|(_, functional, ..)| *functional == self);
        found.map_or((1, 1), |(_, _, least, most)| (*least, *most))
    }
}
