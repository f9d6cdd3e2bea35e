"""Figures of recordings before any simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._args import text as _text
from .style import pyplot

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def recordings(calibration: _core.Calibration) -> Figure:
    """Draws a column per experiment, with measurements followed by inputs. Rows outside the windows are grey."""
    recorded = _core.recorded(calibration)
    names = calibration.experiments()
    n_rows = max(len(series) for _, series, _ in recorded)
    figure, axes = pyplot().subplots(
        n_rows,
        len(recorded),
        squeeze=False,
        sharex="col",
        layout="constrained",
        figsize=(max(6.4, 4.5 * len(recorded)), max(3.0, 1.9 * n_rows)),
    )
    for column, (name, (time, series, windows)) in enumerate(zip(names, recorded)):
        for row, axis in enumerate(axes[:, column]):
            if row >= len(series):
                axis.remove()
                continue
            variable, label, unit, values, is_input = series[row]
            present = ~np.isnan(values)
            style: dict[str, Any] = {"lw": 1.2} if is_input else {"ls": "none", "marker": ".", "ms": 3}
            color = "tab:green" if is_input else "black"
            # A line ends at an empty cell. Single values between empty cells are drawn as marks.
            axis.plot(time, values, color=color, **style)
            if is_input and not present.all():
                axis.plot(time[present], values[present], color=color, lw=0.8, ls=":")
                axis.plot(time[present], values[present], color=color, ls="none", marker=".", ms=2)
            axis.set_ylabel(_text.line(variable + (f" [{unit}]" if unit else "")))
            axis.set_title(_text.line(f"{'input' if is_input else 'measured'}: {label}"), loc="left", fontsize="small")
            if windows and not is_input:
                # Intervals before, between and after the windows.
                edges = [time[0], *(edge for window in sorted(windows) for edge in window), time[-1]]
                for low, high in zip(edges[::2], edges[1::2]):
                    low, high = max(low, time[0]), min(high, time[-1])
                    if low < high:
                        axis.axvspan(low, high, color="0.85", zorder=0)
        axes[len(series) - 1, column].set_xlabel(f"time [{calibration.time_unit()}]")
        axes[len(series) - 1, column].tick_params(labelbottom=True)
        if len(recorded) > 1:
            axes[0, column].annotate(name, (0.5, 1.25), xycoords="axes fraction", ha="center", weight="bold")
    return figure  # type: ignore[no-any-return]
