//! What a run does when a co-simulation calls back during a step: inputs at the instant the model has reached, and an end
//! of the step where the run is to end (FMI 3.0.x, section 4.2.2).

use crate::input::{InputPlan, InputState};
use crate::sys::{MidStep, Update};

/// The answers during one step.
pub(crate) struct Between<'a, F> {
    pub(crate) plan: &'a InputPlan,
    pub(crate) inputs: &'a mut InputState,
    /// Values on their way.
    pub(crate) values: &'a mut Vec<f64>,
    /// Whether the run is to go on.
    pub(crate) goes_on: F,
}

impl<F: Fn() -> bool + Send> MidStep for Between<'_, F> {
    fn update(&mut self, update: &Update, set: &mut dyn FnMut(&[u32], &[f64])) -> bool {
        let (places, references) = &self.plan.intermediate;
        // What is not finite is said at the next communication point.
        if update.set_requested && !places.is_empty() && self.inputs.continuous_at(self.plan, update.time) {
            self.values.clear();
            self.values.extend(places.iter().map(|place| self.inputs.continuous[*place]));
            set(references, self.values);
        }
        !(self.goes_on)()
    }
}
