//! Arrays of small numbers inside of arrays of 64-bit lanes: the FMU writes its own type into the front of the buffer,
//! and the elements are spread out in place. No second buffer, no allocation, one call for any number of values.

use std::ffi::c_int;

/// Types whose elements may lie in a lane: any bits are a value, at most 8 bytes, alignment at most that of `i64`.
///
/// # Safety
/// The type is as described.
pub(super) unsafe trait Element: Copy {
    fn to_lane(self) -> i64;
    fn from_lane(lane: i64) -> Self;
}

macro_rules! integers {
    ($($type:ty),+) => {
        $(
            // SAFETY: integers of at most 8 bytes have no invalid bits, and none is aligned more strictly than i64.
            unsafe impl Element for $type {
                fn to_lane(self) -> i64 {
                    self as i64
                }
                fn from_lane(lane: i64) -> Self {
                    lane as $type
                }
            }
        )+
    };
}
integers!(i8, u8, i16, u16, i32, u32, i64, u64);

// SAFETY: any 4 bytes are a float.
unsafe impl Element for f32 {
    fn to_lane(self) -> i64 {
        f64::from(self).to_bits() as i64
    }
    fn from_lane(lane: i64) -> Self {
        f64::from_bits(lane as u64) as f32
    }
}

/// Lets `call` fill in as many elements as there are lanes, and makes lanes of them.
pub(super) fn get<T: Element>(lanes: &mut [i64], call: impl FnOnce(*mut T) -> c_int) -> c_int {
    let base: *mut T = lanes.as_mut_ptr().cast();
    let code = call(base);
    // From the end: lane i covers elements i and above only, which have been read by then.
    for i in (0..lanes.len()).rev() {
        // SAFETY: element i ends at (i + 1) * size <= (i + 1) * 8, inside of the lanes; it holds bits of a lane or what
        // the call wrote, both values of T.
        let element = unsafe { base.add(i).read() };
        // SAFETY: lane i is one of them.
        unsafe { base.cast::<i64>().add(i).write(element.to_lane()) };
    }
    code
}

/// Hands the lanes as an array of elements to `call`. The lanes are used up.
pub(super) fn set<T: Element>(lanes: &mut [i64], call: impl FnOnce(*const T) -> c_int) -> c_int {
    let base: *mut i64 = lanes.as_mut_ptr();
    // From the front: element i ends within lane i, and the lanes below have been read by then.
    for i in 0..lanes.len() {
        // SAFETY: lane i is one of them, and not yet written over: elements before it end at i * 8 at most.
        let lane = unsafe { base.add(i).read() };
        // SAFETY: as for reading in `get`.
        unsafe { base.cast::<T>().add(i).write(T::from_lane(lane)) };
    }
    call(base.cast_const().cast())
}

/// Booleans are whatever is not 0.
pub(super) fn normalize(lanes: &mut [i64]) {
    for lane in lanes {
        *lane = i64::from(*lane != 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round<T: Element>(values: &[i64]) -> Vec<i64> {
        let mut stored: Vec<T> = Vec::new();
        let mut lanes = values.to_vec();
        set::<T>(&mut lanes, |p| {
            // SAFETY: `set` passes as many elements as there are lanes.
            stored.extend_from_slice(unsafe { std::slice::from_raw_parts(p, values.len()) });
            0
        });
        let mut lanes = vec![-1; values.len()];
        get::<T>(&mut lanes, |p| {
            // SAFETY: `get` has room for as many elements as there are lanes.
            unsafe { std::ptr::copy_nonoverlapping(stored.as_ptr(), p, stored.len()) };
            0
        });
        lanes
    }

    #[test]
    fn elements_of_all_sizes_are_spread_and_gathered() {
        let small = [0, 1, -1, 127, -128, 5];
        assert_eq!(round::<i8>(&small), small);
        assert_eq!(round::<i16>(&[-32768, 7, 32767]), [-32768, 7, 32767]);
        assert_eq!(round::<i32>(&small), small);
        assert_eq!(round::<i64>(&[i64::MIN, 0, i64::MAX]), [i64::MIN, 0, i64::MAX]);
        assert_eq!(round::<u8>(&[0, 255, 3]), [0, 255, 3]);
        assert_eq!(round::<u32>(&[4_294_967_295, 0]), [4_294_967_295, 0]);
        assert_eq!(round::<u64>(&[-1, 0]), [-1, 0]);
        let floats: Vec<i64> = [1.5f64, -0.25, 0.0].iter().map(|x| x.to_bits() as i64).collect();
        assert_eq!(round::<f32>(&floats), floats);
        assert_eq!(round::<i8>(&[]), []);
    }
}
