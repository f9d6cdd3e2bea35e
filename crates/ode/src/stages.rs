//! Weighted sums of the stages of a step, many components at once.

/// So many components are added up at once, each in the order of the stages as if it were alone.
const BLOCK: usize = 8;

/// The stages that have these weights, with them.
pub(crate) fn terms<'k, const S: usize>(
    weights: &'k [(usize, f64)],
    k: &'k [Vec<f64>; S],
) -> impl Iterator<Item = (f64, &'k [f64])> + Clone {
    weights.iter().map(|(j, w)| (*w, &k[*j][..]))
}

/// `out_i = finish(sum_j w_j k_j_i, x_i)`, over terms `(w_j, k_j)`.
#[inline(always)]
fn sums<'k>(
    out: &mut [f64],
    x: &[f64],
    terms: impl Iterator<Item = (f64, &'k [f64])> + Clone,
    finish: impl Fn(f64, f64) -> f64,
) {
    let whole = out.len() - out.len() % BLOCK;
    let (blocks, rest) = out.split_at_mut(whole);
    for (b, (out, x)) in blocks.chunks_exact_mut(BLOCK).zip(x.chunks_exact(BLOCK)).enumerate() {
        let mut sum = [0.0; BLOCK];
        for (w, k) in terms.clone() {
            for (sum, k) in sum.iter_mut().zip(&k[b * BLOCK..][..BLOCK]) {
                *sum += w * k;
            }
        }
        for ((o, x), sum) in out.iter_mut().zip(x).zip(sum) {
            *o = finish(sum, *x);
        }
    }
    for (i, (o, x)) in rest.iter_mut().zip(&x[whole..]).enumerate() {
        let mut sum = 0.0;
        for (w, k) in terms.clone() {
            sum += w * k[whole + i];
        }
        *o = finish(sum, *x);
    }
}

/// `out = x + h * sum_j w_j k_j`.
#[inline(always)]
pub(crate) fn combine<'k>(
    out: &mut [f64],
    x: &[f64],
    h: f64,
    terms: impl Iterator<Item = (f64, &'k [f64])> + Clone,
) {
    sums(out, x, terms, |sum, x| x + h * sum);
}

/// `out = factor * sum_j w_j k_j`.
#[inline(always)]
pub(crate) fn weighted_sum<'k>(
    out: &mut [f64],
    factor: f64,
    terms: impl Iterator<Item = (f64, &'k [f64])> + Clone,
) {
    // There is nothing to add to.
    let n = out.len();
    let Some((_, any)) = terms.clone().next() else { return out.fill(0.0) };
    sums(out, &any[..n], terms, |sum, _| factor * sum);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks and what is left of them give the same bits as components alone.
    #[test]
    fn components_do_not_see_each_other() {
        let wave = |a: f64, n| (0..n).map(|i| (a * (i as f64 + 0.3)).sin()).collect::<Vec<f64>>();
        let weights = [0.1, -2.7, 1e-9];
        for n in [0, 1, 7, 8, 9, 24, 29] {
            let (x, k) = (wave(1.0, n), [wave(0.7, n), wave(3.1, n), wave(-0.2, n)]);
            let terms = weights.iter().copied().zip(k.iter().map(Vec::as_slice));
            let (mut at, mut sum) = (vec![f64::NAN; n], vec![f64::NAN; n]);
            combine(&mut at, &x, 0.01, terms.clone());
            weighted_sum(&mut sum, 0.01, terms);
            for i in 0..n {
                let alone = 0.0 + weights[0] * k[0][i] + weights[1] * k[1][i] + weights[2] * k[2][i];
                assert_eq!((at[i], sum[i]), (x[i] + 0.01 * alone, 0.01 * alone));
            }
        }
        let mut out = [1.0; 3];
        weighted_sum(&mut out, 2.0, std::iter::empty());
        assert_eq!(out, [0.0; 3]);
    }
}
