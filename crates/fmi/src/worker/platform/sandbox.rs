//! The sandbox of worker processes: Landlock confines access to files, and a seccomp filter denies system
//! calls.
//!
//! Both are permanent, and apply to the threads and processes that the confined thread starts. A process is
//! therefore confined before it has a second thread. `SECURITY.md` lists the operations that remain possible.

use crate::error::FmiError;
use landlock::{
    ABI, Access, AccessFs, AccessNet, BitFlags, CompatLevel, Compatible, PathBeneath, PathFd, Ruleset,
    RulesetAttr, RulesetCreated, RulesetCreatedAttr, RulesetError, Scope,
};
use libc::c_long;
use seccompiler::{
    BackendError, BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter,
    SeccompRule, sock_filter,
};
use std::collections::BTreeMap;
use std::error::Error;
use std::io;
use std::path::{Path, PathBuf};

/// Devices that any process may read and write.
const DEVICES: [&str; 3] = ["/dev/null", "/dev/zero", "/dev/full"];

/// Readable paths below `/dev`. Terminals are excluded, because the model must not read the user's input.
const READABLE_DEVICES: [&str; 3] = ["/dev/random", "/dev/urandom", "/dev/shm"];

/// Returns an error if this build or this system has no sandbox for worker processes.
///
/// # Errors
/// Returns [`FmiError::NoSandbox`] with the reason.
pub fn check_sandbox() -> Result<(), FmiError> {
    ruleset().map(drop).map_err(|error| FmiError::NoSandbox {
        reason: format!("the kernel does not support Landlock, which requires Linux 5.13 or newer ({error})"),
    })
}

/// Confines this process, which has one thread. It may then write only below this folder, and the system
/// calls in [`REFUSED`] and [`refused_with`] fail with `EPERM`.
pub(in crate::worker) fn confine_self(folder: &Path) -> io::Result<()> {
    let n_threads = std::fs::read_dir("/proc/self/task")?.count();
    if n_threads != 1 {
        return Err(io::Error::other(format!("sandbox: expected 1 thread, got {n_threads}")));
    }
    let confined = || -> Result<(), Box<dyn Error>> {
        confine_files(folder)?;
        seccompiler::apply_filter(&filter_of_uninspectable())?;
        seccompiler::apply_filter(&filter_of_refused(std::process::id())?)?;
        Ok(())
    };
    confined().map_err(|error| io::Error::other(format!("sandbox: {error}")))
}

/// Returns the rights that are denied unless a rule grants them.
fn ruleset() -> Result<RulesetCreated, RulesetError> {
    let needed = AccessFs::from_write(ABI::V1) | AccessFs::ReadFile | AccessFs::ReadDir;
    Ruleset::default()
        .set_compatibility(CompatLevel::HardRequirement)
        .handle_access(needed)?
        .set_compatibility(CompatLevel::BestEffort)
        .handle_access(AccessFs::from_write(ABI::V9))?
        .handle_access(AccessNet::from_all(ABI::V4))?
        .scope(Scope::from_all(ABI::V6))?
        .create()
}

fn confine_files(folder: &Path) -> Result<(), RulesetError> {
    let read = AccessFs::ReadFile | AccessFs::ReadDir;
    // Device files are excluded, because a privileged user could create one for a disk.
    let special = AccessFs::MakeChar | AccessFs::MakeBlock | AccessFs::MakeSock | AccessFs::IoctlDev;
    let write = read | (AccessFs::from_write(ABI::V3) & !special);
    let mut rules = ruleset()?;
    let mut allow = |path: &Path, access: BitFlags<AccessFs>| -> Result<(), RulesetError> {
        // A path that cannot be opened cannot be read either.
        let Ok(opened) = PathFd::new(path) else { return Ok(()) };
        let access = if path.is_dir() { access } else { access & AccessFs::from_file(ABI::V3) };
        (&mut rules).add_rule(PathBeneath::new(opened, access)).map(drop)
    };
    allow(Path::new("/"), AccessFs::ReadDir.into())?;
    for path in std::fs::read_dir("/").into_iter().flatten().flatten().map(|entry| entry.path()) {
        if path != Path::new("/dev") {
            allow(&path, read)?;
        }
    }
    // If `/` can be listed, only these folders have no rule yet, and a rule for the others would grant access
    // to `/dev`.
    let working = std::env::current_dir().ok();
    let working = working.filter(|working| working != Path::new("/") && !working.starts_with("/dev"));
    for path in READABLE_DEVICES.iter().map(PathBuf::from).chain(working) {
        allow(&path, read)?;
    }
    for path in DEVICES {
        allow(Path::new(path), AccessFs::ReadFile | AccessFs::WriteFile)?;
    }
    allow(folder, write)?;
    rules.restrict_self().map(drop)
}

/// System calls that models do not need.
const REFUSED: &[c_long] = &[
    // Sockets of every family: TCP is also reached by MPTCP and `MSG_FASTOPEN`.
    libc::SYS_socket,
    libc::SYS_socketpair,
    libc::SYS_bind,
    libc::SYS_connect,
    libc::SYS_listen,
    libc::SYS_accept,
    libc::SYS_accept4,
    // Requests to the kernel that bypass filters, including sockets.
    libc::SYS_io_uring_setup,
    libc::SYS_io_uring_enter,
    libc::SYS_io_uring_register,
    // Other processes. `tkill` does not specify the process of the thread.
    libc::SYS_ptrace,
    libc::SYS_process_vm_readv,
    libc::SYS_process_vm_writev,
    libc::SYS_process_madvise,
    libc::SYS_process_mrelease,
    libc::SYS_pidfd_open,
    libc::SYS_pidfd_getfd,
    libc::SYS_pidfd_send_signal,
    libc::SYS_tkill,
    libc::SYS_kcmp,
    libc::SYS_migrate_pages,
    libc::SYS_move_pages,
    libc::SYS_ioprio_set,
    // Memory and messages that processes share by number or name.
    libc::SYS_shmget,
    libc::SYS_shmat,
    libc::SYS_shmctl,
    libc::SYS_semget,
    libc::SYS_semop,
    libc::SYS_semtimedop,
    libc::SYS_semctl,
    libc::SYS_msgget,
    libc::SYS_msgsnd,
    libc::SYS_msgrcv,
    libc::SYS_msgctl,
    libc::SYS_mq_open,
    libc::SYS_mq_unlink,
    libc::SYS_mq_timedsend,
    libc::SYS_mq_timedreceive,
    libc::SYS_mq_notify,
    libc::SYS_mq_getsetattr,
    // Keys.
    libc::SYS_keyctl,
    libc::SYS_add_key,
    libc::SYS_request_key,
    // Changes of files that Landlock does not cover: owner, mode, times, attributes; the length by name
    // before Linux 6.2.
    libc::SYS_fchmod,
    libc::SYS_fchmodat,
    SYS_FCHMODAT2,
    libc::SYS_fchown,
    libc::SYS_fchownat,
    libc::SYS_utimensat,
    libc::SYS_setxattr,
    libc::SYS_lsetxattr,
    libc::SYS_fsetxattr,
    SYS_SETXATTRAT,
    libc::SYS_removexattr,
    libc::SYS_lremovexattr,
    libc::SYS_fremovexattr,
    SYS_REMOVEXATTRAT,
    SYS_FILE_SETATTR,
    libc::SYS_truncate,
    libc::SYS_open_by_handle_at,
    libc::SYS_fanotify_init,
    libc::SYS_fanotify_mark,
    // Namespaces and mounts.
    libc::SYS_setns,
    libc::SYS_unshare,
    libc::SYS_chroot,
    libc::SYS_pivot_root,
    libc::SYS_mount,
    libc::SYS_umount2,
    libc::SYS_mount_setattr,
    libc::SYS_move_mount,
    libc::SYS_open_tree,
    SYS_OPEN_TREE_ATTR,
    libc::SYS_fsopen,
    libc::SYS_fsconfig,
    libc::SYS_fsmount,
    libc::SYS_fspick,
    // Administration of the machine by a privileged user, and common targets of kernel exploits.
    libc::SYS_bpf,
    libc::SYS_perf_event_open,
    libc::SYS_userfaultfd,
    libc::SYS_init_module,
    libc::SYS_finit_module,
    libc::SYS_delete_module,
    libc::SYS_kexec_load,
    SYS_KEXEC_FILE_LOAD,
    libc::SYS_reboot,
    libc::SYS_swapon,
    libc::SYS_swapoff,
    libc::SYS_acct,
    libc::SYS_quotactl,
    libc::SYS_quotactl_fd,
    libc::SYS_syslog,
    libc::SYS_sethostname,
    libc::SYS_setdomainname,
    libc::SYS_settimeofday,
    libc::SYS_clock_settime,
    libc::SYS_clock_adjtime,
    libc::SYS_adjtimex,
    libc::SYS_vhangup,
    libc::SYS_lookup_dcookie,
];

/// Calls of x86-64 that newer architectures do not have.
#[cfg(target_arch = "x86_64")]
const REFUSED_OF_ARCHITECTURE: &[c_long] = &[
    libc::SYS_chmod,
    libc::SYS_chown,
    libc::SYS_lchown,
    libc::SYS_utime,
    libc::SYS_utimes,
    libc::SYS_futimesat,
    libc::SYS_iopl,
    libc::SYS_ioperm,
];
#[cfg(target_arch = "aarch64")]
const REFUSED_OF_ARCHITECTURE: &[c_long] = &[];

/// Numbers that are missing in the bindings of the C library. From 424 on, they are identical on all
/// architectures.
const SYS_FCHMODAT2: c_long = 452;
const SYS_SETXATTRAT: c_long = 463;
const SYS_REMOVEXATTRAT: c_long = 466;
const SYS_OPEN_TREE_ATTR: c_long = 467;
const SYS_FILE_SETATTR: c_long = 469;
#[cfg(target_arch = "x86_64")]
const SYS_KEXEC_FILE_LOAD: c_long = libc::SYS_kexec_file_load;
#[cfg(target_arch = "aarch64")]
const SYS_KEXEC_FILE_LOAD: c_long = 294;

/// Number after the last system call of Linux 6.18.
const FIRST_UNKNOWN: u32 = 470;

/// Commands of `ioctl` that are allowed: sizes, modes and the descriptor itself (linux/fs.h,
/// asm-generic/ioctls.h; the last one is `TCGETS2`). All others can change files, terminals and devices
/// through a descriptor opened for reading.
// The type of these numbers differs among C libraries.
#[allow(clippy::unnecessary_cast)]
const IOCTLS: [u64; 7] = [
    libc::FIOCLEX as u64,
    libc::FIONCLEX as u64,
    libc::FIONBIO as u64,
    libc::FIONREAD as u64,
    libc::TCGETS as u64,
    libc::TIOCGWINSZ as u64,
    0x802c_542a,
];

/// Commands of `fcntl` that are allowed: descriptors, flags, locks, pipes and seals. The others send signals
/// (`F_SETOWN`) or act on the file (`F_SETLEASE`).
const FCNTLS: [i32; 17] = [
    libc::F_DUPFD,
    libc::F_DUPFD_CLOEXEC,
    libc::F_GETFD,
    libc::F_SETFD,
    libc::F_GETFL,
    libc::F_SETFL,
    libc::F_GETLK,
    libc::F_SETLK,
    libc::F_SETLKW,
    libc::F_OFD_GETLK,
    libc::F_OFD_SETLK,
    libc::F_OFD_SETLKW,
    libc::F_GETPIPE_SZ,
    libc::F_SETPIPE_SZ,
    libc::F_GET_SEALS,
    libc::F_ADD_SEALS,
    // F_DUPFD_QUERY
    1027,
];

/// Flags of `clone` that create namespaces.
const NAMESPACES: [i32; 7] = [
    libc::CLONE_NEWNS,
    libc::CLONE_NEWCGROUP,
    libc::CLONE_NEWUTS,
    libc::CLONE_NEWIPC,
    libc::CLONE_NEWUSER,
    libc::CLONE_NEWPID,
    libc::CLONE_NEWNET,
];

/// Returns calls that are denied for certain arguments, with their conditions. One condition is sufficient.
/// Each condition is a list of comparisons that must all hold.
fn refused_with(process_id: u32) -> Vec<(c_long, Vec<Vec<Compared>>)> {
    let other_than = |argument: u8, allowed: &[u64]| -> Vec<Compared> {
        allowed.iter().map(|value| (argument, SeccompCmpOp::Ne, *value)).collect()
    };
    let process_id = u64::from(process_id);
    let (priority_of_process, thread) = (libc::PRIO_PROCESS as u64, [0, process_id]);
    let fcntls = FCNTLS.map(|command| command as u64);
    let truncated = libc::O_TRUNC as u64;
    let mode = libc::O_ACCMODE as u64 | truncated;
    // Landlock treats the file as opened for reading.
    let emptied = |flags: u8| {
        let opened_for = |access: u64| vec![(flags, SeccompCmpOp::MaskedEq(mode), access | truncated)];
        vec![opened_for(libc::O_RDONLY as u64), opened_for(libc::O_ACCMODE as u64)]
    };
    let namespaces = NAMESPACES
        .map(|flag| flag as u32)
        .map(u64::from)
        .map(|flag| vec![(0, SeccompCmpOp::MaskedEq(flag), flag)]);
    let mut refused = vec![
        (libc::SYS_kill, vec![other_than(0, &[process_id])]),
        (libc::SYS_tgkill, vec![other_than(0, &[process_id])]),
        (libc::SYS_rt_sigqueueinfo, vec![other_than(0, &[process_id])]),
        (libc::SYS_rt_tgsigqueueinfo, vec![other_than(0, &[process_id])]),
        (libc::SYS_prlimit64, vec![other_than(0, &thread)]),
        (libc::SYS_sched_setscheduler, vec![other_than(0, &thread)]),
        (libc::SYS_sched_setparam, vec![other_than(0, &thread)]),
        (libc::SYS_sched_setattr, vec![other_than(0, &thread)]),
        (libc::SYS_setpriority, vec![other_than(0, &[priority_of_process]), other_than(1, &thread)]),
        (libc::SYS_ioctl, vec![other_than(1, &IOCTLS)]),
        (libc::SYS_fcntl, vec![other_than(1, &fcntls)]),
        (libc::SYS_openat, emptied(2)),
        (libc::SYS_clone, namespaces.to_vec()),
    ];
    #[cfg(target_arch = "x86_64")]
    refused.push((libc::SYS_open, emptied(1)));
    refused
}

/// Index of an argument, counted from 0, and the value to which it is compared.
type Compared = (u8, SeccompCmpOp, u64);

/// Returns the filter of calls that are denied to this process, which has the process id `process_id`.
fn filter_of_refused(process_id: u32) -> Result<BpfProgram, BackendError> {
    let rule = |compared: Vec<Compared>| {
        let condition = |(argument, comparison, value)| {
            SeccompCondition::new(argument, SeccompCmpArgLen::Dword, comparison, value)
        };
        SeccompRule::new(compared.into_iter().map(condition).collect::<Result<_, _>>()?)
    };
    let always = REFUSED.iter().chain(REFUSED_OF_ARCHITECTURE).map(|call| (*call, Vec::new()));
    let mut rules: BTreeMap<c_long, Vec<SeccompRule>> = always.collect();
    for (call, conditions) in refused_with(process_id) {
        rules.insert(call, conditions.into_iter().map(rule).collect::<Result<_, _>>()?);
    }
    let refuse = SeccompAction::Errno(libc::EPERM as u32);
    SeccompFilter::new(rules, SeccompAction::Allow, refuse, std::env::consts::ARCH.try_into()?)?.try_into()
}

/// Returns the filter of calls that a filter cannot inspect. They fail with `ENOSYS`, so that programs use
/// older calls. These are calls whose arguments are in memory, and all calls that are newer than this list.
/// The comparison also denies 32-bit numbers of x86-64 (x32).
fn filter_of_uninspectable() -> BpfProgram {
    let instruction = |code: u32, jt: u8, jf: u8, k: u32| sock_filter { code: code as u16, jt, jf, k };
    let (load, compare) = (libc::BPF_LD | libc::BPF_W | libc::BPF_ABS, libc::BPF_JMP | libc::BPF_K);
    vec![
        // The number of the call is the first word (linux/seccomp.h, struct seccomp_data).
        instruction(load, 0, 0, 0),
        instruction(compare | libc::BPF_JGE, 3, 0, FIRST_UNKNOWN),
        instruction(compare | libc::BPF_JEQ, 2, 0, libc::SYS_clone3 as u32),
        instruction(compare | libc::BPF_JEQ, 1, 0, libc::SYS_openat2 as u32),
        instruction(libc::BPF_RET | libc::BPF_K, 0, 0, libc::SECCOMP_RET_ALLOW),
        instruction(libc::BPF_RET | libc::BPF_K, 0, 0, libc::SECCOMP_RET_ERRNO | libc::ENOSYS as u32),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sandbox_filters_fit_kernel_limit() {
        // BPF_MAXINSNS of linux/bpf_common.h.
        let n = filter_of_refused(4711).unwrap().len();
        assert!(n < 4096, "{n}");
        assert_eq!(filter_of_uninspectable().len(), 6);
    }

    #[test]
    fn sandbox_lists_contain_no_duplicate_calls() {
        let conditional = refused_with(1).into_iter().map(|(call, _)| call);
        let mut calls: Vec<_> =
            REFUSED.iter().chain(REFUSED_OF_ARCHITECTURE).copied().chain(conditional).collect();
        calls.sort_unstable();
        let n = calls.len();
        calls.dedup();
        assert_eq!(calls.len(), n);
        assert!(calls.iter().all(|call| *call < c_long::from(FIRST_UNKNOWN)));
    }
}
