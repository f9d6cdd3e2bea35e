//! Arrays of small numbers inside of arrays of 64-bit words: the FMU writes its own type into the front of
//! the buffer, and the elements are spread out in place. No second buffer, no allocation, one call for any
//! number of values.

/// Types whose elements may lie in a word: any bits are a value, at most 8 bytes, alignment at most that of
/// `i64`.
///
/// # Safety
/// The type is as described.
pub(super) unsafe trait Element: Copy {
    fn to_word(self) -> i64;
    fn from_word(word: i64) -> Self;
}

macro_rules! integers {
    ($($type:ty),+) => {
        $(
            // SAFETY: integers of at most 8 bytes have no invalid bits, and none is aligned more strictly than i64.
            unsafe impl Element for $type {
                fn to_word(self) -> i64 {
                    self as i64
                }
                fn from_word(word: i64) -> Self {
                    word as $type
                }
            }
        )+
    };
}
integers!(i8, u8, i16, u16, i32, u32, i64, u64);

// SAFETY: any 4 bytes are a float.
unsafe impl Element for f32 {
    fn to_word(self) -> i64 {
        f64::from(self).to_bits() as i64
    }
    fn from_word(word: i64) -> Self {
        f64::from_bits(word as u64) as f32
    }
}

/// Lets `call` fill in as many elements as there are words, and makes words of them.
pub(super) fn get<T: Element, R>(words: &mut [i64], call: impl FnOnce(*mut T) -> R) -> R {
    let base: *mut T = words.as_mut_ptr().cast();
    let code = call(base);
    // From the end: word i covers elements i and above only, which have been read by then.
    for i in (0..words.len()).rev() {
        // SAFETY: element i ends at (i + 1) * size <= (i + 1) * 8, inside of the words; it holds bits of a word or what
        // the call wrote, both values of T.
        let element = unsafe { base.add(i).read() };
        // SAFETY: word i is one of them.
        unsafe { base.cast::<i64>().add(i).write(element.to_word()) };
    }
    code
}

/// Hands the words as an array of elements to `call`. The words are used up.
pub(super) fn set<T: Element, R>(words: &mut [i64], call: impl FnOnce(*const T) -> R) -> R {
    let base: *mut i64 = words.as_mut_ptr();
    // From the front: element i ends within word i, and the words below have been read by then.
    for i in 0..words.len() {
        // SAFETY: word i is one of them, and not yet written over: elements before it end at i * 8 at most.
        let word = unsafe { base.add(i).read() };
        // SAFETY: as for reading in `get`.
        unsafe { base.cast::<T>().add(i).write(T::from_word(word)) };
    }
    call(base.cast_const().cast())
}

/// Booleans are whatever is not 0.
pub(super) fn normalize(words: &mut [i64]) {
    for word in words {
        *word = i64::from(*word != 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round<T: Element>(values: &[i64]) -> Vec<i64> {
        let mut stored: Vec<T> = Vec::new();
        let mut words = values.to_vec();
        set::<T, _>(&mut words, |p| {
            // SAFETY: `set` passes as many elements as there are words.
            stored.extend_from_slice(unsafe { std::slice::from_raw_parts(p, values.len()) });
            0
        });
        let mut words = vec![-1; values.len()];
        get::<T, _>(&mut words, |p| {
            // SAFETY: `get` has room for as many elements as there are words.
            unsafe { std::ptr::copy_nonoverlapping(stored.as_ptr(), p, stored.len()) };
            0
        });
        words
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
        assert_eq!(round::<i8>(&[]), [0_i64; 0]);
    }
}
