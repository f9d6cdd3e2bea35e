//! Files and streams that a command reads and writes are not lost or confused with each other.

use crate::fit::PROBLEM;
use crate::support::{Folder, Ran, json};
use std::io::Write;
use std::process::Stdio;

#[test]
fn commands_do_not_overwrite_their_input() {
    let folder = Folder::with_model("dahlquist");
    folder.record_decay();
    folder.write("problem.toml", PROBLEM);
    let recording = folder.read("run.csv");
    for (arguments, expected) in [
        ("simulate model.fmu --output model.fmu", "model.fmu is an input of this command"),
        ("simulate model.fmu --plot ./model.fmu", "model.fmu is an input of this command"),
        ("fit problem.toml --save run.csv", "run.csv is an input of this command"),
        ("fit problem.toml --report problem.toml", "problem.toml is an input of this command"),
        ("fit problem.toml --save model.fmu", "model.fmu is an input of this command"),
        ("fit problem.toml --save a.fit --checkpoint a.fit", "a.fit would be written twice"),
        ("fit problem.toml --save -", "'-' is not a file"),
        (
            "fit problem.toml --report fit.pdf",
            "fit.pdf: unknown report format; expected a name that ends in .html",
        ),
        ("init model.fmu run.csv run.csv --force", "run.csv is an input of this command"),
    ] {
        if expected.starts_with("a.fit") {
            folder.write("a.fit", "");
        }
        let message = folder.run(arguments).wrong_input();
        assert!(message.contains(expected), "{arguments}: {message}");
    }
    assert_eq!(folder.read("run.csv"), recording);
    assert_eq!(folder.read("problem.toml"), PROBLEM);
    folder.run("info model.fmu").good();
}

#[test]
fn dash_means_a_standard_stream() {
    let folder = Folder::with_model("dahlquist");
    folder.record_decay();
    let table = folder.run("simulate model.fmu --final-time 1 --interval 1 --output -").good();
    assert!(table.starts_with("time,x\n0,1\n") && !folder.path("-").exists(), "{table}");
    let mut child = folder.command("fit - --json --quiet").stdin(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(PROBLEM.as_bytes()).unwrap();
    let fit = json(&Ran::of(child.wait_with_output().unwrap()).good());
    assert!((fit["parameters"][0]["value"].as_f64().unwrap() - 2.0).abs() < 1e-4, "{fit}");
}

#[test]
fn errors_name_options_given_twice() {
    let folder = Folder::with_model("dahlquist");
    folder.record_decay();
    for (arguments, expected) in [
        ("simulate model.fmu --set k=1 --set k=2", "'k' is specified twice: 1 and 2"),
        (
            "fit model.fmu run.csv --output x --parameter k=1 -O max_time=1 -O max_time=2",
            "'max_time' is specified twice",
        ),
        (
            "fit model.fmu run.csv --output x --parameter k=1 -S solver=rk4 -S solver=bdf",
            "'solver' is specified twice",
        ),
        (
            "fit model.fmu run.csv --output x --parameter k=1 -O rng=1 -O seed=2",
            "rng and seed are the same option; specify only one of them",
        ),
        ("fit model.fmu run.csv --output x --output x --parameter k=1", "twice"),
        ("fit model.fmu run.csv --output x --parameter k=1 --parameter k=2", "twice"),
    ] {
        let message = folder.run(arguments).wrong_input();
        assert!(message.contains(expected), "{arguments}: {message}");
    }
}

#[test]
fn short_form_supports_time_column_and_inputs() {
    let folder = Folder::with_model("dahlquist");
    folder.record_decay();
    folder.write("t.csv", &folder.read("run.csv").replace("time", "t"));
    for command in [
        "fit model.fmu t.csv --output x --parameter k=1",
        "init model.fmu t.csv",
        "simulate model.fmu --input t.csv",
    ] {
        let message = folder.run(command).wrong_input();
        assert!(
            message.contains("--time COLUMN") && message.contains("column 'time' not found"),
            "{command}: {message}"
        );
    }
    folder.run("fit model.fmu t.csv --output x --parameter k=1:0.1:10 --time t").good();

    let folder = Folder::with_model("quad_tank");
    let rows: String = (0..6).map(|k| format!("{},5.5,5.5\n", 10 * k)).collect();
    folder.write("in.csv", &format!("time,u1,u2\n{rows}"));
    let simulate = "simulate model.fmu --input in.csv --final-time 50 --interval 10 --outputs u1 --outputs u2 --outputs qt.x1 --output run.csv";
    folder.run(simulate).good();
    let fit = "check model.fmu run.csv --output qt.x1=qt.x1 --parameter qt.a1=3e-6:2e-6:4e-6 --no-run";
    let ran = folder.run(fit);
    assert!(ran.err.contains("driven by the columns of the same names: u1, u2"), "{ran:?}");
    ran.good();
    // Absolute clock times.
    let later: String = (0..6).map(|k| format!("{},5.5,5.5,{k}\n", 1_700_000_000 + 10 * k)).collect();
    folder.write("run.csv", &format!("time,u1,u2,qt.x1\n{later}"));
    let message = folder.run(&format!("{fit} --quiet")).wrong_input();
    assert!(message.contains("Set --start-time 1.7e9 to start with the recording"), "{message}");
    folder.run(&format!("{fit} --start-time 1.7e9")).good();
}

#[test]
fn errors_are_json_when_results_are() {
    let folder = Folder::new();
    let ran = folder.run("info none.fmu --json");
    let error = &json(&ran.out)["error"];
    assert_eq!((ran.code, &error["exit_code"]), (2, &2.into()), "{ran:?}");
    assert_eq!(ran.err, format!("error: {}\n", error["message"].as_str().unwrap()));
}

#[test]
#[cfg(target_os = "linux")]
fn unwritable_result_is_an_error() {
    let folder = Folder::with_model("dahlquist");
    for arguments in ["simulate model.fmu", "info model.fmu", "info model.fmu --json", "schema"] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let ran = Ran::of(folder.command(arguments).stdout(full).output().unwrap());
        assert!(
            ran.code == 2 && ran.err.contains("cannot write to the standard output"),
            "{arguments}: {ran:?}"
        );
    }
}

#[test]
#[cfg(target_os = "linux")]
fn file_names_outside_utf8_are_used_or_rejected() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let folder = Folder::with_model("dahlquist");
    folder.record_decay();
    let (model, data) = (OsStr::from_bytes(b"m\xff.fmu"), OsStr::from_bytes(b"r\xff.csv"));
    let root = folder.path("");
    std::fs::rename(root.join("model.fmu"), root.join(model)).unwrap();
    std::fs::rename(root.join("run.csv"), root.join(data)).unwrap();
    let run = |command: &str, names: &[&OsStr], rest: &str| {
        let mut command = folder.command(command);
        command.args(names).args(rest.split_whitespace());
        Ran::of(command.output().unwrap())
    };
    run("info", &[model], "").good();
    for (command, rest) in [("fit", "--output x --parameter k=1"), ("init", "problem.toml")] {
        let message = run(command, &[model, data], rest).wrong_input();
        assert!(message.contains("is not valid UTF-8"), "{command}: {message}");
    }
    assert!(!folder.path("problem.toml").exists());
}

#[test]
fn unwritable_output_is_reported_before_the_work() {
    let folder = Folder::with_model("dahlquist");
    std::fs::write(folder.path("data.csv"), "time,x\n0,1\n0.5,0.6\n1,0.37\n").unwrap();
    let fit = "fit model.fmu data.csv --output x --parameter k=0.5:0.1:3";
    for (result, place) in
        [("--save", "none/a.fit"), ("--report", "none/a.html"), ("--save", "."), ("--checkpoint", "none/a")]
    {
        let ran = folder.run(&format!("{fit} {result} {place}"));
        assert!(ran.code == 2 && ran.out.is_empty(), "{result}: {ran:?}");
        assert!(ran.err.starts_with(&format!("error: cannot write {place}: ")), "{ran:?}");
    }
    // Option values that are never valid.
    for option in ["workers=0", "max_failed=2"] {
        let ran = folder.run(&format!("{fit} -O {option}"));
        assert_eq!(ran.code, 2, "{ran:?}");
    }
}

#[test]
fn errors_about_workbooks_state_how_to_convert_them() {
    let folder = Folder::with_model("dahlquist");
    folder.write(
        "problem.toml",
        &PROBLEM.replace("data = \"run.csv\"", "data = \"runs.xlsx\"\nsheet = \"Tuesday\""),
    );
    let message = folder.run("check problem.toml").wrong_input();
    assert!(
        message.contains(
            "sheet = 'Tuesday': only Python reads workbooks; the data of a problem file are CSV files"
        ) && message.contains(
            "pandas.read_excel(\"runs.xlsx\", sheet_name=\"Tuesday\").to_csv(\"run.csv\", index=False)"
        ),
        "{message}"
    );
    // A workbook is a zip archive, as a model is.
    std::fs::copy(folder.path("model.fmu"), folder.path("runs.xlsx")).unwrap();
    folder.write("problem.toml", &PROBLEM.replace("run.csv", "runs.xlsx"));
    let message = folder.run("fit problem.toml").wrong_input();
    assert!(
        message.contains("not a CSV file. Save the sheet of a workbook as a CSV file, or convert it"),
        "{message}"
    );
}
