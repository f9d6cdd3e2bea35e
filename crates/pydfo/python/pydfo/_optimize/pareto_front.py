"""The Pareto front of several criteria."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import optional_libraries as _optional_libraries
from .._args import text as _text
from .._args import values as _values
from . import progress as _progress
from .result import OptimizeResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = npt.NDArray[np.float64]

#: Maximum number of points that the printed result shows.
MOST_ROWS = 10


@dataclass(kw_only=True, eq=False, repr=False)
class ParetoFront(OptimizeResult):
    """The result of `pareto`: feasible points that do not dominate each other, sorted by the first criterion.

    A point dominates another point if none of its criteria is larger and at least one is smaller. The other fields
    are as in `OptimizeResult`.

    Attributes
    ----------
    x : ndarray, shape (k, n)
        The points of the front, in the user's units and order. Empty if no evaluated point is feasible.
    criteria, fun : ndarray, shape (k, m)
        Their criteria.
    names : tuple of str
        Names of the criteria.
    compromise : int or None
        Index of the point nearest to the ideal point, which has the smallest value of each criterion on the front.
        Each criterion is scaled by its range on the front (Zeleny, Compromise programming, 1973). None if the front
        is empty.
    success : bool
        True if the front is not empty and the run ended at a limit or by itself. There is no test of convergence.
    constr_violation : float
        Largest violation of a nonlinear constraint on the front, at most ``constraint_tol``. If the front is empty,
        the smallest violation found.
    trace : Trace
        Every evaluation. Its costs are the sums of the squares of the criteria, which the search does not use.
    """

    criteria: FloatArray
    names: tuple[str, ...]
    compromise: int | None

    @classmethod
    def _of(cls, record: dict[str, Any]) -> OptimizeResult:
        points, nearest = record["front"]["points"], record["x"]
        x, criteria = _progress.points_of(record["front"])
        own: dict[str, Any] = {
            "x": x,
            "fun": criteria,
            "criteria": criteria,
            "names": tuple(f"f[{i}]" for i in range(criteria.shape[1])),
            "compromise": int(np.flatnonzero((x == nearest).all(axis=1))[0]) if points else None,
        }
        if points:
            own["constr_violation"] = max(point["constr_violation"] for point in points)
        return super()._of({**record, **own})

    def hypervolume(self, reference: npt.ArrayLike) -> float:
        """Returns the volume that the front dominates, up to a reference point with one value per criterion.

        Points that are not better than the reference point in every criterion do not contribute. The volume measures
        convergence and spread at once (Zitzler and Thiele, IEEE Trans. Evol. Comput. 3, 1999). It is computed by
        slices (While et al., IEEE Trans. Evol. Comput. 10, 2006).
        """
        limits = _values.vector("reference", reference)
        volume = _core.hypervolume(self.criteria.tolist(), limits.tolist())
        if volume is None:
            raise ValueError(f"reference has {len(limits)} values; expected {self.criteria.shape[1]}, one per criterion")
        return volume

    def table(self, rows: int | None = None) -> str:
        """Returns the criteria and the parameters of the points as text, one line per point.

        `rows` limits the number of points, which are then evenly spaced; None shows all.
        """
        n = len(self.x)
        shown = np.arange(n) if rows is None or n <= rows else np.unique(np.linspace(0, n - 1, rows).round().astype(int))
        head = [*map(_text.line, self.names), *(f"x[{i}]" for i in range(self.x.shape[1]))]
        body = [[f"{value:.6g}" for value in (*self.criteria[k], *self.x[k])] for k in shown]
        widths = [max(map(len, column)) for column in zip(head, *body)]
        return "\n".join("  ".join(text.rjust(width) for text, width in zip(line, widths)) for line in (head, *body))

    def to_dataframe(self) -> Any:
        """Returns the front as a pandas.DataFrame, one row per point. Needs pandas."""
        columns = {name: self.criteria[:, i] for i, name in enumerate(self.names)}
        columns |= {f"x[{i}]": self.x[:, i] for i in range(self.x.shape[1])}
        return _optional_libraries.pandas().DataFrame(columns)

    def plot(self) -> Figure:
        """Draws the front, one diagram per pair of criteria, with the compromise. Needs matplotlib."""
        from .. import _plot

        return _plot.front(self)

    def __repr__(self) -> str:
        failed = f" ({self.nfail} failed)" if self.nfail else ""
        lines = [
            ("message", _text.line(self.message)),
            ("success", f"{self.success} (status {self.status}, {self.termination})"),
            ("points", str(len(self.x))),
            ("nit", str(self.nit)),
            ("nfev", f"{self.nfev}{failed}"),
            ("solve_time", f"{self.solve_time:.3g} s"),
        ]
        text = "\n".join(f"{name:>10}: {value}" for name, value in lines)
        return f"{text}\n{self.table(MOST_ROWS)}" if len(self.x) else text


def check_names(names: Sequence[str], criteria: FloatArray) -> None:
    """Raises ValueError if there are criteria and their number is not the number of names."""
    if len(criteria) and len(names) != criteria.shape[1]:
        raise ValueError(f"names has {len(names)} entries for {criteria.shape[1]} criteria")
