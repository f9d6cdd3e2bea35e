"""Concurrency without clocks: an objective waits until other calls are running."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from conftest import rosenbrock

from pydfo import fmin

QUIET = {"disp": False}
PATIENCE = 10.0


@pytest.mark.parametrize("n", [2, 5])
def test_initial_simplex_is_evaluated_at_once(n):
    barrier = threading.Barrier(n + 1)

    def func(x):
        if not barrier.broken and len(seen) <= n:
            seen.append(threading.get_ident())
            barrier.wait(PATIENCE)
        return float(np.sum(x**2))

    seen = []
    res = fmin(func, np.ones(n), nbr_cores=n + 1, max_iters=0, **QUIET)
    assert res.nfev == n + 1 and len(set(seen)) == n + 1


def test_four_points_of_a_round_are_evaluated_at_once():
    count = 0
    lock = threading.Lock()
    barrier = threading.Barrier(4)

    def func(x):
        nonlocal count
        with lock:
            count += 1
            number = count
        # Shorter evaluations may not be distributed if distribution has just taken long, as on a busy machine. The
        # three vertices come first. Rounds of four points follow: the required point and the most probable
        # alternatives.
        time.sleep(0.1)
        if number > 3:
            barrier.wait(PATIENCE)
        return rosenbrock(x)

    res = fmin(func, [-1.2, 1.0], nbr_cores=4, max_iters=5, batch=4, **QUIET)
    assert res.batch == "4" and res.nit == 5


@pytest.mark.parametrize("n", [3])
def test_four_workers_start_four_of_the_vertices_together(n):
    barrier = threading.Barrier(4)

    def func(x):
        time.sleep(0.1)
        barrier.wait(PATIENCE)
        return float(np.sum(x**2))

    assert fmin(func, np.ones(n), nbr_cores=4, max_iters=2, batch=4, **QUIET).nit == 2


def test_single_worker_is_the_calling_thread():
    here = threading.get_ident()
    threads = set()

    def func(x):
        threads.add(threading.get_ident())
        return rosenbrock(x)

    fmin(func, [-1.2, 1.0], max_iters=3, **QUIET)
    assert threads == {here}
    threads.clear()
    fmin(func, [-1.2, 1.0], max_iters=3, nbr_cores=2, **QUIET)
    assert here not in threads


@pytest.mark.parametrize("workers", [1, 3])
def test_callbacks_run_on_the_calling_thread(workers):
    threads = set()
    fmin(
        rosenbrock,
        [-1.2, 1.0],
        nbr_cores=workers,
        max_iters=4,
        callback=lambda p: threads.add(threading.get_ident()),
        **QUIET,
    )
    assert threads == {threading.get_ident()}


def test_runs_may_be_nested_and_concurrent():
    def outer(x):
        inner = fmin(lambda y: (y[0] - x[0]) ** 2 + x[0] ** 2, [0.0], nbr_cores=2, **QUIET)
        return inner.fun

    res = fmin(outer, [1.0], nbr_cores=2, x_tol=1e-3, **QUIET)
    assert abs(res.x[0]) < 0.05
    results = [None] * 4
    reference = fmin(rosenbrock, [-1.2, 1.0], **QUIET)

    def run(i):
        results[i] = fmin(rosenbrock, [-1.2, 1.0], nbr_cores=1 + i % 2, **QUIET)

    threads = [threading.Thread(target=run, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30.0)
    assert all(r.x.tobytes() == reference.x.tobytes() for r in results)


def test_other_threads_run_while_workers_wait():
    # The objective can return only if another Python thread gets the lock in the meantime.
    free = threading.Event()
    started = threading.Event()

    def helper():
        started.wait(PATIENCE)
        free.set()

    thread = threading.Thread(target=helper)
    thread.start()

    def func(x):
        started.set()
        assert free.wait(PATIENCE)
        return rosenbrock(x)

    fmin(func, [-1.2, 1.0], nbr_cores=2, max_iters=1, **QUIET)
    thread.join(PATIENCE)
