"""Figures of a global sensitivity analysis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .style import FITTED, START, names_for, pyplot, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .._optimize.sensitivity import FloatArray, Sensitivity


def effects(found: Sensitivity, outputs: list[int]) -> Figure:
    """Draws bars of the effects on these values, with their confidence intervals."""
    plt = pyplot()
    arrays: list[tuple[str, FloatArray | None, FloatArray | None, str]] = (
        [("mu*", found.mu_star, found.mu_star_conf, FITTED), ("sigma", found.sigma, None, START)]
        if found.method == "morris"
        else [("S1", found.S1, found.S1_conf, FITTED), ("ST", found.ST, found.ST_conf, START)]
    )
    columns = min(len(outputs), 3)
    rows = -(-len(outputs) // max(columns, 1))
    n = len(found.names)
    figure: Figure
    size = (1.5 + 3.6 * columns, 1.0 + max(1.6, 0.45 * n + 0.7) * rows)
    figure, grid = plt.subplots(rows, columns, squeeze=False, sharey=True, figsize=size, layout="constrained")
    at = np.arange(n)
    for axes, k in zip(grid.flat, outputs):
        for i, (label, values, widths, colour) in enumerate(arrays):
            if values is not None:
                errors = None if widths is None else widths[k]
                axes.barh(at + 0.4 * (i - 0.5), values[k], 0.4, xerr=errors, color=colour, label=label, error_kw={"linewidth": 0.8})
        axes.set_title(short(found.outputs[k]), fontsize="medium", loc="left")
        axes.axvline(0.0, color="0.6", linewidth=0.6)
        axes.locator_params(axis="x", nbins=5)
        axes.tick_params(labelsize="small")
        if found.reasons[k]:
            axes.text(0.5, 0.5, "no result", transform=axes.transAxes, ha="center", va="center", color="0.4")
    grid[0, 0].set_yticks(at, names_for(found.names, n))
    grid[0, 0].invert_yaxis()
    for axes in grid.flat[len(outputs) :]:
        axes.set_visible(False)
    for axes in grid[-1]:
        axes.set_xlabel("change over the whole range" if found.method == "morris" else "part of the variance")
    handles, _ = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize="small")
    title = "Elementary effects" if found.method == "morris" else "Sobol' indices"
    figure.suptitle(f"{title}, {100.0 * found.level:g} % intervals", fontsize="medium")
    return figure
