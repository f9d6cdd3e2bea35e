//! The continuous extension of DOP853, which has seven terms:
//! `x + theta (d_0 + (1 - theta) (d_1 + theta (d_2 + ...)))`.

use crate::stages::terms;
use crate::tableau::{Tableau, Weights};

pub(super) const TERMS: usize = 7;

/// `sum_j w_j k_j` of one component.
fn sum<const S: usize>(weights: Weights, k: &[Vec<f64>; S], i: usize) -> f64 {
    terms(weights, k).map(|(w, k)| w * k[i]).sum()
}

/// The terms of the continuous extension, of one component of a step of size `h`.
pub(super) fn dense_terms<const S: usize>(
    tableau: &Tableau<S>,
    highest: &[Weights; 4],
    k: &[Vec<f64>; S],
    h: f64,
    i: usize,
) -> [f64; TERMS] {
    let (start, end, change) = (h * k[0][i], h * k[tableau.end][i], h * sum(tableau.a[tableau.end], k, i));
    let [d3, d4, d5, d6] = highest.map(|weights| h * sum(weights, k, i));
    [change, start - change, 2.0 * change - (start + end), d3, d4, d5, d6]
}

/// The factor of each term at `theta`.
pub(super) fn factors(theta: f64) -> [f64; TERMS] {
    let mut product = theta;
    std::array::from_fn(|term| {
        let now = product;
        product *= if term % 2 == 0 { 1.0 - theta } else { theta };
        now
    })
}
