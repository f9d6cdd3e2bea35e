"""Figures of the uncertainty of a fit: correlation and sensitivity of its parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .. import _core
from .style import COLOURS, names_for, pyplot, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = npt.NDArray[np.float64]

#: Maximum size of a table with numbers.
MOST_NUMBERS = 12

#: Maximum number of distinguishable lines over time.
MOST_LINES = 6

_NO_WORTH = "the fit has no standard errors to plot (see its report)"


def correlation(matrix: FloatArray | None, names: list[str]) -> Figure:
    """Draws the correlation of the parameters as a coloured table."""
    if matrix is None:
        raise ValueError(_NO_WORTH)
    plt = pyplot()
    n = len(names)
    size = min(max(4.0, 0.55 * n + 2.5), 14.0)
    figure: Figure
    figure, axes = plt.subplots(figsize=(size + 1.0, size), layout="constrained")
    colours = plt.get_cmap("PuOr").copy()
    colours.set_bad("0.85")
    image = axes.imshow(np.ma.masked_invalid(matrix), cmap=colours, vmin=-1.0, vmax=1.0)
    figure.colorbar(image, ax=axes, label="correlation", shrink=0.8)
    font = "medium" if n <= MOST_NUMBERS else "x-small"
    labels = names_for(names, n)
    axes.set_xticks(range(n), labels, rotation=90 if n > 4 or max(map(len, labels)) > 10 else 0, fontsize=font)
    axes.set_yticks(range(n), labels, fontsize=font)
    for i, k in np.ndindex(matrix.shape):
        if n <= MOST_NUMBERS:
            value = matrix[i, k]
            text = "-" if np.isnan(value) else f"{value:.2f}"
            axes.text(k, i, text, ha="center", va="center", fontsize="small", color="w" if abs(value) > 0.55 else "k")
    return figure


def sensitivity(native: _core.Fit, names: list[str]) -> Figure:
    """Draws the effect of a relative change of each parameter on each output over time, or its RMS for many
    parameters."""
    outputs: list[dict[str, Any]] = native.sensitivities()
    if not outputs:
        raise ValueError(_NO_WORTH)
    plt = pyplot()
    several = len({output["experiment"] for output in outputs}) > 1
    over_time = len(names) <= MOST_LINES
    columns = 1 if len(outputs) == 1 else 2 if len(outputs) <= 8 else 3
    rows = -(-len(outputs) // columns)
    height = 2.4 if over_time else max(2.0, 0.24 * len(names) + 0.9)
    figure: Figure
    figure, grid = plt.subplots(rows, columns, squeeze=False, figsize=(1.0 + 5.0 * columns, 0.6 + height * rows), layout="constrained")
    labels = names_for(names, len(names))
    for axes, output in zip(grid.flat, outputs):
        title = f"{output['experiment']}: {output['variable']}" if several else output["variable"]
        axes.set_title(short(title, 56), fontsize="medium", loc="left")
        unit = f"[{short(output['unit'])}]" if output["unit"] else "change of the output"
        if over_time:
            for i, row in enumerate(output["rows"]):
                axes.plot(output["times"], row, color=COLOURS[i % len(COLOURS)], linewidth=1.1, label=labels[i])
            axes.axhline(0.0, color="0.6", linewidth=0.6)
            axes.set_ylabel(unit)
        else:
            axes.barh(range(len(names)), np.sqrt(np.mean(output["rows"] ** 2, axis=1)), color=COLOURS[0])
            axes.set_yticks(range(len(names)), labels, fontsize="small")
            axes.invert_yaxis()
            axes.set_xlabel(f"root mean square {unit}")
    for axes in grid.flat[len(outputs) :]:
        axes.set_visible(False)
    if over_time:
        for axes in grid[-1]:
            axes.set_xlabel(f"time [{native.time_unit()}]")
        handles, _ = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(names), 4), fontsize="small")
    figure.suptitle("Change of the outputs by a relative change of each parameter", fontsize="medium")
    return figure
