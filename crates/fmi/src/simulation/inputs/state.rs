//! Input state of a run: the jumps that have occurred, and the values for the next calls.

use super::plan::{HeldSlots, InputPlan, Target};
use crate::error::{FmiError, Result};
use crate::instance::Core;
use ode::Stopwatch;

/// Input state of a run: the jumps that have occurred, and the values for the next calls.
#[derive(Debug, Default)]
pub(crate) struct InputState {
    /// Number of jumps that have occurred.
    passed: usize,
    cursors: Vec<usize>,
    pub(crate) continuous: Vec<f64>,
    held_inputs: HeldValues,
    parameters: HeldValues,
    /// Time in the user's functions since the start, in seconds. It is a sum over all calls. Each call adds
    /// its known time when it ends, so differences of this value are also meaningful.
    in_functions: f64,
    /// All function calls at one time count as one call, because one function may do the work for the others.
    stopwatch: Stopwatch<1>,
}

/// Values of variables that are held between rows.
#[derive(Debug, Default)]
struct HeldValues {
    reals: Vec<f64>,
    /// Words, by the groups of the plan.
    packed: Vec<Vec<i64>>,
    /// Index of the current value of each string input.
    texts: Vec<usize>,
}

impl HeldValues {
    fn new(slots: &HeldSlots) -> Self {
        Self {
            reals: slots.reals.start.clone(),
            packed: slots.packed.iter().map(|(_, slots)| slots.start.clone()).collect(),
            texts: vec![0; slots.texts.len()],
        }
    }

    /// Sets the variables, one call per type.
    fn set(&self, core: &mut Core, slots: &HeldSlots) -> Result<()> {
        core.set_reals(&slots.reals.references, &self.reals)?;
        for ((kind, slots), words) in slots.packed.iter().zip(&self.packed) {
            core.call(|raw| raw.set_packed(*kind, &slots.references, words))?;
        }
        for (text, number) in slots.texts.iter().zip(&self.texts) {
            text.set(core, *number)?;
        }
        Ok(())
    }
}

impl InputState {
    /// Creates buffers of the required sizes.
    pub(crate) fn new(plan: &InputPlan) -> Self {
        Self {
            passed: 0,
            cursors: vec![0; plan.linear.len()],
            continuous: plan.continuous.start().to_vec(),
            held_inputs: HeldValues::new(&plan.held_inputs),
            parameters: HeldValues::new(&plan.parameters),
            in_functions: 0.0,
            stopwatch: Stopwatch::new(),
        }
    }

    /// Returns the time in the user's functions since the start, in seconds. It is an estimate if the
    /// functions are fast; see [`Stopwatch`](ode::Stopwatch).
    pub(crate) fn seconds_in_functions(&self) -> f64 {
        self.in_functions
    }

    /// Resets the state to the start of a run: jumps up to `t` have occurred.
    pub(crate) fn begin(&mut self, plan: &InputPlan, t: f64) {
        self.in_functions = 0.0;
        self.stopwatch.reset();
        self.passed = 0;
        self.cursors.fill(0);
        self.pass(plan, t);
    }

    /// Applies the jumps up to `t` and updates the held values. Returns true if a jump occurred.
    pub(crate) fn pass(&mut self, plan: &InputPlan, t: f64) -> bool {
        let before = self.passed;
        let happened = plan.jumps.partition_point(|jump| *jump <= t + plan.time_tolerance);
        self.passed = self.passed.max(happened);
        let now = match self.passed.checked_sub(1).and_then(|last| plan.jumps.get(last)) {
            Some(jump) => jump.max(t),
            None => t,
        };
        for held in &plan.held {
            let (values, slots) = match held.is_parameter {
                true => (&mut self.parameters, &plan.parameters),
                false => (&mut self.held_inputs, &plan.held_inputs),
            };
            match held.target {
                Target::Real(i) => values.reals[i] = held.column.column.held(now),
                Target::Packed(group, i) => {
                    values.packed[group][i] = held.column.word(slots.packed[group].0, now);
                }
                Target::Text(i) => values.texts[i] = held.column.column.held(now) as usize,
            }
        }
        self.passed > before
    }

    /// Computes the continuous inputs at `t`. Returns false if one is not finite. The piece before a jump is
    /// used until the jump has occurred ([`pass`](Self::pass)), even for times slightly after it.
    pub(crate) fn continuous_at(&mut self, plan: &InputPlan, t: f64) -> bool {
        let next = plan.jumps.get(self.passed).copied().unwrap_or(f64::INFINITY);
        let last = self.passed.checked_sub(1).map_or(f64::NEG_INFINITY, |i| plan.jumps[i]);
        let (at, left) = if t >= next { (next, true) } else { (t.max(last), false) };
        for ((column, place), cursor) in plan.linear.iter().zip(&mut self.cursors) {
            self.continuous[*place] = column.linear(at, left, cursor);
        }
        if !plan.functions.is_empty() {
            let timing = self.stopwatch.start(0);
            for (function, sign, place) in &plan.functions {
                self.continuous[*place] = sign * function.value(t);
            }
            self.in_functions += self.stopwatch.stop(timing);
        }
        self.continuous.iter().all(|value| value.is_finite())
    }
}

impl InputState {
    /// Sets the held inputs.
    pub(crate) fn set_held(&self, core: &mut Core, plan: &InputPlan) -> Result<()> {
        self.held_inputs.set(core, &plan.held_inputs)
    }

    /// Sets the tunable parameters, before the initialization and after each jump.
    pub(crate) fn set_parameters(&self, core: &mut Core, plan: &InputPlan) -> Result<()> {
        self.parameters.set(core, &plan.parameters)
    }

    /// Returns the error for a value that [`continuous_at`](Self::continuous_at) has rejected.
    pub(crate) fn bad_function_value(&self, t: f64) -> FmiError {
        let bad = self.continuous.iter().find(|value| !value.is_finite());
        let value = bad.copied().unwrap_or(f64::NAN);
        FmiError::NotFinite { name: format!("input function at t = {t}"), value }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::input_table::InputTable;
    use crate::simulation::inputs::InputFunction;
    use crate::simulation::inputs::plan::Held;
    use crate::simulation::variable_elements::FloatSlots;

    fn column(times: &[f64], values: &[f64]) -> InputTable {
        InputTable { times: times.into(), values: values.into() }
    }

    fn plan_of(linear: Vec<InputTable>, held: Vec<InputTable>) -> InputPlan {
        let mut plan = InputPlan { time_tolerance: 1e-14, ..InputPlan::default() };
        let mut stops = Vec::new();
        linear.iter().for_each(|c| c.linear_stops(plan.time_tolerance, &mut stops));
        held.iter().for_each(|c| c.held_stops(&mut stops));
        plan.held_inputs.reals.start = vec![0.0; held.len()];
        plan.continuous = FloatSlots::of_zeros(linear.len());
        plan.linear = linear.into_iter().zip(0..).collect();
        plan.held = held
            .into_iter()
            .enumerate()
            .map(|(i, column)| Held { column: column.into(), is_parameter: false, target: Target::Real(i) })
            .collect();
        plan.take_stops(stops);
        plan
    }

    #[test]
    fn continuous_at_uses_the_piece_before_a_jump_until_it_has_passed() {
        let plan = plan_of(
            vec![column(&[0.0, 1.0, 1.0, 2.0], &[0.0, 1.0, 5.0, 5.0])],
            vec![column(&[0.0, 1.0, 1.5], &[7.0, 8.0, 9.0])],
        );
        let mut state = InputState::new(&plan);
        state.begin(&plan, 0.0);
        assert_eq!(state.held_inputs.reals, [7.0]);
        for (t, u) in [(0.5, 0.5), (1.0, 1.0), (1.5, 1.0)] {
            assert!(state.continuous_at(&plan, t));
            assert_eq!(state.continuous, [u], "t = {t}");
        }
        state.pass(&plan, 1.0);
        assert_eq!(state.held_inputs.reals, [8.0]);
        state.continuous_at(&plan, 1.0);
        assert_eq!(state.continuous, [5.0]);
        state.pass(&plan, 1.5);
        assert_eq!(state.held_inputs.reals, [9.0]);
    }

    #[test]
    fn take_stops_merges_jumps_within_rounding() {
        let near = 0.1 + 0.2; // 0.30000000000000004
        let plan = plan_of(
            vec![column(&[0.0, 0.3, 0.3, 1.0], &[0.0, 1.0, 5.0, 5.0])],
            vec![column(&[0.0, near], &[7.0, 8.0])],
        );
        assert_eq!(plan.jumps, [near]);
        let mut state = InputState::new(&plan);
        state.begin(&plan, 0.0);
        state.continuous_at(&plan, near);
        assert_eq!(state.continuous, [1.0]);
        state.pass(&plan, 0.3);
        state.continuous_at(&plan, 0.3);
        assert_eq!((state.continuous[0], state.held_inputs.reals[0]), (5.0, 8.0));
        assert_eq!(plan.next_stop(0.3), None);
        assert_eq!(plan.next_stop(0.0).map(|stop| (stop.time, stop.jump)), Some((near, true)));
    }

    #[test]
    fn seconds_in_functions_sums_all_calls_since_the_start() {
        let mut plan = plan_of(vec![column(&[0.0, 1.0], &[0.0, 1.0])], vec![]);
        let mut state = InputState::new(&plan);
        state.continuous_at(&plan, 0.5);
        assert_eq!(state.seconds_in_functions(), 0.0);
        let slowly = |t| {
            std::thread::sleep(std::time::Duration::from_millis(2));
            2.0 * t
        };
        plan.continuous = FloatSlots::of_zeros(3);
        plan.functions = vec![(InputFunction::new(|t| t), -1.0, 1), (InputFunction::new(slowly), 1.0, 2)];
        let mut state = InputState::new(&plan);
        let mut before = 0.0;
        for t in [0.0, 0.5, 0.25] {
            assert!(state.continuous_at(&plan, t));
            assert_eq!(state.continuous, [t, -t, 2.0 * t]);
            assert!(state.seconds_in_functions() >= before + 0.00199);
            before = state.seconds_in_functions();
        }
        state.begin(&plan, 0.0);
        assert_eq!(state.seconds_in_functions(), 0.0);
    }

    #[test]
    fn begin_passes_a_jump_at_the_start() {
        let plan = plan_of(vec![column(&[0.0, 0.0, 1.0], &[1.0, 2.0, 2.0])], vec![]);
        let mut state = InputState::new(&plan);
        state.begin(&plan, 0.0);
        state.continuous_at(&plan, 0.0);
        assert_eq!(state.continuous, [2.0]);
    }
}
