"""The names of FMPy and PyFMI: docs/compat.md is correct, and scripts of both tools run."""

from __future__ import annotations

import dataclasses
import importlib
import re
import tempfile
from pathlib import Path

import fmus
import numpy as np
import pytest

from pydfo import FMUModel, example_fmu
from pydfo.compat import fmpy as ours
from pydfo.compat import pyfmi
from pydfo.compat.fmpy._file import numbers, read_file, attribute_values

PAGE = Path(__file__).resolve().parents[3] / "docs" / "compat.md"
ROWS = re.findall(r"^\| `([\w.]+)` \| (works|differs|unsupported) \|", PAGE.read_text(encoding="utf-8"), re.M)


def found(name):
    """Returns the object with this name in the table. The name consists of modules, followed by attributes."""
    parts, thing = name.split("."), None
    for k in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(["pydfo.compat", *parts[:k]]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            thing = getattr(thing, part)
        return thing
    raise AssertionError(name)


@pytest.mark.parametrize("name, state", ROWS)
def test_table_matches_the_modules(name, state):
    thing = found(name)
    is_unsupported = callable(thing) and (thing.__doc__ or "").startswith("Not provided: ")
    assert is_unsupported == (state == "unsupported")
    if is_unsupported:
        with pytest.raises(NotImplementedError, match=f"{name.rpartition('.')[2]} is not provided: "):
            thing()


def test_table_lists_all_names_of_fmpy():
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    listed = {name for name, _ in ROWS}
    for module in ("fmpy", "fmpy.model_description", "fmpy.simulation", "fmpy.util", "fmpy.validation"):
        there = importlib.import_module(module)
        public = [n for n, v in vars(there).items() if callable(v) and getattr(v, "__module__", "") == module and not n.startswith("_")]
        assert {f"{module}.{name}" for name in public} <= listed, fmpy.__version__


# --- FMPy -------------------------------------------------------------------------------------------------------------

MODELS = [
    ("bouncing_ball", "2.0", "ME"),
    ("dahlquist", "2.0", "CS"),
    ("dahlquist", "3.0", "ME"),
    ("van_der_pol", "1.0", "ME"),
    ("stair", "2.0", "ME"),
]


def structure(unknowns):
    """Returns the names of unknowns, with their dependencies and kinds of dependencies."""
    by = [u.dependencies and [v.name for v in u.dependencies] for u in unknowns]
    return list(zip([u.variable.name for u in unknowns], by, [u.dependenciesKind for u in unknowns]))


#: Two variables are derivatives of phi. The order of the structure differs from the order of the variables.
STRUCTURE = fmus.xml(
    """
    <ScalarVariable name="u" valueReference="5" causality="input"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="phi" valueReference="1" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="der(phi)" valueReference="2"><Real derivative="2"/></ScalarVariable>
    <ScalarVariable name="w" valueReference="3" causality="output"><Real derivative="2"/></ScalarVariable>
    <ScalarVariable name="der(w)" valueReference="4"><Real derivative="4"/></ScalarVariable>
    """,
    before="",
    structure="""
    <Outputs><Unknown index="4" dependencies=""/><Unknown index="2"/></Outputs>
    <Derivatives>
      <Unknown index="3" dependencies="4" dependenciesKind="constant"/>
      <Unknown index="5" dependencies="1 2"/>
    </Derivatives>
    <InitialUnknowns><Unknown index="2"/><Unknown index="3"/></InitialUnknowns>
    """,
)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-le", "iso-8859-1"])
def test_structure_refers_to_variables_by_index(encoding, tmp_path):
    text = STRUCTURE.replace('"u" ', '"u" description="&#233;\u00e9" ').replace("UTF-8", encoding.upper())
    path = fmus.write(tmp_path / "m.fmu", text.encode(encoding))
    found = ours.read_model_description(path)
    assert structure(found.derivatives) == [("der(phi)", ["w"], ["constant"]), ("der(w)", ["u", "phi"], None)]
    assert structure(found.outputs) == [("w", [], None), ("phi", None, None)]
    assert structure(found.initialUnknowns) == [("phi", None, None), ("der(phi)", None, None)]
    assert [u.index for u in found.derivatives] == [3, 5] and found.clockedStates == found.eventIndicators == []
    assert [u.variable.derivative.name for u in found.derivatives] == ["phi", "w"]
    assert found.modelVariables[0].initial == "exact" and {v.shape for v in found.modelVariables} == {()}
    if encoding != "utf-16-le":
        fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
        theirs = fmpy.read_model_description(str(path), validate=False)
        for name in ("outputs", "derivatives", "initialUnknowns"):
            assert structure(getattr(found, name)) == structure(getattr(theirs, name)), name


def test_structure_omits_unknown_variables():
    file = read_file(STRUCTURE.replace('index="5"', 'index="99"').replace('dependencies="4"', 'dependencies="x 4"').encode())
    assert [attributes["index"] for _, attributes in file.unknowns["derivatives"]] == ["3", "99"]
    assert numbers("x 4 -1 7") == [4, 7]
    assert attribute_values({"priority": "first", "resolution": "3", "canBeDeactivated": "1"}, {"priority", "resolution"}) == {"resolution": 3}


def test_invalid_xml_is_simulated_but_not_described(tmp_path):
    path = fmus.changed("dahlquist", tmp_path / "m.fmu", ("<ModelVariables>", "<!-- a -- b --><ModelVariables>"))
    with pytest.raises(ours.model_description.ValidationError, match=r"\n- not well-formed \(invalid token\): line \d+"):
        ours.read_model_description(path)
    result = ours.simulate_fmu(path, stop_time=1)
    assert result["x"][-1] == pytest.approx(np.exp(-1), abs=1e-4) and result.modelDescription.derivatives == []


def test_clocks_and_arrays_have_their_attributes(tmp_path):
    tests = Path(__file__).resolve().parents[2] / "fmi" / "tests"
    found, arrays = (
        {v.name: v for v in ours.read_model_description(fmus.write(tmp_path / f"{name}.fmu", text)).modelVariables}
        for name, text in ((name, (tests / name / "modelDescription.xml").read_bytes()) for name in ("clocks", "arrays"))
    )
    third, optional = found["third"], found["optional"]
    assert (third.intervalCounter, third.shiftCounter, third.resolution, third.supportsFraction) == (1, 1, 3, True)
    assert (optional.intervalDecimal, optional.shiftDecimal, optional.canBeDeactivated) == (0.5, 0.25, True)
    clocked = [v for v in found.values() if v.clocks is not None]
    assert clocked and all(clock is found[clock.name] and clock.type == "Clock" for v in clocked for clock in v.clocks)
    (extent,) = arrays["x"].dimensions
    assert extent.start is None and arrays["x"].shape == (int(extent.variable.start),)
    assert arrays["x"].dimensionValueReferences == [extent.valueReference] == [extent.variable.valueReference]


def test_attribute_names_match_fmpy():
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    missing = {}
    for name, state in ROWS:
        of, _, short = name.rpartition(".")
        theirs = getattr(fmpy.model_description, short, None)
        if of == "fmpy.model_description" and state != "unsupported" and hasattr(theirs, "__attrs_attrs__"):
            names = {a.name for a in theirs.__attrs_attrs__ if not a.name.startswith("_")}
            missing[short] = names - {field.name for field in dataclasses.fields(found(name))}
    assert len(missing) > 10
    assert {n: m for n, m in missing.items() if m} == {"ModelDescription": {"buildConfigurations", "scheduledExecution"}}


@pytest.mark.parametrize("model", MODELS, ids=" ".join)
def test_descriptions_match_fmpy(model):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    path = str(example_fmu(*model))
    a, b = ours.read_model_description(path), fmpy.read_model_description(path)
    for name in ("fmiVersion", "modelName", "guid", "numberOfContinuousStates", "numberOfEventIndicators", "modelIdentifier"):
        assert getattr(a, name) == getattr(b, name), name
    assert [v.name for v in a.modelVariables] == [v.name for v in b.modelVariables]
    for x, y in zip(a.modelVariables, b.modelVariables):
        for name in ("valueReference", "type", "causality", "variability", "initial", "shape", "clocks", "unit", "description"):
            assert getattr(x, name) == getattr(y, name), (x.name, name)
        for name in ("start", "min", "max", "nominal"):
            one, other = getattr(x, name), getattr(y, name)
            assert one == other or float(one) == float(other), (x.name, name)
    for name in ("outputs", "derivatives", "clockedStates", "eventIndicators", "initialUnknowns"):
        assert structure(getattr(a, name)) == structure(getattr(b, name)), name
    assert ours.supported_platforms(path) == fmpy.supported_platforms(path)
    if a.fmiVersion < "3":
        assert ours.fmi_info(path) == fmpy.fmi_info(path)


@pytest.mark.parametrize("model", MODELS[:4], ids=" ".join)
def test_results_match_fmpy(model):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    path = str(example_fmu(*model))
    arguments = {"relative_tolerance": 1e-9, "record_events": False}
    a, b = ours.simulate_fmu(path, **arguments), fmpy.simulate_fmu(path, **arguments)
    assert a.dtype == b.dtype and a.modelDescription.modelName == b.modelDescription.modelName
    assert np.allclose(a["time"], b["time"], atol=1e-12)
    for name in a.dtype.names:
        assert np.abs(1.0 * a[name] - 1.0 * b[name]).max() < 1e-5, name


@pytest.mark.parametrize("given", [{"output_interval": 0.1, "step_size": 0.01}, {"output_interval": 0.3, "step_size": 0.1}, {"step_size": 0.01}, {}])
def test_euler_steps_match_fmpy(given):
    """x' = -k x, one step from row to row: each row multiplies x by 1 - k h."""
    path = str(example_fmu("dahlquist", kind="ME"))
    arguments = {"fmi_type": "ModelExchange", "solver": "Euler", "stop_time": 1, "start_values": {"k": 0.5}, **given}
    result = ours.simulate_fmu(path, **arguments)
    assert np.allclose(result["x"], np.cumprod(np.append(1.0, 1 - 0.5 * np.diff(result["time"]))), rtol=1e-13)
    assert result["time"][1] == pytest.approx(given.get("output_interval", given.get("step_size", 1e-3)))
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    theirs = fmpy.simulate_fmu(path, **arguments)
    assert np.allclose(result["time"], theirs["time"], atol=1e-14) and np.allclose(result["x"], theirs["x"], rtol=1e-13)


def test_unused_columns_are_ignored_and_input_derivatives_applied():
    signals = np.array([(0, 1, 7), (5, 3, 7)], dtype=[("time", float), ("u", float), ("nothing", float)])
    last = {}
    for kind, u in (("ME", 3.0), ("CS", 2.6)):  # co-simulation holds the input constant over a step
        path, arguments = example_fmu("switched_input", kind=kind), {"stop_time": 5, "output_interval": 1, "output": ["y", "u"]}
        with pytest.warns(UserWarning, match="not inputs of the model have no effect: nothing$"):
            result = ours.simulate_fmu(path, input=signals, **arguments)
        assert np.array_equal(result, ours.simulate_fmu(path, input=signals[["time", "u"]], **arguments)) and result["u"][-1] == u
        last[kind] = result["y"][-1]
        with pytest.warns(UserWarning, match="nothing"):
            alone = ours.simulate_fmu(path, input=signals[["time", "nothing"]], **arguments)
        assert np.array_equal(alone, ours.simulate_fmu(path, **arguments))
    arguments |= {"input": signals[["time", "u"]], "set_input_derivatives": True}
    assert abs(ours.simulate_fmu(path, **arguments)["y"][-1] - last["ME"]) < 0.01 < 0.1 < abs(last["CS"] - last["ME"])
    with pytest.raises(ValueError, match="the FMU cannot interpolate inputs"):
        ours.simulate_fmu(example_fmu("switched_input", version="3.0"), fmi_type="CoSimulation", **arguments)


def test_folders_of_bad_archives_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    path = fmus.write(tmp_path / "m.fmu", STRUCTURE, {"a": "1", "a/b": "2"})
    with pytest.raises(OSError):
        ours.extract(path)
    assert list((tmp_path / "temporary").iterdir()) == []
    target = tmp_path / "own"
    target.mkdir()
    with pytest.raises(OSError):
        ours.extract(path, target)
    assert target.is_dir()
    assert (ours.extract(path, include=lambda name: name != "a/b") / "a").read_text() == "1"


def test_inputs_and_start_values_are_applied():
    path = example_fmu("switched_input")
    signals = np.array([(0, 1), (1, 1), (1, 3), (5, 3)], dtype=[("time", float), ("u", float)])
    result = ours.simulate_fmu(path, stop_time="5", input=signals, start_values={"gear": "2", "enabled": "true"}, output=["y", "u"])
    direct = FMUModel(path).simulate(0, 5, times=[5], inputs=signals, start_values={"gear": 2, "enabled": True}, relative_tolerance=1e-6)
    assert set(result.dtype.names) == {"time", "u", "y"} and result["u"][-1] == 3
    assert result["y"][-1] == pytest.approx(direct.final("y"), abs=1e-5)
    for given in ({"step_finished": print}, {"fmu_state": b""}, {"visible": True}, {"initialize": False}):
        with pytest.raises(NotImplementedError, match="is not provided: "):
            ours.simulate_fmu(path, **given)


def test_rows_contain_both_sides_of_input_jumps(tmp_path):
    """Rows equal FMPy's test_input in event mode, even if they do not match the internal step of the
    model."""
    path = example_fmu("switched_input", version="3.0")
    fixed_step = fmus.changed("switched_input", tmp_path / "own.fmu", ("<CoSimulation ", '<CoSimulation fixedInternalStepSize="0.1" '), version="3.0")
    signals = np.array([(0, 1), (0.5, 1), (0.5, 2), (1, 2)], dtype=[("time", float), ("u", float)])
    for file in (path, fixed_step):
        result = ours.simulate_fmu(file, fmi_type="CoSimulation", input=signals, stop_time=1, output_interval=0.25, output=["u"], use_event_mode=True)
        assert result["time"].tolist() == [0, 0.25, 0.5, 0.5, 0.75, 1] and result["u"].tolist() == [1, 1, 1, 2, 2, 2], file
    plain = ours.simulate_fmu(path, fmi_type="CoSimulation", input=signals, stop_time=1, output_interval=0.25, output=["u"])
    assert plain["time"].tolist() == [0, 0.25, 0.5, 0.75, 1]


@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_rows_are_unchanged_when_times_are_large(kind):
    """Seconds since 1970 have a resolution of 2.4e-7 s."""
    rows = {}
    for start in (0.0, 1.7e9):
        given = ours.simulate_fmu(str(example_fmu("dahlquist", kind=kind)), start_time=start, stop_time=start + 1.05, output_interval=0.1)
        rows[start] = given["time"] - start
    assert rows[1.7e9].shape == rows[0.0].shape and np.allclose(rows[1.7e9], rows[0.0], atol=1e-6)


def test_input_jumps_are_recorded_at_large_times():
    signals = np.array([(1.7e9, 0.0), (1.7e9 + 0.35, 0.0), (1.7e9 + 0.35, 1.0), (1.7e9 + 1.0, 1.0)], dtype=[("time", float), ("u", float)])
    path = str(example_fmu("switched_input", version="3.0"))
    span = {"start_time": 1.7e9, "stop_time": 1.7e9 + 1.0, "output_interval": 0.1}
    result = ours.simulate_fmu(path, fmi_type="CoSimulation", input=signals, use_event_mode=True, **span)
    assert np.count_nonzero(np.abs(result["time"] - 1.7e9 - 0.35) < 1e-6) == 2


def test_wrong_times_are_rejected():
    path = example_fmu("bouncing_ball")
    nan, inf = float("nan"), float("inf")
    for wrong, word in [
        ({"stop_time": -1}, "stop_time"),
        ({"stop_time": nan}, "stop_time"),
        ({"start_time": inf}, "stop_time"),
        ({"start_time": 5, "stop_time": 1}, "stop_time"),
        ({"output_interval": 0}, "output_interval"),
        ({"output_interval": -1}, "output_interval"),
        ({"step_size": nan}, "step_size"),
        ({"output_interval": 1e-12}, "rows"),
    ]:
        with pytest.raises(ValueError, match=word):
            ours.simulate_fmu(path, **{"stop_time": 1, **wrong})
    assert ours.simulate_fmu(path, stop_time=1, output="h").dtype.names == ("time", "h")


def test_instance_is_accessed_by_value_reference(tmp_path):
    """The loop of FMPy's example custom_input."""
    folder = ours.extract(example_fmu("dahlquist", kind="CS"), tmp_path / "folder")
    model = ours.read_model_description(folder)
    references = {v.name: v.valueReference for v in model.modelVariables}
    fmu = ours.instantiate_fmu(folder, model)
    fmu.setupExperiment(startTime=0.0)
    fmu.setReal([references["k"]], [2.0])
    for values in ([], [1.0, 2.0]):
        with pytest.raises(ValueError, match=f"got {len(values)} values for the 1 elements of the variables k"):
            fmu.setReal([references["k"]], values)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    for k in range(10):
        fmu.doStep(currentCommunicationPoint=0.1 * k, communicationStepSize=0.1)
    assert fmu.getReal([references["x"]])[0] == pytest.approx(np.exp(-2), abs=1e-3)
    fmu.terminate()
    fmu.freeInstance()


def test_csv_files_round_trip(tmp_path, capsys):
    result = ours.simulate_fmu(example_fmu("dahlquist"), stop_time=1)
    ours.write_csv(tmp_path / "r.csv", result)
    again = ours.read_csv(tmp_path / "r.csv")
    assert again.dtype.names == result.dtype.names and np.array_equal(again["x"], result["x"])
    pytest.importorskip("matplotlib").use("agg")
    ours.plot_result(result, reference=again, filename=tmp_path / "r.png")
    assert (tmp_path / "r.png").stat().st_size > 1000
    ours.dump(example_fmu("dahlquist"))
    assert "Model Name         Dahlquist" in capsys.readouterr().out


# --- PyFMI ------------------------------------------------------------------------------------------------------------


def test_pyfmi_options_and_results_work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = pyfmi.load_fmu(example_fmu("bouncing_ball"))
    options = model.simulate_options()
    options["ncp"] = 200
    options["CVode_options"]["rtol"] = 1e-9
    options["filter"] = ["h", "v*"]
    options["result_handling"] = "csv"
    result = model.simulate(start_time=0, final_time=1, options=options)
    assert result.keys() == ["time", "h", "v", "v_min"] and len(result["time"]) == 201
    after = 1 - fmus.bounces(2)[0]
    assert result.final("h") == pytest.approx(0.7 * np.sqrt(2 * 9.81) * after - 9.81 * after**2 / 2, abs=1e-6)
    assert result.initial("h") == 1 and Path(result.result_file).exists() and model.get("h") == result.final("h")
    with pytest.raises(KeyError, match="did you mean 'ncp'"):
        options["ncpp"] = 3
    with pytest.raises(NotImplementedError, match="initialize"):
        model.simulate(options={"initialize": False})
    with pytest.warns(UserWarning, match="atol"):
        model.simulate(final_time=1, options={"CVode_options": {"atol": 1e-6}})


def test_pyfmi_variables_work():
    from pydfo.compat.pyfmi.fmi import FMI2_CONTINUOUS, FMI2_OUTPUT, FMI2_PARAMETER, FMI2_REAL

    model = pyfmi.load_fmu(str(example_fmu("bouncing_ball")))
    assert isinstance(model, pyfmi.FMUModelME2)
    assert (model.get_version(), model.get_name(), model.get_ode_sizes()) == ("2.0", "BouncingBall", (2, 1))
    h = model.get_scalar_variable("h")
    assert (h.type, h.causality, h.variability) == (FMI2_REAL, FMI2_OUTPUT, FMI2_CONTINUOUS)
    assert model.get_variable_causality("e") == FMI2_PARAMETER and model.get_variable_start("e") == 0.7
    assert list(model.get_model_variables(causality=FMI2_OUTPUT)) == list(model.get_output_list()) == ["h", "v"]
    assert list(model.get_states_list()) == ["h", "v"] and list(model.get_derivatives_list()) == ["der(h)", "der(v)"]
    assert model.get_real([model.get_variable_valueref("h")]).tolist() == [1.0]


def test_pyfmi_native_loop_works():
    """The loop of PyFMI's example fmi20_bouncing_ball_native: explicit Euler with events."""
    model = pyfmi.load_fmu(example_fmu("bouncing_ball"))
    model.setup_experiment(start_time=0.0)
    model.enter_initialization_mode()
    model.exit_initialization_mode()
    info = model.get_event_info()
    info.newDiscreteStatesNeeded = True
    while info.newDiscreteStatesNeeded:
        model.enter_event_mode()
        model.event_update()
        info = model.get_event_info()
    model.enter_continuous_time_mode()
    x, signs, time, bounces = model.continuous_states, model.get_event_indicators() > 0, 0.0, []
    while time < 1.0:
        x, time = x + 1e-3 * model.get_derivatives(), time + 1e-3
        model.time, model.continuous_states = time, x
        now = model.get_event_indicators() > 0
        step_event, _ = model.completed_integrator_step()
        if step_event or (now != signs).any():
            model.enter_event_mode()
            model.event_update(intermediateResult=True)
            if model.get_event_info().valuesOfContinuousStatesChanged:
                bounces.append(time)
                x = model.continuous_states
            model.enter_continuous_time_mode()
        signs = now
    assert bounces[0] == pytest.approx(fmus.bounces(1)[0], abs=2e-3)


def test_pyfmi_native_loop_works_for_fmi_1():
    """The loop of PyFMI's example fmi_bouncing_ball_native: the time is set before the initialization, and there are
    no modes."""
    model = pyfmi.load_fmu(example_fmu("bouncing_ball", version="1.0", kind="ME"))
    model.time = 0.5
    model.initialize()
    x, signs, bounces = model.continuous_states, model.get_event_indicators() > 0, []
    assert model.time == 0.5 and not model.get_event_info().terminateSimulation
    while model.time < 1.5:
        x = x + 1e-3 * model.get_derivatives()
        model.time, model.continuous_states = model.time + 1e-3, x
        now = model.get_event_indicators() > 0
        step_event = model.completed_integrator_step()
        if step_event or (now != signs).any():
            info = model.get_event_info()
            info.iterationConverged = False
            while not info.iterationConverged:
                model.event_update(intermediateResult=True)
                info = model.get_event_info()
            if info.stateValuesChanged:
                bounces.append(model.time)
                x = model.continuous_states
            assert not info.stateValueReferencesChanged and not info.upcomingTimeEvent
        signs = now
    assert bounces[0] == pytest.approx(0.5 + fmus.bounces(1)[0], abs=2e-3)


def test_pyfmi_state_space_and_co_simulation_work():
    model = pyfmi.load_fmu(example_fmu("van_der_pol"))
    model.initialize()
    a, b, c, d = model.get_state_space_representation(B=False, use_structure_info=False)
    assert np.allclose(a, [[0, 1], [-1, -3]]) and b is False and c.shape[1] == 2 and d.size == 0
    slave = pyfmi.load_fmu(example_fmu("dahlquist", kind="CS"))
    slave.initialize()
    assert slave.do_step(0.0, 0.1) == 0 and slave.time == 0.1
    slave.reset()
    assert slave.simulate(final_time=1).final("x") == pytest.approx(np.exp(-1), abs=1e-3)


def test_pyfmi_names_refer_to_compat_module() -> None:
    model = FMUModel(example_fmu("dahlquist"))
    for name in ("simulate_options", "get_model_variables"):
        with pytest.raises(AttributeError, match=f"no '{name}'; for PyFMI's methods, use pydfo.compat.pyfmi.load_fmu"):
            getattr(model, name)
    assert not hasattr(model, "nothing")
