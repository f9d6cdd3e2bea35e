"""Goodness of fit and the comparison of two fits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pydfo
from pydfo import Calibration, Parameter, example_fmu

T = np.arange(12) / 4
#: ``round(1.5 exp(-2 t) + 0.02 sin(17 t**2 + 1), 3)``
Y = np.array([1.517, 0.927, 0.535, 0.317, 0.188, 0.136, 0.095, 0.052, 0.025, 0.001, 0.019, -0.008])
#: lmfit 1.3.4: ``minimize(lambda p: (p["x"] * exp(-p["k"] * t) - y) / 0.02, params)``, with x free and x = 1.5.
OF_LMFIT = {
    "free": {"nvarys": 2, "nfree": 10, "chisqr": 5.14722622806481, "redchi": 0.514722622806481,
             "aic": -6.157384120397806, "bic": -5.187570820821805},
    "fixed": {"nvarys": 1, "nfree": 11, "chisqr": 6.244454466105626, "redchi": 0.5676776787368751,
              "aic": -5.838554384002023, "bic": -5.353647734214023},
}  # fmt: skip


def fit_of(x: Parameter, data: Any = None, **options: Any) -> pydfo.Fit:
    data = {"time": T, "x": Y} if data is None else data
    options = options or {"sigma": 0.02}
    return Calibration(
        example_fmu("dahlquist"), data, "x", [Parameter("k", 1, 0.1, 9), x], relative_tolerance=1e-10, **options
    ).fit(x_tol=1e-9, f_tol=1e-12)


FREE = Parameter("x", 1, 0.1, 9)
FIXED = Parameter("x", 1.5, 0.1, 9, fixed=True)


@pytest.mark.parametrize("name", ["free", "fixed"])
def test_goodness_has_the_values_of_lmfit(name: str) -> None:
    x = {"free": FREE, "fixed": FIXED}[name]
    for options in ({"sigma": 0.02}, {"weights": {"x": 50.0}}):
        fit = fit_of(x, **options)
        for key, value in OF_LMFIT[name].items():
            assert getattr(fit.goodness, key) == pytest.approx(value, rel=1e-6), key
        assert (fit.chisqr, fit.redchi, fit.aic, fit.bic) == (*fit.goodness[3:6], fit.goodness.bic)
        assert fit.goodness.aicc == pytest.approx(fit.aic + {"free": 12 / 9, "fixed": 4 / 10}[name], rel=1e-9)
        assert (fit.goodness.p_value is None) == ("weights" in options)
        assert fit.to_dict()["goodness"]["redchi"] == fit.redchi


def test_goodness_has_a_p_value_for_known_noise() -> None:
    # scipy.stats.chi2.sf(5.14722622806481, 10)
    fit = fit_of(FREE)
    assert fit.goodness.p_value == pytest.approx(0.8811285308000909, rel=1e-6)
    assert "chi-square 5.147, reduced 0.5147, p = 0.8811" in str(fit)


def test_comparison_of_nested_fits_has_the_f_test() -> None:
    larger, smaller = fit_of(FREE), fit_of(FIXED)
    for pair in ((larger, smaller), (smaller, larger)):
        found = pair[0].compare(pair[1])
        # scipy.stats.f.sf(F, 1, 10) with the chi-squares of lmfit
        assert found.f == pytest.approx(2.131688387928772, rel=1e-5)
        assert found.p_value == pytest.approx(0.17497280545704977, rel=1e-5)
        assert found.goodness == (pair[0].goodness, pair[1].goodness)
    print(larger.compare(smaller))
    assert str(larger.compare(smaller)).splitlines()[-1].endswith("F = 2.132, p = 0.175")
    same = larger.compare(larger)
    assert same.f is None and same.p_value is None and "no F test" in str(same)


def test_fits_to_different_measurements_cannot_be_compared() -> None:
    with pytest.raises(ValueError, match=r"different measurements \(12 and 10\)"):
        fit_of(FREE).compare(fit_of(FREE, {"time": T[:10], "x": Y[:10]}))
