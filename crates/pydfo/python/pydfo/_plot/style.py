"""What all pictures have in common: matplotlib, colours, labels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .._args import text as _text

#: Colours that colour-blind readers tell apart (Okabe and Ito, Color universal design, 2008), those of the report.
MEASURED = "#767676"
START = "#D55E00"
FITTED = "#0072B2"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#767676")

#: Longer names are cut in their middle.
LONGEST = 40


def pyplot() -> Any:
    """``matplotlib.pyplot``, or an error with the command that installs it."""
    try:
        import matplotlib.pyplot as plt
    except ImportError as e:
        raise ImportError("plotting needs matplotlib: pip install matplotlib") from e
    return plt


def short(name: str, longest: int = LONGEST) -> str:
    """The name for a label: without its middle if it is too long, and not read as a formula."""
    name = _text.line(name)
    if len(name) > longest:
        part = (longest - 3) // 2
        name = f"{name[:part]}...{name[-part:]}"
    return name.replace("$", r"\$")


def names_for(names: Sequence[str] | None, n: int) -> list[str]:
    """Labels of parameters: their names, or their positions."""
    return [short(name) for name in names] if names is not None else [f"x[{i}]" for i in range(n)]
