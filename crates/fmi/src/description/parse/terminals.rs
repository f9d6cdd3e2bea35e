//! `terminalsAndIcons/terminalsAndIcons.xml`: groups of variables that are connected together (FMI 3.0.x,
//! section 2.4.9; also used by some FMI 2.0 FMUs).

use super::attributes::Attributes;
use super::encoding;
use super::xml::{Element, Xml};
use crate::cancel_request::CancelRequest;
use crate::description::limits::{DescriptionLimits, Reading, check_size};
use crate::description::quirks::Quirks;
use crate::description::terminals::{StreamMember, Terminal, TerminalIcon, TerminalMember};
use crate::error::Result;
use std::rc::Rc;

/// Name of the file in the folder `terminalsAndIcons/`.
pub(crate) const TERMINALS: &str = "terminalsAndIcons.xml";

/// Returns the terminals of a document.
pub(crate) fn terminals(bytes: &[u8], limits: &DescriptionLimits) -> Result<Vec<Terminal>> {
    check_size(bytes, TERMINALS, limits)?;
    let text = encoding::decode(bytes.into(), &mut Quirks::default());
    let reading = Rc::new(Reading::new(limits, &CancelRequest::default()));
    let mut xml = Xml::new(&text, TERMINALS, reading)?;
    let root = xml.root_named("fmiTerminalsAndIcons")?;
    let mut found = Vec::new();
    while let Some(list) = xml.named(root.level, &["Terminals"])? {
        while let Some(element) = xml.named(list.level, &["Terminal"])? {
            found.push(terminal(&mut xml, &element)?);
        }
    }
    Ok(found)
}

/// Parses a terminal with its nested terminals.
fn terminal(xml: &mut Xml<'_>, element: &Element<'_>) -> Result<Terminal> {
    let attributes = Attributes::of(element)?;
    let mut terminal = Terminal {
        name: attributes.required_text("name")?,
        matching_rule: attributes.required_text("matchingRule")?,
        kind: attributes.text("terminalKind"),
        description: attributes.text("description"),
        ..Terminal::default()
    };
    while let Some(child) = xml.child(element.level)? {
        let attributes = Attributes::of(&child)?;
        match child.name() {
            "TerminalMemberVariable" => terminal.members.push(TerminalMember {
                variable: attributes.required_text("variableName")?,
                kind: attributes.required_text("variableKind")?,
                name: attributes.text("memberName"),
            }),
            "TerminalStreamMemberVariable" => terminal.stream_members.push(StreamMember {
                inflow_variable: attributes.required_text("inStreamVariableName")?,
                outflow_variable: attributes.required_text("outStreamVariableName")?,
                inflow_name: attributes.text("inStreamMemberName"),
                outflow_name: attributes.text("outStreamMemberName"),
            }),
            "TerminalGraphicalRepresentation" => {
                let corner = |name| attributes.real(name);
                let corners = [corner("x1"), corner("y1"), corner("x2"), corner("y2")];
                terminal.icon = Some(TerminalIcon {
                    file: attributes.text("iconBaseName"),
                    corners: corners.map(|corner| corner.unwrap_or(f64::NAN)),
                });
            }
            "Terminal" => terminal.terminals.push(self::terminal(xml, &child)?),
            _ => {}
        }
    }
    Ok(terminal)
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: &str = r##"<?xml version="1.0"?>
<fmiTerminalsAndIcons fmiVersion="3.0">
  <GraphicalRepresentation><Icon x1="-100" y1="-100" x2="100" y2="100"/></GraphicalRepresentation>
  <Terminals>
    <Terminal name="bus" matchingRule="bus" description="all of it">
      <Terminal name="flange" matchingRule="plug" terminalKind="org.modelica.Flange">
        <TerminalMemberVariable variableName="phi" variableKind="signal" memberName="angle"/>
        <TerminalMemberVariable variableName="tau" variableKind="inflow"/>
        <TerminalStreamMemberVariable inStreamVariableName="h_in" outStreamVariableName="h_out" inStreamMemberName="in"/>
        <Unknown/>
        <TerminalGraphicalRepresentation iconBaseName="flange.png" x1="1" y1="2" x2="3" y2="4" defaultConnectionColor="0 0 0"/>
      </Terminal>
    </Terminal>
  </Terminals>
</fmiTerminalsAndIcons>"##;

    #[test]
    fn terminals_returns_members_and_nested_terminals() {
        let found = terminals(EXAMPLE.as_bytes(), &DescriptionLimits::default()).unwrap();
        let [bus] = &found[..] else { panic!("{found:?}") };
        assert_eq!((bus.name.as_str(), bus.matching_rule.as_str()), ("bus", "bus"));
        assert_eq!(bus.description.as_deref(), Some("all of it"));
        let [flange] = &bus.terminals[..] else { panic!("{bus:?}") };
        assert_eq!(flange.kind.as_deref(), Some("org.modelica.Flange"));
        let members: Vec<_> = flange.members.iter().map(|m| (m.variable.as_str(), m.kind.as_str())).collect();
        assert_eq!(members, [("phi", "signal"), ("tau", "inflow")]);
        assert_eq!(flange.members[0].name.as_deref(), Some("angle"));
        assert_eq!(flange.stream_members[0].outflow_variable, "h_out");
        let icon = flange.icon.as_ref().unwrap();
        assert_eq!((icon.file.as_deref(), icon.corners), (Some("flange.png"), [1.0, 2.0, 3.0, 4.0]));
    }

    #[test]
    fn terminals_rejects_invalid_documents_with_their_line() {
        let refused =
            |text: &str| terminals(text.as_bytes(), &DescriptionLimits::default()).unwrap_err().to_string();
        assert!(refused("<a/>").contains("the root element is <a>"));
        let message = refused(&EXAMPLE.replace(" variableName=\"phi\"", ""));
        assert!(message.starts_with("terminalsAndIcons.xml, line 7: <TerminalMemberVariable>"), "{message}");
        let nested = format!(
            "<fmiTerminalsAndIcons><Terminals>{}",
            "<Terminal name=\"a\" matchingRule=\"b\">".repeat(200)
        );
        assert!(refused(&nested).contains("levels deep"));
    }
}
