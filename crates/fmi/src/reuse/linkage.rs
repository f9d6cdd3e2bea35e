//! What copies of a library would still share, read from the file without running anything of it (System V ABI, chapters 4
//! and 5; GNU extension `STB_GNU_UNIQUE`).

use object::elf;
use object::read::elf::{Dyn, FileHeader, ProgramHeader, Sym};
use object::{Endianness, FileKind};
use std::path::{Path, PathBuf};

/// Why copies of the library at `path`, of the FMU unpacked at `root`, would share static variables; `None`: they do not, as far
/// as the file tells.
pub(super) fn shared_state(path: &Path, root: &Path) -> Option<String> {
    // What cannot be read is not loaded either, or is in a format without such things.
    let data = std::fs::read(path).ok()?;
    let linkage = match FileKind::parse(&*data).ok()? {
        FileKind::Elf64 => read::<elf::FileHeader64<Endianness>>(&data),
        FileKind::Elf32 => read::<elf::FileHeader32<Endianness>>(&data),
        _ => return None,
    }?;
    if let Some(symbol) = linkage.unique {
        return Some(format!("{symbol} is one variable for all copies of the library (STB_GNU_UNIQUE)"));
    }
    let folder = path.parent()?;
    let searched = std::iter::once(folder.to_owned()).chain(linkage.search.iter().filter_map(|search| {
        let place = search.strip_prefix("$ORIGIN").or_else(|| search.strip_prefix("${ORIGIN}"))?;
        Some(folder.join(place.trim_start_matches('/')))
    }));
    let folders: Vec<PathBuf> = searched.filter(|place| is_within(place, root) || place == folder).collect();
    let sibling =
        linkage.needed.iter().find(|name| folders.iter().any(|folder| folder.join(name).is_file()))?;
    Some(format!("it is linked with {sibling} of the FMU, which all copies of the library would share"))
}

/// Whether nothing of the library at `path` can be called once its instances are gone: it is linked with the C library alone and
/// imports none of its functions that start threads, register functions or load other libraries.
pub(super) fn may_be_unloaded(path: &Path) -> bool {
    let Ok(data) = std::fs::read(path) else { return false };
    let linkage = match FileKind::parse(&*data) {
        Ok(FileKind::Elf64) => read::<elf::FileHeader64<Endianness>>(&data),
        Ok(FileKind::Elf32) => read::<elf::FileHeader32<Endianness>>(&data),
        _ => None,
    };
    let is_c = |name: &String| C_LIBRARIES.iter().any(|known| name.starts_with(known));
    let is_kept = |name: &String| KEEPING.contains(&name.as_str());
    linkage.is_some_and(|linkage| {
        linkage.unique.is_none() && linkage.needed.iter().all(is_c) && !linkage.imported.iter().any(is_kept)
    })
}

/// The parts of the GNU C library, and the run-time library of GCC.
const C_LIBRARIES: [&str; 7] =
    ["libc.so.", "libm.so.", "libpthread.so.", "libdl.so.", "librt.so.", "libgcc_s.so.", "ld-linux"];

/// Functions of the C library after which code of the caller may be run, or be needed, when its instances are gone. What
/// `atexit` registers for a library is run when it is unloaded (Itanium C++ ABI, 3.3.6.3).
const KEEPING: [&str; 30] = [
    "pthread_create",
    "pthread_key_create",
    "pthread_atfork",
    "__register_atfork",
    "thrd_create",
    "tss_create",
    "__cxa_thread_atexit",
    "__cxa_thread_atexit_impl",
    "on_exit",
    "at_quick_exit",
    "__cxa_at_quick_exit",
    "clone",
    "fork",
    "vfork",
    "syscall",
    "timer_create",
    "mq_notify",
    "aio_read",
    "aio_write",
    "lio_listio",
    "getaddrinfo_a",
    "signal",
    "__sysv_signal",
    "bsd_signal",
    "sigaction",
    "sigset",
    "dlopen",
    "dlmopen",
    "dlsym",
    "dlvsym",
];

fn is_within(place: &Path, root: &Path) -> bool {
    match (place.canonicalize(), root.canonicalize()) {
        (Ok(place), Ok(root)) => place.starts_with(root),
        _ => false,
    }
}

/// What the dynamic section and the symbols of a library say.
#[derive(Debug, Default, PartialEq)]
struct Linkage {
    /// A variable that the loader makes once per process: writable data with unique binding.
    unique: Option<String>,
    /// Functions and variables that it takes from other libraries.
    imported: Vec<String>,
    /// Libraries that it is linked with.
    needed: Vec<String>,
    /// Where they are looked for.
    search: Vec<String>,
}

fn read<Elf: FileHeader<Endian = Endianness>>(data: &[u8]) -> Option<Linkage> {
    let header = Elf::parse(data).ok()?;
    let endian = header.endian().ok()?;
    let segments = header.program_headers(endian, data).ok()?;
    let sections = header.sections(endian, data).ok()?;
    let mut linkage = Linkage::default();
    let is_written = |address: u64| {
        segments.iter().any(|segment| {
            let (start, size) = (segment.p_vaddr(endian).into(), segment.p_memsz(endian).into());
            segment.p_type(endian) == elf::PT_LOAD
                && segment.p_flags(endian) & elf::PF_W != 0
                && address.checked_sub(start).is_some_and(|offset| offset < size)
        })
    };
    if let Ok(symbols) = sections.symbols(endian, data, elf::SHT_DYNSYM) {
        let unique = symbols.iter().find(|symbol| {
            symbol.st_bind() == elf::STB_GNU_UNIQUE
                && symbol.st_shndx(endian) != elf::SHN_UNDEF
                && is_written(symbol.st_value(endian).into())
        });
        let name = |symbol: &Elf::Sym| {
            let name = symbols.symbol_name(endian, symbol).unwrap_or_default();
            String::from_utf8_lossy(name).into_owned()
        };
        linkage.unique = unique.map(name);
        let imported = symbols.iter().filter(|symbol| symbol.st_shndx(endian) == elf::SHN_UNDEF);
        linkage.imported = imported.map(name).collect();
    }
    if let Ok(Some((entries, strings))) = sections.dynamic(endian, data) {
        let strings = sections.strings(endian, data, strings).unwrap_or_default();
        for entry in entries {
            let tag: u64 = entry.d_tag(endian).into();
            let list = match u32::try_from(tag) {
                Ok(elf::DT_NEEDED) => &mut linkage.needed,
                Ok(elf::DT_RUNPATH | elf::DT_RPATH) => &mut linkage.search,
                _ => continue,
            };
            let Ok(text) = entry.string(endian, strings) else { continue };
            let text = String::from_utf8_lossy(text);
            list.extend(text.split(':').filter(|part| !part.is_empty()).map(str::to_owned));
        }
    }
    Some(linkage)
}
