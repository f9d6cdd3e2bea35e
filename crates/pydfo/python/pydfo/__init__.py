"""Fit the parameters of Functional Mock-up Units to measurements, without derivatives.

`FMUModel` is a model to set, simulate and get values of; `example_fmu` has some to try.
`Calibration` puts a model, measurements and `Parameter` objects together, and fits without the interpreter lock.
`minimize` minimises any Python function, `least_squares` the sum of squares of one that returns residuals, and `Optimizer` lets you drive: ask for points, tell their costs;
`scipy_method` makes the methods usable in ``scipy.optimize.minimize``. `fmin` has the signature of the tool of the
paper; `pydfo.dfo` has it together with `quad_err` for scripts written for that tool. `pydfo.ode` integrates systems written
in Python.
"""

from __future__ import annotations

from . import dfo, ode
from ._calibration import Calibration
from ._check import Check, Finding
from ._core import __version__
from ._description import Description, Variable, read_description
from ._errors import (
    AllStartsFailed,
    BadCalibrationError,
    BadModelValueError,
    CalibrationError,
    CalibrationWarning,
    CheckpointError,
    FmuError,
    Interrupted,
    ModelTypeError,
    NoResult,
    PydfoError,
    SimulationError,
    UnknownVariableError,
)
from ._experiment import Experiment
from ._files import build_fmu, clear_caches, example_fmu
from ._fit import ChosenTolerance, Fit, FitNoise, OutputFit
from ._fmin import fmin
from ._least_squares import least_squares
from ._minimize import minimize
from ._model import FMUModel, load_fmu
from ._optimizer import Above, Asked, Optimizer
from ._parameter import LogNormal, Normal, Parameter
from ._point import Raced
from ._profile import Profile
from ._progress import Progress
from ._result import BarrierStage, LeastSquaresResult, OptimizeResult, Trace
from ._scipy import scipy_method
from ._share import load_fit
from ._stages import Stage
from ._trajectory import SimulationResult
from ._validation import CrossValidation, Fold, PredictionBand, ValidatedOutput, Validation
from ._worker import know_interpreter as _know_interpreter
from ._worth import ParameterCheck, Preflight, ResidualCheck, Worth

_know_interpreter()

__all__ = [
    "Above",
    "AllStartsFailed",
    "Asked",
    "BadCalibrationError",
    "BadModelValueError",
    "BarrierStage",
    "Calibration",
    "CalibrationError",
    "CalibrationWarning",
    "Check",
    "CheckpointError",
    "ChosenTolerance",
    "CrossValidation",
    "Description",
    "Experiment",
    "FMUModel",
    "Finding",
    "Fit",
    "FitNoise",
    "FmuError",
    "Fold",
    "Interrupted",
    "LeastSquaresResult",
    "ModelTypeError",
    "NoResult",
    "OptimizeResult",
    "Optimizer",
    "LogNormal",
    "Normal",
    "OutputFit",
    "Parameter",
    "ParameterCheck",
    "Preflight",
    "PredictionBand",
    "Profile",
    "Progress",
    "PydfoError",
    "Raced",
    "ResidualCheck",
    "SimulationError",
    "SimulationResult",
    "Stage",
    "Trace",
    "UnknownVariableError",
    "ValidatedOutput",
    "Validation",
    "Variable",
    "Worth",
    "__version__",
    "build_fmu",
    "clear_caches",
    "dfo",
    "example_fmu",
    "fmin",
    "least_squares",
    "load_fit",
    "load_fmu",
    "minimize",
    "ode",
    "read_description",
    "scipy_method",
]
