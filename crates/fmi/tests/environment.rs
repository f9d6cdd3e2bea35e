//! Changes that FMUs make to their thread are undone, and late messages are harmless.

#![cfg(all(target_os = "linux", target_arch = "x86_64"))]
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use fmi::{InterfaceChoice, SimulateOptions, SimulationPlan, Simulator, Trajectory};
use std::sync::Arc;
use std::time::Duration;
use support::{Folder, evil, evil_with};

fn both_kinds(faults: &[&str]) -> Folder {
    evil_with(faults, |xml| {
        xml.replace(
            "<ModelExchange modelIdentifier=\"evil\"/>",
            "<ModelExchange modelIdentifier=\"evil\"/>\
             <CoSimulation modelIdentifier=\"evil\" canHandleVariableCommunicationStepSize=\"true\"/>",
        )
    })
}

fn bits(t: &Trajectory) -> Vec<u64> {
    t.columns.iter().flatten().chain(&t.time).map(|v| v.to_bits()).collect()
}

#[test]
fn runs_are_reproducible_when_model_changes_float_mode() {
    let options = SimulateOptions::new().ncp(50).outputs(["y", "der(x)"]).parameters(["k"]);
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let options = options.clone().kind(kind);
        let runs = |folder: &Folder, k: [f64; 3]| {
            let plan = Arc::new(SimulationPlan::new(&folder.open(), &options).unwrap());
            let mut simulator = Simulator::new(plan).unwrap();
            k.map(|k| bits(&simulator.trajectory(&[k]).unwrap()))
        };
        let [truth, ..] = runs(&both_kinds(&[]), [1.7; 3]);
        for place in 1..=6 {
            let folder = both_kinds(&[&format!("FLOAT_IN={place}"), "ROUNDS_UP"]);
            let [first, second, _] = runs(&folder, [1.7; 3]);
            let [_, _, after_others] = runs(&folder, [0.3, 2.9, 1.7]);
            assert!(first == second && first == after_others, "{kind:?}, {place}");
            // In instantiation, freeing and initialization, the mode does not affect the run.
            assert!(![1, 5, 6].contains(&place) || first == truth, "{kind:?}, {place}");
        }
    }
    // The thread has its earlier mode, and arithmetic of this program is unaffected.
    let tiny = std::hint::black_box(1e-310f64);
    assert!(tiny / 2.0 > 0.0 && std::hint::black_box(1.0) / std::hint::black_box(0.0f64) > 1.0);
}

#[test]
fn manual_calls_restore_float_mode() {
    let folder = evil(&["FLOAT_IN=3", "UNMASKS"]);
    let instance = folder.open().instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap().enter_continuous_time().unwrap();
    let mut dx = [0.0];
    for _ in 0..3 {
        instance.get_derivatives(&mut dx).unwrap();
        assert_eq!(std::hint::black_box(1.0) / std::hint::black_box(3.0f64), 1.0 / 3.0);
        instance.right_hand_side(0.5, &[0.1], &mut dx).unwrap();
        assert_eq!(std::hint::black_box(dx[0]) * 0.1, -0.1 * 0.1);
    }
}

#[test]
fn delayed_messages_of_foreign_threads_are_harmless() {
    // FMI 3.0 has a different callback.
    for folder in [evil(&["LOGS_LATE"]), support::fixture_with("arrays", &["LOGS_LATE"], |xml| xml)] {
        let fmu = folder.open();
        for _ in 0..20 {
            drop(fmu.instantiate().unwrap());
            // Freed memory is reused for other data.
            let scratch: Vec<Vec<u8>> = (0..200).map(|n| vec![0xa5; n]).collect();
            std::hint::black_box(&scratch);
        }
        std::thread::sleep(Duration::from_millis(20));
        drop(fmu);
        let scratch: Vec<Vec<u8>> = (0..2000).map(|n| vec![0xa5; n % 300]).collect();
        std::thread::sleep(Duration::from_millis(80));
        std::hint::black_box(&scratch);
    }
}

#[test]
fn binary_value_larger_than_memory_is_an_error() {
    let limited =
        |xml: String| xml.replacen("valueReference=\"23\"", "valueReference=\"23\" maxSize=\"1000\"", 1);
    // In the last case, the model has fewer bytes than it reports, but more than its variable allows.
    for (power, is_limited) in [(63, false), (40, false), (40, true), (10, true)] {
        let defines = [format!("HUGE_BINARY={power}")];
        let folder =
            support::fixture_with(
                "arrays",
                &defines.each_ref().map(String::as_str),
                |xml| match is_limited {
                    true => limited(xml),
                    false => xml,
                },
            );
        let fmu = folder.open();
        let instance = fmu.instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
        let mut instance = instance.exit_initialization().unwrap();
        let message = format!(
            "fmi3GetBinary: the FMU returned a value of {} bytes, which exceeds its maxSize or the available \
             memory",
            1u64 << power
        );
        assert_eq!(instance.get("bytes").unwrap_err().to_string(), message);
        drop(instance);
        // Also in a simulation.
        for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
            let options = SimulateOptions::new().kind(kind).final_time(1.0).outputs(["bytes"]);
            let error = fmu.simulate(&options).unwrap_err().to_string();
            assert!(error.contains(&message), "{kind:?}: {error}");
        }
    }
}
