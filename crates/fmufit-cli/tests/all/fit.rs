//! `fit`, `check` and `resume`: the problem file, the short form, mistakes in them, and outcomes.

use crate::support::{Folder, json};

/// Folder with a decay and its problem file, to which lines are added.
fn decay(more: &str) -> Folder {
    let folder = Folder::with_model("dahlquist");
    folder.record_decay();
    folder.write("problem.toml", &(PROBLEM.to_owned() + more));
    folder
}

pub(crate) const PROBLEM: &str = r#"model = "model.fmu"

[[experiments]]
data = "run.csv"
outputs = { x = "x" }

[[parameters]]
name = "k"
start = 1.0
lower = 0.1
upper = 10
"#;

fn fitted(out: &str) -> f64 {
    json(out)["parameters"][0]["value"].as_f64().unwrap()
}

#[test]
fn short_form_and_file_give_the_same_fit() {
    let folder = decay("");
    let from_file = folder.run("fit problem.toml --json --quiet");
    assert_eq!(from_file.err, "");
    let from_file = json(&from_file.good());
    let short = json(&folder.run("fit model.fmu run.csv --output x=x --parameter k=1:0.1:10 --json").good());
    assert!((short["parameters"][0]["value"].as_f64().unwrap() - 2.0).abs() < 1e-4, "{short}");
    for field in ["parameters", "cost", "n_evaluations", "message"] {
        assert_eq!(short[field], from_file[field], "{field}");
    }
    // A single name is also the name of the column, and bounds are optional.
    let open = folder.run("fit model.fmu run.csv --output x --parameter k=1 --json").good();
    assert!((fitted(&open) - 2.0).abs() < 1e-4, "{open}");
}

/// A lag T x' = K u - x from 0.5, whose input is held between the rows.
#[test]
fn short_form_holds_inputs_and_sets_initial_states() {
    let folder = Folder::with_model("switched_input");
    let (gain, constant, mut x) = (2.0, 3.0, 0.5);
    let mut rows = "time,u,y\n".to_owned();
    for row in 0..=24 {
        let u = f64::from((row / 4 + 1) % 2);
        rows += &format!("{row},{u},{x}\n");
        x = gain * u + (x - gain * u) * (-1.0_f64 / constant).exp();
    }
    folder.write("run.csv", &rows);
    let fit = |more: &str| {
        folder.run(&format!(
            "fit model.fmu run.csv --output y --parameter K=1:0.1:10 --parameter T=1:0.1:10 --json --quiet {more}"
        ))
    };
    for state in ["x=1:0:2", "x=0.5", "x=measured:y"] {
        let found = json(&fit(&format!("--hold u --initial-state {state}")).good());
        for (k, expected) in [gain, constant].into_iter().enumerate() {
            let value = found["parameters"][k]["value"].as_f64().unwrap();
            assert!((value - expected).abs() < 1e-3, "{state}: {value} for {expected}");
        }
    }
    for (arguments, expected) in [
        ("--hold enabled", "--hold enabled: no column drives this input"),
        ("--initial-state x=a:0:1", "start 'a' is not a number"),
        ("--initial-state x=first", "initial_states: 'x' = 'first' must be"),
        ("--initial-state x", "expected name=number"),
        ("--initial-state x=1 --initial-state x=2", "'x' is specified twice"),
    ] {
        let refused = fit(arguments);
        assert!(refused.code == 2 && refused.err.contains(expected), "{refused:?}");
    }
}

#[test]
fn fit_prints_summary_and_progress() {
    let folder = decay("");
    let ran = folder.run("fit problem.toml");
    assert!(
        ran.err.contains("searching") && !ran.err.contains('\u{1b}') && !ran.err.contains('\r'),
        "{ran:?}"
    );
    let out = ran.good();
    assert!(out.starts_with("Fit of Dahlquist\nThe fit converged"), "{out}");
}

#[test]
fn command_line_options_take_precedence() {
    let folder = decay(
        "[settings]\nsolver = \"rk4\"\nstep_size = 0.01\n[fit]\nmethod = \"nelder-mead\"\nmax_evaluations = 3\n",
    );
    let ran = folder.run("fit problem.toml --json");
    let result = json(&ran.out);
    assert_eq!(
        (ran.code, &result["method"], &result["solver"]),
        (1, &"nelder-mead".into(), &"rk4".into()),
        "{result}"
    );
    assert_eq!((&result["n_evaluations"], &result["success"]), (&3.into(), &false.into()), "{result}");
    let result = json(&folder.run("fit problem.toml --json -O max_evaluations=none -O method=pattern-search -S solver=tsit5 -S step_size=none").good());
    assert_eq!(
        (&result["method"], &result["solver"]),
        (&"pattern-search".into(), &"tsit5".into()),
        "{result}"
    );
}

/// Records the decay in a different unit: 300 K more.
fn in_another_unit(folder: &Folder) {
    let rows: Vec<String> = folder.read("run.csv").lines().skip(1).map(str::to_owned).collect();
    let shifted = rows.iter().map(|row| {
        let (time, x) = row.split_once(',').unwrap();
        format!("{time},{}\n", 300.0 + x.parse::<f64>().unwrap())
    });
    folder.write("run.csv", &format!("time,x\n{}", shifted.collect::<String>()));
}

#[test]
fn fit_worse_than_a_constant_exits_with_3_and_reports_the_reason() {
    let folder = decay("");
    in_another_unit(&folder);
    let ran = folder.run("fit problem.toml --json --quiet");
    let result = json(&ran.out);
    assert_eq!(
        (ran.code, &result["success"], &result["usable"]),
        (3, &true.into(), &false.into()),
        "{ran:?}"
    );
    let findings = result["findings"].as_array().unwrap();
    let place = |text: &str| {
        findings
            .iter()
            .position(|f| f["sentence"].as_str().unwrap().contains(text))
            .unwrap_or_else(|| panic!("{result}"))
    };
    // Causes first: the unit, then the parameter, then the residuals.
    let [unit, bound, worse] =
        ["probably in another unit", "bound", "the fit is worse than a constant"].map(place);
    assert!(unit < bound && bound < worse && findings[worse]["severity"] == "error", "{result}");
    assert_eq!(
        [unit, bound, worse].map(|k| findings[k]["origin"].as_str().unwrap()),
        ["problem", "search", "residuals"]
    );
    let lines: Vec<&str> = ran.err.lines().collect();
    assert!(
        lines[0]
            .starts_with("error: the result should not be used: output 'x' (column 'x'): the fit is worse"),
        "{ran:?}"
    );
    assert!(
        lines.len() == 2
            && lines[1].starts_with("probable cause: ")
            && lines[1].contains("probably in another unit"),
        "{ran:?}"
    );
    let shown = folder.run("fit problem.toml").out;
    assert!(shown.contains("The fit converged, but its result should not be used: RMS"), "{shown}");
    // A fit ended early is never a success. The result of a good fit is usable.
    assert_eq!(folder.run("fit problem.toml -O method=nelder-mead -O max_evaluations=2 --json").code, 1);
    let good = decay("");
    assert_eq!(json(&good.run("fit problem.toml --json").good())["usable"], true);
}

#[test]
fn problem_reads_start_values_from_exported_fit() {
    let folder = decay("");
    folder.run("fit problem.toml --save decay.fit --report decay.ssv --quiet").good();
    // The file contains k, which is ignored because k is fitted.
    let with_set = PROBLEM.replace("data = ", "start_values = \"decay.ssv\"\ndata = ");
    folder.write("again.toml", &with_set);
    let again = json(&folder.run("fit again.toml --json").good());
    assert_eq!(again["parameters"], json(&folder.run("fit problem.toml --json").good())["parameters"]);
    // If x(0) is fitted, k from the file is the parameter of the model: 2.
    let of_start = with_set.replace("name = \"k\"", "name = \"x\"");
    folder.write("start.toml", &of_start);
    let start = fitted(&folder.run("fit start.toml --json").good());
    assert!((start - 1.0).abs() < 1e-4, "{start}");
    folder.write("none.toml", &with_set.replace("decay.ssv", "none.ssv"));
    assert!(folder.run("fit none.toml").wrong_input().contains("none.ssv"));
    // A file that is read is not overwritten.
    assert!(folder.run("fit again.toml --report decay.ssv").wrong_input().contains("decay.ssv"));
}

#[test]
fn ssv_report_contains_the_values_of_one_experiment() {
    let folder =
        decay("local = true\n[[experiments]]\nname = \"second\"\ndata = \"run.csv\"\noutputs = [\"x\"]\n");
    folder.run("fit problem.toml --save local.fit --quiet").good();
    let refused = folder.run("report local.fit all.ssv");
    assert!(refused.err.contains("Specify one of 'run1', 'second'"), "{refused:?}");
    folder.run("report local.fit second.ssv --experiment second").good();
    assert!(folder.read("second.ssv").contains("name=\"k\""));
    assert!(folder.run("report local.fit a.ssv --experiment third").err.contains("third"));
    let page = folder.run("report local.fit a.html --experiment second").wrong_input();
    assert!(page.contains("--experiment: only .ssv"), "{page}");
}

#[test]
fn units_missing_in_the_model_can_be_given() {
    let folder = decay("");
    let milli: String = (folder.read("run.csv").lines().skip(1))
        .map(|row| row.split_once(',').unwrap())
        .map(|(time, x)| format!("{time},{}\n", 1e3 * x.parse::<f64>().unwrap()))
        .collect();
    folder.write("run.csv", &format!("time,x [mm]\n{milli}"));
    let ran = folder.run("check problem.toml");
    assert!(ran.err.contains("State the unit of 'x' with the setting units"), "{ran:?}");
    let by_argument = json(&folder.run("fit problem.toml --unit x=m --json").good());
    assert!((by_argument["parameters"][0]["value"].as_f64().unwrap() - 2.0).abs() < 1e-4, "{by_argument}");
    assert_eq!(by_argument["outputs"][0]["unit"], "m");
    folder.write("problem.toml", &(PROBLEM.to_owned() + "[settings]\nunits = { x = \"m\" }\n"));
    let by_file = json(&folder.run("fit problem.toml --json").good());
    assert_eq!(by_file["parameters"], by_argument["parameters"]);
    // Units from the file and from the command line apply together.
    let both = json(&folder.run("fit problem.toml --unit k=1/s --json").good());
    assert_eq!(both["parameters"], by_argument["parameters"]);
    for (unit, expected) in
        [("x=K", "'x'"), ("x=mx", "mx"), ("z=m", "no variable \"z\""), ("x", "expected VARIABLE=UNIT")]
    {
        let message = folder.run(&format!("fit problem.toml --unit {unit}")).wrong_input();
        assert!(message.contains(expected), "{unit}: {message}");
    }
    // `init` proposes the unit.
    folder.run("init model.fmu run.csv other.toml").good();
    assert!(
        folder.read("other.toml").contains("# units = { \"x\" = \"mm\" }"),
        "{}",
        folder.read("other.toml")
    );
}

/// Names from Python and other tools have the same meaning in files and on the command line.
#[test]
fn option_names_match_python() {
    let folder = decay("[settings]\nsolver = \"CVode\"\n[fit]\nrng = 1\nworkers = -1\nbatch = \"serial\"\n");
    let result = json(&folder.run("fit problem.toml --json").good());
    assert_eq!(
        (&result["method"], &result["fit_options"]["seed"]),
        (&"least-squares".into(), &1.into()),
        "{result}"
    );
    folder.run("fit problem.toml -O batch=workers -S isolation=none").good();
    let result = json(&folder.run("fit problem.toml --json -S isolation=none").good());
    assert_eq!(result["problem"]["settings"]["isolation"], "none", "{result}");
}

/// Programs that request JSON also receive argument errors as JSON.
#[test]
fn wrong_arguments_are_reported_as_json() {
    let folder = decay("");
    for (arguments, expected) in [
        ("fit problem.toml --json --no-such-option", "unexpected argument '--no-such-option' found"),
        ("fit --json", "the following required arguments were not provided: <PROBLEM.toml | MODEL.fmu>"),
        ("fit problem.toml --json --parameter k=1", "--parameter cannot be used with a problem file"),
    ] {
        let ran = folder.run(arguments);
        let document = json(&ran.out);
        assert!(ran.code == 2 && document["error"]["exit_code"] == 2, "{ran:?}");
        assert!(document["error"]["message"].as_str().unwrap().starts_with(expected), "{document}");
    }
    assert_eq!(folder.run("fit problem.toml --no-such-option").out, "");
}

#[test]
fn file_supports_stages_and_several_recordings() {
    let folder = decay("");
    folder.write(
        "several.toml",
        r#"
model = "model.fmu"
[[experiments]]
name = "a"
data = "run.csv"
outputs = { x = "x" }
windows = [[0.0, 1.0]]
[[experiments]]
name = "b"
data = "run.csv"
outputs = ["x"]
weights = "range"
initial_states = { x = "measured" }
[[parameters]]
name = "k"
start = 1.0
lower = 0.1
upper = 10
scale = "log"
prior = { log-normal = { median = 2.0, sigma = 0.5 } }
[[stages]]
parameters = ["k"]
windows = [[0.0, 0.5]]
[[stages]]
parameters = ["k"]
max_evaluations = 50
"#,
    );
    let result = json(&folder.run("fit several.toml --json").out);
    assert!((fitted(&result.to_string()) - 2.0).abs() < 1e-3, "{result}");
    assert_eq!(result["outputs"].as_array().unwrap().len(), 2, "{result}");
    assert!(result["message"].as_str().unwrap().contains("stage 1 of 2"), "{result}");
}

#[test]
fn errors_name_the_line_of_a_mistake() {
    let folder = decay("");
    for (from, to, line, expected) in [
        ("model = ", "modell = ", 1, "unknown problem field 'modell'; did you mean 'model'?"),
        ("model.fmu", "none.fmu", 1, "none.fmu"),
        ("model = ", "units = { x = \"m\" }\nmodel = ", 1, "'units' belongs to the table [settings]"),
        ("data = ", "date = ", 4, "unknown field of an experiment 'date'; did you mean 'data'?"),
        ("run.csv", "none.csv", 4, "none.csv"),
        ("x = \"x\"", "y = \"x\"", 5, "no variable \"y\""),
        ("x = \"x\"", "x = \"y\"", 5, "column 'y' not found"),
        ("start = 1.0", "strat = 1.0", 9, "did you mean 'start'?"),
        ("start = 1.0", "start = \"one\"", 9, "start must be a number, not 'one'"),
        ("start = 1.0", "start = ", 9, ""),
        ("start = 1.0", "start = 11", 8, "start 11 is outside of the bounds 0.1 and 10"),
        ("name = \"k\"", "name = \"kk\"", 8, "\"kk\""),
        (
            "upper = 10",
            "upper = 10\n[settings]\nsolvr = 1",
            13,
            "unknown setting of simulations 'solvr'; did you mean 'solver'?",
        ),
        ("upper = 10", "upper = 10\n[settings]\nsolver = \"rk5\"", 13, "unknown solver 'rk5'"),
        (
            "upper = 10",
            "upper = 10\n[fit]\nmax_tiem = 1",
            13,
            "unknown fit option 'max_tiem'; did you mean 'max_time'?",
        ),
        (
            "upper = 10",
            "upper = 10\n[fit]\nmax_time = -1",
            13,
            "max_time = -1 must be a positive number of seconds",
        ),
        ("upper = 10", "upper = 10\n[fit]\nmethod = \"simplex\"", 13, "nelder-mead"),
        (
            "upper = 10",
            "upper = 10\n[fit]\nobjective = \"rms\"",
            13,
            "unknown objective 'rms'; did you mean 'rmse'?",
        ),
        ("upper = 10", "upper = 10\n[[stages]]\nparametres = [\"k\"]", 13, "did you mean 'parameters'?"),
        (
            "[[parameters]]",
            "[parameters]",
            7,
            "parameters: expected tables, each with the heading [[parameters]]",
        ),
    ] {
        assert!(PROBLEM.contains(from), "{from}");
        folder.write("wrong.toml", &PROBLEM.replacen(from, to, 1));
        for command in ["check", "fit"] {
            let message = folder.run(&format!("{command} wrong.toml")).wrong_input();
            let place = format!("wrong.toml, line {line}: ");
            assert!(message.starts_with(&place) && message.contains(expected), "{to}: {message}");
        }
    }
    for (arguments, expected) in [
        ("none.toml", "cannot read none.toml"),
        ("model.fmu", "a recording is also required"),
        ("problem.toml run.csv", "Specify either a problem file"),
        ("run.csv", "run.csv, line 1"),
        ("model.fmu run.csv --parameter k=a", "start 'a' is not a number"),
        ("model.fmu run.csv --parameter k=1:2:3:4", "expected name=start:lower:upper"),
        (
            "model.fmu run.csv --output x",
            "there are no parameters to fit. Specify --parameter NAME=START:LOWER:UPPER",
        ),
        (".", ". is not a model, because the folder contains no modelDescription.xml"),
        (
            "problem.toml --option max_time=-1",
            "--option max_time: max_time = -1 must be a positive number of seconds",
        ),
        ("problem.toml -O max_tiem=1", "--option max_tiem: unknown fit option 'max_tiem'"),
        ("problem.toml -S solver=rk5", "--setting solver: unknown solver 'rk5'"),
        ("problem.toml --setting solver", "expected name=value"),
        ("problem.toml --parameter k=1", "--parameter cannot be used with a problem file. Edit problem.toml"),
        ("problem.toml --setting solvr=1", "did you mean 'solver'?"),
    ] {
        let message = folder.run(&format!("fit {arguments}")).wrong_input();
        assert!(message.contains(expected), "{arguments}: {message}");
    }
}

#[test]
fn unsupported_method_options_are_wrong_input() {
    let folder = decay("\n[fit]\npopulation = 5\n");
    for command in ["check", "fit"] {
        let reported = folder.run(&format!("{command} problem.toml")).wrong_input();
        assert!(reported.contains("has no option 'population'"), "{reported}");
    }
}

#[test]
fn check_exits_with_1_only_for_errors() {
    let folder = decay("");
    let document = json(&folder.run("check problem.toml --json --preflight").good());
    assert!(
        document["findings"].is_array() && document["preflight"]["parameters"][0]["has_effect"] == true,
        "{document}"
    );
    assert!(folder.run("check problem.toml --no-run").good().lines().count() >= 1);
    // At this start value, the simulation fails.
    folder.write(
        "bad.toml",
        &PROBLEM
            .replace("start = 1.0", "start = 1.0\n")
            .replace("x = \"x\"", "x = \"x\" }\nstart_values = { x = 1e308 ")
            .replace("start = 1.0", "start = -1e3")
            .replace("0.1", "-1e4"),
    );
    let ran = folder.run("check bad.toml");
    assert!(ran.code == 1 && ran.out.contains("error"), "{ran:?}");
}

#[test]
fn resumed_fit_is_bit_for_bit_identical() {
    let folder = decay("[fit]\nmethod = \"nelder-mead\"\nx_tol = 1e-9\n");
    let whole = json(&folder.run("fit problem.toml --json").out);
    let first = folder.run("fit problem.toml --json --checkpoint fit.ckpt -O max_evaluations=10");
    assert_eq!(json(&first.out)["n_evaluations"], 10, "{first:?}");
    let resumed = json(&folder.run("resume problem.toml --json --checkpoint fit.ckpt").out);
    for field in ["parameters", "cost", "n_evaluations"] {
        assert_eq!(resumed[field], whole[field], "{field}");
    }
    let message = folder.run("resume problem.toml --checkpoint none.ckpt");
    assert!(message.code != 0 && message.err.contains("none.ckpt"), "{message:?}");
    assert!(folder.run("resume problem.toml").wrong_input().contains("--checkpoint FILE"));
}

#[test]
fn report_rejects_files_that_are_not_saved_fits() {
    let folder = decay("");
    folder.run("fit problem.toml --save decay.fit --quiet").good();
    for (arguments, expected) in [
        ("none.fit a.html", "none.fit"),
        ("run.csv a.html", "is not a saved fit"),
        ("decay.fit a.pdf", "a.pdf: unknown report format; expected a name that ends in .html"),
        ("decay.fit no/such/a.html", "no/such/a.html"),
        ("decay.fit a.html --model none.fmu", "none.fmu"),
    ] {
        let message = folder.run(&format!("report {arguments}")).wrong_input();
        assert!(message.contains(expected), "{arguments}: {message}");
    }
    std::fs::rename(folder.path("model.fmu"), folder.path("moved.fmu")).unwrap();
    folder.run("report decay.fit a.html --model moved.fmu").good();
}

#[test]
fn file_contains_derived_parameters() {
    let derived = |expr: &str| format!("\n[[parameters]]\nname = \"x\"\nexpr = \"{expr}\"\n");
    let folder = decay(&derived("k / 2"));
    let ran = folder.run("fit problem.toml --json").good();
    let parameters = &json(&ran)["parameters"];
    assert_eq!(parameters[1]["value"].as_f64().unwrap(), fitted(&ran) / 2.0);
    assert_eq!(parameters[1]["expr"], "k / 2");
    assert!(folder.run("fit problem.toml").good().contains("derived: k / 2"));
    for (expr, expected) in [
        (
            "k ^ 2",
            "problem.toml, line 14: parameter 'x': expr: '^' is not an operator. Write ** for a power (column 3)",
        ),
        ("2 * kk", "'kk' ('k'?), which does not exist; available: k (column 5)"),
    ] {
        folder.write("problem.toml", &(PROBLEM.to_owned() + &derived(expr)));
        let message = folder.run("fit problem.toml").wrong_input();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn constraints_of_a_file_hold_at_the_result() {
    let folder = decay("");
    folder.write("problem.toml", &format!("constraints = [\"2 * k <= 3\"]\n{PROBLEM}"));
    let fit = folder.run("fit problem.toml");
    assert!(fit.out.contains("k  1  -> 1.5"), "{fit:?}");
}

#[test]
fn constraints_of_a_file_are_checked_before_the_fit() {
    let folder = decay("");
    for (constraint, expected) in [
        (
            "k >= 20",
            "problem.toml, line 1: constraint 'k >= 20': k is between 0.1 and 10 within the bounds, but must be at least 20",
        ),
        (
            "kk <= 1",
            "problem.toml, line 1: constraint 'kk <= 1': 'kk' ('k'?) is not a parameter; available: k (column 1)",
        ),
        ("k = 1", "'=' is not an operator. Write == for equality (column 3)"),
    ] {
        folder.write("problem.toml", &format!("constraints = [\"{constraint}\"]\n{PROBLEM}"));
        let message = folder.run("fit problem.toml").wrong_input();
        assert!(message.contains(expected), "{message}");
    }
}
