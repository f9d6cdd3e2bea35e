//! What differs between systems and processors in this room: how a library is opened, and the floating-point mode.

use crate::open_options::LoaderOptions;
use std::path::Path;

/// Never closed: a thread that has called the FMU may hold data of its own for it (thread-specific data, `thread_local`
/// of C++) whose destructor is code of the library and runs when the thread ends. An open library also keeps its file's
/// place on the disk from being given to another file, for which the loader would take that one's code.
#[cfg(unix)]
pub(super) type Handle = std::mem::ManuallyDrop<libloading::os::unix::Library>;
#[cfg(not(unix))]
pub(super) type Handle = libloading::Library;

/// `RTLD_DEEPBIND` of glibc (`dlfcn.h`), where there is such a flag.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const DEEPBIND: Option<std::ffi::c_int> = Some(8);
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
const DEEPBIND: Option<std::ffi::c_int> = None;

/// Whether the loader can do what is asked of it; else the option that it does not have.
pub(super) fn check(options: &LoaderOptions) -> Result<(), &'static str> {
    match options {
        LoaderOptions { deepbind: true, .. } if DEEPBIND.is_none() => Err("deepbind"),
        LoaderOptions { lazy: true, .. } if cfg!(not(unix)) => Err("lazy"),
        _ => Ok(()),
    }
}

/// Opens a shared library and offers none of its symbols to other libraries.
///
/// # Safety
/// Runs the library's constructors, which is foreign code.
#[cfg(unix)]
pub(super) unsafe fn open(path: &Path, options: &LoaderOptions) -> Result<Handle, libloading::Error> {
    use libloading::os::unix::{RTLD_LAZY, RTLD_LOCAL, RTLD_NOW};
    let when = if options.lazy { RTLD_LAZY } else { RTLD_NOW };
    let deep = DEEPBIND.filter(|_| options.deepbind).unwrap_or(0);
    // SAFETY: handed on to the caller.
    unsafe { libloading::os::unix::Library::open(Some(path), when | RTLD_LOCAL | deep) }
        .map(std::mem::ManuallyDrop::new)
}

/// Opens a shared library.
///
/// # Safety
/// Runs the library's constructors, which is foreign code.
#[cfg(not(unix))]
pub(super) unsafe fn open(path: &Path, _: &LoaderOptions) -> Result<Handle, libloading::Error> {
    // SAFETY: handed on to the caller.
    unsafe { Handle::new(path) }
}

/// Sets the floating-point control register of this thread to its default (round to nearest, no flushing of
/// denormals, no traps), and puts the old value back on drop.
///
/// Code linked with `-ffast-math` switches denormals off for the thread that loads it; without this guard the result
/// of a simulation would depend on which thread ran it.
#[derive(Debug)]
pub(crate) struct FloatEnvironment {
    saved: control::Word,
    /// The register belongs to the thread.
    _not_send: std::marker::PhantomData<*const ()>,
}

impl FloatEnvironment {
    /// Remembers the present mode and sets the default.
    pub(crate) fn standard() -> Self {
        let saved = control::read();
        let guard = Self { saved, _not_send: std::marker::PhantomData };
        guard.assert();
        guard
    }

    /// Sets the default again, after calls that may have changed it.
    pub(crate) fn assert(&self) {
        control::write(control::DEFAULT);
    }
}

impl Drop for FloatEnvironment {
    fn drop(&mut self) {
        control::write(self.saved);
    }
}

#[cfg(target_arch = "x86_64")]
mod control {
    pub(super) type Word = u32;
    /// All exceptions masked, round to nearest, no flush-to-zero (Intel SDM volume 1, section 10.2.3).
    pub(super) const DEFAULT: Word = 0x1f80;

    pub(super) fn read() -> Word {
        let mut word: Word = 0;
        // SAFETY: STMXCSR stores 32 bits at the address given, which is that of a local.
        unsafe { std::arch::asm!("stmxcsr [{}]", in(reg) &raw mut word, options(nostack, preserves_flags)) };
        word
    }

    pub(super) fn write(word: Word) {
        // SAFETY: LDMXCSR reads 32 bits from a local; the value is the default or one that was read before, so no
        // reserved bit is set.
        unsafe {
            std::arch::asm!("ldmxcsr [{}]", in(reg) &raw const word, options(nostack, readonly, preserves_flags))
        };
    }
}

#[cfg(target_arch = "aarch64")]
mod control {
    pub(super) type Word = u64;
    /// FPCR: round to nearest, no flush-to-zero, no traps.
    pub(super) const DEFAULT: Word = 0;

    pub(super) fn read() -> Word {
        let word: Word;
        // SAFETY: reading FPCR has no effect.
        unsafe { std::arch::asm!("mrs {}, fpcr", out(reg) word, options(nomem, nostack, preserves_flags)) };
        word
    }

    pub(super) fn write(word: Word) {
        // SAFETY: the value is the default or one that was read before.
        unsafe { std::arch::asm!("msr fpcr, {}", in(reg) word, options(nostack, preserves_flags)) };
    }
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
mod control {
    pub(super) type Word = ();
    pub(super) const DEFAULT: Word = ();
    pub(super) fn read() {}
    pub(super) fn write((): Word) {}
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;

    #[test]
    fn the_guard_sets_the_default_and_restores_what_was_there() {
        let before = control::read();
        control::write(before | 0x8040); // flush to zero, denormals are zero
        let flushed = control::read();
        {
            let guard = FloatEnvironment::standard();
            assert_eq!(control::read() & 0xffc0, control::DEFAULT & 0xffc0);
            assert!(std::hint::black_box(f64::MIN_POSITIVE) / std::hint::black_box(4.0) > 0.0);
            control::write(flushed);
            guard.assert();
            assert_eq!(control::read() & 0xffc0, control::DEFAULT & 0xffc0);
        }
        assert_eq!(control::read() & 0xffc0, flushed & 0xffc0);
        control::write(before);
    }
}
