"""Functions for scripts written for the tool of the 2012 paper: ``from pydfo import dfo``."""

from __future__ import annotations

from ._optimize.fmin import fmin
from ._optimize.quad_err import quad_err, quad_err_simple

__all__ = ["fmin", "quad_err", "quad_err_simple"]
