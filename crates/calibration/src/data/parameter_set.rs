//! Parameter values from files of System Structure Parameter Values (SSP standard 1.0, section 6), `.ssv`.

use crate::data::{Unit, UnitConversion, UnitError};
use crate::error::CalibrationError;
use fmi::description::{BaseUnit, VariableKind};
use fmi::{FmiError, ModelDescription, Value, Variable};
use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, HashSet};
use std::path::Path;

/// Values of an SSP parameter file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterSet {
    /// File name for messages.
    source: String,
    parameters: Vec<SetParameter>,
    /// Units that the file defines, by name.
    #[serde(default, skip_serializing_if = "HashMap::is_empty")]
    units: HashMap<String, Unit>,
}

/// Value in a parameter file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct SetParameter {
    name: String,
    value: Value,
    /// True if the value is the name of an enumeration item.
    is_item: bool,
    /// Unit of the value; default: the unit of the variable.
    unit: Option<String>,
}

/// Maximum depth of elements; the format has five levels.
const DEEPEST: usize = 64;

impl ParameterSet {
    /// Reads a parameter file.
    ///
    /// # Errors
    /// Returns [`CalibrationError::DataFile`] if the file cannot be read, or [`CalibrationError::Data`] if it
    /// is not a parameter set.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, CalibrationError> {
        let path = path.as_ref();
        let bytes = base::files::read_regular(path)
            .map_err(|source| CalibrationError::DataFile { path: path.to_owned(), source })?;
        Self::parse(&bytes, &path.display().to_string())
    }

    /// Parses the text of a parameter file. `source` is its name in errors.
    ///
    /// # Errors
    /// Returns [`CalibrationError::Data`] if the text is not a parameter set.
    pub fn parse(text: &[u8], source: &str) -> Result<Self, CalibrationError> {
        let bad = |message: String| CalibrationError::Data { source_name: source.to_owned(), message };
        if text.starts_with(b"PK\x03\x04") {
            let message = "the file is a zip archive (.ssp, .fmu), not a parameter set. Specify an .ssv file from the archive";
            return Err(bad(message.to_owned()));
        }
        let text = std::str::from_utf8(text)
            .map_err(|_| bad("the file is not UTF-8 text, so it is not a parameter set (.ssv)".to_owned()))?;
        let (parameters, units) = content(text).map_err(bad)?;
        Ok(Self { source: source.to_owned(), parameters, units })
    }

    /// Returns the values for a model, converted to its units. Unit definitions of the file take precedence
    /// over definitions of the model. Definitions of the model take precedence over built-in units.
    ///
    /// # Errors
    /// Returns an error if the model has no such variable or the type of the variable differs. A unit that is
    /// unknown or measures another quantity is also an error.
    pub fn values(&self, model: &ModelDescription) -> Result<Vec<(String, Value)>, CalibrationError> {
        self.parameters
            .iter()
            .map(|parameter| Ok((parameter.name.clone(), self.value(parameter, model)?)))
            .collect()
    }

    fn value(&self, parameter: &SetParameter, model: &ModelDescription) -> Result<Value, CalibrationError> {
        let bad = |message: String| CalibrationError::Data { source_name: self.source.clone(), message };
        let SetParameter { name, value, unit, .. } = parameter;
        let array = || name.rsplit_once('[').and_then(|(array, _)| model.variable(array));
        let variable = model.variable(name).or_else(array).ok_or_else(|| {
            let nearest = model.nearest_names(name, 3).into_iter().map(str::to_owned).collect();
            let unknown = FmiError::UnknownVariable { name: name.clone(), nearest };
            bad(format!("{unknown}. Names in a parameter set of one model must not contain component names"))
        })?;
        match (value, unit) {
            (Value::String(item), _) if parameter.is_item => item_of(model, variable, item)
                .ok_or_else(|| bad(format!("'{name}' = '{item}' is not an item of its enumeration"))),
            (Value::Real(number), Some(unit)) => {
                let unit_definition = self.units.get(unit.trim());
                match UnitConversion::from_defined(unit, unit_definition, variable, model) {
                    Ok(conversion) => Ok(Value::Real(conversion.apply(*number))),
                    // Models without units mostly use SI units.
                    Err(UnitError::NotStated { .. })
                        if unit_definition
                            .copied()
                            .map_or_else(|| Unit::parse(unit), Ok)
                            .is_ok_and(|u| u.is_coherent()) =>
                    {
                        Ok(value.clone())
                    }
                    Err(error) => Err(bad(format!("'{name}': {error}"))),
                }
            }
            _ => Ok(value.clone()),
        }
    }
}

/// Returns the number of an enumeration item.
fn item_of(model: &ModelDescription, variable: &Variable, name: &str) -> Option<Value> {
    let types = variable.declared_type.as_ref().filter(|_| variable.kind == VariableKind::Enumeration);
    let of = model.type_definitions.iter().find(|definition| Some(&definition.name) == types)?;
    of.items.iter().find(|item| item.name == name).map(|item| Value::Integer(i128::from(item.value)))
}

/// Returns the parameters and the unit definitions of a document, or a message about invalid content.
fn content(text: &str) -> Result<(Vec<SetParameter>, HashMap<String, Unit>), String> {
    let mut reader = Reader::from_str(text);
    reader.config_mut().expand_empty_elements = true;
    let (mut found, mut depth) = (Vec::new(), 0_usize);
    // Name of the open parameter, a child of <Parameters> in the outermost element.
    let mut open: Option<String> = None;
    let (mut units, mut open_unit) = (HashMap::new(), None);
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
                        return Err("the file describes a system of models (.ssd), which is not supported. Specify the .ssv file of \
                                    one FMU"
                            .to_owned());
                    }
                    1 if name != "ParameterSet" => {
                        return Err(format!(
                            "the outermost element is <{name}>, not <ParameterSet>, so the file is not an .ssv file"
                        ));
                    }
                    3 if name == "Parameter" => {
                        let name = attribute(&start, "name")?;
                        open = Some(
                            name.ok_or_else(|| format!("line {}: a parameter without a name", line(at)))?,
                        );
                    }
                    3 if name == "Unit" => open_unit = attribute(&start, "name")?,
                    4 if name == "BaseUnit" && open_unit.is_some() => {
                        let unit = open_unit.take().unwrap_or_default();
                        let defined = defined_unit(&start)
                            .map_err(|message| format!("line {}: unit '{unit}': {message}", line(at)))?;
                        if units.insert(unit.trim().to_owned(), defined).is_some() {
                            return Err(format!("line {}: unit '{unit}' is defined twice", line(at)));
                        }
                    }
                    4 if name != "Annotations" => {
                        if let Some(parameter) = open.take() {
                            let one = one(parameter, name, &start);
                            found.push(one.map_err(|message| format!("line {}: {message}", line(at)))?);
                        }
                    }
                    DEEPEST => return Err("its elements are nested too deeply".to_owned()),
                    _ => {}
                }
            }
            Ok(Event::End(_)) => {
                depth = depth.saturating_sub(1);
                if depth == 2 {
                    (open, open_unit) = (None, None);
                }
            }
            Ok(Event::DocType(_)) => {
                return Err("it has a document type definition, which is not supported".to_owned());
            }
            Ok(Event::Eof) if depth == 0 && at > 0 && !text.trim().is_empty() => break,
            Ok(Event::Eof) => return Err("it ends before its outermost element is closed".to_owned()),
            Ok(_) => {}
            Err(error) => return Err(format!("line {}: {error}", line(reader.error_position() as usize))),
        }
    }
    let mut names = HashSet::new();
    if let Some(twice) = found.iter().find(|parameter: &&SetParameter| !names.insert(&parameter.name)) {
        return Err(format!("'{}' is given twice", twice.name));
    }
    match found.is_empty() {
        true => Err("it contains no parameter".to_owned()),
        false => Ok((found, units)),
    }
}

/// Returns a unit from the attributes of its base unit (as in FMI 2.0, section 2.2.2).
fn defined_unit(start: &BytesStart<'_>) -> Result<Unit, String> {
    let mut base = BaseUnit::default();
    for attribute in start.attributes() {
        let attribute = attribute.map_err(|error| error.to_string())?;
        let text = attribute.normalized_value(XmlVersion::Implicit1_0).map_err(|error| error.to_string())?;
        let name: &str = attribute.key.as_ref();
        let exponent = match name {
            "kg" => &mut base.kg,
            "m" => &mut base.m,
            "s" => &mut base.s,
            "A" => &mut base.a,
            "K" => &mut base.k,
            "mol" => &mut base.mol,
            "cd" => &mut base.cd,
            "rad" => &mut base.rad,
            "factor" | "offset" => {
                let number = text.trim().parse().map_err(|_| format!("{name} = '{text}' is not a number"))?;
                *(if name == "factor" { &mut base.factor } else { &mut base.offset }) = number;
                continue;
            }
            _ => return Err(format!("'{name}' is not a base unit of the SI")),
        };
        *exponent =
            text.trim().parse().map_err(|_| format!("the exponent {name} = '{text}' is not an integer"))?;
    }
    Unit::defined(&base)
        .ok_or_else(|| format!("factor {} and offset {} do not define a unit", base.factor, base.offset))
}

/// Returns a parameter from the element of its type, including the types of version 2.0.
fn one(name: String, kind: &str, start: &BytesStart<'_>) -> Result<SetParameter, String> {
    let text = attribute(start, "value")?.ok_or_else(|| format!("'{name}' has no value"))?;
    let bad = || format!("'{name}' = '{text}' is not a valid {kind}");
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
        other => return Err(format!("'{name}' has the type {other}, which is not supported")),
    };
    Ok(SetParameter { name, value, is_item: kind == "Enumeration", unit: attribute(start, "unit")? })
}

/// Returns an attribute of an element.
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
        content(text).map(|(parameters, _)| parameters)
    }

    #[test]
    fn parameter_set_reads_types_and_units() {
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
    fn parameter_set_uses_units_defined_in_the_file() {
        let text = |unit: &str, defined: &str| {
            format!(
                "<ParameterSet><Parameters><Parameter name=\"k\"><Real value=\"3\" unit=\"{unit}\"/></Parameter>\
                 </Parameters><Units>{defined}</Units></ParameterSet>"
            )
        };
        let unit = |name: &str, base: &str| format!("<Unit name=\"{name}\"><BaseUnit {base}/></Unit>");
        let model = |unit: Option<&str>| {
            let unit = unit.map_or_else(String::new, |unit| format!(" unit=\"{unit}\""));
            let text = format!(
                "<fmiModelDescription fmiVersion=\"2.0\" modelName=\"m\" guid=\"g\"><ModelExchange modelIdentifier=\"m\"/>\
                 <ModelVariables><ScalarVariable name=\"k\" valueReference=\"0\" causality=\"parameter\" variability=\"fixed\">\
                 <Real start=\"1\"{unit}/></ScalarVariable></ModelVariables><ModelStructure/></fmiModelDescription>"
            );
            ModelDescription::parse(text.as_bytes()).unwrap()
        };
        let read = |unit: &str, defined: &str, of_variable: Option<&str>| {
            let set =
                ParameterSet::parse(text(unit, defined).as_bytes(), "set.ssv").map_err(|e| e.to_string())?;
            let values = set.values(&model(of_variable)).map_err(|e| e.to_string())?;
            Ok::<_, String>(values[0].1.as_number().unwrap())
        };
        let furlong = unit("furlong", "m=\"1\" factor=\"201.168\"");
        assert_eq!(read("furlong", &furlong, Some("m")), Ok(603.504));
        assert_eq!(read("furlong", &furlong, Some("km")), Ok(0.603504));
        // The definition of the file takes precedence over the known unit, even if both names are equal.
        let hand = unit("mm", "m=\"1\" factor=\"0.002\"");
        assert_eq!(read("mm", &hand, Some("m")), Ok(0.006));
        assert_eq!(read("mm", &hand, Some("mm")), Ok(6.0));
        assert_eq!(read("mm", &unit("mm", "m=\"1\" factor=\"0.001\""), Some("mm")), Ok(3.0));
        let warm = unit("warm", "K=\"1\" offset=\"270\"");
        assert_eq!(read("warm", &warm, Some("K")), Ok(273.0));
        // A name that only the file defines denotes one unit on both sides. If the model has no unit, the
        // unit must be coherent.
        assert_eq!(read("furlong", &furlong, Some("furlong")), Ok(3.0));
        assert_eq!(read("thing", &unit("thing", "kg=\"1\""), None), Ok(3.0));
        for (name, defined, of_variable, expected) in [
            ("furlong", &furlong, None, "the model declares no unit for 'k'"),
            ("furlong", &furlong, Some("s"), "'furlong' (m) cannot be converted to 's' (s)"),
            ("furlong", &String::new(), Some("m"), "'furlong' is not a known unit"),
            ("a", &unit("a", "m=\"x\""), Some("m"), "unit 'a': the exponent m = 'x' is not an integer"),
            (
                "a",
                &unit("a", "factor=\"0\""),
                Some("m"),
                "unit 'a': factor 0 and offset 0 do not define a unit",
            ),
            ("a", &unit("a", "factor=\"two\""), Some("m"), "factor = 'two' is not a number"),
            ("a", &unit("a", "bit=\"1\""), Some("m"), "'bit' is not a base unit"),
            ("a", &unit("a", "m=\"1\"").repeat(2), Some("m"), "unit 'a' is defined twice"),
        ] {
            let message = read(name, defined, of_variable).unwrap_err();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn parameter_set_errors_report_the_cause() {
        let set =
            |inside: &str| format!("<ParameterSet>\n<Parameters>\n{inside}</Parameters></ParameterSet>");
        for (text, expected) in [
            ("", "ends before"),
            ("<a/>", "the outermost element is <a>"),
            ("<ssd:SystemStructureDescription xmlns:ssd=\"x\"/>", "a system of models"),
            ("<!DOCTYPE a><ParameterSet/>", "document type"),
            ("<ParameterSet>", "ends before"),
            (&set(""), "it contains no parameter"),
            (
                &set("<Parameter name=\"k\"><Real value=\"x\"/></Parameter>"),
                "line 3: 'k' = 'x' is not a valid Real",
            ),
            (&set("<Parameter name=\"k\"><Real value=\"1e999\"/></Parameter>"), "is not a valid Real"),
            (&set("<Parameter><Real value=\"1\"/></Parameter>"), "without a name"),
            (&set("<Parameter name=\"k\"><Binary value=\"1\"/></Parameter>"), "has the type Binary"),
            (&set(&"<Parameter name=\"k\"><Real value=\"1\"/></Parameter>".repeat(2)), "'k' is given twice"),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.contains(expected), "{text}: {message}");
        }
    }
}
