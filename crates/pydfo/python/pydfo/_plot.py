"""Pictures; matplotlib is imported only when one is asked for."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ._errors import SimulationError
from ._progress import Progress

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ._calibration import Calibration
    from ._fit import Fit
    from ._result import OptimizeResult

FloatArray = npt.NDArray[np.float64]

#: Points of a drawn response.
CURVE_POINTS = 2001

_log = logging.getLogger("pydfo")


def pyplot() -> Any:
    """``matplotlib.pyplot``, or an error with the command that installs it."""
    try:
        import matplotlib.pyplot as plt
    except ImportError as e:
        raise ImportError("plotting needs matplotlib: pip install matplotlib") from e
    return plt


def _is_live(figure: Figure) -> bool:
    """Whether the figure is shown in a window."""
    return getattr(figure.canvas, "required_interactive_framework", None) is not None


class SimplexWalk:
    """The simplex walking over the plane of two parameters, on contours of the cost.

    The contours are drawn from the points that were evaluated anyway: no evaluation is spent on them.
    """

    def __init__(self, free: npt.NDArray[np.bool_]) -> None:
        self._axes = np.flatnonzero(free)
        if len(self._axes) != 2:
            raise ValueError(
                f"plot=True draws the plane of two parameters, but {len(self._axes)} are free; "
                "plot_conv=True works for any number"
            )
        self._figure: Figure
        self._plane: Axes
        self._figure, self._plane = pyplot().subplots(layout="constrained")
        self._plane.set_xlabel(f"x[{self._axes[0]}]")
        self._plane.set_ylabel(f"x[{self._axes[1]}]")
        self._simplices: list[FloatArray] = []
        self._closed = True

    def __call__(self, progress: Progress) -> None:
        """Takes in the simplex or the population of one iteration, and draws it if the figure is shown in a window."""
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
        """The whole walk on its contours, with the result marked."""
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
        # Costs differ by orders of magnitude between start and end: ranks of the logarithm show both.
        height = np.log10(costs[first] - costs.min() + 1e-3 * max(float(np.ptp(costs)), 1e-300))
        if len(points) < 3 or np.linalg.matrix_rank(points - points[0]) < 2:
            return
        shading = self._plane.tricontourf(points[:, 0], points[:, 1], height, levels=20, cmap="Greys", zorder=1)
        self._figure.colorbar(shading, ax=self._plane, label="log10 of the cost above the best")


def convergence(result: OptimizeResult) -> Figure:
    """Each cost and the best one over the evaluations; below, the best point, each parameter in units of the range that
    the run went through."""
    plt = pyplot()
    figure: Figure
    figure, (costs, points) = plt.subplots(2, 1, sharex=True, height_ratios=[3, 2], figsize=(6.4, 6.4), layout="constrained")
    trace = result.trace
    if trace is not None and len(trace) > 0:
        count = trace.n_dropped + np.arange(1, len(trace) + 1)
        best = trace.running_best()
        positive = bool(np.all(trace.fun[np.isfinite(trace.fun)] > 0.0))
        costs.plot(count, trace.fun, ".", color="0.6", markersize=4, label="evaluated")
        costs.step(count, np.where(np.isfinite(best), best, np.nan), where="post", label="best so far")
        for k in trace.messages:
            costs.axvline(count[k], color="tab:red", linewidth=0.5, alpha=0.5)
        costs.set_yscale("log" if positive else "symlog")
        # where the best changed, and which point it was until the next change
        better = np.flatnonzero(np.diff(best, prepend=np.inf) < 0.0)
        low, width = trace.x.min(axis=0), np.ptp(trace.x, axis=0)
        if len(better) > 0:
            rows = better[np.maximum(np.searchsorted(better, np.arange(len(trace)), side="right") - 1, 0)]
            for i in np.flatnonzero(width > 0.0):
                points.step(count, (trace.x[rows, i] - low[i]) / width[i], where="post", linewidth=1.0, label=f"x[{i}]")
    costs.set_ylabel("cost")
    costs.set_title(f"{result.method}: {result.termination} at {result.fun:.6g}")
    costs.legend(loc="best")
    points.set_xlabel("evaluations")
    points.set_ylabel("best point, scaled")
    if 0 < len(points.lines) <= 10:
        points.legend(loc="best", fontsize="small")
    return figure


def fit(fit: Fit, calibration: Calibration) -> Figure:
    """Measurements, the response at the start and the fitted one per output; below, the residuals of both."""
    plt = pyplot()
    native = calibration._native
    titles = native.experiments() if len(native.experiments()) > 1 else [""]
    columns = [
        (k, name, time[~np.isnan(values)], values[~np.isnan(values)])
        for k, (time, outputs) in enumerate(native.measurements())
        for name, values in outputs
    ]
    figure: Figure
    figure, axes = plt.subplots(
        2, len(columns), sharex="col", squeeze=False, figsize=(6.4 * len(columns), 6.0), height_ratios=[2, 1],
        layout="constrained",
    )
    starts = [_response(calibration, fit.start, k) for k in range(len(titles))]
    fits = [_response(calibration, fit.x, k) for k in range(len(titles))]
    for column, (k, name, time, values) in enumerate(columns):
        upper, lower = axes[0, column], axes[1, column]
        upper.plot(time, values, ".", color="0.6", markersize=3, label="measured")
        for response, colour, style, label in ((starts[k], "tab:orange", "--", "start"), (fits[k], "tab:blue", "-", "fitted")):
            if response is None:
                continue
            curve, at_measured = response
            upper.plot(curve["time"], curve[name], style, color=colour, linewidth=1.0, label=label)
            # a row for every measured time that counts; not every output was measured at each of them
            rows = np.flatnonzero(np.isin(at_measured["time"], time))
            times = at_measured["time"][rows]
            residual = at_measured[name][rows] - values[np.searchsorted(time, times)]
            rms = float(np.sqrt(np.mean(residual**2)))
            lower.plot(times, residual, style, color=colour, linewidth=0.8, label=f"{label}: RMS {rms:.4g}")
        upper.set_title(titles[k])
        upper.set_ylabel(name)
        upper.legend(loc="best", fontsize="small")
        lower.axhline(0.0, color="0.3", linewidth=0.5)
        lower.set_ylabel("simulated - measured")
        lower.set_xlabel("time [s]")
        lower.legend(loc="best", fontsize="small")
    title = ", ".join(f"{name} = {value:.5g}" for name, value in fit.parameters.items())
    figure.suptitle(title, fontsize="medium")
    return figure


def _response(calibration: Calibration, x: FloatArray, k: int) -> tuple[dict[str, FloatArray], dict[str, FloatArray]] | None:
    """A smooth curve of experiment `k` and the values at its measured times; None if the simulation fails at `x`."""
    simulate = calibration._native.simulate
    try:
        at_measured = simulate(x.tolist(), experiment=k)[0]
        time = at_measured["time"]
        if len(time) < 2:
            return at_measured, at_measured
        return simulate(x.tolist(), np.linspace(time[0], time[-1], CURVE_POINTS).tolist(), k)[0], at_measured
    except SimulationError as e:
        _log.warning("nothing to draw at %s: %s", x, e)
        return None
