//! The ends of processes of Windows, in words.

/// Exit code of `abort` in the C runtime.
const ABORT: u32 = 3;

/// Describes the exit code of a process. An exception that nothing handles is the exit code (`ntstatus.h`).
pub(super) fn in_words(code: u32) -> String {
    let words = match code {
        0xC000_0005 => "access violation",
        0xC000_001D => "illegal instruction",
        0xC000_0017 => "out of memory",
        0xC000_0094 => "integer division by zero",
        0xC000_00FD => "stack overflow",
        0xC000_0135 => "a DLL was not found",
        0xC000_013A => "Ctrl-C",
        0xC000_0374 => "heap corruption",
        // Stack buffer overrun, with which newer C runtimes abort.
        ABORT | 0xC000_0409 => "abort",
        // The severity of a status is in its two highest bits. E06D7363: Visual C++.
        0xE06D_7363 => "uncaught C++ exception",
        code if code >> 30 == 3 => return format!("exception 0x{code:08X}"),
        code => return format!("the process called exit({})", code.cast_signed()),
    };
    words.to_owned()
}
