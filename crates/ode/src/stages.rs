//! The stages of a step and their weighted sums, computed for a block of components at once.

/// Components added at once: two registers of two numbers.
const WIDTH: usize = 4;

type Block = [f64; WIDTH];

/// `S` vectors of `n` numbers each, in blocks. The last block of a vector is padded with zeros.
#[derive(Debug, Default)]
pub(crate) struct Stages<const S: usize> {
    blocks: Vec<Block>,
    /// Number of blocks per vector.
    per_stage: usize,
    n: usize,
}

impl<const S: usize> Stages<S> {
    /// Allocates zero vectors for `n` states.
    pub(crate) fn begin(&mut self, n: usize) {
        (self.n, self.per_stage) = (n, n.div_ceil(WIDTH));
        self.blocks.clear();
        self.blocks.resize(S * self.per_stage, [0.0; WIDTH]);
    }

    /// Vector of a stage.
    #[inline]
    pub(crate) fn get(&self, stage: usize) -> &[f64] {
        let begin = WIDTH * self.per_stage * stage;
        &self.blocks.as_flattened()[begin..begin + self.n]
    }

    /// Mutable vector of a stage.
    #[inline]
    pub(crate) fn get_mut(&mut self, stage: usize) -> &mut [f64] {
        let begin = WIDTH * self.per_stage * stage;
        &mut self.blocks.as_flattened_mut()[begin..begin + self.n]
    }

    /// Copies the vector of one stage to another stage.
    #[inline]
    pub(crate) fn copy(&mut self, from: usize, to: usize) {
        let per_stage = self.per_stage;
        for i in 0..per_stage {
            self.blocks[to * per_stage + i] = self.blocks[from * per_stage + i];
        }
    }

    /// Computes `out_i = finish(sum_j w_j k_j_i, x_i)` from terms `(j, w_j)`. Each component is added in the
    /// order of the terms.
    #[inline(always)]
    pub(crate) fn combine(
        &self,
        out: &mut [f64],
        x: &[f64],
        terms: impl Iterator<Item = (usize, f64)> + Clone,
        finish: impl Fn(f64, f64) -> f64 + Copy,
    ) {
        if let (1, Some(blocks)) = (self.per_stage, self.blocks.first_chunk::<S>()) {
            // The constants let the compiler omit index multiplications and bounds checks.
            return put(0, out, x, &total(blocks, 1, 0, terms), finish);
        }
        for block in 0..self.per_stage {
            put(block, out, x, &total(&self.blocks, self.per_stage, block, terms.clone()), finish);
        }
    }
}

/// Computes the sum of the terms in a block.
#[inline(always)]
fn total(
    blocks: &[Block],
    per_stage: usize,
    block: usize,
    terms: impl Iterator<Item = (usize, f64)>,
) -> Block {
    let mut sum = [0.0; WIDTH];
    for (j, w) in terms {
        let k = &blocks[j * per_stage + block];
        for (sum, k) in sum.iter_mut().zip(k) {
            *sum += w * k;
        }
    }
    sum
}

/// Writes the results of `finish` to the components of a block. The last block may be short.
#[inline(always)]
fn put(block: usize, out: &mut [f64], x: &[f64], sum: &Block, finish: impl Fn(f64, f64) -> f64) {
    let (out, x) = (&mut out[WIDTH * block..], &x[WIDTH * block..]);
    match (out.first_chunk_mut::<WIDTH>(), x.first_chunk::<WIDTH>()) {
        // All results are computed before any is written, so that the compiler can vectorize them.
        (Some(out), Some(x)) => *out = std::array::from_fn(|i| finish(sum[i], x[i])),
        _ => out.iter_mut().zip(x).zip(sum).for_each(|((out, x), sum)| *out = finish(*sum, *x)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks and the remaining components give bit-for-bit the same results as separate components.
    #[test]
    fn blocked_sums_equal_componentwise_sums() {
        let wave = |a: f64, n| (0..n).map(|i| (a * (i as f64 + 0.3)).sin()).collect::<Vec<f64>>();
        let weights = [0.1, -2.7, 1e-9];
        for n in [0, 1, 2, 3, 4, 5, 7, 8, 9, 14, 24, 29] {
            let (x, k) = (wave(1.0, n), [wave(0.7, n), wave(3.1, n), wave(-0.2, n)]);
            let mut stages = Stages::<4>::default();
            stages.begin(n);
            for (stage, k) in k.iter().enumerate() {
                stages.get_mut(stage).copy_from_slice(k);
            }
            let terms = weights.iter().copied().enumerate();
            let (mut at, mut sum) = (vec![f64::NAN; n], vec![f64::NAN; n]);
            stages.combine(&mut at, &x, terms.clone(), |sum, x| x + 0.01 * sum);
            stages.combine(&mut sum, &x, terms, |sum, _| 0.01 * sum);
            for i in 0..n {
                let alone = 0.0 + weights[0] * k[0][i] + weights[1] * k[1][i] + weights[2] * k[2][i];
                assert_eq!((at[i], sum[i]), (x[i] + 0.01 * alone, 0.01 * alone));
            }
            stages.copy(1, 3);
            assert_eq!(stages.get(3), &k[1][..]);
        }
    }
}
