"""Model descriptions: bundled models, a handmade one with all features, many variables."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Mapping

import fmus
import pytest

from pydfo import FMUModel, example_fmu, read_description


def test_furuta_description_is_complete():
    d = FMUModel(example_fmu("furuta")).description
    assert (d.fmi_version, d.model_name, d.n_states, d.n_event_indicators) == ("2.0", "Furuta", 4, 4)
    assert d.guid.startswith("{") and d.quirks == []
    assert d.states == ["armJoint.phi", "armJoint.w", "pendulumJoint.phi", "pendulumJoint.w"]
    assert d.outputs == ["armJoint.phi", "pendulumJoint.phi"] and d.inputs == []
    assert {"armFriction", "pendulumFriction", "g"} < set(d.parameters)
    experiment = d.default_experiment
    assert (experiment.start_time, experiment.stop_time, experiment.tolerance) == (0.0, 40.0, 1e-6)
    assert d.model_exchange.model_identifier == "furuta" and d.co_simulation is None
    assert d.capabilities is d.model_exchange.capabilities and d.capabilities.can_get_and_set_state
    assert "model.c" in d.model_exchange.source_files
    assert [c.name for c in d.log_categories] == ["logEvents", "logStatusDiscard", "logStatusError"]
    assert d.units["rad"].base.rad == 1
    (degrees,) = d.units["rad"].display_units
    assert degrees.name == "deg" and degrees.factor == pytest.approx(57.29577951308232)
    assert "Furuta" in repr(d) and "4 states" in repr(d)


def test_variables_are_a_mapping():
    variables = FMUModel(example_fmu("furuta")).description.variables
    assert isinstance(variables, Mapping) and len(variables) == len(list(variables)) == 23
    assert list(variables)[:2] == ["time", "armJoint.phi"]
    assert "armJoint.phi" in variables and "armJoint" not in variables and 3 not in variables
    assert variables.get("armJoint") is None
    assert [v.index for v in variables.values()] == list(range(23))
    assert all(name == variable.name for name, variable in variables.items())
    with pytest.raises(KeyError, match="did you mean armJoint.phi"):
        variables["armJoint.phj"]
    with pytest.raises(KeyError):
        variables[3]


def test_variables_have_their_attributes():
    variables = FMUModel(example_fmu("furuta")).description.variables
    v = variables["armFriction"]
    assert (v.type, v.causality, v.variability, v.initial) == ("Real", "parameter", "tunable", "exact")
    assert (v.start, v.min, v.unit, v.derivative) == (0.012, 0.0, "N.m", None)
    assert v == variables["armFriction"] != variables["g"]
    with pytest.raises(AttributeError):
        v.start = 1.0
    assert variables["der(armJoint.phi)"].derivative == "armJoint.phi"
    assert variables["time"].causality == "independent"
    v = FMUModel(example_fmu("switched_input")).description.variables["gear"]
    assert (v.type, v.start, type(v.start), v.causality) == ("Integer", 1, int, "input")


FULL = """
<ScalarVariable name="r" valueReference="7" description="&lt;a&gt; \u00e4" causality="output" variability="continuous"
  initial="approx" canHandleMultipleSetPerTimeInstant="false">
  <Real declaredType="Temp" start="300" nominal="100" unbounded="true" displayUnit="degC"/>
</ScalarVariable>
<ScalarVariable name="der(r)" valueReference="8"><Real derivative="1" reinit="true"/></ScalarVariable>
<ScalarVariable name="flag" valueReference="7" causality="parameter" variability="tunable"><Boolean start="true"/></ScalarVariable>
"""
FULL_BEFORE = """
<UnitDefinitions>
  <Unit name="K"><BaseUnit K="1"/><DisplayUnit name="degC" factor="1" offset="-273.15"/></Unit>
  <Unit name="widget"/>
</UnitDefinitions>
<TypeDefinitions>
  <SimpleType name="Temp" description="T"><Real quantity="ThermodynamicTemperature" unit="K" min="0" max="1000"/></SimpleType>
  <SimpleType name="Color"><Enumeration quantity="q"><Item name="red" value="1"/><Item name="blue" value="2"/></Enumeration></SimpleType>
</TypeDefinitions>
"""


def test_all_elements_are_read(tmp_path):
    head = 'author="A" version="1.2" copyright="C" license="L" generationTool="Hand 1" generationDateAndTime="2026-01-01T00:00:00Z"'
    structure = '<Derivatives><Unknown index="2"/></Derivatives>'
    path = fmus.write(tmp_path / "m.fmu", fmus.xml(FULL, before=FULL_BEFORE, head=head, structure=structure))
    d = read_description(path)
    assert (d.author, d.version, d.copyright, d.license) == ("A", "1.2", "C", "L")
    assert (d.generation_tool, d.generation_date_and_time) == ("Hand 1", "2026-01-01T00:00:00Z")
    assert (d.n_states, d.states, d.description) == (1, ["r"], None)
    v = d.variables["r"]
    assert (v.description, v.index, v.value_reference, v.declared_type) == ("<a> \u00e4", 0, 7, "Temp")
    assert (v.quantity, v.unit, v.display_unit) == ("ThermodynamicTemperature", "K", "degC")
    assert (v.min, v.max, v.nominal, v.start, v.unbounded, v.relative_quantity) == (0, 1000, 100, 300, True, False)
    assert v.can_handle_multiple_set_per_time_instant is False
    assert (d.variables["der(r)"].derivative, d.variables["der(r)"].reinit) == ("r", True)
    assert d.variables["flag"].start is True
    assert d.units["K"].display_units[0].offset == -273.15 and d.units["widget"].base is None
    assert d.type_definitions["Temp"].max == 1000 and d.type_definitions["Temp"].items == []
    assert [(i.name, i.value) for i in d.type_definitions["Color"].items] == [("red", 1), ("blue", 2)]


def test_quirks_are_reported(tmp_path):
    odd = '<ScalarVariable name="x" valueReference="1"><Real unit="furlong" nominal="0"/></ScalarVariable>'
    d = read_description(fmus.write(tmp_path / "m.fmu", fmus.xml(odd)))
    assert {"undefined", "range"} <= {quirk.kind for quirk in d.quirks}
    assert any("furlong" in quirk.message for quirk in d.quirks)


@pytest.mark.parametrize("version", ["1.0", "3.0"])
def test_other_versions_are_described(tmp_path, version):
    if version == "1.0":
        text = (
            '<fmiModelDescription fmiVersion="1.0" modelName="M" modelIdentifier="m" guid="g" '
            'numberOfContinuousStates="1" numberOfEventIndicators="2"><ModelVariables>'
            '<ScalarVariable name="x" valueReference="1"><Real start="1"/></ScalarVariable>'
            "</ModelVariables></fmiModelDescription>"
        )
    else:
        text = (
            '<fmiModelDescription fmiVersion="3.0" modelName="M" instantiationToken="g">'
            '<ModelExchange modelIdentifier="m"/><ModelVariables><Float64 name="x" valueReference="1" start="1"/>'
            "</ModelVariables><ModelStructure/></fmiModelDescription>"
        )
    path = fmus.write(tmp_path / "m.fmu", text)
    d = read_description(path)
    assert (d.fmi_version, d.model_name, d.guid) == (version, "M", "g") and "x" in d.variables
    assert repr(FMUModel(path)).startswith(f"<FMUModel: M, FMI {version} ME")


def test_description_with_100_000_variables_is_read(tmp_path):
    one = '<ScalarVariable name="a.v[{0}]" valueReference="{0}" causality="parameter" variability="fixed"><Real start="{0}"/></ScalarVariable>'
    path = fmus.write(tmp_path / "m.fmu", fmus.xml("".join(one.format(k) for k in range(100_000))))
    model = FMUModel(path)
    variables = model.description.variables
    assert len(variables) == 100_000 and variables["a.v[99999]"].start == 99999.0
    assert len(list(variables)) == 100_000
    model.set("a.v[5]", 3.0)
    assert model.get(["a.v[5]", "a.v[6]"]) == [3.0, 6.0]
    with pytest.raises(KeyError, match=r"did you mean a\.v\[9999\]|did you mean a\.v"):
        model.get("a.v[999999]")


def test_terminals_are_read(tmp_path):
    assert read_description(example_fmu("dahlquist")).terminals == []
    path = tmp_path / "terminals.fmu"
    shutil.copy(example_fmu("dahlquist"), path)
    member = '<TerminalMemberVariable variableName="x" variableKind="signal"/>'
    streams = '<TerminalStreamMemberVariable inStreamVariableName="a" outStreamVariableName="b"/>'
    inner = f'<Terminal name="pin" matchingRule="plug">{member}{streams}<TerminalGraphicalRepresentation iconBaseName="p"/></Terminal>'
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(
            "terminalsAndIcons/terminalsAndIcons.xml",
            f'<fmiTerminalsAndIcons><Terminals><Terminal name="bus" matchingRule="bus">{inner}</Terminal></Terminals></fmiTerminalsAndIcons>',
        )
    (bus,) = read_description(path).terminals
    assert (bus.name, bus.matching_rule, bus.kind, bus.members) == ("bus", "bus", None, {})
    (pin,) = bus.terminals
    assert (pin.members, pin.streams, pin.icon) == ({"x": "signal"}, [("a", "b")], "p")


ALIASES = """<fmiModelDescription fmiVersion="3.0" modelName="M" instantiationToken="g"><CoSimulation modelIdentifier="m"/>
<ModelVariables><Float64 name="T" valueReference="1" description="temperature" causality="output" start="1" initial="exact">
<Alias name="sensor.T" description="measured" displayUnit="degC"/></Float64><String name="s" valueReference="2" causality="parameter"
variability="fixed" start="text"/></ModelVariables><ModelStructure><Output valueReference="1"/></ModelStructure></fmiModelDescription>"""


def test_aliases_are_listed_as_variables(tmp_path):
    description = read_description(fmus.write(tmp_path / "m.fmu", ALIASES))
    variables = description.variables
    assert list(variables) == ["T", "sensor.T", "s"] and len(variables) == 3
    alias, variable = variables["sensor.T"], variables["T"]
    assert (alias.name, alias.description, alias.display_unit, alias.aliases) == ("sensor.T", "measured", "degC", ("T",))
    assert (variable.description, variable.display_unit, variable.aliases) == ("temperature", None, ("sensor.T",))
    assert (alias.index, alias.value_reference, alias.start) == (variable.index, variable.value_reference, 1.0)
    assert variables["s"].start == "text" and [quirk.kind for quirk in description.quirks] == ["start"]


def test_variables_print_as_table(tmp_path):
    variables = read_description(fmus.write(tmp_path / "m.fmu", ALIASES)).variables
    lines = str(variables).splitlines()
    assert lines[0].split() == ["name", "type", "causality", "variability", "start", "unit", "description"]
    assert [line.split()[0] for line in lines[1:]] == ["T", "sensor.T", "s"] and "measured" in lines[2]
    frame = pytest.importorskip("pandas") and variables.to_dataframe()
    assert list(frame.index) == list(variables) and frame.loc["T", "start"] == 1.0
    one = '<ScalarVariable name="v{0}" valueReference="{0}"><Real/></ScalarVariable>'
    path = fmus.write(tmp_path / "many.fmu", fmus.xml("".join(one.format(k) for k in range(150))))
    many = str(read_description(path).variables).splitlines()
    assert len(many) == 102 and "50 more" in many[-1]
