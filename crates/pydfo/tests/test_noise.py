"""The noise estimated by a fit with priors, and the tolerance chosen by a fit."""

from __future__ import annotations

import functools
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pydfo
from pydfo import Calibration, Normal, Parameter, example_fmu

T = np.arange(51) / 10


def decay(noise: float, prior: Normal, start: float = 1.0, **options: Any) -> Calibration:
    x = np.exp(-2.0 * T) + noise * np.random.default_rng(7).standard_normal(51)
    return Calibration(example_fmu("dahlquist"), {"time": T, "x": x}, "x", [Parameter("k", start, 0.01, 50, prior=prior)], **options)


@pytest.mark.parametrize("start", [0.05, 1.0, 20.0])
def test_noise_is_estimated_with_a_prior(start: float) -> None:
    fit = decay(1e-3, Normal(1.0, 0.3), start).fit()
    assert fit.noise is not None and fit.noise.source == "estimated" and fit.noise.settled and fit.noise.of_residuals == {"x": True}
    assert fit.noise.sd["x"] == pytest.approx(1e-3, rel=0.3)
    assert abs(fit.x[0] - 2.0) < 4 * fit.stderr[0] and fit.rms == pytest.approx(1e-3, rel=0.3)
    assert fit.success and "estimated with the parameters" in str(fit)
    low, high = fit.profile().intervals["k"]
    assert low < fit.parameters["k"] < high
    assert not [f for f in fit.findings if "prior" in f.subject]


def test_stated_noise_is_kept() -> None:
    stated = decay(1e-3, Normal(1.0, 0.3), weights={"x": 1e3}).fit()
    assert stated.noise is not None and stated.noise.source == "stated" and stated.noise.sd == {}
    assert abs(stated.x[0] - 2.0) < 4 * stated.stderr[0]
    of_one = decay(1e-3, Normal(1.0, 0.3)).fit(noise="stated")
    assert of_one.x[0] < 1.5 and of_one.noise is not None and of_one.noise.source == "known"
    assert Calibration(example_fmu("dahlquist"), {"time": T, "x": np.exp(-T)}, "x", [Parameter("k", 2, 0, 9)]).fit().noise is None
    with pytest.raises(ValueError, match="noise = 'known' is invalid; expected one of: 'auto', 'stated', 'estimated'"):
        decay(1e-3, Normal(1.0, 0.3)).fit(noise="known")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="noise 'estimated' requires the sum of squares"):
        decay(1e-3, Normal(1.0, 0.3)).fit(noise="estimated", loss="huber")


def test_known_sigma_gives_the_standard_errors_of_curve_fit(tmp_path: Path) -> None:
    curve_fit = pytest.importorskip("scipy.optimize").curve_fit
    # The derivatives are differences over one standard error, so their error decreases with the square of the noise.
    sigma = 0.002 * (1 + T)
    x = 1.5 * np.exp(-2.0 * T) + sigma * np.random.default_rng(3).standard_normal(51)
    parameters = [Parameter("k", 1.0, 0.01, 50), Parameter("x", 1.0, 0.1, 9)]
    data = {"time": T, "x": x, "s": sigma}

    def errors(absolute: bool) -> np.ndarray:
        of = lambda t, k, start: start * np.exp(-k * t)  # noqa: E731
        return np.sqrt(np.diag(curve_fit(of, T, x, [1.0, 1.0], sigma, absolute, xtol=1e-12, ftol=1e-12)[1]))

    settings = {"relative_tolerance": 1e-10}
    weighted = Calibration(example_fmu("dahlquist"), data, "x", parameters, weights={"x": 1 / sigma}, **settings)
    np.testing.assert_allclose(weighted.fit().stderr, errors(False), rtol=1e-4)
    np.testing.assert_allclose(weighted.fit(noise="stated").stderr, errors(True), rtol=1e-4)
    for given in ("s", {"x": "s"}, {"x": sigma}):
        fit = Calibration(example_fmu("dahlquist"), data, "x", parameters, sigma=given, **settings).fit()
        np.testing.assert_allclose(fit.stderr, errors(True), rtol=1e-4)
        assert fit.noise is not None and fit.noise.source == "known" and "known (sigma)" in str(fit)
        assert fit.uncertainty is not None and np.isinf(fit.uncertainty.degrees_of_freedom)
        low, high = fit.profile("k").intervals["k"]
        assert (high - low) / (2 * 1.96 * fit.stderr[0]) == pytest.approx(1, rel=0.05)
        np.testing.assert_allclose(fit.prediction_band()["x"].noise, sigma)
    fit.save(tmp_path / "a.fit")
    assert pydfo.load_fit(tmp_path / "a.fit").profile("k").intervals == fit.profile("k").intervals
    assert fit.to_dict()["noise"] == "known"


def test_sigma_of_missing_measurement_may_be_missing() -> None:
    y = np.array([1.0, np.nan, 0.36, 0.13])
    sigma = np.array([0.1, np.nan, 0.1, 0.2])
    k = pydfo.Parameter("k", 1.0, 0.1, 10.0)
    model = pydfo.example_fmu("dahlquist")
    found = pydfo.Calibration(model, {"time": [0, 1, 2, 3], "x": y}, "x", k, sigma={"x": sigma}).fit()
    there = ~np.isnan(y)
    data = {"time": np.arange(4.0)[there], "x": y[there]}
    expected = pydfo.Calibration(model, data, "x", k, sigma={"x": sigma[there]}).fit()
    assert found.x.tobytes() == expected.x.tobytes() and found.cost == expected.cost
    sigma[2] = np.nan
    with pytest.raises(pydfo.CalibrationError, match="sigma NaN of output 'x' at time 2 must be positive"):
        pydfo.Calibration(model, {"time": [0, 1, 2, 3], "x": y}, "x", k, sigma={"x": sigma})


def test_name_of_a_sigma_is_a_column() -> None:
    data = {"time": T, "x": np.exp(-2.0 * T), "a": np.full(51, 0.1)}
    k = [pydfo.Parameter("k", 1.0, 0.1, 10.0)]
    build = functools.partial(pydfo.Calibration, example_fmu("dahlquist"), outputs="x", parameters=k)
    assert build(data, sigma="a").cost([1.0]) == pytest.approx(100 * build(data).cost([1.0]))
    del data["a"]
    hint = r"column 'a' not found; .* sigma 'a' is the name of a column; write 'a \+ 0\*abs\(y\)' for a standard deviation that"
    for sigma in ("a", {"x": "a"}):
        with pytest.raises(ValueError, match=hint):
            build(data, sigma=sigma)
    noisy = data | {"x": data["x"] + 0.01 * np.random.default_rng(1).standard_normal(51)}
    noise = build(noisy, sigma="a + 0*abs(y)").fit().noise
    assert noise is not None and noise.coefficients["x"]["a"] == pytest.approx(0.01, rel=0.3)


def test_known_sigma_is_drawn_as_error_bars(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib").use("Agg")
    sigma = 0.01 * (1 + T)
    sigma[3] = np.inf
    data = {"time": T, "x": np.exp(-2.0 * T) + 0.01 * np.sin(9 * T)}
    k = [pydfo.Parameter("k", 1.0, 0.1, 10.0)]
    fit = pydfo.Calibration(example_fmu("dahlquist"), data, "x", k, sigma=sigma).fit()
    upper, lower = fit.plot().axes
    for axes in (upper, lower):
        (bars,) = axes.collections
        heights = [float(np.ptp(segment[:, 1])) for segment in bars.get_segments()]
        np.testing.assert_allclose(heights, 2 * np.delete(sigma, 3), rtol=1e-6)
    fit.report(tmp_path / "fit.html")
    assert "Bars: one known standard deviation (sigma)." in (tmp_path / "fit.html").read_text()
    plain = pydfo.Calibration(example_fmu("dahlquist"), data, "x", k).fit()
    assert not plain.plot().axes[0].collections
    plain.report(tmp_path / "plain.html")
    assert "Bars:" not in (tmp_path / "plain.html").read_text()


def test_sigma_reports_wrong_arguments() -> None:
    def build(**options: Any) -> Calibration:
        return Calibration(example_fmu("dahlquist"), {"time": T, "x": np.exp(-T)}, "x", [Parameter("k", 2, 0, 9)], **options)

    with pytest.raises(ValueError, match="sigma: unknown output 'y'; expected one of: x"):
        build(sigma={"y": 1.0})
    with pytest.raises(ValueError, match="output 'x' has a weight and a sigma"):
        build(sigma=0.1, weights={"x": 3.0})
    with pytest.raises(ValueError, match="sigma 0 of output 'x' must be positive"):
        build(sigma={"x": 0.0})
    with pytest.raises(ValueError, match=r"the noise of 'x' is known \(sigma\)"):
        build(sigma=0.1).fit(objective="likelihood")


@pytest.mark.parametrize("absolute", [True, False])
def test_least_squares_has_the_covariance_of_curve_fit(absolute: bool) -> None:
    curve_fit = pytest.importorskip("scipy.optimize").curve_fit
    y = 1.5 * np.exp(-2.0 * T) + 0.03 * np.random.default_rng(4).standard_normal(51)
    found = pydfo.least_squares(
        lambda p: (p[0] * np.exp(-p[1] * T) - y) / 0.03, [1.0, 1.0], x_tol=1e-9, f_tol=1e-12, absolute_sigma=absolute
    )
    sigma = np.full(51, 0.03)
    expected = curve_fit(lambda t, a, k: a * np.exp(-k * t), T, y, [1.0, 1.0], sigma, absolute)[1]
    assert found.cov is not None
    np.testing.assert_allclose(found.cov, expected, rtol=1e-2)
    with pytest.raises(ValueError, match="absolute_sigma=True requires loss='linear', not 'huber'"):
        pydfo.least_squares(lambda p: p - y[:1], [1.0], loss="huber", absolute_sigma=True)


def test_noise_is_kept_by_files_pickles_and_checkpoints(tmp_path: Path) -> None:
    fit = decay(0.05, Normal(1.0, 0.1)).fit(checkpoint=tmp_path / "fit.ckpt")
    fit.save(tmp_path / "a.fit")
    for other in (pydfo.load_fit(tmp_path / "a.fit"), pickle.loads(pickle.dumps(fit))):
        assert (other.noise, other.tolerance, other.cost) == (fit.noise, fit.tolerance, fit.cost)
        assert other.profile().intervals == fit.profile().intervals
    resumed = decay(0.05, Normal(1.0, 0.1)).fit(checkpoint=tmp_path / "fit.ckpt", resume="require")
    assert (resumed.x.tobytes(), resumed.cost, resumed.nfev, resumed.noise) == (fit.x.tobytes(), fit.cost, fit.nfev, fit.noise)
    assert fit.to_dict()["noise"]["estimated"]["outputs"][0]["sd"] == fit.noise.sd["x"]
    band = fit.prediction_band()["x"]
    np.testing.assert_allclose(band.noise, fit.noise.sd["x"], rtol=0.03)


def test_small_f_tol_selects_small_tolerance() -> None:
    fit = decay(1e-4, Normal(2.0, 1.0)).fit(f_tol=1e-8)
    assert fit.tolerance is not None and fit.tolerance.used < fit.tolerance.stated == 1e-6
    assert any(f.id == "F027" for f in fit.findings)
    assert decay(1e-4, Normal(2.0, 1.0), relative_tolerance=1e-6).fit(f_tol=1e-8).tolerance is None


def varying(sigma: Any, noise: str = "combined", seed: int = 5) -> Calibration:
    y = 3.0 * np.exp(-1.0 * T)
    deviate = np.random.default_rng(seed).standard_normal(51)
    x = y * np.exp(0.1 * deviate) if noise == "log" else y + (0.05 + 0.1 * y) * deviate
    parameters = [Parameter("k", 0.8, 0.01, 50), Parameter("x", 2.0, 0.1, 9)]
    return Calibration(example_fmu("dahlquist"), {"time": T, "x": x}, "x", parameters, sigma=sigma)


def test_error_model_uses_simulated_values(tmp_path: Path) -> None:
    fit = varying({"x": "0.05 + 0.1*abs(y)"}).fit(x_tol=1e-9, f_tol=1e-12)
    assert fit.noise is not None and fit.noise.source == "known" and fit.noise.settled and fit.noise.coefficients == {}
    sigma = 0.05 + 0.1 * fit.x[1] * np.exp(-fit.x[0] * T)
    np.testing.assert_allclose(fit.prediction_band()["x"].noise, sigma, rtol=1e-3)
    # A fit with these standard deviations as known numbers has the same result.
    fixed = varying({"x": sigma}).fit(x_tol=1e-9, f_tol=1e-12)
    assert fit.x == pytest.approx(fixed.x, rel=1e-4) and fit.stderr == pytest.approx(fixed.stderr, rel=1e-3)
    assert fit.goodness.p_value == pytest.approx(fixed.goodness.p_value, rel=1e-2)
    fit.save(tmp_path / "a.fit")
    assert pydfo.load_fit(tmp_path / "a.fit").profile("k").intervals == fit.profile("k").intervals


def test_fitted_error_model_reports_its_coefficients() -> None:
    fit = varying("a + b*abs(y)").fit()
    assert fit.noise is not None and fit.noise.source == "estimated" and list(fit.noise.coefficients["x"]) == ["a", "b"]
    assert sum(fit.noise.coefficients["x"].values()) == pytest.approx(0.15, rel=0.3)
    assert "sigma of x a + b*abs(y), a = " in str(fit)
    assert varying("b*abs(y)").fit().goodness.aic > fit.goodness.aic
    with pytest.raises(ValueError, match="has an error model"):
        fit.compare(varying(0.1).fit())
    with pytest.raises(ValueError, match="depends on simulated values"):
        varying("a + b*abs(y)").fit(loss="huber")
    with pytest.raises(ValueError, match=r"sigma of column 'x': 'a \+ b\*abs\(z\)' is not an error model"):
        varying("a + b*abs(z)")


def test_log_normal_noise_is_a_regression_of_logarithms() -> None:
    calibration = varying("log", "log")
    fit = calibration.fit()
    recorded = 3.0 * np.exp(-T) * np.exp(0.1 * np.random.default_rng(5).standard_normal(51))
    slope, intercept = np.polyfit(T, np.log(recorded), 1)
    assert fit.x[0] == pytest.approx(-slope, rel=1e-3) and fit.x[1] == pytest.approx(np.exp(intercept), rel=1e-3)
    assert varying("LOG", "log").cost(fit.x) == calibration.cost(fit.x)
    with pytest.raises(ValueError, match="must be positive for sigma 'log'"):
        Calibration(example_fmu("dahlquist"), {"time": T, "x": recorded - 1}, "x", [Parameter("k", 1, 0, 9)], sigma="log")
