"""Numbers with the names of parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt


class NamedValues(dict[str, float]):
    """Numbers by name. ``np.asarray`` returns them in order."""

    def to_dict(self) -> dict[str, float]:
        """Returns the numbers by name as a dict, for example for ``json.dumps``."""
        return dict(self)

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.array(list(self.values()), dtype=dtype)


class NamedArray(np.ndarray[Any, np.dtype[np.float64]]):
    """Array whose entries have names: ``a["k"]``, ``a.get("k")``, ``a.keys()``, ``a.values()``, ``a.items()``,
    ``a.to_dict()``. Results of calculations and slices are arrays without names.

    Parameters
    ----------
    values : mapping of str to float
        Numbers by name.

    Examples
    --------
    >>> errors = NamedArray({"k": 0.1, "x": 0.2})
    >>> errors["x"], errors[0], 2 * errors
    (0.2, np.float64(0.1), array([0.2, 0.4]))
    """

    names: tuple[str, ...]
    """Names of the entries."""

    def __new__(cls, values: Mapping[str, float]) -> NamedArray:
        named = np.array(list(values.values()), dtype=np.float64).view(cls)
        named.names = tuple(values)
        return named

    def __array_finalize__(self, other: object) -> None:
        self.names = ()

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        return np.asarray(array)[()]

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str):
            if key not in self.names:
                raise KeyError(f"{key!r} is not among the names {', '.join(self.names) or '(the results of calculations have none)'}")
            return dict(self.items())[key]
        return np.asarray(self)[key]

    def __contains__(self, key: Any) -> bool:
        return key in self.names if isinstance(key, str) else key in np.asarray(self)

    def __repr__(self) -> str:
        return repr(dict(self.items())) if self.names else repr(np.asarray(self))

    def keys(self) -> tuple[str, ...]:
        """Returns the names."""
        return self.names

    def values(self) -> list[float]:
        """Returns the numbers."""
        return self.tolist()  # type: ignore[no-any-return]

    def get(self, name: str, default: Any = None) -> Any:
        """Returns the number with this name, or `default` if there is none."""
        return self[name] if name in self.names else default

    def to_dict(self) -> dict[str, float]:
        """Returns the numbers by name as a dict, for example for ``json.dumps``."""
        return dict(self.items())

    def items(self) -> Iterator[tuple[str, float]]:
        """Returns pairs of name and number."""
        return zip(self.names, self.tolist())
