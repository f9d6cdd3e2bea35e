"""A co-simulation of FMI 3.0 that ends its steps early, compared with FMPy, an independent importer."""

from __future__ import annotations

import fmus
import numpy as np
import pytest

from pydfo import FMUModel

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return fmus.compiled("early_return", tmp_path_factory.mktemp("early_return") / "early_return.fmu")


def test_events_end_steps_early(path):
    line = {"time": [0.0, 3.0], "u": [0.0, 3.0]}
    res = FMUModel(path).simulate(0, 3, times=[0.0, 1.0, 2.0, 3.0], input=line, step_size=0.5)
    points = np.array([0.0, 0.5, 1.0, 1.5, 1.7, 2.0, 2.5, 2.7, 3.0])
    assert res["x"][-1] == pytest.approx(points[:-1] @ np.diff(points), abs=1e-13)
    assert res.events.time == pytest.approx([1.7, 2.7], abs=1e-14) and set(res.events.kind) == {"step"}


def test_early_return_agrees_with_fmpy(path):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(path)) == []
    # Both hold u constant between the communication points; x stays below the level, so there is no event.
    table = np.array([(0.0, 0.0), (4.0, 0.4)], dtype=[("time", float), ("u", float)])
    theirs = fmpy.simulate_fmu(str(path), stop_time=3.0, step_size=0.5, output_interval=0.5, input=table, output=["x", "w"], record_events=False)
    ours = FMUModel(path).simulate(0, 3, output_interval=0.5, step_size=0.5, input={"time": table["time"], "u": table["u"]})
    assert np.array_equal(ours.time, theirs["time"])
    for name in ("x", "w"):
        assert np.array_equal(ours[name], theirs[name]), name
