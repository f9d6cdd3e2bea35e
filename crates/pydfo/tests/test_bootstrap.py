"""Bootstrap of a fit."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from pydfo import Calibration, Parameter, example_fmu

T = np.arange(51) / 10


@pytest.mark.parametrize("kind", ["parametric", "residual", "block"])
def test_bootstrap_agrees_with_the_standard_errors_for_any_number_of_workers(kind: str) -> None:
    x = np.exp(-2.0 * T) + 0.02 * np.random.default_rng(7).standard_normal(51)
    fit = Calibration(example_fmu("dahlquist"), {"time": T, "x": x}, "x", [Parameter("k", 1.5, 0.1, 9)], sigma=0.02).fit()
    found = fit.bootstrap(60, kind, rng=5, workers=2)
    assert (found.samples.shape, found.n_failed, found.kind, found.seed) == ((60, 1), 0, kind, 5)
    assert found.samples[:9].tobytes() == fit.bootstrap(9, kind, rng=5, workers=1).samples.tobytes()
    assert abs(np.log(found.stderr[0] / fit.stderr[0])) < 0.4
    low, high = found.intervals()["k"]
    assert low < fit.x[0] < high and "95 % interval of 60 fits" in str(found)


def test_bootstrap_reports_wrong_arguments() -> None:
    data = {"time": T, "x": np.exp(-2.0 * T) + 0.01 * np.sin(9 * T)}
    calibration = Calibration(example_fmu("dahlquist"), data, "x", [Parameter("k", 1.5, 0.1, 9)])
    fit = calibration.fit()
    with pytest.raises(ValueError, match="kind = 'jackknife' is invalid; expected one of"):
        fit.bootstrap(5, "jackknife")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="n"):
        fit.bootstrap(0)
    with pytest.raises(ValueError, match="n must be an integer of at least 1, not None"):
        fit.bootstrap(None)
    with pytest.raises(ValueError, match="level is 2; it must be between 0 and 1"):
        fit.bootstrap(3, rng=1).intervals(2)
    with pytest.raises(ValueError, match="requires a sum of squares or the likelihood"):
        calibration.fit(objective="mae").bootstrap(5)
    found = calibration.fit(objective="likelihood").bootstrap(5, rng=1)
    assert found.n_failed == 0 and found.stderr[0] > 0
    assert np.isnan(fit.bootstrap(1, rng=1).stderr).all()


def test_bootstrap_continues_from_its_file(tmp_path: Path) -> None:
    data = {"time": T, "x": np.exp(-2.0 * T) + 0.01 * np.sin(9 * T)}
    fit = Calibration(example_fmu("dahlquist"), data, "x", [Parameter("k", 1.5, 0.1, 9)]).fit()
    file = tmp_path / "k.boot"
    part = fit.bootstrap(4, rng=5, workers=2, checkpoint=file)
    saved = json.loads(file.read_text().partition("\n")[2])
    assert len(saved["fits"]) == 4 and saved["seed"] == 5
    # A stored value is used instead of another fit.
    saved["fits"]["2"] = [1.25]
    content = json.dumps(saved)
    file.write_bytes(f"fmufit sha256 {hashlib.sha256(content.encode()).hexdigest()}\n{content}".encode())
    more = fit.bootstrap(7, workers=1, checkpoint=file)
    assert more.seed == 5 and more.samples[2] == 1.25
    whole = fit.bootstrap(7, rng=5).samples
    assert np.delete(more.samples, 2).tobytes() == np.delete(whole, 2).tobytes() and part.samples.tobytes() == whole[:4].tobytes()
    for own, said in [({"rng": 6}, "another seed"), ({"kind": "block"}, "another kind")]:
        with pytest.raises(ValueError, match=f"k.boot contains a bootstrap .*{said}.* Specify another file"):
            fit.bootstrap(7, checkpoint=file, **own)  # type: ignore[arg-type]
    file.write_text("[]")
    with pytest.raises(ValueError, match="k.boot is not a file of a bootstrap"):
        fit.bootstrap(7, checkpoint=file)
