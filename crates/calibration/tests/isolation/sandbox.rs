//! Restrictions of a model in a sandbox, and validation of the answers of a worker.

use crate::support::{costs, faulty, fit};
use crate::{decay, launch, open, settings, with_limit};
use calibration::{Calibration, Data, Experiment, Parameter, RunContext, SimulationSettings};
use fmi::worker::{Isolation, check_sandbox};
use std::io::Read;
use std::net::TcpListener;
use std::path::Path;
use std::time::Duration;

/// Returns the settings of a sandbox, or `None` if the kernel does not support Landlock.
fn sandbox() -> Option<SimulationSettings> {
    check_sandbox().ok().map(|()| SimulationSettings { sandbox: true, ..settings(Isolation::Process) })
}

/// Returns a model that executes `attack` at k above 2.2, with a folder and a port of this machine as
/// targets.
fn attacking(attack: &str, outside: &Path, port: u16) -> tempfile::TempDir {
    let (fault, port) = (format!("FAULT={attack}"), format!("PORT={port}"));
    let outside = format!("OUTSIDE=\"{}\"", outside.display());
    faulty(&["_GNU_SOURCE", "ATTACKS", "FAULT_ABOVE=2.2", &fault, &outside, &port])
}

/// The model runs code in signal handlers of every thread, threads, forked processes, thread destructors, the
/// program and the library. Without a sandbox, each of them can access everything that the user can access.
/// In a sandbox, none of them can.
#[test]
fn sandbox_confines_all_code_of_a_model() {
    let outside = tempfile::tempdir().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let folder = attacking("attack()", outside.path(), listener.local_addr().unwrap().port());
    let reached = |settings: SimulationSettings| {
        let error = decay(open(&folder), settings).cost(&[3.0], &RunContext::new()).unwrap_err().to_string();
        let n_threads = error.split(" handlers").next().unwrap().rsplit(' ').next().unwrap().to_owned();
        assert!(error.contains("exit(3)") && error.contains(&format!("{n_threads} threads")), "{error}");
        let written = std::fs::read_dir(outside.path()).unwrap().flatten();
        let mut written: Vec<_> = written.map(|file| file.file_name().into_string().unwrap()).collect();
        written.sort();
        let mut sent: Vec<String> = Vec::new();
        while let Ok((mut connection, _)) = listener.accept() {
            let mut text = String::new();
            connection.set_nonblocking(false).unwrap();
            connection.read_to_string(&mut text).unwrap();
            sent.push(text);
        }
        sent.sort();
        (n_threads.parse::<usize>().unwrap(), written, sent)
    };
    let (n_threads, written, sent) = reached(settings(Isolation::Process));
    let mut expected: Vec<String> = (0..n_threads).map(|k| format!("handler-{k}")).collect();
    expected.extend(["call", "child", "end-of-thread", "exit", "thread", "unloading"].map(str::to_owned));
    expected.sort();
    assert!(n_threads >= 3 && written == expected && sent == expected, "{written:?}, {sent:?}");
    for name in expected {
        std::fs::remove_file(outside.path().join(name)).unwrap();
    }
    let Some(confined) = sandbox() else { return };
    let (confined_threads, written, sent) = reached(confined);
    assert_eq!((confined_threads, written, sent), (n_threads, Vec::new(), Vec::new()));
}

#[test]
fn sandbox_blocks_unneeded_system_calls() {
    let Some(confined) = sandbox() else { return };
    let outside = tempfile::tempdir().unwrap();
    std::fs::write(outside.path().join("own"), "kept").unwrap();
    let folder = attacking("probe()", outside.path(), 9);
    let before = std::fs::metadata(outside.path().join("own")).unwrap();
    let error = decay(open(&folder), confined).cost(&[3.0], &RunContext::new()).unwrap_err().to_string();
    assert!(error.contains("exit(9)") && error.ends_with("last output: all tried"), "{error}");
    let after = std::fs::metadata(outside.path().join("own")).unwrap();
    assert_eq!(std::fs::read(outside.path().join("own")).unwrap(), b"kept");
    assert_eq!(
        (before.modified().unwrap(), before.permissions()),
        (after.modified().unwrap(), after.permissions())
    );
    assert_eq!(std::fs::read_dir(outside.path()).unwrap().count(), 1);
}

/// The fit is bit-for-bit identical, and none of its processes remains.
#[test]
fn sandbox_gives_bit_identical_fits() {
    let Some(confined) = sandbox() else { return };
    let folder = faulty(&[]);
    let expected = fit(&decay(open(&folder), settings(Isolation::Process)), 2, 60);
    let calibration = decay(open(&folder), confined);
    let found = fit(&calibration, 2, 60);
    assert_eq!(costs(&found), costs(&expected));
}

#[test]
fn sandbox_is_rejected_before_the_run_when_the_model_is_not_confined() {
    let folder = faulty(&[]);
    launch();
    let settings = SimulationSettings { sandbox: true, ..settings(Isolation::None) };
    let data = Data::from_columns(vec![0.0, 1.0], [("y".to_owned(), vec![1.0, 0.5])]).unwrap();
    let built = Calibration::builder(open(&folder))
        .experiment(Experiment::new(data).output("y", "y"))
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 5.0))
        .settings(settings)
        .build();
    let error = built.unwrap_err().to_string();
    let expected = if check_sandbox().is_ok() { "isolation = \"none\"" } else { "sandbox: " };
    assert!(error.contains(expected) && !error.contains("To run the FMU in this process"), "{error}");
}

/// False claims of a worker cannot change the clock of its parent or make the parent read endlessly.
#[test]
fn parent_is_not_delayed_by_false_claims_of_a_worker() {
    let outside = tempfile::tempdir().unwrap();
    let cases = [
        ("claim_runs()", "no answer within the time limit"),
        ("answer_byte_by_byte()", "no answer within the time limit"),
        (
            "answer_too_much()",
            "the answer of the worker is invalid (a message of 0 bytes and 33554432 numbers)",
        ),
        ("answer_cut_off()", "the answer of the worker is invalid (its header is truncated)"),
    ];
    for (attack, expected) in cases {
        let folder = attacking(attack, outside.path(), 9);
        let calibration = decay(open(&folder), with_limit(Some(Duration::from_millis(500))));
        // Without its time limit, the call would end with the context.
        let context = RunContext::new().within(Some(Duration::from_secs(20)));
        let error = calibration.cost(&[3.0], &context).unwrap_err().to_string();
        assert!(error.contains(expected) && error.contains("k = 3"), "{attack}: {error}");
        let found = fit(&calibration, 2, 40);
        let failed: Vec<_> = found.report.failures.iter().map(|(message, _)| message.as_str()).collect();
        assert!(!failed.is_empty() && failed.iter().all(|message| message.contains(expected)), "{failed:?}");
        assert!((found.x[0] - 1.7).abs() < 0.2, "{attack}: {:?}", found.x);
    }
}
