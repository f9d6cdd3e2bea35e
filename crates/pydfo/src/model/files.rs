//! Opening FMUs (unchanged files only once), packing folders, and the bundled examples.

use crate::convert::fmu_error;
use crate::interrupt::interrupt_guard::InterruptGuard;
use crate::interrupt::logs;
use example_models::ExampleKind;
use fmi::platform::BuildTarget;
use fmi::{CancelRequest, FmiError, FmuCache, OpenOptions};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::LazyLock;

/// Number of FMUs that stay open after their last use, because scripts open their model at every evaluation.
const KEPT_OPEN: usize = 32;

static OPEN: LazyLock<FmuCache> = LazyLock::new(|| FmuCache::new(KEPT_OPEN));

/// Returns the FMU at `path`, opened now or earlier with equal options.
pub(crate) fn open(py: Python<'_>, path: PathBuf, options: &OpenOptions) -> PyResult<fmi::Fmu> {
    try_open(py, path, options)?.map_err(|e| fmu_error::raise(py, &e))
}

/// Returns the FMU at `path` like `open`, with the unconverted error of the model.
pub(crate) fn try_open(
    py: Python<'_>,
    path: PathBuf,
    options: &OpenOptions,
) -> PyResult<Result<fmi::Fmu, FmiError>> {
    // Small files can contain large descriptions.
    let opened = watched(py, |cancel| OPEN.open_with(&path, &OpenOptions { cancel, ..options.clone() }))?;
    logs::pass_on(py)?;
    Ok(opened)
}

/// Runs work that may take seconds without the interpreter lock. Ctrl-C ends it.
pub(crate) fn watched<T: Send>(py: Python<'_>, work: impl FnOnce(CancelRequest) -> T + Send) -> PyResult<T> {
    let watch = InterruptGuard::without_handler(py);
    let cancel = CancelRequest::polling(watch.poller());
    let done = py.detach(|| work(cancel));
    if watch.stop().is_requested() { Err(watch.interrupted()) } else { Ok(done) }
}

/// Closes the FMUs kept open. The interpreter calls it at its end, so that no unpacked folder remains.
#[pyfunction]
pub(crate) fn close_unused(py: Python<'_>) {
    py.detach(|| OPEN.clear());
}

/// Closes the FMUs kept open if the system does not replace open files. Called before an FMU is written.
pub(crate) fn allow_replacement(py: Python<'_>) {
    if cfg!(windows) {
        close_unused(py);
    }
}

/// Packs a folder into an FMU.
#[pyfunction]
pub(crate) fn build_fmu(py: Python<'_>, folder: PathBuf, out: PathBuf, platform: &str) -> PyResult<()> {
    let target = platform.parse::<BuildTarget>().map_err(|error| fmu_error::raise(py, &error))?;
    allow_replacement(py);
    let done = watched(py, move |cancel| fmi::pack_for(&folder, &out, target, &cancel))?;
    logs::pass_on(py)?;
    done.map_err(|e| fmu_error::raise(py, &e))
}

/// Returns the path of the FMU of a bundled model.
#[pyfunction]
pub(crate) fn example_fmu(py: Python<'_>, name: &str, version: &str, kind: &str) -> PyResult<PathBuf> {
    let kind = match (version, kind.to_ascii_uppercase().as_str()) {
        ("1.0", "ME") => ExampleKind::Fmi1ModelExchange,
        ("1.0", "CS") => ExampleKind::Fmi1CoSimulation,
        ("2.0", "ME") => ExampleKind::Fmi2ModelExchange,
        ("2.0", "CS") => ExampleKind::Fmi2CoSimulation,
        ("3.0", "ME" | "CS") => ExampleKind::Fmi3,
        _ => {
            let problem = format!(
                "no example model has version '{version}' and kind '{kind}'; expected version '1.0', '2.0' \
                 or '3.0' and kind 'ME' or 'CS'"
            );
            return Err(PyValueError::new_err(problem));
        }
    };
    let path = py.detach(|| example_models::example_fmu_as(name, kind));
    logs::pass_on(py)?;
    path.map_err(|e| fmu_error::raise(py, &e))
}

/// Returns the names of the bundled models.
#[pyfunction]
pub(crate) fn example_names() -> Vec<&'static str> {
    example_models::example_names().collect()
}

/// Removes built libraries and packed examples from the disk, and closes the FMUs kept open.
#[pyfunction]
pub(crate) fn clear_caches(py: Python<'_>) -> PyResult<()> {
    let done = py.detach(|| {
        OPEN.clear();
        fmi::clear_caches()
    });
    done.map_err(|e| fmu_error::raise(py, &e))
}
