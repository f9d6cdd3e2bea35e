"""Clocks of FMI 3.0 from Python: the ticks, and the clocked parts of a model."""

from __future__ import annotations

import fmus
import numpy as np
import pytest

from pydfo import FMUModel


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return fmus.compiled("clocks", tmp_path_factory.mktemp("clocks") / "clocks.fmu")


INPUT = {"time": [0.0, 0.5, 0.7, 1.0], "button": [False, True, False, True], "setpoint": [0.0, 0.0, 0.0, 1.0]}


@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_sampled_controller_matches_reference(path, kind):
    res = FMUModel(path, kind=kind).simulate(0, 2, ncp=20, input=INPUT, relative_tolerance=1e-10)
    state = [1.0]
    for k in range(20):
        state.append(state[-1] + 0.2 * ((0.0 if k < 10 else 1.0) - state[-1]))
    np.testing.assert_allclose(res["x"], state, atol=1e-9)
    assert res.ticks["sample"].tolist() == [k * 0.1 for k in range(21)]
    assert res.ticks["third"].tolist() == [k / 3 for k in range(1, 7)]
    assert res.ticks["growing"].tolist() == [0.0625, 0.1875, 0.4375, 0.9375, 1.9375]
    assert res.ticks["button"].tolist() == [0.5, 1.0]
    assert res.ticks["later"].tolist() == res.ticks["alarm"].tolist() == [0.625, 1.125]
    assert {name: res.final(f"n_{name}") for name in res.ticks} == {name: len(times) for name, times in res.ticks.items()}
    assert res.to_structured().dtype["alarm"] == bool


def test_model_without_clocks_has_no_ticks():
    assert FMUModel(fmus.example_fmu("dahlquist")).simulate(0, 1).ticks == {}


def test_fmpy_validates_model_with_clocks(path):
    pytest.importorskip("fmpy", reason="FMPy is not installed")
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(path)) == []


@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_clock_intervals_are_applied(path, kind):
    model = FMUModel(path, kind=kind)
    given = {"counted": (1, 4), "optional": 1.0, "retuned": np.float64(0.75)}
    ticks = model.simulate(ncp=4, clock_intervals=given).ticks
    np.testing.assert_allclose(ticks["counted"], [0.125 + 0.25 * k for k in range(8)], rtol=0, atol=1e-15)
    assert ticks["optional"].tolist() == [0.25, 1.25]
    assert ticks["retuned"].tolist() == [0.25, 1.0, 1.25, 1.5, 1.75, 2.0]
    with pytest.raises(ValueError, match="cannot set the interval of sample: it has constant intervals"):
        model.simulate(clock_intervals={"sample": 1.0})
    with pytest.raises(ValueError, match="not positive"):
        model.simulate(clock_intervals={"counted": -1.0})
    for bad in ({"counted": (1, -4)}, {"counted": "1"}, {"counted": (1, 2, 3)}, [("counted", 1.0)]):
        with pytest.raises(TypeError, match="interval"):
            model.simulate(clock_intervals=bad)
