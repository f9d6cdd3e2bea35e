"""Costs other than sums of squares, and user-defined functions."""

from __future__ import annotations

import pickle
import threading

import numpy as np
import pytest

from pydfo import Calibration, Experiment, Parameter, example_fmu

TIME = np.linspace(0, 3, 31)
ERROR = np.where(np.arange(31) == 7, 0.5, 0.0)


def calibration(*more):
    made = [Experiment({"time": TIME, "x": x0 * np.exp(-2 * TIME) + ERROR}, ["x"], start_values={"x": x0}) for x0 in (1.0, *more)]
    return Calibration(example_fmu("dahlquist"), made, [Parameter("k", 1.0, 0.1, 10.0)])


def mean_absolute(measured, simulated):
    return np.mean(np.abs(simulated["x"] - measured["x"]))


def ratios(measured, simulated):
    return (simulated["x"] - measured["x"]) / (0.1 + np.abs(measured["x"]))


@pytest.mark.parametrize("objective", ["mae", "RMSE", "nrmse", "likelihood"])
def test_named_costs_match_their_formulas(objective):
    problem = calibration()
    fit = problem.fit(objective=objective)
    is_likelihood = objective == "likelihood"
    method = "least-squares" if is_likelihood else "quadratic-model"
    assert (fit.method, fit.objective, fit.success) == (method, objective.lower(), True)
    assert is_likelihood or "without residuals" in fit.method_reason
    assert (fit.cov is None) == (fit.uncertainty is None) == (not is_likelihood)
    r = problem.residuals(fit.x)
    measured = problem.measurements()["x"][1]
    expected = {
        "mae": np.mean(np.abs(r)),
        "rmse": np.sqrt(np.mean(r**2)),
        "nrmse": np.sqrt(np.mean(r**2)) / np.ptp(measured),
        "likelihood": 31 / 2 * np.log(np.mean(r**2)),
    }
    assert fit.cost == pytest.approx(expected[objective.lower()], rel=1e-12)
    assert fit.rms == pytest.approx(np.sqrt(np.mean(r**2)), rel=1e-12)
    assert 0 < fit.scaled_rms < 1
    if objective == "mae":
        assert fit.x[0] == pytest.approx(2.0, abs=5e-3)
    else:
        assert fit.x[0] == pytest.approx(problem.fit().x[0], rel=1e-3)


def test_functions_are_minimised():
    problem = calibration()
    by_name, fit = problem.fit(objective="mae"), problem.fit(objective=mean_absolute)
    assert fit.x == pytest.approx(by_name.x, abs=1e-4) and fit.method == "quadratic-model"
    assert fit.objective == f"{__name__}.mean_absolute"
    residuals = problem.fit(objective=ratios)
    assert residuals.method == "least-squares" and residuals.uncertainty is None
    assert residuals.cost == pytest.approx(np.sum(problem.residuals(residuals.x) ** 2 / (0.1 + np.abs(problem.measurements()["x"][1])) ** 2))
    assert np.array_equal(problem.fit(objective=ratios, workers=1, batch=residuals.batch_plan).x, residuals.x)
    assert pickle.loads(pickle.dumps(problem)).cost() == problem.cost()
    nelder_mead = problem.fit("nelder-mead", objective=ratios)
    assert nelder_mead.x == pytest.approx(residuals.x, rel=1e-3)


def test_functions_receive_several_experiments():
    seen = set()

    def cost(measured, simulated):
        seen.update(measured)
        assert set(measured) == set(simulated)
        return sum(np.sum((simulated[name]["x"] - measured[name]["x"]) ** 2) for name in measured)

    problem = calibration(2.0)
    fit = problem.fit(objective=cost)
    assert seen == {"run1", "run2"} and fit.cost == pytest.approx(problem.cost(fit.x), rel=1e-9)


def test_function_exception_ends_the_fit():
    class Odd(Exception):
        pass

    calls = []

    def cost(measured, simulated):
        calls.append(threading.get_ident())
        if len(calls) > 8:
            raise Odd("after eight")
        return mean_absolute(measured, simulated)

    with pytest.raises(Odd, match="after eight") as caught:
        calibration().fit(objective=cost, workers=1)
    assert caught.value.partial_result.nfev >= 1
    with pytest.raises(TypeError, match="must return one number"):
        calibration().fit(objective=lambda measured, simulated: "much" if simulated["x"][3] < 1 else 1.0)
    with pytest.raises(ZeroDivisionError):
        calibration().fit(objective=lambda measured, simulated: 1 / 0)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"objective": "maximum"}, ValueError, "objective = 'maximum' is invalid; expected one of 'sum-of-squares', 'mae', 'rmse'"),
        ({"objective": 3}, TypeError, "objective"),
        ({"objective": "mae", "method": "least-squares"}, ValueError, "least-squares requires a sum of squares, and the objective 'mae' is not one"),
        ({"objective": "mae", "loss": "huber"}, ValueError, "a robust loss requires the sum of squares"),
        ({"objective": mean_absolute, "method": "least-squares"}, ValueError, "is not one. Use method auto"),
        ({"objective": lambda measured: 1.0}, TypeError, "positional argument"),
        ({"objective": lambda measured, simulated: None}, TypeError, "None. Check for a missing return statement"),
    ],
)
def test_bad_objectives_are_rejected(arguments, error, message):
    with pytest.raises(error) as caught:
        calibration().fit(**arguments)
    assert message in str(caught.value)


def test_outputs_are_weighted_by_measured_scale():
    values = np.array([4.0, np.nan, 1.0, 1.0])
    data = {"time": np.arange(4.0), "x": values}

    def problem(weights):
        return Calibration(example_fmu("dahlquist"), [Experiment(data, ["x"], weights=weights)], [Parameter("k", 1.0)])

    plain = problem(None).cost()
    for weights, scale in (("range", 3.0), ("mean", 2.0), ("sd", np.sqrt(3.0))):
        assert problem(weights).cost() == pytest.approx(plain / scale**2, rel=1e-12)
    with pytest.raises(ValueError, match="weights = 'variance' is unknown; expected 'range', 'mean', 'sd'"):
        problem("variance")
