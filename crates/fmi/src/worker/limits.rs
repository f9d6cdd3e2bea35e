//! Limits of a worker process, and the choice of running an FMU in one.

use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// Where an FMU runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Isolation {
    /// In processes of its own, one per thread that evaluates: this process outlives whatever the FMU does.
    #[default]
    Process,
    /// In this process, one simulation at a time.
    None,
}

impl Isolation {
    /// All of them, by their names.
    pub const NAMES: [(&'static str, Self); 2] = [("process", Self::Process), ("none", Self::None)];

    /// The name by which it is asked for.
    pub fn name(self) -> &'static str {
        match self {
            Self::Process => "process",
            Self::None => "none",
        }
    }
}

impl FromStr for Isolation {
    type Err = crate::error::FmiError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let found = Self::NAMES.iter().find(|(known, _)| known.eq_ignore_ascii_case(name));
        found.map(|(_, isolation)| *isolation).ok_or_else(|| {
            crate::error::FmiError::BadSetting(format!(
                "isolation = \"{name}\"; there are: \"process\", \"none\""
            ))
        })
    }
}

/// Process that is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ask {
    /// Any that is idle and has loaded the same; a new one if there is none.
    Any,
    /// Of these, the one that was asked longest ago.
    LongestIdle,
    /// One that was never asked before.
    Fresh,
    /// One that was never asked before, and is not asked again.
    FreshOnce,
}

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
    /// It may write into its own folder only, and open no connections (Linux, where the kernel can refuse
    /// that).
    pub sandbox: bool,
}

impl Default for WorkerLimits {
    fn default() -> Self {
        Self { memory: memory_of_machine(), growth: GROWTH, calls: None, sandbox: false }
    }
}

/// Bytes of memory that this machine has, where the system tells.
fn memory_of_machine() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes << 10)
}
