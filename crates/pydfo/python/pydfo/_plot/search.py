"""Figures of a search: its costs, its best points and the minima found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .style import COLOURS, FITTED, MEASURED, START, names_for, pyplot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .._optimize.result import OptimizeResult

#: Maximum number of parameters with a legend.
MOST_NAMES = 10


def convergence(result: OptimizeResult, names: Sequence[str] | None = None) -> Figure:
    """Draws each cost and the best cost against the evaluations, and below them the best point.

    Each parameter is drawn in units of its range in the run."""
    plt = pyplot()
    figure: Figure
    figure, (costs, points) = plt.subplots(2, 1, sharex=True, height_ratios=[3, 2], figsize=(7.0, 6.4), layout="constrained")
    trace = result.trace
    if trace is not None and len(trace) > 0:
        count = trace.n_dropped + np.arange(1, len(trace) + 1)
        best = trace.running_best()
        finite = trace.fun[np.isfinite(trace.fun)]
        costs.plot(count, trace.fun, ".", color=MEASURED, markersize=4, label="evaluated")
        costs.step(count, np.where(np.isfinite(best), best, np.nan), where="post", color=FITTED, label="best so far")
        for position, k in enumerate(trace.messages):
            costs.axvline(count[k], color=START, linewidth=0.5, alpha=0.5, label="failed" if position == 0 else None)
        if len(finite) > 0:
            # costs of zero have no logarithm and are omitted; a likelihood may be negative
            costs.set_yscale("log" if np.all(finite >= 0.0) and np.any(finite > 0.0) else "linear")
        # evaluations at which the best point changed, and the best point until the next change
        better = np.flatnonzero(np.diff(best, prepend=np.inf) < 0.0)
        low, width = trace.x.min(axis=0), np.ptp(trace.x, axis=0)
        labels = names_for(names, trace.x.shape[1])
        if len(better) > 0:
            rows = better[np.maximum(np.searchsorted(better, np.arange(len(trace)), side="right") - 1, 0)]
            for k, i in enumerate(np.flatnonzero(width > 0.0)):
                scaled = (trace.x[rows, i] - low[i]) / width[i]
                points.step(count, scaled, where="post", linewidth=1.0, color=COLOURS[k % len(COLOURS)], label=labels[i])
        costs.legend(loc="best", fontsize="small")
    costs.set_ylabel("cost")
    costs.set_title(f"{result.method}: {result.termination}, cost {getattr(result, 'cost', result.fun):.6g}", fontsize="medium")
    points.set_xlabel("evaluations")
    points.set_ylabel("best point, scaled")
    if 0 < len(points.lines) <= MOST_NAMES:
        figure.legend(handles=points.lines, loc="outside lower center", ncols=2 if len(points.lines) > 3 else 3, fontsize="small")
    return figure


def waterfall(result: OptimizeResult) -> Figure:
    """Draws the sorted final costs of the local searches; steps are minima."""
    if not result.optima:
        raise ValueError("the result has no minima to compare; use method='multistart' or search='global'")
    plt = pyplot()
    figure: Figure
    figure, axes = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    first = 1
    for k, optimum in enumerate(result.optima):
        count = np.arange(first, first + optimum.n_starts)
        first += optimum.n_starts
        label = f"{optimum.fun:.6g}: {optimum.n_starts} {'search' if optimum.n_starts == 1 else 'searches'}"
        colour = COLOURS[k % len(COLOURS)]
        axes.plot(count, np.full(len(count), optimum.fun), "o-", color=colour, label=label if k < MOST_NAMES else None)
    costs = np.array([optimum.fun for optimum in result.optima])
    if np.all(costs > 0.0):
        axes.set_yscale("log")
    axes.set_xlabel("local search, from the best to the worst")
    axes.set_ylabel("cost")
    axes.set_title(f"{len(costs)} {'minimum' if len(costs) == 1 else 'minima'} found", fontsize="medium")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small", title="cost of the minimum")
    axes.xaxis.get_major_locator().set_params(integer=True)
    return figure
