//! Libraries that the dynamic linker loads ahead of a program (`LD_PRELOAD`, see ld.so(8)) and that serve
//! before its `main`.

/// Runs a function before the `main` of a program ahead of which this library was loaded to serve as a worker
/// process (see `worker::Launcher`); elsewhere it does nothing. Python, for example, takes
/// milliseconds to start, of which a worker needs nothing.
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

/// Variable of the environment with the libraries that are loaded ahead of a program.
pub(crate) const PRELOAD: &str = "LD_PRELOAD";

/// Variable with the value that it had before the library that serves was added.
pub(crate) const PRELOADED_BEFORE: &str = "FMUFIT_WORKER_PRELOADED_BEFORE";

/// True if a library of this process was loaded ahead of its program to serve. Before the program's `main`;
/// the process is from then on what Rust expects of one, and its environment that which it would have
/// without.
#[cfg(target_os = "linux")]
#[doc(hidden)]
pub fn is_loaded_to_serve() -> bool {
    use std::env::{remove_var, set_var, var_os};
    let (Some(before), Some(_)) = (var_os(PRELOADED_BEFORE), var_os(PRELOAD)) else { return false };
    // SAFETY: numbers only. A write to a closed pipe is an error, as in every Rust program, not the end.
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
