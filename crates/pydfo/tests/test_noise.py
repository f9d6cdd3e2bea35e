"""The noise estimated by a fit with priors, and the tolerance chosen by a fit."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pydfo
from pydfo import Calibration, Normal, Parameter, example_fmu

T = np.arange(51) / 10


def decay(noise: float, prior: Normal, start: float = 1.0, **own: Any) -> Calibration:
    x = np.exp(-2.0 * T) + noise * np.random.default_rng(7).standard_normal(51)
    return Calibration(example_fmu("dahlquist"), {"time": T, "x": x}, "x", [Parameter("k", start, 0.01, 50, prior=prior)], **own)


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
    assert of_one.x[0] < 1.5 and of_one.noise is not None and of_one.noise.source == "stated"
    assert Calibration(example_fmu("dahlquist"), {"time": T, "x": np.exp(-T)}, "x", [Parameter("k", 2, 0, 9)]).fit().noise is None
    with pytest.raises(ValueError, match="noise = 'known' is invalid; expected one of: 'auto', 'stated', 'estimated'"):
        decay(1e-3, Normal(1.0, 0.3)).fit(noise="known")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="noise 'estimated' requires the sum of squares"):
        decay(1e-3, Normal(1.0, 0.3)).fit(noise="estimated", loss="huber")


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
