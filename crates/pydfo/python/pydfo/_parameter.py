"""What is fitted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from . import _core
from ._keywords import explained
from ._options import choice, flag, number, optional_number


@dataclass(frozen=True, init=False)
class Parameter:
    """A parameter of the model to be fitted.

    Parameters
    ----------
    name : str
        Its name in the model.
    start : float
        Where the fit starts, in the model's unit.
    lower, upper : float, optional
        Bounds; None where there is none.
    scale : {"linear", "log"}
        Whether the search runs over the value or over its logarithm (for positive parameters known only to an order of
        magnitude). Values and bounds are in the model's unit either way.
    nominal : float, optional
        A typical size, from which steps and tolerances are taken; worth giving where `start` is 0 and there are no bounds.
        Default: the nominal value in the model, else the width of the bounds, else the start value; else Nelder-Mead finds
        it by steps of powers of ten.
    kind : {"continuous", "integer", "categorical"}
        Whether it takes any value, whole numbers, or whole numbers that stand for choices. The search is then by "de"
        (integers) or "ga" (both).
    fixed : bool
        Hold the parameter at `start`.
    local : bool
        Each experiment has a value of its own, ``T0[run1]``, ``T0[run2]``, instead of one for all. Where the `start_values` of an
        `Experiment` name the parameter, its search starts there.

    Raises
    ------
    ValueError
        Numbers that do not fit together: bounds that cross, a start outside of them, a log scale with values that are
        not positive, discrete values that are not whole.

    Examples
    --------
    >>> Parameter("armFriction", 0.012, 0, 0.022)
    Parameter('armFriction', 0.012, 0.0, 0.022)
    """

    name: str
    start: float
    lower: float
    upper: float
    scale: str
    nominal: float | None
    kind: str
    fixed: bool
    local: bool

    @explained
    def __init__(
        self,
        name: str,
        start: float,
        lower: float | None = None,
        upper: float | None = None,
        *,
        scale: Literal["linear", "log"] = "linear",
        nominal: float | None = None,
        kind: Literal["continuous", "integer", "categorical"] = "continuous",
        fixed: bool = False,
        local: bool = False,
    ) -> None:
        put = object.__setattr__
        put(self, "name", choice("name", name))
        put(self, "start", number("start", start))
        put(self, "lower", -np.inf if lower is None else number("lower", lower))
        put(self, "upper", np.inf if upper is None else number("upper", upper))
        put(self, "scale", choice("scale", scale))
        put(self, "nominal", optional_number("nominal", nominal))
        put(self, "kind", choice("kind", kind))
        put(self, "fixed", flag("fixed", fixed))
        put(self, "local", flag("local", local))
        _core.check_parameter(self)

    def __repr__(self) -> str:
        said = [repr(self.name), repr(self.start)]
        said.append("None" if self.lower == -np.inf else repr(self.lower))
        said.append("None" if self.upper == np.inf else repr(self.upper))
        if self.scale != "linear":
            said.append(f"scale={self.scale!r}")
        if self.nominal is not None:
            said.append(f"nominal={self.nominal!r}")
        if self.kind != "continuous":
            said.append(f"kind={self.kind!r}")
        if self.fixed:
            said.append("fixed=True")
        if self.local:
            said.append("local=True")
        return f"Parameter({', '.join(said)})"
