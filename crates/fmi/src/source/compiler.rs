//! The system's C compiler: its choice, its version, its limits, and its error messages.

use crate::cancel_request::CancelRequest;
use crate::error::{FmiError, Result};
use crate::platform::{self, BuildTarget};
use crate::sys::limit_compiler;
use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Time limit of the query for the compiler's version.
const ANSWER_TIME: Duration = Duration::from_secs(20);
/// Maximum number of lines kept of a compiler's messages.
const LAST_LINES: usize = 40;
const LAST_BYTES: usize = 8000;
/// Number of bytes of the messages that are searched for the first error.
const SEARCHED_BYTES: u64 = 1 << 20;
/// Time between two checks of a running compiler; long enough to cost nothing compared with the compiler.
const LOOK_EVERY: Duration = Duration::from_millis(5);

/// Conditions that end a running compiler: cancellation and a time limit.
pub(crate) struct Patience<'a> {
    pub(crate) cancel: &'a CancelRequest,
    pub(crate) limit: Duration,
}

impl Patience<'_> {
    /// Waits until the compiler has ended. Kills it and all its child processes on cancellation or timeout.
    fn wait(&self, child: &mut Child) -> io::Result<Result<ExitStatus, Impatience>> {
        let began = Instant::now();
        loop {
            if let Some(status) = child.try_wait()? {
                return Ok(Ok(status));
            }
            let reason = match (self.cancel.is_requested(), began.elapsed() >= self.limit) {
                (true, _) => Impatience::Cancelled,
                (_, true) => Impatience::TimeLimit,
                _ => {
                    std::thread::sleep(LOOK_EVERY);
                    continue;
                }
            };
            platform::kill_group(child);
            child.wait()?;
            return Ok(Err(reason));
        }
    }
}

/// Reason why a compiler was killed.
enum Impatience {
    Cancelled,
    TimeLimit,
}

/// A C compiler that has reported its version.
#[derive(Debug)]
pub(super) struct Compiler {
    program: String,
    /// Arguments that are part of the command, as in `CC="ccache gcc"`.
    arguments: Vec<String>,
    /// First line of the version message.
    version: String,
}

impl Compiler {
    /// Returns the compiler in the [variable](BuildTarget::variable) if it is set, and no other. Otherwise,
    /// returns the first of the usual compilers that reports a version.
    pub(super) fn find(
        model_identifier: &str,
        target: BuildTarget,
        patience: &Patience<'_>,
    ) -> Result<Compiler> {
        let (variable, usual) = (target.variable(), target.compilers());
        let chosen = std::env::var(variable).ok().filter(|name| !name.trim().is_empty());
        let found = match &chosen {
            Some(command) => Compiler::ask(command, patience)?,
            None => {
                let mut answers = usual.iter().map(|command| Compiler::ask(command, patience));
                answers.find_map(Result::transpose).transpose()?
            }
        };
        found.ok_or_else(|| FmiError::NoCompiler {
            model_identifier: model_identifier.to_owned(),
            tried: chosen.map_or(usual.join(", "), |command| format!("{variable}={command}")),
            variable,
        })
    }

    /// Queries the version of a command. Returns `Ok(None)` if the command is not a compiler.
    fn ask(command: &str, patience: &Patience<'_>) -> Result<Option<Compiler>> {
        let Some((program, arguments)) = split(command) else { return Ok(None) };
        let mut question = Command::new(&program);
        question.args(&arguments).arg("--version").env("LC_ALL", "C").stdin(Stdio::null());
        let answer = tempfile::tempfile().and_then(|reported| Ok((reported.try_clone()?, reported)));
        let (out, mut reported) = answer.map_err(FmiError::io("run", &program))?;
        question.stdout(out).stderr(Stdio::null());
        platform::in_process_group(&mut question);
        limit_compiler(&mut question, patience.limit.min(ANSWER_TIME));
        let short = Patience { limit: patience.limit.min(ANSWER_TIME), ..*patience };
        let Ok(mut child) = question.spawn() else { return Ok(None) };
        match short.wait(&mut child) {
            Ok(Ok(status)) if status.success() => {}
            Ok(Err(Impatience::Cancelled)) => return Err(FmiError::Cancelled),
            _ => return Ok(None),
        }
        let mut text = Vec::new();
        let read = reported.rewind().and_then(|()| reported.take(SEARCHED_BYTES).read_to_end(&mut text));
        read.map_err(FmiError::io("read the output of", &program))?;
        let version = String::from_utf8_lossy(&text).lines().next().unwrap_or_default().to_owned();
        Ok(Some(Compiler { program, arguments, version }))
    }

    /// Returns a string that distinguishes the compiler from others.
    pub(super) fn identity(&self) -> String {
        format!("{} {} {}", self.program, self.arguments.join(" "), self.version)
    }

    /// Runs the compiler in a folder. If it fails, the error contains its first error and its last lines.
    pub(super) fn run(
        &self,
        model_identifier: &str,
        folder: &Path,
        arguments: &[impl AsRef<OsStr>],
        patience: &Patience<'_>,
    ) -> Result<()> {
        let mut command = Command::new(&self.program);
        command.args(&self.arguments).args(arguments).current_dir(folder);
        command.env("LC_ALL", "C").stdin(Stdio::null());
        let run = FmiError::io("run", &self.program);
        // The output goes to a file, because a pipe that is not read would block the compiler.
        let reported = tempfile::tempfile()
            .and_then(|reported| Ok((reported.try_clone()?, reported.try_clone()?, reported)));
        let (out, err, mut reported) = match reported {
            Ok(reported) => reported,
            Err(error) => return Err(run(error)),
        };
        command.stdout(out).stderr(err);
        platform::in_process_group(&mut command);
        limit_compiler(&mut command, patience.limit);
        let ended = command.spawn().and_then(|mut child| patience.wait(&mut child));
        let status = match ended.map_err(run)? {
            Ok(status) if status.success() => return Ok(()),
            Ok(status) => status.to_string(),
            Err(Impatience::Cancelled) => return Err(FmiError::Cancelled),
            Err(Impatience::TimeLimit) => format!(
                "stopped after {} s, the time limit OpenOptions::compile_time",
                patience.limit.as_secs_f64()
            ),
        };
        let words = [OsStr::new(&self.program)].into_iter().chain(command.get_args());
        let words: Vec<_> = words.map(OsStr::to_string_lossy).collect();
        Err(FmiError::CompileFailed {
            model_identifier: model_identifier.to_owned(),
            command: words.join(" "),
            status,
            output: messages(&mut reported).map_err(FmiError::io("read the compiler output for", folder))?,
        })
    }
}

/// Returns the first error in the messages of a compiler, and the last lines.
fn messages(reported: &mut File) -> io::Result<String> {
    let mut start = Vec::new();
    reported.rewind()?;
    reported.take(SEARCHED_BYTES).read_to_end(&mut start)?;
    let length = reported.seek(SeekFrom::End(0))?;
    reported.seek(SeekFrom::Start(length.saturating_sub(4 * LAST_BYTES as u64)))?;
    let mut end = Vec::new();
    reported.read_to_end(&mut end)?;
    Ok(shortened(&String::from_utf8_lossy(&start), &String::from_utf8_lossy(&end)))
}

fn shortened(start: &str, end: &str) -> String {
    let end = last_lines(end);
    match start.lines().find(|line| line.contains("error:")) {
        Some(first) if !end.contains(first) => {
            let first: String = first.chars().take(LAST_BYTES).collect();
            format!("{first}\n...\n{end}")
        }
        _ => end,
    }
}

/// Splits a command into program and arguments. A path with spaces is the program if such a file exists.
fn split(command: &str) -> Option<(String, Vec<String>)> {
    let command = command.trim();
    if Path::new(command).is_file() {
        return Some((command.to_owned(), Vec::new()));
    }
    let mut words = command.split_whitespace().map(str::to_owned);
    Some((words.next()?, words.collect()))
}

/// Returns the end of a long text.
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
    fn compiler_command_is_split_unless_it_is_a_file() {
        assert_eq!(split(" ccache gcc -m64 "), Some(("ccache".into(), vec!["gcc".into(), "-m64".into()])));
        assert_eq!(split("  "), None);
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("my cc");
        std::fs::write(&program, "").unwrap();
        let program = program.to_str().unwrap();
        assert_eq!(split(program), Some((program.to_owned(), vec![])));
    }

    #[test]
    fn missing_program_is_not_a_compiler() {
        let (cancel, limit) = (CancelRequest::default(), Duration::from_secs(20));
        let ask =
            |command: &str, limit| Compiler::ask(command, &Patience { cancel: &cancel, limit }).unwrap();
        assert!(ask("no-such-compiler-anywhere", limit).is_none());
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let folder = tempfile::tempdir().unwrap();
            let mute = folder.path().join("mute");
            std::fs::write(&mute, "#!/bin/sh\nsleep 100\n").unwrap();
            std::fs::set_permissions(&mute, std::fs::Permissions::from_mode(0o755)).unwrap();
            let began = Instant::now();
            assert!(ask(mute.to_str().unwrap(), Duration::from_millis(50)).is_none());
            assert!(began.elapsed() < limit);
        }
    }

    #[test]
    fn compiler_messages_keep_first_error() {
        let many: String = (0..100).map(|line| format!("note {line}\n")).collect();
        let text =
            format!("a.c:1: warning: w\na.c:2:1: fatal error: x.h: not there\n{many}a.c:9: error: y\n");
        let kept = shortened(&text, &text);
        assert!(kept.starts_with("a.c:2:1: fatal error: x.h: not there\n...\nnote "), "{kept}");
        assert!(kept.ends_with("a.c:9: error: y"));
        assert_eq!(shortened("a.c:1: error: x\nb\n", "a.c:1: error: x\nb\n"), "a.c:1: error: x\nb");
    }

    #[test]
    fn compiler_messages_keep_end_of_long_text() {
        let many: String = (0..100).map(|line| format!("line {line}\n")).collect();
        let kept = last_lines(&many);
        assert!(kept.starts_with("line 60\n") && kept.ends_with("line 99"));
        assert!(last_lines(&"\u{e4}".repeat(10_000)).len() <= LAST_BYTES);
        assert_eq!(last_lines(""), "");
    }
}
