"""Objectives that can be sent to other processes, and every method with a problem that it can solve."""

from __future__ import annotations

import os

import numpy as np

METHODS = ["nelder-mead", "barrier", "de", "de-classic", "ga", "quadratic-model", "cma-es", "pattern-search"]

#: What a run over Rosenbrock's function needs, the same for every method.
RUN = {"x0": [-1.2, 1.0], "bounds": [(-2.0, 2.0), (-2.0, 2.0)], "rng": 7}


def rosenbrock(x):
    return 100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2


def columns(x):
    """Rosenbrock's function of points in columns; of one point it has the same bits."""
    return np.array([rosenbrock(point) for point in x.T])


def fails_sometimes(x):
    """Raises where the first coordinate is large."""
    if x[0] > 0.5:
        raise ValueError("too large")
    return rosenbrock(x)


class CannotBeSent(Exception):
    """Has no way through a pickle."""

    def __init__(self, first, second):
        super().__init__(f"{first} and {second}")


def raises_what_cannot_be_sent(x):
    raise CannotBeSent(1, 2)


def process_id(x):
    return float(os.getpid())


def shifted(x, by, factor):
    return factor * rosenbrock(x - by)


def timeless(result):
    """All of a run's path but what the clock says."""
    trace, path = result.trace, slice(result.nfev)
    return (
        result.x.tobytes(), result.fun, result.nit, result.nfev, result.n_cached, result.message.partition("; continued from ")[0],
        trace.x[path].tobytes(), trace.fun[path].tobytes(), trace.above[path].tobytes(), trace.used[path].tobytes(),
        trace.id[path].tobytes(), trace.batch[path].tobytes(),
        tuple(sorted((k, text) for k, text in trace.messages.items() if k < result.nfev)),
    )  # fmt: skip
