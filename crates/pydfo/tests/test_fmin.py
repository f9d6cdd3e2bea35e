"""fmin: signature, arguments, result."""

from __future__ import annotations

import concurrent.futures
import inspect
import logging
import multiprocessing
import pickle
from fractions import Fraction
from functools import partial

import numpy as np
import pytest
from conftest import Recorder
from methods import rosenbrock

import pydfo
from pydfo import dfo, fmin

BOX = {"lb": [-2.0, -2.0], "ub": [2.0, 2.0]}
QUIET = {"disp": False}


def test_signature_starts_as_in_the_paper():
    parameters = inspect.signature(fmin).parameters
    old = [
        ("func", inspect.Parameter.empty),
        ("xstart", None),
        ("lb", None),
        ("ub", None),
        ("alg", None),
        ("plot", False),
        ("plot_conv", False),
        ("x_tol", 1e-6),
        ("f_tol", 1e-6),
        ("max_iters", 1000),
        ("max_fevals", 10000),
        ("disp", True),
        ("nbr_cores", None),
        ("debug", False),
    ]
    positional = [p for p in parameters.values() if p.kind is p.POSITIONAL_OR_KEYWORD]
    assert [(p.name, p.default) for p in positional] == old
    assert all(p.kind is p.KEYWORD_ONLY for p in list(parameters.values())[len(old) :])
    assert dfo.fmin is fmin


def test_result_has_fields_entries_and_five_values():
    res = fmin(rosenbrock, [-1.2, 1.0], **BOX, x_tol=1e-8, f_tol=1e-8, stop="all", **QUIET)
    x_opt, f_opt, nbr_iters, nbr_fevals, solve_time = res
    assert x_opt is res.x is res[0] is res["x"]
    assert (f_opt, nbr_iters, nbr_fevals, solve_time) == (res.fun, res.nit, res.nfev, res.solve_time) == res[1:]
    assert len(res) == 5 and "fun" in res and dict(res)["nit"] == res.nit
    np.testing.assert_allclose(res.x, [1.0, 1.0], atol=1e-6)
    assert res.success and res.status == 0 and res.termination == "converged"
    assert "x test passed" in res.message and "f test passed" in res.message
    assert len(res.trace) == res.nfev
    assert res.trace.fun[res.trace.best()] == res.fun
    vertices, costs = res.final_simplex
    assert vertices.shape == (3, 2) and costs.shape == (3,) and np.all(np.diff(costs) >= 0)
    text = repr(res)
    assert "converged" in text and "nfev" in text
    with pytest.raises(KeyError, match="expected one of: x, fun"):
        res["nothing"]
    with pytest.raises(IndexError):
        res[5]
    copy = pickle.loads(pickle.dumps(res))
    assert copy.fun == res.fun and np.array_equal(copy.trace.x, res.trace.x)


def test_either_test_ends_the_run_and_is_named_in_the_message():
    by_x = fmin(rosenbrock, [-1.2, 1.0], x_tol=1e-2, f_tol=0.0, **QUIET)
    assert "x test passed" in by_x.message and "f test not passed" in by_x.message
    assert by_x.x_size <= 1e-2
    by_f = fmin(rosenbrock, [-1.2, 1.0], x_tol=0.0, f_tol=1e-2, **QUIET)
    assert "f test passed" in by_f.message and by_f.f_spread <= 1e-2
    both = fmin(rosenbrock, [-1.2, 1.0], x_tol=1e-2, f_tol=1e-2, stop="all", **QUIET)
    assert both.x_size <= 1e-2 and both.f_spread <= 1e-2
    assert both.nfev >= max(by_x.nfev, by_f.nfev)
    vertices, costs = by_x.final_simplex
    assert np.max(np.abs(vertices - vertices[0])) == pytest.approx(by_x.x_size)
    assert costs[-1] - costs[0] == pytest.approx(by_x.f_spread)


class Method:
    def cost(self, x):
        return rosenbrock(x)

    def __call__(self, x):
        return rosenbrock(x)


def shifted(by, x):
    return rosenbrock(x - by)


@pytest.mark.parametrize("func", [rosenbrock, partial(shifted, 0.0), Method().cost, Method(), lambda x: rosenbrock(x)], ids=repr)
def test_any_callable_is_an_objective(func):
    assert fmin(func, [0.5, 0.5], **QUIET, x_tol=1e-7, f_tol=1e-12, stop="all").fun < 1e-10


@pytest.mark.parametrize(
    "convert",
    [float, int, np.float64, np.float32, np.int64, np.asarray, lambda v: np.array([v]), lambda v: np.array([[v]]), Fraction],
    ids=["float", "int", "float64", "float32", "int64", "0-d", "1-element", "1x1", "Fraction"],
)
def test_any_single_number_is_a_cost(convert):
    res = fmin(lambda x: convert(1000.0 * x[0] ** 2), [1.0], x_tol=1e-3, f_tol=0.0, **QUIET)
    assert isinstance(res.fun, float) and abs(res.x[0]) < 0.05


def test_function_may_keep_and_change_its_point():
    seen = []

    def func(x):
        value = rosenbrock(x)
        seen.append(x)
        x[:] = np.nan
        return value

    res = fmin(func, [-1.2, 1.0], **BOX, max_iters=20, **QUIET)
    assert len({id(x) for x in seen}) == len(seen) and np.isfinite(res.x).all()


def test_every_evaluation_respects_bounds():
    lb, ub = np.array([-0.5, 0.2]), np.array([0.7, 0.9])

    def cost(x):
        return (x[0] - 2.0) ** 2 + 3.0 * (x[1] + 1.0) ** 2 + 0.5 * x[0] * x[1]

    for start in ([-0.5, 0.2], [0.7, 0.9], [-0.5, 0.9], [0.7, 0.2], [0.0, 0.5]):
        res = fmin(cost, start, lb, ub, x_tol=1e-9, f_tol=1e-12, stop="all", **QUIET)
        assert np.all(res.trace.x >= lb) and np.all(res.trace.x <= ub)
        np.testing.assert_allclose(res.x, [0.7, 0.2], atol=1e-6)


def test_bounds_may_be_partial_scalar_or_equal():
    res = fmin(rosenbrock, [2.0, 3.0], lb=[1.5, None], x_tol=1e-8, f_tol=1e-10, stop="all", **QUIET)
    np.testing.assert_allclose(res.x, [1.5, 2.25], atol=1e-4)
    res = fmin(lambda x: float(np.sum((x + 1) ** 2)), [1.0, 2.0, 3.0], lb=0, x_tol=1e-8, f_tol=1e-10, stop="all", **QUIET)
    np.testing.assert_allclose(res.x, 0.0, atol=1e-4)
    fixed = fmin(rosenbrock, [0.5, 0.5], lb=[0.5, -1], ub=[0.5, 1], x_tol=1e-9, f_tol=1e-12, stop="all", **QUIET)
    assert np.all(fixed.trace.x[:, 0] == 0.5) and fixed.x[1] == pytest.approx(0.25, abs=1e-5)
    all_fixed = fmin(rosenbrock, [0.5, 0.5], lb=[0.5, 0.5], ub=[0.5, 0.5], **QUIET)
    assert (all_fixed.nfev, all_fixed.fun, all_fixed.success) == (1, rosenbrock([0.5, 0.5]), True)


@pytest.mark.parametrize("n", range(1, 30))
def test_evaluation_budget_is_exact_and_best_point_is_returned(n):
    func = Recorder(rosenbrock)
    res = fmin(func, [-1.2, 1.0], max_fevals=n, **QUIET)
    assert res.nfev == len(func.values) == n == len(res.trace)
    assert res.fun == func.best and not res.success and res.status == 1
    assert any(np.array_equal(res.x, x) for x, v in zip(func.points, func.values) if v == func.best)


def test_iterations_target_and_time_limit_the_run():
    res = fmin(rosenbrock, [-1.2, 1.0], max_iters=7, **QUIET)
    assert (res.nit, res.status) == (7, 2)
    assert fmin(rosenbrock, [-1.2, 1.0], max_iters=0, **QUIET).nfev == 3
    res = fmin(rosenbrock, [-1.2, 1.0], target=0.1, **QUIET)
    assert res.success and res.status == 10 and res.fun <= 0.1
    assert np.all(res.trace.fun[: len(res.trace) - 1] > 0.1)
    import time

    def slow(x):
        time.sleep(0.02)
        return rosenbrock(x)

    res = fmin(slow, [-1.2, 1.0], max_time=0.2, **QUIET)
    assert res.status == 3 and res.solve_time < 2.0 and res.nfev < 20
    assert fmin(rosenbrock, [-1.2, 1.0], max_iters=None, max_fevals=np.inf, **QUIET).success


def test_callback_is_called_per_iteration_and_may_end_the_run():
    seen = []
    res = fmin(rosenbrock, [-1.2, 1.0], callback=seen.append, max_iters=30, **QUIET)
    assert [p.nit for p in seen] == list(range(31))
    assert seen[0].operation == "initial" and seen[0].nfev == 3 and seen[0].x_size is None
    assert seen[-1].fun == res.fun and seen[-1].final_simplex[0].shape == (3, 2)
    assert "iteration 30" in repr(seen[-1]) and seen[3]["nit"] == 3

    def stop(*, intermediate_result):
        if intermediate_result.nit == 5:
            raise StopIteration

    res = fmin(rosenbrock, [-1.2, 1.0], callback=stop, **QUIET)
    assert (res.nit, res.status, res.success) == (5, 4, False)
    res = fmin(rosenbrock, [-1.2, 1.0], callback=lambda p: p.nit == 4, **QUIET)
    assert res.nit == 4
    # return values that are only truthy do not end a run
    assert fmin(rosenbrock, [-1.2, 1.0], callback=lambda p: p.x, max_iters=9, **QUIET).nit == 9


def test_callback_exception_contains_partial_result():
    error = RuntimeError("enough")

    def callback(progress):
        if progress.nit == 3:
            raise error

    with pytest.raises(RuntimeError) as info:
        fmin(rosenbrock, [-1.2, 1.0], callback=callback, **QUIET)
    assert info.value is error and error.partial_result.nit == 3


def test_disp_prints_a_line_per_iteration(capsys):
    res = fmin(rosenbrock, [-1.2, 1.0], max_iters=5)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:2] == ["iter", "evals"]
    assert [line.split()[0] for line in lines[1:7]] == list("012345")
    assert "reflection" in "".join(lines[2:]) or "expansion" in "".join(lines[2:])
    assert lines[7] == res.message and str(res.nfev) in lines[-1]
    fmin(rosenbrock, [-1.2, 1.0], max_iters=5, disp=False)
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""


def test_debug_logs_every_evaluation(caplog):
    with caplog.at_level(logging.DEBUG, logger="pydfo"):
        res = fmin(rosenbrock, [-1.2, 1.0], max_iters=5, debug=True, **QUIET)
    assert sum(r.levelno == logging.DEBUG for r in caplog.records) == res.nfev


def test_initial_simplex_is_applied():
    vertices = [[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]]
    res = fmin(rosenbrock, [0.0, 0.0], initial_simplex=vertices, max_iters=0, **QUIET)
    np.testing.assert_array_equal(res.trace.x, vertices)
    res = fmin(rosenbrock, [1.0, 2.0], initial_simplex=[0.25, -0.5], max_iters=0, **QUIET)
    np.testing.assert_array_equal(res.trace.x, [[1.0, 2.0], [1.25, 2.0], [1.0, 1.5]])


def test_simplices_are_identical_for_all_plans_and_workers():
    options = dict(x_tol=1e-7, f_tol=1e-9, stop="all", **BOX, **QUIET)
    reference = fmin(rosenbrock, [-1.2, 1.0], **options)
    for batch in ("auto", "serial", 2, 4):
        for workers in (1, 2, 4):
            res = fmin(rosenbrock, [-1.2, 1.0], nbr_cores=workers, batch=batch, **options)
            assert res.x.tobytes() == reference.x.tobytes()
            assert (res.fun, res.nit) == (reference.fun, reference.nit)
            assert res.final_simplex[0].tobytes() == reference.final_simplex[0].tobytes()
            used = res.trace.used
            assert used.sum() == res.nfev == reference.nfev and len(used) - res.nfev == res.n_speculative


def test_figures_are_drawn_only_on_request():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    res = fmin(rosenbrock, [-1.2, 1.0], plot=True, plot_conv=True, max_iters=40, **BOX, **QUIET)
    assert len(res.figures) == 2
    for alg in (2, 3, 4):
        res = fmin(rosenbrock, [-1.2, 1.0], alg=alg, plot=True, plot_conv=True, max_fevals=300, rng=1, **BOX, **QUIET)
        plane, (costs, points) = res.figures[0].axes[0], res.figures[1].axes
        assert plane.get_title().startswith(f"{res.method}: {res.nit} iterations") and len(plane.lines) >= res.nit
        # the end of the curves is the end of the run: the best cost, and the best point in units of the evaluated
        # range
        assert costs.lines[-1].get_ydata()[-1] == res.fun and len(points.lines) == 2
        low, width = res.trace.x.min(axis=0), np.ptp(res.trace.x, axis=0)
        np.testing.assert_allclose([line.get_ydata()[-1] for line in points.lines], (res.x - low) / width)
        matplotlib.pyplot.close("all")
    with pytest.raises(ValueError, match="two free parameters, got 3"):
        fmin(lambda x: x @ x, [1.0, 1.0, 1.0], plot=True, **QUIET)
    assert fmin(rosenbrock, [-1.2, 1.0], max_iters=4, **QUIET).figures == ()
    matplotlib.pyplot.close("all")


def test_missing_matplotlib_is_reported_before_the_run(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    func = Recorder(rosenbrock)
    with pytest.raises(ImportError, match="pip install matplotlib"):
        fmin(func, [-1.2, 1.0], plot_conv=True, **QUIET)
    assert func.values == []


def test_trace_converts_to_data_frame():
    pytest.importorskip("pandas")
    res = fmin(rosenbrock, [-1.2, 1.0], max_iters=10, batch=4, **QUIET)
    frame = res.trace.to_dataframe()
    assert len(frame) == res.nfev + res.n_speculative and frame.loc[frame.used, "fun"].min() == res.fun


def test_version_equals_distribution_version():
    from importlib.metadata import version

    assert pydfo.__version__ == version("fmufit")


def test_executors_maps_and_threads_give_one_path():
    """With one batch plan, the path does not depend on the evaluator. The paper's tool used processes."""
    run = {"xstart": [-1.2, 1.0], "max_fevals": 150, "batch": 4, **BOX, **QUIET}

    def path(res):
        return res.trace.x[res.trace.used], res.trace.fun[res.trace.used]

    first = path(fmin(rosenbrock, **run))
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ThreadPoolExecutor(3) as threads, context.Pool(2) as pool:
        for given in ({"nbr_cores": threads}, {"nbr_cores": pool}, {"workers": map}, {"workers": 2}, {"nbr_cores": pool.map}):
            res = path(fmin(rosenbrock, **run, **given))
            np.testing.assert_array_equal(res[0], first[0])
            np.testing.assert_array_equal(res[1], first[1])
        assert fmin(rosenbrock, [-1.2, 1.0], nbr_cores=threads, max_iters=3, **QUIET).workers == 3
    with pytest.raises(ValueError, match="are the same argument"):
        fmin(rosenbrock, [-1.2, 1.0], nbr_cores=2, workers=2, **QUIET)
    with pytest.raises(TypeError, match="workers must be an integer, not 'two'"):
        fmin(rosenbrock, [-1.2, 1.0], workers="two", **QUIET)


@pytest.mark.parametrize("alg", [1, 2])
def test_default_coefficients_match_the_paper(alg):
    """Table 1, for any number of parameters. minimize uses adaptive coefficients from five parameters on."""
    run = {"xstart": np.full(6, 0.5), "alg": alg, "lb": np.zeros(6), "ub": np.ones(6), "max_fevals": 200, **QUIET}

    def cost(x):
        return float(np.sum(np.arange(1, 7) * (x - 0.3) ** 2))

    def path(**options):
        return fmin(cost, **run, options=options).trace.x

    by_default = path()
    np.testing.assert_array_equal(by_default, path(coefficients=(1.0, 2.0, 0.5, 0.5)))
    assert path(coefficients="adaptive").tolist() != by_default.tolist()
    np.testing.assert_array_equal(path(coefficients="auto"), path(coefficients="adaptive"))


@pytest.mark.parametrize("n", [1, 2, 3])
def test_genetic_algorithm_converges_on_a_quadratic(n):
    for seed in range(5):
        res = fmin(lambda x: float(np.sum((x - 0.7) ** 2)), lb=[-2.0] * n, ub=[2.0] * n, alg=4, rng=seed, **QUIET)
        assert res.success and res.nfev < 9000 and res.fun < 1e-4, res.message
        assert "f test passed" in res.message or "x test passed" in res.message


def test_success_requires_more_than_one_finite_point():
    start = np.array([0.25, 0.5])

    def lonely(x):
        return 1.0 if np.array_equal(x, start) else np.nan

    for stop in ("any", "all"):
        res = fmin(lonely, start, stop=stop, **QUIET)
        assert not res.success and res.status == 12 and res.termination == "one-finite-vertex"
        assert "only one vertex" in res.message and res.fun == 1.0
