//! Macros for declarations: enumerations with a name for each value, and getters.

/// Declares an enumeration with a name for each value: `WORDS`, `name` and `Display`.
macro_rules! words {
    ($(#[$meta:meta])* $vis:vis enum $type:ident { $($(#[$doc:meta])* $variant:ident = $word:literal,)+ }) => {
        $(#[$meta])*
        $vis enum $type { $($(#[$doc])* $variant,)+ }

        #[allow(dead_code)]
        impl $type {
            /// All values with their names.
            pub(crate) const WORDS: &[(&str, $type)] = &[$(($word, $type::$variant)),+];

            /// Returns the name of the value.
            pub fn name(self) -> &'static str {
                match self {
                    $($type::$variant => $word),+
                }
            }
        }

        impl std::fmt::Display for $type {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.name())
            }
        }
    };
}
pub(crate) use words;

/// Declares getters.
macro_rules! getters {
    ($($(#[$meta:meta])* $vis:vis $name:ident($self:ident) -> $type:ty = $value:expr;)+) => {$(
        $(#[$meta])*
        $vis fn $name(&$self) -> $type {
            $value
        }
    )+};
}
pub(crate) use getters;
