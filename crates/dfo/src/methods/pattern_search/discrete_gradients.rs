//! Discrete gradients: whether a point is a minimum, and else a way down, where the cost has kinks (Bagirov,
//! Karasözen and Sezer, J. Optim. Theory Appl. 137, 2008, 317).
//!
//! Where several kinks cross, the directions that lead down may fill so narrow a cone that no poll meets it.
//! But each smooth piece of the cost around a point has a gradient, and against the shortest vector of the
//! convex hull of all of them every piece falls. A discrete gradient holds the change of the cost along a
//! step exactly, and that along the axes from the end of the step by differences: where a step against the
//! shortest vector does not lead down, its discrete gradient shows a piece that was not known, and the vector
//! becomes shorter. When it is zero the point is a minimum as far as these steps reach.

use crate::methods::shared::dot::dot;
use serde::{Deserialize, Serialize};

/// The distance of the differences, in units of the step (it has to be small against that: section 2 there).
pub(super) const DIFFERENCE: f64 = 0.01;
/// So many gradients, in units of n + 1, must tell of a way down at one length of the step: with half as many
/// more ends lie beside the minimum where the residuals of Moré and Wild count by their sizes, with twice as
/// many smooth ends take a third more evaluations. Chosen from 5, 10 and 20 on functions with kinks, n = 2
/// to 6.
const MOST_GRADIENTS: usize = 10;
/// Exchanges of weights in the search for the shortest vector.
const MOST_EXCHANGES: usize = 1000;
/// The square of its length is known to this share when they end.
const ACCURACY: f64 = 1e-6;

/// The discrete gradients around a point, and the direction to look along next.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct DiscreteGradients {
    gradients: Vec<Vec<f64>>,
    /// Weights of the gradients in the shortest vector of their hull.
    weights: Vec<f64>,
    /// Of length 1.
    direction: Vec<f64>,
}

/// The coordinate whose derivative follows from the change of the cost along a step: that of its largest
/// component.
pub(super) fn implied(step: &[f64]) -> usize {
    let larger = |most: usize, k: usize| if step[k].abs() > step[most].abs() { k } else { most };
    (0..step.len()).fold(0, larger)
}

/// What is left of a gradient where the point may not move against it: at a bound.
fn free(gradient: &[f64], at_lower: &[bool], at_upper: &[bool]) -> Vec<f64> {
    let each = gradient.iter().enumerate();
    let inward = each.map(|(k, g)| if at_lower[k] && *g > 0.0 || at_upper[k] && *g < 0.0 { 0.0 } else { *g });
    inward.collect()
}

impl DiscreteGradients {
    pub(super) fn new(direction: Vec<f64>) -> Self {
        Self { gradients: Vec::new(), weights: Vec::new(), direction }
    }

    pub(super) fn is_sound(&self, n: usize) -> bool {
        let is_vector = |v: &Vec<f64>| v.len() == n && v.iter().all(|v| v.is_finite());
        self.weights.len() == self.gradients.len()
            && self.weights.iter().all(|w| w.is_finite())
            && self.gradients.iter().all(is_vector)
            && is_vector(&self.direction)
    }

    pub(super) fn direction(&self) -> &[f64] {
        &self.direction
    }

    /// Takes a gradient, and turns the direction against the shortest vector of the hull. The length of that,
    /// the most that the cost may fall per length; `None` where so many gradients have not told of a way.
    pub(super) fn add(&mut self, gradient: Vec<f64>, bounds: (&[bool], &[bool])) -> Option<f64> {
        if self.gradients.len() >= MOST_GRADIENTS * (gradient.len() + 1)
            || gradient.iter().any(|g| !g.is_finite())
        {
            return None;
        }
        self.gradients.push(gradient);
        self.weights.push(if self.gradients.len() == 1 { 1.0 } else { 0.0 });
        let shortest = self.shortest(bounds);
        let length = dot(&shortest, &shortest).sqrt();
        if length > 0.0 {
            self.direction.iter_mut().zip(&shortest).for_each(|(d, v)| *d = -v / length);
        }
        Some(length)
    }

    /// The shortest vector of the hull, by exchanges of weight between two gradients (Mitchell, Demyanov and
    /// Malozemov, SIAM J. Control 12, 1974, 19).
    fn shortest(&mut self, bounds: (&[bool], &[bool])) -> Vec<f64> {
        let Self { gradients, weights, direction } = self;
        let sum = |weights: &[f64]| {
            let mut sum = vec![0.0; direction.len()];
            for (w, g) in weights.iter().zip(&*gradients) {
                sum.iter_mut().zip(g).for_each(|(sum, g)| *sum += w * g);
            }
            free(&sum, bounds.0, bounds.1)
        };
        let mut shortest = sum(weights);
        for _ in 0..MOST_EXCHANGES {
            let along: Vec<f64> = gradients.iter().map(|g| dot(g, &shortest)).collect();
            let (mut to, mut from) = (0, None::<usize>);
            for (k, value) in along.iter().enumerate() {
                if *value < along[to] {
                    to = k;
                }
                if weights[k] > 0.0 && from.is_none_or(|from| *value > along[from]) {
                    from = Some(k);
                }
            }
            let Some(from) = from else { break };
            let gap = along[from] - along[to];
            let change: f64 = gradients[from].iter().zip(&gradients[to]).map(|(a, b)| (a - b).powi(2)).sum();
            if !(gap > ACCURACY * dot(&shortest, &shortest) && change > 0.0) {
                break;
            }
            let share = (gap / change).min(weights[from]);
            weights[from] -= share;
            weights[to] += share;
            shortest = sum(weights);
        }
        shortest
    }
}

/// A search along discrete gradients.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Descent {
    pub(super) gradients: DiscreteGradients,
    /// The length of the steps, as a multiple of the first frame.
    pub(super) scale: f64,
    /// What counts as a gain, and the cost at the beginning.
    pub(super) least: f64,
    pub(super) f_begin: f64,
    /// The gradient that is being made; `None` while the end of a step is evaluated.
    pub(super) partial: Option<Partial>,
}

/// A gradient of which some derivatives are known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Partial {
    pub(super) derivatives: Vec<f64>,
    /// The coordinate along which the trial point lies.
    pub(super) axis: usize,
    /// The point that it is compared with.
    pub(super) u: Vec<f64>,
    pub(super) cost: f64,
    /// Change of the cost along the step, and the step in units of the sizes.
    pub(super) change: f64,
    pub(super) step: Vec<f64>,
}

impl Descent {
    pub(super) fn is_sound(&self, n: usize) -> bool {
        self.gradients.is_sound(n)
            && self.scale > 0.0
            && self.scale <= 1.0
            && self.partial.as_ref().is_none_or(|partial| {
                partial.axis < n
                    && [&partial.derivatives, &partial.u, &partial.step].iter().all(|v| v.len() == n)
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FREE: (&[bool], &[bool]) = (&[false; 2], &[false; 2]);

    fn after(gradients: &[[f64; 2]], bounds: (&[bool], &[bool])) -> (f64, Vec<f64>) {
        let mut all = DiscreteGradients::new(vec![1.0, 0.0]);
        let length = gradients.iter().fold(None, |_, g| all.add(g.to_vec(), bounds));
        (length.unwrap_or(f64::NAN), all.direction().to_vec())
    }

    #[test]
    fn the_direction_leads_down_on_every_piece() {
        // Across the kink of |x0 - 1| + 10 |x1 - x0| both of its sides rise along all axes.
        let (length, direction) = after(&[[-11.0, 10.0], [9.0, -10.0]], FREE);
        assert!((length - 0.5f64.sqrt()).abs() < 1e-6, "{length}");
        assert!(direction.iter().all(|d| (d - 0.5f64.sqrt()).abs() < 1e-6), "{direction:?}");
    }

    #[test]
    fn a_minimum_has_zero_in_its_hull() {
        assert!(after(&[[1.0, 0.0], [-1.0, 1.0], [-1.0, -2.0]], FREE).0 < 1e-9);
        // At a bound the cost may rise inward.
        assert_eq!(after(&[[3.0, 0.0]], (&[true, false], &[false; 2])).0, 0.0);
        assert_eq!(after(&[[-3.0, 0.0]], (&[true, false], &[false; 2])), (3.0, vec![1.0, 0.0]));
    }

    #[test]
    fn what_is_no_number_is_no_gradient() {
        assert!(after(&[[1.0, f64::NAN]], FREE).0.is_nan());
    }
}
