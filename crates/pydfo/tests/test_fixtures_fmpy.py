"""FMPy, an independent importer, validates the bundled FMUs and computes the same results.

Tolerances are tight, so that only the differences of the importers remain: FMPy's CVode at 1e-10, pydfo at 1e-11.
"""

from __future__ import annotations

import fmus
import numpy as np
import pytest

from pydfo import FMUModel, example_fmu

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")

SPANS = {
    "furuta": 40.0,
    "bouncing_ball": 3.0,
    "dahlquist": 10.0,
    "van_der_pol": 20.0,
    "switched_input": 5.0,
    "quad_tank": 60.0,
    "exhaust": 10.0,  # stiff: pydfo takes steps of a millisecond
}


def table(names, *rows):
    return np.array(list(rows), dtype=[("time", np.float64), *((name, np.float64) for name in names)])


#: FMPy applies discrete inputs in continuous-time mode, which the models reject, and ramps only in the event
#: indicators. Discrete inputs are therefore start values here, and continuous inputs jump.
IDLE, LOAD = (550, 1.08e5, 1700, 2100, 1.015e5), (800, 2.2e5, 5000, 4000, 1.03e5)
MORE = {
    "switched_input": {
        "start_values": {"gear": 2, "enabled": True},
        "input": table(["u"], (0, 1), (1, 1), (1, 3), (2, 3), (2, -1), (5, -1)),
    },
    "quad_tank": {"input": table(["u1", "u2"], (0, 5, 5), (15, 5, 5), (15, 6, 5), (40, 6, 5), (40, 5, 6), (60, 5, 6))},
    "exhaust": {
        "start_values": {"C1": 4500.0, "G1": 60.0},
        "input": table(["T_in", "p_in", "w_turb1", "w_turb2", "p_out"], (0, *IDLE), (3, *IDLE), (3, *LOAD), (7, *LOAD), (7, *IDLE), (10, *IDLE)),
    },
}


@pytest.mark.parametrize("name", fmus.EXAMPLES)
def test_fmpy_validates_bundled_fmus(name):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(example_fmu(name))) == []


@pytest.mark.parametrize("name", SPANS)
def test_bundled_fmus_agree_with_fmpy(name):
    model = FMUModel(example_fmu(name))
    names = list(model.simulate(0, 0))[1:]
    span, more = SPANS[name], MORE.get(name, {})
    theirs = fmpy.simulate_fmu(
        str(model.path),
        stop_time=span,
        output_interval=span / 200,
        solver="CVode",
        relative_tolerance=1e-10,
        output=names,
        record_events=False,
        **more,
    )
    ours = model.simulate(0, span, times=theirs["time"], relative_tolerance=1e-11, **more)
    assert len(ours.time) == 201
    for column in names:
        scale = max(1.0, np.abs(theirs[column]).max())  # a pressure in Pa has fewer digits after the decimal point
        assert np.abs(ours[column] - theirs[column]).max() < 1e-6 * scale, column


def test_time_events_agree_with_fmpy():
    path = example_fmu("stair")
    theirs = fmpy.simulate_fmu(str(path), stop_time=10, output_interval=0.25, output=["counter"], record_events=False)
    ours = FMUModel(path).simulate(0, 10, output_interval=0.25)
    # The model requests its end at 9 s with the value 10; FMPy ends before it records this value.
    rows = len(theirs)
    assert rows in (36, 37) and len(ours.time) == 37
    assert np.array_equal(ours.time[:36], theirs["time"][:36])
    assert np.array_equal(ours["counter"][:36], theirs["counter"][:36])
    assert ours.final("counter") == 10
