"""Figure of the simplex or the population of a run in the plane of two parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .._optimize.progress import Progress
from .style import pyplot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .._optimize.result import OptimizeResult

FloatArray = npt.NDArray[np.float64]


def _is_live(figure: Figure) -> bool:
    """Returns True if the figure is shown in a window."""
    return getattr(figure.canvas, "required_interactive_framework", None) is not None


class SimplexWalk:
    """The path of the simplex in the plane of two parameters, on contours of the cost.

    The contours use the points evaluated by the run and require no further evaluations.
    """

    def __init__(self, free: npt.NDArray[np.bool_]) -> None:
        self._axes = np.flatnonzero(free)
        if len(self._axes) != 2:
            raise ValueError(
                f"plot=True requires two free parameters, got {len(self._axes)}; "
                "plot_conv=True supports any number"
            )
        self._figure: Figure
        self._plane: Axes
        self._figure, self._plane = pyplot().subplots(layout="constrained")
        self._plane.set_xlabel(f"x[{self._axes[0]}]")
        self._plane.set_ylabel(f"x[{self._axes[1]}]")
        self._simplices: list[FloatArray] = []
        self._closed = True

    def __call__(self, progress: Progress) -> None:
        """Stores the simplex or the population of one iteration, and draws it if the figure is shown in a window."""
        shape = progress.final_simplex or progress.final_population
        if shape is None:
            return
        self._closed = progress.final_simplex is not None
        self._simplices.append(shape[0][:, self._axes])
        if _is_live(self._figure):
            self._draw(self._simplices[-1], "tab:blue", 0.8)
            self._plane.set_title(f"iteration {progress.nit}, cost {progress.fun:.6g}")
            pyplot().pause(1e-3)

    def _draw(self, simplex: FloatArray, colour: Any, width: float) -> None:
        if self._closed:
            closed = np.vstack((simplex, simplex[:1]))
            self._plane.plot(closed[:, 0], closed[:, 1], "-", color=colour, linewidth=width, zorder=2)
        else:
            self._plane.plot(simplex[:, 0], simplex[:, 1], ".", color=colour, markersize=4.0 * width, zorder=2)

    def finish(self, result: OptimizeResult) -> Figure:
        """Returns the figure of the whole path on its contours, with the result marked."""
        plt = pyplot()
        self._plane.clear()
        self._contours(result)
        colours = plt.get_cmap("viridis")(np.linspace(0.0, 0.9, max(len(self._simplices), 1)))
        for simplex, colour in zip(self._simplices, colours):
            self._draw(simplex, colour, 1.0)
        best = np.asarray(result.x)[self._axes]
        self._plane.plot(*best, "r*", markersize=12, label=f"best: cost {result.fun:.6g}", zorder=3)
        self._plane.set_xlabel(f"x[{self._axes[0]}]")
        self._plane.set_ylabel(f"x[{self._axes[1]}]")
        self._plane.set_title(f"{result.method}: {result.nit} iterations, {result.nfev} evaluations")
        self._plane.legend(loc="best")
        return self._figure

    def _contours(self, result: OptimizeResult) -> None:
        trace = result.trace
        if trace is None:
            return
        good = np.isfinite(trace.fun)
        points, costs = trace.x[good][:, self._axes], trace.fun[good]
        points, first = np.unique(points, axis=0, return_index=True)
        # Costs span orders of magnitude between start and end. Ranks of the logarithm show both.
        height = np.log10(costs[first] - costs.min() + 1e-3 * max(float(np.ptp(costs)), 1e-300))
        if len(points) < 3 or np.linalg.matrix_rank(points - points[0]) < 2:
            return
        shading = self._plane.tricontourf(points[:, 0], points[:, 1], height, levels=20, cmap="Greys", zorder=1)
        self._figure.colorbar(shading, ax=self._plane, label="log10 of the cost above the best")
