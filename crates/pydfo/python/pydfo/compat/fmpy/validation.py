"""Validation of descriptions, as in FMPy."""

from __future__ import annotations

from .._refused import hand_out
from .util import validate_fmu

__all__ = ["validate_fmu"]

REFUSED = {"validate_model_description": "validate_fmu looks at the file; pydfo.read_description(...).quirks has the lines, too"}
__getattr__ = hand_out("pydfo.compat.fmpy.validation", REFUSED)
