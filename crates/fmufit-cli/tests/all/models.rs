//! Commands for a single model: info, validate, simulate, build.

use crate::support::{Folder, holds_only, json};

/// Returns a column of a CSV table by name.
fn column(table: &str, name: &str) -> Vec<f64> {
    let mut lines = table.lines();
    let at =
        lines.next().unwrap().split(',').position(|n| n == name).unwrap_or_else(|| panic!("{name}: {table}"));
    lines.map(|line| line.split(',').nth(at).unwrap().parse().unwrap()).collect()
}

#[test]
fn info_shows_variables_with_causality_unit_and_start() {
    let folder = Folder::with_model("furuta");
    let text = folder.run("info model.fmu").good();
    assert!(text.starts_with("Furuta, FMI 2.0\n") && text.contains("start 0 s, stop 40 s"), "{text}");
    let line = text.lines().find(|line| line.contains("armFriction")).unwrap();
    let words: Vec<&str> = line.split_whitespace().take(6).collect();
    assert_eq!(words, ["armFriction", "parameter", "tunable", "Real", "N.m", "0.012"]);
    assert!(
        text.contains("internal variables; use --all to show them") && !text.contains("armJoint.w"),
        "{text}"
    );
    assert!(folder.run("info model.fmu --all").good().contains("armJoint.w"));
    let parameters = folder.run("info model.fmu --causality parameter").good();
    assert!(parameters.contains("arm.length") && !parameters.contains("armJoint.phi"), "{parameters}");
    let message = folder.run("info model.fmu --causality paramter").wrong_input();
    assert!(
        message.contains("--causality paramter: no variable has this causality")
            && message.contains("parameter"),
        "{message}"
    );

    let document = json(&folder.run("info model.fmu --json").good());
    assert_eq!((&document["model_name"], &document["fmi_version"]), (&"Furuta".into(), &"2.0".into()));
    let variables = document["variables"].as_array().unwrap();
    let friction = variables.iter().find(|v| v["name"] == "armFriction").unwrap();
    assert_eq!((&friction["unit"], &friction["start"]), (&"N.m".into(), &0.012.into()));
    assert!(variables.iter().any(|v| v["causality"] == "local"));
}

/// Writes a model whose library is for Windows, in which only the programs to run it matter.
#[cfg(target_os = "linux")]
fn write_windows_model(folder: &Folder, platform: &str, file: &str) {
    let mut archive = zip::ZipWriter::new(std::fs::File::create(folder.path(file)).unwrap());
    let description = "<fmiModelDescription fmiVersion=\"2.0\" modelName=\"m\" guid=\"g\"><ModelExchange \
                       modelIdentifier=\"m\"/><DefaultExperiment stopTime=\"1\"/><ModelVariables><ScalarVariable name=\"k\" \
                       valueReference=\"0\" causality=\"parameter\" variability=\"fixed\"><Real start=\"1\"/>\
                       </ScalarVariable><ScalarVariable name=\"y\" valueReference=\"1\" causality=\"output\"><Real/>\
                       </ScalarVariable></ModelVariables><ModelStructure><Outputs><Unknown index=\"2\"/></Outputs>\
                       </ModelStructure></fmiModelDescription>";
    let library = format!("binaries/{platform}/m.dll");
    for (name, content) in [("modelDescription.xml", description), (&library, "MZ")] {
        archive.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        std::io::Write::write_all(&mut archive, content.as_bytes()).unwrap();
    }
    archive.finish().unwrap();
}

#[test]
#[cfg(target_os = "linux")]
fn model_for_windows_reports_the_missing_program() {
    let folder = Folder::new();
    write_windows_model(&folder, "win64", "windows.fmu");
    write_windows_model(&folder, "win32", "windows-32.fmu");
    folder.write("program", "");
    folder.write("data.csv", "time,y\n0,1\n1,2\n");
    folder.write(
        "fit.toml",
        "model = 'windows.fmu'\n[[experiments]]\ndata = 'data.csv'\noutputs = { y = 'y' }\n[[parameters]]\n\
         name = 'k'\nstart = 1.0\n",
    );
    let failed = |arguments: &str, variables: &[(&str, &str)]| {
        let mut command = folder.command(arguments);
        command.env("XDG_DATA_HOME", folder.path("data")).envs(variables.iter().copied());
        let output = command.output().unwrap();
        assert!(!output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    let missing = |variables: &[(&str, &str)]| failed("simulate windows.fmu --outputs time", variables);
    let program = folder.path("program").display().to_string();
    let message = missing(&[("FMUFIT_WINE", "/no/wine")]);
    assert!(
        message.contains("a library for Windows only") && message.contains("FMUFIT_WINE = /no/wine"),
        "{message}"
    );
    let message = failed("fit fit.toml", &[("FMUFIT_WINE", "/no/wine")]);
    assert!(message.contains("runs under Wine. FMUFIT_WINE = /no/wine is not a file"), "{message}");
    let message = missing(&[("FMUFIT_WINE", &program)]);
    assert!(message.contains("data/fmufit/win64/fmufit-worker.exe, was not found"), "{message}");
    assert!(message.contains("make windows-worker"), "{message}");
    // A program that cannot be started.
    let broken = [("FMUFIT_WINE", &*program), ("FMUFIT_WINDOWS_WORKER", &*program)];
    for message in [missing(&broken), failed("fit fit.toml", &broken)] {
        assert!(message.contains("Cannot start a worker process") && message.contains(&program), "{message}");
    }
    // A program that ends at once.
    let message = missing(&[("FMUFIT_WINE", "/bin/false"), ("FMUFIT_WINDOWS_WORKER", &program)]);
    assert!(message.contains("Cannot start a worker process"), "{message}");
    let text = folder.run("info windows.fmu").good();
    assert!(text.contains("win64 (runs here under Wine)"), "{text}");
    let message = failed("simulate windows-32.fmu --outputs time", &[("FMUFIT_WINE", &program)]);
    assert!(
        message.contains("a 32-bit library for Windows only")
            && message.contains("data/fmufit/win32/fmufit-worker.exe"),
        "{message}"
    );
    let text = folder.run("info windows-32.fmu").good();
    assert!(text.contains("win32 (runs here in a 32-bit process)"), "{text}");
}

#[test]
fn validate_runs_a_model_and_reports_violations() {
    let folder = Folder::with_model("dahlquist");
    let text = folder.run("validate model.fmu").good();
    assert!(
        text.contains("no violations of the FMI standard") && text.contains("simulated: to 10 s"),
        "{text}"
    );
    let document = json(&folder.run("validate model.fmu --json").good());
    assert_eq!((&document["is_simulated"], &document["quirks"]), (&true.into(), &serde_json::json!([])));
    // A file that is not an FMU cannot be validated.
    folder.write("broken.fmu", "not an archive");
    assert!(folder.run("validate broken.fmu").wrong_input().contains("broken.fmu"));
    assert!(folder.run("validate none.fmu").wrong_input().contains("none.fmu"));
}

const SET: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" name="set">
  <ssv:Parameters>
    <ssv:Parameter name="k"><ssv:Real value="2"/></ssv:Parameter>
    <ssv:Parameter name="x"><ssv:Real value="3"/></ssv:Parameter>
  </ssv:Parameters>
</ssv:ParameterSet>
"#;

#[test]
fn simulate_reads_start_values_from_ssp_parameter_sets() {
    let folder = Folder::with_model("dahlquist");
    folder.write("set.ssv", SET);
    let options = "--final-time 1 --interval 0.25";
    let by_file = folder.run(&format!("simulate model.fmu --set @set.ssv {options}")).good();
    let by_name = folder.run(&format!("simulate model.fmu --set k=2 --set x=3 {options}")).good();
    assert_eq!(by_file, by_name);
    // Individual values take precedence over values from the file.
    let both = folder.run(&format!("simulate model.fmu --set @set.ssv --set k=1 {options}")).good();
    assert_eq!(both, folder.run(&format!("simulate model.fmu --set k=1 --set x=3 {options}")).good());
    for (text, expected) in [
        (SET.replace("\"k\"", "\"kk\""), "set.ssv: the model has no variable \"kk\""),
        (SET.replace("value=\"2\"", "value=\"two\""), "set.ssv: line 4: 'k' = 'two' is not a valid Real"),
        (SET.replace("value=\"2\"", "value=\"2\" unit=\"m\""), "'k'"),
        ("k = 2".to_owned(), "set.ssv: "),
    ] {
        folder.write("set.ssv", &text);
        let message = folder.run("simulate model.fmu --set @set.ssv").wrong_input();
        assert!(message.contains(expected), "{message}");
    }
    assert!(folder.run("simulate model.fmu --set @none.ssv").wrong_input().contains("none.ssv"));
}

#[test]
fn systems_of_models_are_rejected() {
    let folder = Folder::with_model("dahlquist");
    folder.write("system.ssd", "<ssd:SystemStructureDescription/>");
    let message = folder.run("info system.ssd").wrong_input();
    assert!(message.contains("an .ssd file describes a system of models"), "{message}");
    let message = folder.run("fit system.ssd run.csv --output x --parameter k=1").wrong_input();
    assert!(message.contains("an .ssd file describes a system of models"), "{message}");
    let message = folder.run("simulate model.fmu --set @system.ssd").wrong_input();
    assert!(message.contains("the file describes a system of models (.ssd)"), "{message}");
}

#[test]
fn simulate_writes_the_solution_of_the_model() {
    let folder = Folder::with_model("dahlquist");
    let ran = folder.run("simulate model.fmu --set k=2 --final-time 1 --interval 0.25");
    assert_eq!(ran.err, "");
    let table = ran.good();
    assert_eq!(column(&table, "time"), [0.0, 0.25, 0.5, 0.75, 1.0]);
    for (time, x) in column(&table, "time").into_iter().zip(column(&table, "x")) {
        assert!((x - (-2.0 * time).exp()).abs() < 1e-6, "{table}");
    }
    // In-process simulation gives bit-for-bit the same table; a plot is one SVG document.
    let arguments = "simulate model.fmu --set k=2 --final-time 1 --interval 0.25 --in-process --output own.csv --plot own.svg";
    assert_eq!(folder.run(arguments).good(), "");
    assert_eq!(folder.read("own.csv"), table);
    assert!(folder.read("own.svg").starts_with("<svg"));
    assert!(holds_only(&folder.path(""), &["model.fmu", "own.csv", "own.svg"]));
}

#[test]
fn simulate_converts_recorded_inputs_to_model_units() {
    let folder = Folder::with_model("quad_tank");
    let inputs = json(&folder.run("info model.fmu --json --causality input").good());
    let names: Vec<&str> =
        inputs["variables"].as_array().unwrap().iter().map(|v| v["name"].as_str().unwrap()).collect();
    let rows: String = (0..3).map(|k| format!("{}{}\n", 10 * k, ",5.5".repeat(names.len()))).collect();
    folder.write("in.csv", &format!("time,{}\n{rows}", names.join(",")));
    let table = folder
        .run(&format!("simulate model.fmu --input in.csv --final-time 20 --outputs {}", names[0]))
        .good();
    assert!(column(&table, names[0]).iter().all(|u| (u - 5.5).abs() < 1e-12), "{table}");
    folder.write("other.csv", "time,unknown\n0,1\n1,1\n");
    let message = folder.run("simulate model.fmu --input other.csv").wrong_input();
    assert!(
        message.contains("no column has the name of an input of the model; the columns are 'unknown'")
            && message.contains(names[0]),
        "{message}"
    );
}

#[test]
fn warning_names_inputs_without_a_column() {
    let folder = Folder::with_model("quad_tank");
    let simulate =
        "simulate model.fmu --input in.csv --final-time 20 --interval 10 --outputs u1 --outputs u2";
    let run = |header: &str, more: &str| {
        folder.write("in.csv", &format!("{header}0,2,3\n20,2,3\n"));
        folder.run(&format!("{simulate} {more}"))
    };
    // The case of a name may differ if it identifies one column.
    let ran = run("time,U1 [V],u2\n", "");
    assert!(!ran.err.contains("no column"), "{ran:?}");
    let table = ran.good();
    assert_eq!((column(&table, "u1"), column(&table, "u2")), (vec![2.0; 3], vec![3.0; 3]));
    let ran = run("time,u1,v2\n", "");
    assert!(
        ran.err.contains("in.csv: input 'u2' has no column and keeps its start value")
            && ran.err.contains("one of the columns 'u1', 'v2'"),
        "{ran:?}"
    );
    ran.good();
    let ran = run("time,U2,U2 [V]\n", "--set u2=1");
    assert!(ran.err.contains("no column has the name of an input"), "{ran:?}");
    let ran = run("time,u1,v2\n", "--set u2=1");
    assert!(!ran.err.contains("no column"), "{ran:?}");
    assert_eq!(column(&ran.good(), "u2"), [1.0; 3]);
    // Two units.
    let message = run("time,u1 [V],u2\ns,mV,V\n", "").wrong_input();
    assert!(
        message.contains("in.csv: column 'u1 [V]' has two units, 'V' in its name and 'mV' in line 2"),
        "{message}"
    );
}

#[test]
fn simulate_names_unusable_arguments() {
    let folder = Folder::with_model("furuta");
    for (arguments, expected) in [
        ("none.fmu", "cannot open none.fmu"),
        ("model.fmu --set armFrction=1", "did you mean armFriction?"),
        ("model.fmu --set armFriction=stiff", "'armFriction' = 'stiff': expected a value of type Real"),
        ("model.fmu --set armFriction", "expected NAME=VALUE"),
        ("model.fmu --solver rk5", "unknown solver 'rk5'"),
        ("model.fmu --kind XY", "kind = 'XY'"),
        ("model.fmu --outputs armJoint.fi", "armJoint.phi"),
        ("model.fmu --timeout 0", "--timeout = 0 must be a positive number of seconds"),
        ("model.fmu --input none.csv", "cannot read none.csv"),
        ("model.fmu --output no/such/folder.csv", "no/such"),
    ] {
        let message = folder.run(&format!("simulate {arguments}")).wrong_input();
        assert!(message.contains(expected), "{arguments}: {message}");
    }
    let ran = folder.run(
        "simulate model.fmu --final-time 1e9 --interval 1e8 --solver rk4 --step-size 1e-4 --timeout 0.05",
    );
    assert!(ran.code == 1 && ran.out.is_empty() && ran.err.contains("0.05"), "{ran:?}");
}

#[test]
fn warning_reports_invalid_library_when_sources_replace_it() {
    let folder = Folder::with_model("dahlquist");
    let file = std::fs::File::open(folder.path("model.fmu")).unwrap();
    zip::ZipArchive::new(file).unwrap().extract(folder.path("decay")).unwrap();
    let place = std::fs::read_dir(folder.path("decay/binaries")).unwrap().next().unwrap().unwrap().path();
    let library = std::fs::read_dir(&place).unwrap().next().unwrap().unwrap().path();
    std::fs::write(&library, "no library").unwrap();
    let ran = folder.run("simulate decay --final-time 1 --interval 1");
    let named = library.strip_prefix(folder.path("decay")).unwrap().display().to_string();
    assert!(
        ran.code == 0 && ran.err.contains(&format!("{named} is not a library for this platform")),
        "{ran:?}"
    );
    // A missing library cannot be invalid.
    std::fs::remove_dir_all(place).unwrap();
    assert_eq!(folder.run("simulate decay --final-time 1 --interval 1").err, "");
}

#[test]
fn simulate_errors_use_argument_names() {
    let folder = Folder::with_model("dahlquist");
    for (arguments, expected) in [
        ("--plot x.png", "--plot x.png: expected a name that ends in .svg"),
        ("--start-time 20", "10 is the end time of the model, which --final-time overrides"),
        ("--interval 1e-300", "--interval = 1e-300"),
    ] {
        let message = folder.run(&format!("simulate model.fmu {arguments}")).wrong_input();
        assert!(message.contains(expected), "{message}");
    }
    assert!(holds_only(&folder.path(""), &["model.fmu"]));
}

#[test]
fn build_packs_a_folder_that_can_be_simulated() {
    let folder = Folder::with_model("dahlquist");
    let file = std::fs::File::open(folder.path("model.fmu")).unwrap();
    zip::ZipArchive::new(file).unwrap().extract(folder.path("decay")).unwrap();
    std::fs::remove_dir_all(folder.path("decay/binaries")).unwrap();
    let out = folder.run("build decay").good();
    assert!(out.starts_with("wrote ") && folder.path("decay.fmu").is_file(), "{out}");
    let table = folder.run("simulate decay.fmu --final-time 1 --interval 1").good();
    assert!((column(&table, "x")[1] - (-1.0_f64).exp()).abs() < 1e-6, "{table}");
    assert!(folder.run("build decay.fmu").wrong_input().contains("Specify the file to write"));
    folder.write("decay/sources/model.c", "this is no C\n");
    let ran = folder.run("build decay other.fmu");
    assert!(ran.code == 1 && !folder.path("other.fmu").exists(), "{ran:?}");
    assert!(folder.run("build nothing other.fmu").wrong_input().contains("nothing"));
}

/// Each command that runs a model can confine it, with the same results.
#[test]
fn commands_run_a_model_in_a_sandbox() {
    let folder = Folder::with_model("dahlquist");
    folder.record_decay();
    if fmi::worker::check_sandbox().is_err() {
        let message = folder.run("simulate model.fmu --sandbox").wrong_input();
        assert!(message.starts_with("sandbox: "), "{message}");
        return;
    }
    folder.run("init model.fmu run.csv free.toml").good();
    folder.run("init model.fmu run.csv confined.toml --sandbox").good();
    assert!(folder.read("confined.toml").contains("\nsandbox = true"));
    for command in ["simulate model.fmu --final-time 1", "validate model.fmu", "check free.toml"] {
        let expected = folder.run(command).good();
        assert_eq!(folder.run(&format!("{command} --sandbox")).good(), expected, "{command}");
    }
    assert_eq!(folder.run("check confined.toml").good(), folder.run("check free.toml").good());
    let message = folder.run("check confined.toml -S isolation=none").wrong_input();
    assert!(message.contains("sandbox: the model would run in this process"), "{message}");
    assert_eq!(folder.run("simulate model.fmu --sandbox --in-process").code, 2);
}
