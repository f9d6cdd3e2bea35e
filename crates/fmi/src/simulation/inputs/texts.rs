//! Inputs that are strings or bytes. Each distinct value has an index, and the indices are held between rows
//! like the values of any other input.

use crate::description::{Value, Variable, VariableKind};
use crate::error::{FmiError, Result};
use crate::instance::{Core, assignments::wrong_type};
use std::collections::HashMap;
use std::ffi::CString;

/// Input with its distinct values.
#[derive(Debug, Clone)]
pub(crate) struct TextInput {
    reference: u32,
    values: Values,
}

#[derive(Debug, Clone)]
enum Values {
    Texts(Vec<CString>),
    Bytes(Vec<Vec<u8>>),
}

impl TextInput {
    /// Returns the input with its distinct values, and the index of the value in each row.
    ///
    /// # Errors
    /// Returns [`FmiError::WrongType`] if the variable or a value has a different type. Also returns an error
    /// if a string contains a NUL character.
    pub(crate) fn new(variable: &Variable, rows: &[Value]) -> Result<(Self, Vec<f64>)> {
        let bad = |problem: String| FmiError::BadInput { name: variable.name.clone(), problem };
        let wrong = |value: &Value| wrong_type(variable, value, value.kind_name());
        let mut values = match (variable.kind, rows.first()) {
            (VariableKind::String, _) => Values::Texts(Vec::new()),
            (VariableKind::Binary, _) => Values::Bytes(Vec::new()),
            (_, Some(value)) => return Err(wrong(value)),
            (_, None) => return Err(bad("the table has no rows".to_owned())),
        };
        let mut numbers = Vec::with_capacity(rows.len());
        let mut indices: HashMap<&[u8], usize> = HashMap::new();
        for (row, value) in rows.iter().enumerate() {
            let (bytes, n) = match (&values, value) {
                (Values::Texts(texts), Value::String(text)) => (text.as_bytes(), texts.len()),
                (Values::Bytes(all), Value::Binary(bytes)) => (bytes.as_slice(), all.len()),
                (_, other) => return Err(wrong(other)),
            };
            let index = *indices.entry(bytes).or_insert(n);
            if index == n {
                match &mut values {
                    Values::Texts(texts) => {
                        texts.push(CString::new(bytes).map_err(|_| {
                            bad(format!("the string in row {} contains a NUL character", row))
                        })?)
                    }
                    Values::Bytes(all) => all.push(bytes.to_vec()),
                }
            }
            numbers.push(index as f64);
        }
        Ok((Self { reference: variable.value_reference, values }, numbers))
    }

    /// Returns the type and the reference of the variable.
    pub(crate) fn reference(&self) -> (VariableKind, u32) {
        let kind = match self.values {
            Values::Texts(_) => VariableKind::String,
            Values::Bytes(_) => VariableKind::Binary,
        };
        (kind, self.reference)
    }

    /// Sets the value with this index.
    pub(crate) fn set(&self, core: &mut Core, number: usize) -> Result<()> {
        let one = number..number + 1;
        match &self.values {
            Values::Texts(values) => core.call(|raw| raw.set_string(&[self.reference], &values[one])),
            Values::Bytes(values) => core.call(|raw| raw.set_binary(&[self.reference], &values[one])),
        }
    }
}
