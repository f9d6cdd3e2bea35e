//! A digest of numbers by their bits: tells whether two runs of a model gave the same answers.

/// Notes after which a digest keeps its value.
const KEPT: usize = 1 << 12;

/// Running digest.
#[derive(Debug)]
pub(crate) struct Digest {
    value: u64,
    /// Its value after each of the first notes.
    way: Vec<u64>,
}

/// 2^64 divided by the golden ratio, odd: multiplying with it spreads the bits (Knuth, TAOCP volume 3, 6.4).
const SPREAD: u64 = 0x9e37_79b9_7f4a_7c15;

impl Default for Digest {
    fn default() -> Self {
        Self { value: SPREAD, way: Vec::new() }
    }
}

impl Digest {
    /// Takes numbers in, in their order.
    pub(crate) fn note(&mut self, values: &[f64]) {
        for value in values {
            self.value = (self.value ^ value.to_bits()).wrapping_mul(SPREAD).rotate_left(29);
        }
        if self.way.len() < KEPT {
            self.way.push(self.value);
        }
    }

    /// True if both contain the same numbers, up to the last of the notes kept by the one with fewer of them.
    pub(crate) fn begins_as(&self, other: &Digest) -> bool {
        self.way.iter().zip(&other.way).all(|(one, other)| one == other)
    }

    /// The digest so far.
    pub(crate) fn value(&self) -> u64 {
        self.value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(values: &[f64]) -> u64 {
        let mut digest = Digest::default();
        digest.note(values);
        digest.value()
    }

    #[test]
    fn a_shorter_run_is_compared_up_to_its_end() {
        let along = |values: &[f64]| {
            let mut digest = Digest::default();
            values.iter().for_each(|value| digest.note(&[*value]));
            digest
        };
        let (whole, shorter) = (along(&[1.0, 2.0, 3.0]), along(&[1.0, 2.0]));
        assert!(whole.begins_as(&shorter) && shorter.begins_as(&whole) && whole.begins_as(&along(&[])));
        assert!(!whole.begins_as(&along(&[1.0, 3.0])));
    }

    #[test]
    fn every_bit_and_the_order_count() {
        assert_eq!(of(&[1.0, 2.0]), of(&[1.0, 2.0]));
        assert_ne!(of(&[1.0, 2.0]), of(&[2.0, 1.0]));
        assert_ne!(of(&[0.0]), of(&[-0.0]));
        assert_ne!(of(&[1.0]), of(&[1.0 + f64::EPSILON]));
        assert_ne!(of(&[]), of(&[0.0]));
    }
}
