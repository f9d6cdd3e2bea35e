//! Export of parameter values for other tools: System Structure Parameter Values 1.0 (SSP standard 1.0,
//! section 6).

use super::files::{check_belongs, check_suffix, write};
use crate::error::CalibrationError;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use fmi::description::{BaseUnit, Unit, VariableKind};
use quick_xml::escape;
use std::collections::BTreeMap;
use std::path::Path;

/// Namespaces of the format.
const VALUES: &str = "http://ssp-standard.org/SSP1/SystemStructureParameterValues";
const COMMON: &str = "http://ssp-standard.org/SSP1/SystemStructureCommon";

impl Fit {
    /// Writes the values of the variables that the parameters set to an SSP parameter file, `.ssv`. If there
    /// are [local](crate::Parameter::local) parameters, `experiment` selects their values.
    ///
    /// # Errors
    /// Returns the errors of [`ssv`](Self::ssv). Returns [`CalibrationError::Setup`] if the name does not end
    /// in `.ssv`, or [`fmi::FmiError::Io`].
    pub fn export_ssv(
        &self,
        calibration: &Calibration,
        path: impl AsRef<Path>,
        experiment: Option<&str>,
    ) -> Result<(), CalibrationError> {
        check_suffix(path.as_ref(), "ssv")?;
        write(path.as_ref(), calibration, self.ssv(calibration, experiment)?.as_bytes())
    }

    /// Returns the text of an SSP parameter file. It contains the values in the units of the model, the units
    /// that the model defines, and a description of the fit.
    ///
    /// # Errors
    /// Returns the errors of [`Calibration::variable_values`]. Returns [`CalibrationError::Setup`] if the fit
    /// does not belong to this calibration.
    pub fn ssv(
        &self,
        calibration: &Calibration,
        experiment: Option<&str>,
    ) -> Result<String, CalibrationError> {
        check_belongs(self, calibration)?;
        let model = calibration.fmu().description();
        let values = calibration.variable_values(&self.x, experiment)?;
        let mut units: BTreeMap<&str, &BaseUnit> = BTreeMap::new();
        let mut parameters = String::new();
        for (name, value) in &values {
            let array = || name.rsplit_once('[').and_then(|(array, _)| model.variable(array));
            let variable = model.variable(name).or_else(array);
            let unit = variable.and_then(|v| v.unit.as_deref());
            let is_named = |defined: &&Unit| Some(defined.name.as_str()) == unit;
            let base = model.units.iter().find(is_named).and_then(|defined| defined.base.as_ref());
            let unit = unit.zip(base);
            units.extend(unit);
            let kind = variable.map_or(VariableKind::Real, |v| v.kind);
            let (element, value) = match kind {
                VariableKind::Enumeration => {
                    let types = variable.and_then(|v| v.declared_type.as_deref());
                    let of = model.type_definitions.iter().find(|t| Some(t.name.as_str()) == types);
                    let item = of.and_then(|of| of.items.iter().find(|item| item.value as f64 == *value));
                    match item {
                        Some(item) => ("Enumeration", escape(&item.name)),
                        None => ("Integer", format!("{value}")),
                    }
                }
                kind if kind.is_integer() => ("Integer", format!("{value}")),
                _ => ("Real", format!("{value:?}")),
            };
            let unit = unit.map_or_else(String::new, |(unit, _)| format!(" unit=\"{}\"", escape(unit)));
            parameters += &format!(
                "    <ssv:Parameter name=\"{}\">\n      <ssv:{element} value=\"{value}\"{unit}/>\n    </ssv:Parameter>\n",
                escape(name)
            );
        }
        let unit = |(name, base): (&str, &BaseUnit)| {
            let base = attributes(base);
            let name = escape(name);
            format!("    <ssc:Unit name=\"{name}\">\n      <ssc:BaseUnit{base}/>\n    </ssc:Unit>\n")
        };
        let units = match units.is_empty() {
            true => String::new(),
            false => {
                format!("  <ssv:Units>\n{}  </ssv:Units>\n", units.into_iter().map(unit).collect::<String>())
            }
        };
        let of = experiment.map_or_else(String::new, |name| format!(", experiment {name}"));
        let description = format!(
            "Fit of {} to measurements{of}: cost {:?}, RMS {:?}; {}. SHA-256 of the FMU: {}",
            model.model_name,
            self.cost,
            self.rms,
            self.report.message,
            calibration.problem().model.content_hash
        );
        Ok(format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<ssv:ParameterSet xmlns:ssv=\"{VALUES}\" xmlns:ssc=\"{COMMON}\" \
             version=\"1.0\" name=\"{}\" description=\"{}\" generationTool=\"fmufit {}\">\n  <ssv:Parameters>\n{parameters}  \
             </ssv:Parameters>\n{units}</ssv:ParameterSet>\n",
            escape(&model.model_name),
            escape(&description),
            env!("CARGO_PKG_VERSION"),
        ))
    }
}

/// Escapes text for an attribute value. Line breaks and tabulators become character references, because a
/// reader would convert them to spaces (XML 1.0, section 3.3.3). Characters that XML does not permit (section
/// 2.2) become visible escapes.
fn escape(text: &str) -> String {
    let is_no_character = |c: char| matches!(c, '\u{0}'..='\u{8}' | '\u{b}' | '\u{c}' | '\u{e}'..='\u{1f}' | '\u{fffe}' | '\u{ffff}');
    let held = |c: char| match c {
        c if is_no_character(c) => c.escape_unicode().to_string(),
        c => c.to_string(),
    };
    let held: String = text.chars().map(held).collect();
    escape::escape(&held).replace('\t', "&#9;").replace('\n', "&#10;").replace('\r', "&#13;")
}

/// Returns the base units, factor and offset of a unit as attributes, without defaults.
fn attributes(base: &BaseUnit) -> String {
    let BaseUnit { kg, m, s, a, k, mol, cd, rad, factor, offset } = *base;
    let exponents =
        [("kg", kg), ("m", m), ("s", s), ("A", a), ("K", k), ("mol", mol), ("cd", cd), ("rad", rad)];
    let exponents =
        exponents.into_iter().filter(|(_, n)| *n != 0).map(|(name, n)| format!(" {name}=\"{n}\""));
    let numbers = [("factor", factor, 1.0), ("offset", offset, 0.0)];
    let numbers = numbers.into_iter().filter(|(_, value, default)| value != default);
    exponents.chain(numbers.map(|(name, value, _)| format!(" {name}=\"{value:?}\""))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escape_makes_any_name_a_valid_attribute() {
        let escaped = escape("a\u{1b}[2J\u{0}\n\t<\"k\">\u{ffff}");
        assert_eq!(escaped, "a\\u{1b}[2J\\u{0}&#10;&#9;&lt;&quot;k&quot;&gt;\\u{ffff}");
        let xml = format!("<a name=\"{escaped}\"/>");
        let mut reader = quick_xml::Reader::from_str(&xml);
        assert!(matches!(reader.read_event(), Ok(quick_xml::events::Event::Empty(_))));
    }
}
