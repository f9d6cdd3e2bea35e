//! Shared items of the black-box tests: the bundled models, and the optional reference data next to the
//! checkout.
#![allow(dead_code, unreachable_pub)]
#![allow(clippy::unwrap_used)]

use fmufit::calibration::Data;
use fmufit::example_models::example_fmu;
use fmufit::fmi::Fmu;
use std::path::PathBuf;

/// Opens a bundled model.
pub fn example(name: &str) -> Fmu {
    Fmu::open(example_fmu(name).unwrap()).unwrap()
}

/// Returns the path of an optional file of the reference data next to the checkout.
pub fn shared_data(file: &str) -> Option<PathBuf> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(file);
    path.is_file().then_some(path)
}

/// Returns the Furuta measurements of the project.
pub fn furuta_measurements() -> Data {
    Data::from_csv(PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("examples/data/furuta.csv")).unwrap()
}
