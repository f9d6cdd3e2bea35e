//! Terminals: groups of variables that are connected to another model together (FMI 3.0.x, section 2.4.9).

/// Group of variables that form one connector of the model.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Terminal {
    /// Name, unique on its level.
    pub name: String,
    /// Rule that pairs the members of two connected terminals: `plug`, `bus`, `sequence`, or a name with a
    /// domain prefix.
    pub matching_rule: String,
    /// Kind of connector, as a name with a domain prefix.
    pub kind: Option<String>,
    /// Description.
    pub description: Option<String>,
    /// Variables of the terminal, in file order.
    pub members: Vec<TerminalMember>,
    /// Variables that a flow transports.
    pub stream_members: Vec<StreamMember>,
    /// Nested terminals.
    pub terminals: Vec<Terminal>,
    /// Graphical representation.
    pub icon: Option<TerminalIcon>,
}

/// Variable of a terminal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TerminalMember {
    /// Name of the variable in the model description.
    pub variable: String,
    /// Kind of connection: `signal` (equal values), `inflow` or `outflow` (sum is zero), or a name with a
    /// domain prefix.
    pub kind: String,
    /// Name of the member in the terminal.
    pub name: Option<String>,
}

/// Pair of variables that represent a property of the fluid that flows through a terminal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StreamMember {
    /// Name of the variable for flow into the model.
    pub inflow_variable: String,
    /// Name of the variable for flow out of the model.
    pub outflow_variable: String,
    /// Name of `inflow_variable` in the terminal.
    pub inflow_name: Option<String>,
    /// Name of `outflow_variable` in the terminal.
    pub outflow_name: Option<String>,
}

/// Graphical representation of a terminal.
#[derive(Debug, Clone, PartialEq)]
pub struct TerminalIcon {
    /// Name of the image in the folder `terminalsAndIcons/`.
    pub file: Option<String>,
    /// Lower left and upper right corner in the coordinates of the model's icon: x1, y1, x2, y2. A coordinate
    /// is NaN if the file does not specify it.
    pub corners: [f64; 4],
}
