"""Values and names as messages show them."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Sequence

from .. import _core

_shortened = reprlib.Repr()
_shortened.maxstring = _shortened.maxother = 80


def line(text: str) -> str:
    """A name or another text of one line, with line breaks, escapes and the like as their numbers (``\\u{1b}``)."""
    try:
        return _core.visible_line(text)
    except UnicodeEncodeError:
        # Half of a surrogate pair.
        return _core.visible_line(text.encode(errors="backslashreplace").decode())


def names(words: Iterable[str]) -> str:
    """Names with commas between them."""
    return line(", ".join(words))


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
    shown = ", ".join(f"'{line(word)}'" for word in words[:MOST_LISTED])
    more = len(words) - MOST_LISTED
    return f"{shown} and {more} more" if more > 0 else shown
