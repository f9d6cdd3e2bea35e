//! What copies of a library would still share, read from the file without running anything of it (System V ABI, chapters 4
//! and 5; GNU extension `STB_GNU_UNIQUE`).

use object::elf;
use object::read::elf::{Dyn, FileHeader, ProgramHeader, Sym};
use object::{Endianness, FileKind};
use std::path::{Path, PathBuf};

/// What is read from the file of a library.
#[derive(Debug, Default)]
pub(super) struct Linkage {
    /// Why copies of the library would share static variables; `None`: they do not, as far as the file tells.
    pub(super) shared_state: Option<String>,
    /// Nothing of the library can be called, and nothing of its memory be used, once its instances are gone: it is linked with the C
    /// library alone and imports none of its functions that start threads, keep addresses or load other libraries.
    pub(super) may_be_unloaded: bool,
    /// Libraries of the FMU that the loader loads with it.
    pub(super) siblings: Vec<PathBuf>,
}

impl Linkage {
    /// Of the library at `path`, of the FMU unpacked at `root`. What cannot be read is not loaded either, or is in a format without
    /// such things.
    pub(super) fn of(path: &Path, root: &Path) -> Self {
        let Some(symbols) = DynamicSection::of(path) else { return Self::default() };
        let siblings = siblings(path, &symbols, root);
        let unique = symbols.unique.as_ref().filter(|(_, is_written)| *is_written).map(|(name, _)| {
            format!("{name} is one variable for all copies of the library (STB_GNU_UNIQUE)")
        });
        let linked = || {
            let sibling = siblings.first()?.file_name()?.to_string_lossy().into_owned();
            Some(format!(
                "it is linked with {sibling} of the FMU, which all copies of the library would share"
            ))
        };
        let shared_state = unique.or_else(linked);
        Self { may_be_unloaded: symbols.may_be_unloaded(), shared_state, siblings }
    }
}

/// The libraries of the FMU that one of them is linked with, and those that they are linked with.
fn siblings(path: &Path, symbols: &DynamicSection, root: &Path) -> Vec<PathBuf> {
    let mut found = symbols.needed_beside(path, root);
    let mut next = 0;
    while let Some(sibling) = found.get(next).cloned() {
        let further = DynamicSection::of(&sibling).map(|of_it| of_it.needed_beside(&sibling, root));
        for library in further.unwrap_or_default() {
            if !found.contains(&library) && library != path {
                found.push(library);
            }
        }
        next += 1;
    }
    found
}

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

/// Functions and variables of the C library after whose use code of the caller may be run, or its memory be read or written, when its
/// instances are gone. What `atexit` registers for a library is run when it is unloaded (Itanium C++ ABI, 3.3.6.3).
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

fn is_within(place: &Path, root: &Path) -> bool {
    match (place.canonicalize(), root.canonicalize()) {
        (Ok(place), Ok(root)) => place.starts_with(root),
        _ => false,
    }
}

/// What the dynamic section and the symbols of a library say.
#[derive(Debug, Default, PartialEq)]
struct DynamicSection {
    /// Data that the loader makes once per process, by unique binding; whether it can be written.
    unique: Option<(String, bool)>,
    /// Functions and variables that it takes from other libraries.
    imported: Vec<String>,
    /// Libraries that it is linked with.
    needed: Vec<String>,
    /// Where they are looked for.
    search: Vec<String>,
    /// It asks the loader to keep it (`DF_1_NODELETE`).
    is_kept: bool,
}

impl DynamicSection {
    fn of(path: &Path) -> Option<Self> {
        let data = std::fs::read(path).ok()?;
        match FileKind::parse(&*data).ok()? {
            FileKind::Elf64 => read::<elf::FileHeader64<Endianness>>(&data),
            FileKind::Elf32 => read::<elf::FileHeader32<Endianness>>(&data),
            _ => None,
        }
    }

    /// The libraries of the FMU that it is linked with itself.
    fn needed_beside(&self, path: &Path, root: &Path) -> Vec<PathBuf> {
        let Some(folder) = path.parent() else { return Vec::new() };
        let searched = self.search.iter().filter_map(|search| {
            let place = search.strip_prefix("$ORIGIN").or_else(|| search.strip_prefix("${ORIGIN}"))?;
            Some(folder.join(place.trim_start_matches('/')))
        });
        let folders: Vec<PathBuf> = std::iter::once(folder.to_owned())
            .chain(searched.filter(|place| is_within(place, root) || place == folder))
            .collect();
        let find =
            |name: &String| folders.iter().map(|folder| folder.join(name)).find(|library| library.is_file());
        self.needed.iter().filter_map(find).collect()
    }

    fn may_be_unloaded(&self) -> bool {
        let is_c = |name: &String| C_LIBRARIES.iter().any(|known| name.starts_with(known));
        // Where it is linked with nothing, what it imports is found in any library of the process.
        let is_linked = !self.needed.is_empty() || self.imported.is_empty();
        let is_kept = |name: &String| KEEPING.contains(&name.as_str());
        self.unique.is_none()
            && !self.is_kept
            && is_linked
            && self.needed.iter().all(is_c)
            && !self.imported.iter().any(is_kept)
    }
}

fn read<Elf: FileHeader<Endian = Endianness>>(data: &[u8]) -> Option<DynamicSection> {
    let header = Elf::parse(data).ok()?;
    let endian = header.endian().ok()?;
    let segments = header.program_headers(endian, data).ok()?;
    let sections = header.sections(endian, data).ok()?;
    let mut found = DynamicSection::default();
    let is_written = |address: u64| {
        segments.iter().any(|segment| {
            let (start, size) = (segment.p_vaddr(endian).into(), segment.p_memsz(endian).into());
            segment.p_type(endian) == elf::PT_LOAD
                && segment.p_flags(endian) & elf::PF_W != 0
                && address.checked_sub(start).is_some_and(|offset| offset < size)
        })
    };
    if let Ok(symbols) = sections.symbols(endian, data, elf::SHT_DYNSYM) {
        let name = |symbol: &Elf::Sym| {
            let name = symbols.symbol_name(endian, symbol).unwrap_or_default();
            String::from_utf8_lossy(name).into_owned()
        };
        let is_defined = |symbol: &&Elf::Sym| symbol.st_shndx(endian) != elf::SHN_UNDEF;
        let unique =
            symbols.iter().filter(is_defined).filter(|symbol| symbol.st_bind() == elf::STB_GNU_UNIQUE);
        // One that can be written is shared, the others only keep the library loaded.
        found.unique = unique
            .map(|symbol| (symbol, is_written(symbol.st_value(endian).into())))
            .max_by_key(|(_, is_written)| *is_written)
            .map(|(symbol, is_written)| (name(symbol), is_written));
        let imported = symbols.iter().filter(|symbol| !is_defined(symbol));
        found.imported = imported.map(name).filter(|name| !name.is_empty()).collect();
    }
    if let Ok(Some((entries, strings))) = sections.dynamic(endian, data) {
        let strings = sections.strings(endian, data, strings).unwrap_or_default();
        for entry in entries {
            let tag: u64 = entry.d_tag(endian).into();
            let list = match u32::try_from(tag) {
                Ok(elf::DT_NEEDED) => &mut found.needed,
                Ok(elf::DT_RUNPATH | elf::DT_RPATH) => &mut found.search,
                Ok(elf::DT_FLAGS_1) => {
                    found.is_kept |= entry.d_val(endian).into() & u64::from(elf::DF_1_NODELETE) != 0;
                    continue;
                }
                _ => continue,
            };
            let Ok(text) = entry.string(endian, strings) else { continue };
            let text = String::from_utf8_lossy(text);
            list.extend(text.split(':').filter(|part| !part.is_empty()).map(str::to_owned));
        }
    }
    Some(found)
}

#[cfg(test)]
#[cfg(target_os = "linux")]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn linkage(source: &str, arguments: &[&str]) -> Linkage {
        let folder = tempfile::tempdir().unwrap();
        let (code, library) = (folder.path().join("a.c"), folder.path().join("a.so"));
        std::fs::write(&code, source).unwrap();
        let mut command = std::process::Command::new("cc");
        command.args(["-shared", "-fPIC", "-o"]).arg(&library).arg(&code).args(arguments);
        assert!(command.status().unwrap().success());
        Linkage::of(&library, folder.path())
    }

    #[test]
    fn what_the_process_may_come_back_to_is_not_unloaded() {
        let plain = "#include <math.h>\ndouble f(double x) { return sin(x); }";
        assert!(linkage(plain, &["-lm"]).may_be_unloaded);
        assert!(!linkage(plain, &["-lm", "-Wl,-z,nodelete"]).may_be_unloaded);
        // `sin` is taken from whoever has it.
        assert!(!linkage(plain, &["-nostdlib"]).may_be_unloaded);
        assert!(!linkage("__asm__(\".type u, %gnu_unique_object\");\nconst int u = 1;", &[]).may_be_unloaded);
        for (header, call) in [
            ("stdio.h", "static char buffer[64]; setvbuf(stdout, buffer, _IOFBF, 64);"),
            ("stdlib.h", "static char text[] = \"A=1\"; putenv(text);"),
            ("stdlib.h", "static char state[64]; initstate(1, state, 64);"),
            ("signal.h", "sigaltstack(0, 0);"),
            ("pthread.h", "pthread_key_t key; pthread_key_create(&key, 0);"),
        ] {
            let source = format!("#define _GNU_SOURCE\n#include <{header}>\nvoid f(void) {{ {call} }}");
            assert!(!linkage(&source, &[]).may_be_unloaded, "{call}");
        }
    }
}
