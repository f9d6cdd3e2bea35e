//! Symbols of a library, looked up while its tables are built, and the macros for tables.

use super::function::Function;
use super::platform::Handle;
use super::shared_page;
use super::types::InterfaceKind;
use crate::error::{FmiError, Result};
use std::path::Path;

/// Naming scheme of the functions of a library. The number is the position of a name in the row of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dialect {
    /// FMI 1.0, model exchange.
    Fmi1,
    Fmi2,
    Fmi3,
    /// FMI 1.0, co-simulation. Most names are shared with model exchange.
    Fmi1Slave,
}

/// Looks up symbols in a library while its tables are built.
#[derive(Clone, Copy)]
pub(super) struct Symbols<'a> {
    pub(super) handle: &'a Handle,
    pub(super) path: &'a Path,
    /// Prefix of the names, before an underscore (FMI 1.0). If no symbol has the prefix, the plain name is
    /// used, because some tools export it.
    pub(super) prefix: Option<&'a str>,
    pub(super) dialect: Dialect,
    /// Interface that is used. Functions of the other interface are not looked up.
    pub(super) kind: InterfaceKind,
    pub(super) is_unused: bool,
}

impl Symbols<'_> {
    /// Selects functions of both interfaces.
    pub(super) fn both(self) -> Self {
        self
    }

    /// Selects functions of model exchange only.
    pub(super) fn model_exchange(self) -> Self {
        Self { is_unused: self.kind != InterfaceKind::ModelExchange, ..self }
    }

    /// Selects functions of co-simulation only.
    pub(super) fn co_simulation(self) -> Self {
        Self { is_unused: self.kind != InterfaceKind::CoSimulation, ..self }
    }

    /// Returns the name of a function. A row has a single name or one for each dialect. Co-simulation of FMI
    /// 1.0 uses the name of model exchange if it has no separate one.
    fn name(&self, names: &[&'static str]) -> &'static str {
        let place = if names.len() == 1 { 0 } else { self.dialect as usize };
        names.get(place).or(names.first()).copied().unwrap_or_default()
    }

    /// Looks up a mandatory function. Returns an error if it is missing, unless the dialect has no name for
    /// it.
    ///
    /// # Safety
    /// `F` is a function pointer type that fits the symbol, and is not called after the library is closed.
    pub(super) unsafe fn required<F: Copy>(&self, names: &[&'static str]) -> Result<Function<F>> {
        // SAFETY: the caller upholds the requirements of this function.
        let function = unsafe { self.optional(names) }?;
        if function.pointer.is_none() && !self.is_unused && is_symbol(function.name) {
            return Err(FmiError::MissingSymbol { library: self.path.to_owned(), symbol: function.name });
        }
        Ok(function)
    }

    /// Looks up a function that may be missing.
    ///
    /// # Safety
    /// As for [`required`](Self::required).
    pub(super) unsafe fn optional<F: Copy>(&self, names: &[&'static str]) -> Result<Function<F>> {
        let name = self.name(names);
        // SAFETY: the caller upholds the requirements of this function.
        let find = |name: &str| unsafe { self.handle.get::<F>(name) }.ok().map(|symbol| *symbol);
        let find_prefixed = || find(&format!("{}_{name}", self.prefix?));
        let is_wanted = !self.is_unused && is_symbol(name);
        let pointer = if is_wanted { find_prefixed().or_else(|| find(name)) } else { None };
        let number = if pointer.is_some() { shared_page::number_of(name) } else { 0 };
        Ok(Function { name, pointer, number })
    }
}

/// True if a name in a table is the name of a function.
fn is_symbol(name: &str) -> bool {
    !name.is_empty() && !name.starts_with('(')
}

/// Type of a function: `(arguments)` for a function of a component that returns a status, or `[any type]`.
macro_rules! signature {
    (($($argument:ty),*)) => {
        unsafe extern "C" fn($crate::sys::types::Component, $($argument),*) -> std::ffi::c_int
    };
    ([$type:ty]) => { $type };
}
pub(super) use signature;

/// Declares a table of functions by interface, with their types and names, and the function that fills it.
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
            /// Names in the rows of the table.
            #[cfg(test)]
            $vis const NAMES: &'static [&'static [&'static str]] = &[$($(&[$($name),+]),*),+];

            /// Looks up the functions.
            ///
            /// # Errors
            /// Returns an error if a mandatory function is missing.
            ///
            /// # Safety
            /// The library follows the version of the standard with these names: each symbol has the type
            /// that the standard specifies.
            $vis unsafe fn load(symbols: &$crate::sys::symbols::Symbols<'_>) -> Result<Self, $crate::FmiError> {
                // SAFETY: each name is listed with its type in the standard, and the caller guarantees that
                // the library conforms. The pointers stay valid while the `Library` that owns the table is
                // open.
                unsafe { Ok(Self { $($($row: symbols.$interface().$need(&[$($name),+])?,)*)+ }) }
            }
        }
    };
}
pub(super) use table;
