//! Cost of process isolation per evaluation. It is compared with a plain exchange of the same number of bytes
//! over a socket pair, and with the same evaluation in this process.
//!
//! `cargo bench -p fmufit-calibration --bench isolation`
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use calibration::RunContext;
use calibration::{Calibration, Data, Experiment, FitOptions, Parameter, SimulationSettings};
use dfo::RunOptions;
use fmi::Fmu;
use fmi::worker::Isolation;
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::process::{Command, Stdio};
use std::time::Instant;

const ROWS: usize = 800;
const CALLS: usize = 400;
const ROUNDS: usize = 15;

/// Number of bytes of a request and of a response with two outputs.
const REQUEST_LENGTH: usize = 160;
const ANSWER: usize = 8 * 2 * ROWS + 160;

fn main() {
    calibration::serve_if_worker();
    if std::env::args().any(|argument| argument == "--echo") {
        return echo();
    }
    overhead();
    fits();
}

fn echo() {
    let mut socket =
        UnixStream::from(std::os::fd::AsFd::as_fd(&std::io::stdin()).try_clone_to_owned().unwrap());
    let (mut requested, answer) = ([0; REQUEST_LENGTH], vec![1; ANSWER]);
    while socket.read_exact(&mut requested).is_ok() {
        socket.write_all(&answer).unwrap();
    }
}

fn calibration(isolation: Isolation) -> Calibration {
    let fmu = Fmu::open(example_models::example_fmu("van_der_pol").unwrap()).unwrap();
    let t: Vec<f64> = (0..ROWS).map(|i| 0.01 * i as f64).collect();
    let y: Vec<f64> = t.iter().map(|t| (2.0 * t).cos()).collect();
    let data = Data::from_columns(t, [("a".to_owned(), y.clone()), ("b".to_owned(), y)]).unwrap();
    let experiment = Experiment::new(data).output("x0", "a").output("x1", "b");
    Calibration::builder(fmu)
        .experiment(experiment)
        .parameter(Parameter::new("mu", 1.0).bounds(0.1, 3.0))
        .settings(SimulationSettings { isolation, ..SimulationSettings::default() })
        .build()
        .unwrap()
}

fn seconds_per_call(mut call: impl FnMut()) -> f64 {
    let began = Instant::now();
    (0..CALLS).for_each(|_| call());
    began.elapsed().as_secs_f64() / CALLS as f64
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn overhead() {
    let (mut socket, child_socket) = UnixStream::pair().unwrap();
    let mut child = Command::new(std::env::current_exe().unwrap())
        .arg("--echo")
        .stdin(Stdio::from(OwnedFd::from(child_socket)))
        .spawn()
        .unwrap();
    let (requested, mut answer) = ([0; REQUEST_LENGTH], vec![0; ANSWER]);
    let mut ping = || {
        socket.write_all(&requested).unwrap();
        socket.read_exact(&mut answer).unwrap();
    };
    let (here, apart) = (calibration(Isolation::None), calibration(Isolation::Process));
    let began = Instant::now();
    apart.cost(&[1.2], &RunContext::new()).unwrap();
    println!("first answer of a process: {:.1} ms", 1e3 * began.elapsed().as_secs_f64());
    let rounds: Vec<[f64; 3]> = (0..ROUNDS)
        .map(|_| {
            let cost = |calibration: &Calibration| {
                seconds_per_call(|| drop(calibration.residuals(&[1.2], &RunContext::new()).unwrap()))
            };
            [seconds_per_call(&mut ping), cost(&here), cost(&apart)]
        })
        .collect();
    let of = |value: &dyn Fn(&[f64; 3]) -> f64| 1e6 * median(rounds.iter().map(value).collect());
    println!("ping-pong of {REQUEST_LENGTH} and {ANSWER} bytes: {:.1} us", of(&|r| r[0]));
    println!("evaluation in this process:        {:.1} us", of(&|r| r[1]));
    println!("evaluation in a separate process: {:.1} us", of(&|r| r[2]));
    println!("beyond both:                       {:.1} us", of(&|r| r[2] - r[1] - r[0]));
    drop(socket);
    child.wait().unwrap();
}

/// Times whole fits, including opening the model, alternately with and without isolation.
fn fits() {
    let fit = |isolation| {
        let began = Instant::now();
        let run = RunOptions { workers: Some(2), ..FitOptions::default_run() };
        let fit = calibration(isolation).fit(run).unwrap();
        (began.elapsed().as_secs_f64(), fit.x)
    };
    let ratios = (0..ROUNDS).map(|_| {
        let ((here, x), (apart, other)) = (fit(Isolation::None), fit(Isolation::Process));
        assert_eq!(x, other);
        [here, apart]
    });
    let times: Vec<[f64; 2]> = ratios.collect();
    let ratio = median(times.iter().map(|[here, apart]| apart / here).collect());
    let here = median(times.iter().map(|[here, _]| *here).collect());
    println!("a fit that takes {:.1} ms in this process: {ratio:.2} times as long", 1e3 * here);
}
