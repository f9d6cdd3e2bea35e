//! Part of an instance that is independent of the phase: values, sizes and error messages.

use super::assignments::{self, Assignments};
use super::integer_codec;
use super::progress::Progress;
use crate::description::{ModelDescription, Structure, Value, Variable, VariableKind};
use crate::error::{FmiError, LogLine, Result, Status};
use crate::fmu::Fmu;
use crate::libraries::LoadedLibrary;
use crate::sys::{Fault, RawInstance, Sizes};
use std::ffi::CString;
use std::sync::Arc;

/// Instance in any phase. The component is dropped before the FMU, which owns the library.
#[derive(Debug)]
pub(crate) struct Core {
    pub(crate) raw: RawInstance,
    /// Library in use by an instance that the user controls; `None` in simulations.
    pub(super) _library: Option<Arc<LoadedLibrary>>,
    pub(super) fmu: Fmu,
    pub(super) structure: Structure,
    /// Progress of an instance that the user controls.
    pub(super) progress: Progress,
}

impl Core {
    /// Creates the core of an instance whose structural parameters have their start values.
    pub(crate) fn new(raw: RawInstance, fmu: Fmu) -> Self {
        Self { raw, _library: None, fmu, structure: Structure::default(), progress: Progress::default() }
    }

    pub(crate) fn fmu(&self) -> &Fmu {
        &self.fmu
    }

    /// Converts a fault to an error.
    pub(crate) fn error(&self, fault: Fault) -> FmiError {
        self.error_about(fault, &[], |_| false)
    }

    /// Converts a fault of a call about `references` to an error. `is` selects the kinds of variables that
    /// the call concerns.
    pub(crate) fn error_about(
        &self,
        fault: Fault,
        references: &[u32],
        is: impl Fn(VariableKind) -> bool,
    ) -> FmiError {
        let mut failure = match fault {
            Fault::Discard(call) => Box::new(self.raw.failure(call, Status::Discard)),
            Fault::Failed(failure) => failure,
            Fault::Unusable(library) => return FmiError::LibraryUnusable(library),
            Fault::AfterError(call) => return FmiError::AfterError(call),
            Fault::Missing(function) => return FmiError::MissingFunction(function),
            Fault::TooLarge { call, size } => return FmiError::TooLarge { call, size },
            Fault::Length { call, expected, found } => return FmiError::Length { call, expected, found },
        };
        let variables = &self.fmu.description().variables;
        failure.variables = references
            .iter()
            .filter_map(|reference| variables.iter().find(|v| v.value_reference == *reference && is(v.kind)))
            .map(|variable| variable.name.clone())
            .collect();
        for line in &mut failure.log {
            if line.text.contains('#') {
                line.text = expand_references(&line.text, self.fmu.description());
            }
        }
        FmiError::Call(failure)
    }

    /// Returns the last log lines, with the names of the variables, and the number of discarded lines.
    pub(super) fn log(&self) -> (Vec<LogLine>, u64) {
        let (mut lines, dropped) = self.raw.log();
        for line in &mut lines {
            line.text = expand_references(&line.text, self.fmu.description());
        }
        (lines, dropped)
    }

    /// Forwards the FMU's log lines to the program's logger, outside any call of the FMU.
    pub(crate) fn pass_log_on(&self) {
        let level = self.fmu.log_level();
        if !log::log_enabled!(level) {
            return;
        }
        let (lines, dropped) = self.log();
        let model = &self.fmu.description().model_name;
        if dropped > 0 {
            log::log!(level, "{model}: {dropped} other log lines were dropped");
        }
        for line in lines {
            log::log!(level, "{model}: {line}");
        }
    }

    /// Switches logging on or off. If `categories` is empty, all categories are selected.
    pub(crate) fn set_logging(&mut self, on: bool, categories: &[String]) -> Result<()> {
        let model = self.fmu.description();
        let declared = || model.log_categories.iter().map(|category| &category.name);
        // FMI 1.0 does not declare categories.
        let is_unknown =
            |name: &&String| model.fmi_version.major > 1 && !declared().any(|declared| declared == *name);
        if let Some(name) = categories.iter().find(is_unknown) {
            let available: Vec<&str> = declared().map(String::as_str).collect();
            let problem =
                format!("unknown log category \"{name}\"; expected one of: {}", available.join(", "));
            return Err(FmiError::BadSetting(problem));
        }
        self.raw.keep_log_categories(categories);
        let names: Vec<CString> =
            categories.iter().filter_map(|name| CString::new(name.as_str()).ok()).collect();
        self.call(|raw| raw.set_debug_logging(on, &names))
    }

    /// Sets values, one call per type.
    pub(crate) fn apply(&mut self, values: &Assignments) -> Result<()> {
        let Assignments { reals, packed, strings, binaries } = values;
        self.set_reals(&reals.0, &reals.1)?;
        for (kind, references, words) in packed {
            self.raw
                .set_packed(*kind, references, words)
                .map_err(|fault| self.error_about(fault, references, |other| other == *kind))?;
        }
        if !strings.0.is_empty() {
            self.raw
                .set_string(&strings.0, &strings.1)
                .map_err(|fault| self.error_about(fault, &strings.0, |kind| kind == VariableKind::String))?;
        }
        if !binaries.0.is_empty() {
            self.raw
                .set_binary(&binaries.0, &binaries.1)
                .map_err(|fault| self.error_about(fault, &binaries.0, |kind| kind == VariableKind::Binary))?;
        }
        Ok(())
    }

    /// Sets the values of structural parameters, in configuration mode and before all other values. Updates
    /// the sizes of the model's vectors accordingly.
    pub(crate) fn configure(&mut self, values: &Assignments, structure: &Structure) -> Result<()> {
        if !values.is_empty() {
            self.call(RawInstance::enter_configuration)?;
            let applied = self.apply(values);
            let left = self.call(RawInstance::exit_configuration);
            // The error in the values takes precedence. After an error the instance keeps its previous
            // structure.
            applied.and(left)?;
        }
        self.restructure(structure);
        Ok(())
    }

    /// Updates the sizes of the model's vectors for new structural parameters.
    pub(super) fn restructure(&mut self, structure: &Structure) {
        self.structure.clone_from(structure);
        let model = self.fmu.description();
        self.raw
            .set_sizes(Sizes { states: structure.states(model), indicators: structure.indicators(model) });
    }

    /// Compares the sizes in the description with the sizes that the FMU reports.
    pub(crate) fn check_sizes(&mut self) -> Result<()> {
        let model = self.fmu.description();
        let promised =
            Sizes { states: self.structure.states(model), indicators: self.structure.indicators(model) };
        match self.call(RawInstance::ask_sizes)? {
            Some(found) if found != promised => Err(FmiError::BadSetting(format!(
                "the model description declares {} states and {} event indicators, but the FMU has {} and {}",
                promised.states, promised.indicators, found.states, found.indicators
            ))),
            _ => Ok(()),
        }
    }

    /// Sets real variables.
    pub(crate) fn set_reals(&mut self, references: &[u32], values: &[f64]) -> Result<()> {
        if references.is_empty() && values.is_empty() {
            return Ok(());
        }
        self.raw
            .set_real(references, values)
            .map_err(|fault| self.error_about(fault, references, |kind| kind == VariableKind::Real))
    }

    /// Returns an error if a value reference does not belong to a variable of type Real or the number of
    /// values is wrong. If a reference may belong to an array, only the description contains the number of
    /// its elements.
    #[inline]
    pub(crate) fn check_reals(&self, call: &'static str, references: &[u32], found: usize) -> Result<()> {
        self.fmu.check_real_references(call, references)?;
        let model = self.fmu.description();
        let expected = if model.has_arrays {
            let variables = references.iter().filter_map(|reference| self.fmu.real_variable(*reference));
            variables.map(|variable| self.structure.elements(model, variable)).sum()
        } else {
            references.len()
        };
        if expected == found { Ok(()) } else { Err(FmiError::Length { call, expected, found }) }
    }

    /// Returns the number of elements of an array, or `None` for a scalar.
    pub(crate) fn elements(&self, variable: &Variable) -> Option<usize> {
        let is_array = !variable.dimensions.is_empty();
        is_array.then(|| self.structure.elements(self.fmu.description(), variable))
    }

    /// Reads a variable.
    pub(crate) fn value(&mut self, variable: &Variable) -> Result<Value> {
        let references = [variable.value_reference];
        let kind = variable.kind;
        let elements = self.elements(variable);
        let n = elements.unwrap_or(1);
        let read = match kind {
            VariableKind::Real => {
                let mut values = vec![0.0; n];
                let read = self.raw.get_real(&references, &mut values);
                read.map(|()| values.into_iter().map(Value::Real).collect())
            }
            VariableKind::String => {
                let mut values = Vec::with_capacity(n);
                let read = self.raw.get_string(&references, n, |text| values.push(text.into()));
                read.map(|()| values)
            }
            VariableKind::Binary => {
                let mut values = Vec::with_capacity(n);
                let most = |_| variable.max_size;
                let read = self
                    .raw
                    .get_binary(&references, n, most, |bytes| values.push(Value::Binary(bytes.to_vec())));
                read.map(|()| values)
            }
            kind => {
                let mut values = vec![0; n];
                let read = self.raw.get_packed(kind, &references, &mut values);
                read.map(|()| {
                    values.into_iter().map(|word| integer_codec::value(kind, word)).collect::<Vec<Value>>()
                })
            }
        };
        let mut values = read.map_err(|fault| self.error_about(fault, &references, |other| other == kind))?;
        let value = match (elements, values.pop()) {
            (None, Some(value)) => value,
            (_, last) => {
                values.extend(last);
                Value::Array(values)
            }
        };
        Ok(if variable.negated { assignments::negate(value) } else { value })
    }

    /// Makes a raw call and converts its fault to an error.
    pub(crate) fn call<T>(&mut self, call: impl FnOnce(&mut RawInstance) -> Result<T, Fault>) -> Result<T> {
        call(&mut self.raw).map_err(|fault| self.error(fault))
    }
}

/// Replaces `#r12#` (type letter and value reference) by the name of the variable, and `##` by `#` (FMI
/// 2.0.x, section 2.1.5). All other text stays unchanged.
fn expand_references(text: &str, description: &ModelDescription) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find('#') {
        out.push_str(&rest[..at]);
        let after = &rest[at + 1..];
        let replaced = after.find('#').and_then(|end| {
            let inner = &after[..end];
            let name = if inner.is_empty() { Some("#") } else { referenced(inner, description) };
            name.map(|name| (name, end))
        });
        if let Some((name, end)) = replaced {
            out.push_str(name);
            rest = &after[end + 1..];
        } else {
            out.push('#');
            rest = after;
        }
    }
    out.push_str(rest);
    out
}

/// Returns the variable name for a reference such as `r12`.
fn referenced<'a>(inner: &str, description: &'a ModelDescription) -> Option<&'a str> {
    let mut chars = inner.chars();
    let letter = chars.next()?;
    let reference: u32 = chars.as_str().parse().ok()?;
    description
        .variables
        .iter()
        .find(|variable| variable.value_reference == reference && letter_of(variable.kind) == letter)
        .map(|variable| variable.name.as_str())
}

fn letter_of(kind: VariableKind) -> char {
    match kind {
        VariableKind::Real => 'r',
        VariableKind::Boolean => 'b',
        VariableKind::String => 's',
        // Types of FMI 3.0 cannot occur, because FMI 3.0 messages contain no references.
        _ => 'i',
    }
}
