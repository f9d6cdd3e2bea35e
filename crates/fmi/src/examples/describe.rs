//! Model descriptions of the bundled models for other interfaces, written from the one that lies beside the model's
//! source (FMI 2.0 model exchange).

use super::ExampleKind;

/// `modelDescription.xml` of a model in another form; `original` is that of FMI 2.0 model exchange.
pub(super) fn description(original: &str, kind: ExampleKind) -> String {
    match kind {
        ExampleKind::Fmi2ModelExchange => original.to_owned(),
        ExampleKind::Fmi2CoSimulation => as_co_simulation(original),
    }
}

/// The same description with the other interface.
fn as_co_simulation(original: &str) -> String {
    original
        .replace("<ModelExchange", "<CoSimulation\n    canHandleVariableCommunicationStepSize=\"true\"\n    canInterpolateInputs=\"true\"")
        .replace("</ModelExchange>", "</CoSimulation>")
        .replace("    completedIntegratorStepNotNeeded=\"true\"\n", "")
        .replace("fmi2_me.c", "fmi2_cs.c")
}
