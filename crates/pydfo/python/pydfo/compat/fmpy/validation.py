"""Validation of descriptions, as in FMPy."""

from __future__ import annotations

from .._refused import hand_out
from .util import validate_fmu

__all__ = ["validate_fmu"]

REFUSED = {"validate_model_description": "use validate_fmu for a file; pydfo.read_description(...).quirks also contains the lines"}
__getattr__ = hand_out("pydfo.compat.fmpy.validation", REFUSED)
