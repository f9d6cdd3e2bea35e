//! The bundled example models: their sources are part of this library, and become `.fmu` files on demand.

mod describe;
mod kind;

pub use kind::ExampleKind;

use crate::archive::hash_of_texts;
use crate::error::FmiError;
use crate::source::{cache_folder, pack};
use std::fs;
use std::path::{Path, PathBuf};

struct Example {
    name: &'static str,
    description: &'static str,
    model: &'static str,
}

macro_rules! example {
    ($name:literal) => {
        Example {
            name: $name,
            description: include_str!(concat!("../../models/", $name, "/modelDescription.xml")),
            model: include_str!(concat!("../../models/", $name, "/model.c")),
        }
    };
}

const EXAMPLES: [Example; 8] = [
    example!("furuta"),
    example!("bouncing_ball"),
    example!("dahlquist"),
    example!("van_der_pol"),
    example!("stair"),
    example!("switched_input"),
    example!("quad_tank"),
    example!("exhaust"),
];

/// The names that [`example_fmu`] knows.
pub fn example_names() -> impl ExactSizeIterator<Item = &'static str> {
    EXAMPLES.iter().map(|example| example.name)
}

/// Path of an `.fmu` of a bundled model, with its sources and a library for this platform.
///
/// It is packed at the first call, with the system's C compiler, and kept in a cache folder
/// (see [`build_library`](crate::build_library)).
///
/// # Errors
/// [`FmiError::UnknownExample`] lists the names there are; no compiler; the system refuses to write.
///
/// ```no_run
/// let furuta = fmi::Fmu::open(fmi::example_fmu("furuta")?)?;
/// # Ok::<(), fmi::FmiError>(())
/// ```
pub fn example_fmu(name: &str) -> Result<PathBuf, FmiError> {
    example_fmu_as(name, ExampleKind::Fmi2ModelExchange)
}

/// As [`example_fmu`], for any version of the standard.
///
/// # Errors
/// As [`example_fmu`].
pub fn example_fmu_as(name: &str, kind: ExampleKind) -> Result<PathBuf, FmiError> {
    let Some(example) = EXAMPLES.iter().find(|example| example.name == name) else {
        let known: Vec<&str> = example_names().collect();
        return Err(FmiError::UnknownExample { name: name.to_owned(), known: known.join(", ") });
    };
    let examples = cache_folder("examples")?;
    let files = files(example, kind)?;
    // Sources that change get a new place, so that nobody meets an older model.
    let texts = files.iter().map(|(_, text)| text.as_str());
    let version = [env!("CARGO_PKG_VERSION"), std::env::consts::OS, std::env::consts::ARCH];
    let hash = hash_of_texts(texts.chain(version));
    let kept = examples.join(&hash[..16.min(hash.len())]);
    let file = kept.join(format!("{name}{}.fmu", kind.suffix()));
    if file.is_file() {
        return Ok(file);
    }
    let unfinished = tempfile::Builder::new()
        .prefix(".unfinished-")
        .tempdir_in(&examples)
        .map_err(FmiError::io("create a folder in", &examples))?;
    let folder = unfinished.path().join("fmu");
    write_files(&folder, &files)?;
    let packed = unfinished.path().join("packed.fmu");
    pack(&folder, &packed)?;
    fs::create_dir_all(&kept).map_err(FmiError::io("create", &kept))?;
    // In one step, so that another process meets a whole file or none.
    fs::rename(&packed, &file).map_err(FmiError::io("create", &file))?;
    Ok(file)
}

/// The files of an example as a source-code FMU, by their paths in it.
fn files(example: &Example, kind: ExampleKind) -> Result<Vec<(String, String)>, FmiError> {
    let frontend = kind.frontend();
    let mut files = vec![
        ("modelDescription.xml".to_owned(), describe::description(example.description, kind)?),
        ("sources/model.c".to_owned(), example.model.to_owned()),
    ];
    files.extend(frontend.iter().map(|(name, text)| (format!("sources/{name}"), (*text).to_owned())));
    if matches!(kind, ExampleKind::Fmi1ModelExchange | ExampleKind::Fmi1CoSimulation) {
        // The names of FMI 1.0's functions begin with it.
        let text = format!("#define MODEL_IDENTIFIER {}\n", example.name);
        files.push(("sources/identifier.h".to_owned(), text));
    }
    if kind == ExampleKind::Fmi3 {
        let text = describe::build_description(example.name, &["model.c", frontend[0].0]);
        files.push(("sources/buildDescription.xml".to_owned(), text));
    }
    Ok(files)
}

fn write_files(folder: &Path, files: &[(String, String)]) -> Result<(), FmiError> {
    let sources = folder.join("sources");
    fs::create_dir_all(&sources).map_err(FmiError::io("create", &sources))?;
    for (name, text) in files {
        let path = folder.join(name);
        fs::write(&path, text).map_err(FmiError::io("write", path))?;
    }
    Ok(())
}
