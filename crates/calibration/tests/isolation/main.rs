//! FMUs in separate processes: bit-for-bit identical results, crashes as outcomes, and no remaining
//! processes.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

#[path = "../support/mod.rs"]
mod support;

mod hidden_state;
mod sandbox;

use calibration::RunContext;
use calibration::{
    Calibration, Data, Experiment, FitOptions, Parameter, Prior, ProfileOptions, SimulationSettings,
    ValidationSet,
};
use dfo::{Checkpoint, DifferentialEvolution, LeastSquares, Limits, RunOptions, Termination};
use fmi::worker::{Isolation, Launcher};
use fmi::{Fmu, RunSettings};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use support::{costs, faulty, fit};

/// Sets the program that starts workers.
fn launch() {
    Launcher::of(env!("CARGO_BIN_EXE_fmufit-worker")).set();
}

fn settings(isolation: Isolation) -> SimulationSettings {
    SimulationSettings { isolation, ..SimulationSettings::default() }
}

/// Returns settings with a time limit.
fn with_limit(timeout: Option<Duration>) -> SimulationSettings {
    SimulationSettings {
        isolation: Isolation::Process,
        ..RunSettings { timeout, ..RunSettings::default() }.into()
    }
}

/// Returns a calibration to y = exp(-1.7 t), which the model matches at k = 1.7.
fn decay(fmu: Fmu, settings: SimulationSettings) -> Calibration {
    launch();
    let t: Vec<f64> = (0..=20).map(|i| 0.05 * f64::from(i)).collect();
    let y = t.iter().map(|t: &f64| (-1.7 * t).exp()).collect();
    let calibration = Calibration::builder(fmu)
        .experiment(Experiment::new(Data::from_columns(t, [("y".to_owned(), y)]).unwrap()).output("y", "y"))
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 5.0))
        .settings(settings)
        .build()
        .unwrap();
    assert_eq!(calibration.isolation().1, None);
    calibration
}

fn open(folder: &tempfile::TempDir) -> Fmu {
    Fmu::open(folder.path()).unwrap()
}

/// With more workers than points, the recordings of a point are simulated at the same time.
#[test]
fn recordings_on_several_workers_give_identical_bits_failures_and_statistics() {
    launch();
    let folder = faulty(&["SLOW=200", "FAULT_ABOVE=2.0", "FAULT=abort()"]);
    let recording = |n: usize| {
        let t: Vec<f64> = (0..=n).map(|i| 0.05 * i as f64).collect();
        let y = t.iter().map(|t: &f64| (-1.7 * t).exp() + 0.01 * (31.0 * t).sin()).collect();
        Experiment::new(Data::from_columns(t, [("y".to_owned(), y)]).unwrap()).output("y", "y")
    };
    let run = |isolation: Isolation, workers: usize, start: f64| {
        let calibration = [20, 7, 30, 3, 12]
            .into_iter()
            .fold(Calibration::builder(open(&folder)), |builder, n| builder.experiment(recording(n)))
            .parameter(
                Parameter::new("k", start).bounds(0.1, 5.0).prior(Prior::Normal { mean: 1.5, sd: 0.2 }),
            )
            .settings(settings(isolation))
            .build()
            .unwrap();
        let method = LeastSquares::default().serial().into();
        calibration.fit(RunOptions { method, workers: Some(workers), ..FitOptions::default_run() }).unwrap()
    };
    for start in [1.0, 1.99] {
        let alone = run(Isolation::Process, 1, start);
        for workers in [2, 4, 9] {
            let found = run(Isolation::Process, workers, start);
            assert_eq!(costs(&found), costs(&alone), "{workers}");
            assert_eq!(found.report.failures, alone.report.failures);
            assert_eq!(found.stats.right_hand_sides, alone.stats.right_hand_sides);
            assert_eq!(format!("{:?}", found.uncertainty), format!("{:?}", alone.uncertainty));
        }
    }
}

#[test]
fn results_are_bit_identical_in_this_and_other_processes() {
    let folder = faulty(&[]);
    let alone = decay(open(&folder), settings(Isolation::None));
    let expected = fit(&alone, 1, 100);
    for workers in [1, 2, 7] {
        let apart = decay(open(&folder), settings(Isolation::Process));
        let found = fit(&apart, workers, 100);
        assert_eq!(costs(&found), costs(&expected), "{workers}");
        assert_eq!(format!("{:?}", found.uncertainty), format!("{:?}", expected.uncertainty));
        assert_eq!(
            apart.residuals(&[2.0], &RunContext::new()).unwrap(),
            alone.residuals(&[2.0], &RunContext::new()).unwrap()
        );
        let (one, other) = (
            apart.simulate(&[2.0], None, &RunContext::new()).unwrap(),
            alone.simulate(&[2.0], None, &RunContext::new()).unwrap(),
        );
        assert_eq!(one, other);
        let variables = ["x".to_owned(), "der(x)".to_owned()];
        let recorded = |calibration: &Calibration| {
            calibration.simulate_variables(0, &[2.0], Some(&[0.0, 0.5]), &variables, &RunContext::new())
        };
        assert_eq!(recorded(&apart).unwrap(), recorded(&alone).unwrap());
        assert_eq!(apart.solver(), alone.solver());
    }
}

/// The best point is evaluated again in a fresh process, which is not counted as an evaluation. This is
/// skipped after a short search.
#[test]
fn repeated_best_point_is_counted_separately_from_evaluations() {
    let folder = faulty(&[]);
    let calibration = decay(open(&folder), settings(Isolation::Process));
    let few = fit(&calibration, 1, 3);
    assert!(few.skipped.contains(&"comparison with a fresh process".to_owned()), "{:?}", few.skipped);
    let found = fit(&calibration, 1, 12);
    let one = calibration.simulate(&found.x, None, &RunContext::new()).unwrap()[0].stats;
    let (checks, n) = (found.stats.checks, found.report.n_evaluations);
    assert!(n == 12 && checks.runs >= 1 && checks.steps >= one.accepted_steps, "{n}, {checks:?}");
    assert!(!found.skipped.contains(&"comparison with a fresh process".to_owned()), "{:?}", found.skipped);
    assert!(found.stats.seconds.get() > checks.seconds.get() && checks.seconds.get() > 0.0);
}

/// Faults above k = 2.2, and the expected messages.
const DEATHS: [(&str, &str); 5] = [
    ("raise(SIGSEGV)", "segmentation fault in fmi2GetDerivatives"),
    ("abort()", "abort in fmi2GetDerivatives"),
    ("exit(3)", "the process called exit(3) in fmi2GetDerivatives"),
    ("overflow(m->time)", "in fmi2GetDerivatives"),
    ("close_all()", " in fmi2"),
];

#[test]
fn crashed_worker_fails_only_one_evaluation() {
    for (fault, reported) in DEATHS {
        let folder = faulty(&["FAULT_ABOVE=2.2", &format!("FAULT={fault}")]);
        let calibration = decay(open(&folder), settings(Isolation::Process));
        let found = fit(&calibration, 2, 60);
        assert!((found.x[0] - 1.7).abs() < 0.1, "{fault}: {:?}", found.x);
        let failed: Vec<_> = found.report.failures.iter().map(|(message, _)| message.as_str()).collect();
        assert!(
            failed.iter().all(|message| message.contains(reported)) && !failed.is_empty(),
            "{fault}: {failed:?}"
        );
        let error = calibration.cost(&[3.0], &RunContext::new()).unwrap_err().to_string();
        assert!(error.contains(reported) && error.contains("k = 3"), "{error}");
    }
}

#[test]
fn hanging_worker_ends_soon_after_the_time_limit() {
    let folder = faulty(&["FAULT_ABOVE=2.2", "FAULT=hang()"]);
    let timeout = Some(Duration::from_millis(300));
    let calibration = decay(open(&folder), with_limit(timeout));
    assert!(calibration.cost(&[1.0], &RunContext::new()).is_ok());
    let error = calibration.cost(&[3.0], &RunContext::new()).unwrap_err().to_string();
    assert!(error.contains("no answer within the time limit in fmi2GetDerivatives"), "{error}");
    // Without a time limit, the hanging simulation ends with the fit that it belongs to.
    let calibration = decay(open(&folder), settings(Isolation::Process));
    let limits = Limits { max_time: Some(Duration::from_secs(2)), ..Limits::default() };
    let run = RunOptions { limits, workers: Some(1), ..FitOptions::default_run() };
    let found = calibration.fit(FitOptions { start: Some(vec![2.0]), ..run.into() });
    assert!(found.is_ok(), "{:?}", found.err());
    let short = RunContext::new().within(Some(Duration::from_millis(200)));
    assert!(calibration.cost(&[3.0], &short).is_err());
}

/// The rows are complete, so the call is omitted from then on and reported once.
#[test]
fn crash_at_the_end_of_a_run_fails_no_evaluation() {
    let hang = ["FAULT_ABOVE=0", "FAULT=hang()", "FAULT_AT_END"];
    for (faults, function) in [
        (&["AT_TERMINATE=abort()"][..], "fmi2Terminate"),
        (&["AT_FREE=abort()"], "fmi2FreeInstance"),
        (&["AT_RESET=abort()"], "fmi2Reset"),
        (&["AT_TERMINATE=abort()", "AT_FREE=*(volatile int *)0 = 1"], "fmi2FreeInstance"),
        (&hang, "fmi2Terminate"),
    ] {
        let folder = faulty(faults);
        let sound = faulty(&[]);
        let expected = decay(open(&sound), settings(Isolation::None));
        // A hang is only detected by the time limit.
        let timeout = (faults.len() == hang.len()).then_some(Duration::from_millis(300));
        let calibration = decay(open(&folder), with_limit(timeout));
        for k in [1.0, 3.0, 1.5] {
            let costs =
                [&calibration, &expected].map(|c| c.cost(&[k], &RunContext::new()).unwrap().to_bits());
            assert_eq!(costs[0], costs[1], "{faults:?}, k = {k}");
        }
        let found = fit(&calibration, 2, 60);
        let of_sound = fit(&expected, 2, 60);
        assert_eq!((&found.x, found.report.n_failed), (&of_sound.x, 0), "{faults:?}");
        let quirks = calibration.fmu().quirks_seen();
        let named = quirks.iter().filter(|quirk| quirk.message.starts_with(function)).count();
        assert_eq!(named, 1, "{faults:?}: {quirks:?}");
    }
}

#[test]
fn simulation_fails_when_the_model_crashes_before_its_last_row() {
    let folder = faulty(&["AT_INITIALIZE=abort()", "AT_FREE=abort()"]);
    let calibration = decay(open(&folder), settings(Isolation::Process));
    let error = calibration.cost(&[1.0], &RunContext::new()).unwrap_err().to_string();
    assert!(error.contains("abort in fmi2ExitInitializationMode"), "{error}");
}

/// Returns the processes whose environment contains this temporary folder.
fn processes_of(folder: &Path) -> Vec<String> {
    let place = folder.to_str().unwrap();
    let has_place = |pid: &String| {
        let environment = std::fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
        String::from_utf8_lossy(&environment).contains(place)
    };
    let is_number = |name: &String| name.bytes().all(|byte| byte.is_ascii_digit());
    let entries = std::fs::read_dir("/proc").unwrap().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    names.filter(is_number).filter(has_place).collect()
}

/// Returns a command that runs one test of this test program with a separate temporary folder.
fn another_program(test: &str, temporary: &Path, work: &Path) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", test, "--ignored"]).env("TMPDIR", temporary).env("WORK", work);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command
}

/// Runs a fit of about 0.4 s with a checkpoint. Other tests run this function.
#[test]
#[ignore = "run by other tests"]
fn helper_runs_a_fit_with_a_checkpoint() {
    let Some(work) = std::env::var_os("WORK").map(PathBuf::from) else { return };
    let calibration = decay(Fmu::open(work.join("model")).unwrap(), settings(Isolation::Process));
    let run = RunOptions {
        method: DifferentialEvolution::default().into(),
        limits: Limits { max_evaluations: Some(150), ..Limits::default() },
        workers: Some(2),
        seed: Some(5),
        checkpoint: Some(Checkpoint::new(work.join("checkpoint")).interval(Duration::ZERO)),
        ..FitOptions::default_run()
    };
    let found = calibration.fit(run).unwrap();
    let bits: Vec<String> = costs(&found).iter().map(|cost| format!("{cost:?}")).collect();
    std::fs::write(work.join("result"), format!("{:?} {}", found.x, bits.join(" "))).unwrap();
}

fn is_gone_soon(folder: &Path) {
    let began = Instant::now();
    loop {
        let files = std::fs::read_dir(folder).unwrap().flatten();
        let files: Vec<_> =
            files.map(|file| (file.path(), std::fs::read_dir(file.path()).map(Iterator::count))).collect();
        let processes = processes_of(folder);
        if processes.is_empty() && files.is_empty() {
            return;
        }
        assert!(began.elapsed() < Duration::from_secs(1), "{processes:?}, {files:?}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Kills the program at `moments` different times. Afterwards no worker remains, and the resumed fit is
/// bit-for-bit identical.
fn killed_and_resumed(moments: u64) {
    let (model, temporary) = (faulty(&["SLOW=50"]), tempfile::tempdir().unwrap());
    let run = |work: &Path| {
        std::os::unix::fs::symlink(model.path(), work.join("model")).unwrap();
        another_program("helper_runs_a_fit_with_a_checkpoint", temporary.path(), work)
    };
    let whole = tempfile::tempdir().unwrap();
    let began = Instant::now();
    assert!(run(whole.path()).status().unwrap().success());
    let took = began.elapsed();
    is_gone_soon(temporary.path());
    let expected = std::fs::read_to_string(whole.path().join("result")).unwrap();
    for moment in 0..moments {
        let work = tempfile::tempdir().unwrap();
        let mut child = run(work.path()).spawn().unwrap();
        // Spread the times over the run, in an order independent of its phases.
        std::thread::sleep(took.mul_f64(((moment * 37) % moments) as f64 / moments as f64));
        child.kill().unwrap();
        child.wait().unwrap();
        is_gone_soon(temporary.path());
        assert!(
            another_program("helper_runs_a_fit_with_a_checkpoint", temporary.path(), work.path())
                .status()
                .unwrap()
                .success()
        );
        assert_eq!(std::fs::read_to_string(work.path().join("result")).unwrap(), expected, "{moment}");
        is_gone_soon(temporary.path());
    }
}

#[test]
fn killed_program_leaves_no_processes_and_resumes() {
    killed_and_resumed(3);
}

#[test]
#[ignore = "takes long"]
fn fifty_killed_programs_leave_no_processes_and_resume() {
    killed_and_resumed(50);
}

/// Faults of an FMU in its process, such as excessive memory or endless output, do not affect this process.
#[test]
fn worker_limits_are_enforced() {
    let folder = faulty(&["FAULT_ABOVE=2.2", "FAULT=fill_memory()"]);
    let limited = SimulationSettings { memory_limit: Some(1 << 30), ..settings(Isolation::Process) };
    let calibration = decay(open(&folder), limited);
    assert!(calibration.cost(&[1.0], &RunContext::new()).is_ok());
    let error = calibration.cost(&[3.0], &RunContext::new()).unwrap_err().to_string();
    let expected = "segmentation fault after an allocation beyond the memory limit of 1073741824 bytes in fmi2GetDerivatives";
    assert!(error.contains(expected), "{error}");

    let folder = faulty(&["FAULT_ABOVE=2.2", "FAULT=fill_shared_memory()"]);
    let limited = SimulationSettings { memory_limit: Some(300 << 20), ..settings(Isolation::Process) };
    let error = decay(open(&folder), limited).cost(&[3.0], &RunContext::new()).unwrap_err().to_string();
    assert!(error.contains("memory limit of 314572800 bytes exceeded in fmi2GetDerivatives"), "{error}");

    let folder = faulty(&["FAULT_ABOVE=2.2", "FAULT=print_for_ever()"]);
    let timeout = Some(Duration::from_millis(300));
    let calibration = decay(open(&folder), with_limit(timeout));
    let error = calibration.cost(&[3.0], &RunContext::new()).unwrap_err().to_string();
    assert!(error.contains("last output: ") && error.contains("what a model has to say"), "{error}");
}

#[test]
fn stale_outputs_are_bit_identical_in_all_isolation_modes() {
    let folder = faulty(&["STALE_OUTPUTS"]);
    let alone = decay(open(&folder), settings(Isolation::None));
    let apart = decay(open(&folder), settings(Isolation::Process));
    for k in [1.0, 2.0] {
        let context = RunContext::new();
        let residuals = |calibration: &Calibration| calibration.residuals(&[k], &context).unwrap();
        assert_eq!(residuals(&apart), residuals(&alone));
        let simulated = |calibration: &Calibration| calibration.simulate(&[k], None, &context).unwrap();
        assert_eq!(simulated(&apart), simulated(&alone));
    }
    let (found, expected) = (fit(&apart, 2, 60), fit(&alone, 1, 60));
    assert_eq!(costs(&found), costs(&expected));
}

/// A fit that ends next to crashes of the model, near its minimum, reports this and is not a success.
#[test]
fn fit_is_not_a_success_when_it_ends_next_to_crashes() {
    let folder = faulty(&["FAULT_ABOVE=1.5", "FAULT=abort()"]);
    let fit = decay(open(&folder), settings(Isolation::Process)).fit(FitOptions::default()).unwrap();
    assert!(fit.report.n_failed > 0 && fit.x[0] <= 1.5 && !fit.is_success(), "{fit}");
    let text = fit.to_string();
    assert!(text.contains("The fit ended before the minimum"), "{text}");
    assert!(text.contains("the cost decreases towards values that cannot be simulated"), "{text}");
}

/// A fault of an FMU in one evaluation does not affect the next evaluations.
#[test]
fn other_evaluations_are_unaffected_by_a_fault() {
    let sound = faulty(&[]);
    let sound = decay(open(&sound), settings(Isolation::Process));
    for fault in ["copy_itself()", "remove_folder()", "leave_orphan()"] {
        let folder = faulty(&["FAULT_ABOVE=2.2", &format!("FAULT={fault}")]);
        let calibration = decay(open(&folder), settings(Isolation::Process));
        let began = Instant::now();
        for k in [1.5, 2.25, 1.5, 2.5, 1.7] {
            let found = calibration.residuals(&[k], &RunContext::new());
            if k < 2.2 {
                assert_eq!(found.unwrap(), sound.residuals(&[k], &RunContext::new()).unwrap(), "{fault} {k}");
            } else if fault == "leave_orphan()" {
                let error = found.unwrap_err().to_string();
                assert!(error.contains("exit(3) in fmi2GetDerivatives"), "{error}");
            }
        }
        // The fit does not wait for processes that the FMU left running.
        assert!(
            fault != "leave_orphan()" || began.elapsed() < Duration::from_secs(4),
            "{:?}",
            began.elapsed()
        );
    }
}

/// Processes started by the FMU end with the worker, even if they left its session or the program is killed.
#[test]
fn daemons_end_with_their_worker() {
    let (model, temporary) =
        (faulty(&["FAULT_ABOVE=0", "FAULT=leave_daemon()"]), tempfile::tempdir().unwrap());
    let run = |work: &Path| {
        std::os::unix::fs::symlink(model.path(), work.join("model")).unwrap();
        another_program("helper_runs_a_fit_with_a_checkpoint", temporary.path(), work)
    };
    for is_killed in [false, true] {
        let work = tempfile::tempdir().unwrap();
        let mut child = run(work.path()).spawn().unwrap();
        let began = Instant::now();
        // Program, worker and at least one daemon.
        while processes_of(temporary.path()).len() < 3 {
            assert!(began.elapsed() < Duration::from_secs(20));
            std::thread::sleep(Duration::from_millis(2));
        }
        if is_killed {
            child.kill().unwrap();
        }
        child.wait().unwrap();
        is_gone_soon(temporary.path());
    }
}

/// The exported copy of a model is simulated in the same kind of process as the model.
#[test]
fn exported_copy_runs_in_a_separate_process() {
    let work = tempfile::tempdir().unwrap();
    let here = format!("FAULT=if (getpid() == {}) exit(3)", std::process::id());
    let folder = faulty(&["FAULT_ABOVE=0", &here]);
    let calibration = decay(open(&folder), settings(Isolation::Process));
    let found = fit(&calibration, 1, 20);
    let copy = work.path().join("copy.fmu");
    let written = found.export_fmu(&calibration, &copy, None, false, &RunContext::new()).unwrap();
    // The start values of this model are compiled into its library.
    assert!(written.warning.is_some_and(|warning| warning.contains("'y' by ")) && written.ssv.is_some());
}

#[test]
fn leaking_model_has_bounded_memory() {
    let folder = faulty(&["LEAKS=(64 << 20)"]);
    let calibration = decay(open(&folder), settings(Isolation::Process));
    let found = fit(&calibration, 1, 60);
    assert!((found.x[0] - 1.7).abs() < 0.1, "{:?}", found.x);
}

/// Returns the resident memory of this process in bytes.
fn memory_of_this_process() -> u64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap();
    text.split(' ').nth(1).unwrap().parse::<u64>().unwrap() * 4096
}

/// Lock for tests that check the size of this process or all of its workers.
static ALONE: Mutex<()> = Mutex::new(());

#[test]
#[ignore = "takes long"]
fn leaking_model_has_bounded_memory_in_twenty_thousand_runs() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = faulty(&["LEAKS=(1 << 20)"]);
    let limited = SimulationSettings { memory_limit: Some(1 << 30), ..settings(Isolation::Process) };
    let calibration = decay(open(&folder), limited);
    assert!((fit(&calibration, 2, 500).x[0] - 1.7).abs() < 0.1);
    let before = memory_of_this_process();
    for run in 0..20_000 {
        let cost = calibration.cost(&[1.7 + 1e-6 * f64::from(run)], &RunContext::new()).unwrap();
        assert!(cost < 0.01, "{run}: {cost}");
    }
    let grown = memory_of_this_process().saturating_sub(before);
    assert!(grown < 8 << 20, "{grown} bytes");
    let found = fit(&calibration, 2, 500);
    assert!((found.x[0] - 1.7).abs() < 0.1, "{:?}", found.x);
}

/// Faults in C for points above a bound.
const ZOO: [(&str, &str); 25] = [
    ("handles SIGINT", "signal(SIGINT, SIG_IGN)"),
    ("handles SIGSEGV and hangs", "(signal(SIGSEGV, (void (*)(int))hang), raise(SIGSEGV))"),
    ("ignores SIGABRT and aborts", "(signal(SIGABRT, SIG_IGN), abort())"),
    ("closes descriptors", "close_all()"),
    ("lowers limits", "syscall(302, 0, 7, (unsigned long[2]){0, 0}, 0)"),
    ("leaves a thread", "{ int pthread_create(); pthread_create(&(long){0}, 0, pause, 0); }"),
    ("overflows its stack", "overflow(m->time)"),
    ("takes all memory", "fill_memory()"),
    ("takes shared memory", "fill_shared_memory()"),
    ("writes everywhere", "for (int i = 0; i < 20; i++) (void)!write(i, all_faults, 80)"),
    ("prints for ever", "print_for_ever()"),
    ("prints much", "for (int i = 0; i < 100000; i++) puts(\"much\")"),
    ("copies itself", "copy_itself()"),
    ("leaves a daemon", "leave_daemon()"),
    (
        "leaves a daemon without environment",
        "if (fork() == 0) { setsid(); if (fork() == 0) execle(\"/bin/sleep\", \"sleep\", \"600\", (char *)0, (char *[]){0}); _exit(0); }",
    ),
    ("changes the locale", "setlocale(LC_ALL, \"de_DE.UTF-8\")"),
    ("traps exceptions", "{ unsigned c = 0; __asm__ volatile(\"ldmxcsr %0\" : : \"m\"(c)); }"),
    ("jumps away", "__builtin_longjmp((void **)calloc(64, 1), 1)"),
    ("leaves with 0", "_exit(0)"),
    ("ends its thread", "{ void pthread_exit(void *); pthread_exit(0); }"),
    ("ends its group", "kill(0, SIGKILL)"),
    ("stops itself", "raise(SIGSTOP)"),
    ("sets an alarm", "alarm(1)"),
    ("removes its folder", "remove_folder()"),
    ("goes elsewhere", "(void)!chdir(\"/\")"),
];

/// Returns remaining processes and folders of the workers of this process.
fn left_behind() -> Vec<String> {
    let process_id = std::process::id();
    let prefix = format!("fmufit-worker-{process_id}-");
    let names = std::fs::read_dir(std::env::temp_dir()).unwrap().flatten();
    let mut left: Vec<_> = names.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    left.retain(|name| name.starts_with(&prefix));
    left.extend(processes_of(&std::env::temp_dir().join(prefix)));
    left
}

/// Fit, profile, validation and report end with the optimum or an error with a reason. No process remains.
#[test]
#[ignore = "takes long"]
fn fits_end_cleanly_for_many_kinds_of_faults() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    for (name, fault) in ZOO {
        for bound in [4.755, 2.55] {
            let began = Instant::now();
            let folder = faulty(&[&format!("FAULT_ABOVE={bound}"), &format!("FAULT={fault}")]);
            let settings = with_limit(Some(Duration::from_millis(300)));
            let settings = SimulationSettings { memory_limit: Some(500 << 20), ..settings };
            let calibration = decay(open(&folder), settings);
            let found = fit(&calibration, 2, 60);
            assert!((found.x[0] - 1.7).abs() < 0.1, "{name}: {found}");
            let context = RunContext::new();
            let profile = calibration.profile(&found, &ProfileOptions::default(), &context);
            let windows = ValidationSet::Windows(vec![(0.2, 0.8)]);
            let validation = calibration.validate(&found, &windows, &context);
            let far = calibration.cost(&[4.9], &context).map_err(|error| error.to_string());
            println!(
                "{name}, {bound}: {} of {} failed; profile {:?}, validation {:?}, far {far:?}; {:.1} s",
                found.report.n_failed,
                found.report.n_evaluations,
                profile.map(drop).map_err(|error| error.to_string()),
                validation.map(drop).map_err(|error| error.to_string()),
                began.elapsed().as_secs_f64()
            );
            // The fit has evaluated its points, so the report must succeed.
            calibration.report(&found, folder.path().join("report.html"), &context).unwrap();
            drop(calibration);
            assert_eq!(left_behind(), [""; 0], "{name}");
        }
    }
}

/// Lines logged by the libraries.
static LOGGED: Mutex<Vec<String>> = Mutex::new(Vec::new());

struct Listener;

impl log::Log for Listener {
    fn enabled(&self, _: &log::Metadata<'_>) -> bool {
        true
    }

    fn log(&self, record: &log::Record<'_>) {
        LOGGED.lock().unwrap().push(record.args().to_string());
    }

    fn flush(&self) {}
}

/// Kills the process from which workers are copied. The end of a worker is then still reported, and a fit
/// continues. Other tests run this function.
#[test]
#[ignore = "run by other tests"]
fn helper_kills_its_template() {
    let Some(work) = std::env::var_os("WORK").map(PathBuf::from) else { return };
    log::set_logger(&Listener).unwrap();
    log::set_max_level(log::LevelFilter::Info);
    let calibration = decay(Fmu::open(work.join("model")).unwrap(), settings(Isolation::Process));
    calibration.cost(&[1.0], &RunContext::new()).unwrap();
    let threads = std::fs::read_dir("/proc/self/task").unwrap().flatten();
    let children = threads.map(|thread| std::fs::read_to_string(thread.path().join("children")).unwrap());
    let template = children.collect::<String>();
    assert!(Command::new("kill").args(["-9", template.trim()]).status().unwrap().success(), "{template}");
    let error = calibration.cost(&[3.0], &RunContext::new()).unwrap_err().to_string();
    assert!(error.contains("segmentation fault in fmi2GetDerivatives"), "{error}");
    let reported = LOGGED.lock().unwrap().join("\n");
    let expected =
        "the process ended with an unknown status, because its parent process had ended before: killed";
    assert!(reported.contains(expected) && reported.contains("in fmi2GetDerivatives at t = "), "{reported}");
    assert!((fit(&calibration, 2, 60).x[0] - 1.7).abs() < 0.1);
    std::fs::write(work.join("result"), "done").unwrap();
}

#[test]
fn worker_end_is_explained_when_its_template_was_killed() {
    let (model, temporary) =
        (faulty(&["FAULT_ABOVE=2.2", "FAULT=raise(SIGSEGV)"]), tempfile::tempdir().unwrap());
    let work = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(model.path(), work.path().join("model")).unwrap();
    let done = another_program("helper_kills_its_template", temporary.path(), work.path());
    let output = { done }.stdout(Stdio::piped()).output().unwrap();
    assert!(work.path().join("result").exists(), "{}", String::from_utf8_lossy(&output.stdout));
    is_gone_soon(temporary.path());
}

#[test]
fn fit_ends_at_the_given_share_of_failures() {
    let folder = faulty(&["FAULT_ABOVE=2.2", "FAULT=raise(SIGSEGV)"]);
    let run = RunOptions {
        method: DifferentialEvolution::default().into(),
        limits: Limits { max_failed: Some(0.3), ..Limits::default() },
        seed: Some(5),
        ..FitOptions::default_run()
    };
    let found = decay(open(&folder), settings(Isolation::Process)).fit(run).unwrap();
    assert_eq!(found.report.termination, Termination::TooManyFailed);
    assert!(found.cost.is_finite() && found.report.n_evaluations < 100, "{found}");
    assert!(found.report.message.contains("more than the allowed share of 0.3"), "{}", found.report.message);
}
