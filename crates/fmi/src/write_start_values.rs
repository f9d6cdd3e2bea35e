//! A copy of an FMU with other start values in its description.

use crate::archive::MODEL_DESCRIPTION;
use crate::description::{Structure, Value, VariableKind, with_start_texts};
use crate::error::{FmiError, Result};
use crate::fmu::Fmu;
use crate::instance::assignments::{check_settable_at_start, convert_one, negate};
use crate::simulation::variable_elements::{Starts, VariableElement};
use crate::source::write_archive;
use base::files::open_regular;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use zip::ZipArchive;
use zip::write::{SimpleFileOptions, ZipWriter};

impl Fmu {
    /// Writes an `.fmu` in which these variables, or array elements (`a[2,1]`, counted from 1), have other
    /// start values. Only their `start` attributes and the `start` attributes of their aliases change in
    /// `modelDescription.xml`. All other files are copied unchanged.
    ///
    /// **Many libraries ignore the description**: their variables start from compiled-in values, unless the
    /// importing tool sets the start values of the description. (FMI 2.0.4, section 2.2.7.)
    ///
    /// # Errors
    /// Returns [`FmiError::UnknownVariable`], [`FmiError::NotSettable`], [`FmiError::WrongType`] and similar
    /// errors for values that cannot be set. Returns [`FmiError::BadArchive`] if the file has been modified
    /// since it was opened, or [`FmiError::Io`] if reading or writing fails. After an error, the output is
    /// not a valid FMU.
    pub fn write_with_start_values(&self, values: &[(String, f64)], out: &File) -> Result<()> {
        let bytes = self.description_file()?;
        let description = with_start_texts(&bytes, self.description(), &self.start_texts(values)?)?;
        match self.archive().loose_files()? {
            None => self.copy_packed(out, &description),
            Some(files) => {
                let replaced = [(MODEL_DESCRIPTION, &*description)];
                write_archive(out, "write a copy of", self.path(), files, &replaced)
            }
        }
    }

    /// Copies the entries of the file without recompression, except the description.
    fn copy_packed(&self, out: &File, description: &[u8]) -> Result<()> {
        let mut archive = ZipWriter::new(BufWriter::new(out));
        let path = self.path();
        let failed = |error: zip::result::ZipError| FmiError::io("copy", path)(error.into());
        let file = open_regular(path).map_err(FmiError::io("open", path))?;
        let hash = self.content_hash()?;
        if Fmu::open_with(path, self.options())?.content_hash()? != hash {
            return Err(FmiError::bad_archive(path, "the file has been modified since it was opened"));
        }
        let mut packed = ZipArchive::new(file).map_err(failed)?;
        archive.set_raw_comment(packed.comment().into()).map_err(failed)?;
        for k in 0..packed.len() {
            let entry = packed.by_index_raw(k).map_err(failed)?;
            if entry.name().map_err(failed)? != MODEL_DESCRIPTION {
                archive.raw_copy_file(entry).map_err(failed)?;
                continue;
            }
            let options = SimpleFileOptions::default()
                .compression_method(entry.compression())
                .last_modified_time(entry.last_modified().unwrap_or_default());
            let options = match entry.unix_mode() {
                Some(mode) => options.unix_permissions(mode & 0o777),
                None => options,
            };
            archive.start_file(MODEL_DESCRIPTION, options).map_err(failed)?;
            archive.write_all(description).map_err(FmiError::io("write a copy of", path))?;
        }
        let mut buffer = archive.finish().map_err(failed)?;
        buffer.flush().map_err(FmiError::io("write a copy of", path))
    }

    /// Returns the start values as strings for the description, by the positions of the variables.
    fn start_texts(&self, values: &[(String, f64)]) -> Result<BTreeMap<usize, String>> {
        let model = self.description();
        let structure = Structure::default();
        // Complete values by position, because several elements of one array may be set.
        let mut starts: BTreeMap<usize, Value> = BTreeMap::new();
        for (name, value) in values {
            let VariableElement { variable, element } = VariableElement::of_name(model, &structure, name)?;
            let declared = &model.variables[variable];
            check_settable_at_start(declared)?;
            let value = convert_one(declared, &Value::Real(*value))?;
            let whole = match element {
                None => value,
                Some(element) => {
                    let given: Vec<(usize, Value)> = starts.iter().map(|(k, v)| (*k, v.clone())).collect();
                    let all = Starts { description: model, structure: &structure, given: &given };
                    all.with_element(variable, element, value)?
                }
            };
            starts.insert(variable, whole);
        }
        let mut texts = BTreeMap::new();
        for (variable, value) in starts {
            let declared = &model.variables[variable];
            let is_alias = |k: &usize| {
                let other = &model.variables[*k];
                (other.kind, other.value_reference) == (declared.kind, declared.value_reference)
            };
            let aliases =
                (0..model.variables.len()).filter(is_alias).filter(|k| model.variables[*k].start.is_some());
            let mut with_start: Vec<usize> = aliases.collect();
            if with_start.is_empty() {
                with_start.push(variable);
            }
            for k in with_start {
                let other = &model.variables[k];
                let turned =
                    if other.negated == declared.negated { value.clone() } else { negate(value.clone()) };
                texts.insert(k, text(other.kind, &turned));
            }
        }
        Ok(texts)
    }
}

/// Formats a start value as the shortest string that represents the same number.
fn text(kind: VariableKind, value: &Value) -> String {
    match value {
        Value::Real(x) if kind == VariableKind::Float32 => format!("{:?}", *x as f32),
        Value::Real(x) => format!("{x:?}"),
        Value::Array(values) => values.iter().map(|value| text(kind, value)).collect::<Vec<_>>().join(" "),
        other => other.to_string(),
    }
}
