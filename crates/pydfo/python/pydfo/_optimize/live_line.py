"""The live line with the progress of a fit in a terminal or a notebook."""

from __future__ import annotations

import importlib
import shutil
import sys
import time
from collections.abc import Sequence
from typing import Any, SupportsFloat

from .._args import text as _text
from .._args.values import number
from .progress import Progress

#: Delay in s before a fit is shown without a request.
DELAY = 2.0

#: Name of the native phase in which evaluations are counted. The line shows the names of other phases.
SEARCH = "searching"

#: Maximum number of parameters shown.
MOST_PARAMETERS = 3

#: Minimum time between two updates of the line in s.
INTERVAL = 0.2


def is_notebook() -> bool:
    """Returns True in the kernel of a notebook."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return type(shell).__name__ == "ZMQInteractiveShell"


def is_watched() -> bool:
    """Returns True if standard error is shown immediately: in a terminal or a notebook."""
    try:
        return sys.stderr.isatty() or is_notebook()
    except (AttributeError, ValueError):
        return False


class _Plain:
    """Draws the line with plain terminal output."""

    def __init__(self) -> None:
        self._width = 0

    def show(self, text: str) -> None:
        text = text[: max(shutil.get_terminal_size().columns - 1, 20)]
        sys.stderr.write("\r" + text.ljust(self._width))
        sys.stderr.flush()
        self._width = len(text)

    def close(self) -> None:
        sys.stderr.write("\r" + " " * self._width + "\r")
        sys.stderr.flush()


class _Rich:
    """Draws the line with rich, which shares the terminal with the output of a callback."""

    def __init__(self, rich: Any) -> None:
        self._text = importlib.import_module("rich.text").Text
        self._status = rich.Console(stderr=True).status("")
        self._status.start()

    def show(self, text: str) -> None:
        self._status.update(self._text(text, overflow="ellipsis", no_wrap=True))

    def close(self) -> None:
        self._status.stop()


def _display() -> _Plain | _Rich:
    try:
        return _Rich(importlib.import_module("rich.console"))
    except ImportError:
        return _Plain()


class LiveLine:
    """Shows evaluations, best cost, best parameters, time and the remaining limits, on the calling thread.

    Parameters
    ----------
    names : sequence of str
        Names of the parameters.
    delay : float
        Delay in s before the line appears.
    max_evaluations, max_iterations, max_time : optional
        Limits of the fit.
    """

    def __init__(
        self,
        names: Sequence[str],
        delay: float,
        max_evaluations: SupportsFloat | None,
        max_iterations: SupportsFloat | None,
        max_time: SupportsFloat | None,
    ) -> None:
        self._names = [_text.line(name) for name in names]
        self._start = time.monotonic()
        self._due = self._start + delay
        limits = {"max_evaluations": max_evaluations, "max_iterations": max_iterations, "max_time": max_time}
        self._limits = {name: number(name, limit) for name, limit in limits.items() if limit is not None}
        self._progress: Progress | None = None
        self._phase = SEARCH
        self._display: _Plain | _Rich | None = None

    def __call__(self, progress: Progress) -> None:
        """Stores the progress after an iteration."""
        self._progress = progress
        self.tick(SEARCH)

    def tick(self, phase: str) -> None:
        """Redraws the line if it is due; `phase` is the current phase of the fit."""
        self._phase = phase
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + INTERVAL
        try:
            self._display = self._display or _display()
            self._display.show(self.text(now - self._start))
        except (OSError, ValueError):
            # Standard error has been closed, so the line cannot be shown.
            self._due = float("inf")

    def text(self, seconds: float) -> str:
        """Returns the text of the line after the given time in s."""
        phase = "first simulations" if self._phase == SEARCH else self._phase
        if (progress := self._progress) is None:
            return f"fit: {phase}, {seconds:.0f} s"
        values = [f"{name} = {value:.4g}" for name, value in zip(self._names, progress.x)][:MOST_PARAMETERS]
        if len(self._names) > MOST_PARAMETERS:
            values.append("...")
        left = [
            f"{max(limit - done, 0.0):.0f} {unit} left"
            for name, done, unit in (
                ("max_evaluations", progress.nfev, "evaluations"),
                ("max_iterations", progress.nit, "iterations"),
                ("max_time", seconds, "s"),
            )
            if (limit := self._limits.get(name)) is not None
        ]
        done = [f"fit: {progress.nfev} evaluations", *([] if self._phase == SEARCH else [self._phase])]
        return ", ".join([*done, f"best cost {progress.fun:.6g}", *values, f"{seconds:.0f} s", *left])

    def close(self) -> None:
        """Removes the line."""
        if self._display is not None:
            try:
                self._display.close()
            except (OSError, ValueError):
                pass


class StepLine:
    """Shows the number of completed steps of a long computation, after a delay in s."""

    def __init__(self, label: str, n_steps: int, delay: float) -> None:
        self._label, self._n_steps = label, n_steps
        self._display: _Plain | _Rich | None = None
        self._next = time.monotonic() + delay

    def __call__(self, step: int) -> None:
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + INTERVAL
        if self._display is None:
            self._display = _display()
        self._display.show(f"{self._label} {step} of {self._n_steps}")

    def close(self) -> None:
        """Removes the line."""
        if self._display is not None:
            self._display.close()
