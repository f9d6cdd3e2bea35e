//! The starting simplex: never flat, never outside of the box, wherever in the box the start point lies.

use super::options::InitialSimplex;
use crate::error::Error;
use crate::methods::shared::cost::Cost;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::methods::shared::size_search::{SizeFound, SizeSearch};
use crate::problem::space::Space;
use crate::values::choices::Transform;

/// Side of the simplex as a fraction of the width of the box. With sides from 0.03 to 0.3 of it 124 to 126 of
/// the 126 runs in boxes that tune (`benches/simplex.rs`) are solved, in 474 to 526 evaluations (median).
const BOX_FRACTION: f64 = 0.1;
/// Side of the simplex without a box, in units of the size of the parameter.
const FREE_FRACTION: f64 = 0.3;
/// Smallest pivot, relative to the largest entry of its edge, that still counts as a direction of its own.
const FLAT: f64 = 1e-10;

pub(super) fn simplex(space: &Space, initial: &InitialSimplex) -> Result<RankedPoints, Error> {
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

/// True if no coordinate has a bound of any kind.
fn is_open(space: &Space) -> bool {
    (0..space.n_free()).all(|k| space.is_open(k))
}

/// The start point and the other corners of a simplex that is regular, with edges `FREE_FRACTION` long, where
/// each coordinate is measured in its size (Spendley, Hext and Himsworth, Technometrics 4, 1962). It points
/// away from zero.
///
/// Sizes from |x0| make the path independent of the units of the parameters. Of the fits that tune
/// (`benches/simplex.rs`) 69 or 70 of 72 are solved for any fraction from 0.1 to 0.5; 0.3 takes the fewest
/// evaluations (194, median; the others 195 to 211).
fn regular(space: &Space) -> RankedPoints {
    let n = space.n_free();
    let root = (n as f64 + 1.0).sqrt();
    let unit = FREE_FRACTION / (n as f64 * 2f64.sqrt());
    let (own, other) = (unit * (root + n as f64 - 1.0), unit * (root - 1.0));
    let mut simplex = RankedPoints::new(space, n + 1);
    let mut start = vec![0.0; n];
    space.to_working(space.x0(), &mut start);
    simplex.set(0, &start, space.x0());
    let mut x = vec![0.0; space.n()];
    for vertex in 1..=n {
        let mut u = start.clone();
        for (k, u) in u.iter_mut().enumerate() {
            let moved = *u + if k + 1 == vertex { own } else { other } * outward(space, k);
            *u = if moved.is_finite() { moved } else { *u };
        }
        // Next to a start that is huge the own step must still be seen.
        if u[vertex - 1] == start[vertex - 1] {
            u[vertex - 1] = stepped(
                start[vertex - 1],
                own * outward(space, vertex - 1),
                (f64::NEG_INFINITY, f64::INFINITY),
            );
        }
        space.to_user(&u, &mut x);
        simplex.set(vertex, &u, &x);
    }
    simplex
}

/// The size of coordinate `k`, signed so that a step leads away from zero: that of `-x` is the step of `x`
/// mirrored.
fn outward(space: &Space, k: usize) -> f64 {
    let negative = space.transform(k) == Transform::Linear && space.x0()[space.free()[k]] < 0.0;
    if negative { -space.size(k) } else { space.size(k) }
}

fn default_steps(space: &Space) -> Vec<f64> {
    let step = |k: usize| space.width(k).map_or(FREE_FRACTION * outward(space, k), |w| BOX_FRACTION * w);
    (0..space.n_free()).map(step).collect()
}

/// The point that a search for sizes started from, the steps that it found, and usual ones along the other
/// axes. The space takes the sizes that were unknown.
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

/// The start point and one step along each axis, away from a bound that is too near.
fn from_steps(space: &Space, steps: &[f64]) -> RankedPoints {
    let n = space.n_free();
    let mut simplex = RankedPoints::new(space, n + 1);
    let mut start = vec![0.0; n];
    space.to_working(space.x0(), &mut start);
    let mut u = start.clone();
    // The start point itself is evaluated exactly as given, whatever exp(ln x) makes of it.
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

/// `u + step` if that is in the bounds, else `u - step`, else the bound that is farther away; without two
/// bounds the next that can be seen beside `u`.
pub(super) fn stepped(u: f64, step: f64, bounds: (f64, f64)) -> f64 {
    let (lower, upper) = bounds;
    let good = |v: &f64| lower <= *v && *v <= upper && v.is_finite() && *v != u;
    if let Some(found) = [u + step, u - step].into_iter().find(good) {
        return found;
    }
    // The step is wider than the room, or too small to be seen next to u.
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

/// Number of dimensions spanned by the edges from vertex 0, each measured in the sizes of the parameters:
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
        // Written this way round so that NaN counts as flat.
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
    fn every_corner_of_a_box_is_a_good_start() {
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
    fn without_a_box_each_side_follows_its_parameter() {
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
            // Away from zero.
            assert!(vertices.iter().all(|v| v.iter().zip(&x0).all(|(v, x)| v.abs() >= x.abs())));
        }
        let half = Bounds::new(&[f64::NEG_INFINITY, 0.0], &[f64::INFINITY; 2]).unwrap();
        let space = Space::new(&[-3.0, 4.0], half, &[], &[]).unwrap();
        assert_eq!(vertices(&space), [vec![-3.0, 4.0], vec![-3.9, 4.0], vec![-3.0, 5.2]]);
        let space = Space::new(&[1e300; 2], Bounds::unbounded(2), &[], &[]).unwrap();
        assert!(vertices(&space).iter().flatten().all(|v| v.is_finite()));
    }

    #[test]
    fn one_sided_bounds_turn_the_step_inward() {
        let bounds = Bounds::new(&[f64::NEG_INFINITY], &[2.0]).unwrap();
        let space = Space::new(&[2.0], bounds, &[], &[]).unwrap();
        assert_eq!(vertices(&space), [vec![2.0], vec![1.4]]);
    }

    #[test]
    fn steps_too_wide_or_too_small_still_make_a_simplex() {
        assert_eq!(stepped(0.4, 5.0, (0.0, 1.0)), 1.0);
        assert_eq!(stepped(0.6, 5.0, (0.0, 1.0)), 0.0);
        assert!(stepped(1e20, 1.0, (f64::NEG_INFINITY, f64::INFINITY)) > 1e20);
        assert!(stepped(1e20, 1.0, (f64::NEG_INFINITY, 1e20)) < 1e20);
        assert!(stepped(0.0, f64::MIN_POSITIVE / 1e300, (0.0, f64::INFINITY)) > 0.0);
    }

    #[test]
    fn given_vertices_are_checked() {
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
