//! The functions of FMI 3.0 that tell when clocks tick (FMI 3.0.x, section 2.2.8.3), bound by name.

use crate::description::Interval;
use crate::error::Status;
use crate::sys::symbols::Symbols;
use crate::sys::types::{Component, IntervalAnswer, Qualifier, status};
use std::ffi::c_int;

type IntervalDecimal = unsafe extern "C" fn(Component, *const u32, usize, *mut f64, *mut c_int) -> c_int;
type IntervalFraction =
    unsafe extern "C" fn(Component, *const u32, usize, *mut u64, *mut u64, *mut c_int) -> c_int;
type SetIntervalDecimal = unsafe extern "C" fn(Component, *const u32, usize, *const f64) -> c_int;
type SetIntervalFraction =
    unsafe extern "C" fn(Component, *const u32, usize, *const u64, *const u64) -> c_int;
type ShiftDecimal = unsafe extern "C" fn(Component, *const u32, usize, *mut f64) -> c_int;
type ShiftFraction = unsafe extern "C" fn(Component, *const u32, usize, *mut u64, *mut u64) -> c_int;

pub(super) struct ClockFunctions {
    interval_decimal: Option<IntervalDecimal>,
    interval_fraction: Option<IntervalFraction>,
    set_interval_decimal: Option<SetIntervalDecimal>,
    set_interval_fraction: Option<SetIntervalFraction>,
    shift_decimal: Option<ShiftDecimal>,
    shift_fraction: Option<ShiftFraction>,
}

impl ClockFunctions {
    /// # Safety
    /// As for `Fmi3::load`.
    pub(super) unsafe fn load(symbols: &Symbols<'_>) -> Self {
        // SAFETY: each name is paired with the signature of the standard; the caller vouches for the library.
        unsafe {
            Self {
                interval_decimal: symbols.optional("fmi3GetIntervalDecimal"),
                interval_fraction: symbols.optional("fmi3GetIntervalFraction"),
                set_interval_decimal: symbols.optional("fmi3SetIntervalDecimal"),
                set_interval_fraction: symbols.optional("fmi3SetIntervalFraction"),
                shift_decimal: symbols.optional("fmi3GetShiftDecimal"),
                shift_fraction: symbols.optional("fmi3GetShiftFraction"),
            }
        }
    }

    /// # Safety
    /// As for the methods of `Binding`.
    pub(super) unsafe fn interval(
        &self,
        component: Component,
        reference: u32,
        fraction: bool,
        answer: &mut IntervalAnswer,
    ) -> Status {
        let mut qualifier = 0;
        let (result, interval) = if fraction {
            let Some(function) = self.interval_fraction else { return Status::Missing };
            let (mut counter, mut resolution) = (0, 0);
            // SAFETY: the caller's promises; each pointer leads to one value, and one reference is given.
            let code = unsafe {
                function(
                    component,
                    &raw const reference,
                    1,
                    &raw mut counter,
                    &raw mut resolution,
                    &raw mut qualifier,
                )
            };
            (code, Interval::Fraction(counter, resolution))
        } else {
            let Some(function) = self.interval_decimal else { return Status::Missing };
            let mut interval = 0.0;
            // SAFETY: as above.
            let code = unsafe {
                function(component, &raw const reference, 1, &raw mut interval, &raw mut qualifier)
            };
            (code, Interval::Decimal(interval))
        };
        answer.interval = interval;
        answer.qualifier = match qualifier {
            1 => Qualifier::Unchanged,
            2 => Qualifier::Changed,
            _ => Qualifier::NotYetKnown,
        };
        status(result)
    }

    /// # Safety
    /// As for the methods of `Binding`.
    pub(super) unsafe fn set_interval(
        &self,
        component: Component,
        reference: u32,
        interval: Interval,
    ) -> Status {
        let clock = &raw const reference;
        match interval {
            Interval::Decimal(value) => {
                let Some(function) = self.set_interval_decimal else { return Status::Missing };
                // SAFETY: the caller's promises; one reference and one value are given.
                status(unsafe { function(component, clock, 1, &raw const value) })
            }
            Interval::Fraction(counter, resolution) => {
                let Some(function) = self.set_interval_fraction else { return Status::Missing };
                // SAFETY: as above.
                status(unsafe { function(component, clock, 1, &raw const counter, &raw const resolution) })
            }
        }
    }

    /// # Safety
    /// As for the methods of `Binding`.
    pub(super) unsafe fn shift(
        &self,
        component: Component,
        reference: u32,
        fraction: bool,
        shift: &mut Interval,
    ) -> Status {
        if fraction {
            let Some(function) = self.shift_fraction else { return Status::Missing };
            let (mut counter, mut resolution) = (0, 0);
            // SAFETY: as for intervals.
            let code = unsafe {
                function(component, &raw const reference, 1, &raw mut counter, &raw mut resolution)
            };
            *shift = Interval::Fraction(counter, resolution);
            status(code)
        } else {
            let Some(function) = self.shift_decimal else { return Status::Missing };
            let mut value = 0.0;
            // SAFETY: as for intervals.
            let code = unsafe { function(component, &raw const reference, 1, &raw mut value) };
            *shift = Interval::Decimal(value);
            status(code)
        }
    }
}
