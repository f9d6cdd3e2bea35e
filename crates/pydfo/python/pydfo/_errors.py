"""The exceptions of pydfo.

Invalid arguments raise ``ValueError``, ``TypeError`` or ``KeyError``, as everywhere in Python. Files that cannot be
read raise ``OSError``. Errors specific to models and fits derive from `PydfoError`. Some classes derive from both: an
unknown variable raises a `FmuError` that is also a ``KeyError``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ._args.text import line

if TYPE_CHECKING:
    from ._calibration.posterior import Posterior
    from ._calibration.profile import Profile
    from ._optimize.result import OptimizeResult, Trace
    from ._optimize.sensitivity import Sensitivity
    from .ode import OdeResult

__all__ = [
    "AllStartsFailed",
    "BadCalibrationError",
    "BadModelValueError",
    "CalibrationError",
    "CalibrationWarning",
    "CheckpointError",
    "FmuError",
    "Interrupted",
    "ModelTypeError",
    "NoResult",
    "PydfoError",
    "SimulationError",
    "SimulationWarning",
    "UnknownVariableError",
]


class PydfoError(Exception):
    """Base class of all errors specific to pydfo."""


class FmuError(PydfoError):
    """An FMU cannot be read, built, loaded or used as requested."""


class UnknownVariableError(FmuError, KeyError):
    """The model or a result has no variable with this name. The message suggests the nearest names."""

    def __str__(self) -> str:
        # KeyError would show the repr of the message.
        return Exception.__str__(self)


class BadModelValueError(FmuError, ValueError):
    """A value is not allowed for a variable or a setting of the simulation."""


class ModelTypeError(FmuError, TypeError):
    """A value has the wrong type for a variable."""


class SimulationError(PydfoError):
    """A simulation failed after its start.

    Attributes
    ----------
    status : str or None
        Status returned by the FMU ("error", "fatal", "discard") if a call into it failed.
    time : float or None
        Simulated time reached, in s.
    log : list of str
        The last lines logged by the FMU, oldest first.
    """

    status: str | None = None
    time: float | None = None
    log: list[str]

    def __init__(self, *args: object) -> None:
        super().__init__(*args)
        self.log = []


class CalibrationError(PydfoError):
    """A calibration cannot be set up, or a fit found nothing."""


class BadCalibrationError(CalibrationError, ValueError):
    """Data, parameters or settings of a calibration do not match."""

    def __init__(self, *args: object) -> None:
        super().__init__(*(_message(value) if isinstance(value, str) else value for value in args))


def _message(text: str) -> str:
    """Escapes line breaks, because names of columns and variables may contain them, except before a formula with a
    mark below its mistake."""
    lines = text.rsplit("\n", 2) if text.rpartition("\n")[2].lstrip() == "^" else [text]
    return "\n".join(line(part) for part in lines)


class CalibrationWarning(UserWarning):
    """A calibration can be evaluated but may not be as intended.

    For example, an unused column has the name of an input, the recording of an input does not cover the simulation,
    or values set in an `FMUModel` are ignored. In a simulation, an input has no column in the recording of the
    inputs."""


class SimulationWarning(UserWarning):
    """A simulation reached its end, and some of its results are NaN or infinite."""


class NoResult(CalibrationError):
    """A run ended before any point had a finite cost.

    Attributes
    ----------
    nfev : int
        Number of evaluations.
    failures : dict of str to int
        Reasons of the failed evaluations and their counts, most frequent first.
    trace : Trace or None
        Every evaluation.
    """

    nfev: int = 0
    failures: dict[str, int]
    trace: Trace | None = None

    def __init__(self, *args: object) -> None:
        super().__init__(*args)
        self.failures = {}


class AllStartsFailed(NoResult):
    """The objective failed at every starting point."""


class CheckpointError(PydfoError, ValueError):
    """A checkpoint is damaged or belongs to another run. The message reports the difference. The file is
    unchanged."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C ended a run; ``result`` contains the best point or the computed part of the solution.

    Attributes
    ----------
    result : OptimizeResult, OdeResult, Profile, Posterior, Sensitivity or None
        Result up to the interrupt: a `Fit` for a fit, an `OdeResult` for `pydfo.ode.solve`, a `Profile` for
        `Fit.profile`, a `Posterior` for `Fit.sample`, a `Sensitivity` for a sensitivity analysis. None if no point had
        a finite cost yet.
    """

    result: OptimizeResult | OdeResult | Profile | Posterior | Sensitivity | None = None
