"""The simulations of a fit on an executor: the data sent, and their handling in the receiving process.

A task contains a point and the key of its problem. A process that lacks the problem reports this. The point is then
sent again together with the problem. Other points that the process returns wait until this point is evaluated. A
process that cannot find the model at its path receives the file and stores it for all processes of its machine.
"""

from __future__ import annotations

import concurrent.futures
import hashlib
import os
import socket
import tempfile
import threading
import time
import uuid
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .. import _core
from .._errors import PydfoError
from .._optimize import evaluate as _evaluate

if TYPE_CHECKING:
    from .calibration import Calibration

#: Maximum number of models stored on a machine.
MOST_MODELS = 8

#: Maximum size in bytes of the problems that a process keeps, apart from the most recent one.
MOST_BYTES = 1 << 28

#: Problems that this process has received, with their sizes in bytes. The most recently used one is the last.
_problems: dict[str, tuple[Any, int]] = {}
_lock = threading.Lock()


class Problem(NamedTuple):
    """Data that a process needs to simulate: the state of a calibration, options to open its model, input
    functions."""

    state: bytes
    opened: Any
    functions: Any
    #: Content of the model, if it must be sent.
    model: bytes | None = None

    def open(self) -> Any:
        """Returns the native calibration. Raises FileNotFoundError if the model is not on this machine."""
        path, content = _core.Calibration.model_of(self.state)
        # Another machine may have another model at the same path.
        fmu = self._opened_at(path)
        if fmu is None or fmu.content_hash != content:
            fmu = _core.Fmu(_kept_model(content, self.model), self.opened)
        return _core.Calibration.restore(self.state, fmu, self.functions)

    def _opened_at(self, path: Path) -> Any:
        """Returns the FMU at a path of this machine; None if there is none."""
        try:
            return _core.Fmu(path, self.opened)
        except (PydfoError, OSError):
            return None


class Deadline(NamedTuple):
    """End of a fit with a time limit: clock time on its machine, and seconds after the task was sent."""

    at: float
    machine: str
    seconds: float

    def left(self) -> float:
        """Returns the remaining time for a task in s. Clocks of two machines are not compared."""
        return self.at - time.time() if self.machine == socket.gethostname() else self.seconds


class Missing(NamedTuple):
    """The data that a process lacks: "problem" or "model"."""

    what: str
    machine: str
    #: Id of the process that lacks a problem; 0 for a model, which all processes of the machine share.
    process: int


def _kept_model(content: str, model: bytes | None) -> Path:
    """Returns the path of a model sent to this machine."""
    folder = Path(tempfile.gettempdir()) / f"fmufit-models-{os.getuid() if hasattr(os, 'getuid') else os.getlogin()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.is_symlink() or (hasattr(os, "getuid") and folder.stat().st_uid != os.getuid()):
        raise PermissionError(f"{folder} belongs to another user")
    place = folder / f"{content}.fmu"
    if not place.exists():
        if model is None:
            raise FileNotFoundError(os.fspath(place))
        if hashlib.sha256(model).hexdigest() != content:
            raise RuntimeError("the file of the model has changed since the calibration was created; create the calibration again")
        with tempfile.NamedTemporaryFile(dir=folder, suffix=".part", delete=False) as file:
            file.write(model)
        os.replace(file.name, place)
        kept = sorted(folder.glob("*.fmu"), key=lambda path: path.stat().st_mtime)
        for old in kept[:-MOST_MODELS]:
            old.unlink(missing_ok=True)
    return place


def simulate(
    version: str, key: str, problem: Problem | None, x: Any, cutoff: float, loss: bytes, deadline: Deadline | None = None
) -> tuple[float, bytes] | Missing:
    """Runs a task and returns its run time and its answer, or the data that this process lacks."""
    start = time.perf_counter()
    if version != _core.__version__:
        raise ImportError(f"{socket.gethostname()} has fmufit {_core.__version__}, but the fit was started with {version}. Install the same version.")
    opened = _kept_problem(key)
    if opened is None:
        if problem is None:
            return Missing("problem", socket.gethostname(), os.getpid())
        try:
            opened = problem.open()
        except FileNotFoundError:
            if problem.model is not None:
                raise
            return Missing("model", socket.gethostname(), 0)
        _keep_problem(key, opened, len(problem.state))
    answer = opened.answer(np.ascontiguousarray(x), cutoff, loss, deadline and deadline.left())
    return time.perf_counter() - start, answer


def _kept_problem(key: str) -> Any:
    """Returns a problem that this process has received, and marks it as used; None if there is none."""
    with _lock:
        if key not in _problems:
            return None
        _problems[key] = found = _problems.pop(key)
        return found[0]


def _keep_problem(key: str, problem: Any, size: int) -> None:
    """Keeps a problem, and drops the least recently used ones if all together are too large."""
    with _lock:
        _problems[key] = problem, size
        while len(_problems) > 1 and sum(size for _, size in _problems.values()) > MOST_BYTES:
            del _problems[next(iter(_problems))]


class Simulations(_evaluate.Futures):
    """Sends the points of a fit to an executor."""

    def __init__(self, calibration: Calibration, executor: concurrent.futures.Executor, max_time: float | None) -> None:
        super().__init__(_no_function, executor)
        self._end = None if max_time is None else time.time() + max_time
        self._calibration = calibration
        self._tasks: dict[int, tuple[Any, ...]] = {}
        #: The data under way to a process: the point with which they travel, and the points that wait for them.
        self._under_way: dict[Missing, tuple[int, list[int]]] = {}

    def begin(self, state: bytes, loss: bytes) -> None:
        """Sets the problem of all following points."""
        self._problem = Problem(state, self._calibration._opened, self._calibration._functions)
        # A hash cannot distinguish input functions.
        function_id = uuid.uuid4().bytes if self._calibration._functions else b""
        self._key = hashlib.sha256(state + function_id).hexdigest()
        self._loss = loss

    def _send(self, number: int, problem: Problem | None) -> None:
        key, *point = self._tasks[number]
        self._begin_task(number, simulate, _core.__version__, key, problem, *point)

    def submit(self, number: int, x: Any, cutoff: float) -> None:
        """Starts the evaluation of a point."""
        deadline = self._end and Deadline(self._end, socket.gethostname(), self._end - time.time())
        self._tasks[number] = (self._key, x, cutoff, self._loss, deadline)
        self._send(number, None)

    def poll(self, seconds: float) -> tuple[int, float, Any, str] | None:
        """Extends the base method: sends the data that a process lacks."""
        polled = super().poll(seconds)
        if polled is None:
            return None
        number, took, value, fault = polled
        for missing, (carrier, waiting) in list(self._under_way.items()):
            if carrier == number:
                del self._under_way[missing]
                for point in waiting:
                    self._send(point, None)
        if not isinstance(value, Missing):
            self._tasks.pop(number, None)
            return polled
        if value in self._under_way:
            self._under_way[value][1].append(number)
            return None
        problem = self._problem
        if value.what == "model":
            path, _ = _core.Calibration.model_of(problem.state)
            if os.path.isdir(path):
                self._tasks.pop(number, None)
                why = FileNotFoundError(
                    f"{path} is a folder, which cannot be sent to {value.machine}; use the .fmu file, or a folder that all machines can read"
                )
                return number, took, why, "broken"
            problem = problem._replace(model=Path(path).read_bytes())
        self._under_way[value] = number, []
        self._send(number, problem)
        return None

    def cancel(self, number: int) -> None:
        """Abandons a point; a running evaluation continues."""
        for _, waiting in self._under_way.values():
            if number in waiting:
                waiting.remove(number)
                self._began(number, concurrent.futures.Future())
        super().cancel(number)


def _no_function(x: Any) -> Any:
    raise NotImplementedError
