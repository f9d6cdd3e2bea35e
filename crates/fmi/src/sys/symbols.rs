//! Symbols of a library, looked up while its tables are being made; how a table is written.

use super::function::Function;
use super::platform::Handle;
use super::shared_page;
use super::types::InterfaceKind;
use crate::error::{FmiError, Result};
use std::path::Path;

/// Whose names for the functions a library has; the number is the place of a name in the row of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dialect {
    /// FMI 1.0, model exchange.
    Fmi1,
    Fmi2,
    Fmi3,
    /// FMI 1.0, co-simulation. Most of its names are those of model exchange.
    Fmi1Slave,
}

/// Looks symbols up in a library while its tables are being made.
#[derive(Clone, Copy)]
pub(super) struct Symbols<'a> {
    pub(super) handle: &'a Handle,
    pub(super) path: &'a Path,
    /// Before the names, up to an underscore (FMI 1.0); where a name does not have it, as some tools export
    /// it, the plain one is taken.
    pub(super) prefix: Option<&'a str>,
    pub(super) dialect: Dialect,
    /// The interface that is used: of the other one nothing is looked up.
    pub(super) kind: InterfaceKind,
    pub(super) is_unused: bool,
}

impl Symbols<'_> {
    /// For functions of both interfaces.
    pub(super) fn both(self) -> Self {
        self
    }

    /// For functions of model exchange only.
    pub(super) fn model_exchange(self) -> Self {
        Self { is_unused: self.kind != InterfaceKind::ModelExchange, ..self }
    }

    /// For functions of co-simulation only.
    pub(super) fn co_simulation(self) -> Self {
        Self { is_unused: self.kind != InterfaceKind::CoSimulation, ..self }
    }

    /// The name of a function: of one for each dialect, where co-simulation of FMI 1.0 may have that of model
    /// exchange; or of a single one.
    fn name(&self, names: &[&'static str]) -> &'static str {
        let place = if names.len() == 1 { 0 } else { self.dialect as usize };
        names.get(place).or(names.first()).copied().unwrap_or_default()
    }

    /// A function that must be there, unless the dialect has no name for it.
    ///
    /// # Safety
    /// `F` is a function pointer type that fits the symbol, and is not called after the library is closed.
    pub(super) unsafe fn required<F: Copy>(&self, names: &[&'static str]) -> Result<Function<F>> {
        // SAFETY: handed on to the caller.
        let function = unsafe { self.optional(names) }?;
        if function.pointer.is_none() && !self.is_unused && is_symbol(function.name) {
            return Err(FmiError::MissingSymbol { library: self.path.to_owned(), symbol: function.name });
        }
        Ok(function)
    }

    /// A function that may be missing.
    ///
    /// # Safety
    /// As for [`required`](Self::required).
    pub(super) unsafe fn optional<F: Copy>(&self, names: &[&'static str]) -> Result<Function<F>> {
        let name = self.name(names);
        // SAFETY: handed on to the caller.
        let find = |name: &str| unsafe { self.handle.get::<F>(name) }.ok().map(|symbol| *symbol);
        let find_prefixed = || find(&format!("{}_{name}", self.prefix?));
        let is_wanted = !self.is_unused && is_symbol(name);
        let pointer = if is_wanted { find_prefixed().or_else(|| find(name)) } else { None };
        let number = if pointer.is_some() { shared_page::number_of(name) } else { 0 };
        Ok(Function { name, pointer, number })
    }
}

/// True if a name in a table is that of a function.
fn is_symbol(name: &str) -> bool {
    !name.is_empty() && !name.starts_with('(')
}

/// The type of a function: of `(arguments)` of a component that return a status, or of `[any type]`.
macro_rules! signature {
    (($($argument:ty),*)) => {
        unsafe extern "C" fn($crate::sys::types::Component, $($argument),*) -> std::ffi::c_int
    };
    ([$type:ty]) => { $type };
}
pub(super) use signature;

/// A table of functions by interface, each with its type and its names, and how it is filled.
macro_rules! table {
    (
        $(#[$doc:meta])*
        $vis:vis struct $table:ident $(<$generic:ident>)? {
            $($interface:ident { $($row:ident $signature:tt = $need:ident $($name:literal)|+;)* })+
        }
    ) => {
        $(#[$doc])*
        $vis struct $table $(<$generic>)? {
            $($($vis $row: $crate::sys::function::Function<$crate::sys::symbols::signature!($signature)>,)*)+
        }

        impl $(<$generic>)? $table $(<$generic>)? {
            /// The names in its rows.
            #[cfg(test)]
            $vis const NAMES: &'static [&'static [&'static str]] = &[$($(&[$($name),+]),*),+];

            /// Looks the functions up.
            ///
            /// # Errors
            /// A function that must be there is missing.
            ///
            /// # Safety
            /// The library follows the version of the standard whose names these are: a symbol of a name has
            /// the type the standard gives it.
            $vis unsafe fn load(symbols: &$crate::sys::symbols::Symbols<'_>) -> Result<Self, $crate::FmiError> {
                // SAFETY: each name stands beside the type of the standard; the caller vouches that the library does the
                // same. The pointers stay valid while the `Library` that owns the table is open.
                unsafe { Ok(Self { $($($row: symbols.$interface().$need(&[$($name),+])?,)*)+ }) }
            }
        }
    };
}
pub(super) use table;
