//! Reference values: required correct digits of every method, and error as a function of the tolerance.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::problems;

use ode::*;
use problems::{Problem, nonstiff, stiff};

/// Checks that each problem has the required number of correct digits at rtol 1e-6 and 1e-10.
fn meets(method: Method, problem: &Problem, bars: [f64; 2]) {
    for (rtol, bar) in [1e-6, 1e-10].into_iter().zip(bars) {
        let (digits, stats) = problem.run(method, rtol);
        assert!(digits >= bar, "{} on {} at {rtol:e}: {digits:.2}\n{stats:?}", method.name(), problem.name);
    }
}

/// Checks that the error between rtol 1e-4 and 1e-10 follows a power of the tolerance of at least one half.
/// No run may be more than ten times worse than that line. Errors near rounding are excluded.
fn follows_the_tolerance(method: Method, problem: &Problem) {
    let points: Vec<(f64, f64)> = (4..=10)
        .map(|k| -f64::from(k))
        .map(|k| (k, -problem.run(method, 10f64.powf(k)).0))
        .filter(|p| p.1 > -11.0)
        .collect();
    let n = points.len() as f64;
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let slope = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>()
        / points.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>();
    let worst = points.iter().map(|p| p.1 - (my + slope * (p.0 - mx))).fold(0.0, f64::max);
    let what = format!("{} on {}: slope {slope:.2}, worst {worst:.2}", method.name(), problem.name);
    assert!(slope >= 0.5 && worst < 1.0, "{what}\n{points:?}");
}

#[test]
fn radau5_reaches_required_digits() {
    for p in stiff::all() {
        meets(Method::Radau5, &p, if p.name == "E5 1e5" { [3.0, 6.0] } else { [6.0, 8.0] });
        follows_the_tolerance(Method::Radau5, &p);
    }
}

#[test]
fn bdf_reaches_required_digits() {
    for p in stiff::all() {
        meets(Method::Bdf, &p, [3.5, 7.0]);
        follows_the_tolerance(Method::Bdf, &p);
    }
}

/// `auto` must detect stiffness at every tolerance. It never needs the hundreds of thousands of right-hand
/// sides of Tsit5 alone, and it solves problems that are not stiff with Tsit5 only.
#[test]
fn auto_switches_only_for_stiff_problems() {
    for p in stiff::all() {
        let bars = match p.name {
            "E5 1e5" => [3.0, 6.0],
            "Brusselator" => [5.0, 9.0],
            _ => [5.0, 8.0],
        };
        meets(Method::Auto, &p, bars);
        follows_the_tolerance(Method::Auto, &p);
        for k in 4..=10 {
            let rtol = 10f64.powi(-k);
            let (auto, radau) = (p.run(Method::Auto, rtol).1, p.run(Method::Radau5, rtol).1);
            let most = 4 * radau.right_hand_sides + 1500;
            assert!(auto.right_hand_sides < most, "{} at {rtol:e}: {auto:?}\n{radau:?}", p.name);
        }
    }
    explicit(Method::Auto);
    for p in nonstiff::all() {
        for (rtol, method) in [(1e-6, Method::Tsit5), (1e-8, Method::Dop853)] {
            let (auto, explicit) = (p.run(Method::Auto, rtol).1, p.run(method, rtol).1);
            let share = auto.right_hand_sides as f64 / explicit.right_hand_sides as f64;
            assert!(share < 1.15, "{} at {rtol:e}: {share}, {auto:?}", p.name);
        }
    }
}

#[test]
fn tsit5_reaches_required_digits() {
    explicit(Method::Tsit5);
}

#[test]
fn dop853_reaches_required_digits() {
    explicit(Method::Dop853);
}

fn explicit(method: Method) {
    let bars = [
        (nonstiff::brusselator(), [5.0, 9.0]),
        (nonstiff::van_der_pol(), [3.3, 7.5]),
        (nonstiff::pleiades(), [2.3, 7.0]),
        (nonstiff::arenstorf(), [1.5, 6.0]),
    ];
    for (problem, bars) in bars {
        meets(method, &problem, bars);
        follows_the_tolerance(method, &problem);
    }
}

#[test]
#[ignore = "a prints_a_table_of_decomposition_times to read"]
fn prints_a_table_of_decomposition_times() {
    for (methods, problems) in [
        (vec![Method::Radau5, Method::Bdf, Method::Auto], stiff::all()),
        (vec![Method::Tsit5, Method::Dop853], nonstiff::all()),
    ] {
        for method in methods {
            for p in &problems {
                print!("{:8} {:12}", method.name(), p.name);
                for k in [4, 6, 8, 10] {
                    match p.solve(p.options(method, 10f64.powi(-k))) {
                        Ok((d, s)) => print!(
                            " | {k:2} {d:5.2} rhs {:6} st {:5} rj {:3} J {:4} LU {:4} N {:5}",
                            s.right_hand_sides,
                            s.accepted_steps,
                            s.rejected_steps,
                            s.jacobians,
                            s.decompositions,
                            s.newton_iterations
                        ),
                        Err(e) => print!(" | {k} {e}"),
                    }
                }
                println!();
            }
        }
    }
}

#[test]
fn auto_needs_little_more_than_radau5_for_stiff_problems() {
    // At tight tolerances, accuracy keeps the steps of Tsit5 well within its stability limit. The products of
    // step and eigenvalue then contain no information, and a trial must decide.
    for problem in problems::stiff::all() {
        for rtol in [1e-8, 1e-10] {
            let (_, auto) = problem.run(Method::Auto, rtol);
            let (_, radau) = problem.run(Method::Radau5, rtol);
            let share = auto.right_hand_sides as f64 / radau.right_hand_sides as f64;
            assert!(share < 1.35, "{} at {rtol:e}: {share}", problem.name);
        }
    }
}
