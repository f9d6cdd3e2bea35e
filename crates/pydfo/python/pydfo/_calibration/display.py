"""Display of a running fit: a live line, printed lines, a page for a browser."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from typing import TYPE_CHECKING

from .._args import values as _values
from .._optimize.fmin import Callback, combine, listen
from .._optimize.live_line import DELAY, LiveLine, is_watched
from .._optimize.pareto_front import ParetoFront
from .._optimize.progress import Printer

if TYPE_CHECKING:
    from .. import _core
    from .fit import Fit
    from .settings import Limits


class Display:
    """Shows a running fit according to the arguments `disp`, `watch` and `callback` of `Calibration.fit`."""

    def __init__(self, names: list[str], disp: bool | None, watch: bool, callback: Callback | None, limits: Limits) -> None:
        self._disp = disp if disp is None else _values.flag("disp", disp)
        self._printer = Printer(names)
        self._page: _core.LivePage | None = None
        self._live: LiveLine | None = None
        self._watch = _values.flag("watch", watch)
        listeners: list[Callback] = []
        if self._disp is not False and is_watched():
            delay = DELAY if self._disp is None else 0.0
            self._live = LiveLine(names, delay, limits.max_evaluations, limits.max_iterations, limits.max_time)
            listeners.append(self._live)
        elif self._disp:
            listeners.append(self._printer)
        if callback is not None:
            listeners.append(listen(callback))
        self.observer = combine(listeners)
        if self._live:
            # The function is also called between iterations.
            setattr(self.observer, "tick", self._live.tick)

    @property
    def page_opened(self) -> Callable[[_core.LivePage], None] | None:
        """Function that receives the page for the browser; None if no page is requested."""
        return self._open if self._watch else None

    def _open(self, page: _core.LivePage) -> None:
        self._page = page
        print(f"watch the fit at {page.url}", file=sys.stderr, flush=True)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Closes the live line at the end. An exception is shown on the page."""
        try:
            with closing(self._live) if self._live else nullcontext():
                yield
        except BaseException as e:
            if self._page is not None:
                self._page.show_error(f"{type(e).__name__}: {e}")
            raise

    def end(self, fit: Fit | ParetoFront) -> None:
        """Reports how the fit ended. The page is served as long as the fit exists."""
        if self._page is not None:
            setattr(fit, "_page", self._page)
        if not self._disp:
            return
        if isinstance(fit, ParetoFront):
            print(fit)
            return
        if fit.preflight is not None:
            print(fit.preflight)
        self._printer.end(fit.message, fit.x, fit.cost, fit.nit, fit.nfev, fit.solve_time)
