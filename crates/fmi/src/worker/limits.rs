//! Limits of a worker process, and how it sets them for itself.

use super::frame::FrameSize;
use serde::{Deserialize, Serialize};
use std::sync::LazyLock;
use std::time::Duration;

/// Memory that a worker may gain before it is replaced, in bytes.
const GROWTH: u64 = 512 << 20;

/// Limits of a worker process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct WorkerLimits {
    /// Bytes of memory that it may have. On Linux what goes beyond fails in the FMU, and where the system
    /// does not count it (what is shared with other processes), the worker is ended. Default: the memory of
    /// the machine.
    pub memory: Option<u64>,
    /// Bytes of memory that it may gain after its first answer, before it is replaced. Default: 512 MiB.
    pub growth: u64,
    /// Answers after which it is replaced; default: no limit.
    pub calls: Option<u64>,
    /// It is confined: it may write into its own folder only, and open no connections (Linux; see
    /// [`check_sandbox`](super::check_sandbox)).
    pub sandbox: bool,
}

impl Default for WorkerLimits {
    fn default() -> Self {
        Self { memory: *MEMORY_OF_MACHINE, growth: GROWTH, calls: None, sandbox: false }
    }
}

/// Limits of an answer, which hold whatever the worker says.
#[derive(Debug, Clone, Copy)]
pub struct AnswerLimits {
    /// Wall-clock time of a single simulation; default: no limit.
    pub run: Option<Duration>,
    /// Simulations that the question can have.
    pub runs: u32,
    /// Its size.
    pub size: FrameSize,
}

impl WorkerLimits {
    /// Size of any answer: a worker has it in its memory before it sends it.
    pub fn answer_size(&self) -> FrameSize {
        let most = self.memory.unwrap_or(FrameSize::ANY.text);
        FrameSize { text: most, numbers: most / size_of::<f64>() as u64 }
    }
}

/// Bytes of memory that this machine has, where the system tells. Read once: that takes as long as a short
/// simulation.
static MEMORY_OF_MACHINE: LazyLock<Option<u64>> = LazyLock::new(|| {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes << 10)
});

/// Limits the memory of this process, and lets it write no core files.
#[cfg(unix)]
pub(super) fn limit_self(limits: &WorkerLimits) -> std::io::Result<()> {
    let lower = |resource: rustix::process::Resource, most: u64| {
        let maximum = rustix::process::getrlimit(resource).maximum;
        let most = Some(maximum.map_or(most, |maximum| maximum.min(most)));
        rustix::process::setrlimit(resource, rustix::process::Rlimit { current: most, maximum: most })
    };
    lower(rustix::process::Resource::Core, 0)?;
    if let Some(memory) = limits.memory {
        lower(rustix::process::Resource::Data, memory)?;
    }
    Ok(())
}
