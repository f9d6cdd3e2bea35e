//! The bundled example models: their sources are part of this library, and become `.fmu` files on demand.

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
            description: include_str!(concat!("../models/", $name, "/modelDescription.xml")),
            model: include_str!(concat!("../models/", $name, "/model.c")),
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

/// What turns a model into an FMU; see `models/readme.md`.
const FRONTEND: [(&str, &str); 4] = [
    ("fmi2.h", include_str!("../models/frontend/fmi2.h")),
    ("fmi2_me.c", include_str!("../models/frontend/fmi2_me.c")),
    ("instance.h", include_str!("../models/frontend/instance.h")),
    ("model.h", include_str!("../models/frontend/model.h")),
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
    let Some(example) = EXAMPLES.iter().find(|example| example.name == name) else {
        let known: Vec<&str> = example_names().collect();
        return Err(FmiError::UnknownExample { name: name.to_owned(), known: known.join(", ") });
    };
    let examples = cache_folder("examples")?;
    // Sources that change get a new place, so that nobody meets an older model.
    let texts = FRONTEND.iter().map(|(_, text)| *text).chain([example.description, example.model]);
    let version = [env!("CARGO_PKG_VERSION"), std::env::consts::OS, std::env::consts::ARCH];
    let hash = hash_of_texts(texts.chain(version));
    let kept = examples.join(&hash[..16.min(hash.len())]);
    let file = kept.join(format!("{name}.fmu"));
    if file.is_file() {
        return Ok(file);
    }
    let unfinished = tempfile::Builder::new()
        .prefix(".unfinished-")
        .tempdir_in(&examples)
        .map_err(FmiError::io("create a folder in", &examples))?;
    let folder = unfinished.path().join("fmu");
    write_sources(&folder, example)?;
    let packed = unfinished.path().join("packed.fmu");
    pack(&folder, &packed)?;
    fs::create_dir_all(&kept).map_err(FmiError::io("create", &kept))?;
    // In one step, so that another process meets a whole file or none.
    fs::rename(&packed, &file).map_err(FmiError::io("create", &file))?;
    Ok(file)
}

/// Writes an example as a source-code FMU.
fn write_sources(folder: &Path, example: &Example) -> Result<(), FmiError> {
    let sources = folder.join("sources");
    fs::create_dir_all(&sources).map_err(FmiError::io("create", &sources))?;
    let write = |path: PathBuf, text: &str| fs::write(&path, text).map_err(FmiError::io("write", path));
    write(folder.join("modelDescription.xml"), example.description)?;
    write(sources.join("model.c"), example.model)?;
    for (name, text) in FRONTEND {
        write(sources.join(name), text)?;
    }
    Ok(())
}
