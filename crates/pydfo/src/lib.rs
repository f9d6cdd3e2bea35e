//! The Python module `pydfo._core`: thin bindings. What is computed lives in the crates, what users meet in
//! `python/pydfo`.
#![deny(unsafe_code)]

mod calibration;
mod cost;
mod data;
mod description;
mod dict;
mod error;
mod experiment;
mod files;
mod findings;
mod fit;
mod fit_report;
mod fmu_error;
mod futures;
mod inputs;
mod interrupt;
mod logs;
mod methods;
mod minimize;
mod model;
mod objective;
mod optimizer;
mod profile;
mod py_system;
mod quad_err;
mod record;
mod recordings;
mod report;
mod share;
mod solve;
mod threads;
mod trajectory;
mod validation;
mod values;
mod worker;
mod worth;

use pyo3::prelude::*;

// Free-threaded interpreters take the lock for it: a wheel of the stable interface does not load there, one for them alone has never
// been tested, and an objective in Python relies on being called by one thread at a time unless workers are asked for.
#[pymodule(name = "_core", gil_used = true)]
mod core_module {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::calibration::PyCalibration;
    #[pymodule_export]
    use super::data::{PyTable, check_regular, clock_change, date_seconds, find_column, find_time};
    #[pymodule_export]
    use super::description::Fmu;
    #[pymodule_export]
    use super::experiment::check_parameter;
    #[pymodule_export]
    use super::files::{build_fmu, clear_caches, close_unused, example_fmu, example_names};
    #[pymodule_export]
    use super::fit::PyFit;
    #[pymodule_export]
    use super::fit_report::{
        fit_curves, fit_findings, fit_html, fit_outputs, fit_report, fit_sensitivities, fit_text,
    };
    #[pymodule_export]
    use super::methods::{method_name, method_names, method_of_number, option_names};
    #[pymodule_export]
    use super::minimize::minimize;
    #[pymodule_export]
    use super::model::Model;
    #[pymodule_export]
    use super::optimizer::PyOptimizer;
    #[pymodule_export]
    use super::profile::profile;
    #[pymodule_export]
    use super::quad_err::quad_err;
    #[pymodule_export]
    use super::recordings::{check, recorded, recorded_inputs};
    #[pymodule_export]
    use super::share::{
        export_fmu, export_ssv, fit_to_bytes, fit_to_csv, fit_to_json, functions_of_fit, load_fit,
        parameters_of, save_fit, simulate_variables, variable_values,
    };
    #[pymodule_export]
    use super::solve::solve;
    #[pymodule_export]
    use super::validation::{cross_validate, prediction_bands, validate};
    #[pymodule_export]
    use super::values::dtypes;
    #[pymodule_export]
    use super::worker::{serve_worker, set_launcher};
    #[pymodule_export]
    use super::worth::{PyWorth, preflight_at, preflight_of_fit, worth_at, worth_of_fit};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        super::logs::install();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
