//! A digest of numbers by their bits: tells whether two runs of a model gave the same answers.

/// Numbers of which a digest keeps its values on the way.
const KEPT: usize = 1 << 20;

/// Running digest.
#[derive(Debug)]
pub(crate) struct Digest {
    value: u64,
    /// Its value after each note, up to a number of them; only where a run may have to be compared with a shorter one.
    way: Option<Vec<u64>>,
}

/// 2^64 divided by the golden ratio, odd: multiplying with it spreads the bits (Knuth, TAOCP volume 3, 6.4).
const SPREAD: u64 = 0x9e37_79b9_7f4a_7c15;

impl Default for Digest {
    fn default() -> Self {
        Self { value: SPREAD, way: None }
    }
}

impl Digest {
    /// Takes numbers in, in their order.
    pub(crate) fn note(&mut self, values: &[f64]) {
        for value in values {
            self.value = (self.value ^ value.to_bits()).wrapping_mul(SPREAD).rotate_left(29);
        }
        if let Some(way) = self.way.as_mut().filter(|way| way.len() < KEPT) {
            way.push(self.value);
        }
    }

    /// A digest that keeps its values on the way.
    pub(crate) fn with_way() -> Self {
        Self { way: Some(Vec::new()), ..Self::default() }
    }

    /// Whether both took in the same numbers, as far as is kept; of each, whether its run was stopped and need not have come as
    /// far as the other.
    pub(crate) fn agrees(&self, other: &Digest, stopped: (bool, bool)) -> bool {
        let (Some(way), Some(others)) = (&self.way, &other.way) else { return self.value == other.value };
        let common = way.len().min(others.len());
        (stopped.0 || common == others.len())
            && (stopped.1 || common == way.len())
            && way[..common] == others[..common]
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
            let mut digest = Digest::with_way();
            values.iter().for_each(|value| digest.note(&[*value]));
            digest
        };
        let whole = along(&[1.0, 2.0, 3.0]);
        let (shorter, other) = (along(&[1.0, 2.0]), along(&[1.0, 3.0]));
        assert!(whole.agrees(&shorter, (false, true)) && whole.agrees(&along(&[]), (false, true)));
        assert!(!whole.agrees(&other, (true, true)) && !whole.agrees(&shorter, (true, false)));
        assert!(shorter.agrees(&whole, (true, false)) && !shorter.agrees(&whole, (false, true)));
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
