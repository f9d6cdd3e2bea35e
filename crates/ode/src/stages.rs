//! Weighted sums of the stages of a step, many components at once.

/// The stages that have these weights, with them.
pub(crate) fn terms<'k, const S: usize>(
    weights: &'k [(usize, f64)],
    k: &'k [Vec<f64>; S],
) -> impl Iterator<Item = (f64, &'k [f64])> + Clone {
    weights.iter().map(|(j, w)| (*w, &k[*j][..]))
}

/// `out_i = finish(sum_j w_j k_j_i, x_i)`, over terms `(w_j, k_j)`: blocks of components are added up at
/// once, each component in the order of the stages as if it were alone.
#[inline(always)]
fn sums<'k>(
    out: &mut [f64],
    x: &[f64],
    terms: impl Iterator<Item = (f64, &'k [f64])> + Clone,
    finish: impl Fn(f64, f64) -> f64 + Copy,
) {
    let n = out.len();
    let mut at = 0;
    while n - at >= 8 {
        block::<8>(at, out, x, terms.clone(), finish);
        at += 8;
    }
    if n - at >= 4 {
        block::<4>(at, out, x, terms.clone(), finish);
        at += 4;
    }
    if n - at >= 2 {
        block::<2>(at, out, x, terms.clone(), finish);
        at += 2;
    }
    if n > at {
        block::<1>(at, out, x, terms, finish);
    }
}

/// The `B` components from place `at` on.
#[inline(always)]
fn block<'k, const B: usize>(
    at: usize,
    out: &mut [f64],
    x: &[f64],
    terms: impl Iterator<Item = (f64, &'k [f64])>,
    finish: impl Fn(f64, f64) -> f64,
) {
    let (Some(out), Some(x)) = (out[at..].first_chunk_mut::<B>(), x[at..].first_chunk::<B>()) else { return };
    let mut sum = [0.0; B];
    for (w, k) in terms {
        for (sum, k) in sum.iter_mut().zip(&k[at..at + B]) {
            *sum += w * k;
        }
    }
    // All before any is written: then they are made at once.
    *out = std::array::from_fn(|i| finish(sum[i], x[i]));
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
        for n in [0, 1, 2, 3, 4, 5, 7, 8, 9, 14, 24, 29] {
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
