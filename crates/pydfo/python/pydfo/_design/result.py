"""Results of a design optimisation."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import text as _text
from .._calibration.fit import Fit
from .._errors import BadCalibrationError
from .._optimize.result import OptimizeResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .design import Design


def is_maximised(objective: str) -> bool:
    """True if an objective is maximised."""
    return _core.is_maximised(objective)


class LimitedValue(NamedTuple):
    """Value of a constraint and its limits."""

    text: str
    """The constraint as written, with its scenario if there are several."""
    value: float
    """Value of the compared formula."""
    lower: float
    """Smallest allowed value, or -inf."""
    upper: float
    """Largest allowed value, or inf."""

    @property
    def violation(self) -> float:
        """Distance beyond the nearest limit; 0 within the limits."""
        return max(self.lower - self.value, self.value - self.upper, 0.0)


class DesignPoint:
    """Objectives, criteria and constraints of a design at a point."""

    x: npt.NDArray[np.float64]
    """Values of the parameters."""
    objectives: list[float]
    """Values of the objectives, combined over the scenarios."""
    criteria: dict[str, dict[str, float]]
    """Values of the criteria by scenario, as in ``{"run1": {"max(T)": 341.2}}``."""
    constraints: list[LimitedValue]
    """Values of the constraints with criteria and of the other nonlinear ones."""

    def __init__(self, found: Mapping[str, Any]) -> None:
        self.x = np.array(found["x"])
        self.objectives = [float(value) for value in found["goals"]]
        self.criteria = {}
        for one in found["criteria"]:
            self.criteria.setdefault(one["scenario"], {})[one["text"]] = one["value"]
        self.constraints = [LimitedValue(**one) for one in found["constraints"]]

    def __getitem__(self, criterion: str) -> float:
        """Value of a criterion, if there is one scenario."""
        if len(self.criteria) != 1:
            raise KeyError(f"there are {len(self.criteria)} scenarios; use criteria[scenario][{criterion!r}]")
        (values,) = self.criteria.values()
        if criterion not in values:
            raise KeyError(f"unknown criterion {criterion!r}; expected one of: {', '.join(values)}")
        return values[criterion]

    def lines(self) -> Iterator[str]:
        """Criteria and constraints as text."""
        for scenario, values in self.criteria.items():
            where = f" [{scenario}]" if len(self.criteria) > 1 else ""
            for text, value in values.items():
                yield f"{text}{where}: {value:.6g}"
        for limited in self.constraints:
            state = f"violated by {limited.violation:.3g}" if limited.violation > 0 else "holds"
            yield f"constraint {limited.text}: {state} ({limited.value:.6g})"

    def __repr__(self) -> str:
        return "\n".join([f"objective: {value:.6g}" for value in self.objectives] + list(self.lines()))


class DesignResult:
    """The best design that a search found.

    ``result["K1"]`` is the value of a parameter. Printing shows the parameters, criteria and constraints."""

    x: npt.NDArray[np.float64]
    """Best values of the parameters."""
    value: float
    """Value of the first objective at the best point, as written: the largest value found, if it is maximised."""
    point: DesignPoint | None
    """Objectives, criteria and constraints at the best point; None after an interrupt, or with a callable."""
    start: DesignPoint | None
    """The same at the start; None if the simulation failed there, after an interrupt, or with a callable."""
    search: OptimizeResult
    """Search with its trace: a `Fit` without residuals, or the result of `minimize` for a callable objective."""

    def __init__(self, design: Design, search: OptimizeResult, point: DesignPoint | None, start: DesignPoint | None) -> None:
        self._design = design
        self.search = search
        self.x = np.asarray(search.x)
        self.point, self.start = point, start
        is_maximum = any(is_maximised(goal) for goal in design.objectives[:1])
        self.value = point.objectives[0] if point else -float(search.fun) if is_maximum else float(search.fun)

    @property
    def names(self) -> list[str]:
        """Names of the entries of ``x``."""
        return self._design.names

    @property
    def parameters(self) -> dict[str, float]:
        """Best values by name."""
        return dict(zip(self.names, self.x.tolist()))

    @property
    def success(self) -> bool:
        """True if the search converged and the constraints hold within their tolerance."""
        return bool(self.search.success)

    @property
    def message(self) -> str:
        """Reason for the end of the search."""
        return str(self.search.message)

    @property
    def nfev(self) -> int:
        """Number of evaluations of the search. Each simulates all scenarios."""
        return int(self.search.nfev)

    @property
    def violation(self) -> float:
        """Largest violation of a nonlinear constraint at the best point."""
        return float(self.search.get("constr_violation", 0.0))

    def simulate(self, times: npt.ArrayLike | None = None, outputs: Any = None) -> Any:
        """Simulates the best design, see `Design.simulate`."""
        return self._design.simulate(self.x, times, outputs)

    def plot(self, outputs: Any) -> Figure:
        """Draws variables over time at the start and at the best design, one row per variable and one column per scenario.

        Parameters
        ----------
        outputs : str or list of str
            Variables of the model.

        Returns
        -------
        matplotlib.figure.Figure
            The figure is not shown or saved.

        Raises
        ------
        ImportError
            matplotlib is not installed.
        """
        from .._plot import design as _plot_design

        return _plot_design.trajectories(self._design, self, [outputs] if isinstance(outputs, str) else list(outputs))

    def report(self, path: str | os.PathLike[str]) -> None:
        """Writes a self-contained HTML page with parameters, criteria, constraints, figures and settings.

        Not for a callable objective."""
        if not isinstance(self.search, Fit):
            raise BadCalibrationError("a report requires an objective that is a formula")
        self.search.report(path)

    def to_dict(self) -> dict[str, Any]:
        """Returns parameters, objectives, criteria and constraints for JSON."""
        return {
            "objectives": self._design.objectives,
            "value": self.value,
            "parameters": self.parameters,
            "criteria": self.point.criteria if self.point else {},
            "constraints": [one._asdict() for one in self.point.constraints] if self.point else [],
            "success": self.success,
            "message": self.message,
            "nfev": self.nfev,
        }

    def __getitem__(self, name: str) -> float:
        if name not in self.names:
            raise KeyError(f"unknown parameter {name!r}; expected one of: {', '.join(self.names)}")
        return float(self.x[self.names.index(name)])

    def __repr__(self) -> str:
        goal = next(iter(self._design.objectives), "objective")
        before = f", at the start {self.start.objectives[0]:.6g}" if self.start and not math.isnan(self.start.objectives[0]) else ""
        width = max(len(name) for name in self.names)
        lines = [f"{_text.line(goal)} = {self.value:.6g} ({'optimised' if self.success else 'not converged'}){before}"]
        lines += [f"  {name:{width}} = {value:.6g}" for name, value in self.parameters.items()]
        lines += [f"  {line}" for line in (self.point.lines() if self.point else ())]
        lines.append(f"  {self.nfev} evaluations; {self.message}")
        return "\n".join(lines)
