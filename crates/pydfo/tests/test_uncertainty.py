"""The uncertainty of a fit: standard errors, correlation, verdict, compared with published numbers and SciPy."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
import recordings

import pydfo
from pydfo import Calibration, Parameter, example_fmu

FRICTION = [Parameter("armFriction", 0.012, 0, 0.022), Parameter("pendulumFriction", 0.002, 0, 0.012)]
ANGLES = {"armJoint.phi": "phi", "pendulumJoint.phi": "theta"}
PUBLISHED = "published" in recordings.at_hand("FurutaData.mat")


@pytest.fixture(scope="module")
def furuta():
    return Calibration(example_fmu("furuta"), recordings.furuta("published" if PUBLISHED else "own"), ANGLES, FRICTION)


@pytest.mark.parametrize(
    ("estimator", "stderr", "correlation"),
    [("sandwich", [1.375e-5, 1.094e-6], -0.621), ("pooled", [1.600e-5, 1.352e-6], -0.659)],
)
def test_pendulum_errors_match_published_errors(furuta, estimator, stderr, correlation):
    fit = furuta.fit(covariance=estimator)
    assert fit.uncertainty.estimator == estimator and fit.nfev == len(fit.trace)
    if PUBLISHED:
        np.testing.assert_allclose(fit.stderr, stderr, rtol=0.05)
        assert fit.correlation[0, 1] == pytest.approx(correlation, abs=0.02)
    assert fit.uncertainty.verdict == [] and fit.uncertainty.identifiable == furuta.names
    np.testing.assert_array_equal(fit.cov, fit.covariance)
    assert json.loads(json.dumps(fit.stderr.to_dict())) == dict(fit.stderr) == dict(zip(fit.parameters, fit.stderr.values()))
    assert fit.stderr.get("armFriction") == fit.stderr[0] and fit.stderr.get("x", 1.0) == 1.0
    assert fit.parameters.to_dict() == dict(fit.parameters) and type(fit.parameters.to_dict()) is dict
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance)), fit.stderr)
    intervals = fit.confidence_intervals(0.95)
    np.testing.assert_allclose(intervals.mean(axis=1), fit.x, rtol=1e-12)
    np.testing.assert_allclose(np.diff(intervals)[:, 0], 2 * 1.9614 * fit.stderr, rtol=1e-3)
    assert estimator in repr(fit.uncertainty) and "+-" in repr(fit.uncertainty)


@pytest.mark.skipif(not PUBLISHED, reason="the published recordings are not here")
@pytest.mark.parametrize(
    ("n", "sandwich", "pooled"),
    [(2, [0.0022, 0.0015], [0.0019, 0.0020]), (4, [0.0022, 0.0023, 0.0034, 0.0071], [0.0024, 0.0025, 0.0053, 0.0052])],
)
def test_tank_errors_match_published_errors(n, sandwich, pooled):
    parameters = [Parameter(f"qt.a{k + 1}", 3e-6, 2e-6, 4e-6) for k in range(n)]
    calibration = Calibration(example_fmu("quad_tank"), recordings.quad_tank("published"), recordings.LEVELS[:n], parameters, inputs=["u1", "u2"])
    for estimator, expected in (("sandwich", sandwich), ("pooled", pooled)):
        fit = calibration.fit(covariance=estimator)
        np.testing.assert_allclose(fit.uncertainty.uncorrected_stderr * 1e6, expected, atol=1e-4)
        assert (fit.stderr > 2 * fit.uncertainty.uncorrected_stderr).all()
        assert all(0.79 < check.autocorrelation < 0.93 for check in fit.uncertainty.residual_checks)
    assert any("autocorrelated" in verdict for verdict in fit.uncertainty.verdict)


def test_autocorrelation_is_corrected_unless_disabled(tmp_path):
    time = np.linspace(0, 4, 80)
    x = np.exp(-1.5 * time) + 0.02 * np.sin(4 * time)
    fit = Calibration(example_fmu("dahlquist"), {"time": time, "x": x}, ["x"], [Parameter("k", 1.0, 0.1, 5.0)]).fit()
    uncertainty = fit.uncertainty
    assert uncertainty.autocorrelations[0] > 0.8 and uncertainty.effective_degrees_of_freedom[0] < uncertainty.degrees_of_freedom
    assert fit.stderr[0] > 2 * uncertainty.uncorrected_stderr[0]

    def width(corrected):
        intervals = fit.confidence_intervals(corrected=corrected)
        band = fit.prediction_band([1.0], corrected=corrected)["x"]
        (low, high) = fit.profile(corrected=corrected).intervals["k"]
        return np.array([np.diff(intervals)[0, 0], band.upper[0] - band.lower[0], high - low])

    assert (width(True) > 2 * width(False)).all()
    assert (width(True)[0] == np.diff(fit.confidence_intervals())).all()
    low, high = fit.confidence_intervals()[0]
    assert f"+- {fit.stderr[0]:.2g}"[:6] in str(fit) and "uncorrected" in str(fit) and "corrected for" in str(uncertainty)
    fit.report(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert f"{low:.2f} to {high:.2f}" in page and "uncorrected" in page


def test_likelihood_has_standard_errors_and_a_plot():
    time = np.linspace(0, 3, 60)
    x = np.exp(-1.5 * time) + np.random.default_rng(3).normal(0, 0.02, time.size)
    calibration = Calibration(example_fmu("dahlquist"), {"time": time, "x": x}, ["x"], [Parameter("k", 1.0, 0.1, 5.0)])
    fit, plain = calibration.fit(objective="likelihood"), calibration.fit()
    assert fit.cost < 0
    np.testing.assert_allclose(fit.stderr, plain.stderr, rtol=0.01)
    pytest.importorskip("matplotlib").use("Agg")
    assert fit.plot_convergence().axes[0].get_yscale() == "linear"
    assert plain.plot_convergence().axes[0].get_yscale() == "log"


def test_covariance_matches_curve_fit():
    curve_fit = pytest.importorskip("scipy.optimize").curve_fit
    time = np.linspace(0, 3, 60)
    x = 1.2 * np.exp(-1.5 * time) + np.random.default_rng(3).normal(0, 0.02, time.size)
    best, expected = curve_fit(lambda t, k, x0: x0 * np.exp(-k * t), time, x, [1.0, 1.0])
    for scale in ("linear", "log"):
        parameters = [Parameter("k", 1.0, 0.1, 5.0, scale=scale), Parameter("x", 1.0, 0.1, 5.0, scale=scale)]
        fit = Calibration(example_fmu("dahlquist"), {"time": time, "x": x}, ["x"], parameters).fit(covariance="pooled")
        np.testing.assert_allclose(fit.x, best, rtol=1e-3)
        np.testing.assert_allclose(fit.covariance, expected, rtol=5e-3)


def test_undetermined_parameters_are_reported(furuta):
    time = np.linspace(0, 0.4, 40)
    noise = np.random.default_rng(1).normal(0, 1e-3, time.size)
    parameters = [Parameter("e", 0.7, 0.1, 0.95), Parameter("g", -9.0, -15.0, -5.0)]
    calibration = Calibration(example_fmu("bouncing_ball"), {"time": time, "h": 1 - 0.5 * 9.81 * time**2 + noise}, ["h"], parameters)
    fit = calibration.fit()
    assert fit.uncertainty.undetermined == ["e"] and np.isinf(fit.stderr[0]) and fit.uncertainty.identifiable == ["g"]
    assert fit.findings[0].severity == "warning" and fit.findings[0].sentence.startswith("the data do not determine e")
    assert "determine" not in fit.message and "do not determine e" in fit.cov_message
    copy = pickle.loads(pickle.dumps(fit.uncertainty))
    assert copy.findings == fit.uncertainty.findings and repr(copy) == repr(fit.uncertainty) and copy.covariance.tobytes() == fit.cov.tobytes()
    before = calibration.preflight()
    assert [check.has_effect for check in before.parameters] == [False, True] and before.n_simulations == 4
    assert before.findings[0].id == "F002" and "changes no output" in repr(before) and before.cost == calibration.cost()
    assert calibration.fit(preflight=True).preflight.findings == before.findings and fit.preflight is None
    conditional = calibration.uncertainty(fit.x, parameters=["g"])
    assert conditional.held == ["e"] and conditional.undetermined == []
    without = calibration.fit(covariance=None)
    assert without.uncertainty is None and without.stderr is None and without.cov is None and without.cov_message == ""
    with pytest.raises(ValueError, match="covariance=None"):
        without.confidence_intervals()
    with pytest.raises(ValueError, match="'full' is invalid; expected one of: 'sandwich', 'pooled'"):
        calibration.fit(covariance="full")
    with pytest.raises(ValueError, match="unknown parameter 'h0'"):
        calibration.uncertainty(parameters=["h0"])
    with pytest.raises(ValueError, match="between 0 and 1"):
        fit.confidence_intervals(95)
    with pytest.raises(pydfo.SimulationError):
        furuta.uncertainty([0.01, np.inf])


def test_undriven_inputs_are_reported():
    data = recordings.quad_tank("own")
    recording = {"time": data["time"], "level": data["qt.x1"]}
    calibration = Calibration(example_fmu("quad_tank"), recording, {"qt.x1": "level"}, [Parameter("qt.a1", 3e-6, 2e-6, 4e-6)])
    fit = calibration.fit()
    (expected,) = [finding for finding in fit.findings if finding.subject == "input 'u1'"]
    assert expected.severity == "warning" and "warning  input 'u1': the input is not driven" in repr(fit)
    assert "F054" not in fit.message and "F054" not in repr(calibration.fit(covariance=None))
