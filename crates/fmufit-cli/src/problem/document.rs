//! TOML documents as plain data, with the line of each value.

use super::error_location::{Lines, field, item};
use dfo::{Record, Value};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A document and the lines of its values.
pub(super) struct Document {
    pub(super) record: Record,
    pub(super) lines: Lines,
}

impl Document {
    /// Reads a document.
    ///
    /// # Errors
    /// Returns the line number and a description of the mistake.
    pub(super) fn parse(text: &str) -> Result<Self, (usize, String)> {
        let line_at = |at: usize| 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
        let table = DeTable::parse(text).map_err(|error| {
            let line = error.span().map_or(1, |span| line_at(span.start));
            (line, error.message().trim().replace('\n', ", "))
        })?;
        let mut reader = Reader { lines: Lines::default(), line_at: &line_at };
        let record = reader.record(table.get_ref(), "")?;
        Ok(Self { record, lines: reader.lines })
    }
}

/// Parses a text as a TOML value. A word without quotes is a string.
pub(super) fn value_of_text(text: &str) -> Value {
    let document = Document::parse(&format!("value = {text}"));
    let value = document.ok().and_then(|mut document| document.record.remove("value"));
    value.unwrap_or_else(|| match text {
        "none" => Value::Nothing,
        text => Value::Text(text.to_owned()),
    })
}

struct Reader<'t> {
    lines: Lines,
    line_at: &'t dyn Fn(usize) -> usize,
}

impl Reader<'_> {
    fn record(&mut self, table: &DeTable<'_>, path: &str) -> Result<Record, (usize, String)> {
        let field = |(key, value): (&Spanned<_>, &Spanned<DeValue<'_>>)| {
            let name = AsRef::<str>::as_ref(key.get_ref()).to_owned();
            let path_of_item = field(path, &name);
            self.lines.add(path_of_item.clone(), (self.line_at)(key.span().start));
            Ok((name, self.value(value, &path_of_item)?))
        };
        table.iter().map(field).collect()
    }

    /// Reads a value. Outputs keep the order in which they are written, because residuals use that order.
    fn value(&mut self, value: &Spanned<DeValue<'_>>, path: &str) -> Result<Value, (usize, String)> {
        let line = (self.line_at)(value.span().start);
        let bad = |message: &str| (line, format!("{path}: {message}"));
        Ok(match value.get_ref() {
            DeValue::String(text) => Value::Text(text.to_string()),
            DeValue::Boolean(flag) => Value::Flag(*flag),
            DeValue::Integer(integer) => {
                let number = i64::from_str_radix(&integer.as_str().replace('_', ""), integer.radix());
                let number = number.map_err(|_| bad("the integer is too large"))?;
                u64::try_from(number).map_or(Value::Negative(number), Value::Count)
            }
            DeValue::Float(float) => {
                let number = float.as_str().replace('_', "").parse();
                Value::Number(number.map_err(|_| bad("invalid number"))?)
            }
            DeValue::Datetime(_) => return Err(bad("dates are not supported; specify times in s")),
            DeValue::Array(items) => {
                let mut values = Vec::with_capacity(items.len());
                for (k, value) in items.iter().enumerate() {
                    let path_of_item = item(path, k);
                    self.lines.add(path_of_item.clone(), (self.line_at)(value.span().start));
                    values.push(self.value(value, &path_of_item)?);
                }
                Value::List(values)
            }
            DeValue::Table(table) if path.ends_with(".outputs") => {
                let record = self.record(table, path)?;
                let mut written: Vec<_> =
                    table.keys().map(|key| (key.span().start, key.get_ref().to_string())).collect();
                written.sort();
                let mut pairs = Vec::with_capacity(record.len());
                for (k, (at, name)) in written.into_iter().enumerate() {
                    self.lines.add(item(path, k), (self.line_at)(at));
                    let value = record.get(&name).cloned().unwrap_or(Value::Nothing);
                    pairs.push(Value::List(vec![Value::Text(name), value]));
                }
                Value::List(pairs)
            }
            DeValue::Table(table) => Value::Record(self.record(table, path)?),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_keep_line_numbers_and_outputs_keep_order() {
        let text = "model = \"a.fmu\"\n\n[[experiments]]\ndata = 'x'\noutputs = { z = \"1\", \"a.b\" = \"2\" }\n[fit]\nmax_time = 1_0.5\nn = -3\n";
        let Ok(Document { record, lines }) = Document::parse(text) else { panic!("{text}") };
        let Some(Value::List(experiments)) = record.get("experiments") else { panic!("{record:?}") };
        assert_eq!(experiments[0].to_string(), "{'data': 'x', 'outputs': [['z', '1'], ['a.b', '2']]}");
        assert_eq!(record["fit"].to_string(), "{'max_time': 10.5, 'n': -3}");
        for (path, line) in
            [("model", 1), ("experiments[0].outputs.z", 5), ("experiments[0].windows", 3), ("fit.n", 8)]
        {
            assert_eq!(lines.of(path), Some(line), "{path}");
        }
        assert_eq!(Document::parse("a = 1\nb = [1,\n").err().map(|(line, _)| line), Some(2));
        assert!(
            Document::parse("a = 2024-01-01")
                .err()
                .is_some_and(|(_, message)| message.contains("a: dates are not supported"))
        );
    }

    #[test]
    fn text_is_parsed_as_toml_value_or_string() {
        for (text, value) in [
            ("3", Value::Count(3)),
            ("1e-3", Value::Number(1e-3)),
            ("true", Value::Flag(true)),
            ("radau5", Value::Text("radau5".to_owned())),
            ("\"3\"", Value::Text("3".to_owned())),
            ("none", Value::Nothing),
        ] {
            assert_eq!(value_of_text(text), value);
        }
    }
}
