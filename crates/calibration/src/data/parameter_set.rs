//! Values of variables from files of System Structure Parameter Values (SSP standard 1.0, section 6), `.ssv`.

use crate::data::{Unit, UnitConversion, UnitError};
use crate::error::CalibrationError;
use fmi::description::VariableKind;
use fmi::{FmiError, ModelDescription, Value, Variable};
use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::path::Path;

/// The values of an SSP parameter file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterSet {
    /// The file, for messages.
    source: String,
    parameters: Vec<SetParameter>,
}

/// A value of a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct SetParameter {
    name: String,
    value: Value,
    /// The value is the name of an item of an enumeration.
    is_item: bool,
    /// Its unit; `None`: that of the variable.
    unit: Option<String>,
}

/// Depth of elements; the format has five.
const DEEPEST: usize = 64;

impl ParameterSet {
    /// Reads a file.
    ///
    /// # Errors
    /// [`CalibrationError::DataFile`]: it cannot be read; [`CalibrationError::Data`]: it is no parameter set.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, CalibrationError> {
        let path = path.as_ref();
        let bytes = base::files::read_regular(path)
            .map_err(|source| CalibrationError::DataFile { path: path.to_owned(), source })?;
        Self::parse(&bytes, &path.display().to_string())
    }

    /// Reads the text of a file; `source` names it in errors.
    ///
    /// # Errors
    /// [`CalibrationError::Data`]: it is no parameter set.
    pub fn parse(text: &[u8], source: &str) -> Result<Self, CalibrationError> {
        let bad = |message: String| CalibrationError::Data { source_name: source.to_owned(), message };
        if text.starts_with(b"PK\x03\x04") {
            let message = "this is a zip archive (.ssp, .fmu), no parameter set: give an .ssv that is in it";
            return Err(bad(message.to_owned()));
        }
        let text = std::str::from_utf8(text)
            .map_err(|_| bad("this is no text in UTF-8, so no parameter set (.ssv)".to_owned()))?;
        let parameters = parameters(text).map_err(bad)?;
        Ok(Self { source: source.to_owned(), parameters })
    }

    /// The values for a model, in its units.
    ///
    /// # Errors
    /// The model has no such variable, or it has another type; a unit of another quantity, or not known.
    pub fn values(&self, model: &ModelDescription) -> Result<Vec<(String, Value)>, CalibrationError> {
        self.parameters.iter().map(|own| Ok((own.name.clone(), self.value(own, model)?))).collect()
    }

    fn value(&self, own: &SetParameter, model: &ModelDescription) -> Result<Value, CalibrationError> {
        let bad = |message: String| CalibrationError::Data { source_name: self.source.clone(), message };
        let SetParameter { name, value, unit, .. } = own;
        let array = || name.rsplit_once('[').and_then(|(array, _)| model.variable(array));
        let variable = model.variable(name).or_else(array).ok_or_else(|| {
            let nearest = model.nearest_names(name, 3).into_iter().map(str::to_owned).collect();
            let unknown = FmiError::UnknownVariable { name: name.clone(), nearest };
            bad(format!("{unknown}; names of components are no part of those of a model"))
        })?;
        match (value, unit) {
            (Value::String(item), _) if own.is_item => item_of(model, variable, item)
                .ok_or_else(|| bad(format!("'{name}' = '{item}' is no item of its enumeration"))),
            (Value::Real(number), Some(unit)) => {
                match UnitConversion::to_variable(unit, variable, model) {
                    Ok(conversion) => Ok(Value::Real(conversion.apply(*number))),
                    // Models without units are mostly in those of the SI.
                    Err(UnitError::NotStated { .. }) if Unit::parse(unit).is_ok_and(|u| u.is_coherent()) => {
                        Ok(value.clone())
                    }
                    Err(error) => Err(bad(format!("'{name}': {error}"))),
                }
            }
            _ => Ok(value.clone()),
        }
    }
}

/// The number of an item.
fn item_of(model: &ModelDescription, variable: &Variable, name: &str) -> Option<Value> {
    let types = variable.declared_type.as_ref().filter(|_| variable.kind == VariableKind::Enumeration);
    let of = model.type_definitions.iter().find(|known| Some(&known.name) == types)?;
    of.items.iter().find(|item| item.name == name).map(|item| Value::Integer(i128::from(item.value)))
}

/// The parameters of a document, or what is wrong with it.
fn parameters(text: &str) -> Result<Vec<SetParameter>, String> {
    let mut reader = Reader::from_str(text);
    reader.config_mut().expand_empty_elements = true;
    let (mut found, mut depth) = (Vec::new(), 0_usize);
    // The name of the parameter that is open, which stands in <Parameters> of the outermost element.
    let mut open: Option<String> = None;
    loop {
        let at = reader.buffer_position() as usize;
        let line = |at: usize| 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
        match reader.read_event() {
            Ok(Event::Start(start)) => {
                depth += 1;
                let name = start.local_name();
                let name: &str = name.as_ref();
                match depth {
                    1 if name == "SystemStructureDescription" => {
                        return Err("this describes a system of models (.ssd): a simulation or a fit is of one of its FMUs; give the .ssv of its \
                                    parameters"
                            .to_owned());
                    }
                    1 if name != "ParameterSet" => {
                        return Err(format!(
                            "<{name}> is its outermost element, not <ParameterSet>: this is no .ssv file"
                        ));
                    }
                    3 if name == "Parameter" => {
                        let own = attribute(&start, "name")?;
                        open = Some(
                            own.ok_or_else(|| format!("line {}: a parameter without a name", line(at)))?,
                        );
                    }
                    4 if name != "Annotations" => {
                        if let Some(own) = open.take() {
                            let one = one(own, name, &start);
                            found.push(one.map_err(|message| format!("line {}: {message}", line(at)))?);
                        }
                    }
                    DEEPEST => return Err("its elements are too deep inside each other".to_owned()),
                    _ => {}
                }
            }
            Ok(Event::End(_)) => {
                depth = depth.saturating_sub(1);
                if depth == 2 {
                    open = None;
                }
            }
            Ok(Event::DocType(_)) => {
                return Err("it has a document type definition, which is not accepted".to_owned());
            }
            Ok(Event::Eof) if depth == 0 && at > 0 && !text.trim().is_empty() => break,
            Ok(Event::Eof) => return Err("it ends before its outermost element does".to_owned()),
            Ok(_) => {}
            Err(error) => return Err(format!("line {}: {error}", line(reader.error_position() as usize))),
        }
    }
    let mut names = HashSet::new();
    if let Some(twice) = found.iter().find(|own: &&SetParameter| !names.insert(&own.name)) {
        return Err(format!("'{}' is given twice", twice.name));
    }
    match found.is_empty() {
        true => Err("there is no parameter in it".to_owned()),
        false => Ok(found),
    }
}

/// A parameter by the element of its type; the types of version 2.0 too.
fn one(name: String, kind: &str, start: &BytesStart<'_>) -> Result<SetParameter, String> {
    let text = attribute(start, "value")?.ok_or_else(|| format!("'{name}' has no value"))?;
    let bad = || format!("'{name}' = '{text}' is no {kind}");
    let value = match kind {
        "Real" | "Float64" | "Float32" => {
            Value::Real(text.trim().parse().ok().filter(|number: &f64| number.is_finite()).ok_or_else(bad)?)
        }
        "Boolean" => Value::Boolean(match text.trim() {
            "true" | "1" => true,
            "false" | "0" => false,
            _ => return Err(bad()),
        }),
        "String" | "Enumeration" => Value::String(text),
        kind if kind.trim_start_matches('U').starts_with("Int") => {
            Value::Integer(text.trim().parse().map_err(|_| bad())?)
        }
        other => return Err(format!("'{name}' is of type {other}, which is not read")),
    };
    Ok(SetParameter { name, value, is_item: kind == "Enumeration", unit: attribute(start, "unit")? })
}

/// An attribute of an element.
fn attribute(start: &BytesStart<'_>, name: &str) -> Result<Option<String>, String> {
    let attribute = start.try_get_attribute(name).map_err(|error| error.to_string())?;
    let text =
        attribute.map(|found| found.normalized_value(XmlVersion::Implicit1_0).map(|text| text.into_owned()));
    text.transpose().map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<SetParameter>, String> {
        parameters(text)
    }

    #[test]
    fn values_have_their_types_and_units() {
        let text = r#"<?xml version="1.0"?>
<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" name="a">
  <ssv:Parameters>
    <ssv:Parameter name="k"><ssv:Real value="2.5" unit="mm"/></ssv:Parameter>
    <ssv:Parameter name="n"><ssv:Annotations/><ssv:Integer value="3"/></ssv:Parameter>
    <ssv:Parameter name="m"><ssv:Integer value="-3"/></ssv:Parameter>
    <ssv:Parameter name="on"><ssv:Boolean value="true"/></ssv:Parameter>
    <ssv:Parameter name="a &amp; b"><ssv:String value="x&#10;y"/></ssv:Parameter>
    <ssv:Parameter name="e"><ssv:Enumeration value="two"/></ssv:Parameter>
  </ssv:Parameters>
  <ssv:Units><ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit></ssv:Units>
</ssv:ParameterSet>"#;
        let found = read(text).unwrap();
        let values: Vec<_> =
            found.iter().map(|p| (&p.name[..], p.value.clone(), p.unit.as_deref())).collect();
        assert_eq!(values[0], ("k", Value::Real(2.5), Some("mm")));
        assert_eq!(values[2], ("m", Value::Integer(-3), None));
        assert_eq!(values[3].1, Value::Boolean(true));
        assert_eq!(values[4], ("a & b", Value::String("x\ny".to_owned()), None));
        assert!(found[5].is_item && !found[4].is_item);
    }

    #[test]
    fn what_is_none_is_named() {
        let set =
            |inside: &str| format!("<ParameterSet>\n<Parameters>\n{inside}</Parameters></ParameterSet>");
        for (text, expected) in [
            ("", "ends before"),
            ("<a/>", "<a> is its outermost element"),
            ("<ssd:SystemStructureDescription xmlns:ssd=\"x\"/>", "a system of models"),
            ("<!DOCTYPE a><ParameterSet/>", "document type"),
            ("<ParameterSet>", "ends before"),
            (&set(""), "no parameter in it"),
            (&set("<Parameter name=\"k\"><Real value=\"x\"/></Parameter>"), "line 3: 'k' = 'x' is no Real"),
            (&set("<Parameter name=\"k\"><Real value=\"1e999\"/></Parameter>"), "is no Real"),
            (&set("<Parameter><Real value=\"1\"/></Parameter>"), "without a name"),
            (&set("<Parameter name=\"k\"><Binary value=\"1\"/></Parameter>"), "of type Binary"),
            (&set(&"<Parameter name=\"k\"><Real value=\"1\"/></Parameter>".repeat(2)), "'k' is given twice"),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.contains(expected), "{text}: {message}");
        }
    }
}
