"""What scripts written for the paper's tool import: ``from pydfo import dfo``."""

from __future__ import annotations

from ._fmin import fmin
from ._quad_err import quad_err, quad_err_simple

__all__ = ["fmin", "quad_err", "quad_err_simple"]
