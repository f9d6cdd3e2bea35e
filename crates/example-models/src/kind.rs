//! Versions and interfaces of the examples, and the front end of each.

/// Names and contents of front-end files.
macro_rules! frontend {
    [$($name:literal),+] => {
        [$(($name, include_str!(concat!("../models/frontend/", $name)))),+]
    };
}

/// Version and interface of an example.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ExampleKind {
    /// FMI 1.0 for model exchange.
    Fmi1ModelExchange,
    /// FMI 1.0 for co-simulation.
    Fmi1CoSimulation,
    /// FMI 2.0 model exchange.
    Fmi2ModelExchange,
    /// FMI 2.0 co-simulation.
    Fmi2CoSimulation,
    /// FMI 3.0 for model exchange and co-simulation in one file.
    Fmi3,
}

impl ExampleKind {
    /// All kinds.
    pub const ALL: [ExampleKind; 5] = [
        ExampleKind::Fmi1ModelExchange,
        ExampleKind::Fmi1CoSimulation,
        ExampleKind::Fmi2ModelExchange,
        ExampleKind::Fmi2CoSimulation,
        ExampleKind::Fmi3,
    ];

    /// Returns the suffix that follows the model's name in the file name.
    pub(crate) fn suffix(self) -> &'static str {
        match self {
            ExampleKind::Fmi1ModelExchange => "-fmi1-me",
            ExampleKind::Fmi1CoSimulation => "-fmi1-cs",
            ExampleKind::Fmi2ModelExchange => "",
            ExampleKind::Fmi2CoSimulation => "-fmi2-cs",
            ExampleKind::Fmi3 => "-fmi3",
        }
    }

    /// Returns the files that make an FMU from a model. The first one is compiled; see `models/readme.md`.
    pub(crate) fn frontend(self) -> &'static [(&'static str, &'static str)] {
        match self {
            ExampleKind::Fmi2CoSimulation => {
                &frontend!["fmi2_cs.c", "fmi2.h", "fmi2_common.h", "solver.h", "instance.h", "model.h"]
            }
            ExampleKind::Fmi2ModelExchange => {
                &frontend!["fmi2_me.c", "fmi2.h", "fmi2_common.h", "instance.h", "model.h"]
            }
            ExampleKind::Fmi1ModelExchange => {
                &frontend!["fmi1_me.c", "fmi1.h", "fmi1_common.h", "instance.h", "model.h"]
            }
            ExampleKind::Fmi1CoSimulation => {
                &frontend!["fmi1_cs.c", "fmi1.h", "fmi1_common.h", "solver.h", "instance.h", "model.h"]
            }
            ExampleKind::Fmi3 => &frontend!["fmi3.c", "fmi3.h", "solver.h", "instance.h", "model.h"],
        }
    }
}
