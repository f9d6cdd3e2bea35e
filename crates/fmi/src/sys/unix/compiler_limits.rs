//! Limits of a compiler process: memory, file size, processor time. The process also ends with the thread
//! that waits for it.

use std::io;
use std::process::Command;
use std::time::Duration;

/// Address space in bytes; more than any C compiler needs for a model.
const MEMORY: u64 = 4 << 30;

/// Maximum size of a written file in bytes.
const FILE_SIZE: u64 = 1 << 30;

/// Limits the resources of a command after it is started. The limits are 4 GiB of address space, files of 1
/// GiB, and slightly more than `time` of processor time. The limits apply to each process that it starts. On
/// Linux, the command is killed when the thread that started it ends, and therefore no later than the end of
/// this process.
pub(crate) fn limit_compiler(command: &mut Command, time: Duration) {
    use std::os::unix::process::CommandExt;
    let seconds = time.as_secs().saturating_add(2);
    let parent = std::process::id();
    let prepare = move || {
        set(libc::RLIMIT_AS, MEMORY)?;
        set(libc::RLIMIT_FSIZE, FILE_SIZE)?;
        set(libc::RLIMIT_CPU, seconds)?;
        end_with(parent)
    };
    // SAFETY: between fork and exec, only functions are called that POSIX lists as async-signal-safe, or that
    // are plain system calls of Linux (setrlimit, prctl, getppid). Nothing is allocated and no lock is taken.
    unsafe { command.pre_exec(prepare) };
}

/// Lowers a limit of the calling process. A lower existing limit is kept.
fn set(resource: Resource, most: u64) -> io::Result<()> {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: the address is the address of a local.
    if unsafe { libc::getrlimit(resource, &raw mut limit) } != 0 {
        return Err(io::Error::last_os_error());
    }
    let most = libc::rlim_t::try_from(most).unwrap_or(libc::RLIM_INFINITY);
    limit.rlim_max = limit.rlim_max.min(most);
    limit.rlim_cur = limit.rlim_cur.min(most);
    // SAFETY: the address is the address of an initialized local.
    match unsafe { libc::setrlimit(resource, &raw const limit) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

#[cfg(target_env = "gnu")]
type Resource = libc::__rlimit_resource_t;
#[cfg(not(target_env = "gnu"))]
type Resource = libc::c_int;

/// Requests that the calling process is killed when the thread that started it ends.
#[cfg(any(target_os = "linux", target_os = "android"))]
fn end_with(parent: u32) -> io::Result<()> {
    // SAFETY: the arguments are numbers.
    if unsafe { libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL as libc::c_ulong, 0, 0, 0) } != 0 {
        return Err(io::Error::last_os_error());
    }
    // The parent may have ended before.
    // SAFETY: returns a number.
    match u32::try_from(unsafe { libc::getppid() }) {
        Ok(now) if now == parent => Ok(()),
        _ => Err(io::ErrorKind::Interrupted.into()),
    }
}

#[cfg(not(any(target_os = "linux", target_os = "android")))]
fn end_with(_: u32) -> io::Result<()> {
    Ok(())
}

#[cfg(test)]
#[cfg(target_os = "linux")]
mod tests {
    use super::*;

    #[test]
    fn limited_command_has_resource_limits() {
        let mut command = Command::new("sh");
        command.args(["-c", "ulimit -v; ulimit -f; ulimit -t"]);
        limit_compiler(&mut command, Duration::from_secs(10));
        let output = command.output().unwrap();
        let reported = String::from_utf8(output.stdout).unwrap();
        // In KiB, in blocks of 512 bytes (dash) or 1 KiB (bash), in s.
        let limits: Vec<u64> = reported.lines().map(|line| line.parse().unwrap()).collect();
        assert_eq!((limits[0], limits[2]), (MEMORY >> 10, 12), "{reported}");
        assert!([FILE_SIZE >> 9, FILE_SIZE >> 10].contains(&limits[1]), "{reported}");
    }

    #[test]
    fn limited_command_ends_with_its_starting_thread() {
        let start = || {
            let mut command = Command::new("sleep");
            command.arg("600");
            limit_compiler(&mut command, Duration::from_secs(10));
            command.spawn().unwrap()
        };
        let mut child = std::thread::spawn(start).join().unwrap();
        use std::os::unix::process::ExitStatusExt;
        assert_eq!(child.wait().unwrap().signal(), Some(libc::SIGKILL));
    }
}
