//! The command line `fmufit`.

use std::process::ExitCode;

fn main() -> ExitCode {
    // FMUs run in processes of this same program.
    calibration::serve_if_worker();
    ExitCode::from(fmufit_cli::main(std::env::args_os()))
}
