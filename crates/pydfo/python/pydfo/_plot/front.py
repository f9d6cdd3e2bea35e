"""Figure of a Pareto front."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .style import FITTED, START, pyplot, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .._optimize.pareto_front import ParetoFront


def front(result: ParetoFront) -> Figure:
    """Draws the points of a front, one diagram per pair of criteria, and marks the compromise."""
    n_criteria = result.criteria.shape[1]
    if n_criteria < 2 or len(result.x) == 0:
        raise ValueError(f"the front has {len(result.x)} points with {n_criteria} criteria; a figure requires points with at least 2 criteria")
    plt = pyplot()
    figure: Figure
    side = n_criteria - 1
    figure, axes = plt.subplots(side, side, squeeze=False, figsize=(2.0 + 3.4 * side, 1.4 + 3.0 * side), layout="constrained")
    for row in range(side):
        for column in range(side):
            diagram = axes[row, column]
            if column > row:
                diagram.set_axis_off()
                continue
            across, up = result.criteria[:, column], result.criteria[:, row + 1]
            diagram.plot(across, up, "o", color=FITTED, markersize=4, label=f"front ({len(across)} points)")
            k = result.compromise
            diagram.plot(across[k], up[k], "D", color=START, markersize=7, label="compromise")
            diagram.set_xlabel(short(result.names[column]))
            diagram.set_ylabel(short(result.names[row + 1]))
    axes[0, 0].legend(loc="best", fontsize="small")
    return figure
