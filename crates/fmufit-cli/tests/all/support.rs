//! A folder with a model in which the program is run.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use tempfile::TempDir;

/// A temporary folder.
pub(crate) struct Folder(TempDir);

/// Outcome of a command.
#[derive(Debug)]
pub(crate) struct Ran {
    pub(crate) code: i32,
    pub(crate) out: String,
    pub(crate) err: String,
}

impl Ran {
    pub(crate) fn of(output: Output) -> Self {
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        Self { code: output.status.code().unwrap(), out: text(output.stdout), err: text(output.stderr) }
    }

    /// Returns the standard output of a successful command.
    pub(crate) fn good(self) -> String {
        assert_eq!(self.code, 0, "{self:?}");
        self.out
    }

    /// Returns the only line on the standard error stream of a command that rejected its input. A formula with
    /// a mark below its mistake may follow it.
    pub(crate) fn wrong_input(self) -> String {
        assert_eq!((self.code, self.out.as_str()), (2, ""), "{self:?}");
        let message = self.err.strip_prefix("error: ").unwrap_or_else(|| panic!("{self:?}"));
        let lines: Vec<&str> = message.lines().collect();
        let is_marked = lines.len() == 3 && lines[2].trim_start() == "^";
        assert!(lines.len() == 1 || is_marked, "{message}");
        message.trim_end().to_owned()
    }
}

impl Folder {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// Creates a folder with a bundled model as `model.fmu`.
    pub(crate) fn with_model(name: &str) -> Self {
        let folder = Self::new();
        std::fs::copy(example_models::example_fmu(name).unwrap(), folder.path("model.fmu")).unwrap();
        folder
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).unwrap();
    }

    pub(crate) fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap()
    }

    /// Returns the program with arguments, which are separated by spaces, in this folder.
    pub(crate) fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_fmufit"));
        command.args(arguments.split_whitespace()).current_dir(self.0.path());
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    pub(crate) fn run(&self, arguments: &str) -> Ran {
        Ran::of(self.command(arguments).output().unwrap())
    }

    /// Records the decay x' = -2 x from 1 with the model itself, as `run.csv`.
    pub(crate) fn record_decay(&self) {
        self.run("simulate model.fmu --set k=2 --final-time 2 --interval 0.05 --output run.csv").good();
    }
}

/// Parses a JSON document.
pub(crate) fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

/// True if the folder contains only these names.
pub(crate) fn holds_only(folder: &Path, names: &[&str]) -> bool {
    let mut found: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    found.sort();
    found == names
}
