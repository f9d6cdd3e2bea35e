"""Fixtures and helpers shared by the tests."""

from __future__ import annotations

import os
import signal
import sys

import numpy as np
import pytest


def rosenbrock(x):
    """Returns Rosenbrock's function, with the minimum 0 at (1, 1)."""
    return 100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2


def press_ctrl_c() -> None:
    """Sends the signal of Ctrl-C to this process."""
    if sys.platform == "win32":
        # `os.kill` would end the process.
        signal.raise_signal(signal.SIGINT)
    else:
        os.kill(os.getpid(), signal.SIGINT)


class Recorder:
    """An objective that records every point and value."""

    def __init__(self, function):
        self.function = function
        self.points = []
        self.values = []

    def __call__(self, x):
        self.points.append(x)
        value = self.function(x)
        self.values.append(value)
        return value

    @property
    def best(self):
        finite = [v for v in self.values if np.isfinite(v)]
        return min(finite) if finite else None


@pytest.fixture
def recorder():
    return Recorder(rosenbrock)


def pytest_configure() -> None:
    """Restores Python's handling of Ctrl-C, because a shell that runs the tests in the background ignores it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
