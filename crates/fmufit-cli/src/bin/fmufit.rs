//! The command line `fmufit`.

use std::process::ExitCode;

fn main() -> ExitCode {
    // The processes in which FMUs run are this program, too.
    calibration::serve_if_worker();
    ExitCode::from(fmufit_cli::main(std::env::args_os()))
}
