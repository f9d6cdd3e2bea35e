"""Workers of every kind change only the time: speculative evaluations have no effect on the result."""

import concurrent.futures
import subprocess
import sys
from pathlib import Path

import numpy as np
import pydfo
import pytest
from methods import rosenbrock


class Trap(Exception):
    pass


def summary(result):
    return result.x.tobytes(), result.fun, result.nfev, result.nit, result.nfail, result.termination


@pytest.mark.parametrize("method", ["nelder-mead", "barrier", "de", "de-classic", "ga", "cma-es", "pattern-search"])
@pytest.mark.parametrize("budget", [7, 61, 150])
def test_result_is_identical_for_all_kinds_of_workers(method, budget):
    def patchy(x):
        return float("nan") if np.floor(37 * x[0]) % 7 == 0 else rosenbrock(x)

    def columns(x):
        return np.array([patchy(point) for point in x.T])

    def run(fun, **more):
        return summary(pydfo.minimize(fun, [-0.5, 1.0], bounds=[(-2, 2)] * 2, method=method, rng=3, max_evaluations=budget, **more))

    serial = run(patchy)
    for workers in (2, 3, 7, 16):
        assert run(patchy, workers=workers) == serial
    assert run(patchy, workers=map) == serial
    assert run(columns, workers=7, vectorized=True) == serial
    with concurrent.futures.ThreadPoolExecutor(3) as executor:
        assert run(patchy, workers=executor) == serial


def test_result_is_identical_with_processes():
    def run(workers):
        return summary(pydfo.minimize(rosenbrock, [-1.2, 1.0], workers=workers, max_evaluations=100))

    with concurrent.futures.ProcessPoolExecutor(2) as executor:
        assert run(executor.map) == run(1)


@pytest.mark.parametrize("plan", ["auto", "serial", 2, 4, 20, "ahead"])
@pytest.mark.parametrize("vectorized", [False, True])
def test_exception_counts_when_path_reaches_it(plan, vectorized):
    path = pydfo.minimize(rosenbrock, [-1.2, 1.0], max_evaluations=60, method="nelder-mead")
    evaluated = {x.tobytes() for x in path.trace.x}

    def trap(x):
        if x.tobytes() not in evaluated:
            raise Trap(x)
        return rosenbrock(x)

    def columns(x):
        return np.array([trap(np.ascontiguousarray(point)) for point in x.T])

    result = pydfo.minimize(
        columns if vectorized else trap, [-1.2, 1.0], workers=4, max_evaluations=60, options={"batch": plan},
        vectorized=vectorized, method="nelder-mead",
    )  # fmt: skip
    assert summary(result) == summary(path)
    with pytest.raises(Trap) as raised:
        pydfo.minimize(
            columns if vectorized else trap,
            [-1.2, 1.0],
            workers=4,
            options={"batch": plan},
            vectorized=vectorized,
            method="nelder-mead",
        )
    assert raised.value.partial_result.x.tobytes() is not None


MASKED = [np.ma.masked, np.ma.array(0.0, mask=True), np.ma.array([0.0], mask=[True]), np.ma.array([0], mask=True)]


@pytest.mark.parametrize("cost", MASKED)
def test_masked_cost_is_a_failure(cost):
    def fun(x):
        return cost if x[0] > 0 else float(x[0] ** 2)

    result = pydfo.minimize(fun, [-1.0], max_evaluations=60, method="nelder-mead")
    assert result.x[0] <= 0 and result.nfail > 0
    optimizer = pydfo.Optimizer("nelder-mead", [-1.0])
    ids, _, _ = optimizer.ask()
    optimizer.tell(ids, [cost, 1.0])
    assert optimizer.best[1] == 1.0


def test_masked_costs_of_vectorized_function_are_failures():
    def columns(x):
        return np.ma.masked_where(x[0] > 0, x[0] ** 2)

    result = pydfo.minimize(columns, [-1.0], vectorized=True, max_evaluations=60, method="nelder-mead")
    assert result.x[0] <= 0 and result.nfail > 0


@pytest.mark.parametrize("cost", [1 + 2j, np.complex128(1), None, "1", np.str_("1"), np.array([1.0, 2.0])])
def test_non_numeric_cost_is_an_error(cost):
    with pytest.raises(TypeError):
        pydfo.minimize(lambda x: cost, [1.0])
    with pytest.raises(TypeError):
        pydfo.minimize(lambda x: [cost] * x.shape[1], [1.0], vectorized=True)


@pytest.mark.parametrize("kind", [float, np.float32, np.float64, np.int64, np.array, lambda v: np.array([v])])
def test_all_number_types_are_costs(kind):
    assert pydfo.minimize(lambda x: kind(abs(round(x[0]))), [3.0]).fun == 0


def test_warm_start_reuses_costs_of_the_same_problem():
    calls = []

    def fun(x):
        calls.append(x.copy())
        return rosenbrock(x)

    def run(problem, start=None):
        calls.clear()
        options = {"problem": problem, "warm_start": start}
        result = pydfo.minimize(fun, [-1.2, 1.0], options=options, max_evaluations=40)
        return result, {x.tobytes() for x in calls}

    first, evaluated = run("rosenbrock")
    assert first.trace.problem == "rosenbrock"
    warm, requested = run("rosenbrock", first)
    assert not evaluated & requested and warm.fun <= first.fun
    for problem, start in [(None, first), ("other", first), ("rosenbrock", (first.trace.x, first.trace.fun))]:
        again, requested = run(problem, start)
        assert first.x.tobytes() in requested and again.n_cached == 0
    _, requested = run("rosenbrock", (first.trace.x, first.trace.fun, "rosenbrock"))
    assert not evaluated & requested


def test_warm_start_with_other_data_reuses_only_points():
    t = np.linspace(0, 2, 21)

    def calibration(k, start=1.0, upper=10.0):
        data = {"time": t, "x": np.exp(-k * t)}
        return pydfo.Calibration(pydfo.example_fmu("dahlquist"), data, ["x"], [pydfo.Parameter("k", start, 0.1, upper)])

    first = calibration(2.0).fit(workers=1)
    fit = calibration(5.0).fit(workers=1, options={"warm_start": first})
    assert fit.success and abs(fit.x[0] - 5.0) < 1e-2 and fit.fun < 1e-6
    # The cost does not depend on bounds and start.
    same = calibration(2.0, 3.0, 9.0).fit("nelder-mead", workers=1, options={"warm_start": first})
    assert same.n_cached > 0


def test_missing_limits_are_unlimited():
    def rastrigin(x):
        return float(np.sum(x * x + 10 - 10 * np.cos(2 * np.pi * x)))

    result = pydfo.fmin(rastrigin, lb=[-5] * 5, ub=[4] * 5, alg="de", max_fevals=None, max_iters=300, x_tol=0, f_tol=0, disp=False, rng=1)
    assert len(result.final_population[0]) < 45 and result.fun < 1e-2


def test_huge_sizes_are_memory_errors():
    with pytest.raises(MemoryError, match="simplex"):
        pydfo.minimize(lambda x: x[0], np.full(3_000_000, 0.5))
    with pytest.raises(MemoryError, match="population"):
        pydfo.minimize(lambda x: x[0], bounds=[(0, 1)] * 1_000_000, method="de", options={"population": 1_000_000})


def test_executor_times_are_recorded_per_call():
    import time

    def uneven(x):
        time.sleep(0.03 if x[0] > 0.5 else 0.001)
        return float(x[0] ** 2)

    with concurrent.futures.ThreadPoolExecutor(2) as executor:
        options = {"initial_simplex": [[0.4], [0.6]]}
        result = pydfo.minimize(uneven, [0.4], workers=executor, max_evaluations=2, options=options)
    assert result.trace.seconds[0] < 0.02 < result.trace.seconds[1]


@pytest.mark.parametrize(
    ("isolation", "message"),
    [
        ("none", "a result of 10000001 rows and 23 columns requires 1840 MB of memory"),
        ("process", "the received part of the result of the worker process"),
    ],
)
def test_result_without_memory_is_an_error(isolation, message):
    """Runs in a process that may use 1 GiB more; 1e7 rows of 23 variables require 1.8 GB."""
    pytest.importorskip("resource")
    program = f"""
import resource, pydfo
model = pydfo.FMUModel(pydfo.example_fmu("furuta"))
model.simulate(0, 1e-3, ncp=1)
with open("/proc/self/statm") as statm:
    size = int(statm.read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (size + (1 << 30),) * 2)
try:
    model.simulate(0, 1, ncp=10**7, output="all", isolation={isolation!r})
except MemoryError as e:
    print(e)
"""
    if not Path("/proc/self/statm").exists():
        pytest.skip("no way to know the size of a process")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(message), done.stdout
