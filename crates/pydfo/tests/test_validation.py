"""Validation, cross-validation, prediction bands."""

from __future__ import annotations

import numpy as np
import pytest
import recordings

import pydfo
from pydfo import Calibration, Experiment, Parameter, example_fmu

TIME = np.linspace(0, 3, 31)


def decay(k, x0, noise=0.0, **more):
    values = x0 * np.exp(-k * TIME) + noise * np.resize([1.0, -1.0, -1.0, 1.0], TIME.size)
    return Experiment({"time": TIME, "x": values}, ["x"], **more)


@pytest.fixture(scope="module")
def one():
    parameters = [Parameter("k", 1.0, 0.1, 10.0), Parameter("x", 1.5, 0.1, 10.0)]
    return Calibration(example_fmu("dahlquist"), [decay(2.0, 1.0, 3e-3, window=(0, 2))], parameters).fit()


@pytest.fixture(scope="module")
def two():
    parameters = [Parameter("k", 1.0, 0.1, 10.0), Parameter("x", 1.5, 0.1, 10.0, local=True)]
    return Calibration(example_fmu("dahlquist"), [decay(2.0, 1.0, 1e-3), decay(2.05, 2.0, name="warm")], parameters)


@pytest.mark.skipif("published" not in recordings.at_hand("exhaust_measurements.csv"), reason="the published recording is not at hand")
def test_exhaust_pipe_is_validated_after_ten_minutes():
    """Both sets use simulations that start at 0, so that the wall temperatures include their history."""
    nominal = {"C1": 2500.0, "G1": 120.0, "C2": 9000.0, "G2": 80.0}
    bounds = {"C": (1.0, 5e4), "G": (0.01, 500.0)}
    parameters = [Parameter(name, start, *bounds[name[0]]) for name, start in nominal.items()]
    inputs, data = recordings.EXHAUST_INPUTS, recordings.exhaust("published")
    calibration = Calibration(example_fmu("exhaust"), data, ["T_out"], parameters, inputs=inputs, window=(0, 600))
    fit = calibration.fit(stages=[["C2", "G2"], ["C1", "G1"]], x_tol=1e-3, f_tol=1e-3)
    first, last = (of.validate(windows=(601, 1800)) for of in (fit.stages[0], fit))
    assert (last.n, last.start_rms) == (1200, pytest.approx(13.5848, abs=0.005))
    assert (first.scaled_rms, last.scaled_rms) == (pytest.approx(0.4236, abs=0.003), pytest.approx(0.361, abs=0.003))
    assert (first.rms, last.rms) == (pytest.approx(5.7550, abs=0.02), pytest.approx(4.9053, abs=0.02))
    assert fit.validate(window=(0, 600)).rms == fit.rms
    (output,) = last.outputs
    assert (output.variable, output.unit, output.n, output.time[0]) == ("T_out", "K", 1200, 601)
    spread = np.linalg.norm(output.measured - output.measured.mean())
    assert output.fit_percent == pytest.approx(100 * (1 - np.linalg.norm(output.residuals) / spread))
    assert "T_out" in repr(last) and "scaled RMS" in repr(last)


def test_fit_is_validated_on_window_and_recording(one):
    window = one.validate(windows=(2.05, 3.0))
    k, x0 = one.x
    assert window.n == 10 and window.parameters == one.parameters
    simulated = x0 * np.exp(-k * window.outputs[0].time)
    assert window.outputs[0].simulated == pytest.approx(simulated, abs=1e-5)
    assert window.rms == pytest.approx(np.sqrt(np.mean(window.outputs[0].residuals ** 2)), rel=1e-12)
    other = one.validate(decay(2.0, 1.0, name="again"))
    assert (other.n, other.outputs[0].experiment) == (31, "again") and other.rms < 2e-3 < other.start_rms
    several = one.validate([decay(2.0, 1.0, name="a"), decay(2.1, 1.0, name="b")])
    assert [output.experiment for output in several.outputs] == ["a", "b"]
    assert several.outputs[0].rms < several.outputs[1].rms
    assert window.stats.accepted_steps > 0


def test_validations_are_plotted(one):
    pytest.importorskip("matplotlib").use("Agg")
    figure = one.validate(windows=(2, 3)).plot()
    assert [axis.get_xlabel() for axis in figure.axes][1] == "time [s]"
    assert len(figure.axes[0].lines) == 3


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({}, ValueError, "but not both"),
        ({"experiment": decay(2.0, 1.0), "windows": (0, 1)}, ValueError, "but not both"),
        ({"windows": (5, 6)}, ValueError, "5"),
        ({"windows": (3, 1)}, ValueError, "window"),
        ({"windows": 2}, TypeError, "windows must be a pair"),
        ({"windows": (0, None)}, TypeError, "windows must be a number"),
        ({"experiment": "run2.csv"}, TypeError, "experiment must be an Experiment or a list of Experiments, not 'run2.csv'"),
        ({"experiment": {"time": TIME}}, TypeError, "experiment must be an Experiment"),
        ({"experiment": []}, ValueError, "the list of experiments is empty"),
        ({"experiment": Experiment({"time": TIME, "y": TIME}, ["y"])}, KeyError, "did you mean x"),
        ({"holdout": (0, 1)}, TypeError, "holdout"),
    ],
)
def test_bad_validations_are_rejected(one, arguments, error, message):
    with pytest.raises(error) as caught:
        one.validate(**arguments)
    assert message in str(caught.value)


def test_each_recording_is_omitted_once(two):
    found = two.cross_validate()
    assert [fold.held_out for fold in found.folds] == [["run1"], ["warm"]]
    assert list(found.folds[0].parameters) == ["k", "x[warm]"]
    assert found.folds[0].validation.parameters["x[run1]"] == pytest.approx(1.0, abs=0.02)
    mean, spread = found.parameters["k"]
    assert mean == pytest.approx(2.025, abs=2e-3) and spread == pytest.approx(0.05 / np.sqrt(2), rel=0.05)
    assert found.rms == pytest.approx(np.sqrt(np.mean([fold.validation.rms**2 for fold in found.folds])))
    assert "held out" in repr(found) and "spread" in repr(found)
    assert two.cross_validate(workers=1, folds=2).rms == found.rms
    for folds, message in ((1, "folds = 1 must be from 2"), (3, "number of recordings, 2"), (1.5, "folds = 1.5 must be an integer")):
        with pytest.raises(ValueError, match=message):
            two.cross_validate(folds=folds)


def test_single_recording_is_rejected(one):
    with pytest.raises(ValueError, match="at least two experiments, but there is one"):
        one._calibration.cross_validate()


def test_prediction_bands_match_reference(one):
    times = [0.0, 0.5, 2.5]
    band = one.prediction_band(times)["x"]
    k, x0 = one.x
    assert band.value == pytest.approx(x0 * np.exp(-k * np.array(times)), abs=1e-5)
    gradient = np.array([[-t * x0 * np.exp(-k * t), np.exp(-k * t)] for t in times])
    errors = np.sqrt(np.einsum("ti,ij,tj->t", gradient, one.cov, gradient))
    assert band.standard_error == pytest.approx(errors, rel=0.02)
    assert np.all(band.lower < band.value) and np.all(band.measured_upper > band.upper)
    narrow = one.prediction_band(times, level=0.5, outputs="x")["x"]
    assert np.all(narrow.upper < band.upper)
    assert len(one.prediction_band()["x"].time) == 21
    wrong = (
        ({"level": 95}, "between 0 and 1"),
        ({"outputs": ["y"]}, "output 'y' not found"),
        ({"times": [1.0, 0.5]}, "times must ascend"),
        ({"times": [3, 1]}, "comes after 3"),
    )
    for arguments, message in wrong:
        with pytest.raises(ValueError, match=message):
            one.prediction_band(**arguments)


def test_prediction_bands_cover_several_experiments(two):
    band = two.fit().prediction_band([1.0])
    assert set(band) == {"run1", "warm"} and isinstance(band["warm"]["x"], pydfo.PredictionBand)


def test_cross_validation_reports_parameters_without_another_recording():
    t = np.arange(31) / 10
    runs = [Experiment({"time": t, "x": 1.5 * np.exp(-k * t)}, ["x"], name=name) for name, k in (("a", 2.0), ("b", 2.0), ("c", 0.5))]
    parameters = [
        Parameter("fast", 1, 0.1, 10, variables=["k"], experiments=["a", "b"]),
        Parameter("slow", 1, 0.1, 10, variables=["k"], experiments=["c"]),
        Parameter("x", 1, 0.1, 10),
    ]
    found = Calibration(example_fmu("dahlquist"), runs, parameters).cross_validate()
    assert [fold.validation.fitted for fold in found.folds] == [[], [], ["slow"]] and list(found.folds[2].parameters) == ["fast", "x"]
    assert found.folds[2].validation.parameters["slow"] == pytest.approx(0.5, abs=1e-3)
    assert found.parameters["fast"][0] == pytest.approx(2.0, abs=1e-3) and "which alone determines them: slow" in str(found)
