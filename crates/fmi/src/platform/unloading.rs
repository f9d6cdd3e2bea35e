//! Decides, from the file and without running any of its code, if a library can be unloaded (System V ABI,
//! chapters 4 and 5; GNU extension `STB_GNU_UNIQUE`).

use object::read::elf::{Dyn, FileHeader, Sym};
use object::{Endianness, FileKind, elf};
use std::path::Path;

/// The parts of the GNU C library, and the run-time library of GCC.
const C_LIBRARIES: [&str; 8] = [
    "libc.so.",
    "libm.so.",
    "libmvec.so.",
    "libpthread.so.",
    "libdl.so.",
    "librt.so.",
    "libgcc_s.so.",
    "ld-linux",
];

/// Functions and variables of the C library after whose use code of the caller may be run, or its memory be
/// read or written, when its instances are gone. What `atexit` registers for a library is run when it is
/// unloaded (Itanium C++ ABI, 3.3.6.3).
#[rustfmt::skip]
const KEEPING: &[&str] = &[
    // Threads.
    "pthread_create", "thrd_create", "clone", "fork", "vfork", "syscall", "timer_create", "mq_notify", "getaddrinfo_a",
    "aio_read", "aio_write", "aio_fsync", "lio_listio", "aio_read64", "aio_write64", "aio_fsync64", "lio_listio64",
    // What is called at the end of a thread, of the process, or before it is forked.
    "pthread_key_create", "tss_create", "pthread_atfork", "__register_atfork", "__cxa_thread_atexit",
    "__cxa_thread_atexit_impl", "on_exit", "at_quick_exit", "__cxa_at_quick_exit",
    // Signals: handlers, and the stack they run on.
    "signal", "__sysv_signal", "bsd_signal", "ssignal", "sigaction", "__sigaction", "sigset", "sigvec", "sigaltstack",
    // Other libraries.
    "dlopen", "dlmopen", "dlsym", "dlvsym", "__libc_dlopen_mode",
    // Callbacks and hooks.
    "register_printf_function", "register_printf_specifier", "register_printf_modifier", "register_printf_type",
    "fopencookie", "__malloc_hook", "__free_hook", "__realloc_hook", "__memalign_hook", "__after_morecore_hook",
    // Addresses of buffers and texts that are not copied.
    "setvbuf", "setbuf", "setbuffer", "open_memstream", "open_wmemstream", "fmemopen", "initstate", "setstate",
    "putenv", "environ", "_environ", "__environ", "openlog",
];

/// True if, once the instances of the library at `path` are gone, nothing of it can be called and nothing of
/// its memory used, and it shares no variables with other libraries of the process: it is linked with the C
/// library alone and imports none of its functions that start threads, keep addresses or load other
/// libraries. False for a file that cannot be read or is in another format.
pub(crate) fn may_be_unloaded(path: &Path) -> bool {
    let Ok(data) = std::fs::read(path) else { return false };
    let found = match FileKind::parse(&*data) {
        Ok(FileKind::Elf64) => read::<elf::FileHeader64<Endianness>>(&data),
        Ok(FileKind::Elf32) => read::<elf::FileHeader32<Endianness>>(&data),
        _ => None,
    };
    found.unwrap_or(false)
}

fn read<Elf: FileHeader<Endian = Endianness>>(data: &[u8]) -> Option<bool> {
    let header = Elf::parse(data).ok()?;
    let endian = header.endian().ok()?;
    let sections = header.sections(endian, data).ok()?;
    let symbols = sections.symbols(endian, data, elf::SHT_DYNSYM).ok()?;
    let mut imports = false;
    for symbol in symbols.iter() {
        let name = symbols.symbol_name(endian, symbol).unwrap_or_default();
        let is_imported = symbol.st_shndx(endian) == elf::SHN_UNDEF;
        let is_kept = is_imported && KEEPING.iter().any(|known| known.as_bytes() == name);
        // One variable of this name for the whole process, whichever library has it: these are never unloaded.
        let is_unique = !is_imported && symbol.st_bind() == elf::STB_GNU_UNIQUE;
        if is_kept || is_unique {
            return Some(false);
        }
        imports |= is_imported && !name.is_empty();
    }
    let mut is_linked = false;
    if let Some((entries, strings)) = sections.dynamic(endian, data).ok()? {
        let strings = sections.strings(endian, data, strings).ok()?;
        for entry in entries {
            let tag: u64 = entry.d_tag(endian).into();
            match u32::try_from(tag) {
                Ok(elf::DT_NEEDED) => {
                    let name = String::from_utf8_lossy(entry.string(endian, strings).ok()?);
                    if !C_LIBRARIES.iter().any(|known| name.starts_with(known)) {
                        return Some(false);
                    }
                    is_linked = true;
                }
                Ok(elf::DT_FLAGS_1) if entry.d_val(endian).into() & u64::from(elf::DF_1_NODELETE) != 0 => {
                    return Some(false);
                }
                _ => {}
            }
        }
    }
    // Where it is linked with nothing, what it imports is found in any library of the process.
    Some(is_linked || !imports)
}

#[cfg(test)]
#[cfg(target_os = "linux")]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn is_unloadable(source: &str, arguments: &[&str]) -> bool {
        let folder = tempfile::tempdir().unwrap();
        let (code, library) = (folder.path().join("a.c"), folder.path().join("a.so"));
        std::fs::write(&code, source).unwrap();
        let mut command = std::process::Command::new("cc");
        command.args(["-shared", "-fPIC", "-o"]).arg(&library).arg(&code).args(arguments);
        assert!(command.status().unwrap().success());
        may_be_unloaded(&library)
    }

    #[test]
    fn what_the_process_may_come_back_to_is_not_unloaded() {
        let plain = "#include <math.h>\ndouble f(double x) { return sin(x); }";
        assert!(is_unloadable(plain, &["-lm"]));
        assert!(!is_unloadable(plain, &["-lm", "-Wl,-z,nodelete"]));
        // `sin` is taken from whoever has it.
        assert!(!is_unloadable(plain, &["-nostdlib"]));
        assert!(!is_unloadable("__asm__(\".type u, %gnu_unique_object\");\nconst int u = 1;", &[]));
        for (header, call) in [
            ("stdio.h", "static char buffer[64]; setvbuf(stdout, buffer, _IOFBF, 64);"),
            ("stdlib.h", "static char text[] = \"A=1\"; putenv(text);"),
            ("stdlib.h", "static char state[64]; initstate(1, state, 64);"),
            ("signal.h", "sigaltstack(0, 0);"),
            ("pthread.h", "pthread_key_t key; pthread_key_create(&key, 0);"),
        ] {
            let source = format!("#define _GNU_SOURCE\n#include <{header}>\nvoid f(void) {{ {call} }}");
            assert!(!is_unloadable(&source, &[]), "{call}");
        }
    }
}
