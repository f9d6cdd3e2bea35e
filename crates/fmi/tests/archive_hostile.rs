//! Archives that are damaged, inconsistent or too large are rejected with an error that contains the entry
//! and numbers. No files remain.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod promises;
mod zip_bytes;

use fmi::description::QuirkKind;
use fmi::{Archive, ArchiveLimits, CancelRequest, EntryProblem, FmiError, Fmu};
use proptest::prelude::*;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use zip_bytes::{Entry, description, zip};

/// A file that is removed at the end of the test.
fn file(bytes: &[u8]) -> tempfile::NamedTempFile {
    let file = tempfile::Builder::new().prefix("test-").suffix(".fmu").tempfile().unwrap();
    fs::write(file.path(), bytes).unwrap();
    file
}

/// Opens an archive and unpacks all its files.
fn open(bytes: &[u8]) -> Result<Archive, FmiError> {
    open_with(bytes, &ArchiveLimits::default())
}

fn open_with(bytes: &[u8], limits: &ArchiveLimits) -> Result<Archive, FmiError> {
    let archive = Archive::open_with(file(bytes).path(), limits, &CancelRequest::default())?;
    archive.unpack()?;
    Ok(archive)
}

/// Returns the problem with the last entry of an archive that is otherwise valid.
fn problem_of(entries: &[Entry]) -> EntryProblem {
    let mut all = vec![description()];
    all.extend_from_slice(entries);
    let error = open(&zip(&all)).expect_err("must be refused");
    let message = error.to_string();
    match error {
        FmiError::BadEntry { entry, problem, .. } => {
            assert!(message.contains(&entry.escape_debug().to_string()), "{message}");
            problem
        }
        other => panic!("{other}"),
    }
}

fn problem_of_name(name: &str) -> EntryProblem {
    problem_of(&[Entry::stored(name, b"x")])
}

#[test]
fn archive_is_unpacked_and_folder_removed_on_drop() {
    let archive = open(&zip(&[
        description(),
        Entry::stored("resources/", b"").with(|entry| entry.mode = 0o040_755),
        Entry::stored("resources/a.txt", b"stored"),
        Entry::deflated("resources/deep/er/b.txt", &b"deflated ".repeat(10_000)),
        Entry::stored("resources/run.sh", b"").with(|entry| entry.mode = 0o100_755),
        Entry::stored("documentation/\u{e4} b.html", b"").with(|entry| entry.mode = 0),
    ]))
    .unwrap();
    let root = archive.unpack().unwrap();
    assert!(root.is_absolute() && archive.is_private());
    let folder_name = root.strip_prefix(std::env::temp_dir()).unwrap();
    assert!(folder_name.to_str().unwrap().starts_with("fmufit-"), "{}", root.display());
    assert_eq!(fs::read_to_string(root.join("modelDescription.xml")).unwrap(), zip_bytes::DESCRIPTION);
    assert_eq!(fs::read(root.join("resources/a.txt")).unwrap(), b"stored");
    assert_eq!(fs::read(root.join("resources/deep/er/b.txt")).unwrap().len(), 90_000);
    assert!(root.join("documentation/\u{e4} b.html").is_file());
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = |name: &str| root.join(name).metadata().unwrap().permissions().mode();
        assert_eq!(mode("resources/run.sh") & 0o111, 0o111);
        assert_eq!(mode("resources/a.txt") & 0o111, 0);
    }
    drop(archive);
    assert!(!root.exists() && !root.parent().unwrap().exists());
}

#[test]
fn content_hash_depends_on_bytes_of_archive() {
    let bytes = zip(&[description()]);
    let (one, two) = (open(&bytes).unwrap(), open(&bytes).unwrap());
    assert_eq!(one.content_hash().unwrap(), two.content_hash().unwrap());
    assert_ne!(one.unpack().unwrap(), two.unpack().unwrap());
    let other = open(&zip(&[description(), Entry::stored("a", b"")])).unwrap();
    assert_ne!(one.content_hash().unwrap(), other.content_hash().unwrap());
    assert_eq!(one.content_hash().unwrap().len(), 64);
}

#[test]
fn unpacked_folder_is_used_in_place() {
    let folder = tempfile::tempdir().unwrap();
    let error = Archive::open(folder.path()).unwrap_err();
    assert!(matches!(error, FmiError::NoModelDescription { .. }), "{error}");
    fs::write(folder.path().join("modelDescription.xml"), zip_bytes::DESCRIPTION).unwrap();
    let archive = Archive::open(folder.path()).unwrap();
    assert_eq!(archive.unpack().unwrap(), folder.path());
    assert!(!archive.is_private());
    drop(archive);
    assert!(folder.path().join("modelDescription.xml").exists());
}

#[test]
fn missing_archive_is_io_error_with_path() {
    let error = Archive::open("/no/such/file.fmu").unwrap_err();
    assert!(matches!(&error, FmiError::Io { source, .. } if source.kind() == std::io::ErrorKind::NotFound));
    assert!(error.to_string().contains("/no/such/file.fmu"), "{error}");
}

#[test]
fn truncated_archive_is_distinguished_from_other_files() {
    for (bytes, part) in [
        (&b""[..], "not a zip archive"),
        (b"hello, world", "not a zip archive"),
        (b"<?xml version=\"1.0\"?>", "not a zip archive"),
    ] {
        let message = open(bytes).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    }
    let whole = zip(&[description(), Entry::stored("resources/a", &[7; 1000])]);
    for length in (1..whole.len()).filter(|length| length % 7 == 0 || whole.len() - length < 30) {
        let error = open(&whole[..length]).expect_err("truncated");
        assert!(matches!(error, FmiError::BadArchive { .. }), "{length}: {error}");
        let part = if length < 4 { "not a zip archive" } else { "truncated" };
        assert!(error.to_string().contains(part), "{length}: {error}");
    }
}

#[test]
fn missing_model_description_is_reported_with_hint() {
    let none = open(&zip(&[Entry::stored("a.txt", b"")])).unwrap_err();
    assert!(matches!(none, FmiError::NoModelDescription { hint: None, .. }), "{none}");
    let down = open(&zip(&[description().with(|entry| {
        entry.name = b"BouncingBall/modelDescription.xml".to_vec();
        entry.local_name = entry.name.clone();
    })]))
    .unwrap_err()
    .to_string();
    assert!(down.contains("Pack the contents of \"BouncingBall\""), "{down}");
    let case = open(&zip(&[Entry::stored("ModelDescription.xml", b"")])).unwrap_err().to_string();
    assert!(case.contains("names are case-sensitive"), "{case}");
    let folder = open(&zip(&[Entry::stored("modelDescription.xml/", b"")])).unwrap_err().to_string();
    assert!(folder.contains("is a folder") && !folder.contains("case"), "{folder}");
    let folder = open(&zip(&[Entry::stored("modelDescription.xml/", b"")])).unwrap_err();
    assert!(matches!(folder, FmiError::NoModelDescription { .. }), "{folder}");
    let system = ["SystemStructure.ssd", "resources/a.fmu", "resources/a.ssv"]
        .map(|name| Entry::stored(name, b"<a/>"));
    let system = open(&zip(&system)).unwrap_err().to_string();
    assert!(
        system.contains("it is an SSP archive (a system of models)")
            && system.contains("(resources/a.fmu), with a parameter set (resources/a.ssv)"),
        "{system}"
    );
}

#[test]
fn archive_rejects_names_outside_folder() {
    for name in
        ["../evil", "a/../../evil", "resources/..", "./../evil", "..\\evil", "a\\..\\..\\evil", "a//../b"]
    {
        assert_eq!(problem_of_name(name), EntryProblem::Traversal, "{name}");
    }
    for name in
        ["/etc/passwd", "C:/evil", "c:evil", "//server/share", "\\\\server\\share", "C:\\evil", "./C:evil"]
    {
        assert_eq!(problem_of_name(name), EntryProblem::Absolute, "{name}");
    }
    assert_eq!(problem_of_name("a\0.txt"), EntryProblem::ForbiddenCharacter('\0'));
    assert_eq!(problem_of_name(""), EntryProblem::EmptyName);
    assert_eq!(problem_of_name("a//"), EntryProblem::FolderWithData(1));
    assert_eq!(problem_of_name("./"), EntryProblem::FolderWithData(1));
}

#[test]
fn archive_unpacks_backslashes_and_dots_as_info_zip() {
    let description = Entry::stored("./modelDescription.xml", zip_bytes::DESCRIPTION.as_bytes());
    let archive = open(&zip(&[
        Entry::stored("./", b"").with(|entry| entry.mode = 0o040_755),
        description,
        Entry::stored("resources\\", b"").with(|entry| entry.mode = 0),
        Entry::stored("resources\\deep\\a.txt", b"backslashes"),
        Entry::deflated(".//resources/./b.txt", b"dots"),
    ]))
    .unwrap();
    let root = archive.unpack().unwrap();
    assert_eq!(fs::read(root.join("modelDescription.xml")).unwrap(), zip_bytes::DESCRIPTION.as_bytes());
    assert_eq!(fs::read(root.join("resources/deep/a.txt")).unwrap(), b"backslashes");
    assert_eq!(fs::read(root.join("resources/b.txt")).unwrap(), b"dots");
    let pair = |one: &str, two: &str| problem_of(&[Entry::stored(one, b"1"), Entry::stored(two, b"2")]);
    assert_eq!(pair("a/b", "a\\b"), EntryProblem::Duplicate);
    assert_eq!(pair("./a", "A"), EntryProblem::CaseDuplicate("a".into()));
}

#[test]
fn archive_reads_names_without_utf8_flag_as_cp437() {
    let entry = Entry::stored("", b"x").with(|entry| {
        entry.name = b"resources/\x84.txt".to_vec();
        entry.local_name = entry.name.clone();
    });
    let archive = open(&zip(&[description(), entry])).unwrap();
    assert!(archive.unpack().unwrap().join("resources/\u{e4}.txt").is_file());
}

#[test]
fn archive_rejects_colliding_names() {
    let pair = |one: &str, two: &str| problem_of(&[Entry::stored(one, b"1"), Entry::stored(two, b"2")]);
    assert_eq!(pair("a.txt", "a.txt"), EntryProblem::Duplicate);
    assert_eq!(pair("a.txt", "A.TXT"), EntryProblem::CaseDuplicate("a.txt".into()));
    assert_eq!(pair("r/a", "R/b"), EntryProblem::CaseDuplicate("r".into()));
    assert_eq!(pair("a", "a/b"), EntryProblem::FileAndFolder("a".into()));
    assert_eq!(pair("a/b", "a"), EntryProblem::FileAndFolder("a".into()));
    assert_eq!(
        problem_of_name("ModelDescription.xml"),
        EntryProblem::CaseDuplicate("modelDescription.xml".into())
    );
    assert_eq!(problem_of_name("modelDescription.xml"), EntryProblem::Duplicate);
}

#[test]
fn archive_accepts_duplicate_file_with_identical_content() {
    let text = b"resource ".repeat(30_000);
    let bytes = zip(&[
        description(),
        Entry::deflated("resources/a.txt", &text),
        Entry::stored("resources/a.txt", &text),
        Entry::stored("b", b""),
        description(),
    ]);
    let archive = open(&bytes).unwrap();
    assert_eq!(archive.repeated(), ["resources/a.txt", "modelDescription.xml"]);
    assert_eq!(fs::read(archive.unpack().unwrap().join("resources/a.txt")).unwrap(), text);
    let fmu = Fmu::open(file(&bytes).path()).unwrap();
    let quirk = &fmu.description().quirks[0];
    assert!(
        quirk.kind == QuirkKind::Duplicate && quirk.message.contains("\"resources/a.txt\" and 1 more"),
        "{quirk}"
    );
    // Size and checksum are equal, but the bytes differ.
    let pair = [Entry::stored("a", b"plumless"), Entry::stored("a", b"buckeroo")];
    assert_eq!(problem_of(&pair), EntryProblem::Duplicate);
}

#[test]
fn archive_rejects_links_and_special_files() {
    for (mode, what) in [
        (0o120_777, "symbolic link"),
        (0o020_644, "device"),
        (0o060_644, "device"),
        (0o010_644, "pipe"),
        (0o140_644, "socket"),
    ] {
        let entry = Entry::stored("a", b"/etc/passwd").with(|entry| entry.mode = mode);
        assert_eq!(problem_of(&[entry]), EntryProblem::NotAFile(what));
    }
    let folder = Entry::stored("a/", b"data").with(|entry| entry.mode = 0o040_755);
    assert_eq!(problem_of(&[folder]), EntryProblem::FolderWithData(4));
}

#[test]
fn archive_rejects_encryption_and_unsupported_compression() {
    assert_eq!(
        problem_of(&[Entry::stored("a", b"x").with(|entry| entry.flags = 1)]),
        EntryProblem::Encrypted
    );
    for method in [9, 12, 14, 93, 99] {
        let entry = Entry::stored("a", b"x").with(|entry| entry.method = method);
        assert_eq!(problem_of(&[entry]), EntryProblem::Compression(method));
    }
}

#[test]
fn archive_rejects_overlapping_entries() {
    // Two names for one file, as in overlapping zip bombs.
    let twice = [
        Entry::stored("a", b"12345"),
        Entry::stored("b", b"12345").with(|entry| {
            entry.local_name = b"a".to_vec();
            entry.header_of = Some(1);
        }),
    ];
    assert!(matches!(problem_of(&twice), EntryProblem::HeaderMismatch(_)));
    // The data of the first entry contain the second one.
    let inner = Entry::stored("b", b"12345");
    let inner_bytes = zip(std::slice::from_ref(&inner));
    let local = &inner_bytes[..30 + 1 + 5];
    let outer = Entry::stored("a", local);
    let mut bytes = zip(&[description(), outer, inner]);
    let find = |needle: &[u8], from: usize| {
        from + bytes[from..].windows(needle.len()).position(|window| window == needle).unwrap()
    };
    // The third record of the directory now refers to the copy inside the second.
    let copy = find(local, 0);
    let third = bytes.windows(4).rposition(|window| window == b"PK\x01\x02").unwrap();
    bytes[third + 42..third + 46].copy_from_slice(&(copy as u32).to_le_bytes());
    match open(&bytes).unwrap_err() {
        FmiError::BadEntry { entry, problem: EntryProblem::Overlap { start, other, .. }, .. } => {
            assert_eq!((entry.as_str(), start, other.as_str()), ("b", copy as u64, "a"));
        }
        other => panic!("{other}"),
    }
}

#[test]
fn archive_rejects_data_overlapping_directory() {
    let entry = Entry::stored("a", b"12345").with(|entry| {
        entry.sizes = (50, 50);
        entry.local_sizes = (50, 50);
    });
    match problem_of(&[entry]) {
        EntryProblem::Overlap { other, .. } => assert!(other.contains("directory"), "{other}"),
        other => panic!("{other}"),
    }
}

#[test]
fn archive_rejects_wrong_sizes() {
    let data = b"some text, some text, some text, some text".repeat(10);
    let honest = Entry::deflated("a", &data);
    let lying = |size: u64| {
        honest.clone().with(|entry| {
            entry.sizes.1 = size;
            entry.local_sizes.1 = size as u32;
        })
    };
    let real = data.len() as u64;
    for declared in [10, real - 1] {
        let problem = problem_of(&[lying(declared)]).to_string();
        assert!(problem.contains("larger than its declared"), "{problem}");
    }
    assert_eq!(problem_of(&[lying(real + 1)]), EntryProblem::WrongSize { found: real, declared: real + 1 });
    let stored = Entry::stored("a", b"12345").with(|entry| entry.sizes.1 = 6);
    assert_eq!(problem_of(&[stored]), EntryProblem::WrongSize { found: 5, declared: 6 });
    let mut cut_off = honest.clone();
    cut_off.packed.truncate(honest.packed.len() - 3);
    cut_off.sizes.0 -= 3;
    cut_off.local_sizes.0 -= 3;
    let problem = problem_of(&[cut_off]);
    assert!(matches!(problem, EntryProblem::Damaged(_) | EntryProblem::WrongSize { .. }), "{problem}");
}

#[test]
fn archive_rejects_inconsistent_local_headers() {
    type Change = fn(&mut Entry);
    let changes: [Change; 3] = [
        |entry| entry.local_name = b"b".to_vec(),
        |entry| entry.local_sizes.0 += 1,
        |entry| entry.local_sizes.1 += 1,
    ];
    for change in changes {
        let problem = problem_of(&[Entry::deflated("a", b"12345").with(change)]);
        assert!(matches!(problem, EntryProblem::HeaderMismatch(_)), "{problem}");
    }
    // The headers are compared when the archive is opened.
    let bytes = zip(&[description().with(|entry| entry.local_sizes.1 += 1)]);
    let error = Fmu::open(file(&bytes).path()).unwrap_err();
    assert!(matches!(error, FmiError::BadEntry { problem: EntryProblem::HeaderMismatch(_), .. }), "{error}");
    // Sizes after the data (bit 3) are valid, and the header then contains 0.
    let streamed = Entry::deflated("a", b"12345").with(|entry| {
        entry.flags = 8;
        entry.local_sizes = (0, 0);
    });
    assert!(open(&zip(&[description(), streamed])).is_ok());
}

#[test]
fn archive_rejects_damaged_data() {
    let wrong_sum = Entry::deflated("a", b"12345").with(|entry| entry.crc32 ^= 1);
    assert!(matches!(problem_of(&[wrong_sum]), EntryProblem::Damaged(_)));
    let garbage = Entry::packed("a", vec![0xff; 100], 100, 0);
    assert!(matches!(problem_of(&[garbage]), EntryProblem::Damaged(_)));
}

/// Returns a deflate stream of `mebibytes` of zeros, compressed to about a thousandth.
fn bomb(mebibytes: usize) -> Vec<u8> {
    let mut compress = flate2::Compress::new(flate2::Compression::best(), false);
    let zeros = vec![0; 1 << 20];
    let mut block = Vec::with_capacity(1 << 16);
    // A full flush ends on a byte boundary and resets the state, so the block can be repeated.
    compress.compress_vec(&zeros, &mut block, flate2::FlushCompress::Full).unwrap();
    let mut stream = block.repeat(mebibytes);
    stream.extend([1, 0, 0, 0xff, 0xff]);
    stream
}

#[test]
fn archive_rejects_zip_bomb_for_any_declared_size() {
    const SIZE: u64 = 10 << 30;
    let stream = bomb(10 << 10);
    assert!((5 << 20..15 << 20).contains(&stream.len()), "{}", stream.len());
    let honest = problem_of(&[Entry::packed("bomb", stream.clone(), SIZE, 0)]);
    assert_eq!(honest, EntryProblem::TooLarge { found: SIZE, limit: 2 << 30 });
    let problem = problem_of(&[Entry::packed("bomb", stream.clone(), 1000, 0)]);
    assert!(matches!(problem, EntryProblem::Damaged(_)), "{problem}");
    let below_the_limit = problem_of(&[Entry::packed("bomb", stream.clone(), 1 << 31, 0)]);
    assert_eq!(
        below_the_limit,
        EntryProblem::Ratio { compressed: stream.len() as u64, size: 1 << 31, limit: 200 }
    );
}

#[test]
fn archive_rejects_zip_bomb_in_many_entries() {
    let piece = bomb(100);
    let entries: Vec<Entry> =
        (0..30).map(|i| Entry::packed(&format!("piece{i}"), piece.clone(), 100 << 20, 0)).collect();
    let mut all = vec![description()];
    all.extend(entries);
    match open(&zip(&all)).unwrap_err() {
        FmiError::ArchiveLimit { found, limit, .. } => assert!(found > limit && limit == 200),
        other => panic!("{other}"),
    }
}

#[test]
fn archive_accepts_highly_compressible_tables() {
    let table = b"0.0,0.0,0.0\n".repeat(1 << 20);
    let entry = Entry::deflated("resources/table.csv", &table);
    assert!(entry.packed.len() * 200 < table.len());
    assert!(open(&zip(&[description(), entry])).is_ok());
}

#[test]
fn archive_limits_are_reported_with_numbers() {
    let archive = zip(&[description(), Entry::stored("a", &[1; 5000]), Entry::stored("b", &[2; 5000])]);
    let limits = ArchiveLimits::default();
    let entries = open_with(&archive, &ArchiveLimits { entries: 2, ..limits.clone() }).unwrap_err();
    assert!(entries.to_string().ends_with("3 entries, more than the limit of 2"), "{entries}");
    let file = open_with(&archive, &ArchiveLimits { file_bytes: 4999, ..limits.clone() }).unwrap_err();
    assert!(file.to_string().ends_with("entry \"a\" has 5000 bytes, more than the limit of 4999"), "{file}");
    let total = open_with(&archive, &ArchiveLimits { total_bytes: 9000, ..limits.clone() }).unwrap_err();
    assert!(total.to_string().ends_with("unpacked bytes, more than the limit of 9000"), "{total}");
    assert!(open_with(&archive, &ArchiveLimits { entries: 3, file_bytes: 5000, ..limits }).is_ok());
}

#[test]
fn archive_limits_count_folders_without_entries() {
    let mut entries = vec![description()];
    entries.extend((0..10).map(|i| Entry::stored(&format!("{i}{}f", "/d".repeat(20) + "/"), b"x")));
    let limits = ArchiveLimits { entries: 100, ..ArchiveLimits::default() };
    let error = open_with(&zip(&entries), &limits).unwrap_err();
    assert!(error.to_string().contains("files and folders, more than the limit of 100"), "{error}");
}

#[test]
fn archive_unpacks_many_entries() {
    let mut entries = vec![description()];
    entries.extend((0..20_000).map(|i| Entry::stored(&format!("resources/{}/{i}.txt", i % 100), b"x")));
    let archive = open(&zip(&entries)).unwrap();
    assert!(archive.unpack().unwrap().join("resources/99/19999.txt").is_file());
}

#[test]
fn archive_rejects_uncounted_directory_entries() {
    let mut bytes = zip(&[description(), Entry::stored("a", b"hidden")]);
    let end = bytes.len() - 22;
    bytes[end + 8..end + 12].copy_from_slice(&[1, 0, 1, 0]);
    let message = open(&bytes).unwrap_err().to_string();
    assert!(message.contains("more entries than the 1 that it declares"), "{message}");
}

/// Returns the archives above that are only rejected when they are unpacked.
fn refused_while_unpacking() -> Vec<Vec<u8>> {
    let wrong_sum = Entry::deflated("resources/a", b"12345").with(|entry| entry.crc32 ^= 1);
    let too_long = Entry::packed("resources/bomb", bomb(10), 1000, 0);
    let garbage = Entry::packed("resources/a", vec![0xff; 100], 100, 0);
    [wrong_sum, too_long, garbage].map(|entry| zip(&[description(), entry])).to_vec()
}

fn names_in(folder: &Path) -> Vec<PathBuf> {
    fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect()
}

/// Runs this test in a separate process with its own folder for temporary files, which no other process uses.
#[test]
fn rejected_archives_leave_no_files() {
    const INSIDE: &str = "FMUFIT_TEST_INSIDE";
    if std::env::var_os(INSIDE).is_some() {
        return opens_and_looks_around();
    }
    let folder = tempfile::tempdir().unwrap();
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "rejected_archives_leave_no_files", "--nocapture"])
        .env(INSIDE, "1")
        .envs(["TMPDIR", "TMP", "TEMP"].map(|variable| (variable, folder.path())))
        .output()
        .unwrap();
    let reported = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && reported.contains("1 passed"), "{reported}");
    assert_eq!(names_in(folder.path()), Vec::<PathBuf>::new());
}

fn opens_and_looks_around() {
    for bytes in refused_while_unpacking() {
        let file = file(&bytes);
        let archive = Archive::open(file.path()).unwrap();
        for _ in 0..2 {
            assert!(matches!(archive.unpack(), Err(FmiError::BadEntry { .. })));
        }
        assert_eq!(names_in(&std::env::temp_dir()), [file.path()]);
    }
    let file = file(&zip(&[description()]));
    let archive = Archive::open(file.path()).unwrap();
    assert_eq!(names_in(&std::env::temp_dir()).len(), 1);
    assert!(archive.unpack().unwrap().starts_with(std::env::temp_dir()));
    assert_eq!(names_in(&std::env::temp_dir()).len(), 2);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn archive_rejects_random_bytes(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(open(&bytes).is_err());
    }

    #[test]
    fn modified_archive_is_opened_or_rejected(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = zip(&[description(), Entry::stored("a/b", b"12345"), Entry::deflated("a/c", &[7; 300])]);
        for (place, value) in changes {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        promises::hold_for_archive(file(&bytes).path());
    }

    #[test]
    fn arbitrary_headers_are_handled_safely(
        sizes in any::<(u64, u64)>(), local_sizes in any::<(u32, u32)>(), method in 0_u16..10, flags in any::<u16>(),
        mode in any::<u32>(), header_of in prop::option::of(0_usize..2),
    ) {
        let odd = Entry::deflated("a", b"12345").with(|entry| {
            *entry = Entry { sizes, local_sizes, method, flags, mode: mode & 0xffff, header_of, ..entry.clone() };
        });
        promises::hold_for_archive(file(&zip(&[description(), odd])).path());
    }
}
