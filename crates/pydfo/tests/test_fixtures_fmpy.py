"""FMPy, an independent importer, finds nothing wrong with the bundled FMUs and gets the same results from them.

Tolerances are tight, so that what remains are the differences of the two importers: FMPy's CVode at 1e-10, ours at 1e-11.
"""

from __future__ import annotations

import fmus
import numpy as np
import pytest

from pydfo import FMUModel, example_fmu

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")

SPANS = {"furuta": 40.0, "bouncing_ball": 3.0, "dahlquist": 10.0, "van_der_pol": 20.0, "switched_input": 5.0}

#: FMPy applies discrete inputs in continuous-time mode, which the models refuse, and ramps in the event indicators only:
#: the discrete inputs are start values here, and the continuous one jumps.
JUMPS = np.array(
    [(0, 1), (1, 1), (1, 3), (2, 3), (2, -1), (5, -1)], dtype=[("time", np.float64), ("u", np.float64)]
)


@pytest.mark.parametrize("name", fmus.EXAMPLES)
def test_fmpy_validates(name):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(example_fmu(name))) == []


@pytest.mark.parametrize("name", SPANS)
def test_fmpy_agrees(name):
    model = FMUModel(example_fmu(name))
    names = list(model.simulate(0, 0))[1:]
    span, more = SPANS[name], {}
    if name == "switched_input":
        more = {"start_values": {"gear": 2, "enabled": True}, "input": JUMPS}
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
        assert np.abs(ours[column] - theirs[column]).max() < 1e-6, column


def test_fmpy_agrees_on_time_events():
    path = example_fmu("stair")
    theirs = fmpy.simulate_fmu(str(path), stop_time=10, output_interval=0.25, output=["counter"], record_events=False)
    ours = FMUModel(path).simulate(0, 10, output_interval=0.25)
    # The model ends at 9 s, with 10; FMPy ends before it records that.
    rows = len(theirs)
    assert rows in (36, 37) and len(ours.time) == 37
    assert np.array_equal(ours.time[:36], theirs["time"][:36])
    assert np.array_equal(ours["counter"][:36], theirs["counter"][:36])
    assert ours.final("counter") == 10
