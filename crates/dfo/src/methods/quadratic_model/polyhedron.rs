//! The step of a quadratic model within a ball and linear constraints.
//!
//! The solution satisfies some of the constraints with equality, the active ones. In the null space of their
//! normals, the step is that of a ball alone, by the exact solution of `subproblem.rs` or by conjugate
//! gradients. A constraint that blocks the way to it becomes active. An active constraint with a negative
//! multiplier is released. The first active constraints are those that support the projection of the steepest
//! descent onto the cone of the constraints met at the start (Powell, Math. Program. Comput. 7, 2015;
//! Ragonneau and Zhang, COBYQA, 2022).

use super::model::Quadratic;
use super::subproblem::within_ball;
use crate::methods::shared::dot::dot;
use crate::problem::constraints::quadratic_program::{self, HalfSpace, Solution};
use nalgebra::{DMatrix, DVector};

/// Distance from a constraint, in radii, below which it counts as met at the start of the step.
const MET: f64 = 1e-12;
/// A vector whose part outside other vectors is shorter than this fraction of its length depends on them.
const DEPENDENT: f64 = 1e-10;
/// Distance from a constraint, in radii, below which the truncated search starts along it (Powell 2015,
/// section 3).
const NEAR: f64 = 0.2;
/// Relative limits for the end of the truncated search, see `truncated_cg.rs`.
const LITTLE: f64 = 0.01;

/// Region of steps: `|s| <= radius`, `rows`, and `s` has the products `equal . s` of the start of the search.
#[derive(Debug, Clone, Copy)]
pub(super) struct Region<'a> {
    pub(super) radius: f64,
    pub(super) rows: &'a [HalfSpace],
    pub(super) equal: &'a [Vec<f64>],
}

pub(super) fn length(v: &[f64]) -> f64 {
    dot(v, v).sqrt()
}

/// Returns the rows with normals of length 1, without empty ones.
pub(super) fn with_unit_normals(rows: impl IntoIterator<Item = HalfSpace>) -> Vec<HalfSpace> {
    let unit = |HalfSpace { mut normal, limit }: HalfSpace| {
        let length = length(&normal);
        normal.iter_mut().for_each(|a| *a /= length);
        (length > 0.0 && length.is_finite()).then_some(HalfSpace { normal, limit: limit / length })
    };
    rows.into_iter().filter_map(unit).collect()
}

/// A vector, and the indices of rows with their multipliers.
pub(super) type Supported = (Vec<f64>, Vec<(usize, f64)>);

/// Returns the projection of the descent `-slope` onto the cone of the displacements along the given normals,
/// and the rows that support it with their multipliers. The rows with index `normals.len()` and above are
/// those of `equal`, in both directions.
pub(super) fn project_descent(slope: &[f64], normals: &[&[f64]], equal: &[Vec<f64>]) -> Option<Supported> {
    let row = |normal: &[f64], sign: f64| HalfSpace {
        normal: normal.iter().map(|a| sign * a).collect(),
        limit: 0.0,
    };
    let cone: Vec<HalfSpace> = (normals.iter().map(|normal| row(normal, 1.0)))
        .chain(equal.iter().flat_map(|normal| [row(normal, 1.0), row(normal, -1.0)]))
        .collect();
    let hessian = quadratic_program::identity(slope.len())?;
    let Solution { x, active } = quadratic_program::minimize(&hessian, slope, &cone)?;
    Some((x, active))
}

/// Orthonormal vectors: first those that span the given ones, then those that complete the basis.
struct Basis {
    spanning: Vec<DVector<f64>>,
    null: DMatrix<f64>,
}

/// Removes the components of `v` along orthonormal vectors.
fn remove_components(v: &mut DVector<f64>, along: &[DVector<f64>]) {
    for _ in 0..2 {
        for q in along {
            let share = q.dot(v);
            v.axpy(-share, q, 1.0);
        }
    }
}

/// Adds a vector to an orthonormal set. Returns false if it depends on the set.
fn add_orthonormal(set: &mut Vec<DVector<f64>>, v: &[f64]) -> bool {
    let mut rest = DVector::from_column_slice(v);
    let before = rest.norm();
    remove_components(&mut rest, set);
    let length = rest.norm();
    let counts = length > DEPENDENT * before;
    if counts {
        set.push(rest / length);
    }
    counts
}

impl Basis {
    fn new<'a>(n: usize, vectors: impl Iterator<Item = &'a [f64]>) -> Self {
        let mut set = Vec::new();
        for v in vectors.filter(|_| n > 0) {
            add_orthonormal(&mut set, v);
        }
        let n_spanning = set.len();
        // The axis with the largest part outside the set comes next.
        let mut outside: Vec<f64> =
            (0..n).map(|k| 1.0 - set.iter().map(|q| q[k] * q[k]).sum::<f64>()).collect();
        while set.len() < n {
            let k = (0..n).fold(0, |best, k| if outside[k] > outside[best] { k } else { best });
            let mut axis = vec![0.0; n];
            axis[k] = 1.0;
            if add_orthonormal(&mut set, &axis) {
                let q = &set[set.len() - 1];
                outside.iter_mut().zip(q.iter()).for_each(|(outside, q)| *outside -= q * q);
            }
            outside[k] = f64::NEG_INFINITY;
        }
        let rest = set.split_off(n_spanning);
        let null = if rest.is_empty() { DMatrix::zeros(n, 0) } else { DMatrix::from_columns(&rest) };
        Self { spanning: set, null }
    }
}

/// Returns the first row that blocks the way from `s` along `direction`, and the share of the way to it;
/// 1 if none does.
fn blocked(rows: &[HalfSpace], active: &[usize], s: &[f64], direction: &[f64]) -> (Option<usize>, f64) {
    let least = 1e-14 * length(direction);
    let mut first = (None, 1.0);
    for (k, row) in rows.iter().enumerate().filter(|(k, _)| !active.contains(k)) {
        let along = dot(&row.normal, direction);
        if along > least {
            let share = ((row.limit - dot(&row.normal, s)) / along).max(0.0);
            if share < first.1 {
                first = (Some(k), share);
            }
        }
    }
    first
}

/// Returns the step in the region that (nearly) minimises a model, starting from a step in the region. The
/// normals of the rows have length 1.
pub(super) fn minimize(model: &Quadratic, region: Region<'_>, start: &[f64]) -> Vec<f64> {
    let n = model.gradient.len();
    let Region { radius, rows, equal } = region;
    // Scale to avoid overflow.
    let largest = model.gradient.iter().chain(&model.hessian).fold(0.0f64, |m, v| m.max(v.abs()));
    if !(largest > 0.0 && largest.is_finite()) {
        return start.to_vec();
    }
    let g = DVector::from_iterator(n, model.gradient.iter().map(|g| g / largest));
    let b = DMatrix::from_iterator(n, n, model.hessian.iter().map(|b| b / largest));
    let mut s = DVector::from_column_slice(start);
    let value = |s: &DVector<f64>| g.dot(s) + 0.5 * s.dot(&(&b * s));
    let mut best = (s.clone(), value(&s));
    let mut active = first_active((&g + &b * &s).as_slice(), rows, equal, start, MET * radius);
    let mut n_released = vec![0; rows.len()];
    for _ in 0..4 * (n + rows.len()) {
        let normals = equal.iter().map(|a| &a[..]).chain(active.iter().map(|&k| &rows[k].normal[..]));
        let Basis { spanning, null } = Basis::new(n, normals);
        // The part of the step along the active normals is fixed.
        let fixed = &s - &null * null.tr_mul(&s);
        let left = radius * radius - fixed.norm_squared();
        let (mut end, mut multiplier) = (s.clone(), 0.0);
        if left > 0.0 && null.ncols() > 0 {
            let gradient = null.tr_mul(&(&g + &b * &fixed));
            if let Some(part) = within_ball(null.tr_mul(&(&b * &null)), &gradient, left.sqrt()) {
                (end, multiplier) = (&fixed + &null * part.p, part.multiplier);
            }
        }
        let direction = &end - &s;
        let (row, share) = blocked(rows, &active, s.as_slice(), direction.as_slice());
        if let Some(row) = row {
            s.axpy(share, &direction, 1.0);
            active.push(row);
        } else {
            s = end;
        }
        let here = value(&s);
        if here < best.1 {
            best = (s.clone(), here);
        }
        if row.is_some() && spanning.len() < n {
            continue;
        }
        let slope = &g + &b * &s + &s * multiplier;
        let multipliers = multipliers(slope.as_slice(), equal, rows, &active);
        let worst = active.iter().zip(multipliers).enumerate().filter(|(_, (k, _))| n_released[**k] < 2);
        let worst =
            worst.fold(
                (None, 0.0),
                |worst, (place, (_, multiplier))| {
                    if multiplier < worst.1 { (Some(place), multiplier) } else { worst }
                },
            );
        let Some(place) = worst.0 else { break };
        n_released[active[place]] += 1;
        active.remove(place);
    }
    best.0.as_slice().to_vec()
}

/// Returns the rows within a distance of the start that support the projected descent.
fn first_active(
    slope: &[f64],
    rows: &[HalfSpace],
    equal: &[Vec<f64>],
    start: &[f64],
    distance: f64,
) -> Vec<usize> {
    let met = |row: &HalfSpace| row.limit - dot(&row.normal, start) <= distance;
    let met: Vec<usize> = (0..rows.len()).filter(|&k| met(&rows[k])).collect();
    let normals: Vec<&[f64]> = met.iter().map(|&k| &rows[k].normal[..]).collect();
    let supporting = project_descent(slope, &normals, equal).map_or(Vec::new(), |(_, active)| active);
    supporting.iter().filter_map(|(k, _)| met.get(*k).copied()).collect()
}

/// Returns the least-squares multipliers of the active rows: `slope + sum multiplier * normal = 0`.
fn multipliers(slope: &[f64], equal: &[Vec<f64>], rows: &[HalfSpace], active: &[usize]) -> Vec<f64> {
    if active.is_empty() {
        return Vec::new();
    }
    let columns = equal.iter().map(|a| &a[..]).chain(active.iter().map(|&k| &rows[k].normal[..]));
    let columns: Vec<DVector<f64>> = columns.map(DVector::from_column_slice).collect();
    let normals = DMatrix::from_columns(&columns);
    let solution = normals.svd(true, true).solve(&-DVector::from_column_slice(slope), DEPENDENT);
    solution.map_or(vec![0.0; active.len()], |all| all.as_slice()[equal.len()..].to_vec())
}

/// Like [`minimize`], for many parameters: conjugate gradients in the null space of the active normals,
/// starting at zero. `product` returns the product of the Hessian with a vector.
pub(super) fn minimize_truncated(
    product: impl Fn(&[f64]) -> Vec<f64>,
    gradient: &[f64],
    Region { radius, rows, equal }: Region<'_>,
) -> Vec<f64> {
    let n = gradient.len();
    let (mut s, mut slope) = (vec![0.0; n], gradient.to_vec());
    let mut active = first_active(gradient, rows, equal, &s, NEAR * radius);
    let (mut gained, mut first) = (0.0, None);
    for _ in 0..n {
        let normals = equal.iter().map(|a| &a[..]).chain(active.iter().map(|&k| &rows[k].normal[..]));
        let mut spanning = Vec::new();
        normals.for_each(|v| _ = add_orthonormal(&mut spanning, v));
        let mut direction = vec![0.0; n];
        let mut before = f64::INFINITY;
        // Continue until a row is reached.
        loop {
            let mut rest = -DVector::from_column_slice(&slope);
            remove_components(&mut rest, &spanning);
            let squared = rest.norm_squared();
            let rounding = (DEPENDENT * length(gradient)).powi(2);
            let least = (LITTLE * LITTLE * *first.get_or_insert(squared)).max(rounding);
            if !(squared > least && squared.is_finite()) {
                return s;
            }
            let share = squared / before;
            direction.iter_mut().zip(rest.iter()).for_each(|(d, r)| *d = share * *d + r);
            before = squared;
            let bent = product(&direction);
            let (curvature, along) = (dot(&direction, &bent), -dot(&slope, &direction));
            let (a, b, c) = (dot(&direction, &direction), dot(&s, &direction), radius * radius - dot(&s, &s));
            let root = (b * b + a * c.max(0.0)).sqrt();
            let ball = if b > 0.0 { c.max(0.0) / (b + root) } else { (root - b) / a };
            let minimum = if curvature > 0.0 { along / curvature } else { f64::INFINITY };
            let longest = minimum.min(ball);
            if !(longest.is_finite() && along > 0.0) {
                return s;
            }
            let way: Vec<f64> = direction.iter().map(|d| longest * d).collect();
            let (row, share) = blocked(rows, &active, &s, &way);
            let taken = share * longest;
            for k in 0..n {
                s[k] += taken * direction[k];
                slope[k] += taken * bent[k];
            }
            let gain = taken * (along - 0.5 * taken * curvature);
            gained += gain;
            match row {
                Some(row) => {
                    active.push(row);
                    break;
                }
                None if taken == ball || gain <= LITTLE * gained => return s,
                None => {}
            }
        }
    }
    s
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns pseudo-random numbers from -0.5 to 0.5 (Knuth's MMIX constants).
    fn random(state: &mut u64) -> f64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    }

    fn rows(state: &mut u64, n: usize, count: usize) -> Vec<HalfSpace> {
        let row = |k: usize, state: &mut u64| HalfSpace {
            normal: (0..n).map(|_| random(state)).collect(),
            limit: if k.is_multiple_of(3) { 0.0 } else { 0.3 * (random(state) + 0.5) },
        };
        with_unit_normals((0..count).map(|k| row(k, state)).collect::<Vec<_>>())
    }

    /// Convex programs whose ball is not active have the solution of the dual active-set method.
    #[test]
    fn minimize_agrees_with_the_quadratic_program_in_a_large_ball() {
        let mut state = 3;
        for case in 0..300 {
            let n = 1 + case % 6;
            let root = DMatrix::from_fn(n, n, |_, _| random(&mut state));
            let hessian = &root * root.transpose() + DMatrix::identity(n, n) * 0.05;
            let gradient: Vec<f64> = (0..n).map(|_| random(&mut state)).collect();
            let rows = rows(&mut state, n, case % 9);
            let model = Quadratic { gradient, hessian: hessian.iter().copied().collect() };
            let cholesky = nalgebra::Cholesky::new(hessian).unwrap();
            let expected = quadratic_program::minimize(&cholesky, &model.gradient, &rows).unwrap().x;
            let region = Region { radius: 1e3, rows: &rows, equal: &[] };
            let s = minimize(&model, region, &vec![0.0; n]);
            let error: f64 = s.iter().zip(&expected).map(|(a, b)| (a - b).abs()).sum();
            assert!(error < 1e-9, "case {case}: {s:?} {expected:?}");
        }
    }

    #[test]
    fn steps_stay_in_the_region_and_decrease_the_model() {
        let mut state = 5;
        for case in 0..300 {
            let n = 1 + case % 6;
            let gradient: Vec<f64> = (0..n).map(|_| random(&mut state)).collect();
            let half = DMatrix::from_fn(n, n, |_, _| random(&mut state));
            let hessian = (&half + half.transpose()).iter().copied().collect();
            let model = Quadratic { gradient, hessian };
            let rows = rows(&mut state, n, case % 9);
            let equal: Vec<Vec<f64>> =
                (0..usize::from(n > 2 && case % 2 == 0)).map(|_| vec![1.0; n]).collect();
            let region = Region { radius: 0.7, rows: &rows, equal: &equal };
            let exact = minimize(&model, region, &vec![0.0; n]);
            let product = |v: &[f64]| -> Vec<f64> {
                model.slope(v).iter().zip(&model.gradient).map(|(a, b)| a - b).collect()
            };
            let truncated = minimize_truncated(product, &model.gradient, region);
            for s in [&exact, &truncated] {
                assert!(length(s) <= 0.7 * (1.0 + 1e-9));
                assert!(rows.iter().all(|row| row.value(s) <= row.limit + 1e-12), "case {case}");
                assert!(equal.iter().all(|a| dot(a, s).abs() < 1e-12), "case {case}");
                assert!(model.value(s) <= 0.0, "case {case}");
            }
            // No step along the descent of the model is better than a tenth more.
            let normals: Vec<&[f64]> =
                rows.iter().filter(|row| row.limit == 0.0).map(|row| &row.normal[..]).collect();
            let (down, _) = project_descent(&model.gradient, &normals, &equal).unwrap();
            let size = length(&down);
            if size > 1e-9 {
                let t: Vec<f64> = down.iter().map(|d| 0.7 * d / size).collect();
                let (_, share) = blocked(&rows, &[], &[0.0; 6][..n], &t);
                let t: Vec<f64> = t.iter().map(|t| share * t).collect();
                assert!(model.value(&exact) <= 0.9 * model.value(&t) + 1e-12, "case {case}");
            }
        }
    }
}
