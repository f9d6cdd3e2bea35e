"""The objective of a fit: a named cost, or a function of measured and simulated values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .._args import values as _values

if TYPE_CHECKING:
    from .._calibration.calibration import Calibration

#: A function of (measured, simulated) that returns a cost or a vector of residuals. Both are dicts of arrays by
#: output, or dicts of such dicts if there are several experiments.
Objective = Callable[[dict[str, Any], dict[str, Any]], Any]


@dataclass(frozen=True)
class CostFields:
    """A cost as the native code reads it."""

    name: str
    function: Objective | None
    gives_residuals: bool

    @property
    def has_residuals(self) -> bool:
        """True if the cost is a sum of squares."""
        return self.gives_residuals or (self.function is None and self.name == "sum-of-squares")


def built(objective: Any, calibration: Calibration) -> CostFields:
    """Converts the argument ``objective``.

    Calls a function once with measurements and slightly changed measurements, to find out whether it returns residuals.
    """
    if not callable(objective):
        return CostFields(_values.choice("objective", objective).strip().lower().replace("_", "-"), None, False)
    measured = calibration._native.measured_series()
    returned = objective(measured, _changed(calibration._native.measured_series()))
    name = f"{getattr(objective, '__module__', '')}.{getattr(objective, '__qualname__', type(objective).__qualname__)}"
    return CostFields(name, objective, np.ndim(returned) > 0 and np.size(returned) != 1)


def _changed(series: Mapping[str, Any]) -> dict[str, Any]:
    """Returns other values of the same shape."""
    return {
        name: _changed(values) if isinstance(values, Mapping) else values + 0.01 * (np.ptp(values) or 1.0)
        for name, values in series.items()
    }
