"""minimize: arguments as in SciPy, all methods, all kinds of workers."""

from __future__ import annotations

import concurrent.futures
import inspect
import multiprocessing
import os
import pickle
import threading

import numpy as np
import pytest
from conftest import Recorder
from methods import (
    METHODS,
    RUN,
    CannotBeSent,
    columns,
    fails_sometimes,
    process_id,
    raises_what_cannot_be_sent,
    rosenbrock,
    shifted,
    timeless,
)

import pydfo
from pydfo import minimize


def test_signature_is_stable():
    parameters = inspect.signature(minimize).parameters
    assert [(p.name, p.default) for p in parameters.values() if p.name not in ("fun", "x0")] == [
        ("bounds", None),
        ("method", "auto"),
        ("args", ()),
        ("workers", 1),
        ("callback", None),
        ("rng", None),
        ("max_evaluations", None),
        ("max_iterations", None),
        ("max_time", None),
        ("target", None),
        ("options", None),
        ("checkpoint", None),
        ("resume", "auto"),
        ("on_error", "raise"),
        ("vectorized", False),
        ("search", "local"),
        ("constraints", None),
    ]
    assert list(parameters)[:2] == ["fun", "x0"]
    assert [p.kind is p.POSITIONAL_OR_KEYWORD for p in parameters.values()] == [True] * 2 + [False] * 17
    with pytest.warns(DeprecationWarning, match=r"positional arguments after x0 are deprecated; use bounds=\.\.\., method=\.\.\.$") as caught:
        by_position = minimize(rosenbrock, [-1.2, 1.0], [(-2, 2)] * 2, "barrier", max_evaluations=50)
    assert caught[0].filename == __file__
    named = minimize(rosenbrock, [-1.2, 1.0], bounds=[(-2, 2)] * 2, method="barrier", max_evaluations=50)
    assert timeless(by_position) == timeless(named)
    with pytest.warns(DeprecationWarning), pytest.raises(TypeError, match="multiple values for argument 'bounds'"):
        minimize(rosenbrock, [-1.2, 1.0], [(-2, 2)] * 2, bounds=None)


@pytest.mark.parametrize("method", METHODS)
def test_methods_find_the_minimum(method):
    res = minimize(rosenbrock, **{**RUN, "rng": 1}, method=method, max_evaluations=6000)
    np.testing.assert_allclose(res.x, [1.0, 1.0], atol=0.05)
    assert res.method == method and res.fun == rosenbrock(res.x) and len(res.trace) == res.nfev
    assert (res.final_simplex is None) == (method not in ("nelder-mead", "barrier"))
    if method in ("de", "de-classic", "ga", "cma-es"):
        members, costs = res.final_population
        assert res.seed == 1 and members.shape[1] == 2 and np.all(np.diff(costs) >= 0)
        # CMA-ES returns the last generation, which may not contain the best point.
        assert costs[0] == res.fun or method == "cma-es"
    elif method == "pattern-search":
        assert res.seed is None and res.final_population[1] == [res.fun]
    else:
        # For quadratic models, it contains the interpolation points.
        assert res.seed is None and (res.final_population is None) == (method != "quadratic-model")
    mus = [stage.mu for stage in res.schedule]
    assert (method == "barrier") == bool(mus) and mus == sorted(mus, reverse=True)
    assert timeless(pickle.loads(pickle.dumps(res))) == timeless(res)


@pytest.mark.parametrize("method", METHODS)
def test_budgets_are_exact_for_every_method(method):
    for budget in (*range(1, 60), 97, 150, 200):
        func = Recorder(rosenbrock)
        res = minimize(func, **RUN, method=method, max_evaluations=budget)
        assert res.nfev == len(func.values) <= budget
        assert res.fun == func.best and rosenbrock(res.x) == res.fun
        assert res.nfev == budget or res.success


def test_bounds_are_accepted_in_scipy_forms():
    optimize = pytest.importorskip("scipy.optimize")

    def cost(x):
        return (x[0] - 3.0) ** 2 + (x[1] + 3.0) ** 2

    runs = [
        minimize(cost, [0.0, 0.0], bounds=bounds)
        for bounds in (
            [(-1, 1), (-2, None)],
            ((-1, 1), (-2, np.inf)),
            np.array([[-1, 1], [-2, np.inf]]),
            optimize.Bounds([-1, -2], [1, np.inf]),
        )
    ]
    assert len({timeless(run) for run in runs}) == 1
    np.testing.assert_allclose(runs[0].x, [1.0, -2.0], atol=2e-5)
    scalar = minimize(cost, [0.0, 0.0], bounds=optimize.Bounds(-1, 2))
    np.testing.assert_allclose(scalar.x, [2.0, -1.0], atol=1e-3)
    fixed = minimize(cost, [0.5, 0.0], bounds=[(0.5, 0.5), (None, None)])
    assert np.all(fixed.trace.x[:, 0] == 0.5) and fixed.x[1] == pytest.approx(-3.0, abs=1e-5)
    # methods that sample a box need no start; Bounds then determine the number of parameters
    sampled = minimize(cost, None, bounds=optimize.Bounds([-1, -2], [1, 2]), method="de", rng=1, max_evaluations=2000)
    np.testing.assert_allclose(sampled.x, [1.0, -2.0], atol=1e-3)


def test_further_arguments_reach_the_function():
    res = minimize(shifted, [0.0, 0.0], args=(0.5, 3.0), max_iterations=20)
    assert res.fun == 3.0 * rosenbrock(res.x - 0.5)
    assert timeless(minimize(lambda x, a: rosenbrock(x), [0.0, 0.0], args="a", max_iterations=20)) == timeless(
        minimize(rosenbrock, [0.0, 0.0], max_iterations=20)
    )


@pytest.mark.parametrize("method", METHODS)
def test_serial_threads_executors_and_maps_give_the_same_trace(method):
    """With one batch plan, the path does not depend on the evaluator."""
    plan = {"batch": 4} if method in ("nelder-mead", "barrier") else {}
    run = {**RUN, "method": method, "max_evaluations": 250, "options": plan}
    first = timeless(minimize(rosenbrock, **run))
    for workers in (2, 7, -1, map):
        assert timeless(minimize(rosenbrock, **run, workers=workers)) == first, workers
    assert timeless(minimize(columns, **run, vectorized=True)) == first
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ThreadPoolExecutor(3) as threads:
        assert timeless(minimize(rosenbrock, **run, workers=threads)) == first
        assert timeless(minimize(rosenbrock, **run, workers=threads.map)) == first
    with concurrent.futures.ProcessPoolExecutor(2, mp_context=context) as processes:
        assert timeless(minimize(rosenbrock, **run, workers=processes)) == first
        assert timeless(minimize(rosenbrock, **run, workers=processes.map)) == first
        assert timeless(minimize(shifted, **run, args=(0.0, 1.0), workers=processes)) == first


def test_process_pool_is_used():
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        ids = set()
        for workers in (pool, pool.map):
            res = minimize(process_id, **RUN, method="de", workers=workers, max_evaluations=60)
            ids |= set(res.trace.fun)
        assert len(ids) <= 2 and os.getpid() not in ids


def test_exceptions_in_executors_keep_the_other_points():
    start = {"x0": [0.0, 0.0], "bounds": [(-2, 2), (-2, 2)], "method": "de", "rng": 1}
    with concurrent.futures.ThreadPoolExecutor(2) as threads:
        with pytest.raises(ValueError, match="too large") as info:
            minimize(fails_sometimes, **start, workers=threads)
        partial = info.value.partial_result
        assert partial.nfev >= 2 and partial.status == 6 and partial.fun == rosenbrock(partial.x)
        res = minimize(fails_sometimes, **start, workers=threads, on_error="fail", max_evaluations=300)
        assert res.nfail > 0 and res.failures == {"ValueError: too large": res.nfail}
        serial = minimize(fails_sometimes, **start, on_error="fail", max_evaluations=300)
        assert timeless(res) == timeless(serial)
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as processes:
        res = minimize(fails_sometimes, **start, workers=processes, on_error="fail", max_evaluations=300)
        assert timeless(res) == timeless(serial)
        with pytest.raises(RuntimeError, match="CannotBeSent: 1 and 2"):
            minimize(raises_what_cannot_be_sent, **start, workers=processes)
        with pytest.raises(Exception, match="[Pp]ickle"):
            minimize(lambda x: 1.0, **start, workers=processes)
    with multiprocessing.get_context("spawn").Pool(1) as pool, pytest.raises(RuntimeError, match="CannotBeSent: 1 and 2"):
        minimize(raises_what_cannot_be_sent, **start, workers=pool)
    error = CannotBeSent(3, 4)

    def raising(x):
        raise error

    with pytest.raises(CannotBeSent) as info:
        minimize(raising, **start, workers=map)
    assert info.value is error and info.traceback[-1].name == "raising"


def test_executor_receives_one_point_per_worker():
    widths = []

    class Counting(concurrent.futures.ThreadPoolExecutor):
        def submit(self, *args, **kwargs):
            widths.append(threading.get_ident())
            return super().submit(*args, **kwargs)

    with Counting(5) as executor:
        res = minimize(rosenbrock, [-1.2, 1.0], workers=executor, max_iterations=30, method="nelder-mead")
    assert res.batch == "auto" and res.workers == 5
    # Some points started speculatively are cancelled before they run.
    assert set(widths) == {threading.get_ident()} and len(widths) >= res.nfev + res.n_speculative
    assert minimize(rosenbrock, [-1.2, 1.0], workers=map, max_iterations=3, options={"batch": "serial"}).batch == "serial"


def test_vectorized_points_are_columns():
    shapes = []

    def cost(x, factor):
        shapes.append(x.shape)
        return factor * columns(x)

    res = minimize(cost, **RUN, args=(2.0,), method="de-classic", vectorized=True, max_evaluations=100)
    assert {shape[0] for shape in shapes} == {2} and sum(shape[1] for shape in shapes) == res.nfev == 100
    with pytest.raises(TypeError, match=r"array of shape \(20,\) for points of shape \(2, 20\), not of shape \(2,\)"):
        minimize(lambda x: x[:, 0], **RUN, method="de-classic", vectorized=True)
    with pytest.raises(ValueError, match="workers must be a number"):
        minimize(columns, **RUN, vectorized=True, workers=map)
    bad = minimize(lambda x: np.where(x[0] > 0, np.nan, columns(x)), **RUN, method="de", vectorized=True, max_evaluations=200)
    assert 0 < bad.nfail < 200


def test_callback_receives_progress_and_may_stop():
    seen = []

    def callback(intermediate_result):
        seen.append(intermediate_result)
        if intermediate_result.nit == 4:
            raise StopIteration

    for method in METHODS:
        seen.clear()
        res = minimize(rosenbrock, **RUN, method=method, callback=callback)
        assert (res.nit, res.termination, res.success) == (4, "stopped-by-observer", False)
        assert [p.nit for p in seen] == [0, 1, 2, 3, 4] and seen[-1].fun == res.fun
        assert (seen[-1].final_population is None) != (seen[-1].final_simplex is None)
    error = KeyError("mine")

    def raising(progress):
        raise error

    with pytest.raises(KeyError) as info:
        minimize(rosenbrock, **RUN, callback=raising, workers=map)
    partial = error.partial_result
    assert info.value is error and partial.nfev >= 3
    assert (partial.status, partial.termination, partial.message) == (6, "aborted", "aborted by the callback: KeyError: 'mine'")


def test_seeds_are_accepted_drawn_and_reported():
    run = {"bounds": [(-2, 2)] * 2, "method": "de", "max_evaluations": 200}
    first = minimize(rosenbrock, **run)
    again = minimize(rosenbrock, **run, rng=first.seed)
    assert timeless(first) == timeless(again) and isinstance(first.seed, int)
    assert minimize(rosenbrock, **run).seed != first.seed
    drawn = [minimize(rosenbrock, **run, rng=np.random.default_rng(3)) for _ in range(2)]
    assert timeless(drawn[0]) == timeless(drawn[1])
    generator = np.random.default_rng(3)
    assert minimize(rosenbrock, **run, rng=generator).seed != minimize(rosenbrock, **run, rng=generator).seed
    assert minimize(rosenbrock, **run, rng=np.uint64(2**64 - 1)).seed == 2**64 - 1


def test_integer_and_categorical_parameters_are_optimised():
    def cost(x):
        assert x[1] == round(x[1]) and x[2] == round(x[2])
        return (x[0] - 0.3) ** 2 + (x[1] - 4.0) ** 2 + (0.0 if x[2] == 2 else 1.0)

    box = [(-1, 1), (-10, 10), (0, 5)]
    kinds = ["continuous", "integer", "categorical"]
    res = minimize(cost, None, bounds=box, rng=1, max_evaluations=4000, options={"kinds": kinds})
    assert res.method == "ga" and list(res.x[1:]) == [4.0, 2.0] and res.fun < 1e-3
    whole = minimize(lambda x: (x[0] - 0.3) ** 2 + (x[1] - 4.0) ** 2, None, bounds=box[:2], rng=1, options={"kinds": kinds[:2]})
    assert whole.method == "de" and whole.x[1] == 4.0 and whole.fun < 1e-9 and whole.success
    with pytest.raises(ValueError, match="x\\[2\\], which is categorical"):
        minimize(cost, None, bounds=box, method="de", options={"kinds": kinds})
    with pytest.raises(ValueError, match=r"nelder-mead does not support x\[1\]"):
        minimize(cost, [0, 0, 0], bounds=box, method="nelder-mead", options={"kinds": kinds})


def test_sizes_scales_and_warm_starts_are_options():
    def cost(x):
        return (np.log10(x[0]) - 3.0) ** 2 + (x[1] - 2e-6) ** 2 * 1e12

    res = minimize(cost, [1.0, 0.0], bounds=[(1e-3, 1e6), (None, None)], options={"scale": ["log", "linear"], "nominal": [1, 1e-6]})
    np.testing.assert_allclose(res.x, [1e3, 2e-6], rtol=1e-4)
    for earlier in (res, res.trace, (res.trace.x, res.trace.fun)):
        more = minimize(cost, [1.0, 0.0], bounds=[(1e-3, 1e6), (None, None)], options={"warm_start": earlier})
        assert more.fun <= res.fun and more.trace.x[0].tolist() != [1.0, 0.0]
    limited = minimize(rosenbrock, [-1.2, 1.0], options={"trace_limit": 10})
    assert len(limited.trace) == 10 and limited.trace.n_dropped == limited.nfev - 10
    # Gray codes reach some points repeatedly
    cached = minimize(rosenbrock, **RUN, method="ga", options={"resolution": np.array([0.5, 0.5])}, max_iterations=40)
    assert cached.n_cached > 100


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("nelder-mead", {"batch": "ahead", "coefficients": "adaptive", "bounds_handling": "clamp", "restarts": 0}),
        ("nelder-mead", {"coefficients": (1, 2, 0.5, 0.5), "initial_simplex": np.array([[0, 0], [1, 0], [0, 1.0]])}),
        ("nelder-mead", {"bounds_handling": "sine", "initial_simplex": [0.1, 0.2], "stop": "any", "tolerances": "absolute"}),
        ("barrier", {"mu": 0.5, "factor": 0.2, "batch": 2}),
        ("barrier", {"mu": None}),
        ("de", {"population": 30, "sampling": "sobol", "repair": "mirror", "include_start": False, "budget": 500, "lag": 0}),
        ("de", {"p_best": 0.2, "memory": 6, "archive": 1.5, "final_population": 6, "budget": None}),
        ("de", {"initial_population": np.linspace(-1, 1, 24).reshape(12, 2), "population": 12}),
        ("de-classic", {"strategy": "best1", "crossover": "exponential", "weight": (0.5, 1.0), "probability": 0.7}),
        ("de-classic", {"strategy": "current_to_best1", "weight": 0.6}),
        ("ga", {"population": 20, "selection": 3, "crossover_rate": 0.6, "mutation_rate": 0.02, "elite": 2, "gray": np.True_}),
        ("ga", {"population": 20.0, "selection": 3.0, "elite": np.float64(2), "stall": 1e9}),
        ("cma-es", {"population": 12, "sigma": 0.1, "restarts": "bipop", "bounds_handling": "mirror"}),
        ("cma-es", {"population": 4.0, "sigma": np.float64(1), "restarts": None, "lag": 5}),
        ("pattern-search", {"batch": 4, "frame": 0.1, "restarts": 0}),
        ("ga", {"selection": "fitness", "resolution": [0.01, 0.01], "sampling": "uniform", "stall": None, "cache": 0}),
    ],
)
def test_options_reach_their_methods(method, options):
    res = minimize(rosenbrock, **RUN, method=method, options=options, max_evaluations=300)
    assert res.fun < rosenbrock([-1.2, 1.0])
    if "population" in options:
        assert np.count_nonzero(res.trace.batch == 0) == options["population"]
    if options.get("batch"):
        assert res.batch == str(options["batch"])


@pytest.mark.parametrize("method", ["de", "de-classic"])
def test_given_first_population_is_evaluated_first_with_any_workers(method):
    members = np.random.default_rng(1).uniform(-2, 2, (15, 2))
    runs = [
        minimize(rosenbrock, **{**RUN, "rng": 1}, method=method, options={"initial_population": members}, max_evaluations=200, workers=workers)
        for workers in (1, 3)
    ]
    for res in runs:
        path = res.trace.x[res.trace.used]
        assert path[:15].tolist() == members.tolist() and RUN["x0"] not in path[15:].tolist()
    assert timeless(runs[0])[:2] == timeless(runs[1])[:2]


@pytest.mark.parametrize(
    ("changes", "error", "expected"),
    [
        ({"fun": 3}, TypeError, "fun must be callable"),
        ({"method": "nelder_meat"}, ValueError, "did you mean 'nelder-mead'"),
        ({"method": "least-squares"}, ValueError, "requires the vector of residuals. Use pydfo.least_squares"),
        ({"method": 1}, TypeError, "method must be a string"),
        ({"options": {"restart": 3}}, ValueError, "no option 'restart'; did you mean 'restarts'. its options are hand_over, points, .*every"),
        ({"options": {"popsize": 3}}, ValueError, "unknown option 'popsize'; use the option population"),
        ({"options": {"maxiter": 3}}, ValueError, "use the argument max_iterations"),
        ({"options": {"maxfev": 3}}, ValueError, "use the argument max_evaluations"),
        ({"options": {"xatol": 3}}, ValueError, "use the option x_tol"),
        ({"options": {"ftol": 3}}, ValueError, "use the option f_tol"),
        ({"options": {"rng": 3}}, ValueError, "rng is an argument"),
        ({"method": "differental_evolution"}, ValueError, "did you mean 'de'"),
        ({"x0": ["a"] * 150}, TypeError, r"x0 must be numbers, not \['a', 'a', 'a', 'a', 'a', 'a', \.\.\.\]$"),
        ({"method": "de", "options": {"crossover": "binomial"}}, ValueError, "de has no option 'crossover'; its options are archive"),
        ({"method": "cma-es", "options": {"restarts": "often"}}, ValueError, "restarts = 'often' is invalid; expected one of: 'none', 'ipop'"),
        ({"method": "cma-es", "options": {"sigma": 0}}, ValueError, "sigma = 0 must be positive and finite"),
        ({"method": "cmaess"}, ValueError, "did you mean 'cma-es'"),
        ({"method": "pattern-search", "options": {"frame": "wide"}}, TypeError, "option 'frame' of pattern-search must be a number"),
        ({"options": {"restarts": 1.5}}, TypeError, "option 'restarts' of quadratic-model must be an integer"),
        ({"options": {"restarts": True}}, TypeError, "option 'restarts' of quadratic-model must be an integer"),
        ({"options": {"restarts": -1}}, ValueError, "option 'restarts' of quadratic-model must be an integer of at least 0.* not -1"),
        ({"method": "de", "options": {"population": -1.0}}, ValueError, "'population' of de must be an integer.* not -1.0"),
        ({"method": "de", "options": {"memory": 1e30}}, ValueError, r"'memory' of de must be an integer.* not 1e\+30"),
        ({"method": "ga", "options": {"selection": 0}}, ValueError, "selection = 0 must be from 1 to the number of members"),
        ({"method": "ga", "options": {"selection": -3}}, ValueError, "'selection' of ga must be 'fitness', or the number"),
        ({"method": "ga", "options": {"mutation_rate": np.nan}}, ValueError, "'mutation_rate' of ga must be a number.* not nan"),
        ({"options": {"batch": 0}}, ValueError, "batch = 0 must be at least 1"),
        ({"options": {"batch": 1.5}}, TypeError, "option 'batch' of nelder-mead must be an integer, 'auto', 'serial' or 'ahead', not 1.5"),
        ({"options": {"batch": "six"}}, ValueError, "option 'batch' of nelder-mead must be an integer, 'auto', .*, not 'six'"),
        ({"options": {"coefficients": (1, 2)}}, TypeError, "option 'coefficients' of nelder-mead must be 'auto'"),
        ({"options": {"coefficients": (1, 0.5, 0.5, 0.5)}}, ValueError, "expansion = 0.5 must be above 1"),
        ({"method": "ga", "options": {"crossover_rate": 1.5}}, ValueError, "crossover_rate = 1.5 must be from 0 to 1"),
        ({"method": "ga", "options": {"gray": "yes"}}, TypeError, "option 'gray' of ga must be True or False"),
        ({"method": "de-classic", "options": {"weight": "F"}}, TypeError, "option 'weight' of de-classic must be a number or"),
        ({"options": {"tolerances": "loose"}}, ValueError, "tolerances = 'loose' is invalid; expected one of:"),
        ({"options": {"kinds": "whole"}}, ValueError, "kinds = 'whole' is invalid; expected one of: 'continuous'"),
        ({"options": {"kinds": ["integer"]}}, ValueError, "kinds: expected 2 values, one per parameter; got 1"),
        ({"options": {"nominal": [1.0]}}, ValueError, "nominal: expected 2 values, one per parameter; got 1"),
        ({"options": {"warm_start": 3}}, TypeError, "warm_start must be a result"),
        ({"options": {"warm_start": (np.zeros((3, 1)), np.zeros(3))}}, ValueError, r"expected shapes \(m, 2\) and \(m,\)"),
        ({"options": [("batch", "two")]}, TypeError, "options must be a dict"),
        ({"bounds": [(0, 1)]}, ValueError, "bounds: expected 2 pairs, one per parameter; got 1"),
        ({"bounds": [(0, 1), (0, 1, 2)]}, ValueError, r"bounds\[1\] = .* has 3 values"),
        ({"bounds": 3}, TypeError, "bounds must be pairs"),
        ({"bounds": "de"}, TypeError, "bounds must be pairs of numbers or None, not 'de'; did you mean method='de'?"),
        ({"popluation": 30}, TypeError, "did you mean options={'population': ...}"),
        ({"options": {"initial_simplex": [0.1, np.nan]}}, ValueError, r"initial_simplex\[1\] = nan must be finite"),
        ({"options": {"initial_simplex": [[0, 0], [1, np.inf], [2, 0]]}}, ValueError, r"initial_simplex\[1, 1\] = inf must be"),
        ({"method": "de", "options": {"initial_population": "sobol"}}, TypeError, r"must be points of shape \(m, 2\), not 'sobol'"),
        ({"method": "de", "options": {"initial_population": 1j * np.eye(4, 2)}}, TypeError, r"must be points of shape \(m, 2\), not array"),
        ({"method": "de", "options": {"initial_population": np.ones(2)}}, ValueError, r"shape \(2,\); expected points of shape \(m, 2\)"),
        ({"method": "de", "options": {"initial_population": [[0, np.nan]]}}, ValueError, r"initial_population\[0, 1\] = nan must be finite"),
        ({"method": "de", "options": {"initial_population": np.eye(2)}}, ValueError, "population = 2 must be large enough"),
        ({"method": "de", "options": {"initial_population": 3 * np.eye(4, 2)}}, ValueError, r"x\[0\] = 3 of member 0 is outside"),
        ({"method": "de", "options": {"initial_population": np.eye(4, 2)[:, ::-1] * [0, 1]}}, ValueError, r"x\[0\] = 0 in all members"),
        ({"method": "ga", "options": {"initial_population": np.eye(4, 2)}}, ValueError, "ga has no option 'initial_population'"),
        ({"options": {"init": "sobol"}}, ValueError, r"use options=\{\"sampling\": ...\} or options=\{\"initial_population\": ...\}"),
        ({"bounds": [(1, 0), (0, 1)]}, ValueError, "lower bound 1 is above"),
        ({"bounds": None, "method": "de"}, ValueError, "de requires finite bounds"),
        ({"x0": None, "bounds": None}, ValueError, "is missing; methods that sample a box require at least bounds"),
        ({"x0": None}, ValueError, "the start point"),
        ({"workers": 0}, ValueError, "workers = 0"),
        ({"workers": 10**20}, ValueError, "workers = 100000000000000000000 is too large"),
        ({"workers": "two"}, TypeError, "workers must be an integer"),
        ({"rng": -1}, ValueError, "rng = -1"),
        ({"rng": "seed"}, TypeError, "rng must be an integer"),
        ({"on_error": "continue"}, ValueError, "on_error = 'continue' is invalid; expected one of: 'raise', 'fail'"),
        ({"callback": 1}, TypeError, "callback must be callable"),
        ({"max_evaluations": 0}, ValueError, "max_evaluations = 0"),
        ({"target": np.nan}, ValueError, "target = NaN"),
        ({"resume": "maybe"}, ValueError, "resume = 'maybe' is invalid; expected one of:"),
    ],
    ids=lambda v: str(v)[:60] if isinstance(v, dict) else "",
)
def test_bad_arguments_are_explained_before_the_run(changes, error, expected):
    func = Recorder(rosenbrock)
    arguments = {"fun": func, "x0": [0.5, 0.5], "bounds": [(-2, 2), (-2, 2)], **changes}
    with pytest.raises(error, match=expected):
        minimize(**arguments)
    assert func.values == []


def test_huge_limits_mean_no_limit():
    free = timeless(minimize(rosenbrock, **RUN))
    for limits in ({"max_time": 1e30}, {"max_iterations": 1e30}, {"max_evaluations": 2**70}, {"max_time": np.inf}):
        assert timeless(minimize(rosenbrock, **{**RUN, **limits}))[:2] == free[:2]
    for name in ("max_time", "max_evaluations", "target"):
        with pytest.raises(TypeError, match=f"{name} must be a number, not '3'"):
            minimize(rosenbrock, [0.0, 0.0], **{name: "3"})


def test_unsupported_arguments_suggest_alternatives():
    def bowl(x):
        return float(x @ x)

    with pytest.raises(TypeError, match="the methods do not use derivatives"):
        minimize(bowl, [1.0], **{"jac": None})
    with pytest.raises(TypeError, match="use the argument constraints"):
        minimize(bowl, [1.0], **{"cons": []})
    with pytest.raises(TypeError, match="pass additional arguments through a function"):
        pydfo.fmin(bowl, [1.0], args=(2.0,))

    async def listen(progress):
        pass

    with pytest.raises(TypeError, match="coroutine function"):
        minimize(bowl, [1.0], callback=listen)


def test_unknown_sizes_are_estimated():
    scales = np.array([1e-6, 1e5, 30.0])

    def cost(x):
        u = x / scales - [2.0, -1.0, 3.0]
        return float(u @ u + (u[0] - u[1] + u[2]) ** 2)

    found = minimize(cost, [0.0, 0.0, 0.0])
    assert found.success and found.fun < 1e-9
    partly = minimize(cost, [0.0, 0.0, 0.0], options={"nominal": [1e-6, None, 30]})
    assert partly.success and partly.fun < 1e-9
    unmoved = minimize(lambda x: float((x[0] - 1) ** 2), [0.5, 0.0])
    assert "no step of x[1] from zero changed the cost" in unmoved.message
    with pytest.raises(ValueError, match=r"x\[1\].*NaN"):
        minimize(cost, [0.0, 0.0, 0.0], options={"nominal": [1e-6, float("nan"), 30]})


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("method", METHODS)
def test_run_ends_with_call_that_reaches_the_target(method, workers):
    res = pydfo.minimize(lambda x: float(x @ x), [1.0, 2.0], bounds=[(-5, 5)] * 2, method=method, target=1e9, rng=1, workers=workers)
    assert (res.success, res.nfev, res.status) == (True, 1, 10)


def test_cutoffs_do_not_change_counts():
    def cost(x):
        return float(((x - [3.3, -4.1, 1.7]) ** 2).sum() + 3 * (1 - np.cos(2 * (x - [3.3, -4.1, 1.7]))).sum())

    def cutting(x, *, cutoff):
        value = cost(x)
        return pydfo.Above(cutoff) if value > cutoff else value

    for seed in range(10):
        options = {"kinds": "integer", "population": 12}
        arguments = dict(bounds=[(-9, 9)] * 3, method="de", rng=seed, max_evaluations=60 + 13 * seed, options=options)
        whole, cut = pydfo.minimize(cost, **arguments), pydfo.minimize(cutting, **arguments)
        assert (whole.x == cut.x).all()
        assert (whole.nfev, whole.nit, whole.n_cached) == (cut.nfev, cut.nit, cut.n_cached)
