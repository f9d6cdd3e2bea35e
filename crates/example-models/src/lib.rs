//! Example models for documentation, tests and demos: their sources are part of this library, and become
//! `.fmu` files on demand, for every version of the standard.
//!
//! The crate stands above the importer, which packs the models; the importer knows nothing of them.

mod describe;
mod kind;

pub use kind::ExampleKind;

use fmi::FmiError;
use std::path::PathBuf;

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

/// The names that [`example_fmu`] knows.
pub fn example_names() -> impl ExactSizeIterator<Item = &'static str> {
    EXAMPLES.iter().map(|example| example.name)
}

/// Path of an `.fmu` of a bundled model, with its sources and a library for this platform.
///
/// It is packed at the first call, with the system's C compiler, and kept in a cache folder
/// (see [`fmi::build_library`]).
///
/// # Errors
/// [`FmiError::BadSetting`] lists the names there are; no compiler; the system refuses to write.
///
/// ```no_run
/// let furuta = fmi::Fmu::open(example_models::example_fmu("furuta")?)?;
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
        let problem = format!("there is no example model \"{name}\"; there are {}", known.join(", "));
        return Err(FmiError::BadSetting(problem));
    };
    let file_name = format!("{name}{}.fmu", kind.suffix());
    fmi::pack_texts(&file_name, &files(example, kind)?)
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
