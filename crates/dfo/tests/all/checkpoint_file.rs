//! Checkpoint files: remains of killed processes, links and permissions.
#![cfg(unix)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use dfo::{Checkpoint, Outcome, Resume, by_hand, minimize};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::time::Duration;

fn run(path: &Path, budget: usize) {
    let checkpoint = Checkpoint::new(path).interval(Duration::ZERO);
    let square = |x: &[f64]| x[0] * x[0];
    let report = minimize(square).start(&[1.0]).max_evaluations(budget).checkpoint(checkpoint).run().unwrap();
    assert_eq!(report.n_evaluations, budget);
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn temporary_files_of_killed_processes_are_removed() {
    let folder = tempfile::tempdir().unwrap();
    // No process has such a large id; process 1 always exists.
    let (dead, alive) = (".run.writing-4294967294-Ab3xYz", ".run.writing-1-Ab3xYz");
    let others = [".other.writing-4294967294-Ab3xYz", ".run.writing-notes", ".tmpAb3xYz"];
    for name in others.into_iter().chain([dead, alive]) {
        std::fs::write(folder.path().join(name), "half").unwrap();
    }
    run(&folder.path().join("run"), 10);
    let mut left = others.to_vec();
    left.extend([alive, "run"]);
    left.sort_unstable();
    assert_eq!(names(folder.path()), left);
}

#[test]
fn checkpoint_is_written_by_one_run_at_a_time() {
    let folder = tempfile::tempdir().unwrap();
    let file = || Checkpoint::new(folder.path().join("run"));
    let square = |x: &[f64]| x[0] * x[0];
    let refused = std::sync::Mutex::new(Vec::new());
    let outer = |x: &[f64]| {
        let inner = std::thread::scope(|scope| {
            let run = || minimize(square).start(&[1.0]).checkpoint(file()).run();
            scope.spawn(run).join().unwrap()
        });
        refused.lock().unwrap().push(inner.unwrap_err().to_string());
        square(x)
    };
    minimize(outer).start(&[1.0]).max_evaluations(3).checkpoint(file()).run().unwrap();
    let messages = refused.into_inner().unwrap();
    let message =
        "another run in this process is writing to it; wait until it has ended, or specify another path";
    assert!(messages.len() == 3 && messages.iter().all(|text| text.ends_with(message)), "{messages:?}");
    // An optimizer driven by hand may be abandoned.
    let left = by_hand().start(&[1.0]).checkpoint(file().resume(Resume::Never)).optimizer().unwrap();
    let mut next = by_hand().start(&[1.0]).checkpoint(file().resume(Resume::Never)).optimizer().unwrap();
    let point = next.ask(1).remove(0);
    next.tell(point.id, Outcome::Value(1.0)).unwrap();
    next.save().unwrap();
    assert_eq!(left.n_pending(), 0);
}

#[test]
fn checkpoint_follows_links_and_keeps_permissions() {
    let folder = tempfile::tempdir().unwrap();
    let (file, link) = (folder.path().join("store/file"), folder.path().join("link"));
    std::fs::create_dir(file.parent().unwrap()).unwrap();
    // This also works if the file does not exist yet and the path is a link to a link.
    symlink("store/file", folder.path().join("between")).unwrap();
    symlink("between", &link).unwrap();
    run(&link, 10);
    assert!(link.is_symlink() && !file.is_symlink() && file.is_file());
    let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
    let usual = folder.path().join("usual");
    std::fs::write(&usual, "").unwrap();
    assert_eq!(mode(&file), mode(&usual));
    std::fs::set_permissions(&file, PermissionsExt::from_mode(0o640)).unwrap();
    run(&link, 20);
    assert_eq!((mode(&file), link.is_symlink()), (0o640, true));
}

#[test]
fn rejects_irregular_file_and_leaves_it_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let fifo = folder.path().join("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let link = folder.path().join("link");
    symlink("/dev/zero", &link).unwrap();
    for path in [Path::new("/dev/full"), &fifo, &link, folder.path()] {
        for resume in [Resume::Auto, Resume::Never, Resume::Require] {
            let checkpoint = Checkpoint::new(path).resume(resume);
            let run = minimize(|x: &[f64]| x[0] * x[0]).start(&[1.0]).checkpoint(checkpoint).run();
            let message = run.unwrap_err().to_string();
            assert!(message.contains("it is not a regular file"), "{message}");
        }
        assert!(!std::fs::metadata(path).unwrap().is_file());
    }
    let nowhere = minimize(|x: &[f64]| x[0] * x[0]).start(&[1.0]).checkpoint(Checkpoint::new("")).run();
    assert!(nowhere.unwrap_err().to_string().contains("the path is empty"));
}
