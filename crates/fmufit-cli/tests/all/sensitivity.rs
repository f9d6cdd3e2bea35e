//! `sensitivity`: effects of parameters in fits and designs.

use crate::support::{Folder, json};

const PARAMETER: &str = "[[parameters]]\nname = \"k\"\nstart = 2.0\nlower = 0.1\nupper = 10\n";

fn folder() -> Folder {
    let folder = Folder::with_model("dahlquist");
    folder.write("data.csv", "time,x\n0,1\n0.5,0.37\n1,0.14\n");
    let experiment = "[[experiments]]\ndata = \"data.csv\"\noutputs = { x = \"x\" }\n";
    folder.write("fit.toml", &format!("model = \"model.fmu\"\n{experiment}{PARAMETER}"));
    let scenario = "[[scenarios]]\nfinal_time = 50\n";
    let objective = "model = \"model.fmu\"\nobjective = \"3*k + 0*final(x)\"\n";
    folder.write("design.toml", &format!("{objective}{PARAMETER}{scenario}"));
    folder
}

#[test]
fn effects_on_fits_and_designs_are_estimated() {
    let folder = folder();
    let text = folder.run("sensitivity fit.toml --rng 1 --quiet").good();
    assert!(text.starts_with("sensitivity (morris): 20 evaluations, 95 % intervals"), "{text}");
    assert!(text.contains("cost") && text.contains("rms(x)"), "{text}");
    // A linear objective has the same effect everywhere, its slope times the range.
    let found = json(&folder.run("sensitivity design.toml -n 4 --rng 1 --json --quiet").good());
    let effects = &found["outputs"][0]["effects"]["morris"];
    assert!((effects["mu_star"][0].as_f64().unwrap() / 29.7 - 1.0).abs() < 1e-12, "{found}");
    assert!(effects["sigma"][0].as_f64().unwrap() < 1e-12, "{found}");
    // The only parameter causes all of the variance, at the same points with a checkpoint and other workers.
    let command = "sensitivity design.toml --method sobol -n 64 --json --quiet --rng 1";
    let first = folder.run(&format!("{command} --checkpoint s.ckpt --workers 2")).good();
    let found = json(&first);
    assert_eq!(found["n_evaluations"], 64 * 3);
    let total = found["outputs"][0]["effects"]["sobol"]["st"][0].as_f64().unwrap();
    assert!((total - 1.0).abs() < 0.1, "{found}");
    assert_eq!(first, folder.run(&format!("{command} --checkpoint s.ckpt")).good());
    assert_eq!(first, folder.run(command).good());
}

#[test]
fn mistakes_are_named() {
    let folder = folder();
    for (arguments, expected) in [
        ("design.toml --second-order", "--second-order is an option of --method sobol only"),
        ("design.toml --method sobol --levels 4", "--levels is an option of --method morris only"),
        ("design.toml --max-time=-1", "--max-time -1: expected a number of seconds"),
        ("design.toml -n 1", "at least 2"),
        ("design.toml --level 2", "between 0 and 1"),
        ("design.toml --method fast", "possible values: morris, sobol"),
        ("design.toml -n 1000000000000", "at most 2^28 coordinates"),
        ("design.toml --method sobol -n 18446744073709551615", "at most 2^28 coordinates"),
        ("design.toml --levels 1000000000000", "an even number from 2 to 1000000"),
    ] {
        let ran = folder.run(&format!("sensitivity {arguments}"));
        assert!(ran.code == 2 && ran.err.contains(expected), "{arguments}: {ran:?}");
    }
    folder.write(
        "open.toml",
        &std::fs::read_to_string(folder.path("fit.toml")).unwrap().replace("upper = 10\n", ""),
    );
    let error = folder.run("sensitivity open.toml").wrong_input();
    assert!(error.contains("'k'") && error.contains("requires finite bounds"), "{error}");
}
