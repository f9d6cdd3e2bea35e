"""The exceptions of pydfo.

Bad arguments are ``ValueError``, ``TypeError`` or ``KeyError``, as everywhere in Python, and files that cannot be read
are ``OSError``. What is special to models and fits derives from `PydfoError`. Where both apply, a class is both: an
unknown variable is a `FmuError` and a ``KeyError``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ._args.text import line

if TYPE_CHECKING:
    from ._calibration.profile import Profile
    from ._optimize.result import OptimizeResult, Trace
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
    """Base of all errors that are special to pydfo."""


class FmuError(PydfoError):
    """An FMU cannot be read, built, loaded, or used as asked."""


class UnknownVariableError(FmuError, KeyError):
    """The model, or a result, has no variable of this name; the message offers the nearest names."""

    def __str__(self) -> str:
        # KeyError would show the repr of the message.
        return Exception.__str__(self)


class BadModelValueError(FmuError, ValueError):
    """A value that a variable or a setting of the simulation cannot take."""


class ModelTypeError(FmuError, TypeError):
    """A value of the wrong type for a variable."""


class SimulationError(PydfoError):
    """A simulation that was started failed.

    Attributes
    ----------
    status : str or None
        What the FMU returned ("error", "fatal", "discard"), if a call into it failed.
    time : float or None
        Simulated time that was reached, in s.
    log : list of str
        The last lines that the FMU logged, oldest first.
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
    """Data, parameters or settings of a calibration that do not fit together."""

    def __init__(self, *args: object) -> None:
        # Names of columns and variables may hold line breaks and escapes.
        super().__init__(*(line(value) if isinstance(value, str) else value for value in args))


class CalibrationWarning(UserWarning):
    """A calibration can be evaluated, but perhaps it is not what was meant: a column that is not used has the name of an
    input, the recording of an input does not cover the simulation, values set in an `FMUModel` do not count. In a
    simulation: an input has no column in the recording of the inputs."""


class SimulationWarning(UserWarning):
    """A simulation went to its end, and some of its results are NaN or infinite."""


class NoResult(CalibrationError):
    """A run ended before any point had a finite cost.

    Attributes
    ----------
    nfev : int
        Evaluations made.
    failures : dict of str to int
        The reasons of the failed ones and how often each occurred, most frequent first.
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
    """The objective failed at every one of the starting points."""


class CheckpointError(PydfoError, ValueError):
    """A checkpoint that is damaged, or belongs to another run; the message names the difference. The file is untouched."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C ended a run; the best point seen, or the part of the solution that there is, is in hand.

    Attributes
    ----------
    result : OptimizeResult, OdeResult, Profile or None
        The result up to the interrupt (of a fit: a `Fit`, of `pydfo.ode.solve`: an `OdeResult`, of
        `Fit.profile`: a `Profile`); None if no point had a finite cost yet.
    """

    result: OptimizeResult | OdeResult | Profile | None = None
