"""Values and names for messages."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Sequence

from .. import _core

_shortened = reprlib.Repr()
_shortened.maxstring = _shortened.maxother = 80


def line(text: str) -> str:
    r"""Returns a name or another string as one line, with line breaks, escapes and similar characters as their
    numbers (``\u{1b}``)."""
    try:
        return _core.visible_line(text)
    except UnicodeEncodeError:
        # The string contains half of a surrogate pair.
        return _core.visible_line(text.encode(errors="backslashreplace").decode())


def names(words: Iterable[str]) -> str:
    """Returns names separated by commas."""
    return line(", ".join(words))


def show(value: object) -> str:
    """Returns a value for a message; a long value is truncated."""
    return " ".join(_shortened.repr(value).split())


def beginning(text: str) -> str:
    """Returns a string for a message; a long string is truncated."""
    return text if len(text) <= 500 else f"{text[:500]}..."


#: Maximum number of names listed. Further names are only counted.
MOST_LISTED = 20


def listed(words: Sequence[str]) -> str:
    """Returns quoted words, at most `MOST_LISTED` of them."""
    shown = ", ".join(f"'{line(word)}'" for word in words[:MOST_LISTED])
    more = len(words) - MOST_LISTED
    return f"{shown} and {more} more" if more > 0 else shown
