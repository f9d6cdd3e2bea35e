//! Linear constraints of a search on quadratic models. Every requested point satisfies them.

use super::iteration::norm;
use super::model::Quadratic;
use super::polyhedron::{self, project_descent, with_unit_normals};
use super::state::ModelSearch;
use crate::method_interface::interface::{MethodOptions, Setup};
use crate::methods::shared::dot::dot;
use crate::problem::constraints::quadratic_program::{self, HalfSpace};

/// Distance from a constraint, in resolutions, below which a step towards it is blocked.
const MET: f64 = 1e-9;
/// Distance of the middle of the first points from the start, in first radii.
const FARTHEST_MIDDLE: f64 = 2.0;
/// Number of times that the first points are moved nearer to the start to satisfy the constraints.
const MOST_HALVED: i32 = 30;

impl ModelSearch {
    /// True if there are linear inequalities beyond bounds.
    pub(super) fn has_rows(&self) -> bool {
        !self.setup.space.rows().is_empty()
    }

    /// True if another method supports the constraints of this search.
    pub(super) fn is_supported_by<M: MethodOptions>(&self, options: &M) -> bool {
        let Setup { space, constraints, .. } = &self.setup;
        (!space.has_linear() || options.supports_linear())
            && (constraints.nonlinear.is_empty() || options.supports_nonlinear())
    }

    /// Returns the linear inequalities and the bounds as constraints of the displacement from a feasible
    /// point, in units of the parameter sizes and with normals of length 1.
    pub(super) fn rows_from(&self, u: &[f64]) -> Vec<HalfSpace> {
        let space = &self.setup.space;
        let n = u.len();
        let rows = space.rows().iter().map(|row| HalfSpace {
            normal: row.normal.iter().enumerate().map(|(k, a)| a * space.size(k)).collect(),
            limit: (row.limit - row.value(u)).max(0.0),
        });
        let bound = |(k, sign, margin): (usize, f64, f64)| {
            let mut normal = vec![0.0; n];
            normal[k] = sign;
            HalfSpace { normal, limit: (margin / space.size(k)).max(0.0) }
        };
        let bounds = (0..n).flat_map(|k| {
            let (lower, upper) = space.working_bounds(k);
            [(k, 1.0, upper - u[k]), (k, -1.0, u[k] - lower)]
        });
        let finite = bounds.filter(|(.., margin)| margin.is_finite());
        with_unit_normals(rows.chain(finite.map(bound)))
    }

    /// Returns the best step of a model within the radius and the linear constraints.
    pub(super) fn step_within_rows(&self, model: &Quadratic) -> Vec<f64> {
        let rows = self.rows_from(self.points.u(self.base()));
        let region = polyhedron::Region { radius: self.delta, rows: &rows, equal: &[] };
        if self.has_many() {
            let product = |v: &[f64]| self.product(&model.hessian, v);
            polyhedron::minimize_truncated(product, &model.gradient, region)
        } else {
            polyhedron::minimize(model, region, &vec![0.0; model.gradient.len()])
        }
    }

    /// Returns the nearest displacement from the base point that satisfies the linear constraints.
    pub(super) fn nearest_inside(&self, s: Vec<f64>) -> Vec<f64> {
        if !self.has_rows() {
            return s;
        }
        let rows = self.rows_from(self.points.u(self.base()));
        nearest(&s, &rows, 0.0).unwrap_or_else(|| vec![0.0; s.len()])
    }

    /// Returns the slope of a model after removing what the linear constraints at the base point block.
    pub(super) fn free_slope(&self, gradient: &[f64]) -> f64 {
        let rows = self.rows_from(self.points.u(self.base()));
        let met = rows.iter().filter(|row| row.limit <= MET * self.rho).map(|row| &row.normal[..]);
        let met: Vec<&[f64]> = met.collect();
        project_descent(gradient, &met, &[]).map_or(0.0, |(down, _)| dot(&down, &down))
    }

    /// Places the start point of the search, inside all linear constraints.
    pub(super) fn place_first(&mut self) {
        let x0 = self.setup.space.x0().to_vec();
        self.points.place_exactly(0, &x0, &self.setup.space);
        if !self.setup.space.satisfies_rows(self.points.u(0)) {
            let mut u = self.points.u(0).to_vec();
            self.setup.space.restore(&mut u);
            self.points.place(0, &u, &self.setup.space);
        }
    }

    /// Replaces a first point outside the linear constraints. The first points outside are moved to a sphere
    /// in the constraints whose middle is the nearest one to the start.
    pub(super) fn place_start_inside(&self, centre: &[f64], slot: usize, u: &mut [f64]) {
        let space = &self.setup.space;
        if space.satisfies_rows(u) {
            return;
        }
        let n = centre.len();
        let rows = self.rows_from(centre);
        let found = (1..=MOST_HALVED).find_map(|halved| {
            let distance = self.radius * 0.5f64.powi(halved);
            let middle = nearest(&vec![0.0; n], &rows, distance)?;
            (norm(&middle) <= FARTHEST_MIDDLE * self.radius).then_some((distance, middle))
        });
        let (distance, mut s) = found.unwrap_or_else(|| (0.0, vec![0.0; n]));
        match slot - 1 {
            k if k < n => s[k] += distance,
            k if k < 2 * n => s[k - n] -= distance,
            k => {
                let (turn, p) = ((k - 2 * n) / n + 1, (k - 2 * n) % n);
                [p, (p + turn) % n]
                    .into_iter()
                    .for_each(|k| s[k] += std::f64::consts::FRAC_1_SQRT_2 * distance);
            }
        }
        let share = 0.5f64.powi(self.retries[slot] as i32);
        for (k, u) in u.iter_mut().enumerate() {
            let (lower, upper) = space.working_bounds(k);
            *u = (centre[k] + share * s[k] * space.size(k)).clamp(lower, upper);
        }
        space.shorten(centre, u);
    }
}

/// Returns the nearest displacement to `s` that has a distance from all rows.
fn nearest(s: &[f64], rows: &[HalfSpace], distance: f64) -> Option<Vec<f64>> {
    let gradient: Vec<f64> = s.iter().map(|s| -s).collect();
    let moved: Vec<HalfSpace> = rows
        .iter()
        .map(|HalfSpace { normal, limit }| HalfSpace { normal: normal.clone(), limit: limit - distance })
        .collect();
    quadratic_program::minimize(&quadratic_program::identity(s.len())?, &gradient, &moved)
        .map(|found| found.x)
}
