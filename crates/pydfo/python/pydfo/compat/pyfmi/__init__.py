"""PyFMI's models with their names and methods, implemented with `pydfo`: ``from pydfo.compat.pyfmi import load_fmu``.

Unsupported functions raise `NotProvided` when they are called, and suggest an alternative. docs/compat.md lists all
names.
"""

from __future__ import annotations

from .._refused import NotProvided, hand_out
from .model import FMUModelCS1, FMUModelCS2, FMUModelME1, FMUModelME2, FMUModelME3, load_fmu

__all__ = ["FMUModelCS1", "FMUModelCS2", "FMUModelME1", "FMUModelME2", "FMUModelME3", "NotProvided", "load_fmu"]

REFUSED = {
    "CoupledFMUModelME2": "only one FMU is simulated at a time",
    "FMUModelME1Extended": "only one FMU is simulated at a time; use load_fmu(kind='CS') for co-simulation",
    "Master": "only one FMU is simulated at a time",
    "check_packages": "pip check",
}
__getattr__ = hand_out("pydfo.compat.pyfmi", REFUSED)
