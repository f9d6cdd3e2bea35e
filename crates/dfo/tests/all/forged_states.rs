//! Saved states with one changed field. They are rejected, or the search continues within its bounds without
//! a panic or hang.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use ciborium::Value;
use dfo::{Answers, AnyMethod, Batch, Bounds, Method, MethodOptions, Nsga2, Outcome, Setup, Space};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

/// Time limit for a single state, sufficient for slow machines.
const HANGS: Duration = Duration::from_secs(120);

/// Number of rounds from a forged state.
const ROUNDS: usize = 30;

/// Residuals of a point; `None` if it fails.
type Residuals = fn(&[f64]) -> Option<[f64; 3]>;

fn smooth(x: &[f64]) -> Option<[f64; 3]> {
    Some([x[0] - 0.3, (x[1] + 0.2).powi(2), 0.0])
}

fn noisy(x: &[f64]) -> Option<[f64; 3]> {
    let shake = |frequency: f64| 0.02 * (frequency * (x[0] + 0.7 * x[1])).sin();
    Some([x[0] - 0.3 + shake(1e6), x[1] + 0.2 + shake(3e6), 0.1 + shake(7e6)])
}

fn failing(x: &[f64]) -> Option<[f64; 3]> {
    (x[0] > 0.5).then_some([x[0] - 0.3, x[1] + 0.2, 0.1])
}

fn setup() -> Setup {
    let bounds = Bounds::new(&[0.05, -2.0], &[2.0, -0.05]).unwrap();
    let mut setup = Setup::new(Space::new(&[1.0, -1.0], bounds, &[], &[]).unwrap());
    setup.seed = Some(3);
    setup.max_evaluations = Some(400);
    setup
}

fn go_on(method: &mut impl Method, residuals: Residuals, rounds: usize) {
    let (mut batch, mut answers) = (Batch::new(), Answers::default());
    for _ in 0..rounds {
        method.ask(&mut batch);
        if batch.is_empty() {
            break;
        }
        assert!(batch.points().all(|x| setup().space.bounds().contains(x)), "{:?}", batch.as_flat());
        answers.clear();
        for residuals in batch.points().map(residuals) {
            match residuals {
                Some(residuals) => {
                    answers.push(Outcome::Value(residuals.iter().map(|r| r * r).sum()), &residuals)
                }
                None => answers.push(Outcome::failed("no"), &[]),
            }
        }
        if method.tell(&answers).is_err() {
            break;
        }
        method.details();
        method.status();
        method.best();
        method.front();
    }
    method.linear_model(&dfo::RunContext::new());
}

/// Collects the paths to the numbers and lists of a state.
fn places(value: &Value, way: &mut Vec<usize>, found: &mut Vec<Vec<usize>>) {
    match value {
        Value::Array(items) => {
            found.push(way.clone());
            // For long lists: the first, a middle and the last item.
            let n = items.len();
            for k in (0..n).filter(|k| n <= 4 || [0, n / 2, n - 1].contains(k)) {
                way.push(k);
                places(&items[k], way, found);
                way.pop();
            }
        }
        Value::Map(entries) => {
            for (k, (_, inner)) in entries.iter().enumerate() {
                way.push(k);
                places(inner, way, found);
                way.pop();
            }
        }
        Value::Float(_) | Value::Integer(_) => found.push(way.clone()),
        _ => {}
    }
}

fn at<'v>(value: &'v mut Value, way: &[usize], name: &mut String) -> &'v mut Value {
    let Some((k, rest)) = way.split_first() else { return value };
    match value {
        Value::Array(items) => {
            name.push_str(&format!("[{k}]"));
            at(&mut items[*k], rest, name)
        }
        Value::Map(entries) => {
            let (key, inner) = &mut entries[*k];
            name.push_str(&format!(".{}", key.as_text().unwrap_or("?")));
            at(inner, rest, name)
        }
        _ => unreachable!("a way leads through lists and maps"),
    }
}

/// Returns replacements for a number or a list.
fn others(value: &Value) -> Vec<Value> {
    match value {
        Value::Float(_) => {
            [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -1.0, 1e308, -1e308].map(Value::Float).into()
        }
        Value::Integer(_) => [0u64, 1, 1 << 20, 1 << 62, u64::MAX].map(Value::from).into(),
        Value::Array(items) => {
            let shorter = items.split_last().map(|(_, rest)| rest.to_vec()).unwrap_or_default();
            let longer = items.iter().chain(items.first()).cloned().collect();
            [shorter, Vec::new(), longer].map(Value::Array).into()
        }
        _ => Vec::new(),
    }
}

/// Returns all forged states of a method after some rounds, with a description of the change.
fn forged(options: &AnyMethod, residuals: Residuals, rounds: usize) -> Vec<(String, Vec<u8>)> {
    let mut method = options.begin(&setup()).unwrap();
    go_on(&mut method, residuals, rounds);
    options.restore(&setup(), &method.save().unwrap()).expect("a state as it was saved");
    let state: Value = ciborium::from_reader(&method.save().unwrap()[..]).unwrap();
    let mut found = Vec::new();
    places(&state, &mut Vec::new(), &mut found);
    let mut all = Vec::new();
    for way in found {
        let mut forged = state.clone();
        let mut name = String::new();
        for other in others(at(&mut forged, &way, &mut String::new())) {
            let mut forged = state.clone();
            name.clear();
            *at(&mut forged, &way, &mut name) = other.clone();
            let mut bytes = Vec::new();
            ciborium::into_writer(&forged, &mut bytes).unwrap();
            let other = format!("{other:?}");
            all.push((format!("{name} = {}", &other[..other.len().min(60)]), bytes));
        }
    }
    all
}

fn check(options: &AnyMethod, residuals: Residuals) {
    let name = options.name();
    let mut failures = Vec::new();
    let mut n = 0;
    for rounds in [0, 3, 12, 40] {
        let all = forged(options, residuals, rounds);
        n += all.len();
        let (tell, reported) = channel();
        let (options, states) = (options.clone(), all.clone());
        std::thread::spawn(move || {
            for (_, state) in states {
                let end = catch_unwind(AssertUnwindSafe(|| {
                    if let Ok(mut method) = options.restore(&setup(), &state) {
                        go_on(&mut method, residuals, ROUNDS);
                    }
                }));
                if tell.send(end.is_ok()).is_err() {
                    break;
                }
            }
        });
        for (what, _) in &all {
            match reported.recv_timeout(HANGS) {
                Ok(true) => {}
                Ok(false) => failures.push(format!("after {rounds} rounds {what} panics")),
                Err(RecvTimeoutError::Timeout) => {
                    failures.push(format!("after {rounds} rounds {what} hangs"));
                    break;
                }
                Err(RecvTimeoutError::Disconnected) => unreachable!("panics are caught"),
            }
        }
    }
    assert!(n > 300, "{n} states");
    assert!(failures.is_empty(), "{name}: {} of {n}:\n{}", failures.len(), failures.join("\n"));
}

macro_rules! methods {
    ($($function:ident: $name:literal, $residuals:ident);* $(;)?) => {
        $(#[test]
        fn $function() {
            check(&$name.parse().unwrap(), $residuals);
        })*
    };
}

#[test]
fn nsga2() {
    check(&Nsga2::default().population(6).into(), smooth);
    check(&Nsga2::default().population(6).into(), failing);
}

methods!(
    barrier: "barrier", smooth;
    cma_es: "cma-es", smooth;
    differential_evolution: "de", smooth;
    classic_differential_evolution: "de-classic", smooth;
    genetic: "ga", smooth;
    least_squares: "least-squares", smooth;
    least_squares_in_noise: "least-squares", noisy;
    least_squares_where_points_fail: "least-squares", failing;
    multistart: "multistart", smooth;
    nelder_mead: "nelder-mead", smooth;
    pattern_search: "pattern-search", smooth;
    quadratic_model: "quadratic-model", smooth;
);
