//! Quadratic models of many parameters with O(n^2) operations per evaluation. The inverse of the
//! interpolation conditions is updated from step to step, and distant points are replaced one by one (NEWUOA:
//! Powell, report DAMTP 2004/NA08; BOBYQA: 2009/NA06).

use super::inverse::{Inverse, median};
use super::iteration::norm;
use super::options::MOST_FROM_SCRATCH;
use super::state::{ModelSearch, Phase};
use crate::methods::shared::dot::dot;

/// Distance of the base point from the origin, in trust-region radii, above which the inverse is rebuilt.
/// Rounding errors grow with the square of this distance.
const FROM_ORIGIN: f64 = 1e3;
/// Error of the Lagrange polynomials above which the inverse is rebuilt.
const INACCURATE: f64 = 0.1;
/// Distances, in trust-region radii and in resolutions, beyond which points are replaced (NA06, section 2).
const FAR_REGIONS: f64 = 2.0;
const FAR_RESOLUTIONS: f64 = 10.0;

impl ModelSearch {
    pub(super) fn has_many(&self) -> bool {
        self.n() > MOST_FROM_SCRATCH && self.nonlinear.is_none()
    }

    /// Prepares the inverse for the next step. The existing inverse is kept while it is accurate.
    pub(super) fn complete_inverse(&mut self) {
        let base = self.base();
        let good = self.inverse.as_ref().is_some_and(|inverse| {
            inverse.place_of(base).is_some_and(|place| {
                let is_near = inverse.distance(place) <= FROM_ORIGIN * self.delta;
                !inverse.is_due() || (is_near && inverse.is_accurate(place, INACCURATE))
            })
        });
        if !good {
            let from = self.points.u(base).to_vec();
            self.rebuild(&from);
        }
    }

    /// Rebuilds the inverse and the model. `from` is the previous base point of the model.
    pub(super) fn rebuild(&mut self, from: &[f64]) {
        self.fold();
        let base = self.base();
        let (f, u) = (self.cost(base), self.points.u(base).to_vec());
        let moved = self.displacement(from, &u);
        self.model.gradient = self.model.slope(&moved);
        let (mut slots, mut displacements, mut rest) = (Vec::new(), Vec::new(), Vec::new());
        slots.extend((0..self.points.len()).filter(|&slot| (self.cost(slot) - f).is_finite()));
        // The origin is the median of the points, where rounding errors are smallest. Distant points do not
        // affect it.
        let origin: Vec<f64> =
            (0..u.len()).map(|k| median(slots.iter().map(|&slot| self.points.u(slot)[k]))).collect();
        for &slot in &slots {
            let y = self.displacement(&u, self.points.u(slot));
            rest.push(self.cost(slot) - f - self.model.value(&y));
            displacements.extend(self.displacement(&origin, self.points.u(slot)));
        }
        self.inverse = Inverse::new(slots, &displacements, self.n());
        let place = self.inverse.as_ref().and_then(|inverse| inverse.place_of(base));
        if let (Some(inverse), Some(place)) = (&mut self.inverse, place) {
            let at = inverse.point(place).to_vec();
            inverse.add(&rest, &at, &mut self.model.gradient);
        }
    }

    /// Moves all weights to the Hessian, which is then complete.
    pub(super) fn fold(&mut self) {
        if let Some(inverse) = &mut self.inverse {
            inverse.fold_all(&mut self.model.hessian);
        }
    }

    /// Returns the product of the complete Hessian with a vector. `hessian` is the stored part of the
    /// Hessian.
    pub(super) fn product(&self, hessian: &[f64], v: &[f64]) -> Vec<f64> {
        let mut product: Vec<f64> = hessian.chunks_exact(v.len().max(1)).map(|row| dot(row, v)).collect();
        if let Some(inverse) = &self.inverse {
            inverse.add_product(v, &mut product);
        }
        product
    }

    /// Returns the value of the model at a displacement from the base point, relative to the base point.
    pub(super) fn value(&self, s: &[f64]) -> f64 {
        if !self.has_many() {
            return self.model.value(s);
        }
        dot(&self.model.gradient, s) + 0.5 * dot(&self.product(&self.model.hessian, s), s)
    }

    /// Replaces a point of the model by the trial point, at the displacement `s` from the base point.
    pub(super) fn exchange(&mut self, s: &[f64], better: bool) {
        let (base, from) = (self.base(), self.points.u(self.base()).to_vec());
        let place = self.inverse.as_ref().and_then(|inverse| inverse.place_of(base));
        let unused = self.unused_slot();
        let (Some(inverse), Some(base_place), None) = (&self.inverse, place, unused) else {
            // Add a point without an exchange.
            if let Some(slot) = unused {
                self.fold();
                self.points.copy_from(slot, &self.trial, 0);
            }
            self.points.rank();
            return self.rebuild(&from);
        };
        let step = inverse.step(base_place, s);
        let factors = inverse.slots.iter().copied().zip(inverse.factors(&step));
        let Some(slot) = self.most_dispensable(factors, better) else { return };
        let rest = self.trial.cost(0).value().map_or(0.0, |cost| cost - self.cost(base)) - self.value(s);
        let (place, at) = (inverse.place_of(slot), inverse.point(base_place).to_vec());
        let mut exchanged = false;
        if let (Some(inverse), Some(place)) = (&mut self.inverse, place) {
            exchanged = inverse.exchange(place, &step, &mut self.model.hessian);
            if exchanged {
                let mut values = vec![0.0; inverse.slots.len()];
                values[place] = rest;
                inverse.add(&values, &at, &mut self.model.gradient);
            }
        }
        self.points.copy_from(slot, &self.trial, 0);
        self.points.rank();
        if !exchanged {
            return self.rebuild(&from);
        }
        let moved = self.displacement(&from, self.points.u(self.base()));
        if moved.iter().any(|m| *m != 0.0) {
            let turned = self.product(&self.model.hessian, &moved);
            self.model.gradient.iter_mut().zip(turned).for_each(|(g, t)| *g += t);
        }
    }

    /// Replaces the model by the model of least norm if the slope of the latter is much smaller.
    pub(super) fn compare_inverse_with_least_norm(&mut self) {
        let base = self.base();
        let f = self.cost(base);
        let Some(inverse) = &self.inverse else { return };
        let Some(place) = inverse.place_of(base) else { return };
        let values: Vec<f64> = inverse.slots.iter().map(|&slot| self.cost(slot) - f).collect();
        let (gradient, weights) = inverse.least_norm(&values, inverse.point(place));
        if self.is_much_steeper_than(&gradient) {
            self.model.gradient = gradient;
            self.model.hessian.fill(0.0);
            if let Some(inverse) = &mut self.inverse {
                inverse.set_weights(weights);
            }
        }
    }

    /// Requests a point near the base point to replace the farthest one, at a large value of its Lagrange
    /// polynomial. Does so if the farthest point is too far away, or if `poised` is infinite.
    pub(super) fn replace_farthest(&mut self, poised: f64) -> bool {
        let base = self.base();
        let Some(inverse) = &self.inverse else { return false };
        let Some(from) = inverse.place_of(base) else { return false };
        let length = |slot: usize| norm(&self.displacement(self.points.u(base), self.points.u(slot)));
        let lengths = inverse.slots.iter().map(|&slot| length(slot)).enumerate();
        let (place, far) = lengths.fold((0, 0.0), |far, other| if other.1 > far.1 { other } else { far });
        if poised.is_finite() && far <= (FAR_REGIONS * self.delta).max(FAR_RESOLUTIONS * self.rho) {
            return false;
        }
        let radius = (0.1 * far).min(self.delta).max(self.rho);
        let (lower, upper) = self.margins();
        let inside = |s| self.nearest_inside(s);
        let s = inverse.far_from_zero(place, from, radius, &lower, &upper, inside);
        if norm(&s) > 0.0 && self.place_trial(&s) {
            self.phase = Phase::Geometry;
            return true;
        }
        false
    }
}
