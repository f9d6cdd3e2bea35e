//! FMUs as files: opened once and kept, the bundled models, packing.

use crate::error;
use fmi::{Fmu, FmuCache};
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::OnceLock;

/// FMUs kept open: scripts open the same file again for every evaluation.
const KEPT: usize = 16;

/// The cache, and the process it belongs to.
static OPEN: OnceLock<(u32, FmuCache)> = OnceLock::new();

/// The FMU of a path; the same one for as long as the file does not change.
pub(crate) fn open(py: Python<'_>, path: PathBuf) -> PyResult<Fmu> {
    let opened = py.detach(|| OPEN.get_or_init(|| (std::process::id(), FmuCache::new(KEPT))).1.open(path));
    opened.map_err(|e| error::model(py, &e))
}

/// Closes the FMUs kept open, so that their private folders go; called when the interpreter ends.
#[pyfunction]
pub(crate) fn close_fmus(py: Python<'_>) {
    if let Some((process, cache)) = OPEN.get()
        // The folders of a forked child are those of its parent.
        && *process == std::process::id()
    {
        py.detach(|| cache.clear());
    }
}

/// Path of a bundled model.
#[pyfunction]
pub(crate) fn example_fmu(py: Python<'_>, name: &str) -> PyResult<PathBuf> {
    py.detach(|| fmi::example_fmu(name)).map_err(|e| error::model(py, &e))
}

/// Names of the bundled models.
#[pyfunction]
pub(crate) fn example_names() -> Vec<&'static str> {
    fmi::example_names().collect()
}

/// Packs a folder into an `.fmu`.
#[pyfunction]
pub(crate) fn build_fmu(py: Python<'_>, folder: PathBuf, out: PathBuf) -> PyResult<()> {
    py.detach(|| fmi::pack(&folder, &out)).map_err(|e| error::model(py, &e))
}
