"""A fit over time: measurements, responses, residuals, inputs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .style import COLOURS, FITTED, MEASURED, START, pyplot, short

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .._calibration.fit import Fit

#: Maximum number of experiments with separate columns.
MOST_COLUMNS = 4

#: Maximum number of parameter values in a title.
MOST_VALUES = 3

#: Curves of an experiment, of one of its outputs, or of an input (see `_core.Fit.curves`).
Curves = dict[str, Any]


def fit(fit: Fit, native: _core.Fit) -> Figure:
    """Draws each output of each experiment: measurements, responses at the start and of the fit, and the residuals of
    the fit below.

    The inputs are at the bottom, grouped by unit."""
    plt = pyplot()
    experiments: list[Curves] = native.curves()
    outputs, inputs = _columns(experiments)
    width = {1: 7.4, 2: 10.4}.get(len(outputs), 1.2 + 3.9 * len(outputs))
    n_rows, n_inputs = max(map(len, outputs)), max(map(len, inputs))
    height = 3.0 if n_rows <= 2 else 2.2
    figure: Figure = plt.figure(figsize=(width, 1.0 + height * n_rows + 1.2 * n_inputs), layout="constrained")
    grid = figure.add_gridspec(
        2 * n_rows + n_inputs, len(outputs), height_ratios=[2.0, 1.0] * n_rows + [1.2] * n_inputs
    )
    handles: dict[str, Any] = {}
    first: dict[str, Axes] = {}
    for column in range(len(outputs)):
        panels: dict[str, list[Axes]] = {}

        def panel(row: int, experiment: Curves) -> Axes:
            name = experiment["name"]
            axes: Axes = figure.add_subplot(grid[row, column], sharex=first.get(name))
            first.setdefault(name, axes)
            panels.setdefault(name, []).append(axes)
            for window in experiment["windows"]:
                axes.axvspan(*window, color="#F0E442", alpha=0.15, linewidth=0.0, label="window")
            return axes

        for row, (experiment, output) in enumerate(outputs[column]):
            upper, lower = panel(2 * row, experiment), panel(2 * row + 1, experiment)
            _draw_output(upper, lower, output)
            name = output["measured"]["variable"]
            upper.set_title(short(name if len(experiments) == 1 else f"{experiment['name']}: {name}", 56), fontsize="medium", loc="left")
            handles |= {str(label): handle for handle, label in zip(*upper.get_legend_handles_labels())}
        for row, (experiment, group) in enumerate(inputs[column]):
            _draw_inputs(panel(2 * n_rows + row, experiment), group)
        for axes_of_experiment in panels.values():
            for axes in axes_of_experiment[:-1]:
                axes.tick_params(labelbottom=False)
            axes_of_experiment[-1].set_xlabel(f"time [{experiments[0]['time_unit']}]")
    values = [f"{short(name)} = {value:.5g}" for name, value in fit.parameters.items()]
    title = ", ".join(values) if len(values) <= MOST_VALUES else None
    figure.legend(
        handles.values(), handles.keys(), loc="outside upper center", ncols=len(handles), fontsize="small", title=title, frameon=False
    )
    return figure


def _columns(experiments: list[Curves]) -> tuple[list[list[tuple[Curves, Curves]]], list[list[tuple[Curves, list[Curves]]]]]:
    """Returns the outputs and the inputs of each column.

    There is one column per experiment. For one or many experiments, the outputs are distributed over columns."""
    outputs = [[(experiment, output) for output in experiment["outputs"]] for experiment in experiments]
    inputs = [[(experiment, group) for group in _groups(experiment["inputs"])] for experiment in experiments]
    if 1 < len(experiments) <= MOST_COLUMNS:
        return outputs, inputs
    cells, groups = sum(outputs, []), sum(inputs, [])
    n = 1 if len(cells) == 1 else 2 if len(cells) <= 8 else 3
    return [cells[k::n] for k in range(n)], [groups[k::n] for k in range(n)]


def _groups(inputs: list[Curves]) -> list[list[Curves]]:
    """Groups the inputs by unit."""
    groups: dict[str | None, list[Curves]] = {}
    for signal in inputs:
        groups.setdefault(signal["unit"], []).append(signal)
    return list(groups.values())


def _draw_output(upper: Axes, lower: Axes, output: Curves) -> None:
    """Draws measurements and responses in the upper panel, and residuals in the lower one."""
    measured, residuals = output["measured"], output["residuals"]
    size = 4.0 if len(residuals) < 300 else 2.0
    upper.plot(measured["times"], measured["values"], ".", color=MEASURED, markersize=size, label="measured")
    limits = _limits([measured, output["fitted"]])
    for name, colour, style in (("start", START, "--"), ("fitted", FITTED, "-")):
        if (response := output[name]) is not None:
            upper.plot(response["times"], np.clip(response["values"], *limits), style, color=colour, linewidth=1.1, label=name)
    lower.axhline(0.0, color="0.6", linewidth=0.6)
    if (sigma := output["sigma"]) is not None:
        # One known standard deviation. A measurement with an infinite one is excluded.
        known = np.isfinite(sigma := np.asarray(sigma))
        times = measured["times"][known]
        for axes, values in ((upper, measured["values"]), (lower, residuals)):
            axes.errorbar(times, values[known], sigma[known], fmt="none", ecolor=MEASURED, elinewidth=0.6, zorder=0)
    lower.plot(measured["times"], residuals, ".", color=FITTED, markersize=size, label="residual")
    unit = f" [{short(measured['unit'])}]" if measured["unit"] else ""
    upper.set_ylabel(unit.strip() or "value")
    lower.set_ylabel(f"residual{unit}", fontsize="small")
    rms = float(np.sqrt(np.mean(residuals**2)))
    lower.set_title(f"RMS {rms:.4g}{unit}", fontsize="x-small", loc="right", pad=2.0)


def _limits(signals: list[Curves | None]) -> tuple[float, float]:
    """Returns the limits for the response at the start: the range of the other curves, extended by twice this
    range."""
    values = np.concatenate([signal["values"] for signal in signals if signal is not None])
    low, high = float(np.min(values)), float(np.max(values))
    by = 2.0 * (high - low) or abs(high) or 1.0
    return low - by, high + by


def _draw_inputs(axes: Axes, group: list[Curves]) -> None:
    """Draws inputs with the same unit."""
    lines = []
    for k, signal in enumerate(group):
        there = ~np.isnan(signal["values"])
        lines += axes.plot(signal["times"][there], signal["values"][there], color=COLOURS[k % len(COLOURS)], linewidth=1.0, label=short(signal["variable"], 24))
    axes.set_ylabel(f"[{short(group[0]['unit'])}]" if group[0]["unit"] else "input")
    axes.legend(handles=lines, loc="lower right", bbox_to_anchor=(1.0, 0.96), ncols=4, fontsize="x-small", frameon=False)
    axes.set_title("input" if len(group) == 1 else "inputs", fontsize="small", loc="left", pad=2.0)
