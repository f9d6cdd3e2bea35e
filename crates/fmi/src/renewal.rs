//! New instances for runs, and old ones brought back to their beginning.

use crate::error::FmiError;
use crate::fmu::Reuse;
use crate::instance;
use crate::plan::SimulationPlan;
use crate::sys::{Library, RawInstance};
use std::sync::Arc;

/// A new instance; where saved states bring instances back, with the state to bring back.
pub(crate) fn new_instance(plan: &SimulationPlan, library: &Arc<Library>) -> Result<RawInstance, FmiError> {
    if plan.reuse() == Some(Reuse::Restore) {
        return new_with_origin(plan, library);
    }
    plan.fmu().instantiate_for_runs(library, plan.kind)
}

/// A new instance with its state saved, unless the FMU refuses that: then it is not asked again.
pub(crate) fn new_with_origin(
    plan: &SimulationPlan,
    library: &Arc<Library>,
) -> Result<RawInstance, FmiError> {
    let new = || plan.fmu().instantiate_for_runs(library, plan.kind);
    let mut raw = new()?;
    if raw.save_origin().is_err() {
        plan.refuse_restore();
        drop(raw);
        return new();
    }
    Ok(raw)
}

/// Brings an instance back to its beginning, or makes a new one where that fails; and whether it was used before.
pub(crate) fn renew_or_replace(
    used: RawInstance,
    plan: &SimulationPlan,
    library: &Arc<Library>,
    reuse: Reuse,
) -> Result<(RawInstance, bool), FmiError> {
    if reuse == Reuse::Restore && !used.has_origin() {
        drop(used);
        return Ok((new_instance(plan, library)?, false));
    }
    if let Ok(raw) = instance::renew(used, plan.fmu(), reuse) {
        return Ok((raw, true));
    }
    match reuse {
        Reuse::Restore => plan.refuse_restore(),
        _ => plan.set_reuse(Reuse::Reinstantiate),
    }
    Ok((new_instance(plan, library)?, false))
}
