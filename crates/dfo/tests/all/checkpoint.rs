//! A resumed run is bit-for-bit identical to the uninterrupted run. Files of other runs are rejected and left
//! unchanged.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{methods_for_costs, probe, rosenbrock, timeless};
use dfo::{
    AnyMethod, Cause, Checkpoint, CmaEs, Error, Lookahead, MethodOptions, Minimize, NelderMead, Outcome,
    Query, Report, Resume, Termination, by_hand, minimize, with_query,
};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("dfo-checkpoint-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }
    pub(crate) fn file(&self) -> PathBuf {
        self.0.join("run.checkpoint")
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

pub(crate) fn methods() -> Vec<AnyMethod> {
    let mut all: Vec<AnyMethod> = methods_for_costs();
    all.push(NelderMead::default().batch(Lookahead::Points(20)).into());
    all.push(CmaEs::default().lag(20).into());
    all
}

fn set_up<'a>(m: Minimize<'a, NelderMead>, method: &AnyMethod) -> Minimize<'a, AnyMethod> {
    m.start(&[-0.5, 1.0])
        .bounds(&[-2.0; 2], &[2.0; 2])
        .unwrap()
        .method(method.clone())
        .seed(5)
        .max_evaluations(500)
}

fn at(path: &Path) -> Checkpoint {
    Checkpoint::new(path).interval(Duration::ZERO)
}

pub(crate) fn same(a: &Report, b: &Report, what: &str) {
    assert_eq!(timeless(&a.trace), timeless(&b.trace), "{what}");
    assert_eq!(
        (&a.x, a.fun, &a.termination, &a.message),
        (&b.x, b.fun, &b.termination, &b.message),
        "{what}"
    );
    assert_eq!(
        (a.n_evaluations, a.n_iterations, a.n_failed, a.n_cached),
        (b.n_evaluations, b.n_iterations, b.n_failed, b.n_cached),
        "{what}"
    );
    assert_eq!(
        (&a.final_simplex, &a.final_population, &a.schedule),
        (&b.final_simplex, &b.final_population, &b.schedule)
    );
    assert_eq!((&a.failures, &a.tests, a.seed), (&b.failures, &b.tests, b.seed), "{what}");
}

#[test]
fn resumed_run_matches_uninterrupted_run() {
    let folder = Folder::new("interrupted");
    for (number, method) in methods().iter().enumerate() {
        let whole = with_query(|x: &[f64], _: &Query<'_>| Outcome::Value(probe(x)));
        let whole = set_up(minimize(whole), method).run().unwrap();
        for stride in [7, 60, 210] {
            let path = folder.0.join(format!("{number}-{stride}"));
            let total = AtomicUsize::new(0);
            let mut sessions = 0;
            let report = loop {
                sessions += 1;
                assert!(sessions < 1200, "{method:?} does not end");
                // Each session is aborted after `stride` calls of the objective.
                let calls = AtomicUsize::new(0);
                let cost = with_query(|x: &[f64], _: &Query<'_>| {
                    if calls.fetch_add(1, Ordering::Relaxed) == stride {
                        return Outcome::Abort("power cut".to_owned());
                    }
                    total.fetch_add(1, Ordering::Relaxed);
                    Outcome::Value(probe(x))
                });
                let workers = if stride > 50 { 3 } else { 1 };
                // The plan chosen by the first session is kept, whatever the number of workers of later
                // sessions.
                let run = set_up(minimize(cost), method).workers(if sessions == 1 { 1 } else { workers });
                match run.checkpoint(at(&path)).run() {
                    Ok(report) if matches!(report.termination, Termination::Aborted(_)) => continue,
                    Ok(report) => break report,
                    Err(Error::EndedWithoutPoint { termination: Termination::Aborted(_), .. }) => continue,
                    Err(e) => panic!("{method:?}: {e}"),
                }
            };
            same(&report, &whole, &format!("{method:?} {stride}"));
            // No known point is evaluated again. With several workers, running evaluations may be cut off.
            if stride < 50 && whole.n_speculative == 0 {
                assert_eq!(total.into_inner(), whole.n_evaluations, "{method:?} {stride}");
            }
            // A finished run returns its stored result.
            let never = |_: &[f64]| -> f64 { panic!("nothing is left to evaluate") };
            let stored = set_up(minimize(never), method).checkpoint(at(&path)).run().unwrap();
            same(&stored, &whole, &format!("{method:?} {stride} stored"));
        }
    }
}

#[test]
fn kill_between_writes_does_not_change_the_result() {
    // Keeps a copy of the file from the middle of the run and resumes from the copy later.
    let folder = Folder::new("killed");
    for method in methods() {
        let (path, aside) = (folder.file(), folder.0.join("aside"));
        let _ = std::fs::remove_file(&path);
        let mut copied = false;
        let whole = set_up(minimize(probe), &method)
            .checkpoint(at(&path))
            .observer(|p| {
                if !copied && p.n_evaluations > 230 {
                    std::fs::copy(&path, &aside).unwrap();
                    copied = true;
                }
                std::ops::ControlFlow::Continue(())
            })
            .run()
            .unwrap();
        if copied {
            let resumed = set_up(minimize(probe), &method)
                .checkpoint(at(&aside).resume(Resume::Require))
                .run()
                .unwrap();
            same(&resumed, &whole, &format!("{method:?}"));
        }
        assert!(copied || whole.n_evaluations < 300, "{method:?}");
    }
}

#[test]
fn run_continues_with_larger_budget() {
    let folder = Folder::new("budget");
    for method in methods() {
        if method.plans_with_budget() {
            continue; // L-SHADE plans with its budget, so another budget is another run.
        }
        let _ = std::fs::remove_file(folder.file());
        let whole = set_up(minimize(probe), &method).run().unwrap();
        for budget in [7, 100, 101, 500] {
            let run = set_up(minimize(probe), &method).max_evaluations(budget).checkpoint(at(&folder.file()));
            match run.run() {
                Ok(report) if budget == 500 => same(&report, &whole, &format!("{method:?}")),
                Ok(report) => assert!(report.n_evaluations <= budget),
                Err(Error::EndedWithoutPoint { .. }) => assert_eq!(budget, 7),
                Err(e) => panic!("{e}"),
            }
        }
    }
    let lshade: AnyMethod = "de".parse().unwrap();
    let _ = std::fs::remove_file(folder.file());
    set_up(minimize(probe), &lshade).checkpoint(at(&folder.file())).run().unwrap();
    let other = set_up(minimize(probe), &lshade).max_evaluations(501).checkpoint(at(&folder.file())).run();
    assert!(
        matches!(other, Err(Error::CheckpointMismatch { ref what, .. }) if what == "max_evaluations"),
        "{other:?}"
    );
}

#[test]
fn rejects_file_of_other_run_and_leaves_it_unchanged() {
    let folder = Folder::new("refused");
    let path = folder.file();
    let run = |seed, upper: f64, x_tol, name: &str, checkpoint: Checkpoint| {
        minimize(probe)
            .start(&[-0.5, 1.0])
            .bounds(&[-2.0; 2], &[2.0, upper])
            .unwrap()
            .method(name.parse::<AnyMethod>().unwrap())
            .seed(seed)
            .x_tol(x_tol)
            .max_evaluations(60)
            .checkpoint(checkpoint)
            .run()
    };
    let tagged = || at(&path).tag("model", "abc");
    let missing = run(1, 2.0, 1e-6, "ga", tagged().resume(Resume::Require));
    assert!(matches!(missing, Err(Error::CheckpointFile { .. })));
    run(1, 2.0, 1e-6, "ga", tagged()).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    for (what, refused) in [
        ("seed", run(2, 2.0, 1e-6, "ga", tagged())),
        ("upper bounds", run(1, 2.5, 1e-6, "ga", tagged())),
        ("x_tol", run(1, 2.0, 1e-5, "ga", tagged())),
        ("method", run(1, 2.0, 1e-6, "nelder-mead", tagged())),
        ("model", run(1, 2.0, 1e-6, "ga", at(&path).tag("model", "abd"))),
        ("model", run(1, 2.0, 1e-6, "ga", at(&path))),
    ] {
        match refused {
            Err(Error::CheckpointMismatch { what: named, .. }) => assert_eq!(named, what),
            other => panic!("{what}: {other:?}"),
        }
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
    }
    // In words, without program syntax.
    let other = run(1, 2.0, 1e-6, "de", tagged()).unwrap_err().to_string();
    assert!(other.ends_with("belongs to another run (method: ga in the file, de in this run)"), "{other}");
    let other = run(1, 2.5, 1e-6, "ga", tagged()).unwrap_err().to_string();
    assert!(other.ends_with("(upper bounds: [2.0, 2.0] in the file, [2.0, 2.5] in this run)"), "{other}");
    // If the file is damaged in any byte or truncated anywhere, the run returns an error. It never panics or
    // returns another result.
    for k in (0..bytes.len()).step_by(11) {
        let mut damaged = bytes.clone();
        damaged[k] ^= 0x40;
        for broken in [damaged, bytes[..k].to_vec()] {
            std::fs::write(&path, &broken).unwrap();
            let refused = run(1, 2.0, 1e-6, "ga", tagged());
            assert!(matches!(refused, Err(Error::Checkpoint { .. })), "{k}: {refused:?}");
            assert_eq!(std::fs::read(&path).unwrap(), broken);
        }
    }
    let restarted = run(2, 2.0, 1e-6, "ga", tagged().resume(Resume::Never)).unwrap();
    assert_eq!(restarted.seed, Some(2));
    let nowhere = run(1, 2.0, 1e-6, "ga", at(&folder.0.join("no/such/folder")));
    assert!(matches!(nowhere, Err(Error::CheckpointFile { .. })));
}

#[test]
fn drawn_seed_is_stored() {
    let folder = Folder::new("seed");
    let run = |budget| {
        minimize(probe)
            .bounds(&[-2.0; 2], &[2.0; 2])
            .unwrap()
            .method("de-classic".parse::<AnyMethod>().unwrap())
            .max_evaluations(budget)
            .checkpoint(at(&folder.file()))
            .run()
            .unwrap()
    };
    let (first, second) = (run(100), run(200));
    assert!(first.seed.is_some() && first.seed == second.seed);
    assert_eq!(timeless(&second.trace)[..100], timeless(&first.trace)[..]);
}

#[test]
fn time_before_resume_counts() {
    let folder = Folder::new("time");
    // A sleep lasts at least the requested time, so the first run spends more than the limit of the second
    // one.
    let slow = |x: &[f64]| {
        std::thread::sleep(Duration::from_millis(2));
        probe(x)
    };
    let set_up = || {
        let run = set_up(minimize(slow), &"nelder-mead".parse().unwrap());
        run.checkpoint(at(&folder.file()))
    };
    set_up().max_evaluations(20).run().unwrap();
    let stored = set_up().max_time(Duration::from_millis(40)).run().unwrap();
    assert_eq!((stored.termination, stored.n_evaluations), (Termination::MaxTime, 20));
    let longer = set_up().max_time(Duration::from_secs(3600)).max_evaluations(30).run().unwrap();
    assert_eq!((longer.termination, longer.n_evaluations), (Termination::MaxEvaluations, 30));
}

#[test]
fn failed_write_is_retried() {
    let folder = tempfile::tempdir().unwrap();
    let (place, away) = (folder.path().join("place"), folder.path().join("away"));
    std::fs::create_dir(&place).unwrap();
    let calls = AtomicUsize::new(0);
    let cost = |x: &[f64]| {
        match calls.fetch_add(1, Ordering::Relaxed) {
            20 => std::fs::rename(&place, &away).unwrap(),
            40 => std::fs::rename(&away, &place).unwrap(),
            _ => {}
        }
        rosenbrock(x)
    };
    let run = |resume| {
        minimize(cost)
            .start(&[-0.5, 1.0])
            .bounds(&[-2.0; 2], &[2.0; 2])
            .unwrap()
            .method(NelderMead::default())
            .checkpoint(Checkpoint::new(place.join("run")).interval(Duration::ZERO).resume(resume))
            .max_evaluations(60)
            .run()
            .unwrap()
    };
    let report = run(Resume::Auto);
    assert_eq!((&report.termination, report.n_evaluations), (&Termination::MaxEvaluations, 60));
    assert_eq!(run(Resume::Require).x, report.x);
    assert_eq!(calls.load(Ordering::Relaxed), 60);
}

#[test]
fn foreign_file_is_left_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("data.csv");
    for content in ["time,y\n0,1\n", "x"] {
        std::fs::write(&path, content).unwrap();
        for resume in [Resume::Auto, Resume::Never, Resume::Require] {
            let run = minimize(rosenbrock)
                .start(&[-0.5, 1.0])
                .checkpoint(Checkpoint::new(&path).resume(resume))
                .max_evaluations(20)
                .run();
            let message = run.unwrap_err().to_string();
            assert!(message.contains("data.csv") && message.contains("not a checkpoint"), "{message}");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), content);
        }
    }
}

#[test]
#[cfg_attr(windows, ignore = "a folder with an open file cannot be removed")]
fn run_returns_result_when_checkpoint_becomes_unwritable() {
    for name in methods_for_costs().iter().map(AnyMethod::name) {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("place");
        std::fs::create_dir(&place).unwrap();
        let calls = AtomicUsize::new(0);
        let cost = |x: &[f64]| {
            // The folder is removed in the middle of the run.
            if calls.fetch_add(1, Ordering::Relaxed) == 150 {
                std::fs::remove_dir_all(&place).unwrap();
            }
            rosenbrock(x)
        };
        let run = |cost: &(dyn Fn(&[f64]) -> f64 + Sync)| {
            minimize(|x: &[f64]| cost(x))
                .start(&[-0.5, 1.0])
                .bounds(&[-2.0; 2], &[2.0; 2])
                .unwrap()
                .method(name.parse::<AnyMethod>().unwrap())
                .seed(1)
                .x_tol(0.0)
                .checkpoint(Checkpoint::new(place.join("run")).interval(Duration::ZERO))
                .max_evaluations(400)
                .run()
        };
        let report = run(&cost).unwrap();
        // The run continues and reports at its end that no checkpoint is stored.
        assert!(report.n_evaluations > 151, "{report}");
        let Termination::NotSaved { reason, ended } = &report.termination else { panic!("{report}") };
        let is_from_run = matches!(ended.cause(), Cause::Limit | Cause::Search);
        assert!(
            reason.contains("run") && is_from_run && report.termination.cause() == ended.cause(),
            "{report}"
        );
        assert_eq!(report.termination.ended(), &**ended);
        let message = &report.message;
        assert!(message.contains("; the last state could not be saved: checkpoint"), "{message}");
        assert!(!report.is_success() && report.n_evaluations > 150);
        assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)));
        // If the folder does not exist from the start, nothing is evaluated.
        let before = calls.load(Ordering::Relaxed);
        assert!(matches!(run(&cost), Err(Error::CheckpointFile { kind: std::io::ErrorKind::NotFound, .. })));
        assert_eq!(calls.load(Ordering::Relaxed), before);
    }
}

/// File of an earlier version: Nelder-Mead on Rosenbrock's function, stopped after 8 evaluations.
#[test]
fn rejects_file_of_earlier_format_and_leaves_it_unchanged() {
    let folder = Folder::new("format");
    let golden = include_bytes!("../data/format_2.checkpoint");
    std::fs::write(folder.file(), golden).unwrap();
    let run = |resume| {
        let checkpoint = at(&folder.file()).resume(resume);
        minimize(rosenbrock).start(&[-1.2, 1.0]).max_evaluations(20).checkpoint(checkpoint).run()
    };
    for resume in [Resume::Auto, Resume::Require] {
        let message = run(resume).unwrap_err().to_string();
        assert!(message.contains("format 2 of an earlier version"), "{message}");
        assert!(message.contains("resume"), "{message}");
        assert_eq!(std::fs::read(folder.file()).unwrap(), golden);
    }
    assert_eq!(run(Resume::Never).unwrap().n_evaluations, 20);
    assert_eq!(run(Resume::Require).unwrap().n_evaluations, 20);
}

/// Files of the current format stay readable. One file per method, written after 60 evaluations, is continued
/// to the end of the uninterrupted run. `DFO_WRITE_CHECKPOINTS=1` rewrites the files; use it only for a new
/// format.
#[test]
#[cfg_attr(windows, ignore = "the stored runs used the mathematical functions of Linux")]
fn files_of_current_format_are_resumed() {
    let folder = Folder::new("present");
    for name in methods_for_costs().iter().map(AnyMethod::name) {
        let golden =
            Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/data/format_14_{name}.checkpoint"));
        let method: AnyMethod = name.parse().unwrap();
        let calls = AtomicUsize::new(0);
        let limited = |limit: usize| {
            let calls = &calls;
            with_query(move |x: &[f64], _: &Query<'_>| match calls.fetch_add(1, Ordering::Relaxed) {
                k if k >= limit => Outcome::Abort("stopped".to_owned()),
                _ => Outcome::Value(rosenbrock(x)),
            })
        };
        let whole = set_up(minimize(limited(usize::MAX)), &method).max_evaluations(120).run().unwrap();
        if std::env::var_os("DFO_WRITE_CHECKPOINTS").is_some() {
            let _ = std::fs::remove_file(&golden);
            calls.store(0, Ordering::Relaxed);
            set_up(minimize(limited(60)), &method)
                .max_evaluations(120)
                .checkpoint(at(&golden))
                .run()
                .unwrap();
        }
        let path = folder.0.join(name);
        std::fs::copy(&golden, &path).unwrap();
        calls.store(0, Ordering::Relaxed);
        let continued = set_up(minimize(limited(usize::MAX)), &method)
            .max_evaluations(120)
            .checkpoint(at(&path).resume(Resume::Require))
            .run()
            .unwrap();
        same(&continued, &whole, name);
        assert!(calls.into_inner() <= 60, "{name}");
    }
}

#[test]
fn stored_identity_can_be_read() {
    let folder = Folder::new("identity");
    let file = folder.file();
    let checkpoint = || at(&file).tag("solver", "radau5");
    assert_eq!(checkpoint().stored_identity().unwrap(), None);
    assert!(checkpoint().resume(Resume::Require).stored_identity().is_err());
    let method: AnyMethod = NelderMead::default().into();
    set_up(minimize(rosenbrock), &method).checkpoint(checkpoint()).run().unwrap();
    let stored = checkpoint().stored_identity().unwrap().unwrap();
    assert!(stored.contains(&("solver".to_owned(), "radau5".to_owned())), "{stored:?}");
    assert_eq!(checkpoint().resume(Resume::Never).stored_identity().unwrap(), None);
    std::fs::write(&file, b"something else").unwrap();
    let message = checkpoint().stored_identity().unwrap_err().to_string();
    assert!(message.contains("not a checkpoint"), "{message}");
}

/// A limit of the trace also applies to the file.
#[test]
fn checkpoint_contains_only_kept_trace() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    let cost = |x: &[f64]| x.iter().map(|x| (x - 0.3).abs().sqrt()).sum::<f64>();
    let run = |resume, limit: usize| {
        let run = by_hand().start(&[-0.5; 12]).bounds(&[-2.0; 12], &[2.0; 12]).unwrap().x_tol(0.0);
        run.max_evaluations(3000).trace_limit(limit).checkpoint(at(&path).resume(resume)).optimizer().unwrap()
    };
    for limit in [usize::MAX, 50] {
        let mut optimizer = run(Resume::Never, limit);
        while optimizer.termination().is_none() {
            for point in optimizer.ask(1) {
                optimizer.tell(point.id, Outcome::Value(cost(&point.x))).unwrap();
            }
        }
        let whole = optimizer.report().unwrap();
        drop(optimizer);
        // The simplex takes 15 kB; the whole trace takes 450 kB.
        let size = std::fs::metadata(&path).unwrap().len();
        assert!(size < if limit == 50 { 50_000 } else { 600_000 }, "{size}");
        let mut resumed = run(Resume::Require, limit);
        assert!(resumed.ask(1).is_empty());
        same(&resumed.report().unwrap(), &whole, "continued");
    }
}
