//! Quadratic models of many parameters with O(n^2) operations per evaluation: the inverse of the
//! interpolation conditions is kept from step to step, and points that lie far off are replaced one by one
//! (NEWUOA: Powell, report DAMTP 2004/NA08; BOBYQA: 2009/NA06).

use super::inverse::{Inverse, median};
use super::iteration::norm;
use super::options::MOST_FROM_SCRATCH;
use super::state::{ModelSearch, Phase};
use crate::methods::shared::dot::dot;

/// The inverse is made anew when the base point is farther from its origin than so many trust regions:
/// numbers lose the square of it,
const FROM_ORIGIN: f64 = 1e3;
/// and when its Lagrange polynomials are off by so much.
const INACCURATE: f64 = 0.1;
/// Points farther off than so many trust regions, or resolutions, are replaced (NA06, section 2).
const FAR_REGIONS: f64 = 2.0;
const FAR_RESOLUTIONS: f64 = 10.0;

impl ModelSearch {
    pub(super) fn has_many(&self) -> bool {
        self.n() > MOST_FROM_SCRATCH
    }

    /// The inverse for the next step: that of before, as long as it is accurate.
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

    /// Makes inverse and model anew, the displacements of the model being from `from` so far.
    pub(super) fn rebuild(&mut self, from: &[f64]) {
        self.fold();
        let base = self.base();
        let (f, u) = (self.cost(base), self.points.u(base).to_vec());
        let moved = self.displacement(from, &u);
        self.model.gradient = self.model.slope(&moved);
        let (mut slots, mut displacements, mut rest) = (Vec::new(), Vec::new(), Vec::new());
        slots.extend((0..self.points.len()).filter(|&slot| (self.cost(slot) - f).is_finite()));
        // In the middle of the points, whatever lies far off: there numbers lose least.
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

    /// The Hessian of the model is whole from here on.
    pub(super) fn fold(&mut self) {
        if let Some(inverse) = &mut self.inverse {
            inverse.fold_all(&mut self.model.hessian);
        }
    }

    /// The product of the Hessian, of which this is one part, with a vector.
    pub(super) fn product(&self, hessian: &[f64], v: &[f64]) -> Vec<f64> {
        let mut product: Vec<f64> = hessian.chunks_exact(v.len()).map(|row| dot(row, v)).collect();
        if let Some(inverse) = &self.inverse {
            inverse.add_product(v, &mut product);
        }
        product
    }

    /// Value of the model at a displacement from the base point, less that at the base point.
    pub(super) fn value(&self, s: &[f64]) -> f64 {
        if !self.has_many() {
            return self.model.value(s);
        }
        dot(&self.model.gradient, s) + 0.5 * dot(&self.product(&self.model.hessian, s), s)
    }

    /// The trial point, at the displacement `s` from the base point, takes the place of another in the model.
    pub(super) fn exchange(&mut self, s: &[f64], better: bool) {
        let (base, from) = (self.base(), self.points.u(self.base()).to_vec());
        let place = self.inverse.as_ref().and_then(|inverse| inverse.place_of(base));
        let unused = self.unused_slot();
        let (Some(inverse), Some(base_place), None) = (&self.inverse, place, unused) else {
            // A point more.
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

    /// Takes the model of least norm where its slope is much less.
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

    /// Asks for a point near the base point in place of the farthest, if that is too far off, or the wanted
    /// spread of the points has no limit: where its Lagrange polynomial is large.
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
        let s = inverse.far_from_zero(place, from, radius, &lower, &upper);
        if norm(&s) > 0.0 && self.place_trial(&s) {
            self.phase = Phase::Geometry;
            return true;
        }
        false
    }
}
