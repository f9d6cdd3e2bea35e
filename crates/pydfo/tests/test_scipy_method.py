"""The methods inside scipy.optimize.minimize."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from methods import METHODS, rosenbrock, shifted

import pydfo

optimize = pytest.importorskip("scipy.optimize")
BOX = [(-2.0, 2.0), (-2.0, 2.0)]


@pytest.mark.parametrize("method", METHODS)
def test_methods_give_equal_results_inside_scipy(method):
    res = optimize.minimize(rosenbrock, [-1.2, 1.0], bounds=BOX, method=pydfo.scipy_method(method, rng=3), options={"maxfev": 400})
    alone = pydfo.minimize(rosenbrock, [-1.2, 1.0], bounds=BOX, method=method, rng=3, max_evaluations=400)
    assert isinstance(res, optimize.OptimizeResult) and res.x.tobytes() == alone.x.tobytes()
    assert (res.fun, res.nfev, res.nit, res.message) == (alone.fun, alone.nfev, alone.nit, alone.message)
    assert res.success == alone.success and res.status == alone.status
    assert f"nfev: {res.nfev}" in str(res)


def test_tolerances_arguments_and_options_are_passed_on():
    method = pydfo.scipy_method("nelder-mead")
    res = optimize.minimize(shifted, [0.0, 0.0], args=(1.0, 2.0), method=method, tol=1e-3)
    vertices, costs = res.final_simplex
    assert np.abs(vertices - vertices[0]).max() <= 1e-3 and costs[-1] - costs[0] <= 1e-3
    assert res.fun == shifted(res.x, 1.0, 2.0) and "<= x_tol 0.001" in res.message
    tight = optimize.minimize(rosenbrock, [0.0, 0.0], method=method, options={"xatol": 1e-8, "fatol": 1e-8})
    assert tight.nfev > res.nfev and tight.x_size <= 1e-8 and tight.f_spread <= 1e-8
    res = optimize.minimize(rosenbrock, [0.0, 0.0], method=method, options={"maxiter": 11, "batch": 4})
    assert res.nit == 11 and res.status == 2 and res.batch == "4"
    simplex = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
    options = {"initial_simplex": simplex, "maxiter": 0, "adaptive": True}
    np.testing.assert_array_equal(optimize.minimize(rosenbrock, [0.0, 0.0], method=method, options=options).trace.x, simplex)
    bounds = optimize.Bounds([-2, -2], [0.5, np.inf])
    res = optimize.minimize(rosenbrock, [0.0, 0.0], method=method, bounds=bounds)
    np.testing.assert_allclose(res.x, [0.5, 0.25], atol=1e-4)


def test_callbacks_follow_scipy_convention():
    method, seen = pydfo.scipy_method("nelder-mead"), []

    def by_name(intermediate_result):
        assert isinstance(intermediate_result, optimize.OptimizeResult)
        seen.append((intermediate_result.x, intermediate_result.fun))
        if len(seen) == 5:
            raise StopIteration

    res = optimize.minimize(rosenbrock, [0.0, 0.0], method=method, callback=by_name)
    assert len(seen) == 5 and not res.success and res.fun == seen[-1][1]
    points = []
    optimize.minimize(rosenbrock, [0.0, 0.0], method=method, callback=points.append, options={"maxiter": 7})
    assert len(points) == 8 and all(isinstance(x, np.ndarray) for x in points)


def test_unsupported_arguments_are_reported(capsys):
    method = pydfo.scipy_method("nelder-mead")
    with pytest.raises(ValueError, match="does not support nonlinear constraints"):
        optimize.minimize(rosenbrock, [0.0, 0.0], method=method, constraints={"type": "eq", "fun": sum})
    with pytest.warns(RuntimeWarning, match="does not use derivatives"):
        optimize.minimize(rosenbrock, [0.0, 0.0], method=method, jac=optimize.rosen_der)
    with pytest.raises(ValueError, match="unknown option 'gtol'"):
        optimize.minimize(rosenbrock, [0.0, 0.0], method=method, options={"gtol": 1})
    with pytest.raises(ValueError, match="unknown method 'bfgs'; .*did you mean 'quadratic-model'"):
        pydfo.scipy_method("bfgs")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        optimize.minimize(rosenbrock, [0.0, 0.0], method=method, options={"disp": True, "maxiter": 3})
    assert "iterations" in capsys.readouterr().out
