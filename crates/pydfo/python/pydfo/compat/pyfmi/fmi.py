"""Contents of ``pyfmi.fmi``: the models, and the codes of types, causalities and variabilities."""

from __future__ import annotations

from . import constants as _constants
from .described import ScalarVariable
from .exceptions import FMUException, InvalidFMUException, InvalidOptionException, TimeLimitExceeded
from .model import FMUModelBase, FMUModelCS1, FMUModelCS2, FMUModelME1, FMUModelME2, FMUModelME3, load_fmu

globals().update({name: value for name, value in vars(_constants).items() if name.startswith("FMI")})

__all__ = [
    "FMUException",
    "FMUModelBase",
    "FMUModelCS1",
    "FMUModelCS2",
    "FMUModelME1",
    "FMUModelME2",
    "FMUModelME3",
    "InvalidFMUException",
    "InvalidOptionException",
    "ScalarVariable",
    "TimeLimitExceeded",
    "load_fmu",
]
