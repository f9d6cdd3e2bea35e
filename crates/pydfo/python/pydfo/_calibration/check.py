"""What does not fit between model, recordings and parameters, said before a fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, overload

from .. import _core


class Finding(NamedTuple):
    """Something that `Calibration.check` has found, or that is to be said of a fit or a validation."""

    severity: str
    """"error": nothing can be fitted as it is, or the result of a fit is not to be used; "warning": it is likely not what is meant, or a value is not to be relied on; "note":
    worth knowing."""
    subject: str
    """What it is about: a recording, a column, a variable, a parameter."""
    sentence: str
    """What was found, with its numbers."""
    remedy: str
    """What to do about it; may be empty."""
    origin: str
    """"problem" (model, recording, units, settings), "search" (where the parameters and the search ended) or "residuals" (residuals and
    standard errors): the former explain the latter, and stand before them."""


class Check(Sequence[Finding]):
    """What `Calibration.check` has found, causes and the gravest first, notes last: a sequence of `Finding`, true in a condition if there are any, notes
    included; ``print(check)`` shows a table.

    Attributes
    ----------
    ok : bool
        Whether there are no errors and no warnings: ``assert calibration.check().ok``.
    n_evaluations : int
        Evaluations that were made for it, each a simulation of every experiment.
    """

    def __init__(self, findings: list[dict[str, str]], table: str, n_evaluations: int, ok: bool) -> None:
        self._findings = tuple(Finding(**finding) for finding in findings)
        self._table = table
        self.n_evaluations = n_evaluations
        self.ok = ok

    @overload
    def __getitem__(self, index: int) -> Finding: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Finding, ...]: ...
    def __getitem__(self, index: int | slice) -> Finding | tuple[Finding, ...]:
        return self._findings[index]

    def __len__(self) -> int:
        return len(self._findings)

    def __str__(self) -> str:
        return self._table

    def __repr__(self) -> str:
        return f"<Check: {self._table.splitlines()[0]}>"

    def _repr_pretty_(self, printer: object, cycle: bool) -> None:
        """Shows the table at the end of a notebook's cell."""
        getattr(printer, "text")(self._table)


def of(calibration: _core.Calibration, simulate: bool, max_time: float | None) -> Check:
    """The check of a calibration."""
    return Check(*_core.check(calibration, simulate, max_time))
