//! Initial simplex: never flat and never outside the box, for any start point in the box.

use super::options::InitialSimplex;
use crate::error::Error;
use crate::methods::shared::cost::Cost;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::methods::shared::size_search::{SizeFound, SizeSearch};
use crate::problem::space::Space;
use crate::values::choices::Transform;

/// Edge of the simplex as a fraction of the width of the box. Fractions from 0.03 to 0.3 solve 124 to 126 of
/// the 126 tuning runs in boxes (`benches/simplex.rs`). They need 474 to 526 evaluations (median).
const BOX_FRACTION: f64 = 0.1;
/// Edge of the simplex without a box, in units of the parameter size.
const FREE_FRACTION: f64 = 0.3;
/// Minimum pivot of an independent direction, relative to the largest entry of its edge.
const FLAT: f64 = 1e-10;

pub(super) fn simplex(space: &Space, initial: &InitialSimplex) -> Result<RankedPoints, Error> {
    let mut simplex = in_box(space, initial)?;
    if !matches!(initial, InitialSimplex::Vertices(_)) {
        (1..simplex.len()).for_each(|slot| bring_into_rows(&mut simplex, 0, slot, space));
    } else if !space.rows().is_empty() {
        for slot in 0..simplex.len() {
            let mut u = simplex.u(slot).to_vec();
            space.restore(&mut u);
            let mut x = simplex.x(slot).to_vec();
            space.to_user(&u, &mut x);
            simplex.set(slot, &u, &x);
        }
        let (rank, n) = (rank(space, &simplex), space.n_free());
        if rank < n {
            return Err(Error::DegenerateSimplex { rank, n });
        }
    }
    Ok(simplex)
}

/// Moves a vertex that violates linear constraints. It moves to the opposite side of the vertex `base`, or
/// else its edge starts from a point between `base` and the interior, and is as long as the constraints
/// allow. The edges of different vertices then remain independent.
pub(super) fn bring_into_rows(simplex: &mut RankedPoints, base: usize, slot: usize, space: &Space) {
    let u = simplex.u(slot).to_vec();
    if space.satisfies_rows(&u) {
        return;
    }
    let from = simplex.u(base).to_vec();
    let edge: Vec<f64> = u.iter().zip(&from).map(|(u, from)| u - from).collect();
    let length = |edge: &mut dyn Iterator<Item = f64>| {
        edge.enumerate().map(|(k, e)| (e / space.size(k)).powi(2)).sum::<f64>().sqrt()
    };
    let moved = |start: &[f64], sign: f64| -> Vec<f64> {
        start.iter().zip(&edge).map(|(start, e)| start + sign * e).collect()
    };
    let mut found = moved(&from, -1.0);
    if !space.holds(&found) {
        let inward: Vec<f64> =
            space.interior().iter().zip(&from).map(|(inside, from)| inside - from).collect();
        let distance = length(&mut inward.iter().copied());
        let share =
            if distance > 0.0 { (length(&mut edge.iter().copied()) / distance).min(1.0) } else { 0.0 };
        let start: Vec<f64> = from.iter().zip(&inward).map(|(from, inward)| from + share * inward).collect();
        let ends = [1.0, -1.0].map(|sign| {
            let mut end = moved(&start, sign);
            for (k, v) in end.iter_mut().enumerate() {
                let (lower, upper) = space.working_bounds(k);
                *v = v.clamp(lower, upper);
            }
            space.shorten(&start, &mut end);
            let reached = length(&mut end.iter().zip(&start).map(|(end, start)| end - start));
            (end, reached)
        });
        let [first, second] = ends;
        found = if second.1 > first.1 { second.0 } else { first.0 };
    }
    let mut x = simplex.x(slot).to_vec();
    space.to_user(&found, &mut x);
    simplex.set(slot, &found, &x);
}

fn in_box(space: &Space, initial: &InitialSimplex) -> Result<RankedPoints, Error> {
    match initial {
        InitialSimplex::Auto if is_open(space) => Ok(regular(space)),
        InitialSimplex::Auto => Ok(from_steps(space, &default_steps(space))),
        InitialSimplex::Steps(steps) => {
            if steps.len() != space.n() {
                return Err(Error::Length { what: "initial steps", expected: space.n(), got: steps.len() });
            }
            let mut free = Vec::with_capacity(space.n_free());
            for &index in space.free() {
                let value = steps[index];
                if value == 0.0 || !value.is_finite() {
                    let range = "finite and not zero";
                    return Err(Error::ParameterOption { name: "initial step", index, value, range });
                }
                free.push(value);
            }
            Ok(from_steps(space, &free))
        }
        InitialSimplex::Vertices(vertices) => from_vertices(space, vertices),
    }
}

/// True if no coordinate has a bound.
fn is_open(space: &Space) -> bool {
    (0..space.n_free()).all(|k| space.is_open(k))
}

/// Returns a regular simplex at the start point, with edges of length `FREE_FRACTION` if each coordinate is
/// measured in its size (Spendley, Hext and Himsworth, Technometrics 4, 1962). The simplex points away from
/// zero.
///
/// Sizes from |x0| make the path independent of the units of the parameters. For any fraction from 0.1 to
/// 0.5, 69 or 70 of the 72 tuning fits (`benches/simplex.rs`) are solved. The fraction 0.3 needs the fewest
/// evaluations (194, median; the others 195 to 211).
fn regular(space: &Space) -> RankedPoints {
    let n = space.n_free();
    let root = (n as f64 + 1.0).sqrt();
    let unit = FREE_FRACTION / (n as f64 * 2f64.sqrt());
    let (along, across) = (unit * (root + n as f64 - 1.0), unit * (root - 1.0));
    let mut simplex = RankedPoints::new(space, n + 1);
    let mut start = vec![0.0; n];
    space.to_working(space.x0(), &mut start);
    simplex.set(0, &start, space.x0());
    let mut x = vec![0.0; space.n()];
    for vertex in 1..=n {
        let mut u = start.clone();
        for (k, u) in u.iter_mut().enumerate() {
            let moved = *u + if k + 1 == vertex { along } else { across } * outward(space, k);
            *u = if moved.is_finite() { moved } else { *u };
        }
        // At a huge start value, the step must still change the value.
        if u[vertex - 1] == start[vertex - 1] {
            u[vertex - 1] = stepped(
                start[vertex - 1],
                along * outward(space, vertex - 1),
                (f64::NEG_INFINITY, f64::INFINITY),
            );
        }
        space.to_user(&u, &mut x);
        simplex.set(vertex, &u, &x);
    }
    simplex
}

/// Returns the size of coordinate `k`, signed such that a step leads away from zero. The step of `-x` is the
/// mirrored step of `x`.
fn outward(space: &Space, k: usize) -> f64 {
    let negative = space.transform(k) == Transform::Linear && space.x0()[space.free()[k]] < 0.0;
    if negative { -space.size(k) } else { space.size(k) }
}

fn default_steps(space: &Space) -> Vec<f64> {
    let step = |k: usize| space.width(k).map_or(FREE_FRACTION * outward(space, k), |w| BOX_FRACTION * w);
    (0..space.n_free()).map(step).collect()
}

/// Returns a simplex from the base point of a size search. Its edges are the steps found by the search, and
/// default steps along the other axes. Sets the unknown sizes of the space.
pub(super) fn around(space: &mut Space, search: &SizeSearch) -> RankedPoints {
    let found = search.found(space);
    for SizeFound { k, size, .. } in &found {
        if space.size_is_unknown(*k) {
            space.set_unit(*k, *size);
        }
    }
    let (base, cost) = search.base();
    let plain = space.without_sine().starting_at(base);
    let mut simplex = from_steps(&plain, &default_steps(&plain));
    simplex.rewrite(space);
    simplex.set_cost(0, Cost::Value(cost));
    let (mut u, mut x) = (vec![0.0; space.n_free()], base.to_vec());
    for SizeFound { k, vertex, .. } in found {
        let Some((value, cost)) = vertex else { continue };
        let i = space.free()[k];
        x[i] = value;
        space.to_working(&x, &mut u);
        simplex.set(k + 1, &u, &x);
        simplex.set_cost(k + 1, Cost::Value(cost));
        x[i] = base[i];
    }
    simplex
}

/// Returns the start point and one step along each axis, directed away from a bound that is too near.
fn from_steps(space: &Space, steps: &[f64]) -> RankedPoints {
    let n = space.n_free();
    let mut simplex = RankedPoints::new(space, n + 1);
    let mut start = vec![0.0; n];
    space.to_working(space.x0(), &mut start);
    let mut u = start.clone();
    // The start point itself is evaluated exactly as given, without the rounding of exp(ln x).
    simplex.set(0, &start, space.x0());
    let mut x = vec![0.0; space.n()];
    for (k, step) in steps.iter().enumerate() {
        u[k] = stepped(start[k], *step, space.working_bounds(k));
        space.to_user(&u, &mut x);
        simplex.set(k + 1, &u, &x);
        u[k] = start[k];
    }
    simplex
}

/// Returns `u + step` if it is within the bounds, otherwise `u - step`, otherwise the bound that is farther
/// away. Without two bounds, returns the nearest value that differs from `u`.
pub(super) fn stepped(u: f64, step: f64, bounds: (f64, f64)) -> f64 {
    let (lower, upper) = bounds;
    let good = |v: &f64| lower <= *v && *v <= upper && v.is_finite() && *v != u;
    if let Some(found) = [u + step, u - step].into_iter().find(good) {
        return found;
    }
    // The step exceeds the available space, or is too small to change u.
    if lower.is_finite() && upper.is_finite() {
        return if u - lower > upper - u { lower } else { upper };
    }
    let seen = 1e-8 * u.abs();
    let beside = [u.next_up() + seen, u.next_down() - seen, u.next_up(), u.next_down()];
    beside.into_iter().find(good).unwrap_or(u)
}

fn from_vertices(space: &Space, vertices: &[Vec<f64>]) -> Result<RankedPoints, Error> {
    let n = space.n_free();
    if vertices.len() != n + 1 {
        return Err(Error::SimplexSize { expected: n + 1, got: vertices.len() });
    }
    let mut simplex = RankedPoints::new(space, n + 1);
    let mut u = vec![0.0; n];
    for (vertex, x) in vertices.iter().enumerate() {
        if x.len() != space.n() {
            return Err(Error::Length {
                what: "vertex of the initial simplex",
                expected: space.n(),
                got: x.len(),
            });
        }
        for (index, &value) in x.iter().enumerate() {
            let (lower, upper) = (space.bounds().lower()[index], space.bounds().upper()[index]);
            let inside = value.is_finite() && lower <= value && value <= upper;
            if !inside {
                return Err(Error::SimplexOutside { vertex, index, value, lower, upper });
            }
        }
        for (k, &index) in space.free().iter().enumerate() {
            if space.transform(k) == Transform::Log && x[index] <= 0.0 {
                return Err(Error::LogScale { index, what: "vertex coordinate", value: x[index] });
            }
        }
        space.to_working(x, &mut u);
        simplex.set(vertex, &u, x);
    }
    let rank = rank(space, &simplex);
    if rank < n {
        return Err(Error::DegenerateSimplex { rank, n });
    }
    Ok(simplex)
}

/// Returns the number of dimensions spanned by the edges from vertex 0, measured in parameter sizes. Uses
/// Gaussian elimination with complete pivoting.
fn rank(space: &Space, simplex: &RankedPoints) -> usize {
    let n = space.n_free();
    let mut edges: Vec<Vec<f64>> = (1..=n)
        .map(|v| (0..n).map(|k| (simplex.u(v)[k] - simplex.u(0)[k]) / space.size(k)).collect())
        .collect();
    for edge in &mut edges {
        let largest = edge.iter().fold(0.0f64, |m, e| m.max(e.abs()));
        if largest > 0.0 {
            edge.iter_mut().for_each(|e| *e /= largest);
        }
    }
    for step in 0..n {
        let mut pivot = (step, step);
        for row in step..n {
            for column in step..n {
                if edges[row][column].abs() > edges[pivot.0][pivot.1].abs() {
                    pivot = (row, column);
                }
            }
        }
        // This form of the comparison counts NaN as flat.
        let large_enough = edges[pivot.0][pivot.1].abs() > FLAT;
        if !large_enough {
            return step;
        }
        edges.swap(step, pivot.0);
        edges.iter_mut().for_each(|e| e.swap(step, pivot.1));
        let (done, rest) = edges.split_at_mut(step + 1);
        let top = &done[step];
        for row in rest {
            let factor = row[step] / top[step];
            for column in step..n {
                row[column] -= factor * top[column];
            }
        }
    }
    n
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::space::Bounds;

    fn vertices(space: &Space) -> Vec<Vec<f64>> {
        let simplex = simplex(space, &InitialSimplex::Auto).unwrap();
        (0..=space.n_free()).map(|v| simplex.x(v).to_vec()).collect()
    }

    #[test]
    fn simplex_is_valid_when_start_is_a_corner_of_the_box() {
        let (lower, upper) = ([0.0, -3.0, 1e-9], [1.0, 5.0, 1e-6]);
        let bounds = Bounds::new(&lower, &upper).unwrap();
        for corner in 0..8 {
            let x0: Vec<f64> =
                (0..3).map(|i| if corner >> i & 1 == 1 { upper[i] } else { lower[i] }).collect();
            let space = Space::new(&x0, bounds.clone(), &[], &[]).unwrap();
            let vertices = vertices(&space);
            assert_eq!(vertices[0], x0);
            for (k, vertex) in vertices[1..].iter().enumerate() {
                assert!(bounds.contains(vertex), "{vertex:?}");
                let side = (vertex[k] - x0[k]).abs();
                assert!((side / (upper[k] - lower[k]) - 0.1).abs() < 1e-6, "corner {corner}: {side}");
            }
        }
    }

    #[test]
    fn simplex_edges_follow_parameter_sizes_without_a_box() {
        for (x0, sizes, nominal) in [
            (vec![3.0, -4e6], vec![3.0, 4e6], vec![]),
            (vec![1e-6, 0.0, 20.0], vec![1e-6, 1.0, 20.0], vec![]),
            (vec![5.0], vec![5.0], vec![]),
            (vec![3.0, 4.0], vec![10.0, 1.0], vec![Some(10.0), Some(1.0)]),
        ] {
            let space = Space::new(&x0, Bounds::unbounded(x0.len()), &[], &nominal).unwrap();
            let vertices = vertices(&space);
            assert_eq!(vertices[0], x0);
            for (i, a) in vertices.iter().enumerate() {
                for b in &vertices[..i] {
                    let squares = a.iter().zip(b).zip(&sizes).map(|((a, b), s)| ((a - b) / s).powi(2));
                    let distance = squares.sum::<f64>().sqrt();
                    assert!((distance - 0.3).abs() < 1e-9, "{a:?} {b:?}: {distance}");
                }
            }
            // All vertices are at least as far from zero as the start.
            assert!(vertices.iter().all(|v| v.iter().zip(&x0).all(|(v, x)| v.abs() >= x.abs())));
        }
        let half = Bounds::new(&[f64::NEG_INFINITY, 0.0], &[f64::INFINITY; 2]).unwrap();
        let space = Space::new(&[-3.0, 4.0], half, &[], &[]).unwrap();
        assert_eq!(vertices(&space), [vec![-3.0, 4.0], vec![-3.9, 4.0], vec![-3.0, 5.2]]);
        let space = Space::new(&[1e300; 2], Bounds::unbounded(2), &[], &[]).unwrap();
        assert!(vertices(&space).iter().flatten().all(|v| v.is_finite()));
    }

    #[test]
    fn simplex_points_inward_when_start_is_on_a_one_sided_bound() {
        let bounds = Bounds::new(&[f64::NEG_INFINITY], &[2.0]).unwrap();
        let space = Space::new(&[2.0], bounds, &[], &[]).unwrap();
        assert_eq!(vertices(&space), [vec![2.0], vec![1.4]]);
    }

    #[test]
    fn stepped_returns_different_value_when_step_is_too_wide_or_too_small() {
        assert_eq!(stepped(0.4, 5.0, (0.0, 1.0)), 1.0);
        assert_eq!(stepped(0.6, 5.0, (0.0, 1.0)), 0.0);
        assert!(stepped(1e20, 1.0, (f64::NEG_INFINITY, f64::INFINITY)) > 1e20);
        assert!(stepped(1e20, 1.0, (f64::NEG_INFINITY, 1e20)) < 1e20);
        assert!(stepped(0.0, f64::MIN_POSITIVE / 1e300, (0.0, f64::INFINITY)) > 0.0);
    }

    #[test]
    fn simplex_rejects_invalid_vertices() {
        let bounds = Bounds::new(&[0.0, 0.0], &[1.0, 1.0]).unwrap();
        let space = Space::new(&[0.5, 0.5], bounds, &[], &[]).unwrap();
        let build = |v: &[[f64; 2]]| {
            simplex(&space, &InitialSimplex::Vertices(v.iter().map(|x| x.to_vec()).collect())).map(|_| ())
        };
        assert_eq!(build(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), Ok(()));
        assert_eq!(build(&[[0.0, 0.0], [1.0, 0.0]]), Err(Error::SimplexSize { expected: 3, got: 2 }));
        assert_eq!(
            build(&[[0.0, 0.0], [0.5, 0.5], [1.0, 1.0]]),
            Err(Error::DegenerateSimplex { rank: 1, n: 2 })
        );
        assert!(matches!(
            build(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.5]]),
            Err(Error::SimplexOutside { vertex: 2, index: 1, .. })
        ));
        assert!(matches!(
            build(&[[0.0, f64::NAN], [1.0, 0.0], [0.0, 1.0]]),
            Err(Error::SimplexOutside { .. })
        ));
    }
}
