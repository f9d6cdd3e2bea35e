//! The locale of a thread: FMUs read and write numbers with functions of C, which take the decimal point from
//! it.

#[cfg(unix)]
mod of_thread {
    use std::sync::OnceLock;

    /// The C locale. Never freed and never changed, so that all threads may use it.
    struct Handle(libc::locale_t);

    // SAFETY: a locale object is changed by `freelocale` and by `newlocale` with it as base only; neither is called.
    unsafe impl Send for Handle {}
    // SAFETY: as for `Send`.
    unsafe impl Sync for Handle {}

    fn handle() -> libc::locale_t {
        static C: OnceLock<Handle> = OnceLock::new();
        // SAFETY: the name ends in NUL, and there is no base.
        C.get_or_init(|| Handle(unsafe { libc::newlocale(libc::LC_ALL_MASK, c"C".as_ptr(), NONE) })).0
    }

    const NONE: libc::locale_t = std::ptr::null_mut();

    /// The C locale is that of this thread, whatever that of the process is; undone on drop.
    #[derive(Debug)]
    pub(crate) struct CLocale(libc::locale_t);

    impl CLocale {
        pub(crate) fn enter() -> Self {
            // SAFETY: the handle is a locale object (or NULL, which changes nothing) and is never freed.
            Self(unsafe { libc::uselocale(handle()) })
        }
    }

    impl Drop for CLocale {
        fn drop(&mut self) {
            // SAFETY: what was the thread's locale before: an object of whoever set it, or that of the process.
            unsafe { libc::uselocale(self.0) };
        }
    }
}

#[cfg(not(unix))]
mod of_thread {
    /// Threads have no locales of their own here.
    #[derive(Debug)]
    pub(crate) struct CLocale;

    impl CLocale {
        pub(crate) fn enter() -> Self {
            Self
        }
    }
}

pub(super) use of_thread::CLocale;

#[cfg(test)]
#[cfg(all(target_os = "linux", target_env = "gnu"))]
mod tests {
    #![allow(clippy::unwrap_used, clippy::print_stderr)]
    use super::super::CallEnvironment;
    use std::ffi::CStr;
    use std::process::Command;

    fn strtod(text: &CStr) -> f64 {
        // SAFETY: the text ends in NUL, and nobody wants to know where the number ends.
        unsafe { libc::strtod(text.as_ptr(), std::ptr::null_mut()) }
    }

    #[test]
    fn calls_see_the_decimal_point_and_the_thread_keeps_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let made = Command::new("localedef")
            .args(["-c", "-i", "de_DE", "-f", "UTF-8"])
            .arg(folder.path().join("xx_XX"))
            .output();
        if !made.is_ok_and(|output| output.status.success()) {
            // No data to make it of: Debian has them in the package `locales`.
            eprintln!("SKIPPED: no locale with a decimal comma can be made here");
            return;
        }
        // SAFETY: no other test of this crate reads or writes the environment at the same time but for the compiler's
        // variables, which are not this one.
        unsafe { std::env::set_var("LOCPATH", folder.path()) };
        // SAFETY: the name ends in NUL, there is no base.
        let comma = unsafe { libc::newlocale(libc::LC_ALL_MASK, c"xx_XX".as_ptr(), std::ptr::null_mut()) };
        assert!(!comma.is_null());
        // SAFETY: a locale object that is never freed.
        let before = unsafe { libc::uselocale(comma) };
        assert_eq!((strtod(c"1,5"), strtod(c"1.5")), (1.5, 1.0));
        {
            let _environment = CallEnvironment::enter();
            assert_eq!((strtod(c"1,5"), strtod(c"1.5")), (1.0, 1.5));
            drop(CallEnvironment::enter());
            assert_eq!(strtod(c"1.5"), 1.5);
        }
        assert_eq!(strtod(c"1,5"), 1.5);
        // SAFETY: what was there.
        unsafe { libc::uselocale(before) };
        // SAFETY: as for setting it.
        unsafe { std::env::remove_var("LOCPATH") };
    }
}
