"""Corner plots of samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .style import FITTED, MEASURED, pyplot, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .._calibration.posterior import Posterior

#: Number of bins of a histogram and, in each direction, of a joint distribution.
BINS = 40


def corner(posterior: Posterior) -> Figure:
    """Draws histograms on the diagonal, with the 95 % intervals, and joint distributions below it."""
    plt = pyplot()
    names, draws, intervals = posterior.names, list(posterior.draws.values()), posterior.intervals()
    n = len(names)
    figure: Figure
    size = 1.0 + 2.1 * n
    figure, grid = plt.subplots(n, n, squeeze=False, figsize=(size, size), layout="constrained")
    ranges = [(low, high) if low < high else (low - 1.0, low + 1.0) for low, high in (np.quantile(d, (0.0005, 0.9995)) for d in draws)]
    labels = [short(name) + (f"\n[{posterior._units[name]}]" if name in posterior._units else "") for name in names]
    for row in range(n):
        for column in range(n):
            axes = grid[row, column]
            if column > row:
                axes.set_visible(False)
                continue
            if column == row:
                axes.hist(draws[row], bins=BINS, range=ranges[row], color=FITTED, alpha=0.6)
                low, high = intervals[names[row]]
                for end in (low, posterior.mean[names[row]], high):
                    axes.axvline(end, color=MEASURED, linewidth=0.8, linestyle="-" if end not in (low, high) else "--")
                axes.set_yticks([])
                axes.set_title(f"{posterior.mean[names[row]]:.4g}\n({low:.4g}, {high:.4g})", fontsize="small")
            else:
                axes.hist2d(draws[column], draws[row], bins=BINS, range=[ranges[column], ranges[row]], cmap="Blues")
                axes.set_ylim(*ranges[row])
            axes.set_xlim(*ranges[column])
            axes.tick_params(labelsize="small", axis="x", rotation=30)
            axes.tick_params(labelsize="small", axis="y")
            if row == n - 1:
                axes.set_xlabel(labels[column], fontsize="small")
            else:
                axes.set_xticklabels([])
            if column == 0 and row > 0:
                axes.set_ylabel(labels[row], fontsize="small")
            elif column > 0:
                axes.set_yticklabels([])
    figure.suptitle(f"Posterior distribution, {posterior.chain.shape[0] * posterior.chain.shape[1]} draws", fontsize="medium")
    return figure
