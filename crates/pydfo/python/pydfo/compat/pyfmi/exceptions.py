"""PyFMI's names of the exceptions of pydfo."""

from __future__ import annotations

from ..._errors import FmuError, PydfoError, SimulationError

FMUException = PydfoError
InvalidFMUException = InvalidXMLException = InvalidBinaryException = InvalidVersionException = FmuError
IOException = OSError
TimeLimitExceeded = SimulationError


class InvalidOptionException(ValueError, PydfoError):
    """An invalid value of an option."""


class UnrecognizedOptionError(KeyError, PydfoError):
    """An unknown option."""

    def __str__(self) -> str:
        return Exception.__str__(self)
