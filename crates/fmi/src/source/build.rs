//! The library of a source-code FMU: built from a recipe, or found in the cache. The recipe follows the
//! description or the existing files.

use super::compiler::{Compiler, Patience};
use super::{cache, headers};
use crate::archive::{hash_of_texts, is_inside};
use crate::cancel_request::CancelRequest;
use crate::description::{BUILD_DESCRIPTION, BuildSet, Interface, ModelDescription, build_sets};
use crate::error::{FmiError, Result};
use crate::platform::{BinaryHeader, BuildTarget};
use base::files::read_regular;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Extensions of source files that are not compiled separately.
const HEADERS: &[&str] = &["h", "hpp", "hh", "inc"];

/// Increased when libraries built by earlier versions must no longer be used.
const RECIPE_VERSION: &str = "3";

/// Instructions for building one library.
#[derive(Debug, PartialEq)]
pub(super) struct Recipe {
    model_identifier: String,
    /// Folder in which the compiler runs. All other paths are relative to it, so that the library does not
    /// depend on the location of the unpacked FMU.
    folder: PathBuf,
    /// Options and files, in the order of the command line.
    arguments: Vec<String>,
    /// Contents of a header that is included first.
    plain_names: String,
    target: BuildTarget,
}

impl Recipe {
    /// Determines the files and options to compile.
    pub(super) fn find(
        root: &Path,
        description: &ModelDescription,
        interface: &Interface,
        target: BuildTarget,
    ) -> Result<Recipe> {
        let folder = root.join("sources");
        let sources = Sources { folder: &folder, model_identifier: &interface.model_identifier };
        let set = sources.build_set(description, interface)?;
        let mut arguments: Vec<String> = target.options().iter().map(|&s| s.into()).collect();
        // With this macro, newer headers of the standard do not prefix names with the model identifier.
        arguments.push(format!("-D{}", description.fmi_version.plain_names_macro()));
        arguments.push("-I.".to_owned());
        for include in &set.include_folders {
            arguments.push(format!("-I{}", sources.checked(include, Path::is_dir)?));
        }
        for (name, value) in &set.definitions {
            arguments.push(match value {
                Some(value) => format!("-D{name}={value}"),
                None => format!("-D{name}"),
            });
        }
        for file in &set.files {
            let file = sources.checked(file, Path::is_file)?;
            if !is_header(&file) {
                arguments.push(file);
            }
        }
        let plain_names = plain_names(&interface.model_identifier);
        let model_identifier = interface.model_identifier.clone();
        Ok(Recipe { model_identifier, folder, arguments, plain_names, target })
    }

    /// Returns a key that changes whenever the library may change.
    pub(super) fn key(&self, compiler: &Compiler, content_hash: &str) -> String {
        let identity = compiler.identity();
        let platform = self.target.identity();
        let fixed = [
            RECIPE_VERSION,
            content_hash,
            self.model_identifier.as_str(),
            identity.as_str(),
            platform.as_str(),
        ];
        hash_of_texts(fixed.into_iter().chain(self.arguments.iter().map(String::as_str)))
    }

    /// Compiles and links to `target`.
    pub(super) fn build(&self, compiler: &Compiler, target: &Path, patience: &Patience<'_>) -> Result<()> {
        let header = target.with_file_name("plain_names.h");
        fs::write(&header, &self.plain_names).map_err(FmiError::io("write", &header))?;
        let standard = target.with_file_name("standard");
        headers::write(&standard)?;
        let mut arguments = vec!["-include".to_owned(), header.to_string_lossy().into_owned()];
        arguments.extend_from_slice(&self.arguments);
        // Searched after all other folders, so that headers of the FMU take precedence.
        arguments.extend(["-idirafter".to_owned(), standard.to_string_lossy().into_owned()]);
        arguments.extend(["-o".to_owned(), target.to_string_lossy().into_owned()]);
        arguments.extend(self.target.system_libraries().iter().map(|&library| library.to_owned()));
        compiler.run(&self.model_identifier, &self.folder, &arguments, patience)?;
        fs::remove_dir_all(&standard).map_err(FmiError::io("remove", &standard))?;
        fs::remove_file(&header).map_err(FmiError::io("remove", &header))?;
        match BinaryHeader::read(target).map_err(FmiError::io("read", target))? {
            Some(header) if self.target.can_load(&header) => Ok(()),
            header => Err(FmiError::CompileFailed {
                model_identifier: self.model_identifier.clone(),
                command: compiler.identity(),
                status: "success".to_owned(),
                output: match header {
                    Some(header) => format!("the library is for {header}, not for the requested platform"),
                    None => "the output is not a library".to_owned(),
                },
            }),
        }
    }
}

/// Returns definitions that convert the names in source-code FMUs to the names in libraries.
///
/// In sources, the standard prefixes each name with the model identifier (`Model_fmi2GetReal`), so that
/// several models can be linked into one program. Libraries have no prefix. The headers of FMI 2.0.0 to 2.0.3
/// build the names by token pasting. The result of pasting is expanded as a macro again. The list of names
/// comes from the header of the standard.
fn plain_names(model_identifier: &str) -> String {
    let is_identifier = model_identifier.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if !is_identifier {
        return String::new();
    }
    let functions = headers::FMI2_FUNCTIONS.lines().filter_map(|line| {
        let (name, value) = line.strip_prefix("#define ")?.split_once(' ')?;
        value.trim_start().starts_with("fmi2FullName(").then_some(name)
    });
    functions.map(|name| format!("#define {model_identifier}_{name} {name}\n")).collect()
}

/// Source folder of one interface.
struct Sources<'a> {
    folder: &'a Path,
    model_identifier: &'a str,
}

impl Sources<'_> {
    fn error(&self, reason: String) -> FmiError {
        FmiError::NoSources { model_identifier: self.model_identifier.to_owned(), reason }
    }

    /// Returns the files to compile, from the description or the build description. If neither lists files,
    /// returns every C file.
    fn build_set(&self, description: &ModelDescription, interface: &Interface) -> Result<BuildSet> {
        if !self.folder.is_dir() {
            return Err(self.error("the folder \"sources\" does not exist".to_owned()));
        }
        if !interface.source_files.is_empty() {
            return Ok(BuildSet { files: interface.source_files.clone(), ..BuildSet::default() });
        }
        let list = self.folder.join(BUILD_DESCRIPTION);
        if list.is_file() {
            let bytes = read_regular(&list).map_err(FmiError::io("read", &list))?;
            if let Some(set) = build_sets(&bytes, self.model_identifier)? {
                return Ok(set);
            }
        }
        let files = self.all_c_files()?;
        if files.is_empty() {
            return Err(self.error("the folder \"sources\" contains no C files".to_owned()));
        }
        log::warn!(
            "\"{}\" does not list its source files; compiling all {} C files in \"sources\"",
            description.model_name,
            files.len()
        );
        Ok(BuildSet { files, ..BuildSet::default() })
    }

    fn all_c_files(&self) -> Result<Vec<String>> {
        let mut names = Vec::new();
        for entry in fs::read_dir(self.folder).map_err(FmiError::io("list", self.folder))? {
            let path = entry.map_err(FmiError::io("list", self.folder))?.path();
            let name = path.file_name().and_then(|name| name.to_str());
            if let Some(name) = name.filter(|name| name.ends_with(".c"))
                && path.is_file()
            {
                names.push(name.to_owned());
            }
        }
        names.sort();
        Ok(names)
    }

    /// Converts a path from a file to an argument. The path must be in `sources/`, even after resolving
    /// links, and satisfy `is_right`. The prefix `./` prevents names from being read as options.
    fn checked(&self, name: &str, is_right: fn(&Path) -> bool) -> Result<String> {
        // Windows tools write backslashes here.
        let relative = name.replace('\\', "/");
        let relative = relative.trim_end_matches('/');
        let refuse = |why: &str| self.error(format!("\"{}\" {why}", name.escape_debug()));
        if !is_inside(relative) {
            return Err(refuse("is listed, but is not a path inside \"sources\""));
        }
        let path = self.folder.join(relative);
        if !is_right(&path) {
            return Err(refuse("is listed, but does not exist"));
        }
        let real = path.canonicalize().map_err(FmiError::io("find", &path))?;
        let real_folder = self.folder.canonicalize().map_err(FmiError::io("find", self.folder))?;
        if !real.starts_with(real_folder) {
            return Err(refuse("is a link to a path outside \"sources\""));
        }
        Ok(format!("./{relative}"))
    }
}

fn is_header(name: &str) -> bool {
    Path::new(name)
        .extension()
        .and_then(|ending| ending.to_str())
        .is_some_and(|ending| HEADERS.contains(&ending))
}

/// Default time limit of a compiler.
pub(crate) const COMPILE_TIME: Duration = Duration::from_secs(300);

/// Builds the library of an interface from the sources of an FMU, or finds it in the cache. Uses the system's
/// C compiler (`CC`, otherwise `cc`, `gcc`, `clang`).
///
/// * `root` is the unpacked FMU, and `content_hash` the hash of its content.
/// * The compiled files are those in the description, otherwise those in `sources/buildDescription.xml`,
///   otherwise all `.c` files in `sources/`. Compiler options in an FMU are ignored.
///
/// The library is kept in a cache folder (`FMUFIT_CACHE`, otherwise the system's cache folder of the user),
/// with content, compiler and options as key. The oldest libraries are removed if there are more than 256, or
/// more than 512 MiB in total.
///
/// Headers of FMI 2.0 and 3.0 are provided if the FMU does not contain them. The compiler is killed after
/// five minutes.
///
/// # Errors
/// Returns [`FmiError::NoSources`](crate::FmiError::NoSources),
/// [`FmiError::NoCompiler`](crate::FmiError::NoCompiler) or [`FmiError::Io`](crate::FmiError::Io). Returns
/// [`FmiError::CompileFailed`](crate::FmiError::CompileFailed) with the command, the first error and the last
/// lines of the compiler.
pub fn build_library(
    root: &Path,
    description: &ModelDescription,
    interface: &Interface,
    content_hash: &str,
) -> Result<PathBuf> {
    let patience = Patience { cancel: &CancelRequest::default(), limit: COMPILE_TIME };
    let target = BuildTarget::Native;
    build_unchanged(root, description, interface, content_hash, target, &patience, || Ok(()))
}

/// Builds the library as [`build_library`] does. The compiler is ended when `patience` is exhausted. The
/// library is kept only if `check` succeeds after the compiler has run, because the sources may have changed.
pub(crate) fn build_unchanged(
    root: &Path,
    description: &ModelDescription,
    interface: &Interface,
    content_hash: &str,
    target: BuildTarget,
    patience: &Patience<'_>,
    check: impl FnOnce() -> Result<()>,
) -> Result<PathBuf> {
    let recipe = Recipe::find(root, description, interface, target)?;
    let compiler = Compiler::find(&interface.model_identifier, target, patience)?;
    let key = recipe.key(&compiler, content_hash);
    let file_name = format!("{}.{}", interface.model_identifier, target.extension());
    cache::get_or_make(cache::LIBRARIES, &key, &file_name, |target| {
        recipe.build(&compiler, target, patience)?;
        check()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn description(listed: &[&str]) -> ModelDescription {
        let files: String = listed.iter().map(|name| format!("<File name=\"{name}\"/>")).collect();
        let text = format!(
            "<fmiModelDescription fmiVersion=\"2.0\" modelName=\"m\" guid=\"g\">\
             <ModelExchange modelIdentifier=\"m\"><SourceFiles>{files}</SourceFiles></ModelExchange>\
             </fmiModelDescription>"
        );
        ModelDescription::parse(text.as_bytes()).unwrap()
    }

    fn sources(files: &[&str]) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        fs::create_dir(root.path().join("sources")).unwrap();
        for name in files {
            let path = root.path().join("sources").join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, "").unwrap();
        }
        root
    }

    fn recipe(files: &[&str], listed: &[&str]) -> Result<Recipe> {
        let description = description(listed);
        let root = sources(files);
        Recipe::find(
            root.path(),
            &description,
            description.model_exchange.as_ref().unwrap(),
            BuildTarget::Native,
        )
    }

    fn compiled(files: &[&str], listed: &[&str]) -> Vec<String> {
        let arguments = recipe(files, listed).unwrap().arguments;
        arguments.into_iter().filter(|argument| !argument.starts_with('-')).collect()
    }

    #[test]
    fn recipe_keeps_order_of_listed_files() {
        assert_eq!(compiled(&["a.c", "b.c", "c.h", "x.c"], &["b.c", "c.h", "a.c"]), ["./b.c", "./a.c"]);
        assert_eq!(compiled(&["s/a.c"], &["s\\a.c"]), ["./s/a.c"]);
    }

    #[test]
    fn recipe_contains_all_c_files_when_none_is_listed() {
        assert_eq!(compiled(&["b.c", "a.c", "a.h", "sub/c.c"], &[]), ["./a.c", "./b.c"]);
    }

    #[test]
    fn plain_names_remove_prefix_of_functions() {
        let header = plain_names("Model");
        assert_eq!(header.lines().count(), 44);
        assert!(header.contains("#define Model_fmi2GetReal fmi2GetReal\n"));
        assert_eq!(plain_names("not an identifier"), "");
    }

    #[test]
    fn recipe_follows_build_description() {
        let root = sources(&["a.c", "b.c", "inc/x.h"]);
        fs::write(
            root.path().join("sources/buildDescription.xml"),
            "<fmiBuildDescription><BuildConfiguration modelIdentifier=\"m\"><SourceFileSet><SourceFile name=\"a.c\"/>\
             <PreprocessorDefinition name=\"N\" value=\"2\"/><IncludeDirectory name=\"inc/\"/></SourceFileSet>\
             </BuildConfiguration></fmiBuildDescription>",
        )
        .unwrap();
        let description = description(&[]);
        let found = Recipe::find(
            root.path(),
            &description,
            description.model_exchange.as_ref().unwrap(),
            BuildTarget::Native,
        )
        .unwrap();
        assert!(found.arguments.ends_with(&["-I./inc".into(), "-DN=2".into(), "./a.c".into()]), "{found:?}");
    }

    #[test]
    fn recipe_rejects_paths_outside_sources() {
        for name in ["../a.c", "/etc/passwd", "..\\a.c", "C:\\a.c", "x/../../a.c", ""] {
            let message = recipe(&["a.c"], &[name]).unwrap_err().to_string();
            assert!(message.contains("not a path inside"), "{name}: {message}");
        }
        assert!(recipe(&["a.c"], &["b.c"]).unwrap_err().to_string().contains("does not exist"));
    }

    #[test]
    #[cfg(unix)]
    fn recipe_rejects_links_outside_sources() {
        let root = sources(&[]);
        let outside = tempfile::NamedTempFile::new().unwrap();
        std::os::unix::fs::symlink(outside.path(), root.path().join("sources/a.c")).unwrap();
        let description = description(&["a.c"]);
        let result = Recipe::find(
            root.path(),
            &description,
            description.model_exchange.as_ref().unwrap(),
            BuildTarget::Native,
        );
        assert!(result.unwrap_err().to_string().contains("is a link to a path outside"));
    }

    #[test]
    fn recipe_distinguishes_missing_sources() {
        assert!(recipe(&["a.h"], &[]).unwrap_err().to_string().contains("no C files"));
        let empty = tempfile::tempdir().unwrap();
        let description = description(&[]);
        let result = Recipe::find(
            empty.path(),
            &description,
            description.model_exchange.as_ref().unwrap(),
            BuildTarget::Native,
        );
        assert!(result.unwrap_err().to_string().contains("the folder \"sources\" does not exist"));
    }
}
