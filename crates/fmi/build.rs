//! Compiles the C shim that FMI's variadic logger needs (see `src/sys/callbacks.rs`).

fn main() {
    println!("cargo::rerun-if-changed=src/sys/logger.c");
    // _FORTIFY_SOURCE makes printf abort on some format strings; a log message must never end the process.
    cc::Build::new().file("src/sys/logger.c").flag_if_supported("-U_FORTIFY_SOURCE").compile("fmufit_logger");
}
