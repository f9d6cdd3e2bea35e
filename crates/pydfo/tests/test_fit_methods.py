"""Fits by every method, and on from their checkpoints."""

from __future__ import annotations

import numpy as np
import pytest
from methods import METHODS, timeless
from test_calibration import TIME, TRUE, decay

import pydfo
from pydfo import Parameter, example_fmu

BOXED = [Parameter("k", 1.0, 0.1, 5.0)]


@pytest.fixture(scope="module")
def dahlquist():
    """x' = -k x, x(0) = 1."""
    return example_fmu("dahlquist")


@pytest.mark.parametrize("method", METHODS)
def test_every_method_fits_with_its_options(dahlquist, method):
    calibration = decay(dahlquist, parameters=BOXED)
    options = {"population": 24} if method in ("de", "de-classic", "ga") else {"batch": "four"}
    options = {"points": 3} if method == "quadratic-model" else options
    fits = [
        calibration.fit(method, rng=3, max_evaluations=500, workers=workers, options=options) for workers in (1, 2)
    ]
    fit = fits[0]
    assert fit.method == method and fit.x[0] == pytest.approx(2.0, abs=2e-3)
    assert timeless(fits[0]) == timeless(fits[1])
    if "population" in options:
        assert fit.seed == 3 and np.count_nonzero(fit.trace.batch == 0) == 24
    elif "batch" in options:
        assert fit.batch == "four"


@pytest.mark.parametrize("method", METHODS)
def test_a_fit_goes_on_from_its_checkpoint(dahlquist, method, tmp_path):
    calibration = decay(dahlquist, parameters=BOXED)
    options = {"budget": 200} if method == "de" else {}
    run = {"method": method, "rng": 5, "options": options, "workers": 1}
    whole = calibration.fit(**run, max_evaluations=200)
    path, evaluations = tmp_path / "fit", 0
    while evaluations < 200:
        evaluations = min(evaluations + 23, 200)
        fit = calibration.fit(**run, max_evaluations=evaluations, checkpoint=path)
    assert timeless(fit) == timeless(whole)
    other = decay(dahlquist, data={"time": TIME, "x": TRUE + 1e-9}, parameters=BOXED)
    before = path.read_bytes()
    with pytest.raises(pydfo.CheckpointError, match="data of experiment 0"):
        other.fit(**run, max_evaluations=200, checkpoint=path)
    with pytest.raises(pydfo.CheckpointError, match="relative tolerance: 1e-10 in the file, 1e-9 here"):
        decay(dahlquist, parameters=BOXED, relative_tolerance=1e-9).fit(**run, max_evaluations=200, checkpoint=path)
    assert path.read_bytes() == before
