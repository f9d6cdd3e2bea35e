"""Types of the native module."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from ._options import Options
from ._progress import Progress
from ._result import OptimizeResult

__version__: str

def minimize(
    func: Callable[[npt.NDArray[np.float64]], Any],
    x0: npt.NDArray[np.float64],
    lower: npt.NDArray[np.float64],
    upper: npt.NDArray[np.float64],
    options: Options,
    *,
    tolerant: bool = False,
    observer: Callable[[Progress], Any] | None = None,
    detail: bool = False,
) -> OptimizeResult: ...
