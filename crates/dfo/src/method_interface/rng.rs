//! Random numbers with one independent stream per purpose, generation and index. A draw does not depend on
//! other draws, on the order of answers or on the number of workers.
//!
//! The generator is Philox4x32 with ten rounds (Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as
//! easy as 1, 2, 3", SC11). It maps a counter to a block of random bits and has no state.

use std::f64::consts::{PI, TAU};
use std::hash::{BuildHasher, Hasher, RandomState};

/// Purpose of a stream. Two purposes never share a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// Starting points.
    Sampling = 0,
    /// Random numbers of an individual in a generation.
    Individual = 1,
    /// Random numbers of a generation, drawn once.
    Generation = 2,
    /// Random numbers of a restart.
    Restart = 3,
    /// Seeds of the searches within a search.
    Start = 4,
}

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub(crate) struct Stream {
    key: [u32; 2],
    counter: [u32; 4],
    block: [u32; 4],
    left: usize,
}

/// Draws a seed for a run without a given seed. It differs from run to run and is reported.
pub fn draw_seed() -> u64 {
    // The keys of the standard library's hasher come from the system's random numbers. 53 bits survive every
    // number format.
    RandomState::new().build_hasher().finish() >> 11
}

/// Returns the seed of a search that starts from a point, within a search with this seed.
pub(crate) fn seed_at(seed: u64, start: &[f64]) -> u64 {
    start.iter().fold(seed, |seed, x| {
        let [low, high] = halves(x.to_bits());
        Stream::new(seed, Purpose::Start, low.into(), high as usize).bits() >> 11
    })
}

impl Stream {
    pub(crate) fn new(seed: u64, purpose: Purpose, generation: u64, index: usize) -> Self {
        let [low, high] = halves(generation);
        // The last word contains 24 bits of the generation, and the purpose: 2^56 generations.
        let counter = [0, index as u32, low, high << 8 | purpose as u32];
        Self { key: halves(seed), counter, block: [0; 4], left: 0 }
    }

    fn word(&mut self) -> u32 {
        if self.left == 0 {
            self.block = philox(self.counter, self.key);
            self.counter[0] = self.counter[0].wrapping_add(1);
            self.left = 4;
        }
        self.left -= 1;
        self.block[3 - self.left]
    }

    fn bits(&mut self) -> u64 {
        let low = self.word();
        u64::from(self.word()) << 32 | u64::from(low)
    }

    /// Returns a uniform number in [0, 1), a multiple of 2^-53.
    pub(crate) fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (0.5 * f64::EPSILON)
    }

    /// Returns a uniform number in `low..high`.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Returns true with this probability.
    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }

    /// Puts the entries into a random order, all orders equally likely (Fisher and Yates).
    pub(crate) fn shuffle<T>(&mut self, entries: &mut [T]) {
        for k in (1..entries.len()).rev() {
            entries.swap(k, self.below(k + 1));
        }
    }

    /// Returns an integer in `0..n`, all equally likely (Lemire, ACM Trans. Model. Comput. Simul. 29, 2019).
    /// Returns 0 if `n` is 0.
    pub(crate) fn below(&mut self, n: usize) -> usize {
        let n = n as u64;
        if n < 2 {
            return 0;
        }
        let threshold = n.wrapping_neg() % n;
        loop {
            let product = u128::from(self.bits()) * u128::from(n);
            if product as u64 >= threshold {
                return (product >> 64) as usize;
            }
        }
    }

    /// Returns a normally distributed number (Box and Muller 1958).
    pub(crate) fn normal(&mut self, mean: f64, deviation: f64) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        mean + deviation * radius * (TAU * self.uniform()).cos()
    }

    /// Returns a Cauchy-distributed number.
    pub(crate) fn cauchy(&mut self, location: f64, scale: f64) -> f64 {
        location + scale * (PI * (self.uniform() - 0.5)).tan()
    }
}

fn halves(v: u64) -> [u32; 2] {
    [v as u32, (v >> 32) as u32]
}

fn philox(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for _ in 0..10 {
        let [low_0, high_0] = halves(u64::from(counter[0]) * 0xD251_1F53);
        let [low_1, high_1] = halves(u64::from(counter[2]) * 0xCD9E_8D57);
        counter = [high_1 ^ counter[1] ^ key[0], low_1, high_0 ^ counter[3] ^ key[1], low_0];
        key = [key[0].wrapping_add(0x9E37_79B9), key[1].wrapping_add(0xBB67_AE85)];
    }
    counter
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn philox_matches_published_vectors() {
        // The known-answer vectors that accompany the paper (Random123).
        for (counter, key, expected) in [
            ([0; 4], [0; 2], [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]),
            ([u32::MAX; 4], [u32::MAX; 2], [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]),
            (
                [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344],
                [0xa409_3822, 0x299f_31d0],
                [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1],
            ),
        ] {
            assert_eq!(philox(counter, key), expected);
        }
    }

    #[test]
    fn streams_differ_for_each_key() {
        let first = |seed, purpose, generation, index| Stream::new(seed, purpose, generation, index).bits();
        let all = [
            first(1, Purpose::Individual, 2, 3),
            first(2, Purpose::Individual, 2, 3),
            first(1 << 32, Purpose::Individual, 2, 3),
            first(1, Purpose::Sampling, 2, 3),
            first(1, Purpose::Individual, 3, 3),
            first(1, Purpose::Individual, 2 << 32, 3),
            first(1, Purpose::Individual, 2, 4),
        ];
        for (i, a) in all.iter().enumerate() {
            assert!(all[..i].iter().all(|b| a != b), "{i}");
        }
        assert_eq!(all[0], first(1, Purpose::Individual, 2, 3));
    }

    /// Returns mean and variance of many draws.
    fn moments(mut draw: impl FnMut() -> f64) -> (f64, f64) {
        const COUNT: f64 = 40_000.0;
        let draws: Vec<f64> = (0..COUNT as usize).map(|_| draw()).collect();
        let mean = draws.iter().sum::<f64>() / COUNT;
        (mean, draws.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / COUNT)
    }

    #[test]
    fn distributions_have_expected_moments() {
        let mut s = Stream::new(7, Purpose::Individual, 0, 0);
        // Three standard deviations of the mean of 40 000 draws: 3 sigma / 200.
        let (mean, variance) = moments(|| s.uniform());
        assert!((mean - 0.5).abs() < 0.0044 && (variance - 1.0 / 12.0).abs() < 0.002, "{mean} {variance}");
        let (mean, variance) = moments(|| s.normal(2.0, 0.5));
        assert!((mean - 2.0).abs() < 0.0075 && (variance - 0.25).abs() < 0.006, "{mean} {variance}");
        let (mean, _) = moments(|| f64::from(s.cauchy(3.0, 0.1) < 3.1));
        assert!((mean - 0.75).abs() < 0.0065, "{mean}");
        let mut counts = [0; 7];
        (0..70_000).for_each(|_| counts[s.below(7)] += 1);
        assert!(counts.iter().all(|c| (9_720..10_280).contains(c)), "{counts:?}");
        assert_eq!((s.below(0), s.below(1)), (0, 0));
    }

    #[test]
    fn drawn_seeds_differ() {
        assert_ne!(draw_seed(), draw_seed());
    }
}
