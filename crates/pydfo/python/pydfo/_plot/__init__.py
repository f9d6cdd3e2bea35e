"""Figures. matplotlib is imported only when a figure is requested."""

from __future__ import annotations

from .fit import fit
from .front import front
from .posterior import corner
from .profile import profiles
from .search import convergence, waterfall
from .sensitivity import effects
from .simplex import SimplexWalk
from .style import pyplot
from .uncertainty import correlation, sensitivity

__all__ = ["SimplexWalk", "convergence", "corner", "correlation", "effects", "fit", "front", "profiles", "pyplot", "sensitivity", "waterfall"]
