//! The step of a quadratic model of the cost and quadratic models of nonlinear constraints, within a ball and
//! linear constraints.
//!
//! The models cost nothing compared with an evaluation, so the step solves their problem by several turns of
//! sequential quadratic programming (Ragonneau and Zhang, COBYQA, 2022; Omojokun, thesis, Boulder 1989). Each
//! turn linearises the constraint models at the present step. The normal step reduces the violation of the
//! linearised constraints as far as possible. The tangential step then minimises the cost with the curvature
//! of the Lagrangian, without a larger violation. Turns count if they decrease the merit function of the
//! models, the cost plus the penalty times the Euclidean norm of the violations. Later turns play the part
//! of second-order corrections.

use super::model::Quadratic;
use super::polyhedron::{Region, length, minimize, project_descent, with_unit_normals};
use crate::methods::shared::dot::dot;
use crate::problem::constraints::quadratic_program::{self, HalfSpace};

/// Share of the radius for the first normal step (Omojokun 1989; COBYQA).
const NORMAL_SHARE: f64 = 0.8;
/// Maximum number of turns, and of halvings of a turn that does not decrease the merit function.
const MOST_TURNS: usize = 12;
const MOST_HALVED: i32 = 4;
/// Turns end if the step changes by less than this fraction of the radius.
const LITTLE: f64 = 1e-9;
/// Weight of the length of a normal step relative to the largest squared slope of the constraints.
const SHORT: f64 = 1e-10;

/// Models of the cost and of the constraints around the base point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Models<'a> {
    pub(super) cost: &'a Quadratic,
    /// Values of the constraints at the base point, and models of their changes.
    pub(super) values: &'a [f64],
    pub(super) constraints: &'a [Quadratic],
    /// Lower and upper limits of the constraints.
    pub(super) limits: &'a [(f64, f64)],
    /// Linear constraints on the step, with normals of length 1.
    pub(super) rows: &'a [HalfSpace],
    pub(super) radius: f64,
    pub(super) penalty: f64,
}

/// Constraints linearised at a step: `slopes . (t - step)` are the changes of `values`.
struct Linearised {
    values: Vec<f64>,
    slopes: Vec<Vec<f64>>,
}

/// Returns the Euclidean norm of the violations.
pub(super) fn violation(values: impl Iterator<Item = f64>, limits: &[(f64, f64)]) -> f64 {
    let each = values.zip(limits).map(|(value, (lower, upper))| (lower - value).max(value - upper).max(0.0));
    each.map(|v| v * v).sum::<f64>().sqrt()
}

fn add(to: &mut [f64], weight: f64, v: &[f64]) {
    to.iter_mut().zip(v).for_each(|(a, v)| *a += weight * v);
}

impl Models<'_> {
    fn n(&self) -> usize {
        self.cost.gradient.len()
    }

    /// Returns the violation that the models predict after a step.
    pub(super) fn violation(&self, s: &[f64]) -> f64 {
        let values = self.values.iter().zip(self.constraints).map(|(value, model)| value + model.value(s));
        violation(values, self.limits)
    }

    /// Returns the change of the merit function that the models predict.
    pub(super) fn change(&self, s: &[f64]) -> f64 {
        let before = violation(self.values.iter().copied(), self.limits);
        self.cost.value(s) + self.penalty * (self.violation(s) - before)
    }

    fn linearised(&self, s: &[f64]) -> Linearised {
        Linearised {
            values: self.values.iter().zip(self.constraints).map(|(value, m)| value + m.value(s)).collect(),
            slopes: self.constraints.iter().map(|m| m.slope(s)).collect(),
        }
    }

    /// Returns the least-squares multipliers of the nonlinear constraints at a step: those of the constraints
    /// within `near` of it, with the sign with which the slopes of the constraints balance the slope of the
    /// cost.
    pub(super) fn multipliers(&self, s: &[f64], near: f64) -> Vec<f64> {
        self.balance(s, near).0
    }

    /// Like [`multipliers`](Self::multipliers), with those of the linear constraints, which have an index.
    pub(super) fn balance(&self, s: &[f64], near: f64) -> (Vec<f64>, Vec<(usize, f64)>) {
        let at = self.linearised(s);
        let mut sides: Vec<(usize, f64, Vec<f64>)> = Vec::new();
        let mut equal: Vec<(usize, f64, Vec<f64>)> = Vec::new();
        for (i, (slope, (lower, upper))) in at.slopes.iter().zip(self.limits).enumerate() {
            let size = length(slope);
            if !(size > 0.0 && size.is_finite()) {
                continue;
            }
            let unit = |sign: f64| -> Vec<f64> { slope.iter().map(|a| sign * a / size).collect() };
            if lower == upper {
                equal.push((i, 1.0 / size, unit(1.0)));
                continue;
            }
            if (upper - at.values[i]) / size <= near {
                sides.push((i, 1.0 / size, unit(1.0)));
            }
            if (at.values[i] - lower) / size <= near {
                sides.push((i, -1.0 / size, unit(-1.0)));
            }
        }
        let met = |row: &HalfSpace| row.limit - dot(&row.normal, s) <= near;
        let rows: Vec<usize> = (0..self.rows.len()).filter(|&k| met(&self.rows[k])).collect();
        let normals = sides.iter().map(|side| &side.2[..]);
        let normals: Vec<&[f64]> = normals.chain(rows.iter().map(|&k| &self.rows[k].normal[..])).collect();
        let of_equal: Vec<Vec<f64>> = equal.iter().map(|side| side.2.clone()).collect();
        let (mut found, mut of_rows) = (vec![0.0; self.limits.len()], Vec::new());
        let Some((_, active)) = project_descent(&self.cost.slope(s), &normals, &of_equal) else {
            return (found, of_rows);
        };
        for (k, multiplier) in active {
            if let Some((i, sign, _)) = sides.get(k) {
                found[*i] += sign * multiplier;
            } else if let Some(row) = rows.get(k - sides.len()) {
                of_rows.push((*row, multiplier));
            } else {
                let k = k - normals.len();
                let (i, sign, _) = &equal[k / 2];
                found[*i] += if k.is_multiple_of(2) { sign * multiplier } else { -sign * multiplier };
            }
        }
        (found, of_rows)
    }

    /// Returns the half-spaces of the linearised inequalities, and twice those of the equalities.
    fn half_spaces(&self, at: &Linearised, s: &[f64]) -> Vec<HalfSpace> {
        let mut all = Vec::new();
        for ((value, slope), (lower, upper)) in at.values.iter().zip(&at.slopes).zip(self.limits) {
            let here = dot(slope, s);
            if upper.is_finite() {
                all.push(HalfSpace { normal: slope.clone(), limit: upper - value + here });
            }
            if lower.is_finite() {
                let normal = slope.iter().map(|a| -a).collect();
                all.push(HalfSpace { normal, limit: value - lower - here });
            }
        }
        with_unit_normals(all)
    }

    /// Returns the end of the normal step from `s`.
    fn normal(&self, at: &Linearised, s: &[f64], radius: f64) -> Vec<f64> {
        if violation(at.values.iter().copied(), self.limits) == 0.0 {
            return s.to_vec();
        }
        // The nearest point that satisfies the linearised constraints, if it is in the ball.
        let mut rows = self.half_spaces(at, s);
        rows.extend(self.rows.iter().cloned());
        let towards: Vec<f64> = s.iter().map(|s| -s).collect();
        let nearest = quadratic_program::identity(s.len())
            .and_then(|hessian| quadratic_program::minimize(&hessian, &towards, &rows));
        if let Some(nearest) = nearest.filter(|nearest| length(&nearest.x) <= radius) {
            return nearest.x;
        }
        if length(s) > radius {
            return s.to_vec();
        }
        // Otherwise the least sum of squares of the violations in the ball. Other constraints stay satisfied.
        let n = self.n();
        let mut model = Quadratic::zero(n);
        let mut rows = Vec::new();
        for ((value, slope), (lower, upper)) in at.values.iter().zip(&at.slopes).zip(self.limits) {
            let here = dot(slope, s);
            let excess = if value > upper { value - upper } else { (value - lower).min(0.0) };
            if excess != 0.0 {
                // (excess + slope . (t - s))^2 / 2
                add(&mut model.gradient, excess - here, slope);
                for (a, row) in slope.iter().zip(model.hessian.chunks_exact_mut(n.max(1))) {
                    add(row, *a, slope);
                }
            } else if lower != upper {
                if upper.is_finite() {
                    rows.push(HalfSpace { normal: slope.clone(), limit: upper - value + here });
                }
                if lower.is_finite() {
                    let normal = slope.iter().map(|a| -a).collect();
                    rows.push(HalfSpace { normal, limit: value - lower - here });
                }
            }
        }
        let largest = (0..n).map(|k| model.hessian[k * n + k]).fold(0.0, f64::max);
        for (k, s) in s.iter().enumerate() {
            model.hessian[k * n + k] += SHORT * largest;
            model.gradient[k] -= SHORT * largest * s;
        }
        let mut rows = with_unit_normals(rows);
        rows.extend(self.rows.iter().cloned());
        minimize(&model, Region { radius, rows: &rows, equal: &[] }, s)
    }

    /// Returns the end of the tangential step from `normal`, which starts at the linearisation at `s`.
    fn tangential(&self, at: &Linearised, s: &[f64], normal: &[f64]) -> Vec<f64> {
        let n = self.n();
        let multipliers = self.multipliers(s, self.radius);
        let mut model = Quadratic { gradient: self.cost.slope(s), hessian: self.cost.hessian.clone() };
        for (multiplier, constraint) in multipliers.iter().zip(self.constraints) {
            if *multiplier != 0.0 {
                add(&mut model.hessian, *multiplier, &constraint.hessian);
            }
        }
        // The gradient belongs to the step zero.
        let bent: Vec<f64> = model.hessian.chunks_exact(n.max(1)).map(|row| dot(row, s)).collect();
        add(&mut model.gradient, -1.0, &bent);
        let mut rows = Vec::new();
        let mut equal = Vec::new();
        for ((value, slope), (lower, upper)) in at.values.iter().zip(&at.slopes).zip(self.limits) {
            let here = dot(slope, normal);
            let there = value + here - dot(slope, s);
            if lower == upper {
                equal.push(slope.clone());
                continue;
            }
            if upper.is_finite() {
                rows.push(HalfSpace { normal: slope.clone(), limit: here + (upper - there).max(0.0) });
            }
            if lower.is_finite() {
                let normal = slope.iter().map(|a| -a).collect();
                rows.push(HalfSpace { normal, limit: (there - lower).max(0.0) - here });
            }
        }
        let mut rows = with_unit_normals(rows);
        rows.extend(self.rows.iter().cloned());
        minimize(&model, Region { radius: self.radius, rows: &rows, equal: &equal }, normal)
    }

    /// Returns the step, and the violation that the first normal step predicts for the models.
    pub(super) fn step(&self) -> (Vec<f64>, f64) {
        let mut s = vec![0.0; self.n()];
        let (mut change, mut reachable) = (0.0, self.violation(&s));
        for turn in 0..MOST_TURNS {
            let at = self.linearised(&s);
            let share = if turn == 0 { NORMAL_SHARE } else { 1.0 };
            let normal = self.normal(&at, &s, share * self.radius);
            if turn == 0 {
                reachable = self.violation(&normal).min(reachable);
            }
            let end = self.tangential(&at, &s, &normal);
            // The whole turn, shorter ones, and the normal step alone.
            let towards = |halved: i32| -> Vec<f64> {
                let share = 0.5f64.powi(halved);
                s.iter().zip(&end).map(|(s, end)| s + share * (end - s)).collect()
            };
            let candidates = (0..=MOST_HALVED).map(towards).chain([normal.clone()]);
            let Some((next, value)) = candidates
                .map(|t| (self.change(&t), t))
                .find(|(value, _)| *value < change)
                .map(|(v, t)| (t, v))
            else {
                break;
            };
            let moved: Vec<f64> = next.iter().zip(&s).map(|(a, b)| a - b).collect();
            (s, change) = (next, value);
            if length(&moved) <= LITTLE * self.radius {
                break;
            }
        }
        (s, reachable)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quadratic(gradient: &[f64], hessian: &[f64]) -> Quadratic {
        Quadratic { gradient: gradient.to_vec(), hessian: hessian.to_vec() }
    }

    /// min x + y with x^2 + y^2 <= 2 from (1, -0.5): the minimum (-1, -1) with multiplier 1/2.
    #[test]
    fn step_solves_the_problem_of_the_models_in_a_large_ball() {
        let cost = quadratic(&[1.0, 1.0], &[0.0; 4]);
        let circle = [quadratic(&[2.0, -1.0], &[2.0, 0.0, 0.0, 2.0])];
        let models = Models {
            cost: &cost,
            values: &[1.25],
            constraints: &circle,
            limits: &[(f64::NEG_INFINITY, 2.0)],
            rows: &[],
            radius: 5.0,
            penalty: 2.0,
        };
        let (s, _) = models.step();
        assert!((s[0] + 2.0).abs() < 1e-6 && (s[1] + 0.5).abs() < 1e-6, "{s:?}");
        assert!((models.multipliers(&s, 1e-3)[0] - 0.5).abs() < 1e-6);
    }

    /// An equality that cannot be reached: the violation decreases as far as the ball allows.
    #[test]
    fn step_decreases_the_violation_in_a_small_ball() {
        let cost = quadratic(&[0.0, 1.0], &[0.0; 4]);
        let line = [quadratic(&[1.0, 0.0], &[0.0; 4])];
        let rows = [HalfSpace { normal: vec![0.0, -1.0], limit: 0.05 }];
        let models = Models {
            cost: &cost,
            values: &[0.0],
            constraints: &line,
            limits: &[(1.0, 1.0)],
            rows: &rows,
            radius: 0.1,
            penalty: 10.0,
        };
        let (s, reachable) = models.step();
        assert!((reachable - 0.92).abs() < 1e-8 && models.violation(&s) <= 0.92 + 1e-8, "{s:?} {reachable}");
        assert!(s[1] >= -0.05 - 1e-12 && length(&s) <= 0.1 * (1.0 + 1e-9), "{s:?}");
    }
}
