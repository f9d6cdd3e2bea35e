"""Names of other tools that are refused: they can be imported, and say at their use why they cannot be had."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NoReturn


class NotProvided(NotImplementedError):
    """A function, argument or option of another tool that pydfo does not have; the message says what to use instead."""


def refuse(what: str, reason: str) -> NoReturn:
    """Raises what says that `what` is not provided, and why."""
    raise NotProvided(f"{what} is not provided: {reason}")


def refused(what: str, reason: str) -> Callable[..., NoReturn]:
    """A function that refuses."""

    def function(*args: Any, **kwargs: Any) -> NoReturn:
        refuse(what, reason)

    function.__name__ = function.__qualname__ = what.rpartition(".")[2]
    function.__doc__ = f"Not provided: {reason}"
    return function


def hand_out(owner: str, reasons: Mapping[str, str]) -> Callable[[str], Any]:
    """The ``__getattr__`` of a module: its refused names."""

    def get(name: str) -> Any:
        if name in reasons:
            return refused(f"{owner}.{name}", reasons[name])
        raise AttributeError(f"module {owner!r} has no attribute {name!r}")

    return get
