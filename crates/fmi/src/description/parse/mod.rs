//! Parser of `modelDescription.xml`, with one file per version of the standard. Common elements are in
//! `shared.rs`.

mod attributes;
mod build_description;
mod clocks;
mod encoding;
mod fmi1;
mod fmi2;
mod fmi3;
mod shared;
mod terminals;
mod xml;

use super::draft::Draft;
use super::limits::{DescriptionLimits, Reading, check_size};
use super::model::ModelDescription;
use super::version::FmiVersion;
use crate::archive::MODEL_DESCRIPTION;
use crate::cancel_request::CancelRequest;
use crate::error::{FmiError, Result};
use attributes::Attributes;
use std::borrow::Cow;
use std::rc::Rc;
use xml::{Element, Xml};

pub(crate) use build_description::{BUILD_DESCRIPTION, BuildSet, build_sets};
pub(super) use encoding::encoding_of;
pub(crate) use terminals::{TERMINALS, terminals};

/// Parses a document.
pub(super) fn parse(
    bytes: Cow<'_, [u8]>,
    limits: &DescriptionLimits,
    cancel: &CancelRequest,
) -> Result<Draft> {
    let reading = Rc::new(Reading::new(limits, cancel));
    check_size(&bytes, MODEL_DESCRIPTION, limits)?;
    let text = encoding::decode(bytes, &mut reading.quirks.borrow_mut());
    reading.take(text.len());
    let mut xml = Xml::new(&text, MODEL_DESCRIPTION, Rc::clone(&reading))?;
    let root = xml.root_named("fmiModelDescription")?;
    let version = version(&Attributes::of(&root)?)?;
    let major = version.major;
    let mut draft = Draft {
        model: ModelDescription { fmi_version: version, ..ModelDescription::default() },
        reading,
        flags: Vec::new(),
        structure_lines: Default::default(),
    };
    let parse_version: fn(&mut Xml<'_>, &Element<'_>, &mut Draft) -> Result<()> = match major {
        1 => fmi1::parse,
        2 => fmi2::parse,
        3 => fmi3::parse,
        _ => return Err(FmiError::UnknownVersion(draft.model.fmi_version.text)),
    };
    parse_version(&mut xml, &root, &mut draft)?;
    Ok(draft)
}

/// Returns the version from its leading numbers, for example "2.0", "3.0.1" or "3.0-beta.2".
fn version(root: &Attributes<'_>) -> Result<FmiVersion> {
    let text = root.required("fmiVersion")?;
    let mut numbers = text.trim().split(|c: char| !c.is_ascii_digit()).map(str::parse);
    match (numbers.next(), numbers.next()) {
        (Some(Ok(major)), minor) => {
            let minor = minor.and_then(Result::ok).unwrap_or(0);
            Ok(FmiVersion { major, minor, text: text.to_owned() })
        }
        _ => Err(root.error(format!("fmiVersion=\"{}\" is not a version", attributes::shortened(text)))),
    }
}
