"""A test problem of the benchmarks, and the record of a run of a solver on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

Array = np.ndarray


class Enough(Exception):
    """The budget is used up."""


def sum_of_squares(r: Array) -> float:
    """Returns the cost of residuals; infinite if it is not a number."""
    with np.errstate(all="ignore"):
        cost = float(r @ r)
    return cost if np.isfinite(cost) else np.inf


@dataclass(frozen=True)
class Problem:
    """A function with a start, a box (infinite if there is none) and the best known value.

    `residuals` returns the vector whose sum of squares is the cost; `cost` is used if there are no residuals. The
    values seen by a solver may be disturbed by noise: `disturb(values, rng)` is applied to residuals or cost, and
    `assessed` is the undisturbed cost. Problems with even numbers are for tuning constants, odd ones for assessment.
    """

    name: str
    number: int
    x0: Array
    lower: Array
    upper: Array
    best: float
    residuals: Callable[[Array], Array] | None = None
    cost: Callable[[Array], float] | None = None
    disturb: Callable[[Array, np.random.Generator, Array], Array] | None = None
    fails: Callable[[Array], bool] | None = None
    has_start: bool = True

    @property
    def n(self) -> int:
        """Number of parameters."""
        return len(self.x0)

    @property
    def is_boxed(self) -> bool:
        """True if any bound is finite."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Returns the box as pairs."""
        return list(zip(self.lower.tolist(), self.upper.tolist()))

    def assessed(self, x: Array) -> float:
        """Returns the cost without noise."""
        if self.cost is not None:
            return self.cost(x)
        assert self.residuals is not None
        return sum_of_squares(self.residuals(x))


@dataclass
class Record:
    """The evaluations of a run: undisturbed costs in order, and the sizes of the requested batches.

    Costs are infinite for points outside the box and for failures."""

    problem: Problem
    budget: int
    seed: int
    costs: list[float] = field(default_factory=list)
    batches: list[int] = field(default_factory=list)
    error: str | None = None

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng([self.seed, self.problem.number])

    def _seen(self, x: Array) -> Array | None:
        """Counts an evaluation and returns its undisturbed residuals, or the cost as an array; None if it failed."""
        if len(self.costs) >= self.budget:
            raise Enough
        p = self.problem
        inside = bool(np.all(x >= p.lower) and np.all(x <= p.upper))
        if p.fails is not None and p.fails(x):
            self.costs.append(np.inf)
            return None
        with np.errstate(all="ignore"):
            values = np.array([p.cost(x)]) if p.cost is not None else p.residuals(x)  # type: ignore[misc]
        cost = float(values[0]) if p.cost is not None else sum_of_squares(values)
        self.costs.append(cost if inside and np.isfinite(cost) else np.inf)
        return values if p.disturb is None else p.disturb(values, self.rng, x)

    def f(self, x: Array) -> float:
        """Returns the cost as seen by a solver: one evaluation, alone in its batch unless `batch` is open."""
        values = self._seen(np.asarray(x, dtype=float))
        self._count()
        if values is None:
            return np.nan
        return float(values[0]) if self.problem.cost is not None else sum_of_squares(values)

    def r(self, x: Array) -> Array:
        """Returns the residuals as seen by a solver."""
        assert self.problem.residuals is not None
        values = self._seen(np.asarray(x, dtype=float))
        self._count()
        return np.full(len(self.problem.residuals(self.problem.x0)), np.nan) if values is None else values

    def _count(self) -> None:
        if not self._open:
            self.batches.append(1)

    _open = False

    def batch(self, size: int) -> None:
        """Groups the next `size` evaluations into one batch."""
        self._open = True
        self.batches.append(size)

    def rounds(self, workers: float) -> Array:
        """Returns the end of each evaluation on a machine with this number of workers and one unit of time per
        evaluation."""
        ends, clock = [], 0.0
        for size in self.batches:
            ends += [clock + k // workers + 1.0 for k in range(size)]
            clock = ends[-1]
        return np.array(ends[: len(self.costs)])
