//! The Python module `pydfo._core`: thin bindings. What is computed lives in the crates, what users meet in
//! `python/pydfo`.
#![deny(unsafe_code)]

mod error;
mod fmin;
mod interrupt;
mod objective;
mod report;
mod settings;

use pyo3::prelude::*;

#[pymodule(name = "_core")]
mod core_module {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::fmin::minimize;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
