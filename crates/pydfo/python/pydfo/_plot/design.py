"""Figures of a design."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .._args import text as _text
from .._errors import SimulationError
from .style import FITTED, START, pyplot, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .._design.design import Design
    from .._design.result import DesignResult


def trajectories(design: Design, result: DesignResult, outputs: Sequence[str]) -> Figure:
    """Draws a row per variable and a column per scenario: at the start, and at the best design."""

    def simulated(x: Any) -> dict[str, Any]:
        found = design.simulate(x, outputs=outputs)
        return dict(found) if len(design.scenarios) > 1 else {design.scenarios[0]: found}

    best = simulated(result.x)
    try:
        before = simulated(None)
    except SimulationError:
        before = {}
    figure, axes = pyplot().subplots(
        len(outputs), len(best), squeeze=False, sharex="col", sharey="row", layout="constrained",
        figsize=(max(6.4, 4.5 * len(best)), max(3.0, 1.9 * len(outputs))),
    )
    for column, (name, run) in enumerate(best.items()):
        for row, output in enumerate(outputs):
            axis = axes[row, column]
            if name in before:
                axis.plot(before[name]["time"], before[name][output], color=START, lw=1.0, ls="--", label="start")
            axis.plot(run["time"], run[output], color=FITTED, lw=1.4, label="optimised")
            if column == 0:
                unit = run.units.get(output)
                axis.set_ylabel(short(output) + (f" [{_text.line(unit)}]" if unit else ""))
        axes[-1, column].set_xlabel("time")
        if len(best) > 1:
            axes[0, column].set_title(_text.line(name), fontsize="small")
    axes[0, 0].legend(fontsize="small")
    return figure  # type: ignore[no-any-return]
