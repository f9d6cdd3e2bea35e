//! From the bytes of `modelDescription.xml` to house types: one file per version of the standard, what they have
//! in common in `shared.rs`, and the checks that need the whole picture behind them.

mod attributes;
mod build_description;
mod clocks;
mod encoding;
mod fmi1;
mod fmi2;
mod fmi3;
mod shared;
mod xml;

use super::checks;
use super::limits::{Budget, DescriptionLimits};
use super::model::{ModelDescription, Unknown};
use super::quirks::Quirks;
use super::variable::Variable;
use super::version::FmiVersion;
use crate::archive::MODEL_DESCRIPTION;
use crate::cancel::Cancel;
use crate::error::FmiError;
use attributes::Attributes;
use std::borrow::Cow;
use std::rc::Rc;
use xml::{Element, Xml};

pub(crate) use build_description::{BUILD_DESCRIPTION, BuildSet, build_sets};

/// A description in the making.
pub(super) struct Draft {
    pub(super) model: ModelDescription,
    pub(super) quirks: Quirks,
    pub(super) budget: Rc<Budget>,
    /// For each variable which of its flags the file sets, so that a type does not overrule them.
    pub(super) flags: Vec<Flags>,
    /// Lines of the unknowns in the model structure, in the order of outputs, derivatives, initial unknowns, event
    /// indicators.
    pub(super) structure_lines: [Vec<u32>; 4],
}

/// Flags that a variable sets itself, and that its type would else supply.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Flags {
    pub(super) relative_quantity: bool,
    pub(super) unbounded: bool,
}

/// An index that stands for "not a variable"; the checks remove it.
pub(super) const NOWHERE: usize = usize::MAX;

/// Parses a document and checks it.
pub(super) fn parse(
    bytes: Cow<'_, [u8]>,
    limits: &DescriptionLimits,
    cancel: &Cancel,
) -> Result<ModelDescription, FmiError> {
    let budget = Rc::new(Budget::new(limits, cancel));
    check_size(&bytes, MODEL_DESCRIPTION, limits)?;
    let mut quirks = Quirks::default();
    let text = encoding::decode(bytes, &mut quirks);
    budget.take(text.len());
    let mut xml = Xml::new(&text, MODEL_DESCRIPTION, Rc::clone(&budget))?;
    let root = xml.root()?;
    if root.name() != "fmiModelDescription" {
        return Err(
            xml.error(format!("<{}> is the outermost element, not <fmiModelDescription>", root.name()))
        );
    }
    let version = version(&Attributes::of(&root)?)?;
    let major = version.major;
    let mut draft = Draft {
        model: ModelDescription::empty(version),
        quirks,
        budget,
        flags: Vec::new(),
        structure_lines: Default::default(),
    };
    let parse_version: fn(&mut Xml<'_>, &Element<'_>, &mut Draft) -> Result<(), FmiError> = match major {
        1 => fmi1::parse,
        2 => fmi2::parse,
        3 => fmi3::parse,
        _ => return Err(FmiError::UnknownVersion { version: draft.model.fmi_version.text }),
    };
    parse_version(&mut xml, &root, &mut draft)?;
    checks::finish(draft)
}

fn check_size(bytes: &[u8], file: &'static str, limits: &DescriptionLimits) -> Result<(), FmiError> {
    let limit = limits.bytes;
    if bytes.len() as u64 <= limit {
        return Ok(());
    }
    let message = format!("it has more bytes than the limit of {limit} (DescriptionLimits::bytes)");
    Err(FmiError::Description { file, line: 1, message })
}

/// The version by its leading numbers: "2.0", "3.0.1", "3.0-beta.2".
fn version(root: &Attributes<'_>) -> Result<FmiVersion, FmiError> {
    let text = root.required("fmiVersion")?;
    let mut numbers = text.trim().split(|c: char| !c.is_ascii_digit()).map(str::parse);
    match (numbers.next(), numbers.next()) {
        (Some(Ok(major)), minor) => {
            let minor = minor.and_then(Result::ok).unwrap_or(0);
            Ok(FmiVersion { major, minor, text: text.to_owned() })
        }
        _ => Err(root.error(format!("fmiVersion=\"{}\" is not one", attributes::shortened(text)))),
    }
}

/// The lists of the model structure.
#[derive(Clone, Copy)]
enum StructureList {
    Outputs,
    Derivatives,
    InitialUnknowns,
    EventIndicators,
}

impl Draft {
    /// Adds a variable.
    fn add_variable(&mut self, variable: Variable, flags: Flags) {
        // Its places in the index of names and in the sets that checks make.
        self.budget.take(64);
        self.budget.push(&mut self.model.variables, variable);
        self.budget.push(&mut self.flags, flags);
    }

    fn add_unknown(&mut self, list: StructureList, unknown: Unknown, line: u32) {
        let structure = &mut self.model.structure;
        let (unknowns, lines) = match list {
            StructureList::Outputs => (&mut structure.outputs, &mut self.structure_lines[0]),
            StructureList::Derivatives => (&mut structure.derivatives, &mut self.structure_lines[1]),
            StructureList::InitialUnknowns => (&mut structure.initial_unknowns, &mut self.structure_lines[2]),
            StructureList::EventIndicators => (&mut structure.event_indicators, &mut self.structure_lines[3]),
        };
        self.budget.push(unknowns, unknown);
        self.budget.push(lines, line);
    }
}
