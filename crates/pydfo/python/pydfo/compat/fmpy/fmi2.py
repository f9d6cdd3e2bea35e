"""FMPy's classes for instances of FMI 2.0."""

from __future__ import annotations

from .instances import Model as FMU2Model
from .instances import Slave as FMU2Slave

__all__ = ["FMU2Model", "FMU2Slave"]
