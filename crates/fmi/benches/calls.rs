//! Overhead of the safe layer per call into an FMU. The same calls are made from Rust and from a C program
//! (`raw_calls.c`), with the same library, in one run. `cargo bench -p fmufit-fmi --bench calls`.

#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use example_models::example_fmu;
use fmi::{Fmu, platform};
use std::path::Path;
use std::process::Command;
use std::time::Instant;

const CALLS: u32 = 200_000;

/// Nanoseconds per call: the minimum of 30 repetitions, because other load on the machine only increases the
/// time.
fn best(mut call: impl FnMut(u32)) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..30 {
        let begin = Instant::now();
        for i in 0..CALLS {
            call(i);
        }
        best = best.min(begin.elapsed().as_secs_f64());
    }
    1e9 * best / f64::from(CALLS)
}

/// Names of the same calls from C, with their times in nanoseconds.
fn raw(library: &Path, token: &str, n_states: usize) -> Vec<(String, f64)> {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("raw_calls");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/raw_calls.c");
    let built =
        Command::new("cc").arg("-O2").arg("-o").arg(&program).arg(source).arg("-ldl").output().unwrap();
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let run = Command::new(program)
        .arg(library)
        .args([token, &n_states.to_string(), &CALLS.to_string()])
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    String::from_utf8(run.stdout)
        .unwrap()
        .lines()
        .map(|line| {
            let (name, time) = line.rsplit_once(' ').unwrap();
            (name.to_owned(), time.parse().unwrap())
        })
        .collect()
}

fn main() {
    let fmu = Fmu::open(example_fmu("van_der_pol").unwrap()).unwrap();
    let description = fmu.description();
    let interface = description.model_exchange.as_ref().unwrap();
    let library = platform::find_binary(
        &fmu.root().unwrap(),
        &interface.model_identifier,
        platform::FolderNames::SystemAndBits,
    )
    .unwrap()
    .path;
    let raw = raw(&library, &description.guid, description.n_states());

    let instance = fmu.instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap().enter_continuous_time().unwrap();
    let reference = [description.variable("x0").unwrap().value_reference];
    let (x, mut dx, mut one) = ([2.0, 0.0], [0.0; 2], [0.0]);
    let safe = [
        best(|i| instance.set_time(1e-9 * f64::from(i)).unwrap()),
        best(|_| instance.set_continuous_states(&x).unwrap()),
        best(|_| instance.get_derivatives(&mut dx).unwrap()),
        best(|i| instance.right_hand_side(1e-9 * f64::from(i), &x, &mut dx).unwrap()),
        best(|_| instance.get_reals(&reference, &mut one).unwrap()),
    ];
    println!("{:<24} {:>10} {:>10} {:>12}", "call", "raw C ns", "here ns", "added ns");
    for ((name, raw), safe) in raw.into_iter().zip(safe) {
        println!("{name:<24} {raw:>10.1} {safe:>10.1} {:>12.1}", safe - raw);
    }
}
