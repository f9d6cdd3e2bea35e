//! Names of the libraries that a library of Windows needs and that are missing. Windows does not report them.

use std::path::Path;

/// Other systems name the missing library in their own message.
#[cfg(not(windows))]
pub(crate) fn missing_libraries(_: &Path) -> Vec<String> {
    Vec::new()
}

/// Returns the libraries that a library needs and that are neither in its folder nor in a folder of the
/// system. Includes the needs of libraries in its folder.
#[cfg(windows)]
pub(crate) fn missing_libraries(library: &Path) -> Vec<String> {
    let own_folder = library.parent().unwrap_or(library);
    let root = std::env::var_os("SystemRoot").map(std::path::PathBuf::from);
    let system = root.iter().flat_map(|root| [root.join("System32"), root.clone()]);
    let on_path = std::env::var_os("PATH").map(|path| std::env::split_paths(&path).collect::<Vec<_>>());
    let folders: Vec<_> = system.chain(on_path.into_iter().flatten()).collect();
    let (mut checked, mut missing) = (Vec::new(), Vec::new());
    let mut pending = vec![library.to_owned()];
    while let Some(library) = pending.pop() {
        for name in needed(&library).unwrap_or_default() {
            // Sets of functions that the loader itself provides.
            let is_virtual = ["api-ms-", "ext-ms-"].iter().any(|prefix| name.starts_with(prefix));
            if is_virtual || checked.contains(&name) {
                continue;
            }
            let own = own_folder.join(&name);
            if own.is_file() {
                pending.push(own);
            } else if !folders.iter().any(|folder| folder.join(&name).is_file()) {
                missing.push(name.clone());
            }
            checked.push(name);
        }
    }
    missing
}

/// Returns the names of the libraries that a library needs, in lower case.
#[cfg(windows)]
fn needed(library: &Path) -> Option<Vec<String>> {
    use object::LittleEndian;
    #[cfg(target_pointer_width = "32")]
    use object::read::pe::PeFile32 as PeFile;
    #[cfg(target_pointer_width = "64")]
    use object::read::pe::PeFile64 as PeFile;
    let bytes = base::files::read_regular(library).ok()?;
    let table = PeFile::parse(&*bytes).ok()?.import_table().ok()??;
    let mut entries = table.descriptors().ok()?;
    let mut names = Vec::new();
    while let Ok(Some(entry)) = entries.next() {
        let name = table.name(entry.name.get(LittleEndian)).ok()?;
        names.push(String::from_utf8_lossy(name).to_ascii_lowercase());
    }
    Some(names)
}
