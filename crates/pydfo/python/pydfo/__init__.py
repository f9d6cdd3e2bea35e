"""Fit the parameters of Functional Mock-up Units to measurements, without derivatives.

`FMUModel` opens a model to set, simulate and read values; `example_fmu` provides example models. `Calibration`
combines a model, measurements and `Parameter` objects, and fits without the interpreter lock. `minimize` minimises
any Python function, `least_squares` minimises the sum of squares of residuals, and `pareto` minimises several criteria
at once. `Optimizer` lets you control the run: ask for points and report their costs. `scipy_method` provides the
methods for ``scipy.optimize.minimize``. `sensitivity` estimates the effect of each parameter of a function over its
whole range. `Design` chooses parameters so that criteria of simulations are best. `fmin` has the signature of the
paper's tool; `pydfo.dfo` provides it together with `quad_err` for scripts written for that tool. `pydfo.ode` integrates
systems written in Python, `pydfo.fmi` controls an instance of an FMU call by call, and `pydfo.compat` provides the
names of FMPy and PyFMI.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from ._calibration.worker import set_interpreter as _set_interpreter
from ._core import __version__

if TYPE_CHECKING:
    from . import compat, dfo, fmi, ode
    from ._calibration.bootstrap import Bootstrap
    from ._calibration.calibration import Calibration
    from ._calibration.check import Check, Finding
    from ._calibration.experiment import Experiment, Hold
    from ._calibration.export import load_fit
    from ._calibration.fit import ChosenTolerance, Fit, FitNoise, OutputFit
    from ._calibration.goodness import Comparison, Goodness
    from ._calibration.parameter import LogNormal, Normal, Parameter
    from ._calibration.posterior import Posterior
    from ._calibration.profile import Profile
    from ._calibration.settings import Limits, Process, Simulation
    from ._calibration.stages import Stage
    from ._calibration.uncertainty import ParameterCheck, Preflight, ResidualCheck, Uncertainty
    from ._calibration.validation import CrossValidation, Fold, PredictionBand, ValidatedOutput, Validation
    from ._design.design import Design
    from ._design.result import DesignPoint, DesignResult, LimitedValue
    from ._design.scenario import Scenario
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
        SimulationWarning,
        UnknownVariableError,
    )
    from ._model.description import Description, Variable, read_description
    from ._model.files import build_fmu, clear_caches, example_fmu
    from ._model.model import FMUModel, load_fmu
    from ._model.trajectory import SimulationResult
    from ._optimize.constraints import LinearConstraint, NonlinearConstraint
    from ._optimize.evaluate import Resubmit
    from ._optimize.fmin import fmin
    from ._optimize.least_squares import least_squares
    from ._optimize.minimize import minimize
    from ._optimize.optimizer import Above, Asked, Optimizer
    from ._optimize.pareto import pareto
    from ._optimize.pareto_front import ParetoFront
    from ._optimize.progress import Progress
    from ._optimize.result import BarrierStage, LeastSquaresResult, OptimizeResult, Trace
    from ._optimize.scipy import scipy_method
    from ._optimize.sensitivity import Sensitivity, sensitivity

_set_interpreter()
#: Modules and the names that `pydfo` exports from them. A module is imported when one of its names is first used.
_HOMES = {
    "_calibration.calibration": "Calibration",
    "_calibration.check": "Check Finding",
    "_design.design": "Design",
    "_design.result": "DesignPoint DesignResult LimitedValue",
    "_design.scenario": "Scenario",
    "_model.description": "Description Variable read_description",
    "_errors": "AllStartsFailed BadCalibrationError BadModelValueError CalibrationError CalibrationWarning CheckpointError FmuError Interrupted ModelTypeError NoResult PydfoError SimulationError SimulationWarning UnknownVariableError",
    "_calibration.experiment": "Experiment Hold",
    "_model.files": "build_fmu clear_caches example_fmu",
    "_calibration.bootstrap": "Bootstrap",
    "_calibration.fit": "ChosenTolerance Fit FitNoise OutputFit",
    "_calibration.goodness": "Comparison Goodness",
    "_optimize.constraints": "LinearConstraint NonlinearConstraint",
    "_optimize.evaluate": "Resubmit",
    "_optimize.fmin": "fmin",
    "_optimize.least_squares": "least_squares",
    "_optimize.minimize": "minimize",
    "_model.model": "FMUModel load_fmu",
    "_optimize.optimizer": "Above Asked Optimizer",
    "_calibration.parameter": "LogNormal Normal Parameter",
    "_calibration.posterior": "Posterior",
    "_calibration.profile": "Profile",
    "_optimize.pareto": "pareto",
    "_optimize.pareto_front": "ParetoFront",
    "_optimize.progress": "Progress",
    "_optimize.result": "BarrierStage LeastSquaresResult OptimizeResult Trace",
    "_optimize.scipy": "scipy_method",
    "_optimize.sensitivity": "Sensitivity sensitivity",
    "_calibration.export": "load_fit",
    "_calibration.settings": "Limits Process Simulation",
    "_calibration.stages": "Stage",
    "_model.trajectory": "SimulationResult",
    "_calibration.validation": "CrossValidation Fold PredictionBand ValidatedOutput Validation",
    "_calibration.uncertainty": "ParameterCheck Preflight ResidualCheck Uncertainty",
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names.split()}

__all__ = [
    "Above",
    "AllStartsFailed",
    "Asked",
    "BadCalibrationError",
    "BadModelValueError",
    "BarrierStage",
    "Bootstrap",
    "Calibration",
    "CalibrationError",
    "CalibrationWarning",
    "Check",
    "CheckpointError",
    "ChosenTolerance",
    "Comparison",
    "CrossValidation",
    "Description",
    "Design",
    "DesignPoint",
    "DesignResult",
    "Experiment",
    "FMUModel",
    "Finding",
    "Fit",
    "FitNoise",
    "FmuError",
    "Fold",
    "Hold",
    "Goodness",
    "Interrupted",
    "LeastSquaresResult",
    "Limits",
    "LimitedValue",
    "LinearConstraint",
    "ModelTypeError",
    "NoResult",
    "NonlinearConstraint",
    "OptimizeResult",
    "Optimizer",
    "LogNormal",
    "Normal",
    "OutputFit",
    "Parameter",
    "ParameterCheck",
    "ParetoFront",
    "Preflight",
    "PredictionBand",
    "Process",
    "Posterior",
    "Profile",
    "Progress",
    "PydfoError",
    "ResidualCheck",
    "Resubmit",
    "Scenario",
    "Sensitivity",
    "Simulation",
    "SimulationError",
    "SimulationResult",
    "SimulationWarning",
    "Stage",
    "Trace",
    "UnknownVariableError",
    "ValidatedOutput",
    "Validation",
    "Variable",
    "Uncertainty",
    "__version__",
    "build_fmu",
    "clear_caches",
    "compat",
    "dfo",
    "example_fmu",
    "fmi",
    "fmin",
    "least_squares",
    "load_fit",
    "load_fmu",
    "minimize",
    "ode",
    "pareto",
    "read_description",
    "scipy_method",
    "sensitivity",
]


def __getattr__(name: str) -> Any:
    if name in ("compat", "dfo", "fmi", "ode"):
        return importlib.import_module(f"{__name__}.{name}")
    home = _HOME_OF.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(f"{__name__}.{home}"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
