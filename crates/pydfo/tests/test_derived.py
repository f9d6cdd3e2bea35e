"""Derived parameters, ``Parameter("k3", expr="1 - k1 - k2")``, and constraints."""

from __future__ import annotations

import copy
import html
import pickle
import re
from typing import Any

import numpy as np
import pytest

import pydfo
from pydfo import Calibration, Parameter, example_fmu

T = np.linspace(0.0, 2.0, 21)
K = Parameter("k", 1.0, 0.1, 10.0)


def dahlquist(*parameters: Parameter, **arguments: Any) -> Calibration:
    """A decay from x = 1.5 with k = 2 and a small deterministic disturbance."""
    measured = 1.5 * np.exp(-2.0 * T) + 1e-3 * np.sin(40 * T)
    return Calibration(example_fmu("dahlquist"), {"time": T, "x": measured}, ["x"], list(parameters), **arguments)


def test_value_and_error_follow_from_the_formula(tmp_path: Any) -> None:
    fit = dahlquist(K, Parameter("x", expr="3 / k", lower=0.5, display_name="start")).fit()
    assert fit.parameters["x"] == 3 / fit.x[0]
    assert fit.stderr is not None
    assert fit.stderr["x"] == pytest.approx(3 / fit.x[0] ** 2 * fit.stderr["k"], rel=1e-12)
    assert "derived: 3 / k" in str(fit) and "derived: 3 / k" in html.unescape(fit._repr_html_())
    free, derived = fit.to_dict()["parameters"]
    assert "expr" not in free and "tied_to" not in derived
    assert (derived["name"], derived["expr"], derived["value"]) == ("x", "3 / k", fit.parameters["x"])
    fit.to_csv(tmp_path / "fit.csv")
    rows = (tmp_path / "fit.csv").read_text().splitlines()
    assert rows[0].endswith(",tied_to,expr") and rows[2].endswith(",,3 / k")


def test_chain_and_shares_equal_the_explicit_problem() -> None:
    chain = dahlquist(Parameter("x", expr="rest + 0.5"), K, Parameter("rest", expr="k / 2", offset_of="x"))
    explicit = dahlquist(K, Parameter("x", 1.0), Parameter("rest", 1.0, offset_of="x"))
    assert chain.cost([1.8]) == explicit.cost([1.8, 0.9 + 0.5, 0.9])
    assert chain.names == ["k"]
    assert chain.model_values([1.8]) == {"x": 1.4, "k": 1.8}


def test_saved_and_pickled_fits_keep_derived_parameters(tmp_path: Any) -> None:
    calibration = dahlquist(K, Parameter("x", expr="3 / k", upper=5.0))
    fit = calibration.fit()
    fit.save(tmp_path / "decay.fit")
    loaded = pydfo.load_fit(tmp_path / "decay.fit")
    assert loaded.parameters == fit.parameters and np.array_equal(loaded.stderr, fit.stderr)
    for other in (copy.copy(calibration), pickle.loads(pickle.dumps(calibration))):
        assert other.cost([1.7]) == calibration.cost([1.7])
    parameter = Parameter("x", expr="3 / k", upper=5.0)
    assert repr(parameter) == "Parameter('x', upper=5.0, expr='3 / k')"
    assert eval(repr(parameter)) == parameter


def test_checkpoint_depends_on_the_formula(tmp_path: Any) -> None:
    path = tmp_path / "fit.ckpt"
    dahlquist(K, Parameter("x", expr="3 / k")).fit(checkpoint=path)
    assert dahlquist(K, Parameter("x", expr="3 / k")).fit(checkpoint=path, resume="require").success
    for other in (Parameter("x", expr="2 / k"), Parameter("x", expr="3 / k", lower=0.5)):
        with pytest.raises(pydfo.CheckpointError):
            dahlquist(K, other).fit(checkpoint=path)


def test_points_outside_the_bounds_fail_and_starts_are_rejected() -> None:
    calibration = dahlquist(K, Parameter("x", expr="3 / k", upper=4.0))
    with pytest.raises(pydfo.SimulationError, match="'x' = 3 / k is 6, above its upper bound 4, at k = 0.5"):
        calibration.cost([0.5])
    with pytest.raises(ValueError, match=r"3 / k is 6 at the start \(k = 0.5\), above its upper bound 4"):
        calibration.fit(start=[0.5])
    with pytest.raises(ValueError, match=r"log\(k - 3\) is NaN at the start \(k = 1\), not finite"):
        dahlquist(K, Parameter("x", expr="log(k - 3)"))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"expr": "1 - k ^ 2"}, r"expr: '\^' is not an operator. Write \*\* for a power \(column 7\)"),
        ({"expr": "ln(k)"}, "'ln' is not a function; 'log'?"),
        ({"expr": ""}, "the expression is empty"),
        ({"expr": "3"}, "contains no parameter"),
        ({"expr": "k", "start": 1.0}, "Omit start"),
        ({"expr": "k", "scale": "log"}, "have no meaning"),
        ({"expr": "k", "tied_to": "k"}, "has tied_to and expr"),
        ({"expr": 3}, "expr"),
    ],
)
def test_mistakes_in_formulas_are_errors(arguments: dict[str, Any], expected: str) -> None:
    with pytest.raises((ValueError, TypeError), match=expected):
        Parameter("x", **arguments)


def test_unknown_name_is_reported_with_its_column_and_the_nearest_name() -> None:
    with pytest.raises(ValueError, match=r"'kk' \('k'\?\), which does not exist; available: k \(column 5\)\n    1 - kk\n        \^"):
        dahlquist(K, Parameter("x", expr="1 - kk"))


def test_constraints_hold_at_the_result() -> None:
    calibration = dahlquist(K, Parameter("x", 1.0, 0.1, 5.0), constraints=["x <= k", "x * k <= 20"])
    assert calibration.constraints == ["x <= k", "x * k <= 20"]
    assert pickle.loads(pickle.dumps(calibration)).constraints == calibration.constraints
    assert calibration.cost([1.0, 1.0]) > 0
    fit = dahlquist(K, Parameter("x", 1.0, 0.1, 5.0), constraints=["x + k == 3.4", "x * k <= 20"]).fit()
    assert fit.success and abs(fit.x.sum() - 3.4) < 1e-14 and fit.constr_violation == 0
    assert "conditional on the active constraints 'x + k == 3.4'" in str(fit)
    assert fit.uncertainty is not None and fit.uncertainty.active_constraints == ["x + k == 3.4"]
    free = dahlquist(K, Parameter("x", 1.0, 0.1, 5.0), constraints=None).fit()
    assert free.uncertainty is not None and free.uncertainty.active_constraints == []
    assert fit.stderr is not None and fit.stderr["x"] == pytest.approx(fit.stderr["k"], rel=1e-6)
    assert dahlquist(K, constraints="k <= 5").constraints == ["k <= 5"]


@pytest.mark.parametrize(
    ("constraint", "expected"),
    [
        ("k <= kk", r"'kk' \('k'\?\) is not a parameter; available: k \(column 6\)"),
        ("k = 1", r"'=' is not an operator. Write == for equality \(column 3\)"),
        ("k", "a comparison is missing"),
        ("k >= 20", "k is between 0.1 and 10 within the bounds, but must be at least 20"),
    ],
)
def test_mistakes_in_constraints_are_errors(constraint: str, expected: str) -> None:
    with pytest.raises(ValueError, match=f"constraint '{re.escape(constraint)}': {expected}"):
        dahlquist(K, constraints=[constraint])
