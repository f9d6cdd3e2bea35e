//! Finite bounds that are far enough to count as no bounds.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::timeless;
use dfo::{Barrier, BoundsHandling, Minimize, NelderMead, minimize};

fn bowl(x: &[f64]) -> f64 {
    (x[0] - 1.0).powi(2) + (x[1] + 2.0).powi(2) + 0.5 * (x[0] - 1.0) * (x[1] + 2.0)
}

fn start(x0: &[f64], lower: &[f64], upper: &[f64]) -> Minimize<'static, NelderMead> {
    minimize(bowl).start(x0).bounds(lower, upper).unwrap()
}

const FAR: [f64; 9] = [1e10, 1e12, 1e15, 1e16, 1e20, 1e30, 1e100, 1e300, f64::MAX];

#[test]
fn far_bounds_do_not_change_the_path() {
    for x0 in [[0.0, 0.0], [0.3, 0.3], [-5.0, 0.0]] {
        let free = minimize(bowl).start(&x0).run().unwrap();
        assert!(free.is_success() && free.fun < 1e-9, "{free}");
        for b in FAR.iter().filter(|b| **b > 5e10) {
            let report = start(&x0, &[-b; 2], &[*b; 2]).run().unwrap();
            assert_eq!(timeless(&report.trace), timeless(&free.trace), "{b:e} {x0:?}: {report}");
            assert_eq!(report.message, free.message);
        }
    }
}

#[test]
fn far_bounds_allow_minima_with_any_handling() {
    let inf = f64::INFINITY;
    for handling in [BoundsHandling::Sine, BoundsHandling::Mirror, BoundsHandling::Clamp] {
        let method = || NelderMead::default().bounds_handling(handling);
        for b in FAR {
            for x0 in [[0.0, 0.0], [0.3, 0.3]] {
                let boxed = start(&x0, &[-b; 2], &[b; 2]).method(method()).run().unwrap();
                let one = start(&x0, &[0.0, -b], &[b, 0.5]).method(method()).run().unwrap();
                let mixed = start(&x0, &[0.0, -3.0], &[b, 3.0]).method(method()).run().unwrap();
                let open = start(&x0, &[0.0, -inf], &[inf, 0.5]).method(method()).run().unwrap();
                for report in [boxed, one, mixed] {
                    assert!(report.is_success() && report.fun < 1e-7, "{handling:?} {b:e} {x0:?}: {report}");
                }
                assert!(open.fun < 1e-7, "{handling:?} {open}");
            }
        }
    }
}

#[test]
fn barrier_finds_minima_with_far_bounds() {
    for b in FAR {
        for x0 in [[0.0, 0.0], [0.3, 0.3]] {
            for (lower, upper) in [([-b, -b], [b, b]), ([-0.5, -b], [b, 0.5]), ([-0.5, -3.0], [b, 3.0])] {
                let report = start(&x0, &lower, &upper).method(Barrier::default()).run().unwrap();
                assert!(report.is_success() && report.fun < 1e-4, "{b:e} {x0:?}: {report}");
            }
        }
    }
}

#[test]
fn far_bounds_are_respected() {
    for handling in [BoundsHandling::Sine, BoundsHandling::Mirror, BoundsHandling::Clamp] {
        for (x0, slope) in [(0.3, -1.0), (0.0, -1.0), (-2.0, 1.0)] {
            let b = 1e12;
            let report = minimize(|x: &[f64]| slope * x[0])
                .start(&[x0])
                .bounds(&[-b], &[b])
                .unwrap()
                .method(NelderMead::default().bounds_handling(handling))
                .run()
                .unwrap();
            assert!(report.trace.iter().all(|e| e.x[0].abs() <= b), "{report}");
            assert!(report.fun < -0.99 * b, "{handling:?} {report}");
        }
    }
}

#[test]
fn path_in_ordinary_box_is_independent_of_units() {
    // Scales the problem and its start by the same factor.
    let scaled = |s: f64| {
        let cost = move |x: &[f64]| bowl(&[x[0] / s, x[1] / s]);
        minimize(cost).start(&[0.3 * s; 2]).bounds(&[-5.0 * s; 2], &[5.0 * s; 2]).unwrap().run().unwrap()
    };
    let (unit, large) = (scaled(1.0), scaled(2f64.powi(60)));
    assert_eq!(unit.n_evaluations, large.n_evaluations);
    assert_eq!(unit.fun, large.fun);
}
