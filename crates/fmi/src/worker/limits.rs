//! Limits of a worker process, and the functions that set them.

use super::frame::FrameSize;
use serde::{Deserialize, Serialize};
use std::sync::LazyLock;
use std::time::Duration;

/// Memory growth in bytes after which a worker is replaced.
const GROWTH: u64 = 512 << 20;

/// Limits of a worker process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct WorkerLimits {
    /// Maximum memory in bytes. On Linux, allocations beyond the limit fail in the FMU. If memory is not
    /// counted by the system (memory shared with other processes), the worker is killed instead. Default: the
    /// memory of the machine.
    pub memory: Option<u64>,
    /// Memory growth in bytes after the first answer, after which the worker is replaced. Default: 512 MiB.
    pub growth: u64,
    /// Number of answers after which the worker is replaced; default: no limit.
    pub calls: Option<u64>,
    /// True if the worker is confined. It may then write only to its own folder, and open no connections
    /// (Linux; see [`check_sandbox`](super::check_sandbox)).
    pub sandbox: bool,
}

impl Default for WorkerLimits {
    fn default() -> Self {
        Self { memory: *MEMORY_OF_MACHINE, growth: GROWTH, calls: None, sandbox: false }
    }
}

/// Limits of an answer, enforced regardless of what the worker reports.
#[derive(Debug, Clone, Copy)]
pub struct AnswerLimits {
    /// Wall-clock time of a single simulation; default: no limit.
    pub run: Option<Duration>,
    /// Maximum number of simulations for the request.
    pub runs: u32,
    /// Maximum size of the answer.
    pub size: FrameSize,
}

impl WorkerLimits {
    /// Returns the maximum size of any answer. A worker must have the answer in memory before it sends it.
    pub fn answer_size(&self) -> FrameSize {
        let most = self.memory.unwrap_or(FrameSize::ANY.text);
        FrameSize { text: most, numbers: most / size_of::<f64>() as u64 }
    }
}

/// Memory of this machine in bytes, if the system reports it. Read only once, because reading takes as long
/// as a short simulation.
static MEMORY_OF_MACHINE: LazyLock<Option<u64>> = LazyLock::new(|| {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes << 10)
});
