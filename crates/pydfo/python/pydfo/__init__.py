"""Fit the parameters of Functional Mock-up Units to measurements, without derivatives.

`fmin` minimises a Python function, with the signature of the tool of the paper; `pydfo.dfo` has it together with
`quad_err` for scripts written for that tool.
"""

from __future__ import annotations

from . import dfo
from ._core import __version__
from ._errors import (
    AllStartsFailed,
    BadCalibrationError,
    BadModelValueError,
    CalibrationError,
    FmuError,
    Interrupted,
    MethodNotAvailable,
    ModelTypeError,
    NoResult,
    PydfoError,
    SimulationError,
    UnknownVariableError,
)
from ._fmin import fmin
from ._progress import Progress
from ._result import OptimizeResult, Trace

__all__ = [
    "AllStartsFailed",
    "BadCalibrationError",
    "BadModelValueError",
    "CalibrationError",
    "FmuError",
    "Interrupted",
    "MethodNotAvailable",
    "ModelTypeError",
    "NoResult",
    "OptimizeResult",
    "Progress",
    "PydfoError",
    "SimulationError",
    "Trace",
    "UnknownVariableError",
    "__version__",
    "dfo",
    "fmin",
]
