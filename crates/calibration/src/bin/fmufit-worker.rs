//! A program that serves as the worker process of programs that do not call `calibration::serve_if_worker` in
//! their own `main`. They specify it as their [`Launcher`](fmi::worker::Launcher).

fn main() -> std::process::ExitCode {
    calibration::serve_if_worker();
    // Reached only if this program was not started as a worker.
    std::process::ExitCode::FAILURE
}
