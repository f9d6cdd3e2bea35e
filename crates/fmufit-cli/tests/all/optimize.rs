//! `optimize`: designs from problem files, and mistakes in them.

use crate::support::{Folder, json};

const DESIGN: &str = r#"model = "model.fmu"
objective = "integral(x) + k**2"

[[parameters]]
name = "k"
start = 2.0
lower = 0.1
upper = 10

[[scenarios]]
final_time = 50
"#;

fn design(text: &str) -> Folder {
    let folder = Folder::with_model("dahlquist");
    folder.write("design.toml", text);
    folder
}

#[test]
fn design_is_optimised_and_reported() {
    let folder = design(DESIGN);
    let ran = folder.run("optimize design.toml --json --quiet --report design.html --checkpoint d.ckpt");
    let found = json(&ran.good());
    // The minimum of 1/k + k^2.
    let k = found["parameters"][0]["value"].as_f64().unwrap();
    assert!((k - 0.5_f64.cbrt()).abs() < 2e-3, "{found}");
    assert!((found["result"]["criteria"][0]["value"].as_f64().unwrap() * k - 1.0).abs() < 1e-5, "{found}");
    let page = std::fs::read_to_string(folder.path("design.html")).unwrap();
    assert!(page.contains("Design of") && page.contains("integral(x)") && !page.contains("NaN"), "{page}");
    // A complete checkpoint returns its result.
    let text = folder.run("optimize design.toml --quiet --checkpoint d.ckpt").good();
    assert!(
        text.contains("integral(x) + k**2 = 1.88988") && text.contains("continued from d.ckpt"),
        "{text}"
    );
    // The design fails if its constraint cannot hold.
    let constrained = DESIGN.replace("[[parameters]]", "constraints = [\"final(x) >= 2\"]\n[[parameters]]");
    let ran = design(&constrained).run("optimize design.toml --quiet --option max_evaluations=30");
    assert_eq!(ran.code, 1, "{ran:?}");
}

#[test]
fn mistakes_in_designs_name_their_line() {
    for (from, to, expected) in [
        (
            "integral(x)",
            "integral(y)",
            "design.toml, line 2: objective 'integral(y) + k**2': 'y' ('x'?) is neither",
        ),
        (
            "integral(x)",
            "integal(x)",
            "design.toml, line 2: 'integal' is not a function; 'integral'? (column 1)",
        ),
        ("[[scenarios]]", "[[experiments]]", "experiments belong to a fit, and objective to a design"),
        ("final_time = 50", "final_time = -1", "final_time = -1 must be later than the start"),
        ("objective = \"integral(x) + k**2\"\n", "", "objective is missing. Add, for example, objective = "),
        ("[[parameters]]", "combine = \"best\"\n[[parameters]]", "combine"),
        ("objective = ", "objectives = ", "'objectives'"),
    ] {
        let error = design(&DESIGN.replacen(from, to, 1)).run("optimize design.toml").wrong_input();
        assert!(error.contains(expected), "{error}");
    }
    let folder = design(DESIGN);
    assert!(folder.run("check design.toml").good().contains("nothing found"));
    let error = folder.run("check design.toml --preflight --quiet").wrong_input();
    assert!(error.contains("preflight: a design has no recordings"), "{error}");
    assert!(folder.run("jobs init design.toml --jobs 1").wrong_input().contains("Use fmufit optimize"));
    let error = folder.run("fit design.toml").wrong_input();
    assert!(error.contains("Use fmufit optimize"), "{error}");
}

#[test]
fn several_objectives_have_a_pareto_front() {
    let objectives = "objective = [\"integral(x)\", \"maximize -k**2\"]";
    let text = DESIGN.replace("objective = \"integral(x) + k**2\"", objectives);
    let folder = design(&text);
    let command =
        "optimize design.toml --quiet -O population=16 -O max_evaluations=160 -O rng=1 --checkpoint d.ckpt";
    let found = json(&folder.run(&format!("{command} --json --report front.csv")).good());
    let front = found["front"].as_array().unwrap();
    assert!(front.len() > 5 && found["compromise"].as_u64().unwrap() < front.len() as u64, "{found}");
    for point in front {
        let [time, effort] = [0, 1].map(|k| point["objectives"][k].as_f64().unwrap());
        let k = point["parameters"][0].as_f64().unwrap();
        // The integral of exp(-k t) from 0 to 50.
        let expected = (1.0 - (-50.0 * k).exp()) / k;
        assert!((time / expected - 1.0).abs() < 1e-4 && effort == -k * k, "{point}");
    }
    let table = std::fs::read_to_string(folder.path("front.csv")).unwrap();
    assert!(table.starts_with("integral(x),maximize -k**2,k\n"), "{table}");
    assert_eq!(table.lines().count(), front.len() + 1);
    // The checkpoint is complete. The table and the figure have the same designs.
    let shown = folder.run(&format!("{command} --report front.svg")).good();
    assert!(shown.starts_with(&format!("Pareto front with {} designs", front.len())), "{shown}");
    assert!(shown.contains("compromise (nearest") && shown.contains("continued from d.ckpt"), "{shown}");
    assert!(std::fs::read_to_string(folder.path("front.svg")).unwrap().starts_with("<svg"));
    for (arguments, expected) in [
        ("--report front.html", "unknown format of a Pareto front"),
        ("--watch", "the problem has several"),
        ("--option method=cma-es", "is searched by NSGA-II"),
    ] {
        let error = folder.run(&format!("optimize design.toml {arguments}")).wrong_input();
        assert!(error.contains(expected), "{error}");
    }
    let infeasible = text.replace("[[parameters]]", "constraints = [\"final(x) >= 2\"]\n[[parameters]]");
    let ran = design(&infeasible)
        .run("optimize design.toml -O max_evaluations=40 -O population=10 --json --report f.svg");
    assert_eq!((ran.code, json(&ran.out)["front"].as_array().map(Vec::len)), (1, Some(0)), "{ran:?}");
    assert!(ran.err.contains("f.svg was not written, because no design satisfies"), "{ran:?}");
    let empty =
        design(&text.replace("[\"integral(x)\", \"maximize -k**2\"]", "[]")).run("optimize design.toml");
    assert!(empty.wrong_input().contains("design.toml, line 2: objective: the list is empty"));
    let wrong = design(&text.replace("-k**2", "-q**2")).run("optimize design.toml").wrong_input();
    assert!(wrong.contains("design.toml, line 2: objective 'maximize -q**2': 'q'"), "{wrong}");
}
