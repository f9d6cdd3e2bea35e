"""Picklable objectives, and a solvable problem for every method."""

from __future__ import annotations

import os

import numpy as np

METHODS = ["nelder-mead", "barrier", "de", "de-classic", "ga", "quadratic-model", "cma-es", "pattern-search"]

#: Arguments of a run over Rosenbrock's function, for every method.
RUN = {"x0": [-1.2, 1.0], "bounds": [(-2.0, 2.0), (-2.0, 2.0)], "rng": 7}


def rosenbrock(x):
    return 100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2


def columns(x):
    """Returns Rosenbrock's function of points in columns, bit-for-bit equal to single points."""
    return np.array([rosenbrock(point) for point in x.T])


def fails_sometimes(x):
    """Raises an exception if the first coordinate is large."""
    if x[0] > 0.5:
        raise ValueError("too large")
    return rosenbrock(x)


class CannotBeSent(Exception):
    """An exception that cannot be pickled."""

    def __init__(self, first, second):
        super().__init__(f"{first} and {second}")


def raises_what_cannot_be_sent(x):
    raise CannotBeSent(1, 2)


def process_id(x):
    return float(os.getpid())


def shifted(x, by, factor):
    return factor * rosenbrock(x - by)


def timeless(result):
    """Returns the path of a run without times."""
    trace, path = result.trace, slice(result.nfev)
    return (
        result.x.tobytes(), result.fun, result.nit, result.nfev, result.n_cached, result.message.partition("; continued from ")[0],
        trace.x[path].tobytes(), trace.fun[path].tobytes(), trace.above[path].tobytes(), trace.used[path].tobytes(),
        trace.id[path].tobytes(), trace.batch[path].tobytes(),
        tuple(sorted((k, text) for k, text in trace.messages.items() if k < result.nfev)),
    )  # fmt: skip
