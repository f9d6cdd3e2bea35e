//! Arrays of small numbers inside arrays of 64-bit words. The FMU writes its own type to the front of the
//! buffer, and the elements are then expanded in place. This requires no second buffer, no allocation, and
//! one call for any number of values.

/// Types whose elements fit into a word. Any bits are a valid value. The size is at most 8 bytes, and the
/// alignment is at most the alignment of `i64`.
///
/// # Safety
/// The type satisfies the requirements above.
pub(super) unsafe trait Element: Copy {
    fn to_word(self) -> i64;
    fn from_word(word: i64) -> Self;
}

macro_rules! integers {
    ($($type:ty),+) => {
        $(
            // SAFETY: integers of at most 8 bytes have no invalid bits, and their alignment is at most the
            // alignment of i64.
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

// SAFETY: any 4 bytes are a valid float.
unsafe impl Element for f32 {
    fn to_word(self) -> i64 {
        f64::from(self).to_bits() as i64
    }
    fn from_word(word: i64) -> Self {
        f64::from_bits(word as u64) as f32
    }
}

/// Calls `call` to fill as many elements as there are words, and converts the elements to words.
pub(super) fn get<T: Element, R>(words: &mut [i64], call: impl FnOnce(*mut T) -> R) -> R {
    let base: *mut T = words.as_mut_ptr().cast();
    let code = call(base);
    // In reverse order: word i covers only elements i and above, which have already been read.
    for i in (0..words.len()).rev() {
        // SAFETY: element i ends at (i + 1) * size <= (i + 1) * 8, inside the words. It contains bits of a
        // word or bits written by the call; both are valid values of T.
        let element = unsafe { base.add(i).read() };
        // SAFETY: word i is inside the slice.
        unsafe { base.cast::<i64>().add(i).write(element.to_word()) };
    }
    code
}

/// Converts the words to an array of elements and passes it to `call`. The words are overwritten.
pub(super) fn set<T: Element, R>(words: &mut [i64], call: impl FnOnce(*const T) -> R) -> R {
    let base: *mut i64 = words.as_mut_ptr();
    // In forward order: element i ends within word i, and the words before have already been read.
    for i in 0..words.len() {
        // SAFETY: word i is inside the slice and has not been overwritten, because the elements before it end
        // at i * 8 or earlier.
        let word = unsafe { base.add(i).read() };
        // SAFETY: as for reading in `get`.
        unsafe { base.cast::<T>().add(i).write(T::from_word(word)) };
    }
    call(base.cast_const().cast())
}

/// Converts all nonzero words to 1, because every nonzero value is true.
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
            // SAFETY: `get` provides space for as many elements as there are words.
            unsafe { std::ptr::copy_nonoverlapping(stored.as_ptr(), p, stored.len()) };
            0
        });
        words
    }

    #[test]
    fn packed_integers_keep_elements_of_all_sizes() {
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
