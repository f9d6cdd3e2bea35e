"""What scripts written for the paper's tool import: ``from pydfo import dfo``."""

from __future__ import annotations

from ._fmin import fmin

__all__ = ["fmin"]
