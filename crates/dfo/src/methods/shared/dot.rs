//! Products of long vectors.

/// Returns the dot product as eight partial sums, which processors can add in parallel.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (eights, others) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest = eights.remainder().iter().zip(others.remainder()).map(|(a, b)| a * b).sum::<f64>();
    let mut parts = [0.0; 8];
    for (a, b) in eights.zip(others) {
        parts.iter_mut().zip(a.iter().zip(b)).for_each(|(part, (a, b))| *part += a * b);
    }
    parts.iter().sum::<f64>() + rest
}
