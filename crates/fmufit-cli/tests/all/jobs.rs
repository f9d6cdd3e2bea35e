//! `jobs`: a fit by processes that share a folder, some of which are killed.
#![cfg(unix)]

use crate::fit::PROBLEM;
use crate::support::{Folder, Ran, json};
use serde_json::Value;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// Folder with a problem of two parameters and its recording.
fn furuta() -> Folder {
    let folder = Folder::with_model("furuta");
    folder
        .run("simulate model.fmu --final-time 40 --set armFriction=0.01 --output run.csv --interval 0.05")
        .good();
    folder.write("problem.toml", FURUTA);
    folder
}

const FURUTA: &str = r#"model = "model.fmu"

[[experiments]]
data = "run.csv"
outputs = { "armJoint.phi" = "armJoint.phi", "pendulumJoint.phi" = "pendulumJoint.phi" }

[[parameters]]
name = "armFriction"
start = 0.012
lower = 0
upper = 0.022

[[parameters]]
name = "pendulumFriction"
start = 0.002
lower = 0
upper = 0.012

[settings]
relative_tolerance = 1e-9
"#;

/// Folder with a decay and its problem file.
fn decay() -> Folder {
    let folder = Folder::with_model("dahlquist");
    folder.record_decay();
    folder.write("problem.toml", PROBLEM);
    folder
}

/// Parts of a result that depend neither on the number of processes nor on their ends. One finding reports the
/// number of lost answers.
fn path(result: &Value) -> (Vec<&Value>, Vec<&Value>) {
    let parts =
        ["parameters", "cost", "n_evaluations", "n_iterations", "message", "method", "noise", "outputs"];
    let findings = result["findings"].as_array().unwrap().iter().filter(|finding| finding["id"] != "F034");
    (parts.map(|name| &result[name]).to_vec(), findings.collect())
}

fn start(folder: &Folder) -> Child {
    let mut command = folder.command("jobs run problem.toml --json --quiet");
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// Numbers from a linear congruential generator (Knuth, MMIX).
fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    *state >> 33
}

fn result(folder: &Folder) -> Value {
    folder.run("report problem.jobs/result.fit result.json --quiet").good();
    json(&folder.read("result.json"))
}

#[test]
fn killed_jobs_give_the_same_bits_as_one_process() {
    for (options, seed) in [("-O rng=5 -O method=de -O max_evaluations=200", 1), ("-O rng=5", 2)] {
        let folder = furuta();
        let alone = json(&folder.run(&format!("fit problem.toml --json {options} -O workers=8")).out);
        folder.run(&format!("jobs init problem.toml --jobs 8 --lease 1 {options}")).good();
        let (mut jobs, mut state, mut n_killed) = (Vec::new(), seed, 0);
        jobs.resize_with(8, || start(&folder));
        let begin = Instant::now();
        while !folder.path("problem.jobs/result.fit").exists() {
            assert!(
                begin.elapsed() < Duration::from_secs(300),
                "{:?}",
                folder.run("jobs status problem.toml")
            );
            std::thread::sleep(Duration::from_millis(20 + random(&mut state) % 300));
            if n_killed < 16 {
                // Every second one is the process that drives the fit, if there is one.
                let driver =
                    std::fs::read_to_string(folder.path("problem.jobs/driver.lock")).unwrap_or_default();
                let driver = jobs.iter().position(|job| n_killed % 2 == 0 && job.id().to_string() == driver);
                let k = driver.unwrap_or(random(&mut state) as usize % jobs.len());
                // The process may have ended already.
                let _ = jobs[k].kill();
                jobs[k].wait().unwrap();
                jobs[k] = start(&folder);
                n_killed += 1;
            }
        }
        jobs.iter_mut().for_each(|job| _ = job.wait().unwrap());
        let together = result(&folder);
        assert_eq!(path(&together), path(&alone), "{options}");
        let status = json(&folder.run("jobs status problem.toml --json").good());
        assert_eq!(
            (&status["is_done"], &status["n_waiting"], &together["n_lost"]),
            (&true.into(), &0.into(), &status["n_lost"]),
            "{status}"
        );
    }
}

#[test]
fn point_of_a_killed_job_is_evaluated_again_and_counted() {
    let folder = decay();
    let alone = json(&folder.run("fit problem.toml --json -O workers=2").good());
    folder.run("jobs init problem.toml --jobs 2 --lease 1").good();
    // A claim without a process is like the claim of a killed job.
    let claim = json(&folder.run("jobs next problem.toml --lease 1").good());
    assert_eq!((&claim["state"], &claim["parameters"]["k"]), (&"point".into(), &1.0.into()));
    folder.run("jobs run problem.toml --quiet").good();
    let together = result(&folder);
    assert_eq!(path(&together), path(&alone));
    assert_eq!(together["n_lost"], 1);
}

#[test]
fn interrupted_job_leaves_its_point_to_another_job() {
    let folder = decay();
    folder.run("jobs init problem.toml --jobs 2").good();
    let mut job = start(&folder);
    let answers = || std::fs::read_dir(folder.path("problem.jobs/answers")).unwrap().count();
    while answers() == 0 && !folder.path("problem.jobs/result.fit").exists() {
        std::thread::sleep(Duration::from_millis(1));
    }
    let pid = rustix::process::Pid::from_raw(i32::try_from(job.id()).unwrap()).unwrap();
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    job.wait().unwrap();
    // The lease is longer than this test may take.
    folder.run("jobs run problem.toml --quiet").good();
    assert_eq!(result(&folder)["n_lost"], 0);
}

#[test]
fn another_program_can_evaluate_the_points() {
    let folder = decay();
    let alone = json(&folder.run("fit problem.toml --json -O workers=3").good());
    folder.run("jobs init problem.toml --jobs 3").good();
    let measured: Vec<(f64, f64)> = folder.read("run.csv").lines().skip(1).map(numbers).collect();
    let mut n = 0;
    loop {
        let next = json(&folder.run("jobs next problem.toml").good());
        if next["state"] == "done" {
            break;
        }
        assert_eq!(next["state"], "point", "{next}");
        let point = next["point"].as_str().unwrap();
        if n == 0 {
            let wrong =
                folder.run(&format!("jobs tell problem.toml {point} --residuals run.csv")).wrong_input();
            assert!(wrong.contains("run.csv: 'time' is not a number"), "{wrong}");
            folder.write("short", "1.0");
            let wrong =
                folder.run(&format!("jobs tell problem.toml {point} --residuals short")).wrong_input();
            assert!(wrong.contains("1 residuals given") && wrong.contains("expected 41"), "{wrong}");
        }
        let k = next["parameters"]["k"].as_f64().unwrap();
        // Any function may replace the model.
        let residuals: Vec<String> =
            measured.iter().map(|(t, x)| format!("{:?}", (-k * t).exp() - x)).collect();
        folder.write("residuals", &residuals.join("\n"));
        folder.run(&format!("jobs tell problem.toml {point} --residuals residuals")).good();
        n += 1;
        assert!(n < 100);
    }
    let [found, expected] =
        [&result(&folder), &alone].map(|fit| fit["parameters"][0]["value"].as_f64().unwrap());
    assert!(n > 3 && (found - expected).abs() < 1e-4, "{n} {found} {expected}");
    assert!(folder.run("jobs tell problem.toml ../x --failed no").wrong_input().contains("is not claimed"));
}

fn numbers(row: &str) -> (f64, f64) {
    let (t, x) = row.split_once(',').unwrap();
    (t.parse().unwrap(), x.parse().unwrap())
}

#[test]
fn other_problems_and_damaged_files_are_errors_with_names() {
    let folder = decay();
    assert!(folder.run("jobs run problem.toml").wrong_input().contains("jobs init"));
    let timed = folder.run("jobs init problem.toml --jobs 2 -O max_time=5").wrong_input();
    assert!(timed.contains("max_time is not available for jobs"), "{timed}");
    folder.run("jobs init problem.toml --jobs 2").good();
    assert!(folder.run("jobs init problem.toml --jobs 2").wrong_input().contains("problem.jobs"));
    for (from, to, expected) in [
        ("start = 1.0", "start = 1.5", "start value of parameter k is 1.0 there and 1.5 here"),
        ("upper = 10", "upper = 9", "bounds of parameter k is 0.1 to 10.0 there and 0.1 to 9.0 here"),
        ("outputs", "weights = { x = 2 }\noutputs", "weight"),
        ("[[parameters]]", "[fit]\nf_tol = 1e-3\n[[parameters]]", "f_tol is 0.0001 there and 0.001 here"),
    ] {
        folder.write("other.toml", &PROBLEM.replace(from, to));
        let message = folder.run("jobs run other.toml --folder problem.jobs").wrong_input();
        assert!(message.contains("belongs to another fit") && message.contains(expected), "{message}");
    }
    folder.run("jobs run problem.toml --quiet").good();
    let names = |part: &str| -> Vec<_> {
        let entries = std::fs::read_dir(folder.path("problem.jobs").join(part)).unwrap();
        entries.map(|entry| entry.unwrap().path()).collect()
    };
    // Another job continues after the answers of this one.
    std::fs::remove_file(folder.path("problem.jobs/result.fit")).unwrap();
    let answer = names("answers").remove(0);
    let mut bytes = std::fs::read(&answer).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&answer, bytes).unwrap();
    let ran = folder.run("jobs run problem.toml --quiet");
    let name = answer.file_name().unwrap().to_str().unwrap();
    assert!(ran.code == 2 && ran.err.contains(name) && ran.err.contains("is damaged"), "{ran:?}");
    std::fs::remove_file(&answer).unwrap();
    folder.run("jobs run problem.toml --quiet").good();
}

/// A killed process of this test must not leave the program running.
#[test]
fn job_ends_when_another_job_has_ended_the_fit() {
    let folder = decay();
    folder.run("jobs init problem.toml --jobs 2").good();
    let jobs = [start(&folder), start(&folder)];
    for job in jobs {
        let ran = Ran::of(job.wait_with_output().unwrap());
        assert_eq!(ran.code, 0, "{ran:?}");
    }
    assert!(folder.run("jobs status problem.toml").good().contains("the fit has ended"));
}
