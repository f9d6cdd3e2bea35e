//! A digest of numbers by their bits: tells whether two runs of a model gave the same answers.

/// Running digest.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Digest(u64);

/// 2^64 divided by the golden ratio, odd: multiplying with it spreads the bits (Knuth, TAOCP volume 3, 6.4).
const SPREAD: u64 = 0x9e37_79b9_7f4a_7c15;

impl Default for Digest {
    fn default() -> Self {
        Self(SPREAD)
    }
}

impl Digest {
    /// Takes numbers in, in their order.
    pub(crate) fn note(&mut self, values: &[f64]) {
        for value in values {
            self.0 = (self.0 ^ value.to_bits()).wrapping_mul(SPREAD).rotate_left(29);
        }
    }

    /// The digest so far.
    pub(crate) fn value(self) -> u64 {
        self.0
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
    fn every_bit_and_the_order_count() {
        assert_eq!(of(&[1.0, 2.0]), of(&[1.0, 2.0]));
        assert_ne!(of(&[1.0, 2.0]), of(&[2.0, 1.0]));
        assert_ne!(of(&[0.0]), of(&[-0.0]));
        assert_ne!(of(&[1.0]), of(&[1.0 + f64::EPSILON]));
        assert_ne!(of(&[]), of(&[0.0]));
    }
}
