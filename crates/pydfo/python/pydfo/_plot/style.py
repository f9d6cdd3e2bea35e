"""Common parts of all figures: matplotlib, colours, labels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .._args import text as _text

#: Colours suitable for colour-blind readers (Okabe and Ito, Color universal design, 2008), as in the report.
MEASURED = "#767676"
START = "#D55E00"
FITTED = "#0072B2"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#767676")

#: Maximum length of a name. Longer names are shortened in the middle.
LONGEST = 40


def pyplot() -> Any:
    """Returns ``matplotlib.pyplot``, or raises an error with the command that installs it."""
    try:
        import matplotlib.pyplot as plt
    except ImportError as e:
        raise ImportError("plotting requires matplotlib; install it with pip install matplotlib") from e
    return plt


def short(name: str, longest: int = LONGEST) -> str:
    """Returns the name for a label, shortened in the middle if it is too long, with formula characters escaped."""
    name = _text.line(name)
    if len(name) > longest:
        part = (longest - 3) // 2
        name = f"{name[:part]}...{name[-part:]}"
    return name.replace("$", r"\$")


def names_for(names: Sequence[str] | None, n: int) -> list[str]:
    """Returns labels of parameters: their names, or their indices."""
    return [short(name) for name in names] if names is not None else [f"x[{i}]" for i in range(n)]
