//! What a run on residuals gives back besides its best point: residuals, Jacobian, covariance, and losses.
#![allow(clippy::unwrap_used, clippy::panic)]

use dfo::{
    BatchView, Checkpoint, Error, LeastSquares, Loss, NelderMead, Objective, Outcome, Query, Report,
    RobustLoss, Tolerances, Transform, by_hand, least_squares, minimize, minimize_batches, residuals,
};

const TIMES: usize = 9;

/// `2 exp(-0.7 t) + 0.3` with small deviations, and one large one.
fn measured(k: usize) -> f64 {
    let t = 0.4 * k as f64;
    2.0 * (-0.7 * t).exp() + 0.3 + 0.01 * (7.0 * t).sin() + if k == 4 { 0.8 } else { 0.0 }
}

fn decay(x: &[f64], out: &mut Vec<f64>) {
    out.extend((0..TIMES).map(|k| x[0] * (-x[1] * 0.4 * k as f64).exp() + x[2] - measured(k)));
}

fn plain(x: &[f64]) -> Vec<f64> {
    let mut out = Vec::new();
    decay(x, &mut out);
    out
}

/// Central differences.
fn jacobian(x: &[f64]) -> Vec<f64> {
    let mut jacobian = vec![0.0; TIMES * 3];
    for j in 0..3 {
        let moved = |h: f64| plain(&std::array::from_fn::<_, 3, _>(|i| x[i] + if i == j { h } else { 0.0 }));
        for (i, (above, below)) in moved(1e-5).iter().zip(moved(-1e-5)).enumerate() {
            jacobian[3 * i + j] = (above - below) / 2e-5;
        }
    }
    jacobian
}

fn is_near(got: &[f64], expected: &[f64], tolerance: f64) -> bool {
    let size = expected.iter().fold(0.0, |size: f64, e| size.max(e.abs()));
    got.len() == expected.len() && got.iter().zip(expected).all(|(g, e)| (g - e).abs() <= tolerance * size)
}

fn fitted(loss: Loss) -> Report {
    let objective = residuals(decay).loss(loss, 0.1).unwrap();
    minimize(objective).start(&[1.0, 1.0, 0.0]).method(LeastSquares::default()).run().unwrap()
}

#[test]
fn residuals_and_jacobian_are_the_plain_ones_for_every_loss() {
    for loss in [Loss::Linear, Loss::SoftL1, Loss::Huber, Loss::Cauchy] {
        let report = fitted(loss);
        assert!(report.is_success(), "{loss:?} {report}");
        let r = plain(&report.x);
        assert!(is_near(report.residuals.as_ref().unwrap(), &r, 1e-14), "{loss:?}");
        assert!(
            is_near(report.jacobian.as_ref().unwrap(), &jacobian(&report.x), 1e-3),
            "{loss:?} {report:?}"
        );
        let scale = RobustLoss::new(loss, 0.1).unwrap();
        let cost: f64 = r.iter().map(|r| scale.transform(*r).powi(2)).sum();
        assert!((report.fun - cost).abs() < 1e-14 && report.active == [0; 3]);
        let squares: f64 = r.iter().map(|r| r * r).sum();
        assert!((report.sum_of_squares().unwrap() - squares).abs() < 1e-14);
        // The outlier spoils the fit only where it counts fully.
        let near = (report.x[1] - 0.7).abs() < 0.1;
        assert_eq!(near, loss != Loss::Linear, "{loss:?} {:?}", report.x);
        let covariance = report.covariance().unwrap();
        assert!(
            covariance.message(|k| format!("x[{k}]")).is_empty()
                && covariance.degrees_of_freedom == TIMES - 3
        );
        let deviation = covariance.matrix[4].sqrt();
        assert!(deviation > 0.0 && (deviation < 0.3) == near, "{loss:?} {deviation}");
    }
}

#[test]
fn a_loss_is_part_of_the_objective_for_every_method_and_respects_the_cutoff() {
    let objective = residuals(decay).loss(Loss::Huber, 0.1).unwrap();
    let simplex = minimize(objective).start(&[1.0, 1.0, 0.0]).method(NelderMead::default()).run().unwrap();
    let report = fitted(Loss::Huber);
    assert!((simplex.fun / report.fun - 1.0).abs() < 1e-4, "{simplex} {report}");
    // Costs alone were asked for.
    assert_eq!((simplex.residuals, simplex.jacobian, simplex.active), (None, None, vec![]));
    let cost = report.fun;
    let at = |cutoff: f64| objective.answer(&report.x, &Query::new(0, 0, cutoff)).outcome;
    assert_eq!((at(cost), at(0.9 * cost)), (Outcome::Value(cost), Outcome::Above(0.9 * cost)));
}

#[test]
fn fixed_logarithmic_and_bounded_parameters() {
    let run = least_squares(decay).start(&[1.0, 0.7, 0.1]);
    let run = run.bounds(&[0.1, 0.7, 0.0], &[10.0, 0.7, 0.2]).unwrap();
    let report = run.transforms(&[Transform::Log, Transform::Linear, Transform::Linear]).run().unwrap();
    let mut expected = jacobian(&report.x);
    (0..TIMES).for_each(|i| expected[3 * i + 1] = 0.0);
    assert!(is_near(report.jacobian.as_ref().unwrap(), &expected, 1e-3), "{report:?}");
    assert_eq!(report.active, [0, -1, 1], "{report}");
    let covariance = report.covariance().unwrap();
    assert!(covariance.message(|k| format!("x[{k}]")).contains("x[1], x[2]") && covariance.matrix[0] > 0.0);
    assert_eq!((covariance.held, covariance.matrix[8]), (vec![1, 2], 0.0));
}

#[test]
fn batches_by_hand_and_resumed_runs_give_the_same() {
    let report = fitted(Loss::SoftL1);
    let same = |other: &Report| {
        assert_eq!(
            (&other.x, &other.residuals, &other.jacobian),
            (&report.x, &report.residuals, &report.jacobian)
        );
    };
    let objective = || residuals(decay).loss(Loss::SoftL1, 0.1).unwrap();
    let batches = |view: &BatchView<'_>| {
        let answer = |k| {
            let answer = objective().answer(view.point(k), &view.query(k));
            view.set_residuals(k, &answer.residuals);
            answer.outcome
        };
        (0..view.len()).map(answer).collect()
    };
    let run = minimize_batches(batches).loss(RobustLoss::new(Loss::SoftL1, 0.1).unwrap());
    same(&run.start(&[1.0, 1.0, 0.0]).method(LeastSquares::default()).run().unwrap());
    let run = by_hand().start(&[1.0, 1.0, 0.0]).method(LeastSquares::default());
    let mut optimizer = run.optimizer().unwrap();
    while optimizer.termination().is_none() {
        for point in optimizer.ask(3).into_iter().rev() {
            optimizer.tell(point.id, objective().answer(&point.x, &point.query())).unwrap();
        }
    }
    // What was told is what it knows: the residuals as they count, without the loss that they have gone through.
    let told = optimizer.report().unwrap();
    assert!(is_near(&told.x, &report.x, 1e-4), "{told}");
    assert!((told.sum_of_squares().unwrap() / report.fun - 1.0).abs() < 1e-6);
    let folder = std::env::temp_dir().join(format!("dfo-least-squares-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let run = |loss: Loss| {
        let objective = residuals(decay).loss(loss, 0.1).unwrap();
        let run = minimize(objective).start(&[1.0, 1.0, 0.0]).method(LeastSquares::default());
        run.checkpoint(Checkpoint::new(folder.join("run")))
    };
    for limit in 1..report.n_evaluations {
        let cut = run(Loss::SoftL1).max_evaluations(limit).run().unwrap();
        assert_eq!(cut.residuals.map(|r| r.len()), Some(TIMES));
    }
    same(&run(Loss::SoftL1).run().unwrap());
    same(&run(Loss::SoftL1).run().unwrap());
    let Err(Error::CheckpointMismatch { what, .. }) = run(Loss::Huber).run() else { panic!() };
    assert_eq!(what, "loss");
    assert!(matches!(run(Loss::Linear).run(), Err(Error::CheckpointMismatch { .. })));
    std::fs::remove_dir_all(&folder).unwrap();
}

/// Lines with noise of a tenth to ten times the scale of the loss: the cost falls to its minimum, which
/// Newton's method on the scores finds. A model of residuals that a loss has bent would end before it.
#[test]
fn a_loss_that_bends_between_the_points_does_not_hide_the_slope() {
    for (kind, turn) in [(Loss::Huber, 0), (Loss::SoftL1, 1), (Loss::Cauchy, 2)] {
        for seed in 0..10 {
            let n = 400;
            let noise = |i: usize| {
                let uniform = |k: usize| ((12.9898 * k as f64 + 1.0).sin() * 43_758.547).fract().abs();
                let at = 2 * (i + n * (seed + 10 * turn)) + 1;
                (-2.0 * uniform(at).max(1e-12).ln()).sqrt() * (std::f64::consts::TAU * uniform(at + 1)).cos()
            };
            // The model is curved, and the data tell its parameters to 1e-5 of them.
            let at = |x: &[f64], i: usize| 1e4 * x[0] * (x[1] * i as f64 / n as f64).exp();
            let measured: Vec<f64> = (0..n).map(|i| at(&[1.0, 0.7], i) + noise(i)).collect();
            let function = |x: &[f64], out: &mut Vec<f64>| out.extend((0..n).map(|i| at(x, i) - measured[i]));
            let run = |start: [f64; 2], tolerance: f64| {
                let objective = residuals(function).loss(kind, 1.0).unwrap();
                let tolerances = Tolerances { x_tol: tolerance, f_tol: tolerance, ..Tolerances::default() };
                let run = minimize(objective).start(&start).method(LeastSquares::default());
                run.tolerances(tolerances).run()
            };
            let fit = run([1.3, 0.4], 1e-4).unwrap();
            let best = run([1.0, 0.7], 1e-9).unwrap();
            assert!(fit.is_success(), "{fit}");
            assert!(fit.fun - best.fun < 0.05, "{kind:?} {seed}: {} above", fit.fun - best.fun);
        }
    }
}
