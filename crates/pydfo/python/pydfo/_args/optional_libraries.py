"""Libraries that are not always there."""

from __future__ import annotations

import importlib
from typing import Any


def library(name: str, user: str) -> Any:
    """A module that `user` needs and that need not be there."""
    try:
        return importlib.import_module(name)
    except ImportError as e:
        raise ImportError(f"{user} needs {name}: pip install {name}") from e


def pandas() -> Any:
    """The module, where a table of it is asked for."""
    return library("pandas", "to_dataframe()")
