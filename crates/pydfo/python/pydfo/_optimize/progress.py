"""Progress of a run after each iteration, and the lines printed from it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from .._args import text as _text

FloatArray = npt.NDArray[np.float64]

#: Names in results, as in SciPy, of fields in the native records of runs.
_NAMES = {
    "n_iterations": "nit",
    "n_evaluations": "nfev",
    "n_failed": "nfail",
    "seconds": "solve_time",
    "jacobian": "jac",
    "active": "active_mask",
    "recent": "_recent",
}


def points_of(front: dict[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Returns the points of a front (k, n) and their criteria (k, m) from a record of the native code."""
    both = (np.array([point[what] for point in front["points"]], dtype=np.float64) for what in ("x", "criteria"))
    x, criteria = (array if array.size else np.empty((0, 0)) for array in both)
    return x, criteria


def named(record: dict[str, Any], of: type) -> dict[str, Any]:
    """Returns the fields of a result class from a record of the native code."""
    values = {_NAMES.get(name, name): value for name, value in record.items()}
    values.update(record["tests"] or {"x_size": None, "f_spread": None})
    for name in ("final_simplex", "final_population"):
        if (simplex := record[name]) is not None:
            values[name] = np.array(simplex["vertices"]), np.array(simplex["costs"], dtype=np.float64)
    return {field.name: values[field.name] for field in fields(of) if field.name in values}


@dataclass(kw_only=True, eq=False, repr=False)
class Progress:
    """The state of a run after an iteration; iteration 0 is the evaluation of the starting points.

    Attributes
    ----------
    x : ndarray, shape (n,)
        The best point so far, in the user's units.
    fun : float
        Cost at the best point.
    nit, nfev, nfail : int
        Complete iterations, evaluations of the path, and failed evaluations of the path so far.
    n_speculative : int
        Further calls of the objective so far, made speculatively.
    operation : str
        Operation of the iteration: "initial", "reflection", "expansion", "outside contraction", "inside contraction",
        "shrink", "parallel moves", "restart" or "generation".
    x_size, f_spread : float or None
        Values of the two tests: extent of the simplex, and spread of the costs at its vertices. None before the first
        iteration. The spread is None while a vertex is a failed point.
    final_simplex : tuple of ndarray or None
        Current simplex: vertices (n + 1, n) and their costs (n + 1,), best first.
    final_population : tuple of ndarray or None
        Current population: members (m, n) and their costs (m,), best first.
    front : tuple of ndarray or None
        Points of the current Pareto front (k, n) and their criteria (k, m), for `pareto`.
    solve_time : float
        Wall-clock time since the start, in s.
    """

    x: FloatArray
    fun: float
    nit: int
    nfev: int
    nfail: int
    n_speculative: int
    solve_time: float
    operation: str
    x_size: float | None
    f_spread: float | None
    final_simplex: tuple[FloatArray, FloatArray] | None
    final_population: tuple[FloatArray, FloatArray] | None
    _recent: list[tuple[FloatArray, str, bool]]
    front: tuple[FloatArray, FloatArray] | None = None

    @classmethod
    def _of(cls, record: dict[str, Any]) -> Progress:
        """Creates the progress from a record of the native code."""
        front = record["front"] and points_of(record["front"])
        return cls(**named({**record, "front": front}, cls))

    def __getitem__(self, key: str) -> Any:
        return vars(self)[key]

    def __repr__(self) -> str:
        return f"<Progress: iteration {self.nit}, {self.nfev} evaluations, fun {self.fun!r}, {self.operation}>"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3e}"


class Printer:
    """Prints a line per iteration, as the paper's tool does."""

    def __init__(self, names: list[str] | None = None) -> None:
        self._names = names and [_text.line(name) for name in names]

    def __call__(self, progress: Progress) -> None:
        """Prints the line of one iteration, preceded by a header at the first call."""
        if progress.nit == 0:
            print(f"{'iter':>5} {'evals':>6} {'best cost':>15} {'x size':>10} {'f spread':>10}  operation", flush=True)
        print(
            f"{progress.nit:>5} {progress.nfev:>6} {progress.fun:>15.8e} {_number(progress.x_size):>10} "
            f"{_number(progress.f_spread):>10}  {progress.operation}",
            flush=True,
        )

    def end(self, message: str, x: FloatArray, fun: float, nit: int, nfev: int, seconds: float) -> None:
        """Prints how the run ended."""
        print(message)
        if self._names is None:
            print(f"x = {np.array2string(np.asarray(x), separator=', ', prefix='x = ')}")
        else:
            for name, value in zip(self._names, x):
                print(f"{name} = {value:.8g}")
        print(f"f = {fun:.10g} after {nit} iterations, {nfev} evaluations, {seconds:.3g} s", flush=True)
