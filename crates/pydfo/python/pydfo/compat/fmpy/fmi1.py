"""FMPy's classes for instances of FMI 1.0."""

from __future__ import annotations

from .instances import Model as FMU1Model
from .instances import Slave as FMU1Slave

__all__ = ["FMU1Model", "FMU1Slave"]
