//! Registers that control the floating-point arithmetic of a thread: rounding, denormals, exceptions.

/// A floating-point mode.
///
/// Code linked with `-ffast-math` disables denormals on the thread that loads it, and some solvers change the
/// rounding.
#[derive(Debug, Clone, Copy)]
pub(super) struct FloatMode(control::Words);

impl FloatMode {
    /// Returns the mode of this thread.
    #[inline]
    pub(super) fn present() -> Self {
        Self(control::read())
    }

    /// True for round to nearest, no flushing of denormals, and no traps.
    #[inline]
    pub(super) fn is_default(&self) -> bool {
        control::is_default(self.0)
    }

    /// Sets the mode of this thread.
    pub(super) fn set(self) {
        control::write(self.0);
    }

    #[cold]
    pub(super) fn set_default() {
        control::write(control::DEFAULT);
    }
}

/// Control registers: MXCSR for SSE and AVX, the control word for x87 (`long double`).
#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
mod control {
    pub(super) type Words = (u32, u16);

    /// All exceptions masked, round to nearest, no flush-to-zero (Intel SDM volume 1, section 10.2.3). For
    /// x87 also the precision with which the system starts threads (section 8.1.5; extended, but double on
    /// Windows).
    pub(super) const DEFAULT: Words = (0x1f80, if cfg!(windows) { 0x027f } else { 0x037f });

    /// The lowest six bits of MXCSR record which exceptions have occurred. They control nothing.
    const FLAGS: u32 = 0x3f;

    #[inline]
    pub(super) fn read() -> Words {
        let (mut mxcsr, mut x87): Words = (0, 0);
        // SAFETY: STMXCSR stores 32 bits and FNSTCW 16 bits at the addresses of locals. Neither waits for
        // pending exceptions nor changes anything else.
        unsafe {
            std::arch::asm!(
                "stmxcsr [{}]", "fnstcw [{}]", in(reg) &raw mut mxcsr, in(reg) &raw mut x87,
                options(nostack, preserves_flags)
            );
        }
        (mxcsr, x87)
    }

    #[inline]
    pub(super) fn is_default((mxcsr, x87): Words) -> bool {
        (mxcsr & !FLAGS, x87) == DEFAULT
    }

    pub(super) fn write((mxcsr, x87): Words) {
        // SAFETY: LDMXCSR and FLDCW read from locals; the values are the default or were read before, so no
        // reserved bit is set. Pending x87 exceptions are cleared first, because FLDCW would raise unmasked
        // ones.
        unsafe {
            std::arch::asm!(
                "ldmxcsr [{}]", "fnclex", "fldcw [{}]", in(reg) &raw const mxcsr, in(reg) &raw const x87,
                options(nostack, readonly)
            );
        }
    }
}

#[cfg(target_arch = "aarch64")]
mod control {
    pub(super) type Words = u64;
    /// FPCR: round to nearest, no flush-to-zero, no traps.
    pub(super) const DEFAULT: Words = 0;

    #[inline]
    pub(super) fn read() -> Words {
        let word: Words;
        // SAFETY: reading FPCR has no effect.
        unsafe { std::arch::asm!("mrs {}, fpcr", out(reg) word, options(nomem, nostack, preserves_flags)) };
        word
    }

    #[inline]
    pub(super) fn is_default(word: Words) -> bool {
        word == DEFAULT
    }

    pub(super) fn write(word: Words) {
        // SAFETY: the value is the default or was read before.
        unsafe { std::arch::asm!("msr fpcr, {}", in(reg) word, options(nostack, preserves_flags)) };
    }
}

#[cfg(not(any(target_arch = "x86", target_arch = "x86_64", target_arch = "aarch64")))]
mod control {
    pub(super) type Words = ();
    pub(super) const DEFAULT: Words = ();
    pub(super) fn read() {}
    pub(super) fn is_default((): Words) -> bool {
        true
    }
    pub(super) fn write((): Words) {}
}

#[cfg(all(test, any(target_arch = "x86", target_arch = "x86_64")))]
mod tests {
    use super::super::{Inside, set_float_mode};
    use super::*;
    use crate::fair_lock::FairLock;
    use std::sync::Arc;

    fn is_same(a: FloatMode, b: FloatMode) -> bool {
        (a.0.0 & 0xffc0, a.0.1) == (b.0.0 & 0xffc0, b.0.1)
    }

    #[test]
    fn inside_sets_default_float_mode_and_restores_previous_one() {
        let lock = Arc::new(FairLock::default());
        let before = FloatMode::present();
        // Flush to zero, denormals are zero; x87 rounds up in double precision.
        let theirs = FloatMode((0x9fc0, 0x0a7f));
        // All exceptions unmasked, and some of them pending.
        let unmasked = FloatMode((0x003f, 0x0340));
        theirs.set();
        assert!(is_same(FloatMode::present(), theirs));
        {
            let _inside = Inside::enter(&lock);
            assert!(FloatMode::present().is_default());
            assert!(std::hint::black_box(f64::MIN_POSITIVE) / std::hint::black_box(4.0) > 0.0);
            let nested = Inside::enter(&lock);
            theirs.set();
            drop(nested);
            assert!(FloatMode::present().is_default());
            unmasked.set();
            set_float_mode();
            assert!(FloatMode::present().is_default());
            assert!(std::hint::black_box(1.0) / std::hint::black_box(0.0) > 1.0);
            assert!(Inside::enter_for_call(&lock).is_none());
            unmasked.set();
        }
        assert!(is_same(FloatMode::present(), theirs));
        {
            // A call without an enclosing guard.
            let call = Inside::enter_for_call(&lock);
            assert!(call.is_some() && FloatMode::present().is_default());
            unmasked.set();
        }
        assert!(is_same(FloatMode::present(), theirs));
        before.set();
    }
}
