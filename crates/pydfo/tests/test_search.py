"""Global searches and the choice of the method: `search=`, `method_reason`, `optima`."""

import numpy as np
import pytest

import pydfo
from pydfo import Parameter


def himmelblau(x):
    """Returns a function with four minima of cost 0 in [-5, 5]^2."""
    return np.array([x[0] ** 2 + x[1] - 11.0, x[0] + x[1] ** 2 - 7.0])


MINIMA = [(3.0, 2.0), (-2.805118, 3.131313), (-3.779310, -3.283186), (3.584428, -1.848127)]
BOX = [(-5.0, 5.0)] * 2


def found(result):
    return sum(any(np.abs(o.x - m).max() < 1e-3 and o.fun < 1e-6 for o in result.optima) for m in MINIMA)


def test_global_search_reports_minima_and_reason():
    by_cost = pydfo.minimize(lambda x: float(np.sum(himmelblau(x) ** 2)), bounds=BOX, search="global", rng=1)
    assert by_cost.method == "multistart" and "global search" in by_cost.method_reason
    # The budget ends before the four minima are probably complete.
    assert by_cost.termination == "max-evaluations" and by_cost.fun < 1e-8 and by_cost.optima[0].fun == by_cost.fun
    fit = pydfo.least_squares(himmelblau, [0.0, 0.0], BOX, search="global", rng=1)
    assert fit.method == "multistart" and "residuals" in fit.method_reason
    assert found(fit) == 4 and fit.nfev < 700 and fit.cost < 1e-12
    assert all(o.n_starts >= 1 for o in fit.optima) and fit.jac.shape == (2, 2)
    again = pydfo.least_squares(himmelblau, [0.0, 0.0], BOX, search="global", rng=1, workers=2)
    assert again.trace.x.tobytes() == fit.trace.x.tobytes()


def test_automatic_method_depends_on_the_problem():
    def chosen(function=pydfo.minimize, fun=lambda x: float(x @ x), **given):
        return function(fun, [1.0, 2.0], max_evaluations=20, **given)

    assert chosen().method == "quadratic-model" and "Nelder-Mead if it has kinks" in chosen().method_reason
    assert chosen(method="nelder-mead").method_reason is None
    assert chosen(options={"kinds": "integer"}, bounds=BOX).method == "cma-es"
    assert chosen(options={"kinds": "integer", "p_best": 0.2}, bounds=BOX).method == "de"
    assert chosen(options={"coefficients": "standard"}).method == "nelder-mead"
    kinked = pydfo.minimize(lambda x: abs(x[0] - 1.0) + 10.0 * abs(x[1] - x[0]), [-1.0, 2.0])
    assert kinked.success and kinked.fun < 1e-5 and "switched to nelder-mead after" in kinked.message
    assert chosen(pydfo.least_squares, himmelblau).method == "least-squares"
    with pytest.raises(ValueError, match=r"a global search requires finite bounds, but x\[0\]"):
        chosen(search="global")
    with pytest.raises(ValueError, match="search = 'everywhere' is invalid; expected one of: 'local', 'global'"):
        chosen(search="everywhere")
    with pytest.raises(ValueError, match="selects the method automatically"):
        chosen(search="global", method="de", bounds=BOX)


def test_global_fit_uses_residuals():
    time = np.linspace(0.0, 2.0, 21)
    data = {"time": time, "x": np.exp(-2.0 * time)}
    calibration = pydfo.Calibration(pydfo.example_fmu("dahlquist"), data, ["x"], [Parameter("k", 1.0, 0.1, 10.0)])
    fit = calibration.fit()
    assert fit.method == "least-squares" and fit.method_reason and abs(fit.x[0] - 2.0) < 1e-4 and fit.nfev < 15
    everywhere = calibration.fit(search="global", rng=1)
    assert everywhere.method == "multistart" and len(everywhere.optima) == 1 and abs(everywhere.x[0] - 2.0) < 1e-4
    simplex = calibration.fit(initial_simplex=[0.5])
    assert simplex.method == "nelder-mead" and "initial_simplex" in simplex.method_reason
