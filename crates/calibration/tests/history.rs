//! Models that keep a state which no variable shows: a fit has the same result for any number of workers.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

mod support;

use fmi::{Fmu, Sharing};
use support::{calibration, costs, faulty, fit};

#[test]
fn a_fit_begins_anew_where_its_simulations_depend_on_earlier_ones() {
    let honest = fit(&calibration(Fmu::open(faulty(&[]).path()).unwrap(), Sharing::Copies), 1, 150);
    assert_eq!(honest.n_beginnings, 1);
    for fault in ["REMEMBERS=2.2", "REMEMBERS_IN_INSTANCE=2.2"] {
        let folder = faulty(&[fault]);
        let mut first = None;
        for workers in [1, 2, 5] {
            let (_files, fmu) = open_copy(folder.path());
            let calibration = calibration(fmu, Sharing::Copies);
            let found = fit(&calibration, workers, 150);
            assert!(
                found.n_beginnings > 1 && found.to_string().contains("begun"),
                "{}",
                found.report.message
            );
            assert_eq!(found.report.n_evaluations, 150);
            // What it says of its best point is what a new calibration finds there, first of all.
            let again = support::calibration(Fmu::open(folder.path()).unwrap(), Sharing::Copies);
            assert_eq!(again.cost(&found.x).unwrap().to_bits(), found.cost.to_bits(), "{fault} {workers}");
            let expected = first.get_or_insert_with(|| costs(&found));
            assert_eq!(&costs(&found), expected, "{fault} {workers}");
        }
    }
}

/// Every N-th run of a loaded copy fails: none of the runs that are made again for their number may be among them.
#[test]
fn a_fit_does_not_depend_on_workers_where_every_nth_run_fails() {
    for fault in ["FAILING_START=fmi2Fatal", "FAILING_LATE=fmi2Error"] {
        for n in [3, 8, 13] {
            let folder = faulty(&[fault, &format!("ODD_RUN=runs%{n}==0")]);
            let mut first = None;
            for workers in [1, 2, 3] {
                let (_files, fmu) = open_copy(folder.path());
                let found = fit(&calibration(fmu, Sharing::Copies), workers, 120);
                assert!(found.n_beginnings > 1, "{fault} {n} {workers}");
                assert_eq!(found.report.n_failed, 0, "{fault} {n} {workers}");
                let expected = first.get_or_insert_with(|| costs(&found));
                assert_eq!(&costs(&found), expected, "{fault} {n} {workers}");
            }
        }
    }
}

/// Every N-th run of a loaded copy is another one; the points that are looked at again at the end show it.
#[test]
fn a_fit_looks_at_some_of_its_costs_again() {
    let honest = fit(&calibration(Fmu::open(faulty(&[]).path()).unwrap(), Sharing::Copies), 1, 300);
    assert_eq!(honest.n_beginnings, 1);
    for n in [7, 11, 13] {
        let folder = faulty(&["ODD_FACTOR=1.5", &format!("ODD_RUN=runs%{n}==0")]);
        let (_files, fmu) = open_copy(folder.path());
        let found = fit(&calibration(fmu, Sharing::Copies), 1, 300);
        assert_eq!((found.n_beginnings, &found.x, found.cost), (2, &honest.x, honest.cost), "{n}");
    }
}

/// An instance that cannot be ended costs its loaded copy, and no evaluation.
#[test]
fn fatal_at_the_end_of_a_run_changes_no_cost() {
    let honest = faulty(&[]);
    let expected = fit(&calibration(Fmu::open(honest.path()).unwrap(), Sharing::Copies), 1, 60);
    for (status, workers) in [("fmi2Fatal", 1), ("fmi2Fatal", 3), ("fmi2Error", 2)] {
        let folder = faulty(&[&format!("TERMINATE={status}"), "SHARED_GLOBALS"]);
        let found = fit(&calibration(Fmu::open(folder.path()).unwrap(), Sharing::Copies), workers, 60);
        assert_eq!(costs(&found), costs(&expected), "{status} {workers}");
        assert_eq!(found.report.n_failed, 0);
    }
}

/// Opened from files of its own: nothing is known of it yet.
fn open_copy(folder: &std::path::Path) -> (tempfile::TempDir, Fmu) {
    let copy = tempfile::tempdir().unwrap();
    copy_folder(folder, copy.path());
    let fmu = Fmu::open(copy.path()).unwrap();
    (copy, fmu)
}

fn copy_folder(from: &std::path::Path, to: &std::path::Path) {
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            std::fs::create_dir_all(&target).unwrap();
            copy_folder(&path, &target);
        } else {
            std::fs::copy(&path, &target).unwrap();
        }
    }
}
