"""Optional libraries."""

from __future__ import annotations

import importlib
from typing import Any


def library(name: str, user: str) -> Any:
    """Imports an optional module that `user` needs."""
    try:
        return importlib.import_module(name)
    except ImportError as e:
        raise ImportError(f"{user} requires {name}; install it with pip install {name}") from e


def pandas() -> Any:
    """Imports pandas for a table."""
    return library("pandas", "to_dataframe()")
