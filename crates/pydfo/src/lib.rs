//! The Python module `pydfo._core`: thin bindings. The crates contain the computations, and `python/pydfo`
//! contains the public Python interface.
#![deny(unsafe_code)]

mod calibration;
mod command_line;
mod convert;
mod interrupt;
mod model;
mod ode;
mod optimize;

use pyo3::prelude::*;

// Free-threaded interpreters enable the lock for this module. A wheel of the stable interface does not load
// there, and a separate wheel has never been tested. Objectives in Python also rely on being called by one
// thread at a time, unless workers are requested.
#[pymodule(name = "_core", gil_used = true)]
mod core_module {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::calibration::calibration_class::PyCalibration;
    #[pymodule_export]
    use super::calibration::check::{check, name_of_finding};
    #[pymodule_export]
    use super::calibration::data_files::{
        PyTable, check_regular, clock_change, date_seconds, find_column, find_time,
    };
    #[pymodule_export]
    use super::calibration::experiment::{check_parameter, is_maximised, is_output_scale, is_sigma_text};
    #[pymodule_export]
    use super::calibration::fit::PyFit;
    #[pymodule_export]
    use super::calibration::live_page::PyLivePage;
    #[pymodule_export]
    use super::calibration::posterior::sample;
    #[pymodule_export]
    use super::calibration::profile::profile;
    #[pymodule_export]
    use super::calibration::recordings::{recorded, recorded_inputs};
    #[pymodule_export]
    use super::calibration::saved_fit::{functions_of_fit, load_fit};
    #[pymodule_export]
    use super::calibration::sensitivity::calibration_sensitivity;
    #[pymodule_export]
    use super::calibration::uncertainty::PyUncertainty;
    #[pymodule_export]
    use super::calibration::validation::{cross_validate, prediction_bands, validate};
    #[pymodule_export]
    use super::calibration::worker::{ForkServer, serve_worker, set_launcher, start_worker_ahead};
    #[pymodule_export]
    use super::command_line::command_line;
    #[pymodule_export]
    use super::convert::error::visible_line;
    #[pymodule_export]
    use super::convert::values::dtypes;
    #[pymodule_export]
    use super::model::description::Fmu;
    #[pymodule_export]
    use super::model::files::{build_fmu, clear_caches, close_unused, example_fmu, example_names};
    #[pymodule_export]
    use super::model::instance::{PyInstance, PySavedState};
    #[pymodule_export]
    use super::model::model_class::Model;
    #[pymodule_export]
    use super::model::trajectory::time_tolerance;
    #[pymodule_export]
    use super::ode::solve::{solve, solver_of_alias};
    #[pymodule_export]
    use super::optimize::methods::{method_name, method_names, method_of_number, option_names};
    #[pymodule_export]
    use super::optimize::minimize::{hypervolume, minimize};
    #[pymodule_export]
    use super::optimize::optimizer::PyOptimizer;
    #[pymodule_export]
    use super::optimize::quad_err::quad_err;
    #[pymodule_export]
    use super::optimize::sensitivity::sensitivity;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        super::interrupt::logs::install();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
