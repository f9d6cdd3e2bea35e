//! JSON schema of problem files: the schema accepts what the program accepts and rejects the same unknown
//! names.

use crate::fit::PROBLEM;
use crate::json_schema::Schema;
use crate::support::{Folder, json};
use serde_json::Value;

fn schema(folder: &Folder) -> Schema {
    Schema::new(json(&folder.run("schema").good()))
}

fn document(text: &str) -> Value {
    toml::from_str(text).unwrap()
}

#[test]
fn problem_files_follow_their_schema() {
    let folder = Folder::with_model("dahlquist");
    let schema = schema(&folder);
    folder.record_decay();
    folder.run("init model.fmu run.csv written.toml").good();
    let written = folder.read("written.toml");
    assert!(written.starts_with("#:schema problem.schema.json\n"), "{written}");
    // The commented options that `init` writes are also valid.
    let options: String = written.split_once("[settings]").unwrap().1.replace("\n# ", "\n");
    let uncommented = format!("{PROBLEM}[settings]{options}");
    let whole = format!(
        "{PROBLEM}scale = \"log\"\nprior = {{ log-normal = {{ median = 2.0, sigma = 0.5 }} }}\n[[experiments]]\ndata = \"run.csv\"\n\
         outputs = [\"x\"]\nweights = \"range\"\nwindows = [[0.0, 1.0]]\nstart_values = {{ x = 1 }}\ninitial_states = {{ x = \"measured\" }}\n\
         [settings]\nsolver = \"rk4\"\nstep_size = 0.01\ntimeout = 2\n[fit]\nmethod = \"de-classic\"\nweight = [0.5, 0.9]\nmax_evaluations = 60\n\
         [[stages]]\nparameters = [\"k\"]\nmethod = \"nm\"\ninitial_simplex = [0.1]\nbatch = 2\nmax_evaluations = 50\n"
    );
    // The example of the documentation.
    let page = include_str!("../../../../docs/command-line.md");
    let documented = page.split_once("```toml title=\"tank.toml\"\n").unwrap().1.split_once("```").unwrap().0;
    let controller = include_str!("../../../../docs/design.md");
    let controller =
        controller.split_once("```toml title=\"controller.toml\"\n").unwrap().1.split_once("```").unwrap().0;
    let several = controller.replacen("objective = ", "objective = [\"max(u1)\", ", 1).replacen(
        "\nconstraints",
        "]\nconstraints",
        1,
    );
    for text in [PROBLEM, &written, &uncommented, &whole, documented, controller, &several] {
        let errors = schema.errors(&document(text));
        assert!(errors.is_empty(), "{text}\n{errors:?}");
    }
    folder.write("whole.toml", &whole.replace("initial_states = { x = \"measured\" }\n", ""));
    let ran = folder.run("check whole.toml --no-run");
    assert_ne!(ran.code, 2, "{ran:?}");
}

#[test]
fn schema_accepts_the_spellings_of_the_program() {
    let folder = Folder::with_model("dahlquist");
    let schema = schema(&folder);
    folder.record_decay();
    for more in [
        "[[constraints]]\nexpr = \"k <= 5\"\n[[constraints]]\nexpr = \"0 <= k\"",
        "[[parameters]]\nname = \"x\"\nexpr = \"k / 2 + 0.5\"\nlower = 0",
        "fixed = 0\nlocal = 1",
        "fixed = false\nkind = \"Continuous\"\nscale = \"LOG\"",
        "prior = { log-normal = { median = 2.0, sigma = 0.5 } }",
        "[settings]\nsolver = \"Radau5\"\nkind = \"ME\"\nisolation = \"Process\"\nsandbox = 0",
        "[settings]\nkind = \"Model-Exchange\"\nchattering = \"WARN\"\ninput_derivatives = 1",
        "[fit]\nmethod = \"Nelder-Mead\"\nstop = \"ANY\"\npreflight = 1",
        "[fit]\nmethod = \"nelder_mead\"\ntolerances = \"Absolute\"",
        "[fit]\nobjective = \"Sum_Of-Squares\"\nnoise = \"Stated\"\nloss = \"Soft-L1\"",
    ] {
        let text = PROBLEM.to_owned() + more;
        folder.write("spelt.toml", &text);
        let ran = folder.run("check spelt.toml --no-run");
        let errors = schema.errors(&document(&text));
        assert!(ran.code != 2 && errors.is_empty(), "{more}: {ran:?} {errors:?}");
    }
}

#[test]
fn results_follow_their_schemas() {
    let folder = Folder::with_model("dahlquist");
    folder.record_decay();
    folder.write("problem.toml", PROBLEM);
    folder.write(
        "staged.toml",
        &format!("{PROBLEM}[[stages]]\nparameters = [\"k\"]\nwindows = [[0.0, 1.0]]\n"),
    );
    folder.write("derived.toml", &format!("{PROBLEM}[[parameters]]\nname = \"x\"\nexpr = \"k / 2\"\n"));
    for (of, arguments) in [
        ("info", "info model.fmu --json"),
        ("validate", "validate model.fmu --json"),
        ("check", "check problem.toml --json"),
        ("check", "check problem.toml --preflight --json"),
        ("fit", "fit problem.toml --json -O preflight=true"),
        ("fit", "fit derived.toml --json"),
        ("fit", "fit problem.toml --json -O max_evaluations=3 -O covariance=none"),
        ("fit", "fit staged.toml --json -O method=de-classic -O max_evaluations=20 -O workers=-1 -O rng=1"),
        ("error", "fit none.toml --json"),
    ] {
        let schema = Schema::new(json(&folder.run(&format!("schema --of {of}")).good()));
        let document = json(&folder.run(arguments).out);
        let errors = schema.errors(&document);
        assert!(errors.is_empty(), "{arguments}: {errors:?}\n{document}");
        // The schema is informative: some fields are required.
        let is_needed = |name: &String| {
            let mut less = document.clone();
            less.as_object_mut().unwrap().remove(name);
            !schema.errors(&less).is_empty()
        };
        assert!(document.as_object().unwrap().keys().any(is_needed), "{arguments}");
    }
}

#[test]
fn schema_and_program_reject_the_same_documents() {
    let folder = Folder::with_model("dahlquist");
    let schema = schema(&folder);
    folder.record_decay();
    for (from, to) in [
        ("model = ", "modell = "),
        ("data = ", "date = "),
        ("start = 1.0", "strat = 1.0"),
        ("start = 1.0", "start = \"one\""),
        ("start = 1.0", "expr = 1"),
        ("model = ", "constraints = [1]\nmodel = "),
        ("model = ", "constraints = [{ exp = \"k <= 5\" }]\nmodel = "),
        ("upper = 10", "upper = 10\nscale = \"ln\""),
        ("upper = 10", "upper = 10\nprior = { normal = { mean = 1.0, sigma = 1.0 } }"),
        ("upper = 10", "upper = 10\n[settings]\nsolvr = 1"),
        ("upper = 10", "upper = 10\n[settings]\nsolver = \"rk5\""),
        ("upper = 10", "upper = 10\n[settings]\ntimeout = -1"),
        ("upper = 10", "upper = 10\n[fit]\nmax_tiem = 1"),
        ("upper = 10", "upper = 10\n[fit]\nmax_evaluations = 0"),
        ("upper = 10", "upper = 10\n[fit]\nmethod = \"simplex\""),
        ("upper = 10", "upper = 10\n[fit]\nmethod = \"de\"\ninitial_simplex = [0.1]"),
        ("upper = 10", "upper = 10\n[fit]\nobjective = \"rms\""),
        ("upper = 10", "upper = 10\n[[stages]]\nparametres = [\"k\"]"),
        ("outputs = { x = \"x\" }", "outputs = { x = 1 }"),
        ("outputs = { x = \"x\" }", "outputs = { x = \"x\" }\nweights = { x = -1 }"),
        ("outputs = { x = \"x\" }", "outputs = { x = \"x\" }\nweights = { x = 0 }"),
        ("[[experiments]]\ndata = \"run.csv\"\noutputs = { x = \"x\" }\n", "experiments = []\n"),
        ("[[experiments]]\ndata = \"run.csv\"\noutputs = { x = \"x\" }\n", ""),
        ("start = 1.0\n", ""),
        ("name = \"k\"\n", ""),
        ("[[parameters]]\nname = \"k\"\nstart = 1.0\nlower = 0.1\nupper = 10\n", "[fit]\n"),
        ("upper = 10", "upper = 10\nfixed = 2"),
        ("upper = 10", "upper = 10\nprior = { normal = [1.0, 1.0] }"),
        ("upper = 10", "upper = 10\n[fit]\nmethod = \"DE\"\ninitial_simplex = [0.1]"),
    ] {
        let text = PROBLEM.replacen(from, to, 1);
        assert_ne!(text, PROBLEM, "{from}");
        assert!(!schema.errors(&document(&text)).is_empty(), "the schema takes {to}");
        folder.write("wrong.toml", &text);
        let ran = folder.run("check wrong.toml --no-run");
        assert_eq!(ran.code, 2, "{to}: {ran:?}");
    }
}
