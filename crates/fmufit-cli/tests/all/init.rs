//! `init`: matching, and the steps from a model and a recording to a report.

use crate::support::{Folder, json};

#[test]
fn init_leads_to_correct_fit_and_report() {
    let folder = Folder::with_model("dahlquist");
    folder.record_decay();
    let out = folder.run("init model.fmu run.csv problem.toml").good();
    assert!(out.contains("wrote problem.toml: 1 output, 0 inputs, 1 parameter"), "{out}");
    let ran = folder.run("check problem.toml --preflight");
    assert!(ran.code == 0 && ran.out.contains("sensitivity"), "{ran:?}");
    let ran = folder.run("fit problem.toml --save decay.fit --report decay.html --json");
    assert_eq!(ran.code, 0, "{ran:?}");
    let result = json(&ran.out);
    let k = &result["parameters"][0];
    assert!(k["name"] == "k" && (k["value"].as_f64().unwrap() - 2.0).abs() < 1e-4, "{result}");
    assert_eq!(result["success"], true);
    assert!(folder.read("decay.html").contains("<svg"));
    // The saved fit contains the same numbers.
    for (file, expected) in [
        ("a.html", "<!DOCTYPE html>"),
        ("a.csv", "name,value"),
        ("a.ssv", "ParameterSet"),
        ("a.json", "\"success\""),
    ] {
        folder.run(&format!("report decay.fit {file}")).good();
        assert!(folder.read(file).contains(expected), "{file}");
    }
    assert_eq!(json(&folder.read("a.json"))["parameters"], result["parameters"]);
}

#[test]
fn init_reports_unmatched_columns_and_variables() {
    let folder = Folder::with_model("furuta");
    folder.write("run.csv", "time,PHI,x\n0,0,1\n1,0.1,2\n2,0.2,1\n");
    let ran = folder.run("init model.fmu run.csv");
    assert!(ran.code == 0 && ran.err.contains("no column matches an output"), "{ran:?}");
    let text = folder.read("problem.toml");
    assert!(text.contains("# Column 'PHI' may match armJoint.phi, pendulumJoint.phi."), "{text}");
    assert!(text.contains("# Column 'x' does not match any output or input."), "{text}");
    assert!(folder.run("init model.fmu run.csv").wrong_input().contains("problem.toml already exists"));
    folder.run("init model.fmu run.csv --force --output armJoint.phi=PHI --parameter armFriction").good();
    let text = folder.read("problem.toml");
    assert!(
        text.contains("outputs = { \"armJoint.phi\" = \"PHI\" }")
            && text.matches("\n[[parameters]]").count() == 1,
        "{text}"
    );
    // Spaces and punctuation are ignored, and a unit is not part of the name.
    folder.write("blank.csv", "time,armJoint phi [deg]\n0,0\n1,0.1\n2,0.2\n");
    folder.run("init model.fmu blank.csv blank.toml --parameter armFriction").good();
    let text = folder.read("blank.toml");
    assert!(text.contains("outputs = { \"armJoint.phi\" = \"armJoint phi\" }"), "{text}");
    for (arguments, expected) in [
        ("--output armJoint.fi=PHI", "did you mean"),
        ("--output armJoint.phi=none", "column 'none' not found"),
        ("--parameter none", "no variable \"none\""),
        ("--parameter time", "--parameter time: expected a scalar real variable"),
        ("--time t", "column 't' not found"),
    ] {
        let message = folder.run(&format!("init model.fmu run.csv other.toml {arguments}")).wrong_input();
        assert!(message.contains(expected) && !folder.path("other.toml").exists(), "{message}");
    }
}

#[test]
fn named_variable_is_matched_only_once() {
    let folder = Folder::with_model("furuta");
    folder.write("run.csv", "time,PHI,armJoint.phi\n0,0,1\n1,0.1,2\n2,0.2,1\n");
    folder.run("init model.fmu run.csv --output armJoint.phi=PHI --parameter armFriction").good();
    let text = folder.read("problem.toml");
    assert!(text.contains("outputs = { \"armJoint.phi\" = \"PHI\" }"), "{text}");
    assert!(text.contains("# Column 'armJoint.phi'"), "{text}");
}

#[test]
fn parameters_without_effect_are_listed_in_one_comment() {
    let folder = Folder::with_model("bouncing_ball");
    // Before the first bounce at 0.45 s, only gravity affects the ball.
    folder.run("simulate model.fmu --final-time 0.3 --interval 0.02 --output run.csv").good();
    folder.run("init model.fmu run.csv").good();
    let text = folder.read("problem.toml");
    assert!(
        text.contains("\nname = \"g\"")
            && text.contains("\n# Left out (no effect on any output at the start values): "),
        "{text}"
    );
    assert!(!text.contains("name = \"e\"") && text.contains("start values): e, v_min\n"), "{text}");
}

#[test]
fn paths_are_relative_to_the_problem_file() {
    let folder = Folder::with_model("dahlquist");
    folder.record_decay();
    std::fs::create_dir(folder.path("below")).unwrap();
    folder.run("init model.fmu run.csv below/problem.toml").good();
    folder.run("check below/problem.toml").good();
    folder.run("init model.fmu run.csv problem.toml").good();
    let text = folder.read("problem.toml");
    assert!(text.contains("model = \"model.fmu\"") && text.contains("data = \"run.csv\""), "{text}");
    let elsewhere = Folder::new();
    elsewhere.run(&format!("check {}", folder.path("problem.toml").display())).good();
}
