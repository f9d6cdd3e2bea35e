//! The system's C compiler: which one, which version, and what it says when it fails.

use crate::error::FmiError;
use crate::platform;
use std::ffi::OsStr;
use std::path::Path;
use std::process::{Command, Stdio};

/// What is kept of a compiler's messages.
const LAST_LINES: usize = 40;
const LAST_BYTES: usize = 8000;

/// A C compiler that has answered.
#[derive(Debug)]
pub(super) struct Compiler {
    program: String,
    /// Arguments that come with the name, as in `CC="ccache gcc"`.
    arguments: Vec<String>,
    /// First line of what it says about itself.
    version: String,
}

impl Compiler {
    /// The compiler named by `CC`, and no other if that is set; else the first of the usual names that answers.
    pub(super) fn find(model_identifier: &str) -> Result<Compiler, FmiError> {
        let chosen = std::env::var("CC").ok().filter(|name| !name.trim().is_empty());
        let found = match &chosen {
            Some(command) => Compiler::ask(command),
            None => platform::C_COMPILERS.iter().find_map(|command| Compiler::ask(command)),
        };
        found.ok_or_else(|| FmiError::NoCompiler {
            model_identifier: model_identifier.to_owned(),
            tried: chosen.map_or(platform::C_COMPILERS.join(", "), |command| format!("CC={command}")),
        })
    }

    fn ask(command: &str) -> Option<Compiler> {
        let (program, arguments) = split(command)?;
        let output = Command::new(&program)
            .args(&arguments)
            .arg("--version")
            .env("LC_ALL", "C")
            .stdin(Stdio::null())
            .output()
            .ok()
            .filter(|output| output.status.success())?;
        let version = String::from_utf8_lossy(&output.stdout).lines().next().unwrap_or_default().to_owned();
        Some(Compiler { program, arguments, version })
    }

    /// What distinguishes it from other compilers.
    pub(super) fn identity(&self) -> String {
        format!("{} {} {}", self.program, self.arguments.join(" "), self.version)
    }

    /// Runs it in a folder; fails with its last lines unless it succeeds.
    pub(super) fn run(
        &self,
        model_identifier: &str,
        folder: &Path,
        arguments: &[impl AsRef<OsStr>],
    ) -> Result<(), FmiError> {
        let mut command = Command::new(&self.program);
        command.args(&self.arguments).args(arguments).current_dir(folder);
        command.env("LC_ALL", "C").stdin(Stdio::null());
        let output = command.output().map_err(FmiError::io("run", &self.program))?;
        if output.status.success() {
            return Ok(());
        }
        let words = [OsStr::new(&self.program)].into_iter().chain(command.get_args());
        let words: Vec<_> = words.map(OsStr::to_string_lossy).collect();
        let mut messages = output.stderr;
        messages.extend(output.stdout);
        Err(FmiError::CompileFailed {
            model_identifier: model_identifier.to_owned(),
            command: words.join(" "),
            status: output.status.to_string(),
            output: last_lines(&String::from_utf8_lossy(&messages)),
        })
    }
}

/// A command as program and arguments. A path with spaces in it is a program if there is such a file.
fn split(command: &str) -> Option<(String, Vec<String>)> {
    let command = command.trim();
    if Path::new(command).is_file() {
        return Some((command.to_owned(), Vec::new()));
    }
    let mut words = command.split_whitespace().map(str::to_owned);
    Some((words.next()?, words.collect()))
}

/// The end of a long text.
fn last_lines(text: &str) -> String {
    let lines: Vec<&str> = text.lines().collect();
    let tail = lines[lines.len().saturating_sub(LAST_LINES)..].join("\n");
    let start = tail.len().saturating_sub(LAST_BYTES);
    let start = (start..=tail.len()).find(|&at| tail.is_char_boundary(at)).unwrap_or(tail.len());
    tail[start..].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_split_at_spaces_unless_they_are_files() {
        assert_eq!(split(" ccache gcc -m64 "), Some(("ccache".into(), vec!["gcc".into(), "-m64".into()])));
        assert_eq!(split("  "), None);
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("my cc");
        std::fs::write(&program, "").unwrap();
        let program = program.to_str().unwrap();
        assert_eq!(split(program), Some((program.to_owned(), vec![])));
    }

    #[test]
    fn a_program_that_does_not_exist_is_no_compiler() {
        assert!(Compiler::ask("no-such-compiler-anywhere").is_none());
    }

    #[test]
    fn only_the_end_of_long_messages_is_kept() {
        let many: String = (0..100).map(|line| format!("line {line}\n")).collect();
        let kept = last_lines(&many);
        assert!(kept.starts_with("line 60\n") && kept.ends_with("line 99"));
        assert!(last_lines(&"\u{e4}".repeat(10_000)).len() <= LAST_BYTES);
        assert_eq!(last_lines(""), "");
    }
}
