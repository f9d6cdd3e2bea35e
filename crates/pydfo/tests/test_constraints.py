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
    method = pydfo.scipy_method("quadratic-model")
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


def test_nonlinear_equalities_are_rejected_by_populations() -> None:
    equality = pydfo.NonlinearConstraint(radius, 1, 1)
    for method in ("de", "ga"):
        with pytest.raises(ValueError, match="does not support nonlinear equality constraints; use quadratic-model"):
            pydfo.minimize(total, bounds=BOX, method=method, constraints=equality)
    result = pydfo.minimize(total, bounds=BOX, search="global", rng=1, constraints=equality)
    assert result.constr_violation <= 1e-6 and result.method == "multistart" and abs(result.fun + np.sqrt(2)) < 1e-4


def test_all_parameters_may_be_fixed() -> None:
    result = pydfo.minimize(lambda x: x @ x, [2, 3], bounds=[(2, 2), (3, 3)], constraints=pydfo.NonlinearConstraint(radius, ub=20))
    assert result.success and result.fun == 13


def test_functions_cannot_change_the_point() -> None:
    def spoiling(x: np.ndarray) -> float:
        value = radius(x)
        x[:] = 7.0
        return value

    spoiled = pydfo.NonlinearConstraint(spoiling, ub=1)
    reference = solve(CIRCLE, max_evaluations=300)
    assert np.array_equal(solve([spoiled, spoiled], max_evaluations=300).x, reference.x)
    run = pydfo.minimize(lambda x: x[0] + x[1], bounds=BOX, method="de", rng=3, constraints=spoiled, max_evaluations=300, vectorized=True)
    assert np.array_equal(run.x, reference.x)
    optimizer = pydfo.Optimizer("de", bounds=BOX, rng=3, max_evaluations=300, constraints=CIRCLE)
    while not optimizer.done:
        ids, points, _ = optimizer.ask()
        costs = [total(x) for x in points]
        points[:] = 7.0
        optimizer.tell(ids, costs)
    assert np.array_equal(optimizer.report().x, reference.x)


def test_told_constraint_values_must_fit_the_run() -> None:
    optimizer = pydfo.Optimizer("de", bounds=BOX, rng=3)
    ids, points, _ = optimizer.ask(1)
    with pytest.raises(ValueError, match="no nonlinear constraints"):
        optimizer.tell(ids, [total(points[0])], [[1.0]])
    optimizer = pydfo.Optimizer("de", bounds=BOX, rng=3, constraints=CIRCLE)
    ids, points, _ = optimizer.ask(1)
    with pytest.raises(ValueError, match="got 2 constraint values of a point; expected 1"):
        optimizer.tell(ids, [total(points[0])], [[1.0, 2.0]])


def test_told_points_outside_a_kept_constraint_have_no_cost() -> None:
    kept = pydfo.NonlinearConstraint(radius, ub=1, keep_feasible=True)
    reference = solve(kept, max_evaluations=300)
    optimizer = pydfo.Optimizer("de", bounds=BOX, rng=3, max_evaluations=300, constraints=kept)
    while not optimizer.done:
        ids, points, _ = optimizer.ask()
        optimizer.tell(ids, [total(x) for x in points])
    report = optimizer.report()
    assert np.array_equal(report.x, reference.x)
    assert report.n_infeasible == reference.n_infeasible > 0 and report.nfail == 0


def test_exception_in_a_vectorized_run_belongs_to_its_point() -> None:
    def partial(x: np.ndarray) -> float:
        if x[0] > 1.5:
            raise ZeroDivisionError("no value")
        return radius(x)

    def run(on_error: str) -> pydfo.OptimizeResult:
        constraint = pydfo.NonlinearConstraint(partial, ub=1)
        return pydfo.minimize(
            lambda x: x[0] + x[1], bounds=BOX, method="de", rng=3, constraints=constraint, max_evaluations=300, vectorized=True, on_error=on_error
        )

    result = run("fail")
    assert 0 < result.nfail < 150 and result.failures == {"ZeroDivisionError: no value": result.nfail} and result.fun < -1.3
    with pytest.raises(ZeroDivisionError, match="no value"):
        run("raise")


def test_warm_start_computes_constraint_values() -> None:
    first = pydfo.minimize(total, [0.0, 0.0], bounds=BOX, constraints=CIRCLE)
    again = pydfo.minimize(total, [1.5, 1.5], bounds=BOX, constraints=CIRCLE, options={"warm_start": first})
    assert again.success and abs(again.fun - first.fun) < 1e-6 and again.nfev < first.nfev + 5
    points = ([[-0.7, -0.7], [-2.0, -2.0]], [-1.4, -4.0])
    again = pydfo.minimize(total, [1.5, 1.5], bounds=BOX, constraints=CIRCLE, options={"warm_start": points}, max_evaluations=1)
    assert np.array_equal(again.x, [-0.7, -0.7])


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
