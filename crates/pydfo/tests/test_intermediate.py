"""A co-simulation of FMI 3.0 that calls back during its steps and ends them early, beside FMPy, an independent importer."""

from __future__ import annotations

import fmus
import numpy as np
import pytest

from pydfo import FMUModel

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return fmus.compiled("intermediate", tmp_path_factory.mktemp("intermediate") / "intermediate.fmu")


def test_inputs_are_exact_within_steps(path):
    line = {"time": [0.0, 3.0], "u": [0.0, 3.0]}
    res = FMUModel(path).simulate(0, 3, times=[0.0, 1.0, 2.0, 3.0], input=line)
    np.testing.assert_allclose(res["x"], 0.5 * res.time**2, atol=1e-13)
    assert res.events.time == pytest.approx([1.45, 2.45], abs=1e-14) and set(res.events.kind) == {"step"}


def test_fmpy_agrees(path):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(path)) == []
    # Both hold v between the communication points; u is 0, so there is no event.
    table = np.array([(0.0, 0.0), (4.0, 4.0)], dtype=[("time", float), ("v", float)])
    theirs = fmpy.simulate_fmu(
        str(path), stop_time=3.0, step_size=0.5, output_interval=0.5, input=table, output=["x", "w"], record_events=False
    )
    ours = FMUModel(path).simulate(0, 3, output_interval=0.5, step_size=0.5, input={"time": table["time"], "v": table["v"]})
    assert np.array_equal(ours.time, theirs["time"])
    for name in ("x", "w"):
        assert np.array_equal(ours[name], theirs[name]), name
