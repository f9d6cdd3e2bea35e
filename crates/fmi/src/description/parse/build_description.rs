//! `sources/buildDescription.xml`: the files to compile for each interface (FMI 3.0, also used by some FMI
//! 2.0 FMUs).

use super::attributes::Attributes;
use super::encoding;
use super::xml::Xml;
use crate::description::limits::{DescriptionLimits, check_size};
use crate::description::quirks::Quirks;
use crate::error::Result;
use std::rc::Rc;

/// Name of the file in `sources/`.
pub(crate) const BUILD_DESCRIPTION: &str = "buildDescription.xml";

/// Files to compile together.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct BuildSet {
    /// Files, relative to `sources/`.
    pub(crate) files: Vec<String>,
    /// Header folders, relative to `sources/`.
    pub(crate) include_folders: Vec<String>,
    /// Macros to define, with their values.
    pub(crate) definitions: Vec<(String, Option<String>)>,
}

/// Returns the first build configuration for a model identifier, with its C source sets merged. Compiler
/// options are ignored, because they are specific to one compiler and some are unsafe.
pub(crate) fn build_sets(bytes: &[u8], model_identifier: &str) -> Result<Option<BuildSet>> {
    check_size(bytes, BUILD_DESCRIPTION, &DescriptionLimits::default())?;
    let text = encoding::decode(bytes.into(), &mut Quirks::default());
    let mut xml = Xml::new(&text, BUILD_DESCRIPTION, Rc::default())?;
    let root = xml.root()?;
    while let Some(configuration) = xml.named(root.level, &["BuildConfiguration"])? {
        if Attributes::of(&configuration)?.get("modelIdentifier") != Some(model_identifier) {
            continue;
        }
        let mut set = BuildSet::default();
        while let Some(child) = xml.named(configuration.level, &["SourceFileSet"])? {
            source_file_set(&mut xml, child.level, &mut set)?;
        }
        return Ok(Some(set));
    }
    Ok(None)
}

fn source_file_set(xml: &mut Xml<'_>, level: usize, set: &mut BuildSet) -> Result<()> {
    while let Some(element) = xml.child(level)? {
        let attributes = Attributes::of(&element)?;
        let name = || attributes.required("name").map(str::to_owned);
        match element.name() {
            "SourceFile" => set.files.push(name()?),
            "IncludeDirectory" => set.include_folders.push(name()?),
            "PreprocessorDefinition" if attributes.get("optional") != Some("true") => {
                let name = name()?;
                if !is_identifier(&name) {
                    return Err(attributes
                        .error(format!("name=\"{}\" is not a valid macro name", name.escape_debug())));
                }
                set.definitions.push((name, attributes.text("value")));
            }
            _ => {}
        }
    }
    Ok(())
}

fn is_identifier(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: &str = r#"<?xml version="1.0"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="other"><SourceFileSet><SourceFile name="x.c"/></SourceFileSet></BuildConfiguration>
  <BuildConfiguration modelIdentifier="m">
    <SourceFileSet language="C99" compilerOptions="-fplugin=evil.so">
      <SourceFile name="a.c"/>
      <PreprocessorDefinition name="A" value="1"/>
      <PreprocessorDefinition name="B"/>
      <PreprocessorDefinition name="C" optional="true"/>
      <IncludeDirectory name="headers"/>
    </SourceFileSet>
    <SourceFileSet><SourceFile name="sub/b.c"/></SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>"#;

    #[test]
    fn build_sets_merges_the_sets_of_one_model() {
        let set = build_sets(EXAMPLE.as_bytes(), "m").unwrap().unwrap();
        assert_eq!(set.files, ["a.c", "sub/b.c"]);
        assert_eq!(set.include_folders, ["headers"]);
        assert_eq!(set.definitions, [("A".to_owned(), Some("1".to_owned())), ("B".to_owned(), None)]);
        assert_eq!(build_sets(EXAMPLE.as_bytes(), "none").unwrap(), None);
    }

    #[test]
    fn build_sets_rejects_invalid_macro_names_with_file_and_line() {
        let text = EXAMPLE.replace("name=\"B\"", "name=\"B;rm\"");
        let message = build_sets(text.as_bytes(), "m").unwrap_err().to_string();
        assert!(message.starts_with("buildDescription.xml, line 8: <PreprocessorDefinition>"), "{message}");
    }
}
