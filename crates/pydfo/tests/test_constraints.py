"""Constraints of `minimize`, `least_squares`, `fmin` and `Optimizer`, in the forms of SciPy."""

from __future__ import annotations

import concurrent.futures
from typing import Any

import numpy as np
import pydfo
import pytest

CIRCLE = pydfo.NonlinearConstraint(lambda x: x[0] ** 2 + x[1] ** 2, ub=1)
BOX = [(-2.0, 2.0), (-2.0, 2.0)]


def total(x: np.ndarray) -> float:
    return float(x[0] + x[1])


def radius(x: np.ndarray) -> float:
    return float(x[0] ** 2 + x[1] ** 2)


def solve(constraints: Any, **given: Any) -> pydfo.OptimizeResult:
    return pydfo.minimize(total, bounds=BOX, method="de", rng=3, constraints=constraints, **given)


def test_nonlinear_constraints_are_met_in_every_form() -> None:
    forms: list[Any] = [
        CIRCLE,
        [CIRCLE],
        {"type": "ineq", "fun": lambda x, r: r - x[0] ** 2 - x[1] ** 2, "args": (1,)},
        pydfo.NonlinearConstraint(lambda x: [x[0] ** 2 + x[1] ** 2, x[0]], [-np.inf, -5], [1, 5]),
    ]
    for form in forms:
        result = solve(form)
        assert result.success and np.allclose(result.x, -np.sqrt(0.5), atol=1e-3)
        assert result.constr_violation <= 1e-6 and "violation" in repr(result)


def test_scipys_own_classes_are_accepted() -> None:
    optimize = pytest.importorskip("scipy.optimize")
    result = solve([optimize.NonlinearConstraint(radius, -np.inf, 1), optimize.LinearConstraint([[1, -1]], 0.5, 0.5)])
    # On the line x0 - x1 = 0.5, the circle is met at x0 + x1 = -sqrt(2 - 0.25).
    assert result.success and abs(result.fun + np.sqrt(1.75)) < 1e-3
    assert np.all(np.abs(result.trace.x @ [1, -1] - 0.5) < 1e-14)
    equality = {"type": "eq", "fun": lambda x: x[0] - x[1]}
    method = pydfo.scipy_method("de", rng=3, max_evaluations=3000)
    again = optimize.minimize(total, [0, 0], method=method, bounds=BOX, constraints=[equality])
    assert abs(again.x[0] - again.x[1]) <= 1e-6 and again.fun < -3.9


def test_same_path_for_threads_executor_map_and_vectorized() -> None:
    constraint = pydfo.NonlinearConstraint(radius, ub=1, keep_feasible=True)
    first = solve(constraint, max_evaluations=400)
    runs = [solve(constraint, max_evaluations=400, workers=4)]
    with concurrent.futures.ThreadPoolExecutor(3) as executor:
        runs.append(solve(constraint, max_evaluations=400, workers=executor))
        runs.append(solve(constraint, max_evaluations=400, workers=executor.map))
    runs.append(
        pydfo.minimize(lambda x: x[0] + x[1], bounds=BOX, method="de", rng=3, constraints=constraint, max_evaluations=400, vectorized=True)
    )
    assert first.nfail == 0
    for run in runs:
        assert np.array_equal(run.x, first.x) and run.nfev == first.nfev == 400
        assert np.array_equal(run.constraints, first.constraints)


def test_keep_feasible_never_calls_the_objective_outside() -> None:
    seen = []

    def cost(x: np.ndarray) -> float:
        seen.append(radius(x))
        return total(x)

    result = pydfo.minimize(
        cost, bounds=BOX, method="de", rng=1, max_evaluations=500, constraints=pydfo.NonlinearConstraint(radius, ub=1, keep_feasible=True)
    )
    assert len(seen) < 500 and max(seen) <= 1 + 1e-6 and result.fun < -1.4


def test_ask_and_tell_follow_the_path_of_minimize() -> None:
    reference = solve(CIRCLE, max_evaluations=300)
    for given in (False, True):
        optimizer = pydfo.Optimizer("de", bounds=BOX, rng=3, max_evaluations=300, constraints=CIRCLE)
        while not optimizer.done:
            ids, points, _ = optimizer.ask(5)
            values = [[radius(x)] for x in points] if given else None
            optimizer.tell(ids[::-1], [total(x) for x in points][::-1], None if values is None else values[::-1])
        assert np.array_equal(optimizer.report().x, reference.x)


def test_resumed_run_equals_uninterrupted_run(tmp_path: Any) -> None:
    def run(constraint: Any, n: int, **given: Any) -> pydfo.OptimizeResult:
        return pydfo.minimize(total, bounds=BOX, method="de-classic", rng=3, constraints=constraint, max_evaluations=n, **given)

    reference = run(CIRCLE, 500)
    file = tmp_path / "run"
    run(CIRCLE, 120, checkpoint=file)
    resumed = run(CIRCLE, 500, checkpoint=file)
    assert np.array_equal(resumed.x, reference.x) and np.array_equal(resumed.constraints, reference.constraints)
    with pytest.raises(pydfo.CheckpointError, match="nonlinear constraints"):
        run(pydfo.NonlinearConstraint(radius, ub=1.5), 500, checkpoint=file)


@pytest.mark.parametrize(
    ("constraints", "error", "message"),
    [
        (3, TypeError, "constraints must be a LinearConstraint"),
        ([3], TypeError, r"constraints\[0\] must be a LinearConstraint"),
        ({"type": "less", "fun": radius}, ValueError, r"constraints\['type'\] = 'less'"),
        ({"type": "eq"}, TypeError, r"constraints\['fun'\] must be callable"),
        (pydfo.LinearConstraint([1, 2, 3], 0, 1), ValueError, r"expected \(m, 2\)"),
        (pydfo.LinearConstraint([[1, 2], [2, 1]], [0, 1, 2]), ValueError, "does not fit 2 constraint values"),
        (pydfo.LinearConstraint([1, np.nan], 0, 1), ValueError, r"coefficient of x\[1\] is NaN"),
        (pydfo.LinearConstraint([1, 1], 2, 1), ValueError, "no number is between its limits 2 and 1"),
        (pydfo.LinearConstraint([1, 1], 5, 9), ValueError, "constraint 0 contradicts"),
        (pydfo.NonlinearConstraint(lambda x: "a", ub=1), TypeError, "must return numbers"),
    ],
)
def test_mistakes_are_errors_before_the_first_call(constraints: Any, error: type[Exception], message: str) -> None:
    def cost(x: np.ndarray) -> float:
        raise AssertionError("the objective was called")

    with pytest.raises(error, match=message):
        pydfo.minimize(cost, [0.0, 0.0], bounds=BOX, method="de", constraints=constraints)


def test_infeasible_constraints_are_no_success() -> None:
    result = solve(pydfo.NonlinearConstraint(radius, ub=-1), max_evaluations=300)
    assert not result.success and result.constr_violation >= 1
    assert "the best point violates a nonlinear constraint by 1" in result.message


def test_method_without_support_names_others() -> None:
    with pytest.raises(ValueError, match="barrier does not support nonlinear constraints; use"):
        pydfo.minimize(total, [0.0, 0.0], bounds=BOX, method="barrier", constraints=CIRCLE)


def test_exception_of_a_constraint_function_reaches_the_caller() -> None:
    def broken(x: np.ndarray) -> float:
        if len(calls) > 20:
            raise ZeroDivisionError("no value")
        calls.append(1)
        return radius(x)

    calls: list[int] = []
    with pytest.raises(ZeroDivisionError, match="no value") as raised:
        solve(pydfo.NonlinearConstraint(broken, ub=1))
    assert raised.value.partial_result.nfev == 21  # type: ignore[attr-defined]
