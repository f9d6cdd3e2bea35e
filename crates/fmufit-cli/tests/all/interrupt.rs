//! Ctrl-C: the best point is printed and saved.
#![cfg(unix)]

use crate::support::{Folder, Ran, json};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::Child;

fn interrupt(child: &Child, signal: Signal) {
    let pid = Pid::from_raw(i32::try_from(child.id()).unwrap()).unwrap();
    kill_process(pid, signal).unwrap();
}

/// A fit that runs for hours.
const ENDLESS: &str = "fit problem.toml --json --save furuta.fit -O method=de -O x_tol=0 -O f_tol=0 -O max_evaluations=1000000000";

/// Ctrl-C, and the signal with which the system or another program ends this one.
#[test]
fn interrupted_fit_ends_with_best_point() {
    [Signal::INT, Signal::TERM].into_iter().for_each(ends_with_the_best_point);
}

fn ends_with_the_best_point(signal: Signal) {
    let folder = Folder::with_model("furuta");
    folder
        .run("simulate model.fmu --final-time 10 --set armFriction=0.01 --output run.csv --interval 0.05")
        .good();
    let outputs = "--output armJoint.phi=armJoint.phi --output pendulumJoint.phi=pendulumJoint.phi";
    folder.run(&format!("init model.fmu run.csv {outputs}")).good();
    let checkpointed = format!("{ENDLESS} --checkpoint furuta.ckpt");
    let result = interrupted(&folder, &checkpointed, signal);
    folder.run("report furuta.fit furuta.csv").good();
    // The checkpoint contains the state at the interrupt.
    let further = interrupted(&folder, &checkpointed.replace("fit problem", "resume problem"), signal);
    let [n, n_further] = [&result, &further].map(|result| result["n_evaluations"].as_u64().unwrap());
    let [cost, cost_further] = [&result, &further].map(|result| result["cost"].as_f64().unwrap());
    assert!(n_further >= n && cost_further <= cost, "{n} {n_further} {cost} {cost_further}");
}

/// Returns the result of a fit that a signal ends after its first evaluations.
fn interrupted(folder: &Folder, arguments: &str, signal: Signal) -> Value {
    let mut child = folder.command(arguments).spawn().unwrap();
    // Waits for the first evaluations.
    let mut lines = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.contains("evaluations") {
        line.clear();
        assert!(lines.read_line(&mut line).unwrap() > 0, "it has ended");
    }
    interrupt(&child, signal);
    let mut rest = String::new();
    lines.read_to_string(&mut rest).unwrap();
    let ran = Ran::of(child.wait_with_output().unwrap());
    assert_eq!(ran.code, 130, "{ran:?} {rest}");
    let result = json(&ran.out);
    assert_eq!((&result["termination"], &result["success"]), (&"interrupted".into(), &false.into()));
    // The start is one of the points.
    assert!(result["cost"].as_f64().unwrap() <= result["start_cost"].as_f64().unwrap(), "{result}");
    assert!(rest.contains("ending; press Ctrl-C again") && rest.contains("saved furuta.fit"), "{rest}");
    result
}

/// The page of a fit: its address is printed, and its button ends the fit like Ctrl-C. Without a terminal,
/// the program does not wait.
#[test]
fn page_button_ends_the_fit_with_best_point() {
    let folder = Folder::with_model("furuta");
    folder
        .run("simulate model.fmu --final-time 10 --set armFriction=0.01 --output run.csv --interval 0.05")
        .good();
    let outputs = "--output armJoint.phi=armJoint.phi --output pendulumJoint.phi=pendulumJoint.phi";
    folder.run(&format!("init model.fmu run.csv {outputs}")).good();
    let mut child = folder.command(&format!("{ENDLESS} --watch --quiet")).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    lines.read_line(&mut line).unwrap();
    let place = line.trim_end().strip_prefix("watch the fit at http://").unwrap_or_else(|| panic!("{line}"));
    let (host, path) = place.split_once('/').unwrap();
    let requested = |method: &str, path: &str| {
        let mut stream = TcpStream::connect(host).unwrap();
        write!(stream, "{method} /{path} HTTP/1.1\r\nHost: {host}\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    };
    while !requested("GET", &format!("{path}state")).contains("Convergence") {
        std::thread::yield_now();
    }
    assert!(requested("GET", path).contains("armFriction"));
    assert!(requested("POST", &format!("{path}stop")).starts_with("HTTP/1.1 303"));
    let ran = Ran::of(child.wait_with_output().unwrap());
    let result = json(&ran.out);
    assert_eq!((ran.code, &result["termination"]), (130, &"interrupted".into()), "{result}");
    assert!(result["cost"].as_f64().unwrap() <= result["start_cost"].as_f64().unwrap(), "{result}");
    assert!(folder.path("furuta.fit").is_file());
}

#[test]
fn interrupted_simulation_has_no_result() {
    let folder = Folder::with_model("van_der_pol");
    let arguments =
        "simulate model.fmu --final-time 1e9 --interval 1e8 --solver rk4 --step-size 1e-4 --output run.csv";
    let child = folder.command(arguments).spawn().unwrap();
    // Waits until the program handles the signal.
    let status = format!("/proc/{}/status", child.id());
    let is_watched = || {
        let text = std::fs::read_to_string(&status).unwrap();
        let caught = text.lines().find_map(|line| line.strip_prefix("SigCgt:")).unwrap().trim().to_owned();
        u64::from_str_radix(&caught, 16).unwrap() & 2 != 0
    };
    while cfg!(target_os = "linux") && !is_watched() {
        std::thread::yield_now();
    }
    interrupt(&child, Signal::INT);
    let ran = Ran::of(child.wait_with_output().unwrap());
    assert!(ran.code == 130 && ran.err.contains("interrupted") && ran.out.is_empty(), "{ran:?}");
    assert!(!folder.path("run.csv").exists());
}
