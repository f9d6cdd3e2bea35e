"""Figures of profile likelihoods."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .style import FITTED, MEASURED, START, pyplot, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .._calibration.profile import FloatArray, Profile

#: Height of the panels as a multiple of the threshold.
HEIGHT = 1.6


#: Number of points of a curve.
SMOOTH = 200


def smooth(values: FloatArray, costs: FloatArray, optimum: float) -> tuple[FloatArray, FloatArray]:
    """Returns a curve through the points of a profile.

    It is a monotone cubic Hermite interpolant (Fritsch and Carlson, SIAM J. Numer. Anal. 17, 1980) of the square root
    of the cost with the sign of the side. The root is a straight line if the cost is a parabola."""
    if len(values) < 3:
        return values, costs
    roots = np.copysign(np.sqrt(np.maximum(costs, 0.0)), values - optimum)
    slopes = np.gradient(roots, values)
    widths, secants = np.diff(values), np.diff(roots) / np.diff(values)
    limit = 3.0 * np.minimum(np.append(np.abs(secants), np.inf), np.insert(np.abs(secants), 0, np.inf))
    slopes = np.clip(slopes, -limit, limit)
    at = np.linspace(values[0], values[-1], SMOOTH)
    k = np.clip(np.searchsorted(values, at, side="right") - 1, 0, len(values) - 2)
    s = (at - values[k]) / widths[k]
    curve = (
        (1.0 + 2.0 * s) * (1.0 - s) ** 2 * roots[k]
        + s * (1.0 - s) ** 2 * widths[k] * slopes[k]
        + s * s * (3.0 - 2.0 * s) * roots[k + 1]
        + s * s * (s - 1.0) * widths[k] * slopes[k + 1]
    )
    return at, curve * curve


def profiles(profile: Profile) -> Figure:
    """Draws the rise of the cost against each parameter, with the threshold and the shaded interval."""
    plt = pyplot()
    names = list(profile.values)
    columns = min(len(names), 3)
    rows = -(-len(names) // columns)
    figure: Figure
    figure, grid = plt.subplots(rows, columns, squeeze=False, figsize=(1.0 + 3.6 * columns, 0.8 + 2.9 * rows), layout="constrained")
    for axes, name in zip(grid.flat, names):
        values, costs = profile.values[name], profile.costs[name]
        shown = costs <= HEIGHT * profile.threshold
        low, high = profile.intervals[name]
        left, right = (end if np.isfinite(end) else values[k] for end, k in ((low, 0), (high, -1)))
        axes.axvspan(left, right, color=FITTED, alpha=0.12, linewidth=0)
        axes.axhline(profile.threshold, color=START, linestyle="--", linewidth=1.0)
        for end in (low, high):
            if np.isfinite(end):
                axes.axvline(end, color=FITTED, linewidth=0.8)
        axes.plot(*smooth(values, costs, profile.parameters[name]), color=FITTED, linewidth=1.1)
        axes.plot(values[shown], costs[shown], ".", color=FITTED)
        axes.axvline(profile.parameters[name], color=MEASURED, linewidth=0.8)
        axes.set_ylim(-0.05 * profile.threshold, HEIGHT * profile.threshold)
        unit = profile._units.get(name)
        axes.set_xlabel(short(name) + (f" [{unit}]" if unit else ""))
        axes.tick_params(axis="x", labelsize="small", rotation=30)
        interval = ", ".join(f"{end:.5g}" if np.isfinite(end) else "open" for end in (low, high))
        axes.set_title(f"({interval})", fontsize="small")
    for axes in grid.flat[len(names) :]:
        axes.set_visible(False)
    for row in grid:
        row[0].set_ylabel("increase of the cost [standard errors squared]")
    figure.suptitle(f"Profile likelihood, {100.0 * profile.level:g} % intervals", fontsize="medium")
    return figure
