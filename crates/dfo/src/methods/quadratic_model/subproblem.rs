//! The step of a quadratic model within a ball and a box.

use super::model::Quadratic;
use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Maximum number of Newton steps for the multiplier of the ball. A few are enough.
const MOST_STEPS: usize = 60;
/// Maximum number of sweeps per eigenvalue. A few are enough.
const MOST_SWEEPS: usize = 1000;

/// Region of steps from the base point: `|s| <= radius`, `lower <= s <= upper`, which includes zero.
#[derive(Debug, Clone, Copy)]
pub(super) struct Region<'a> {
    pub(super) radius: f64,
    pub(super) lower: &'a [f64],
    pub(super) upper: &'a [f64],
}

/// Solution for the free coordinates in the ball alone, and its Lagrange multiplier.
pub(super) struct Part {
    pub(super) p: DVector<f64>,
    pub(super) multiplier: f64,
}

/// Returns the step in the region that (nearly) minimises a model.
///
/// In the ball alone, the problem is solved exactly (Moré and Sorensen, SIAM J. Sci. Stat. Comput. 4, 1983)
/// with the eigenvalues of the Hessian. If the solution leaves the box, the coordinate that reaches its bound
/// first is fixed there. The remaining problem is then solved again. A fixed coordinate is released if the
/// slope at the end of the step leads back inside.
pub(super) fn minimize(model: &Quadratic, region: Region<'_>) -> Vec<f64> {
    let n = model.gradient.len();
    let Region { radius, lower, upper } = region;
    // Scale to avoid overflow.
    let largest = model.gradient.iter().chain(&model.hessian).fold(0.0f64, |m, v| m.max(v.abs()));
    if !(largest > 0.0 && largest.is_finite()) {
        return vec![0.0; n];
    }
    let g: Vec<f64> = model.gradient.iter().map(|g| g / largest).collect();
    let b = DMatrix::from_iterator(n, n, model.hessian.iter().map(|b| b / largest));
    let mut fixed: Vec<Option<f64>> = (0..n)
        .map(|k| {
            let blocked = (lower[k] >= 0.0 && g[k] >= 0.0) || (upper[k] <= 0.0 && g[k] <= 0.0);
            blocked.then_some(0.0)
        })
        .collect();
    let mut best = (vec![0.0; n], 0.0);
    let mut released = vec![false; n];
    for _ in 0..=3 * n {
        let free: Vec<usize> = (0..n).filter(|&k| fixed[k].is_none()).collect();
        let mut s: Vec<f64> = fixed.iter().map(|f| f.unwrap_or(0.0)).collect();
        let left = radius * radius - s.iter().map(|s| s * s).sum::<f64>();
        let slope = |s: &[f64], k: usize| g[k] + (0..n).map(|j| b[(k, j)] * s[j]).sum::<f64>();
        let mut part = None;
        if left > 0.0 && !free.is_empty() {
            let hessian = DMatrix::from_fn(free.len(), free.len(), |i, j| b[(free[i], free[j])]);
            let gradient = DVector::from_iterator(free.len(), free.iter().map(|&k| slope(&s, k)));
            part = within_ball(hessian, &gradient, left.sqrt());
        }
        let share = |k: usize, p: f64| {
            let bound = if p > 0.0 { upper[k] } else { lower[k] };
            if p != 0.0 && bound / p < 1.0 { bound / p } else { 1.0 }
        };
        let (mut first, mut multiplier) = (1.0, 0.0);
        if let Some(part) = &part {
            multiplier = part.multiplier;
            first = free.iter().zip(part.p.iter()).map(|(&k, p)| share(k, *p)).fold(1.0, f64::min);
            free.iter().zip(part.p.iter()).for_each(|(&k, p)| s[k] = (first * p).clamp(lower[k], upper[k]));
        }
        let value = model.value(&s);
        if value < best.1 {
            best = (s.clone(), value);
        }
        if first < 1.0 {
            let p = part.as_ref().map(|part| &part.p);
            for (&k, p) in free.iter().zip(p.into_iter().flat_map(|p| p.iter())) {
                if share(k, *p) <= first {
                    fixed[k] = Some(if *p > 0.0 { upper[k] } else { lower[k] });
                }
            }
            continue;
        }
        // A bound is released if the slope there leads back inside.
        let pull = |k: usize| {
            let slope = slope(&s, k) + multiplier * s[k];
            let at = fixed[k]?;
            let inward = if at >= upper[k] && upper[k] > lower[k] { slope } else { -slope };
            (inward > 0.0 && !released[k]).then_some((k, inward))
        };
        let worst = (0..n).filter_map(pull).fold(None, |worst: Option<(usize, f64)>, pull| match worst {
            Some(worst) if worst.1 >= pull.1 => Some(worst),
            _ => Some(pull),
        });
        let Some((k, _)) = worst else { break };
        fixed[k] = None;
        released[k] = true;
    }
    best.0
}

/// Returns the step that minimises the model within `|p| <= radius`.
pub(super) fn within_ball(hessian: DMatrix<f64>, gradient: &DVector<f64>, radius: f64) -> Option<Part> {
    let n = gradient.len();
    let SymmetricEigen { eigenvectors, eigenvalues } =
        SymmetricEigen::try_new(hessian, f64::EPSILON, MOST_SWEEPS * n)?;
    let g = eigenvectors.tr_mul(gradient);
    let (place, least) = eigenvalues
        .iter()
        .enumerate()
        .fold((0, f64::INFINITY), |least, (k, v)| if *v < least.1 { (k, *v) } else { least });
    let span = eigenvalues.amax();
    let at = |multiplier: f64| {
        DVector::from_iterator(
            n,
            eigenvalues
                .iter()
                .zip(g.iter())
                .map(|(v, g)| if *g == 0.0 { 0.0 } else { -g / (v + multiplier) }),
        )
    };
    if least > f64::EPSILON * span {
        let p = at(0.0);
        if p.norm() <= radius {
            return Some(Part { p: &eigenvectors * p, multiplier: 0.0 });
        }
    }
    // Newton's method on 1 / |p|, started at the left end of the interval where |p| decreases, with
    // bracketing.
    let low_end = (-least).max(0.0);
    let (mut low, mut high) = (low_end, low_end + g.norm() / radius);
    let mut multiplier = low + 1e-3 * (high - low);
    let mut p = at(multiplier);
    for _ in 0..MOST_STEPS {
        let norm = p.norm();
        if !norm.is_finite() || norm > radius {
            low = multiplier
        } else {
            high = multiplier
        }
        if (norm / radius - 1.0).abs() < 1e-6 || high - low <= f64::EPSILON * high {
            break;
        }
        let slope: f64 = p.iter().zip(eigenvalues.iter()).map(|(p, v)| p * p / (v + multiplier)).sum();
        let next = multiplier + (norm / radius - 1.0) * norm * norm / slope;
        multiplier = if next > low && next < high { next } else { 0.5 * (low + high) };
        p = at(multiplier);
    }
    let norm = p.norm();
    if !norm.is_finite() {
        return None;
    }
    if norm > radius {
        p *= radius / norm;
    } else if norm < 0.999 * radius {
        // Hard case: the gradient has no component along the smallest eigenvalue.
        let rest = (radius * radius - norm * norm).sqrt();
        p[place] += if p[place] < 0.0 { -rest } else { rest };
        let norm = p.norm();
        p *= radius / norm;
    }
    Some(Part { p: &eigenvectors * p, multiplier })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns pseudo-random numbers from -0.5 to 0.5 (Knuth's MMIX constants).
    fn random(state: &mut u64) -> f64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    }

    #[test]
    fn minimize_finds_nearly_the_best_step_of_the_region() {
        let mut state = 7;
        for case in 0..200 {
            let n = 1 + case % 4;
            let gradient: Vec<f64> = (0..n).map(|_| random(&mut state)).collect();
            // Convex, because a nonconvex model may have several minima in the box.
            let root = DMatrix::from_fn(n, n, |_, _| 2.0 * random(&mut state));
            let hessian = (&root * root.transpose()).iter().copied().collect();
            let model = Quadratic { gradient, hessian };
            let lower: Vec<f64> =
                (0..n).map(|k| if (case + k) % 3 == 0 { 0.0 } else { random(&mut state) - 0.5 }).collect();
            let upper: Vec<f64> =
                (0..n).map(|k| if (case + k) % 5 == 1 { 0.0 } else { random(&mut state) + 0.5 }).collect();
            let region = Region { radius: 0.7, lower: &lower, upper: &upper };
            let s = minimize(&model, region);
            let inside = |s: &[f64]| (0..n).all(|k| lower[k] <= s[k] && s[k] <= upper[k]);
            assert!(inside(&s) && s.iter().map(|v| v * v).sum::<f64>().sqrt() <= 0.7 * (1.0 + 1e-9));
            let value = model.value(&s);
            let mut least = 0.0f64;
            for _ in 0..2000 {
                let mut t: Vec<f64> =
                    (0..n).map(|k| (1.4 * random(&mut state)).clamp(lower[k], upper[k])).collect();
                let length = t.iter().map(|v| v * v).sum::<f64>().sqrt();
                t.iter_mut().for_each(|v| *v *= (0.7 / length).min(1.0));
                least = least.min(model.value(&t));
            }
            assert!(value <= 0.9 * least, "case {case}: {value} {least}");
        }
    }

    #[test]
    fn minimize_returns_finite_steps_for_extreme_models() {
        let far = [f64::NEG_INFINITY; 2];
        let away = [f64::INFINITY; 2];
        let region = Region { radius: 1.0, lower: &far, upper: &away };
        for v in [0.0, 1e308, 5e-324, f64::NAN, f64::INFINITY] {
            let model = Quadratic { gradient: vec![v, -v], hessian: vec![v, 0.0, 0.0, -v] };
            assert!(minimize(&model, region).iter().all(|s| s.is_finite() && s.abs() <= 1.0), "{v}");
        }
    }
}
