"""Failures, exceptions and bad input."""

from __future__ import annotations

import concurrent.futures
import contextlib
import threading

import numpy as np
import pytest
from conftest import Recorder, rosenbrock

import pydfo
from pydfo import fmin

QUIET = {"disp": False}


class Boom(Exception):
    pass


def path(n):
    """Returns the first n points evaluated by a run without failures."""
    return fmin(rosenbrock, [-1.2, 1.0], max_fevals=n, x_tol=0.0, f_tol=0.0, **QUIET).trace.x


def failing_at(k, how, values):
    """Returns Rosenbrock's function with a failure at the point of evaluation k of the path, and a store of its
    finite values.

    The point also fails if it is evaluated speculatively, and again when the path reaches it."""
    lock = threading.Lock()
    where = path(k)[-1]

    def func(x):
        if np.array_equal(x, where):
            if how == "raise":
                raise Boom(k)
            return np.nan
        value = rosenbrock(x)
        with lock:
            values.append(value)
        return value

    return func


def n_visits(result, k):
    """Returns the number of used evaluations at the point of evaluation k: more than one if the search started again."""
    n = int(np.all(result.trace.x[result.trace.used] == path(k)[-1], axis=1).sum())
    assert n >= 1
    return n


def check_best(result, values):
    finite = np.where(result.trace.used, result.trace.fun, np.nan)
    assert result.fun == np.nanmin(finite)
    assert result.trace.x[np.nanargmin(finite)].tobytes() == result.x.tobytes()
    if result.n_speculative == 0:
        assert result.fun == min(values)


@pytest.mark.parametrize("workers", [1, 4])
@pytest.mark.parametrize("k", range(1, 61))
def test_best_point_is_minimum_of_trace_despite_a_failure(k, workers):
    options = dict(nbr_cores=workers, max_fevals=70, x_tol=0.0, f_tol=0.0, **QUIET)
    values = []
    result = fmin(failing_at(k, "nan", values), [-1.2, 1.0], **options)
    assert (result.nfail, result.nfev) == (n_visits(result, k), 70)
    check_best(result, values)

    values = []
    with pytest.raises(Boom) as info:
        fmin(failing_at(k, "raise", values), [-1.2, 1.0], **options)
    partial = info.value.partial_result
    if partial is None:
        assert k == 1 and (workers > 1 or not values)
    else:
        assert partial.status == 6 and not partial.success and "aborted" in partial.message
        check_best(partial, values)

    values = []
    result = fmin(failing_at(k, "raise", values), [-1.2, 1.0], on_error="fail", **options)
    n = n_visits(result, k)
    assert (result.nfail, result.nfev, result.failures) == (n, 70, {f"Boom: {k}": n})
    check_best(result, values)


@pytest.mark.parametrize("workers", [1, 3])
def test_exception_keeps_identity_and_traceback(workers):
    error = Boom("mine", 7)

    def func(x):
        if x[0] > 1.0:
            raise error
        return -x[0]

    with pytest.raises(Boom) as info:
        fmin(func, [0.0], nbr_cores=workers, **QUIET)
    assert info.value is error and error.args == ("mine", 7)
    assert info.traceback[-1].name == "func"
    assert error.partial_result.fun < 0.0 and error.partial_result.x[0] <= 1.0


def test_exception_without_attributes_is_raised():
    class Rigid(Exception):
        def __setattr__(self, name, value):
            raise AttributeError(name)

    with pytest.raises(Rigid):
        fmin(lambda x: (_ for _ in ()).throw(Rigid()), [0.0], **QUIET)


def test_system_exit_and_interrupts_propagate():
    def func(x):
        raise SystemExit(3)

    with pytest.raises(SystemExit):
        fmin(func, [0.0], on_error="fail", **QUIET)


def test_system_exit_point_is_independent_of_workers():
    def func(x):
        if x[0] > 0.5:
            raise SystemExit(3)
        return (x[0] - 0.45) ** 2 + 10.0 * (x[1] - x[0]) ** 2

    def end(workers):
        try:
            with contextlib.nullcontext() if isinstance(workers, int) else workers as pool:
                return pydfo.minimize(func, [-0.3, 0.4], method="nelder-mead", workers=pool or workers, bounds=[(-1, 2)] * 2).x
        except SystemExit as e:
            return [*e.partial_result.x, e.partial_result.nfev, e.code]

    alone = end(1)
    for workers in (2, 7, concurrent.futures.ThreadPoolExecutor(4)):
        assert np.array_equal(end(workers), alone)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (None, "not None. Check for a missing return statement"),
        ("1.5", r"not '1.5' \(str\)"),
        (np.zeros(3), r"not an array of shape \(3,\)"),
        (np.zeros((2, 2)), r"not an array of shape \(2, 2\)"),
        (np.zeros(0), r"not an array of shape \(0,\)"),
        (np.array(["a"]), "not an array or scalar of type <U1"),
        (np.complex128(1j), "not an array or scalar of type complex128"),
        (1j, r"not 1j \(complex\)"),
        ([1.0], r"not \[1.0\] \(list\)"),
        ({}, r"not {} \(dict\)"),
        (b"x" * 500, r"\.\.\. \(bytes\)"),
    ],
)
@pytest.mark.parametrize("on_error", ["raise", "fail"])
def test_non_numeric_cost_is_a_type_error(value, expected, on_error):
    with pytest.raises(TypeError, match=expected):
        fmin(lambda x: value, [1.0], on_error=on_error, **QUIET)


@pytest.mark.parametrize("workers", [1, 2])
def test_failing_everywhere_raises_error_with_counts(workers):
    reasons = iter(["out of range", "out of range", "no licence"])

    def func(x):
        raise Boom(next(reasons))

    with pytest.raises(pydfo.AllStartsFailed, match="at every starting point: .*2 x Boom: out of range") as info:
        fmin(func, [0.0, 0.0], on_error="fail", nbr_cores=workers, **QUIET)
    assert info.value.failures == {"Boom: out of range": 2, "Boom: no licence": 1}
    assert info.value.nfev == 3 and len(info.value.trace) == 3
    assert isinstance(info.value, pydfo.CalibrationError) and isinstance(info.value, pydfo.PydfoError)
    with pytest.raises(pydfo.AllStartsFailed, match="3 x cost is NaN"):
        fmin(lambda x: np.nan, [0.0, 0.0], **QUIET)


def test_budget_without_any_cost_is_an_error():
    with pytest.raises(pydfo.NoResult, match="max-evaluations") as info:
        fmin(lambda x: np.inf, [0.0, 0.0], max_fevals=2, **QUIET)
    assert info.value.nfev == 2 and not isinstance(info.value, pydfo.AllStartsFailed)


@pytest.mark.parametrize(
    ("changes", "error", "expected"),
    [
        ({"lb": [1.0, 0.0], "ub": [0.5, 1.0]}, ValueError, r"x\[0\]: the lower bound 1 is above the upper bound 0.5"),
        ({"lb": [np.nan, 0.0]}, ValueError, r"lower bound of x\[0\] must not be NaN"),
        ({"ub": [1.0, np.nan]}, ValueError, r"upper bound of x\[1\] must not be NaN"),
        ({"lb": [0.0]}, ValueError, "lb: expected 2 values, one per parameter; got 1"),
        ({"ub": [1.0, 1.0, 1.0]}, ValueError, "ub: expected 2 values, one per parameter; got 3"),
        ({"ub": [[1.0, 1.0]]}, ValueError, "ub must be one-dimensional"),
        ({"lb": ["a", "b"]}, TypeError, "lb must be numbers"),
        ({"xstart": [np.nan, 0.0]}, ValueError, r"x0\[0\] = NaN"),
        ({"xstart": []}, ValueError, "empty"),
        ({"xstart": [[0.5, 0.5]]}, ValueError, "xstart must be one-dimensional"),
        ({"xstart": None}, ValueError, "xstart, the start point of .*, is missing"),
        ({"xstart": "ab"}, TypeError, "xstart must be numbers"),
        ({"xstart": [1j, 0]}, TypeError, "xstart must be numbers"),
        ({"func": None}, TypeError, "func must be callable"),
        ({"alg": 7}, ValueError, "alg = 7 must be a number from 1 to 4"),
        ({"alg": "bobyqa"}, ValueError, "unknown method 'bobyqa'; .*did you mean 'quadratic-model'"),
        ({"x_tol": -1.0}, ValueError, "x_tol = -1 must be finite and not negative"),
        ({"f_tol": np.nan}, ValueError, "f_tol = NaN"),
        ({"x_tol": "small"}, TypeError, "x_tol must be a number"),
        ({"max_fevals": 0}, ValueError, "max_fevals = 0 must be an integer of at least 1"),
        ({"max_fevals": 1.5}, ValueError, "max_fevals = 1.5"),
        ({"max_iters": -1}, ValueError, "max_iters = -1"),
        ({"max_iters": np.nan}, ValueError, "max_iters = nan"),
        ({"max_time": -1.0}, ValueError, "max_time = -1"),
        ({"max_time": np.nan}, ValueError, "max_time = NaN"),
        ({"target": np.nan}, ValueError, "target = NaN"),
        ({"nbr_cores": 0}, ValueError, "nbr_cores = 0 must be at least 1"),
        ({"nbr_cores": -2}, ValueError, "nbr_cores = -2"),
        ({"nbr_cores": 1.5}, TypeError, "nbr_cores must be an integer"),
        ({"stop": "both"}, ValueError, "stop = 'both' is invalid; expected one of: 'any', 'all'"),
        ({"stop": 1}, TypeError, "stop must be a string"),
        ({"batch": "eight"}, ValueError, "'batch' of nelder-mead must be an integer, 'auto', 'serial' or 'ahead', not 'eight'"),
        ({"on_error": "ignore"}, ValueError, "on_error = 'ignore'"),
        ({"callback": 3}, TypeError, "callback must be callable"),
        ({"initial_simplex": [[0.0, 0.0], [1.0, 1.0]]}, ValueError, "2 vertices; expected 3"),
        ({"initial_simplex": [[0, 0], [0.5, 0.5], [1, 1]]}, ValueError, "flat: its vertices span only 1 of 2"),
        ({"initial_simplex": [[0, 0], [0.5, 0], [0, 9]], "ub": [1, 1]}, ValueError, "= 9 of vertex 2"),
        ({"initial_simplex": [0.1, 0.1, 0.1]}, ValueError, "initial_simplex has shape"),
        ({"initial_simplex": [0.1, 0.0]}, ValueError, r"initial step of x\[1\] = 0"),
        ({"initial_simplex": "big"}, TypeError, "initial_simplex must be numbers"),
    ],
    ids=lambda v: str(v) if isinstance(v, dict) else "",
)
def test_bad_arguments_are_rejected_before_the_run(changes, error, expected):
    func = Recorder(rosenbrock)
    arguments = {"func": func, "xstart": [0.5, 0.5], **QUIET, **changes}
    with pytest.raises(error, match=expected):
        fmin(**arguments)
    assert func.values == []
