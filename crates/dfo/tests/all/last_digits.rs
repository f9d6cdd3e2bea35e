//! Errors in the last digit of the residuals, as between the mathematical functions of two systems, must not
//! decide whether a fit ends with success.

use dfo::*;

/// Returns the finaliser of SplitMix64 (Steele, Lea and Flood, OOPSLA 2014).
fn hash(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The exponential function, wrong by at most one unit in the last place.
fn inexact_exp(x: f64, seed: u64) -> f64 {
    let y = x.exp();
    match hash(x.to_bits() ^ seed.wrapping_mul(0x9e37_79b9_7f4a_7c15)) % 3 {
        0 => y,
        1 => f64::from_bits(y.to_bits() + 1),
        _ => f64::from_bits(y.to_bits().saturating_sub(1)),
    }
}

/// Returns an approximately normal number: the sum of six uniform numbers.
fn noise(k: usize) -> f64 {
    let uniform = |k: usize| (hash(k as u64 + 1) >> 11) as f64 / 2f64.powi(52) - 1.0;
    (0..6).map(|i| uniform(6 * k + i + 1)).sum::<f64>() / 2f64.sqrt()
}

/// From one start, a few of 10 000 fits end at the minimum at an infinite rate.
#[test]
fn least_squares_succeeds_for_any_last_digits() {
    let mut n_elsewhere = 0;
    for (seed, step) in (0..60).flat_map(|seed| [0.02, 0.1, 0.2].map(|step| (seed, step))) {
        let decay = |a: f64, b: f64, k: usize| a * inexact_exp(-b * step * k as f64, seed);
        for (height, start) in [(1e3, [1.0, 1.0]), (1e5, [1.0, 1.0]), (1e5, [10.0, 0.1]), (1e4, [1.0, 3.0])] {
            let residuals = |x: &[f64], out: &mut Vec<f64>| {
                out.extend((0..50).map(|k| decay(x[0], x[1], k) - decay(height, 0.5, k) - 0.2 * noise(k)));
            };
            let report = least_squares(residuals).start(&start).run().unwrap();
            let is_right = (report.x[0] / height - 1.0).abs() < 1e-3 && (report.x[1] - 0.5).abs() < 1e-3;
            assert!(report.is_success(), "seed {seed}, step {step}, {height} {start:?}: {report}");
            n_elsewhere += usize::from(!is_right);
        }
    }
    assert!(n_elsewhere <= 2, "{n_elsewhere}");
}
