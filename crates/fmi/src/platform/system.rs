//! Names that differ between operating systems and processors: those of folders and libraries, machine types
//! of binaries, where caches and private folders live, how a C compiler is called.

use super::binary::Machine;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::{env, io};

/// Extension of shared libraries on this platform, without the dot: `so`, `dll`, `dylib`.
pub const LIBRARY_EXTENSION: &str = env::consts::DLL_EXTENSION;

/// Naming scheme of the folders of `binaries/`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FolderNames {
    /// `linux64` (FMI 1.0 and 2.0).
    SystemAndBits,
    /// `x86_64-linux` (FMI 3.0).
    ProcessorAndSystem,
}

/// Folders of `binaries/` that may hold a library for this platform, the best first.
///
/// FMI 1.0 and 2.0 name them `linux64`, `win64`, `darwin64` and know no processor but x86; FMUs for ARM use
/// FMI 3.0's names, or put an ARM library into the x86 folder, so both are looked at and
/// [`BinaryHeader::runs_here`](super::BinaryHeader::runs_here) decides.
pub fn binary_folders(names: FolderNames) -> Vec<String> {
    let modern = format!("{}-{}", modern_processor(), modern_system());
    let classic = format!("{}{}", classic_system(), usize::BITS);
    let is_x86 = matches!(Machine::host(), Machine::X86 | Machine::X86_64);
    let classic_first = names == FolderNames::SystemAndBits && is_x86;
    if classic_first { vec![classic, modern] } else { vec![modern, classic] }
}

fn modern_processor() -> &'static str {
    env::consts::ARCH
}

fn modern_system() -> &'static str {
    match env::consts::OS {
        "macos" => "darwin",
        other => other,
    }
}

fn classic_system() -> &'static str {
    match env::consts::OS {
        "windows" => "win",
        "macos" => "darwin",
        other => other,
    }
}

/// Folder under which private unpack folders are made.
///
/// Some FMUs cannot live in a path with spaces, braces or letters beyond ASCII, because they paste it into
/// a URI or a format string; then another folder for temporary files is preferred, if there is one.
pub(crate) fn unpack_base() -> PathBuf {
    let usual = env::temp_dir();
    let others = if cfg!(unix) { &["/tmp", "/var/tmp"][..] } else { &[] };
    if is_plain(&usual) {
        return usual;
    }
    others.iter().map(PathBuf::from).find(|path| path.is_dir()).unwrap_or(usual)
}

fn is_plain(path: &Path) -> bool {
    path.to_str()
        .is_some_and(|text| text.chars().all(|c| c.is_ascii_alphanumeric() || "/\\:._-~+,=@".contains(c)))
}

/// Folder for files worth keeping between runs: `FMUFIT_CACHE` if set, else where the system keeps caches
/// of a user. `None` where nothing says who the user is.
pub(crate) fn cache_folder() -> Option<PathBuf> {
    if let Some(folder) = absolute_from("FMUFIT_CACHE") {
        return Some(folder);
    }
    let users = if cfg!(windows) {
        absolute_from("LOCALAPPDATA")
    } else if cfg!(target_vendor = "apple") {
        absolute_from("HOME").map(|home| home.join("Library").join("Caches"))
    } else {
        absolute_from("XDG_CACHE_HOME").or_else(|| absolute_from("HOME").map(|home| home.join(".cache")))
    };
    users.map(|folder| folder.join("fmufit"))
}

/// A folder named by an environment variable; relative ones are ignored, as the XDG specification asks.
fn absolute_from(variable: &str) -> Option<PathBuf> {
    env::var_os(variable).map(PathBuf::from).filter(|path| path.is_absolute())
}

/// Where caches go if they cannot go into [`cache_folder`].
pub(crate) fn fallback_cache_folder() -> PathBuf {
    unpack_base().join("fmufit-cache")
}

/// Creates a folder that only its owner may write into, and refuses one that is there and is not such.
/// Libraries are loaded from it, and folders for temporary files are open to everybody.
pub(crate) fn create_private_folder(path: &Path) -> io::Result<()> {
    let mut builder = fs::DirBuilder::new();
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    match builder.create(path) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let found = fs::symlink_metadata(path)?;
        let own = own_file()?.metadata()?.uid();
        if !found.is_dir() || found.uid() != own || found.mode() & 0o022 != 0 {
            return Err(io::Error::new(io::ErrorKind::PermissionDenied, "others may write into it"));
        }
    }
    Ok(())
}

/// A file of this user, without a name.
pub(crate) fn own_file() -> io::Result<File> {
    tempfile::tempfile()
}

/// Takes the right to write into a folder from the user's group, and refuses a folder that everybody may
/// write into or that belongs to somebody else than `own`, a file of this user: others may have put something
/// there.
pub(crate) fn keep_others_out(folder: &Path, own: &File) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, PermissionsExt};
        let found = folder.metadata()?;
        if found.uid() != own.metadata()?.uid() || found.mode() & 0o002 != 0 {
            return Err(io::Error::new(io::ErrorKind::PermissionDenied, "others may write into it"));
        }
        if found.mode() & 0o020 != 0 {
            fs::set_permissions(folder, fs::Permissions::from_mode(found.mode() & 0o7755))?;
        }
    }
    #[cfg(not(unix))]
    let _ = (folder, own);
    Ok(())
}

/// Names of C compilers to try where `CC` is not set.
pub(crate) const C_COMPILERS: &[&str] = &["cc", "gcc", "clang"];

/// Options that make a C compiler write a shared library. Floating-point arithmetic stays as the standard
/// says: contraction to fused operations would make results depend on the processor. Without assertions, as
/// tools compile the libraries that they deliver: one that does not hold ends the process (seen in the reset
/// function of Dymola's sources).
pub(crate) fn shared_library_options() -> &'static [&'static str] {
    if cfg!(windows) {
        &["-O2", "-DNDEBUG", "-shared", "-ffp-contract=off"]
    } else {
        &["-O2", "-DNDEBUG", "-fPIC", "-shared", "-ffp-contract=off"]
    }
}

/// Lets a command and what it starts be ended together.
pub(crate) fn in_own_group(command: &mut Command) {
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    #[cfg(not(unix))]
    let _ = command;
}

/// Ends a child made by such a command; what it has started as well, where systems have groups of processes.
pub(crate) fn kill_group(child: &mut Child) {
    #[cfg(unix)]
    if let Ok(id) = i32::try_from(child.id())
        && let Some(group) = rustix::process::Pid::from_raw(id)
    {
        let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
    }
    // One that has just ended cannot be killed.
    let _ = child.kill();
}

/// Libraries every model is linked with.
pub(crate) fn system_libraries() -> &'static [&'static str] {
    if cfg!(windows) { &[] } else { &["-lm"] }
}

/// True if a component of an archive's path can be the name of a file here.
pub(crate) fn is_file_name(component: &str) -> bool {
    if !cfg!(windows) {
        return true;
    }
    let stem = component.split('.').next().unwrap_or_default().trim_end().to_ascii_uppercase();
    let numbered = |prefix: &str| {
        stem.strip_prefix(prefix).is_some_and(|rest| rest.len() == 1 && rest.as_bytes()[0].is_ascii_digit())
    };
    let device = matches!(stem.as_str(), "CON" | "PRN" | "AUX" | "NUL") || numbered("COM") || numbered("LPT");
    !device && !component.ends_with(['.', ' ']) && !component.contains(['<', '>', ':', '"', '|', '?', '*'])
}

/// True if a file is marked as executable by its owner.
pub(crate) fn is_executable(metadata: &fs::Metadata) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        metadata.permissions().mode() & 0o100 != 0
    }
    #[cfg(not(unix))]
    {
        let _ = metadata;
        false
    }
}

/// Marks a file as executable by everybody who can read it, where systems have such marks.
pub(crate) fn make_executable(file: &File) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        file.set_permissions(fs::Permissions::from_mode(0o755))?;
    }
    #[cfg(not(unix))]
    let _ = file;
    Ok(())
}

/// A text without the places of private folders of this library, which differ from process to process: paths
/// of files in them begin inside of the FMU.
pub fn without_private_folders(text: &str) -> String {
    let base = unpack_base().join(PRIVATE_PREFIX).display().to_string();
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find(&base) {
        let after = &rest[at + base.len()..];
        let name = after.find(|c: char| !c.is_ascii_alphanumeric()).unwrap_or(after.len());
        let Some(inside) = after[name..].strip_prefix(PRIVATE_INSIDE) else {
            out.push_str(&rest[..at + base.len()]);
            rest = after;
            continue;
        };
        out.push_str(&rest[..at]);
        rest = inside;
    }
    out + rest
}

/// Prefix of the names of private folders.
pub(crate) const PRIVATE_PREFIX: &str = "fmufit-unpacked-";
/// Path between the name of a private folder and its content.
const PRIVATE_INSIDE: &str = "/fmu/";

/// Makes a folder appear at a second place, where systems can do so without ado.
pub(crate) fn link_folder(folder: &Path, link: &Path) -> io::Result<()> {
    #[cfg(unix)]
    std::os::unix::fs::symlink(folder, link)?;
    #[cfg(not(unix))]
    let _ = (folder, link);
    Ok(())
}

/// Reads from a place in a file; where systems can do so, without moving the position of the file.
pub(crate) fn read_at(file: &File, buffer: &mut [u8], position: u64) -> io::Result<usize> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::read_at(file, buffer, position);
    #[cfg(not(unix))]
    {
        use std::io::{Read, Seek};
        let mut file = file;
        file.seek(io::SeekFrom::Start(position))?;
        file.read(buffer)
    }
}

/// Bytes of memory that can be had without pushing others out; `None` where the system does not say.
pub(crate) fn available_memory() -> Option<u64> {
    let text = fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

/// Data that distinguish a file from others, and from its earlier versions.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) struct FileIdentity {
    /// Device and inode, where systems have them.
    place: (u64, u64),
    size: u64,
    /// Seconds and nanoseconds of the last modification of the content and, where known, of the status.
    modified: (i64, i64),
    changed: (i64, i64),
}

/// Where a file lies: device and inode, or the path on systems that have none.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) enum FilePlace {
    Inode(u64, u64),
    Path(PathBuf),
}

impl FileIdentity {
    /// The place of the file that is found at `path`.
    pub(crate) fn place(&self, path: &Path) -> FilePlace {
        match self.place {
            (0, 0) => FilePlace::Path(path.canonicalize().unwrap_or_else(|_| path.to_owned())),
            (device, inode) => FilePlace::Inode(device, inode),
        }
    }

    /// True if the file has not been written since.
    pub(crate) fn same_content(&self, other: &Self) -> bool {
        (self.size, self.modified) == (other.size, other.modified)
    }
}

/// The identity of a file from its metadata; nothing is read.
pub(crate) fn file_identity(metadata: &fs::Metadata) -> FileIdentity {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        FileIdentity {
            place: (metadata.dev(), metadata.ino()),
            size: metadata.size(),
            modified: (metadata.mtime(), metadata.mtime_nsec()),
            changed: (metadata.ctime(), metadata.ctime_nsec()),
        }
    }
    #[cfg(not(unix))]
    {
        let since_epoch = metadata.modified().ok().and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok());
        let modified = since_epoch.map_or((0, 0), |d| (d.as_secs() as i64, i64::from(d.subsec_nanos())));
        FileIdentity { place: (0, 0), size: metadata.len(), modified, changed: (0, 0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_classic_folder_comes_first_on_x86_only() {
        let two = binary_folders(FolderNames::SystemAndBits);
        let three = binary_folders(FolderNames::ProcessorAndSystem);
        assert_eq!(two.len(), 2);
        if Machine::host() == Machine::X86_64 && cfg!(target_os = "linux") {
            assert_eq!(two, ["linux64", "x86_64-linux"]);
            assert_eq!(three, ["x86_64-linux", "linux64"]);
        }
    }

    #[test]
    fn private_folders_are_no_part_of_a_reason() {
        let base = unpack_base();
        let base = base.display();
        let text = format!(
            "cannot open {base}/fmufit-unpacked-Ab12Cd/fmu/resources/a.txt or {base}/fmufit-unpacked-9/x, {base}/fmufit-"
        );
        let wanted = format!("cannot open resources/a.txt or {base}/fmufit-unpacked-9/x, {base}/fmufit-");
        assert_eq!(without_private_folders(&text), wanted);
    }

    #[test]
    fn paths_that_upset_fmus_are_recognised() {
        assert!(is_plain(Path::new("/tmp/a-b_c.d")));
        for bad in ["/tmp/a b", "/tmp/{a}", "/tmp/\u{e4}", "/tmp/a%20b"] {
            assert!(!is_plain(Path::new(bad)), "{bad}");
        }
    }
}
