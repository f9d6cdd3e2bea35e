//! Source-code FMUs: compiled with the system's compiler, cached by content, packed reproducibly. A test that
//! needs a separate cache or compiler runs itself again in a process with that environment.

#![allow(clippy::unwrap_used, clippy::panic)]

use fmi::platform::{BinaryHeader, FolderNames, LIBRARY_EXTENSION, binary_folders, find_binary};
use fmi::{Archive, FmiError, ModelDescription, build_library, clear_caches, pack};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

const MODEL: &str = "#include \"model.h\"\nint answer(void) { return ANSWER; }\n";
const HEADER: &str = "#define ANSWER 42\n";

fn description(files: &str) -> String {
    format!(
        "<fmiModelDescription fmiVersion=\"2.0\" modelName=\"m\" guid=\"g\"><ModelExchange modelIdentifier=\"tiny\">\
         <SourceFiles>{files}</SourceFiles></ModelExchange></fmiModelDescription>"
    )
}

/// Returns a folder with a model of two files.
fn source_folder() -> tempfile::TempDir {
    let root = tempfile::tempdir().unwrap();
    fs::write(root.path().join("modelDescription.xml"), description("<File name=\"model.c\"/>")).unwrap();
    for (name, text) in
        [("sources/model.c", MODEL), ("sources/model.h", HEADER), ("resources/table.txt", "1 2 3\n")]
    {
        let path = root.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    root
}

fn build(root: &Path) -> Result<PathBuf, FmiError> {
    let archive = Archive::open(root)?;
    let model = ModelDescription::read(&archive)?;
    build_library(&archive.unpack()?, &model, model.model_exchange.as_ref().unwrap(), archive.content_hash()?)
}

/// Runs the body of a test in a separate process, with a separate cache folder and additional variables.
/// Starts this program again for this one test, which then runs the body.
fn with_environment(test: &str, variables: &[(&str, &str)], body: fn()) {
    const INSIDE: &str = "FMUFIT_TEST_INSIDE";
    if std::env::var_os(INSIDE).is_some() {
        return body();
    }
    let (cache, temporary) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", test, "--nocapture"])
        .env(INSIDE, "1")
        .env("FMUFIT_CACHE", cache.path())
        .env("TMPDIR", temporary.path())
        .env_remove("CC")
        .envs(variables.iter().copied())
        .output()
        .unwrap();
    let reported = String::from_utf8_lossy(&output.stdout);
    let complained = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && reported.contains("1 passed"), "{reported}{complained}");
}

fn cache() -> PathBuf {
    std::env::var_os("FMUFIT_CACHE").unwrap().into()
}

fn kept() -> Vec<PathBuf> {
    fs::read_dir(cache().join("libraries")).unwrap().map(|entry| entry.unwrap().path()).collect()
}

#[test]
fn library_is_built_once_per_content() {
    with_environment("library_is_built_once_per_content", &[], builds_once_per_content);
}

fn builds_once_per_content() {
    let root = source_folder();
    let library = build(root.path()).unwrap();
    assert_eq!(library.file_name().unwrap().to_str().unwrap(), format!("tiny.{LIBRARY_EXTENSION}"));
    assert!(library.starts_with(cache()));
    assert!(BinaryHeader::read(&library).unwrap().unwrap().runs_here());
    let made = library.metadata().unwrap().modified().unwrap();
    assert_eq!(build(root.path()).unwrap(), library);
    let copy = source_folder();
    assert_eq!(build(copy.path()).unwrap(), library); // the same content elsewhere
    assert_eq!(kept().len(), 1);
    assert!(library.metadata().unwrap().modified().unwrap() >= made);
    fs::write(root.path().join("sources/model.h"), "#define ANSWER 43\n").unwrap();
    assert_ne!(build(root.path()).unwrap(), library);
    assert_eq!(kept().len(), 2);
    // Several builds at the same time: all succeed, one result is kept, and no unfinished files remain.
    fs::write(root.path().join("sources/model.h"), "#define ANSWER 44\n").unwrap();
    let paths: Vec<PathBuf> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(|| build(root.path()).unwrap())).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert!(paths.iter().all(|path| *path == paths[0]));
    assert_eq!(kept().len(), 3);
    fs::write(cache().join("mine.txt"), "not of the cache").unwrap();
    let unfinished = cache().join("libraries/.unfinished-by-another-process");
    fs::create_dir(&unfinished).unwrap();
    clear_caches().unwrap();
    assert!(!library.exists() && cache().join("mine.txt").exists() && unfinished.exists());
    assert_eq!(build(root.path()).unwrap(), paths[0]);
}

/// Writes a bundled model as an FMU with sources only.
fn bundled(root: &Path) {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../example-models/models");
    fs::create_dir(root.join("sources")).unwrap();
    fs::copy(models.join("dahlquist/modelDescription.xml"), root.join("modelDescription.xml")).unwrap();
    fs::copy(models.join("dahlquist/model.c"), root.join("sources/model.c")).unwrap();
    for file in fs::read_dir(models.join("frontend")).unwrap() {
        let file = file.unwrap();
        fs::copy(file.path(), root.join("sources").join(file.file_name())).unwrap();
    }
}

#[test]
fn library_is_cached_for_the_sources_it_was_built_from() {
    with_environment("library_is_cached_for_the_sources_it_was_built_from", &[], builds_what_is_there);
}

fn builds_what_is_there() {
    let root = tempfile::tempdir().unwrap();
    bundled(root.path());
    let source = root.path().join("sources/model.c");
    let honest = fs::read_to_string(&source).unwrap();
    let options = fmi::SimulateOptions::new().final_time(1.0);
    let run = |fmu: &fmi::Fmu| *fmu.simulate(&options).unwrap().columns[0].last().unwrap();
    let open = || fmi::Fmu::open(root.path()).unwrap();
    let early = open();
    let other = honest.replace("= -memory->k * memory", "= -2 * memory->k * memory");
    assert_ne!(other, honest);
    fs::write(&source, other).unwrap();
    let edited = run(&early);
    fs::write(&source, honest).unwrap();
    let first = run(&open());
    assert_ne!(first, edited);
    // The second run checks that the cached library was not overwritten.
    assert_eq!(run(&open()), first);
}

#[test]
#[cfg(unix)]
fn open_rejects_links_to_folders() {
    let root = tempfile::tempdir().unwrap();
    let fmu = root.path().join("fmu");
    fs::create_dir(&fmu).unwrap();
    bundled(&fmu);
    fs::rename(fmu.join("sources"), root.path().join("elsewhere")).unwrap();
    std::os::unix::fs::symlink(root.path().join("elsewhere"), fmu.join("sources")).unwrap();
    let error = fmi::Fmu::open(&fmu).unwrap_err();
    assert!(error.to_string().contains("\"sources\" is a link to a folder"), "{error}");
}

#[test]
#[cfg(unix)]
fn library_is_not_kept_in_a_shared_folder_without_a_home() {
    let name = "library_is_not_kept_in_a_shared_folder_without_a_home";
    with_environment(name, &[("FMUFIT_CACHE", ""), ("HOME", ""), ("XDG_CACHE_HOME", "")], || {
        use std::os::unix::fs::PermissionsExt;
        let root = source_folder();
        let library = build(root.path()).unwrap();
        let base = library.ancestors().nth(3).unwrap();
        assert_eq!(base.metadata().unwrap().permissions().mode() & 0o022, 0, "{}", base.display());
        clear_caches().unwrap();
    });
}

/// The headers of FMI 2.0 prefix function names with the model identifier in this way.
const PREFIXED: &str = "\
#define FMI2_FUNCTION_PREFIX tiny_
#define paste(a, b) a ## b
#define paste_values(a, b) paste(a, b)
#define fmi2GetVersion paste_values(FMI2_FUNCTION_PREFIX, fmi2GetVersion)
const char *fmi2GetVersion(void) { return \"2.0\"; }
";

#[test]
fn source_code_prefix_is_removed_from_function_names() {
    with_environment("source_code_prefix_is_removed_from_function_names", &[], loses_the_prefix);
}

fn loses_the_prefix() {
    let root = source_folder();
    fs::write(root.path().join("sources/model.c"), PREFIXED).unwrap();
    let library = build(root.path()).unwrap();
    let bytes = fs::read(&library).unwrap();
    let has = |name: &[u8]| bytes.windows(name.len()).any(|window| window == name);
    assert!(has(b"\0fmi2GetVersion\0") && !has(b"tiny_fmi2GetVersion"));
    assert_eq!(fs::read_dir(library.parent().unwrap()).unwrap().count(), 1);
}

/// An assertion that fails would end the process.
#[test]
fn assertions_in_sources_are_disabled() {
    with_environment("assertions_in_sources_are_disabled", &[], leaves_assertions_out);
}

fn leaves_assertions_out() {
    let root = source_folder();
    let source =
        "#include <assert.h>\n#include \"model.h\"\nint answer(int n) { assert(n > 0); return ANSWER; }\n";
    fs::write(root.path().join("sources/model.c"), source).unwrap();
    let library = fs::read(build(root.path()).unwrap()).unwrap();
    assert!(!library.windows(13).any(|name| name == b"__assert_fail"));
}

#[test]
fn compiler_messages_are_passed_on() {
    with_environment("compiler_messages_are_passed_on", &[], reports_compiler_messages);
}

fn reports_compiler_messages() {
    let root = source_folder();
    fs::write(root.path().join("sources/model.c"), "int answer(void) { return undeclared_name; }\n").unwrap();
    match build(root.path()).unwrap_err() {
        FmiError::CompileFailed { model_identifier, command, output, .. } => {
            assert_eq!(model_identifier, "tiny");
            assert!(command.contains("./model.c") && command.contains("-shared"), "{command}");
            assert!(output.contains("undeclared_name") && output.contains("model.c:1"), "{output}");
        }
        other => panic!("{other}"),
    }
    assert_eq!(kept(), Vec::<PathBuf>::new());
    fs::remove_file(root.path().join("sources/model.c")).unwrap();
    assert!(matches!(build(root.path()), Err(FmiError::NoSources { .. })));
}

#[test]
fn headers_of_the_standard_are_found() {
    with_environment("headers_of_the_standard_are_found", &[], finds_headers);
}

fn finds_headers() {
    for header in ["fmi2Functions.h", "fmi3Functions.h"] {
        let root = source_folder();
        let source = format!("#include \"{header}\"\nint answer(void) {{ return 42; }}\n");
        fs::write(root.path().join("sources/model.c"), source).unwrap();
        let library = build(root.path()).unwrap();
        assert_eq!(fs::read_dir(library.parent().unwrap()).unwrap().count(), 1, "only the library is kept");
        // A header that the FMU contains takes precedence.
        fs::write(root.path().join("sources").join(header), "#error its own\n").unwrap();
        let message = build(root.path()).unwrap_err().to_string();
        assert!(message.contains("its own"), "{message}");
    }
    // The first error is shown, regardless of the length of the output.
    let root = source_folder();
    let notes: String = (0..100).map(|k| format!("#warning \"note {k}\"\n")).collect();
    fs::write(root.path().join("sources/model.c"), format!("#error first\n{notes}")).unwrap();
    let message = build(root.path()).unwrap_err().to_string();
    assert!(message.contains("#error first") && message.contains("note 99"), "{message}");
}

#[test]
#[cfg(unix)]
fn hanging_compiler_is_killed() {
    use std::os::unix::fs::PermissionsExt;
    // A compiler that answers `--version`, and otherwise starts another program and waits for it.
    let folder = tempfile::tempdir().unwrap();
    let compiler = folder.path().join("cc.sh");
    let script = "#!/bin/sh\n[ \"$1\" = --version ] && echo slow && exit 0\nsleep 600 &\necho $! > \"$0.started\"\nwait\n";
    fs::write(&compiler, script).unwrap();
    fs::set_permissions(&compiler, fs::Permissions::from_mode(0o755)).unwrap();
    let variables = [("CC", compiler.to_str().unwrap())];
    with_environment("hanging_compiler_is_killed", &variables, ends_the_compiler);
}

#[cfg_attr(not(unix), expect(dead_code, reason = "ends a shell script"))]
fn ends_the_compiler() {
    let started = PathBuf::from(std::env::var("CC").unwrap() + ".started");
    let root = tempfile::tempdir().unwrap();
    bundled(root.path());
    let run = |seconds: u64, cancel: &fmi::CancelRequest| {
        let compile_time = Duration::from_secs(seconds);
        let options = fmi::OpenOptions { compile_time, ..fmi::OpenOptions::default() };
        let fmu = fmi::Fmu::open_with(root.path(), &options).unwrap();
        let error = fmu.prepare(fmi::InterfaceChoice::Auto, cancel).unwrap_err();
        let ended = Instant::now();
        let child = fs::read_to_string(&started).unwrap();
        let process = PathBuf::from("/proc").join(child.trim()).join("exe");
        // Processes that the compiler started are ended as well. Their parent may need some time to notice.
        let is_gone = (0..200).any(|_| {
            std::thread::sleep(Duration::from_millis(5));
            process.read_link().is_err()
        });
        assert!(is_gone, "{child}");
        (error, ended)
    };
    let message = run(1, &fmi::CancelRequest::default()).0.to_string();
    assert!(
        message.contains("stopped after 1 s") && message.contains("OpenOptions::compile_time"),
        "{message}"
    );
    let flag = Arc::new(AtomicBool::new(false));
    let raised = std::thread::spawn({
        let flag = Arc::clone(&flag);
        move || {
            std::thread::sleep(Duration::from_millis(300));
            flag.store(true, Ordering::Relaxed);
            Instant::now()
        }
    });
    let (error, ended) = run(60, &fmi::CancelRequest::when(flag));
    assert!(matches!(error, FmiError::Cancelled), "{error}");
    let late = ended.saturating_duration_since(raised.join().unwrap());
    assert!(late < Duration::from_secs(5), "{late:?}");
    assert_eq!(kept(), Vec::<PathBuf>::new());
}

#[test]
fn missing_compiler_is_reported_by_name() {
    with_environment(
        "missing_compiler_is_reported_by_name",
        &[("CC", "no-such-compiler -x")],
        names_a_missing_compiler,
    );
}

fn names_a_missing_compiler() {
    let message = build(source_folder().path()).unwrap_err().to_string();
    assert!(message.contains("no C compiler") && message.contains("CC=no-such-compiler -x"), "{message}");
}

#[test]
fn library_is_built_elsewhere_when_the_cache_folder_is_unusable() {
    let blocked = tempfile::NamedTempFile::new().unwrap();
    let temporary = tempfile::tempdir().unwrap();
    let temporary = temporary.path().to_str().unwrap();
    with_environment(
        "library_is_built_elsewhere_when_the_cache_folder_is_unusable",
        &[
            ("FMUFIT_CACHE", blocked.path().to_str().unwrap()),
            ("TMPDIR", temporary),
            ("TMP", temporary),
            ("TEMP", temporary),
        ],
        builds_elsewhere,
    );
}

fn builds_elsewhere() {
    let library = build(source_folder().path()).unwrap();
    assert!(library.starts_with(std::env::temp_dir()) && library.is_file(), "{}", library.display());
}

#[test]
fn folder_is_packed_reproducibly() {
    with_environment("folder_is_packed_reproducibly", &[], packs_reproducibly);
}

fn packs_reproducibly() {
    let root = source_folder();
    let out = tempfile::tempdir().unwrap();
    let (one, two) = (out.path().join("one.fmu"), out.path().join("two.fmu"));
    fs::write(&two, "something older").unwrap();
    pack(root.path(), &one).unwrap();
    clear_caches().unwrap();
    pack(source_folder().path(), &two).unwrap();
    assert_eq!(fs::read(&one).unwrap(), fs::read(&two).unwrap());
    assert_eq!(fs::read_dir(out.path()).unwrap().count(), 2);

    let archive = Archive::open(&one).unwrap();
    assert_eq!(fs::read_to_string(archive.unpack().unwrap().join("sources/model.c")).unwrap(), MODEL);
    assert_eq!(fs::read_to_string(archive.unpack().unwrap().join("resources/table.txt")).unwrap(), "1 2 3\n");
    let found = find_binary(&archive.unpack().unwrap(), "tiny", FolderNames::SystemAndBits).unwrap();
    assert!(found.path.starts_with(
        archive.unpack().unwrap().join("binaries").join(&binary_folders(FolderNames::SystemAndBits)[0])
    ));
    assert_eq!(found.note, None);

    // Packing into the folder itself does not include the previous result.
    let inside = root.path().join("out.fmu");
    pack(root.path(), &inside).unwrap();
    let before = fs::read(&inside).unwrap();
    assert_eq!(before, fs::read(&one).unwrap());
    pack(root.path(), &inside).unwrap();
    // The unpacked folder is removed with the archive.
    let archive = Archive::open(&inside).unwrap();
    let packed = fs::read_dir(archive.unpack().unwrap()).unwrap();
    let names: Vec<_> = packed.map(|entry| entry.unwrap().file_name()).collect();
    assert!(!names.contains(&"out.fmu".into()));
}

#[test]
fn pack_rejects_invalid_folders() {
    let root = tempfile::tempdir().unwrap();
    let out = root.path().join("out.fmu");
    assert!(matches!(pack(root.path(), &out), Err(FmiError::NoModelDescription { .. })));
    fs::write(root.path().join("modelDescription.xml"), "<fmiModelDescription/>").unwrap();
    assert!(matches!(pack(root.path(), &out), Err(FmiError::Description { .. })));
    fs::write(root.path().join("modelDescription.xml"), description("")).unwrap();
    #[cfg(target_os = "linux")]
    {
        fs::write(root.path().join("A.txt"), "").unwrap();
        fs::write(root.path().join("a.txt"), "").unwrap();
        let message = pack(root.path(), &out).unwrap_err().to_string();
        assert!(message.contains("upper and lower case"), "{message}");
        fs::remove_file(root.path().join("A.txt")).unwrap();
    }
    assert!(!out.exists());
    pack(root.path(), &out).unwrap(); // no sources: packed as it is
    assert!(out.is_file());
}
