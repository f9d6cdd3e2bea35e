//! Terminals: variables that are connected to those of another model together (FMI 3.0.x, section 2.4.9).

/// Variables that belong to one connector of the model.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Terminal {
    /// Its name, unique on its level.
    pub name: String,
    /// Rule by which members of two connected terminals are paired: `plug`, `bus`, `sequence`, or a name with
    /// a domain.
    pub matching_rule: String,
    /// Kind of connector, as a name with a domain.
    pub kind: Option<String>,
    /// Description.
    pub description: Option<String>,
    /// Its variables, in the order of the file.
    pub members: Vec<TerminalMember>,
    /// Its variables that are transported with a flow.
    pub stream_members: Vec<StreamMember>,
    /// Terminals inside of it.
    pub terminals: Vec<Terminal>,
    /// Where and how it is drawn.
    pub icon: Option<TerminalIcon>,
}

/// A variable of a terminal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TerminalMember {
    /// Name of the variable in the model description.
    pub variable: String,
    /// Kind of connection: `signal` (equal), `inflow` or `outflow` (sum is zero), or a name with a domain.
    pub kind: String,
    /// Its name in the terminal.
    pub name: Option<String>,
}

/// A pair of variables that stand for a property of what flows through a terminal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StreamMember {
    /// Name of the variable for flow into the model.
    pub inflow_variable: String,
    /// Name of the variable for flow out of the model.
    pub outflow_variable: String,
    /// Name of the first in the terminal.
    pub inflow_name: Option<String>,
    /// Name of the second in the terminal.
    pub outflow_name: Option<String>,
}

/// Where a terminal is drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct TerminalIcon {
    /// Name of the image in the folder `terminalsAndIcons/`.
    pub file: Option<String>,
    /// Lower left and upper right corner in the coordinates of the model's icon: x1, y1, x2, y2; NaN where
    /// the file does not say.
    pub corners: [f64; 4],
}
