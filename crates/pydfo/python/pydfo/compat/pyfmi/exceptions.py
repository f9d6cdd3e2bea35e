"""PyFMI's exceptions: those of pydfo under their names there."""

from __future__ import annotations

from ..._errors import FmuError, PydfoError, SimulationError

FMUException = PydfoError
InvalidFMUException = InvalidXMLException = InvalidBinaryException = InvalidVersionException = FmuError
IOException = OSError
TimeLimitExceeded = SimulationError


class InvalidOptionException(ValueError, PydfoError):
    """A value that an option cannot have."""


class UnrecognizedOptionError(KeyError, PydfoError):
    """An option that there is none of."""

    def __str__(self) -> str:
        return Exception.__str__(self)
