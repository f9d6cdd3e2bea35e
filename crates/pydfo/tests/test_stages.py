"""Fits in stages."""

from __future__ import annotations

import numpy as np
import pytest
import recordings

import pydfo
from pydfo import Calibration, Parameter, Stage, example_fmu

NOMINAL = {"C1": 2500.0, "G1": 120.0, "C2": 9000.0, "G2": 80.0}
WALLS = [["C2", "G2"], ["C1", "G1"]]


def exhaust(record, **more):
    bounds = {"C": (1.0, 5e4), "G": (0.01, 500.0)}
    parameters = [Parameter(name, start, *bounds[name[0]]) for name, start in NOMINAL.items()]
    return Calibration(example_fmu("exhaust"), record, ["T_out"], parameters, inputs=recordings.EXHAUST_INPUTS, window=(0, 600), **more)


def tanks(n=4, **more):
    levels = recordings.LEVELS
    parameters = [Parameter(f"qt.a{k + 1}", 3e-6, 2e-6, 4e-6) for k in range(4)]
    data = recordings.quad_tank("own")
    return Calibration(example_fmu("quad_tank"), data, levels[:n], parameters, inputs=["u1", "u2"], **more)


@pytest.mark.parametrize("method", ["auto", "nelder-mead"])
@pytest.mark.skipif("published" not in recordings.at_hand("exhaust_measurements.csv"), reason="the published recording is not at hand")
def test_exhaust_pipe_is_fitted_in_stages(method):
    fit = exhaust(recordings.exhaust("published")).fit(method, stages=WALLS, x_tol=1e-3, f_tol=1e-3)
    first, second = fit.stages
    assert fit.start_rms == pytest.approx(21.9885, abs=0.005)
    assert (first.parameters["C2"], first.parameters["G2"]) == (pytest.approx(20311.5, abs=100), pytest.approx(176.58, abs=1))
    assert (fit.parameters["C1"], fit.parameters["G1"]) == (pytest.approx(3447.9, abs=40), pytest.approx(62.54, abs=0.6))
    assert (first.parameters["C1"], first.parameters["G1"]) == (2500, 120)
    assert (fit.parameters["C2"], fit.parameters["G2"]) == (first.parameters["C2"], first.parameters["G2"])
    assert (first.cost, fit.cost) == (pytest.approx(16372.58, rel=1e-3), pytest.approx(9673.6, rel=1e-3))
    assert (first.scaled_rms, fit.scaled_rms) == (pytest.approx(0.2374, abs=0.003), pytest.approx(0.182, abs=0.003))
    assert fit.nfev == first.nfev + second.nfev == np.sum(fit.trace.used)
    # Each stage converged, but the minimum in all four parameters is lower.
    assert first.success and second.success and not fit.success and fit.termination == "before-minimum"
    assert "F022" in {finding.id for finding in fit.findings}
    assert fit["scaled_rms"] == fit.scaled_rms == fit.rms / fit.start_rms


@pytest.mark.parametrize("method", ["nelder-mead", "least-squares"])
@pytest.mark.parametrize(("n", "outlets", "cost"), [(2, [2.65838, 2.71220], 3.20422e-5), (4, [2.65931, 2.70252, 3.00666, 2.93158], 9.44303e-5)])
@pytest.mark.skipif("published" not in recordings.at_hand("qt_par_est_data.mat"), reason="the published recording is not at hand")
def test_tank_outlets_are_fitted_in_stages(method, n, outlets, cost):
    """Two stages, of which the last frees all outlets, have the same result as a single fit of all."""
    data, names = recordings.quad_tank("published"), [f"qt.a{k + 1}" for k in range(n)]
    parameters = [Parameter(name, 3e-6, 2e-6, 4e-6) for name in names]
    calibration = Calibration(example_fmu("quad_tank"), data, recordings.LEVELS[:n], parameters, inputs=["u1", "u2"])
    for stages in (None, [names[:1], names]):
        fit = calibration.fit(method, stages=stages, x_tol=1e-4, f_tol=1e-4)
        assert [1e6 * a for a in fit.x] == pytest.approx(outlets, abs=2e-3)
        assert fit.cost == pytest.approx(cost, abs=1e-7)


def test_stages_have_separate_methods_windows_and_limits():
    stages = [
        Stage(["qt.a1", "qt.a2"], windows=(0, 30), method="nelder-mead", max_evaluations=15),
        Stage(["qt.a3", "qt.a4"], x_tol=1e-2, f_tol=1e-2),
    ]
    calibration = tanks()
    fit = calibration.fit(stages=stages)
    first, second = fit.stages
    assert [stage.method for stage in fit.stages] == ["nelder-mead", "least-squares"]
    assert (first.nfev, first.termination) == (15, "max-evaluations") and not fit.success
    half = tanks(window=(0, 30))
    assert first.cost == half.cost(first.x) and first.rms == half._native.rms(list(first.x), first.cost)
    assert fit.start_cost == calibration.cost() and fit.rms == calibration._native.rms(list(fit.x), fit.cost)
    assert "x_tol 0.01" in second.message and "stage 2 of 2: " in fit.message
    assert np.all(np.diag(fit.cov) > 0)
    assert np.all(second.cov[:2] == 0) and np.all(np.diag(second.cov)[2:] > 0)
    assert fit.parameters["qt.a1"] == first.parameters["qt.a1"] != 3e-6


def test_limits_and_callbacks_cover_all_stages(tmp_path):
    calibration = tanks()
    stages = [["qt.a1", "qt.a2"], ["qt.a3", "qt.a4"]]
    whole = calibration.fit(stages=stages, batch="serial", workers=1)
    n = whole.stages[0].nfev
    assert np.array_equal(calibration.fit(stages=stages, batch="serial", workers=3).trace.x, whole.trace.x)
    some = calibration.fit(stages=stages, batch="serial", max_evaluations=n)
    assert (some.nfev, len(some.stages), some.termination) == (n, 1, "max-evaluations")
    seen = []
    calibration.fit(stages=stages, batch="serial", callback=lambda progress: seen.append(progress.nfev))
    assert seen == sorted(seen) and n < seen[-1] <= whole.nfev
    file = tmp_path / "fit.ckpt"
    for limit in (n - 1, n + 1, None):
        again = calibration.fit(stages=stages, batch="serial", max_evaluations=limit, checkpoint=file)
    assert np.array_equal(again.x, whole.x) and again.nfev == whole.nfev
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fit.ckpt.stage1", "fit.ckpt.stage2"]
    with pytest.raises(ValueError, match=r"'x' in stage 2") as caught:
        raised = []

        def callback(progress):
            raised.append(progress.nfev)
            if progress.nfev > n + 1:
                raise ValueError("'x' in stage 2")

        calibration.fit(stages=stages, batch="serial", callback=callback)
    assert len(caught.value.partial_result.stages) == 2


@pytest.mark.parametrize(
    ("stages", "error", "message"),
    [
        (["qt.a1", "qt.a2"], TypeError, "stage 1 requires a list of parameter names, such as"),
        ("qt.a1", TypeError, "stages must be a list of stages"),
        (Stage(["qt.a1"]), TypeError, "stages must be a list of stages"),
        ({"qt.a1": 1}, TypeError, "stages must be a list of stages"),
        ([], ValueError, "stages is empty"),
        ([[]], ValueError, "stage 1: the stage has no parameters. Specify at least one"),
        ([["qt.a1"], ["qt.a9"]], ValueError, "stage 2: parameter 'qt.a9' not found; available: qt.a1, qt.a2"),
        ([["qt.a1"], [3]], TypeError, "stage 2 requires parameter names, not 3"),
        ([["qt.a1", "qt.a1"]], ValueError, "stage 1: parameter 'qt.a1' is listed twice"),
    ],
)
def test_bad_stages_are_rejected(stages, error, message):
    with pytest.raises(error) as caught:
        tanks().fit(stages=stages)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"windows": (0, 1, 2)}, ValueError, "windows must be a pair (from, to)"),
        ({"windows": 30}, TypeError, "windows must be a pair (from, to), or a list of pairs, not 30"),
        ({"windows": []}, ValueError, "windows must be a pair"),
        ({"windows": ("a", "b")}, TypeError, "windows"),
        ({"windows": (70, 80)}, ValueError, "stage 1: "),
        ({"windows": (30, 0)}, ValueError, "stage 1: "),
        ({"method": "simplex"}, ValueError, "did you mean 'nelder-mead'?"),
        ({"max_evaluations": 0}, ValueError, "max_evaluations"),
        ({"options": {"population": 3}, "method": "nelder-mead"}, ValueError, "population"),
    ],
)
def test_bad_stage_objects_are_rejected(arguments, error, message):
    with pytest.raises(error) as caught:
        tanks().fit(stages=[Stage(["qt.a1"], **arguments)])
    assert message in str(caught.value)


def test_stage_frees_all_or_one_value_of_local_parameter():
    time = np.linspace(0, 1, 21)
    made = [pydfo.Experiment({"time": time, "x": x0 * np.exp(-2 * time)}, ["x"], start_values={"x": 1.0}) for x0 in (1.0, 2.0)]
    parameters = [Parameter("k", 1.0, 0.1, 10.0), Parameter("x", 1.5, 0.1, 5.0, local=True)]
    calibration = Calibration(example_fmu("dahlquist"), made, parameters)
    fit = calibration.fit(stages=[["k"], ["x[run2]"], ["x", "k"]])
    assert fit.stages[0].parameters["x[run2]"] == 1.0 == fit.stages[1].parameters["x[run1]"] != fit.stages[1].parameters["x[run2]"]
    assert fit.x == pytest.approx([2.0, 1.0, 2.0], rel=1e-3)
