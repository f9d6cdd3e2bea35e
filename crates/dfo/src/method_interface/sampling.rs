//! Starting points that fill a box: uniform, Latin hypercube or Sobol.

use crate::error::Error;
use crate::method_interface::rng::{Purpose, Stream};
use crate::problem::space::Space;
use serde::{Deserialize, Serialize};

/// Distribution of starting points over a box.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Sampling {
    /// Independent and uniform points.
    Uniform,
    /// Latin hypercube (McKay, Beckman and Conover 1979). The range of each parameter is divided into as many
    /// intervals as there are points, and each interval is used once.
    #[default]
    LatinHypercube,
    /// Sobol sequence with a random digital shift, for at most 40 parameters.
    Sobol,
}

impl Sampling {
    /// Fills `out` with the working coordinates of `count` points, one after the other.
    ///
    /// # Errors
    /// Returns an error if there are more parameters than the Sobol table supports.
    pub(crate) fn fill(
        self,
        space: &Space,
        seed: u64,
        count: usize,
        out: &mut Vec<f64>,
    ) -> Result<(), Error> {
        let n = space.n_free();
        out.clear();
        out.resize(count * n, 0.0);
        match self {
            Self::Uniform => {
                for (i, point) in out.chunks_exact_mut(n.max(1)).enumerate() {
                    let mut stream = Stream::new(seed, Purpose::Sampling, 0, i);
                    point.iter_mut().for_each(|t| *t = stream.uniform());
                }
            }
            Self::LatinHypercube => {
                for k in 0..n {
                    let mut stream = Stream::new(seed, Purpose::Sampling, 0, k);
                    let mut slices: Vec<usize> = (0..count).collect();
                    stream.shuffle(&mut slices);
                    for (i, slice) in slices.iter().enumerate() {
                        out[i * n + k] = (*slice as f64 + stream.uniform()) / count as f64;
                    }
                }
            }
            Self::Sobol => sobol(seed, n, count, out)?,
        }
        for point in out.chunks_exact_mut(n.max(1)) {
            for (k, t) in point.iter_mut().enumerate() {
                let (lower, upper) = space.working_bounds(k);
                *t = (lower + *t * (upper - lower)).clamp(lower, upper);
            }
        }
        if !space.rows().is_empty() {
            for (i, point) in out.chunks_exact_mut(n.max(1)).enumerate() {
                if !space.satisfies_rows(point) {
                    draw_feasible(space, &mut Stream::new(seed, Purpose::Sampling, 2, i), point);
                }
            }
        }
        Ok(())
    }
}

/// Number of steps of hit and run per parameter, and additional steps.
const STEPS: (usize, usize) = (5, 20);

/// Draws a nearly uniform point in the bounds and linear constraints, by hit and run from the interior point
/// (Smith, Oper. Res. 32, 1984, 1296): each step goes to a uniform point on the chord along a random
/// direction. Directions are random in units of the sizes, and every other one is along a coordinate. Chords
/// without an end extend by one size.
pub(crate) fn draw_feasible(space: &Space, stream: &mut Stream, u: &mut [f64]) {
    let n = space.n_free();
    u.copy_from_slice(space.interior());
    let (mut direction, mut next) = (vec![0.0; n], vec![0.0; n]);
    for step in 0..STEPS.0 * n + STEPS.1 {
        if step % 2 == 0 {
            direction.fill(0.0);
            let k = stream.below(n);
            direction[k] = space.size(k);
        } else {
            direction.iter_mut().enumerate().for_each(|(k, d)| *d = stream.normal(0.0, space.size(k)));
        }
        let share = stream.uniform();
        let (low, high) = chord(space, u, &direction);
        let along = low + share * (high - low);
        for (k, next) in next.iter_mut().enumerate() {
            let (lower, upper) = space.working_bounds(k);
            *next = (u[k] + along * direction[k]).clamp(lower, upper);
        }
        // Rounding may move the end of a chord outside.
        if next.iter().all(|v| v.is_finite()) && space.satisfies_rows(&next) {
            u.copy_from_slice(&next);
        }
    }
}

/// Returns the range of `t` in which `u + t direction` is in the bounds and rows.
fn chord(space: &Space, u: &[f64], direction: &[f64]) -> (f64, f64) {
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    let mut limit = |distance: f64, slope: f64| {
        let t = distance.max(0.0) / slope.abs();
        if slope > 0.0 {
            high = high.min(t);
        } else if slope < 0.0 {
            low = low.max(-t);
        }
    };
    for (k, d) in direction.iter().enumerate() {
        let (lower, upper) = space.working_bounds(k);
        limit(upper - u[k], *d);
        limit(u[k] - lower, -d);
    }
    for row in space.rows() {
        limit(row.limit - row.value(u), row.value(direction));
    }
    (if low.is_finite() { low } else { -1.0 }, if high.is_finite() { high } else { 1.0 })
}

/// Number of bits of a Sobol coordinate.
const BITS: usize = 32;

/// Largest number of coordinates of a Sobol point.
pub(crate) const SOBOL_DIMENSIONS: usize = POLYNOMIALS.len() + 1;

/// Fills `out` with the coordinates, between 0 and 1, of `count` points of a Sobol sequence with a random
/// digital shift.
///
/// # Errors
/// Returns an error if there are more coordinates than the table supports.
pub(crate) fn sobol(seed: u64, n: usize, count: usize, out: &mut [f64]) -> Result<(), Error> {
    if n > SOBOL_DIMENSIONS {
        let range = "at most 40 for a Sobol sequence";
        return Err(Error::Option { name: "free parameters", value: n as f64, range });
    }
    for k in 0..n {
        let directions = directions(k);
        let shift = (Stream::new(seed, Purpose::Sampling, 1, k).uniform() * 4_294_967_296.0) as u32;
        let mut value = shift;
        for i in 0..count {
            // Shifts points by half a cell, so that no point is on the lower bound.
            out[i * n + k] = (f64::from(value) + 0.5) / 4_294_967_296.0;
            // Antonov and Saleev (1979) order: one direction number per point.
            value ^= directions[((i + 1).trailing_zeros() as usize).min(BITS - 1)];
        }
    }
    Ok(())
}

/// Returns the direction numbers of a dimension (Joe and Kuo, ACM Trans. Math. Softw. 29, 2003).
fn directions(dimension: usize) -> [u32; BITS] {
    let mut v = [0u32; BITS];
    let Some((polynomial, first)) = dimension.checked_sub(1).map(|d| POLYNOMIALS[d]) else {
        v.iter_mut().enumerate().for_each(|(i, v)| *v = 1 << (BITS - 1 - i));
        return v;
    };
    let degree = first.len();
    for i in 0..BITS {
        v[i] = if i < degree {
            first[i] << (BITS - 1 - i)
        } else {
            let mut next = v[i - degree] ^ (v[i - degree] >> degree);
            for k in 1..degree {
                if polynomial >> (degree - 1 - k) & 1 == 1 {
                    next ^= v[i - k];
                }
            }
            next
        };
    }
    v
}

/// Coefficients of the primitive polynomials (without the first and the last) and the first direction numbers
/// of dimensions 2 to 40. Source: table of Joe and Kuo (SIAM J. Sci. Comput. 30, 2008), criterion D6.
#[rustfmt::skip]
const POLYNOMIALS: [(u32, &[u32]); 39] = [
    (0, &[1]),
    (1, &[1, 3]),
    (1, &[1, 3, 1]),
    (2, &[1, 1, 1]),
    (1, &[1, 1, 3, 3]),
    (4, &[1, 3, 5, 13]),
    (2, &[1, 1, 5, 5, 17]),
    (4, &[1, 1, 5, 5, 5]),
    (7, &[1, 1, 7, 11, 19]),
    (11, &[1, 1, 5, 1, 1]),
    (13, &[1, 1, 1, 3, 11]),
    (14, &[1, 3, 5, 5, 31]),
    (1, &[1, 3, 3, 9, 7, 49]),
    (13, &[1, 1, 1, 15, 21, 21]),
    (16, &[1, 3, 1, 13, 27, 49]),
    (19, &[1, 1, 1, 15, 7, 5]),
    (22, &[1, 3, 1, 15, 13, 25]),
    (25, &[1, 1, 5, 5, 19, 61]),
    (1, &[1, 3, 7, 11, 23, 15, 103]),
    (4, &[1, 3, 7, 13, 13, 15, 69]),
    (7, &[1, 1, 3, 13, 7, 35, 63]),
    (8, &[1, 3, 5, 9, 1, 25, 53]),
    (14, &[1, 3, 1, 13, 9, 35, 107]),
    (19, &[1, 3, 1, 5, 27, 61, 31]),
    (21, &[1, 1, 5, 11, 19, 41, 61]),
    (28, &[1, 3, 5, 3, 3, 13, 69]),
    (31, &[1, 1, 7, 13, 1, 19, 1]),
    (32, &[1, 3, 7, 5, 13, 19, 59]),
    (37, &[1, 1, 3, 9, 25, 29, 41]),
    (41, &[1, 3, 5, 13, 23, 1, 55]),
    (42, &[1, 3, 7, 3, 13, 59, 17]),
    (50, &[1, 3, 1, 3, 5, 53, 69]),
    (55, &[1, 1, 5, 5, 23, 33, 13]),
    (56, &[1, 1, 7, 7, 1, 61, 123]),
    (59, &[1, 1, 7, 9, 13, 61, 49]),
    (62, &[1, 3, 3, 5, 3, 55, 33]),
    (14, &[1, 3, 1, 15, 31, 13, 49, 245]),
    (21, &[1, 3, 5, 15, 31, 59, 63, 97]),
    (22, &[1, 3, 1, 11, 11, 11, 77, 249]),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::space::Bounds;

    fn space(n: usize) -> Space {
        let bounds = Bounds::new(&vec![-1.0; n], &vec![3.0; n]).unwrap();
        Space::new(&vec![0.0; n], bounds, &[], &[]).unwrap()
    }

    #[test]
    fn all_samplings_fill_the_box_and_follow_the_seed() {
        for sampling in [Sampling::Uniform, Sampling::LatinHypercube, Sampling::Sobol] {
            let (mut a, mut b, mut c) = (Vec::new(), Vec::new(), Vec::new());
            sampling.fill(&space(5), 1, 64, &mut a).unwrap();
            sampling.fill(&space(5), 1, 64, &mut b).unwrap();
            sampling.fill(&space(5), 2, 64, &mut c).unwrap();
            assert!(a == b && a != c && a.len() == 320 && a.iter().all(|u| (-1.0..=3.0).contains(u)));
            for k in 0..5 {
                let mean = a.iter().skip(k).step_by(5).sum::<f64>() / 64.0;
                assert!((mean - 1.0).abs() < 0.5, "{sampling:?}: {mean}");
            }
        }
    }

    /// Counts the slices of the unit interval without a point, over all parameters.
    fn empty_slices(sampling: Sampling, n: usize, count: usize) -> usize {
        let mut points = Vec::new();
        sampling.fill(&space(n), 3, count, &mut points).unwrap();
        let slice = |u: f64| (((u + 1.0) / 4.0 * count as f64) as usize).min(count - 1);
        (0..n)
            .map(|k| {
                let mut seen = vec![false; count];
                points.iter().skip(k).step_by(n).for_each(|u| seen[slice(*u)] = true);
                seen.iter().filter(|s| !**s).count()
            })
            .sum()
    }

    #[test]
    fn stratified_samplings_fill_every_slice() {
        assert_eq!(empty_slices(Sampling::LatinHypercube, 7, 50), 0);
        assert_eq!(empty_slices(Sampling::Sobol, 40, 64), 0);
        assert!(empty_slices(Sampling::Uniform, 7, 50) > 50);
    }

    #[test]
    fn sobol_points_match_published_values() {
        // Points 5, 11 and 14 of the unshifted sequence in dimensions 1, 2, 3, 8, 21 and 40, from SciPy 1.17.
        for (point, expected) in [
            (5, [0.875, 0.875, 0.125, 0.375, 0.625, 0.375]),
            (11, [0.4375, 0.5625, 0.1875, 0.6875, 0.9375, 0.3125]),
            (14, [0.5625, 0.4375, 0.0625, 0.8125, 0.3125, 0.1875]),
        ] {
            for (dimension, expected) in [0, 1, 2, 7, 20, 39].into_iter().zip(expected) {
                let directions = directions(dimension);
                let mut value = 0u32;
                (0..point).for_each(|i: usize| value ^= directions[(i + 1).trailing_zeros() as usize]);
                assert_eq!(f64::from(value) / 4_294_967_296.0, expected, "{point} {dimension}");
            }
        }
        let too_many = Sampling::Sobol.fill(&space(41), 0, 2, &mut Vec::new());
        assert!(matches!(too_many, Err(Error::Option { .. })));
    }
}
