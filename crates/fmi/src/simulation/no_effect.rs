//! Settings that a simulation would ignore.

use crate::simulation::options::SimulateOptions;
use crate::sys::InterfaceKind;
use ode::{Method, Number};

impl SimulateOptions {
    /// Settings that have no effect with this interface, with the reason; one sentence each.
    pub fn without_effect(&self, kind: InterfaceKind) -> Vec<String> {
        let (method, integrates) = (self.method, kind == InterfaceKind::ModelExchange);
        let mut found = Vec::new();
        if !integrates && method != Method::Auto {
            found.push(format!(
                "solver '{}' has no effect in co-simulation: the model integrates itself",
                method.name()
            ));
        }
        if let Some(step) = self.step_size.filter(|_| integrates && !method.is_fixed_step()) {
            found.push(format!(
                "step_size = {} has no effect with the solver '{}', which chooses its steps itself; max_step limits them",
                Number(step),
                method.name()
            ));
        }
        match self.max_step.map(Number) {
            Some(step) if !integrates => found.push(format!(
                "max_step = {step} has no effect in co-simulation: the model integrates itself; step_size is the \
                 communication step"
            )),
            Some(step) if method.is_fixed_step() => found.push(format!(
                "max_step = {step} has no effect with the solver '{}': all its steps are step_size",
                method.name()
            )),
            _ => {}
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_ignored_is_said() {
        let both = |method| SimulateOptions::new().method(method).step_size(0.1).max_step(0.2);
        for (method, kind, expected) in [
            (
                Method::Tsit5,
                InterfaceKind::ModelExchange,
                &["step_size = 0.1 has no effect with the solver 'tsit5'"][..],
            ),
            (
                Method::Rk4,
                InterfaceKind::ModelExchange,
                &["max_step = 0.2 has no effect with the solver 'rk4'"],
            ),
            (Method::Auto, InterfaceKind::CoSimulation, &["max_step = 0.2 has no effect in co-simulation"]),
            (Method::Bdf, InterfaceKind::CoSimulation, &["solver 'bdf' has no effect", "max_step = 0.2"]),
        ] {
            let found = both(method).without_effect(kind);
            assert_eq!(found.len(), expected.len(), "{found:?}");
            assert!(found.iter().zip(expected).all(|(found, start)| found.starts_with(start)), "{found:?}");
        }
    }
}
