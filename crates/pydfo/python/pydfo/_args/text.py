"""Values and names as messages show them."""

from __future__ import annotations

import reprlib
from collections.abc import Sequence

_shortened = reprlib.Repr()
_shortened.maxstring = _shortened.maxother = 80


def show(value: object) -> str:
    """A value for a message: of long ones the beginning."""
    return " ".join(_shortened.repr(value).split())


def beginning(text: str) -> str:
    """A text for a message: of a long one the beginning."""
    return text if len(text) <= 500 else f"{text[:500]}..."


#: Names beyond these are counted only.
MOST_LISTED = 20


def listed(words: Sequence[str]) -> str:
    """Words in quotes, not too many of them."""
    shown = ", ".join(f"'{word}'" for word in words[:MOST_LISTED])
    more = len(words) - MOST_LISTED
    return f"{shown} and {more} more" if more > 0 else shown
