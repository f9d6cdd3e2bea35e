"""Mismatches between model, recordings and parameters, found before a fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, overload

from .. import _core


class Finding(NamedTuple):
    """A finding of `Calibration.check`, or a remark on a fit or a validation."""

    severity: str
    """"error": a fit is impossible, or its result should not be used; "warning": the setup is probably not as
    intended, or a value is unreliable; "note": useful information."""
    subject: str
    """Subject of the finding: a recording, a column, a variable or a parameter."""
    sentence: str
    """Description of the finding with its numbers."""
    remedy: str
    """Suggested remedy; may be empty."""
    origin: str
    """"problem" (model, recording, units, settings), "search" (end of the parameters and the search) or "residuals"
    (residuals and standard errors). Earlier categories explain later ones and precede them."""
    id: str
    """Identifier of the kind of finding, such as "F012". The page Findings of the documentation lists all of them."""

    @property
    def name(self) -> str:
        """Name of the kind of finding, such as "autocorrelated-residuals"."""
        return _core.name_of_finding(self.id)


class Check(Sequence[Finding]):
    """The findings of `Calibration.check`: a sequence of `Finding`.

    Causes come first, more severe findings before less severe ones, and notes last. The sequence is true in a
    condition if it contains any finding, including notes. ``print(check)`` shows a table.

    Attributes
    ----------
    ok : bool
        True if there are no errors and no warnings: ``assert calibration.check().ok``.
    n_evaluations : int
        Number of evaluations for the check, each a simulation of every experiment.
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
    """Returns the check of a calibration."""
    return Check(*_core.check(calibration, simulate, max_time))
