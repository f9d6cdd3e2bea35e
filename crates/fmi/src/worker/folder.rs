//! The folder of a worker process, and the processes that were started with it.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::SystemTime;

/// The folder of a worker, which makes it; it is removed when this is dropped by the process that has started
/// the worker.
#[derive(Debug)]
pub(super) struct Folder {
    path: PathBuf,
    owner: u32,
}

/// Folders that this process has named.
static N_NAMED: AtomicU32 = AtomicU32::new(0);

impl Folder {
    /// Names a folder that is not there yet.
    pub(super) fn named() -> Self {
        let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let (owner, n) = (std::process::id(), N_NAMED.fetch_add(1, Ordering::Relaxed));
        let name = format!("fmufit-worker-{owner}-{n}-{:x}", since.as_nanos());
        let path = std::env::temp_dir().join(name);
        Self { path: std::path::absolute(&path).unwrap_or(path), owner }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        if self.owner == std::process::id() {
            remove(&self.path);
        }
    }
}

/// Makes the folder of this worker, for nobody else, and goes there.
pub(super) fn enter(folder: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::DirBuilderExt;
    std::fs::DirBuilder::new().mode(0o700).create(folder)?;
    std::env::set_current_dir(folder)
}

/// Removes a folder in which something may be made meanwhile.
pub(super) fn remove(folder: &Path) {
    for _ in 0..100 {
        if std::fs::remove_dir_all(folder).is_ok() || !folder.exists() {
            return;
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
}

/// Kills the processes that were started by a worker or by its children. They may have left its group and
/// session; its folder they have in their environment, unless they have hidden that. Looked at are those with
/// numbers above the worker's, or all where the numbers have begun again since.
#[cfg(target_os = "linux")]
pub(super) fn kill_processes_of(worker: u32, folder: &Path) {
    use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};
    use std::io::Read;
    use std::os::unix::ffi::OsStrExt;
    let marker = [super::settings::FOLDER.as_bytes(), b"=", folder.as_os_str().as_bytes()].concat();
    let mut environment = Vec::new();
    let mut is_marked = |pid: i32| {
        environment.clear();
        let file = std::fs::File::open(format!("/proc/{pid}/environ"));
        file.and_then(|mut file| file.read_to_end(&mut environment)).is_ok()
            && environment.split(|byte| *byte == 0).any(|entry| entry == marker)
    };
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let last: Option<u32> = text.split_ascii_whitespace().last().and_then(|last| last.parse().ok());
    let begun_again = last.is_none_or(|last| last < worker);
    let is_later = |pid: &i32| pid.unsigned_abs() > worker || begun_again && pid.unsigned_abs() != worker;
    // Until there are none: they may start others meanwhile.
    for _ in 0..5 {
        let Ok(entries) = std::fs::read_dir("/proc") else { return };
        let pids = entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok());
        let mut n_killed = 0;
        for pid in pids.filter(is_later) {
            if !is_marked(pid) {
                continue;
            }
            let process = Pid::from_raw(pid).and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
            // The number may be that of another process meanwhile.
            if let Some(process) = process.filter(|_| is_marked(pid)) {
                n_killed += usize::from(pidfd_send_signal(process, Signal::KILL).is_ok());
            }
        }
        if n_killed == 0 {
            return;
        }
    }
}

/// Those that have left its group stay where the system does not tell of them.
#[cfg(not(target_os = "linux"))]
pub(super) fn kill_processes_of(_: u32, _: &Path) {}
