//! Limits of a compiler that is started: memory, files, time of the processor, and an end with the thread
//! that waits for it.

#[cfg(unix)]
use std::io;
use std::process::Command;
use std::time::Duration;

/// Address space in bytes, more than any C compiler needs for a model.
const MEMORY: u64 = 4 << 30;

/// The largest file that may be written, in bytes.
const FILE_SIZE: u64 = 1 << 30;

/// Limits what a command may take once it is started: 4 GiB of address space, files of 1 GiB, and a little
/// more than `time` of a processor, each for every process that it starts. On Linux it is killed when the
/// thread ends that has started it, and with that at the latest when this process does.
#[cfg(unix)]
pub(crate) fn limit(command: &mut Command, time: Duration) {
    use std::os::unix::process::CommandExt;
    let seconds = time.as_secs().saturating_add(2);
    let parent = std::process::id();
    let prepare = move || {
        set(libc::RLIMIT_AS, MEMORY)?;
        set(libc::RLIMIT_FSIZE, FILE_SIZE)?;
        set(libc::RLIMIT_CPU, seconds)?;
        end_with(parent)
    };
    // SAFETY: between fork and exec only calls are made that POSIX lists as safe in signal handlers, or that are plain system calls of
    // Linux (setrlimit, prctl, getppid); nothing is allocated and no lock is taken.
    unsafe { command.pre_exec(prepare) };
}

/// Not limited where there are no such limits.
#[cfg(not(unix))]
pub(crate) fn limit(_: &mut Command, _: Duration) {}

/// Lowers a limit of the calling process; one that is lower stays.
#[cfg(unix)]
fn set(resource: Resource, most: u64) -> io::Result<()> {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: the address is that of a local.
    if unsafe { libc::getrlimit(resource, &raw mut limit) } != 0 {
        return Err(io::Error::last_os_error());
    }
    let most = libc::rlim_t::try_from(most).unwrap_or(libc::RLIM_INFINITY);
    limit.rlim_max = limit.rlim_max.min(most);
    limit.rlim_cur = limit.rlim_cur.min(most);
    // SAFETY: the address is that of a local, which was filled in.
    match unsafe { libc::setrlimit(resource, &raw const limit) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

#[cfg(all(unix, target_env = "gnu"))]
type Resource = libc::__rlimit_resource_t;
#[cfg(all(unix, not(target_env = "gnu")))]
type Resource = libc::c_int;

/// Lets the calling process be killed with the thread that has started it.
#[cfg(any(target_os = "linux", target_os = "android"))]
fn end_with(parent: u32) -> io::Result<()> {
    // SAFETY: numbers only.
    if unsafe { libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL as libc::c_ulong, 0, 0, 0) } != 0 {
        return Err(io::Error::last_os_error());
    }
    // It may have ended before.
    // SAFETY: asks for a number.
    match u32::try_from(unsafe { libc::getppid() }) {
        Ok(now) if now == parent => Ok(()),
        _ => Err(io::ErrorKind::Interrupted.into()),
    }
}

#[cfg(all(unix, not(any(target_os = "linux", target_os = "android"))))]
fn end_with(_: u32) -> io::Result<()> {
    Ok(())
}

#[cfg(test)]
#[cfg(target_os = "linux")]
mod tests {
    use super::*;

    #[test]
    fn a_program_has_its_limits() {
        let mut command = Command::new("sh");
        command.args(["-c", "ulimit -v; ulimit -f; ulimit -t"]);
        limit(&mut command, Duration::from_secs(10));
        let output = command.output().unwrap();
        let said = String::from_utf8(output.stdout).unwrap();
        // In KiB, in blocks of 512 bytes (dash) or 1 KiB (bash), in s.
        let limits: Vec<u64> = said.lines().map(|line| line.parse().unwrap()).collect();
        assert_eq!((limits[0], limits[2]), (MEMORY >> 10, 12), "{said}");
        assert!([FILE_SIZE >> 9, FILE_SIZE >> 10].contains(&limits[1]), "{said}");
    }

    #[test]
    fn a_program_ends_with_the_thread_that_has_started_it() {
        let start = || {
            let mut command = Command::new("sleep");
            command.arg("600");
            limit(&mut command, Duration::from_secs(10));
            command.spawn().unwrap()
        };
        let mut child = std::thread::spawn(start).join().unwrap();
        use std::os::unix::process::ExitStatusExt;
        assert_eq!(child.wait().unwrap().signal(), Some(libc::SIGKILL));
    }
}
