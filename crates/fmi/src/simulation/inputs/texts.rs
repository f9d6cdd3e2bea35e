//! Inputs that are texts or bytes: each value they take has a number, and the numbers are held from row to
//! row like those of any other input.

use crate::description::{Value, Variable, VariableKind};
use crate::error::{FmiError, Result};
use crate::instance::{Core, assignments::wrong_type};
use std::collections::HashMap;
use std::ffi::CString;

/// An input and the values that it takes.
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
    /// The values in these rows, and the number of each row's.
    ///
    /// # Errors
    /// [`FmiError::WrongType`] where the variable or a value is of another type; a text has a NUL in it.
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
        let mut known: HashMap<&[u8], usize> = HashMap::new();
        for (row, value) in rows.iter().enumerate() {
            let (bytes, n) = match (&values, value) {
                (Values::Texts(texts), Value::String(text)) => (text.as_bytes(), texts.len()),
                (Values::Bytes(all), Value::Binary(bytes)) => (bytes.as_slice(), all.len()),
                (_, other) => return Err(wrong(other)),
            };
            let number = *known.entry(bytes).or_insert(n);
            if number == n {
                match &mut values {
                    Values::Texts(texts) => texts.push(
                        CString::new(bytes)
                            .map_err(|_| bad(format!("the text in row {} has a NUL in it", row)))?,
                    ),
                    Values::Bytes(all) => all.push(bytes.to_vec()),
                }
            }
            numbers.push(number as f64);
        }
        Ok((Self { reference: variable.value_reference, values }, numbers))
    }

    /// Type and reference of the variable.
    pub(crate) fn reference(&self) -> (VariableKind, u32) {
        let kind = match self.values {
            Values::Texts(_) => VariableKind::String,
            Values::Bytes(_) => VariableKind::Binary,
        };
        (kind, self.reference)
    }

    /// Sets the value of this number.
    pub(crate) fn set(&self, core: &mut Core, number: usize) -> Result<()> {
        let one = number..number + 1;
        match &self.values {
            Values::Texts(values) => core.call(|raw| raw.set_string(&[self.reference], &values[one])),
            Values::Bytes(values) => core.call(|raw| raw.set_binary(&[self.reference], &values[one])),
        }
    }
}
