"""FMPy's classes for instances of FMI 3.0."""

from __future__ import annotations

from .instances import Model as FMU3Model
from .instances import Slave as FMU3Slave

__all__ = ["FMU3Model", "FMU3Slave"]
