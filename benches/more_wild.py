"""The 22 functions of Moré and Wild (SIAM J. Optim. 20, 2009) as residual vectors, from the published formulas: Moré,
Garbow and Hillstrom (ACM Trans. Math. Softw. 7, 1981) for 1 to 18, CUTEr for Bdqrtic, Cube, Mancino and Heart8."""

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Callable

import numpy as np
from scipy.optimize import least_squares

TABLE = Path(__file__).resolve().parents[2] / "shared" / "data" / "more_wild.csv"

BARD = np.array([0.14, 0.18, 0.22, 0.25, 0.29, 0.32, 0.35, 0.39, 0.37, 0.58, 0.73, 0.96, 1.34, 2.10, 4.39])
KOWALIK_V = np.array([4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625])
KOWALIK_Y = np.array([0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246])
MEYER = np.array(
    [34780, 28610, 23650, 19630, 16370, 13720, 11540, 9744, 8261, 7030, 6005, 5147, 4427, 3820, 3307, 2872], dtype=float
)
OSBORNE_1 = np.array(
    [0.844, 0.908, 0.932, 0.936, 0.925, 0.908, 0.881, 0.850, 0.818, 0.784, 0.751, 0.718, 0.685, 0.658, 0.628, 0.603, 0.580]
    + [0.558, 0.538, 0.522, 0.506, 0.490, 0.478, 0.467, 0.457, 0.448, 0.438, 0.431, 0.424, 0.420, 0.414, 0.411, 0.406]
)
OSBORNE_2 = np.array(
    [1.366, 1.191, 1.112, 1.013, 0.991, 0.885, 0.831, 0.847, 0.786, 0.725, 0.746, 0.679, 0.608, 0.655, 0.616, 0.606, 0.602]
    + [0.626, 0.651, 0.724, 0.649, 0.649, 0.694, 0.644, 0.624, 0.661, 0.612, 0.558, 0.533, 0.495, 0.500, 0.423, 0.395]
    + [0.375, 0.372, 0.391, 0.396, 0.405, 0.428, 0.429, 0.523, 0.562, 0.607, 0.653, 0.672, 0.708, 0.633, 0.668, 0.645]
    + [0.632, 0.591, 0.559, 0.597, 0.625, 0.739, 0.710, 0.729, 0.720, 0.636, 0.581, 0.428, 0.292, 0.162, 0.098, 0.054]
)


def start(number: int, n: int) -> np.ndarray:
    """The standard start."""
    fixed = {
        4: [-1.2, 1.0],
        5: [-1.0, 0.0, 0.0],
        6: [3.0, -1.0, 0.0, 1.0],
        7: [0.5, -2.0],
        9: [0.25, 0.39, 0.415, 0.39],
        10: [0.02, 4000.0, 250.0],
        12: [0.0, 10.0, 20.0],
        13: [0.3, 0.4],
        14: [25.0, 5.0, -5.0, -1.0],
        17: [0.5, 1.5, -1.0, 0.01, 0.02],
        18: [1.3, 0.65, 0.65, 0.7, 0.6, 3.0, 5.0, 7.0, 2.0, 4.5, 5.5],
        22: [-0.3, -0.39, 0.3, -0.344, -1.2, 2.69, 1.59, -1.5],
    }
    if number in fixed:
        return np.array(fixed[number])
    k = np.arange(1.0, n + 1.0)
    if number == 15:
        return k / (n + 1)
    if number == 21:
        return -8.710996e-4 * ((k - 50.0) ** 3 + _wave(np.sqrt(k[:, None] / k)).sum(axis=1))
    return np.full(n, 0.5 if number in (11, 16, 20) else 1.0)


def _wave(v: np.ndarray) -> np.ndarray:
    """Mancino's v (sin^5 ln v + cos^5 ln v)."""
    return v * (np.sin(np.log(v)) ** 5 + np.cos(np.log(v)) ** 5)


def residuals(number: int, m: int, x: np.ndarray) -> np.ndarray:
    """The residual vector of a function; its length is m."""
    n, i = len(x), np.arange(1.0, m + 1.0)
    if number == 1:  # linear, full rank
        return np.concatenate((x, np.zeros(m - n))) - (2.0 * x.sum() / m + 1.0)
    if number == 2:  # linear, rank 1
        return i * (np.arange(1, n + 1) @ x) - 1.0
    if number == 3:  # linear, rank 1 with zero columns and rows
        return np.where(i == m, 0.0, (i - 1.0) * (np.arange(2, n) @ x[1:-1])) - 1.0
    if number == 4:  # Rosenbrock
        return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
    if number == 5:  # helical valley
        if x[0] == 0.0:
            turn = math.copysign(0.25, x[1])
        else:
            turn = math.atan(x[1] / x[0]) / math.tau + (0.5 if x[0] < 0.0 else 0.0)
        return np.array([10.0 * (x[2] - 10.0 * turn), 10.0 * (math.hypot(x[0], x[1]) - 1.0), x[2]])
    if number == 6:  # Powell singular
        last = math.sqrt(10.0) * (x[0] - x[3]) ** 2
        return np.array([x[0] + 10.0 * x[1], math.sqrt(5.0) * (x[2] - x[3]), (x[1] - 2.0 * x[2]) ** 2, last])
    if number == 7:  # Freudenstein and Roth
        first = -13.0 + x[0] + ((5.0 - x[1]) * x[1] - 2.0) * x[1]
        return np.array([first, -29.0 + x[0] + ((1.0 + x[1]) * x[1] - 14.0) * x[1]])
    if number == 8:  # Bard
        return BARD - (x[0] + i / ((16.0 - i) * x[1] + np.minimum(i, 16.0 - i) * x[2]))
    if number == 9:  # Kowalik and Osborne
        return KOWALIK_Y - x[0] * KOWALIK_V * (KOWALIK_V + x[1]) / (KOWALIK_V * (KOWALIK_V + x[2]) + x[3])
    if number == 10:  # Meyer
        return x[0] * np.exp(x[1] / (45.0 + 5.0 * i + x[2])) - MEYER
    if number == 11:  # Watson
        t, j = (i[:29] / 29.0)[:, None], np.arange(n)
        slope = (j[1:] * x[1:] * t ** (j[1:] - 1)).sum(axis=1)
        value = (x * t**j).sum(axis=1)
        return np.concatenate((slope - value**2 - 1.0, [x[0], x[1] - x[0] ** 2 - 1.0]))
    if number == 12:  # Box, three-dimensional
        t = i / 10.0
        return np.exp(-t * x[0]) - np.exp(-t * x[1]) + x[2] * (np.exp(-i) - np.exp(-t))
    if number == 13:  # Jennrich and Sampson
        return 2.0 + 2.0 * i - np.exp(i * x[0]) - np.exp(i * x[1])
    if number == 14:  # Brown and Dennis
        t = i / 5.0
        return (x[0] + t * x[1] - np.exp(t)) ** 2 + (x[2] + x[3] * np.sin(t) - np.cos(t)) ** 2
    if number == 15:  # Chebyquad
        y = 2.0 * x - 1.0
        before, now, means = np.ones(n), y, np.empty(m)
        for k in range(m):
            means[k] = now.sum() / n
            before, now = now, 2.0 * y * now - before
        return means + np.where(i % 2 == 0, 1.0 / np.where(i % 2 == 0, i * i - 1.0, 1.0), 0.0)
    if number == 16:  # Brown, almost linear
        return np.append(x[:-1] + x.sum() - (n + 1.0), x.prod() - 1.0)
    if number == 17:  # Osborne 1
        t = 10.0 * (i - 1.0)
        return OSBORNE_1 - (x[0] + x[1] * np.exp(-t * x[3]) + x[2] * np.exp(-t * x[4]))
    if number == 18:  # Osborne 2
        t = (i - 1.0) / 10.0
        bells = sum(x[k] * np.exp(-x[k + 4] * (t - x[k + 7]) ** 2) for k in (1, 2, 3))
        return OSBORNE_2 - (x[0] * np.exp(-t * x[4]) + bells)
    if number == 19:  # Bdqrtic
        k, s = np.arange(n - 4), x**2
        return np.concatenate((3.0 - 4.0 * x[: n - 4], s[k] + 2 * s[k + 1] + 3 * s[k + 2] + 4 * s[k + 3] + 5 * s[-1]))
    if number == 20:  # Cube
        return np.concatenate(([x[0] - 1.0], 10.0 * (x[1:] - x[:-1] ** 3)))
    if number == 21:  # Mancino
        return 1400.0 * x + (i - 50.0) ** 3 + _wave(np.sqrt((x**2)[:, None] + i[:, None] / i)).sum(axis=1)
    if number == 22:  # Heart8
        a, b, c, d, t, u, v, w = x
        return np.array(
            [
                a + b + 0.69,
                c + d + 0.044,
                t * a + u * b - v * c - w * d + 1.57,
                v * a + w * b + t * c + u * d + 1.31,
                a * (t * t - v * v) - 2 * c * t * v + b * (u * u - w * w) - 2 * d * u * w + 2.65,
                c * (t * t - v * v) + 2 * a * t * v + d * (u * u - w * w) + 2 * b * u * w - 2.0,
                a * t * (t * t - 3 * v * v) + c * v * (v * v - 3 * t * t) + b * u * (u * u - 3 * w * w)
                + d * w * (w * w - 3 * u * u) + 12.6,
                c * t * (t * t - 3 * v * v) - a * v * (v * v - 3 * t * t) + d * u * (u * u - 3 * w * w)
                - b * w * (w * w - 3 * u * u) - 9.48,
            ]
        )  # fmt: skip
    raise ValueError(f"there is no function {number}")


@dataclass
class Problem:
    """A sum of squares with its start, its box (infinite where there is none) and the best value known."""

    name: str
    f: Callable[[np.ndarray], float]
    x0: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    best: float

    @property
    def n(self) -> int:
        return len(self.x0)


def cost(number: int, m: int) -> Callable[[np.ndarray], float]:
    """The sum of squares; not finite where a term overflows."""

    def f(x: np.ndarray) -> float:
        with np.errstate(all="ignore"):
            r = residuals(number, m, np.asarray(x, dtype=float))
            return float(r @ r)

    return f


def smooth() -> list[Problem]:
    """The 53 instances, with the best values of the table."""
    problems = []
    with TABLE.open() as file:
        for row in csv.DictReader(line for line in file if not line.startswith("#")):
            number, n, m, exponent = (int(row[key]) for key in ("nprob", "n", "m", "ns"))
            x0, free = start(number, n) * 10.0**exponent, np.full(n, np.inf)
            problems.append(Problem(f"{number}/{n}/{exponent}", cost(number, m), x0, -free, free, float(row["f_best"])))
    return problems


BOUNDED = [(4, 2, 2), (5, 3, 3), (6, 4, 4), (7, 2, 2), (8, 3, 15), (9, 4, 11), (12, 3, 10), (13, 2, 10), (14, 4, 20)]
BOUNDED += [(15, 6, 6), (16, 10, 10), (17, 5, 33), (19, 8, 8), (20, 5, 5), (22, 8, 8), (11, 6, 31)]


def bounded(active: bool) -> list[Problem]:
    """16 of the problems in boxes around start and minimum; `active` cuts every other coordinate before the minimum.
    The best value is that of bounded least squares from three starts."""
    problems = []
    for number, n, m in BOUNDED:
        x0 = start(number, n)

        def r(x: np.ndarray, number: int = number, m: int = m) -> np.ndarray:
            with np.errstate(all="ignore"):
                return np.nan_to_num(residuals(number, m, x), nan=1e100, posinf=1e100, neginf=-1e100)

        solve = dict(xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=3000, x_scale="jac")
        minimum = least_squares(r, x0, **solve).x
        half = np.maximum(1.5 * np.abs(minimum - x0), 0.5 * np.maximum(np.abs(x0), 0.1))
        lower, upper = np.minimum(x0, minimum) - half, np.maximum(x0, minimum) + half
        if active:
            for k in range(0, n, 2):
                cut = x0[k] + 0.6 * (minimum[k] - x0[k])
                if minimum[k] > x0[k]:
                    upper[k] = cut
                elif minimum[k] < x0[k]:
                    lower[k] = cut
        starts = (x0, 0.5 * (lower + upper), np.clip(minimum, lower, upper))
        inside = [np.clip(s, lower + 1e-9 * (upper - lower), upper - 1e-9 * (upper - lower)) for s in starts]
        best = min(2.0 * least_squares(r, s, bounds=(lower, upper), **solve).cost for s in inside)
        problems.append(Problem(f"{number}/{n}", cost(number, m), x0, lower, upper, best))
    return problems
