//! Example models for documentation, tests and demos. The library contains their sources and creates `.fmu`
//! files on demand, for every version of the standard.
//!
//! This crate depends on the importer, which packs the models. The importer does not depend on this crate.

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

const EXAMPLES: [Example; 9] = [
    example!("furuta"),
    example!("bouncing_ball"),
    example!("dahlquist"),
    example!("van_der_pol"),
    example!("stair"),
    example!("switched_input"),
    example!("quad_tank"),
    example!("exhaust"),
    example!("tank_control"),
];

/// Returns the names that [`example_fmu`] accepts.
pub fn example_names() -> impl ExactSizeIterator<Item = &'static str> {
    EXAMPLES.iter().map(|example| example.name)
}

/// Returns the path of an `.fmu` file of a bundled model, with its sources and a library for this platform.
///
/// The first call compiles it with the system's C compiler and stores it in a cache folder (see
/// [`fmi::build_library`]).
///
/// # Errors
/// Returns [`FmiError::BadSetting`] with the available names if the name is unknown. Also returns an error if
/// there is no compiler, or a file cannot be written.
///
/// ```no_run
/// let furuta = fmi::Fmu::open(example_models::example_fmu("furuta")?)?;
/// # Ok::<(), fmi::FmiError>(())
/// ```
pub fn example_fmu(name: &str) -> Result<PathBuf, FmiError> {
    example_fmu_as(name, ExampleKind::Fmi2ModelExchange)
}

/// Returns a path as [`example_fmu`] does, for any version of the standard.
///
/// # Errors
/// Returns the errors of [`example_fmu`].
pub fn example_fmu_as(name: &str, kind: ExampleKind) -> Result<PathBuf, FmiError> {
    let Some(example) = EXAMPLES.iter().find(|example| example.name == name) else {
        let available: Vec<&str> = example_names().collect();
        let problem = format!("unknown example model \"{name}\"; expected one of: {}", available.join(", "));
        return Err(FmiError::BadSetting(problem));
    };
    let file_name = format!("{name}{}.fmu", kind.suffix());
    fmi::pack_texts(&file_name, &files(example, kind)?)
}

/// Returns the files of an example as a source-code FMU, with their paths in the FMU.
fn files(example: &Example, kind: ExampleKind) -> Result<Vec<(String, String)>, FmiError> {
    let frontend = kind.frontend();
    let mut files = vec![
        ("modelDescription.xml".to_owned(), describe::description(example.description, kind)?),
        ("sources/model.c".to_owned(), example.model.to_owned()),
    ];
    files.extend(frontend.iter().map(|(name, text)| (format!("sources/{name}"), (*text).to_owned())));
    if matches!(kind, ExampleKind::Fmi1ModelExchange | ExampleKind::Fmi1CoSimulation) {
        // FMI 1.0 prefixes its function names with this identifier.
        let text = format!("#define MODEL_IDENTIFIER {}\n", example.name);
        files.push(("sources/identifier.h".to_owned(), text));
    }
    if kind == ExampleKind::Fmi3 {
        let text = describe::build_description(example.name, &["model.c", frontend[0].0]);
        files.push(("sources/buildDescription.xml".to_owned(), text));
    }
    Ok(files)
}
