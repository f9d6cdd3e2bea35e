//! Libraries that the dynamic linker loads before a program (`LD_PRELOAD`, see ld.so(8)) and that run a
//! worker before its `main`.

/// Runs a function before the `main` of a program if this library was preloaded to serve as a worker process
/// (see `worker::Launcher`), and does nothing otherwise. A worker thus starts without the program: for
/// example, starting Python takes milliseconds, and a worker does not need Python.
#[macro_export]
macro_rules! serve_before_main {
    ($serve:path) => {
        #[cfg(target_os = "linux")]
        const _: () = {
            extern "C" fn start() {
                if $crate::is_loaded_to_serve() {
                    $serve();
                }
            }

            // SAFETY: the functions in this section are called once, by the dynamic linker (System V ABI, chapter 5).
            #[unsafe(link_section = ".init_array")]
            #[used]
            static START: extern "C" fn() = start;
        };
    };
}

/// Environment variable with the libraries that are loaded before a program.
pub(crate) const PRELOAD: &str = "LD_PRELOAD";

/// Environment variable with the value of `LD_PRELOAD` before the serving library was added.
pub(crate) const PRELOADED_BEFORE: &str = "FMUFIT_WORKER_PRELOADED_BEFORE";

/// True if a library of this process was preloaded to serve. Must be called before the program's `main`. Sets
/// up the process as Rust expects it, and restores the environment to its state without preloading.
#[cfg(target_os = "linux")]
#[doc(hidden)]
pub fn is_loaded_to_serve() -> bool {
    use std::env::{remove_var, set_var, var_os};
    let (Some(before), Some(_)) = (var_os(PRELOADED_BEFORE), var_os(PRELOAD)) else { return false };
    // SAFETY: the arguments are numbers. A write to a closed pipe becomes an error, as in every Rust program,
    // and does not end the process.
    unsafe { libc::signal(libc::SIGPIPE, libc::SIG_IGN) };
    // SAFETY: before `main` there is no other thread that could read the environment.
    unsafe {
        remove_var(PRELOADED_BEFORE);
        remove_var(PRELOAD);
        if !before.is_empty() {
            set_var(PRELOAD, before);
        }
    }
    true
}
