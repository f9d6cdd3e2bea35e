//! A program that serves as the worker process of others: those that do not call
//! `calibration::serve_if_worker` in their own `main` name it as their [`Launcher`](fmi::worker::Launcher).

fn main() -> std::process::ExitCode {
    calibration::serve_if_worker();
    // Reached only where nobody has asked.
    std::process::ExitCode::FAILURE
}
