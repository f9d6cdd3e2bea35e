//! The continuous extension of DOP853, which has seven terms:
//! `x + theta (d_0 + (1 - theta) (d_1 + theta (d_2 + ...)))`.

use crate::stages::Stages;
use crate::tableau::{StageWeights, Tableau};

pub(super) const TERMS: usize = 7;

/// Computes the terms of the continuous extension of a step of size `h`.
pub(super) fn dense_terms<const S: usize>(
    tableau: &Tableau<S>,
    highest: &[StageWeights; 4],
    k: &Stages<S>,
    h: f64,
    dense: &mut Stages<TERMS>,
) {
    let (starts, ends) = (k.get(0), k.get(tableau.end));
    let sums = [(0, tableau.a[tableau.end])].into_iter().chain((3..).zip(*highest));
    for (term, weights) in sums {
        k.combine(dense.get_mut(term), starts, weights.iter().copied(), |sum, _| h * sum);
    }
    for i in 0..starts.len() {
        let (start, end, change) = (h * starts[i], h * ends[i], dense.get(0)[i]);
        dense.get_mut(1)[i] = start - change;
        dense.get_mut(2)[i] = 2.0 * change - (start + end);
    }
}

/// Factor of each term at `theta`.
pub(super) fn factors(theta: f64) -> [f64; TERMS] {
    let mut product = theta;
    std::array::from_fn(|term| {
        let now = product;
        product *= if term % 2 == 0 { 1.0 - theta } else { theta };
        now
    })
}
