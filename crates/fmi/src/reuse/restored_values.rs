//! What was ever set in a loaded copy of a library. Some tools keep parameters in static variables, which neither reset nor a
//! new instance renews (Simulink): so before each run every variable that was ever set in the copy is set again, to its wanted
//! value or to what a new instance answers in which nothing was set.

use super::copies::{Defaults, SetKey};
use super::copy_use::CopyRequest;
use super::lend::CopyLease;
use super::runner::{Prepared, Runner};
use super::store::CopyStore;
use crate::description::{Causality, QuirkKind, Structure, Variable};
use crate::error::FmiError;
use crate::fmu::Fmu;
use crate::instance::Core;
use crate::instance::assignments::{check_settable_at_start, convert};
use crate::simulation::Sharing;
use crate::simulation::plan::Setting;
use crate::simulation::variable_elements::Unset;
use crate::sys::{CallEnvironment, Experiment, InterfaceKind, Library, RawInstance};
use std::collections::HashMap;
use std::sync::Arc;

impl Runner {
    /// Finds out what is to be set in the present copy besides the settings of the plan; nothing to do where both are known.
    pub(crate) fn prepare(&mut self) -> Result<(), FmiError> {
        let Some(lease) = &self.lease else { return Ok(()) };
        let n_recorded = lease.copy().record().keys().len();
        if self.prepared.as_ref().is_some_and(|prepared| prepared.n_recorded == n_recorded) {
            return Ok(());
        }
        let without = self.prepare_in_copy()?;
        if without.is_empty() {
            return Ok(());
        }
        // There is no way back for these: another copy, in which they were not set.
        let (plan, fmu) = (Arc::clone(&self.plan), self.plan.fmu().clone());
        let store = fmu.store(plan.kind)?;
        let other = store.lend_if_free(&self.request(), |copy| !copy.record().has_any(&without));
        if let Some(other) = other {
            self.release_copy();
            self.lease = Some(other);
            self.prepare_in_copy()?;
            return Ok(());
        }
        let model = fmu.description();
        let is_meant = |v: &&Variable| without.contains(&(v.kind, v.value_reference));
        let names: Vec<&str> = model.variables.iter().filter(is_meant).map(|v| &*v.name).collect();
        let message = format!(
            "earlier simulations in this process have set {}, what it is in a new instance is not known, and there is no \
             other copy of the library: where the model keeps it, it still has that value",
            names.join(", ")
        );
        fmu.note_quirk(QuirkKind::Promise, message);
        Ok(())
    }

    /// The variables that were set in the present copy, that the plan does not set, and for which there is no value.
    #[cold]
    fn prepare_in_copy(&mut self) -> Result<Vec<SetKey>, FmiError> {
        let plan = Arc::clone(&self.plan);
        let Some(lease) = &self.lease else { return Ok(Vec::new()) };
        let store = Arc::clone(lease.store());
        let wanted = keys_of(&plan.settings);
        let is_known = |key: &SetKey| store.defaults().contains_key(key);
        let recorded = lease.copy().record().keys().to_vec();
        // Where there is no other copy to ask later, this one is asked before anything is set.
        let new = |key: &&SetKey| recorded.binary_search(key).is_err() && !is_known(key);
        let new: Vec<SetKey> = wanted.iter().filter(new).copied().collect();
        let may_ask_later = plan.sharing == Sharing::Copies && store.may_copy();
        if !new.is_empty() && !may_ask_later {
            lease.copy().free_idle();
            let defaults = read_defaults(plan.fmu(), plan.kind, lease.library(), &new);
            store.defaults().extend(defaults);
        }
        let unset: Vec<SetKey> =
            recorded.iter().filter(|key| wanted.binary_search(key).is_err()).copied().collect();
        let unknown: Vec<SetKey> = unset.iter().filter(|key| !is_known(key)).copied().collect();
        if !unknown.is_empty() {
            let fmu = plan.fmu();
            let request = CopyRequest { owner: None, ..self.request() };
            learn(fmu, &store, &request, &unknown);
        }
        let (values, without) = unset_values(plan.fmu(), plan.structure(), &unset, &store.defaults());
        let n_recorded = {
            let mut record = lease.copy().record();
            record.note(wanted);
            record.keys().len()
        };
        let settings = with_keys(&plan.settings, &unset);
        self.engine.running().unset = values;
        self.prepared = Some(Prepared { n_recorded, settings });
        Ok(without)
    }
}

/// Finds out what these variables are in a new instance: in a copy where they were never set, if there is one to be had.
fn learn(fmu: &Fmu, store: &Arc<CopyStore>, request: &CopyRequest, keys: &[SetKey]) {
    let defaults = match store.lend_if_free(request, |copy| !copy.record().has_any(keys)) {
        Some(other) => {
            other.copy().free_idle();
            read_defaults(fmu, request.kind, other.library(), keys)
        }
        None => described_defaults(fmu, keys),
    };
    store.defaults().extend(defaults);
}

/// Sets in a new instance that is made by hand what was set in its copy before; whether all of it could be.
pub(crate) fn set_again(core: &mut Core, kind: InterfaceKind, lease: &CopyLease) -> bool {
    let fmu = core.fmu().clone();
    let recorded = lease.copy().record().keys().to_vec();
    if recorded.is_empty() {
        return true;
    }
    let store = lease.store();
    let unknown: Vec<SetKey> =
        recorded.iter().filter(|key| !store.defaults().contains_key(*key)).copied().collect();
    if !unknown.is_empty() {
        let request = CopyRequest::for_good(&fmu, kind);
        learn(&fmu, store, &request, &unknown);
    }
    let (unset, without) = unset_values(&fmu, &Structure::default(), &recorded, &store.defaults());
    let mut set = || {
        if !unset.structural.is_empty() {
            core.configure(&unset.structural, &Structure::default())?;
        }
        core.apply(&unset.early)?;
        core.apply(&unset.inputs)
    };
    set().is_ok() && without.is_empty()
}

/// The variables that a plan sets, sorted.
fn keys_of(settings: &[Setting]) -> Vec<SetKey> {
    let mut keys: Vec<SetKey> = settings.iter().map(|(_, kind, reference)| (*kind, *reference)).collect();
    keys.sort_unstable();
    keys.dedup();
    keys
}

/// The settings of a plan, and these variables.
fn with_keys(settings: &Arc<[Setting]>, keys: &[SetKey]) -> Arc<[Setting]> {
    if keys.is_empty() {
        return Arc::clone(settings);
    }
    let mut all = settings.to_vec();
    all.extend(keys.iter().map(|(kind, reference)| (true, *kind, *reference)));
    all.sort_unstable();
    all.dedup();
    all.into()
}

/// The variables of the description behind these keys (sorted), as far as they can be set.
fn variables<'a>(fmu: &'a Fmu, keys: &[SetKey]) -> HashMap<SetKey, &'a Variable> {
    let mut found = HashMap::with_capacity(keys.len());
    for variable in &fmu.description().variables {
        let key = (variable.kind, variable.value_reference);
        if keys.binary_search(&key).is_ok() && check_settable_at_start(variable).is_ok() {
            found.entry(key).or_insert(variable);
        }
    }
    found
}

/// What an instance of this library, which is new, answers for these variables; where it does not answer, their start values in
/// the description.
fn read_defaults(fmu: &Fmu, kind: InterfaceKind, library: &Arc<Library>, keys: &[SetKey]) -> Defaults {
    let variables = variables(fmu, keys);
    let mut core = initialized(fmu, kind, library).ok();
    let _environment = CallEnvironment::enter();
    let mut value = |key: &SetKey| {
        let variable = variables.get(key)?;
        let answer = core.as_mut().and_then(|core| core.value(variable).ok());
        answer.or_else(|| variable.start.clone())
    };
    keys.iter().map(|key| (*key, value(key))).collect()
}

/// The start values of the description for these variables.
fn described_defaults(fmu: &Fmu, keys: &[SetKey]) -> Defaults {
    let variables = variables(fmu, keys);
    let start = |key: &SetKey| variables.get(key).and_then(|variable| variable.start.clone());
    keys.iter().map(|key| (*key, start(key))).collect()
}

/// A new instance in which nothing was set, where values can be read: in initialization mode, in FMI 1.0 after the
/// initialization.
fn initialized(fmu: &Fmu, kind: InterfaceKind, library: &Arc<Library>) -> Result<Core, FmiError> {
    let raw = fmu.instantiate_for_runs(library, kind)?;
    let _environment = CallEnvironment::enter();
    let mut core = Core::new(raw, fmu.clone());
    let start = fmu.description().default_experiment.start_time.unwrap_or(0.0);
    let experiment = Experiment { tolerance: None, start, stop: None };
    core.call(|raw| raw.setup_experiment(&experiment))?;
    core.call(RawInstance::enter_initialization)?;
    if fmu.description().fmi_version.major < 2 {
        core.call(RawInstance::exit_initialization)?;
    }
    Ok(core)
}

/// The settings that bring these variables back, and those for which there is no value that fits.
fn unset_values(
    fmu: &Fmu,
    structure: &Structure,
    keys: &[SetKey],
    defaults: &Defaults,
) -> (Unset, Vec<SetKey>) {
    let (model, variables) = (fmu.description(), variables(fmu, keys));
    let (mut unset, mut without) = (Unset::default(), Vec::new());
    for key in keys {
        let mut set = || {
            let (variable, value) = (variables.get(key)?, defaults.get(key)?.as_ref()?);
            let list = match variable.causality {
                Causality::StructuralParameter => &mut unset.structural,
                Causality::Input => &mut unset.inputs,
                _ => &mut unset.early,
            };
            let is_array = !variable.dimensions.is_empty();
            let elements = is_array.then(|| structure.elements(model, variable));
            // Checked before: what does not fit leaves a reference without a value.
            convert(variable, value, elements).ok()?;
            list.push(variable, value, elements).ok()
        };
        if set().is_none() {
            without.push(*key);
        }
    }
    (unset, without)
}
