//! Help, wrong arguments and completions.

use crate::support::Folder;

const COMMANDS: [&str; 14] = [
    "info",
    "validate",
    "simulate",
    "init",
    "check",
    "fit",
    "optimize",
    "sensitivity",
    "resume",
    "jobs",
    "report",
    "build",
    "schema",
    "completions",
];

#[test]
fn help_contains_examples_and_exit_codes() {
    let folder = Folder::new();
    let all = folder.run("--help").good();
    assert!(all.contains("130  interrupted by Ctrl-C") && all.contains("3    the fit ran"), "{all}");
    for command in COMMANDS {
        assert!(all.contains(&format!("\n  {command} ")), "{all}");
        let help = folder.run(&format!("{command} --help")).good();
        assert!(help.contains("Example") && help.contains(&format!("  fmufit {command} ")), "{help}");
    }
    assert!(!all.contains("worker"), "{all}");
}

#[test]
fn errors_name_wrong_arguments() {
    let folder = Folder::new();
    for (arguments, expected) in [
        ("", "Usage: fmufit"),
        ("fitt", "a similar subcommand exists: 'fit'"),
        ("info", "required arguments were not provided"),
        ("info model.fmu --jsn", "a similar argument exists: '--json'"),
        ("simulate model.fmu --final-time soon", "invalid value 'soon'"),
        ("fit problem.toml --output x=x", "--output cannot be used with a problem file"),
        ("check problem.toml --no-run --preflight", "cannot be used with"),
        ("completions tcsh", "possible values"),
    ] {
        let ran = folder.run(arguments);
        assert!(ran.code == 2 && ran.out.is_empty() && ran.err.contains(expected), "{arguments}: {ran:?}");
    }
    assert!(folder.run("worker").wrong_input().contains("started by other programs only"));
}

#[test]
fn completions_exist_for_each_shell() {
    let folder = Folder::new();
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = folder.run(&format!("completions {shell}")).good();
        assert!(
            script.contains("fmufit") && COMMANDS.iter().all(|command| script.contains(command)),
            "{script}"
        );
    }
}

#[test]
fn closed_output_pipe_is_not_an_error() {
    let folder = Folder::new();
    let mut child = folder.command("completions bash").spawn().unwrap();
    drop(child.stdout.take());
    assert_eq!(child.wait_with_output().unwrap().status.code(), Some(0));
}
