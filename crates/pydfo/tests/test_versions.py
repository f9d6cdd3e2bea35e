"""All versions of FMI, model exchange and co-simulation, compared with FMPy, an independent importer.

FMPy validates the bundled FMUs of all versions. Model exchange agrees to 1e-6 at tight tolerances, and co-simulation
is bit-for-bit identical."""

from __future__ import annotations

import fmus
import numpy as np
import pytest

import pydfo
from pydfo import FMUModel, example_fmu

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")

VERSIONS = ("1.0", "2.0", "3.0")
#: Duration of the simulation, and the communication step.
SPANS = {
    "furuta": (5.0, 0.0625),
    "dahlquist": (5.0, 0.125),
    "van_der_pol": (10.0, 0.0625),
    "switched_input": (3.0, 0.125),
    "quad_tank": (20.0, 0.5),
    "exhaust": (2.0, 0.125),
}
#: Start values that the models do not declare.
START = {"quad_tank": {"u1": 5.0, "u2": 4.0}}


def columns(model, skip=("time",)):
    return [name for name in model.simulate(0, 0.01) if name not in skip]


@pytest.mark.parametrize("name", fmus.EXAMPLES)
@pytest.mark.parametrize(("version", "kind"), [("1.0", "ME"), ("1.0", "CS"), ("2.0", "CS"), ("3.0", "ME")])
def test_fmpy_validates_all_versions(name, version, kind):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(example_fmu(name, version, kind))) == []


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", SPANS)
def test_model_exchange_agrees_with_fmpy(name, version):
    path = example_fmu(name, version, "ME")
    model = FMUModel(path, kind="ME")
    span, step = SPANS[name]
    names = columns(model)
    theirs = fmpy.simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        stop_time=span,
        output_interval=step,
        solver="CVode",
        relative_tolerance=1e-10,
        output=names,
        start_values=START.get(name, {}),
        record_events=False,
    )
    ours = model.simulate(0, span, times=theirs["time"], relative_tolerance=1e-10, start_values=START.get(name))
    for column in names:
        scale = max(1.0, np.abs(theirs[column].astype(float)).max())
        assert np.abs(ours[column] - theirs[column]).max() < 1e-6 * scale, column


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", SPANS)
def test_co_simulation_equals_fmpy(name, version):
    path = example_fmu(name, version, "CS")
    model = FMUModel(path, kind="cs")
    assert model.kind == "CS"
    span, step = SPANS[name]
    names = columns(model)
    theirs = fmpy.simulate_fmu(
        str(path),
        fmi_type="CoSimulation",
        stop_time=span,
        step_size=step,
        output_interval=step,
        output=names,
        start_values=START.get(name, {}),
        record_events=False,
        early_return_allowed=version == "3.0",
        use_event_mode=version == "3.0",
    )
    rows = dict(zip(theirs["time"], theirs))
    ours = model.simulate(0, span, output_interval=step, step_size=step, relative_tolerance=1e-6, start_values=START.get(name))
    assert len(ours.time) == round(span / step) + 1
    for column in names:
        for time, value in zip(ours.time, ours[column]):
            assert value == rows[time][column], (column, time)


@pytest.mark.parametrize("version", VERSIONS)
def test_values_are_set_in_all_versions(version):
    path = example_fmu("switched_input", version, "CS")
    with FMUModel(path, kind="CS") as model:
        model.set(["gear", "enabled", "K"], [2, True, 0.5])
        assert model.get(["gear", "enabled", "K"]) == [2, True, 0.5]
        res = model.simulate(0, 1)
        assert model.get("y") == res.final("y")
        assert [type(v) for v in model.get(["gear", "enabled", "y"])] == [int, bool, float]


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_fit_works_in_all_versions_and_kinds(version, kind):
    t = np.linspace(0, 2, 9)
    calibration = pydfo.Calibration(
        example_fmu("dahlquist", version, kind),
        {"time": t, "x": np.exp(-1.5 * t)},
        ["x"],
        [pydfo.Parameter("k", 1.0, 0.1, 10.0)],
        kind=kind,
    )
    assert calibration.fit().x[0] == pytest.approx(1.5, abs=1e-3)


def test_calibration_uses_kind_of_its_model():
    model = FMUModel(example_fmu("dahlquist", "3.0"), kind="CS")
    data, parameter = {"time": [0.0, 0.35], "x": [1.0, 0.7]}, pydfo.Parameter("k", 1.0, 0.1, 10.0)
    # The solver of the model and the method of pydfo differ in the last digits.
    costs = [pydfo.Calibration(m, data, ["x"], [parameter], kind=k).cost() for m, k in ((model, None), (model.path, "CS"), (model, "ME"))]
    assert costs[0] == costs[1] != costs[2]


def test_unknown_examples_are_rejected():
    with pytest.raises(ValueError, match=r"'1\.1'"):
        example_fmu("furuta", "1.1")
    with pytest.raises(ValueError, match="'SE'"):
        example_fmu("furuta", "3.0", "SE")
