"""Defects of the paper's tool, one test per defect, so that they do not occur here."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from conftest import Recorder, rosenbrock

from pydfo import fmin

QUIET = {"disp": False}


def probe(x):
    """Returns Rosenbrock's function, or NaN in three regions near the path from (-0.5, 1)."""
    if x[0] + x[1] < -0.2 or (x[0] > 0.2 and x[1] < 0.02) or x[1] > 1.6:
        return np.nan
    return rosenbrock(x)


@pytest.mark.parametrize("failure", [np.nan, np.inf, -np.inf, "raise"])
def test_failing_regions_do_not_stall_the_search(failure):
    def func(x):
        value = probe(x)
        if np.isfinite(value):
            return value
        if failure == "raise":
            raise ArithmeticError("no cost here")
        return failure

    res = fmin(func, [-0.5, 1.0], [-2, -2], [2, 2], x_tol=1e-8, f_tol=1e-10, stop="all", max_fevals=2000, on_error="fail", **QUIET)
    assert res.fun < 1e-6 and res.nfev < 2000
    assert 0 < res.nfail == sum(res.failures.values()) == len(res.trace.messages)


def test_no_vertex_is_evaluated_twice():
    func = Recorder(rosenbrock)
    res = fmin(func, [-1.2, 1.0], x_tol=1e-6, f_tol=1e-6, stop="all", **QUIET)
    assert len({x.tobytes() for x in func.points}) == len(func.points)
    # the paper's tool requires 501 evaluations for 3.6e-7
    assert res.fun < 3.6e-7 and res.nfev < 250


def test_unmoved_simplex_never_converges():
    # the values are so small that absolute tolerances are met at once
    func = Recorder(lambda x: 1e-8 * rosenbrock(x))
    res = fmin(func, [-1.2, 1.0], **QUIET)
    assert res.nit >= 1 and res.nfev > 3 and not np.array_equal(res.x, [-1.2, 1.0])
    assert res.fun < func.values[0]
    # with a suitable test, the optimum is found
    res = fmin(func, [-1.2, 1.0], x_tol=1e-7, f_tol=1e-20, stop="all", **QUIET)
    np.testing.assert_allclose(res.x, [1.0, 1.0], atol=1e-5)


def test_small_parameters_are_optimised():
    optimum = np.array([3e-6, 7e-6])
    res = fmin(
        lambda x: float(np.sum((x / optimum - 1.0) ** 2)),
        [1e-6, 1e-6],
        lb=[0.0, 0.0],
        ub=[1e-5, 1e-5],
        x_tol=1e-12,
        f_tol=1e-10,
        stop="all",
        **QUIET,
    )
    np.testing.assert_allclose(res.x, optimum, rtol=1e-4)
    assert res.success


@pytest.mark.parametrize("start", [[-3.0, 0.0], [3.0, 0.0], [0.0, -3.0], [0.0, 3.0]])
def test_both_bounds_are_checked_at_the_start(start):
    with pytest.raises(ValueError, match=r"x0\[[01]\] = -?3 is outside its bounds \[-2, 2\]"):
        fmin(rosenbrock, start, [-2, -2], [2, 2], **QUIET)


def test_start_on_a_bound_is_allowed():
    res = fmin(rosenbrock, [-2.0, 2.0], [-2, -2], [2, 2], x_tol=1e-7, f_tol=1e-10, stop="all", **QUIET)
    assert res.fun < 1e-8 and np.array_equal(res.trace.x[0], [-2.0, 2.0])


@pytest.mark.parametrize("nbr_cores", [1, 2, 4])
def test_evaluation_budget_is_exact(nbr_cores):
    func = Recorder(rosenbrock)
    res = fmin(func, [-1.2, 1.0], max_fevals=50, nbr_cores=nbr_cores, **QUIET)
    # a slow machine may evaluate speculative points, which the budget does not count
    assert res.nfev == len(func.values) - res.n_speculative == 50


def test_best_point_is_returned_when_budget_ends():
    for budget in range(1, 80):
        func = Recorder(rosenbrock)
        assert fmin(func, [-1.2, 1.0], max_fevals=budget, **QUIET).fun == func.best


def test_callables_other_than_functions_are_accepted():
    class Model:
        def cost(self, scale, x):
            return scale * rosenbrock(x)

    assert fmin(partial(Model().cost, 2.0), [0.5, 0.5], **QUIET).nfev > 3


def test_file_names_are_rejected_as_functions():
    with pytest.raises(TypeError, match="not the name of its file"):
        fmin("furuta_dfo_cost.py", [1.0], **QUIET)


def test_initial_step_can_be_chosen():
    res = fmin(rosenbrock, [1.0, 1.0], initial_simplex=[1e-3, 1e-3], max_iters=0, **QUIET)
    np.testing.assert_allclose(res.trace.x - 1.0, [[0, 0], [1e-3, 0], [0, 1e-3]])


def test_points_keep_all_digits():
    start = [0.1 + 0.2, 1.0 / 3.0]
    func = Recorder(rosenbrock)
    fmin(func, start, max_fevals=1, **QUIET)
    assert func.points[0].tolist() == start


def test_one_failing_evaluation_does_not_fail_the_run():
    calls = []

    def func(x):
        calls.append(1)
        if len(calls) == 10:
            raise OSError("a licence was not to be had")
        return rosenbrock(x)

    res = fmin(func, [-1.2, 1.0], on_error="fail", **QUIET)
    assert res.nfail == 1 and res.failures == {"OSError: a licence was not to be had": 1} and res.success


@pytest.mark.parametrize(
    ("alg", "method"),
    [(2, "barrier"), (3, "de-classic"), (4, "ga"), ("barrier", "barrier"), ("DE", "de"), ("ga", "ga"), ("de_classic", "de-classic")],
)
def test_other_methods_run_by_number_and_by_name(alg, method):
    box = {"lb": [-2.0, -2.0], "ub": [2.0, 2.0]}
    res = fmin(rosenbrock, [-1.2, 1.0], **box, alg=alg, rng=1, max_fevals=5000, stop="all", **QUIET)
    assert res.method == method and res.fun < 0.01
    x_opt, f_opt, nbr_iters, nbr_fevals, _ = res
    assert (f_opt, nbr_iters, nbr_fevals) == (rosenbrock(x_opt), res.nit, len(res.trace))
    # Both tests apply, with absolute tolerances; mutation keeps a population of bit strings wide.
    loose = fmin(rosenbrock, [-1.2, 1.0], **box, alg=alg, rng=1, x_tol=5.0 if method == "ga" else 0.5, f_tol=0.0, **QUIET)
    assert loose.termination == "converged" and loose.nfev < res.nfev and "x test passed" in loose.message


def test_missing_requirements_of_other_methods_are_reported():
    with pytest.raises(ValueError, match="barrier requires at least one bound"):
        fmin(rosenbrock, [0.0, 0.0], alg=2, **QUIET)
    with pytest.raises(ValueError, match="strictly between its bounds"):
        fmin(rosenbrock, [-2.0, 0.0], [-2, -2], [2, 2], alg=2, **QUIET)
    for alg in (3, 4):
        with pytest.raises(ValueError, match=r"requires finite bounds, but x\[0\]"):
            fmin(rosenbrock, [0.0, 0.0], alg=alg, **QUIET)
        assert fmin(rosenbrock, None, [-2, -2], [2, 2], alg=alg, rng=1, max_fevals=100, **QUIET).nfev == 100
        assert fmin(rosenbrock, None, [-2, -2], 2.0, alg=alg, rng=1, max_fevals=100, max_iters=None, **QUIET).nfev == 100
    with pytest.raises(ValueError, match="xstart, the start point of .*, is missing"):
        fmin(rosenbrock, None, [-2, -2], [2, 2], alg=1, **QUIET)


@pytest.mark.parametrize("alg", [None, 1, "nelder-mead", "Nelder-Mead"])
def test_nelder_mead_has_several_names(alg):
    assert fmin(rosenbrock, [0.0, 0.0], alg=alg, **QUIET).method == "nelder-mead"
