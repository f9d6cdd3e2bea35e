//! Discrete gradients. They show that a point is a minimum, or give a descent direction, for costs with kinks
//! (Bagirov, Karasözen and Sezer, J. Optim. Theory Appl. 137, 2008, 317).
//!
//! At an intersection of several kinks, the descent directions may form a cone so narrow that no poll finds
//! it. However, each smooth piece of the cost around a point has a gradient. Every piece decreases in the
//! direction opposite to the shortest vector of the convex hull of these gradients. A discrete gradient
//! contains the exact change of the cost along a step. It also contains finite differences along the axes
//! from the end of the step. If a step opposite to the shortest vector does not lead down, its discrete
//! gradient adds an unknown piece. The vector then becomes shorter. If the vector is zero, the point is a
//! minimum within the reach of these steps.

use crate::methods::shared::dot::dot;
use crate::problem::constraints::quadratic_program::{self, HalfSpace};
use serde::{Deserialize, Serialize};

/// Distance of the finite differences, in units of the step. It must be small compared with the step (section
/// 2 of the paper).
pub(super) const DIFFERENCE: f64 = 0.01;
/// Maximum number of gradients at one step length, in units of n + 1. Chosen from 5, 10 and 20 on functions
/// with kinks, n = 2 to 6. With half as many, more runs end away from the minimum if the absolute residuals
/// of Moré and Wild are summed. With twice as many, smooth problems need a third more evaluations to end.
const MOST_GRADIENTS: usize = 10;
/// Maximum number of weight exchanges in the search for the shortest vector.
const MOST_EXCHANGES: usize = 1000;
/// Relative accuracy of the squared length of the shortest vector at which the exchanges end.
const ACCURACY: f64 = 1e-6;

/// Discrete gradients around a point, and the next search direction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct DiscreteGradients {
    gradients: Vec<Vec<f64>>,
    /// Weights of the gradients in the shortest vector of their hull.
    weights: Vec<f64>,
    /// Direction of length 1.
    direction: Vec<f64>,
}

/// Returns the coordinate whose derivative follows from the change of the cost along a step. This is the
/// coordinate of the largest component of the step.
pub(super) fn implied(step: &[f64]) -> usize {
    let larger = |most: usize, k: usize| if step[k].abs() > step[most].abs() { k } else { most };
    (0..step.len()).fold(0, larger)
}

/// Bounds and linear constraints that block directions.
pub(super) struct Blocked<'a> {
    /// Coordinates at their lower bound, and at their upper bound.
    pub(super) at_lower: &'a [bool],
    pub(super) at_upper: &'a [bool],
    /// Half-spaces of directions that do not leave linear constraints or bounds; empty without linear
    /// constraints.
    pub(super) rows: Vec<HalfSpace>,
}

/// Returns a gradient without the part whose descent direction is blocked.
fn free(gradient: &[f64], Blocked { at_lower, at_upper, rows }: &Blocked<'_>) -> Vec<f64> {
    if !rows.is_empty() {
        // The nearest direction to steepest descent that is not blocked.
        let identity = quadratic_program::identity(gradient.len());
        let nearest = identity.and_then(|h| quadratic_program::minimize(&h, gradient, rows));
        return nearest.map_or_else(|| gradient.to_vec(), |solution| solution.x.iter().map(|d| -d).collect());
    }
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

    /// Adds a gradient, and sets the direction opposite to the shortest vector of the hull. Returns the
    /// length of this vector, the maximum decrease of the cost per length. Returns `None` after the maximum
    /// number of gradients.
    pub(super) fn add(&mut self, gradient: Vec<f64>, blocked: &Blocked<'_>) -> Option<f64> {
        if self.gradients.len() >= MOST_GRADIENTS * (gradient.len() + 1)
            || gradient.iter().any(|g| !g.is_finite())
        {
            return None;
        }
        self.gradients.push(gradient);
        self.weights.push(if self.gradients.len() == 1 { 1.0 } else { 0.0 });
        let shortest = self.shortest(blocked);
        let length = dot(&shortest, &shortest).sqrt();
        if length > 0.0 {
            self.direction.iter_mut().zip(&shortest).for_each(|(d, v)| *d = -v / length);
        }
        Some(length)
    }

    /// Returns the shortest vector of the hull, found by exchanges of weight between two gradients (Mitchell,
    /// Demyanov and Malozemov, SIAM J. Control 12, 1974, 19).
    fn shortest(&mut self, blocked: &Blocked<'_>) -> Vec<f64> {
        let Self { gradients, weights, direction } = self;
        let sum = |weights: &[f64]| {
            let mut sum = vec![0.0; direction.len()];
            for (w, g) in weights.iter().zip(&*gradients) {
                sum.iter_mut().zip(g).for_each(|(sum, g)| *sum += w * g);
            }
            free(&sum, blocked)
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
    /// Length of the steps, as a multiple of the first frame.
    pub(super) scale: f64,
    /// Smallest significant gain, and the cost at the start of the search.
    pub(super) least: f64,
    pub(super) f_begin: f64,
    /// The incomplete gradient; `None` while the end of a step is evaluated.
    pub(super) partial: Option<Partial>,
}

/// A gradient with some known derivatives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Partial {
    pub(super) derivatives: Vec<f64>,
    /// Coordinate along which the trial point is displaced.
    pub(super) axis: usize,
    /// Point with which the trial point is compared.
    pub(super) u: Vec<f64>,
    pub(super) cost: f64,
    /// Change of the cost along the step, and the step in units of the parameter sizes.
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
        let blocked = Blocked { at_lower: bounds.0, at_upper: bounds.1, rows: Vec::new() };
        let length = gradients.iter().fold(None, |_, g| all.add(g.to_vec(), &blocked));
        (length.unwrap_or(f64::NAN), all.direction().to_vec())
    }

    #[test]
    fn direction_leads_down_on_every_piece() {
        // At the kink of |x0 - 1| + 10 |x1 - x0|, both sides rise along all axes.
        let (length, direction) = after(&[[-11.0, 10.0], [9.0, -10.0]], FREE);
        assert!((length - 0.5f64.sqrt()).abs() < 1e-6, "{length}");
        assert!(direction.iter().all(|d| (d - 0.5f64.sqrt()).abs() < 1e-6), "{direction:?}");
    }

    #[test]
    fn shortest_vector_is_zero_at_a_minimum() {
        assert!(after(&[[1.0, 0.0], [-1.0, 1.0], [-1.0, -2.0]], FREE).0 < 1e-9);
        // At a bound, the cost may rise inward.
        assert_eq!(after(&[[3.0, 0.0]], (&[true, false], &[false; 2])).0, 0.0);
        assert_eq!(after(&[[-3.0, 0.0]], (&[true, false], &[false; 2])), (3.0, vec![1.0, 0.0]));
    }

    #[test]
    fn add_rejects_gradient_with_nan() {
        assert!(after(&[[1.0, f64::NAN]], FREE).0.is_nan());
    }
}
