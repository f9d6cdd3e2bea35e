"""Unsupported names of other tools. They can be imported, and raise an error with the reason when they are used."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NoReturn


class NotProvided(NotImplementedError):
    """A function, argument or option of another tool that pydfo does not provide. The message suggests an
    alternative."""


def refuse(what: str, reason: str) -> NoReturn:
    """Raises an error that `what` is not provided, with the reason."""
    raise NotProvided(f"{what} is not provided: {reason}")


def refused(what: str, reason: str) -> Callable[..., NoReturn]:
    """Returns a function that raises `NotProvided`."""

    def function(*args: Any, **kwargs: Any) -> NoReturn:
        refuse(what, reason)

    function.__name__ = function.__qualname__ = what.rpartition(".")[2]
    function.__doc__ = f"Not provided: {reason}"
    return function


def hand_out(owner: str, reasons: Mapping[str, str]) -> Callable[[str], Any]:
    """Returns a ``__getattr__`` for a module, which provides its unsupported names."""

    def get(name: str) -> Any:
        if name in reasons:
            return refused(f"{owner}.{name}", reasons[name])
        raise AttributeError(f"module {owner!r} has no attribute {name!r}")

    return get
