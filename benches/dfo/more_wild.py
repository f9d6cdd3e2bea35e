"""The 22 functions of Moré and Wild (SIAM J. Optim. 20, 2009) as residual vectors, from the published formulas.

Sources: Moré, Garbow and Hillstrom (ACM Trans. Math. Softw. 7, 1981) for 1 to 18, CUTEr for Bdqrtic, Cube, Mancino
and Heart8."""

import dataclasses
import math
from functools import partial

import numpy as np
from problem import Array, Problem, sum_of_squares
from scipy.optimize import least_squares

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
    """Returns the standard start."""
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
    """Returns the residual vector of a function; its length is m."""
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

# Number of the function, n, m, exponent of the scale of the start, best known sum of squares.
INSTANCES = [
    (1, 9, 45, 0, 35.99999999999998), (1, 9, 45, 1, 35.99999999999997), (2, 7, 35, 0, 8.380281690140844),
    (2, 7, 35, 1, 8.380281690140844), (3, 7, 35, 0, 9.880597014925371), (3, 7, 35, 1, 9.880597014925371),
    (4, 2, 2, 0, 0.0), (4, 2, 2, 1, 0.0), (5, 3, 3, 0, 0.0), (5, 3, 3, 1, 0.0), (6, 4, 4, 0, 1.0837888763552525e-72),
    (6, 4, 4, 1, 3.9911429117656076e-70), (7, 2, 2, 0, 1.3762381623173845), (7, 2, 2, 1, 0.0),
    (8, 3, 15, 0, 0.008214877306578954), (8, 3, 15, 1, 0.008214877306578957), (9, 4, 11, 0, 0.0003075056038492367),
    (10, 3, 16, 0, 87.94585517045806), (11, 6, 31, 0, 0.002287670053552378), (11, 6, 31, 1, 0.0022876700535524),
    (11, 9, 31, 0, 1.3997601380947563e-06), (11, 9, 31, 1, 1.399760138206813e-06),
    (11, 12, 31, 0, 4.722381274184104e-10), (11, 12, 31, 1, 4.722383722478784e-10), (12, 3, 10, 0, 0.0),
    (13, 2, 10, 0, 124.36218235561476), (14, 4, 20, 0, 85822.20162635627), (14, 4, 20, 1, 85822.20162635625),
    (15, 6, 6, 0, 5.966236728414598e-32), (15, 7, 7, 0, 6.915267641132454e-32), (15, 8, 8, 0, 0.003516873725677939),
    (15, 9, 9, 0, 4.324975873646821e-32), (15, 10, 10, 0, 0.004772713696375357),
    (15, 11, 11, 0, 0.0027997615518657727), (16, 10, 10, 0, 0.0), (17, 5, 33, 0, 5.4648946974826946e-05),
    (18, 11, 65, 0, 0.04013773629354773), (18, 11, 65, 1, 0.9843748684995508), (19, 8, 8, 0, 10.238973421317436),
    (19, 10, 12, 0, 18.281161753593537), (19, 11, 14, 0, 22.260591734883757), (19, 12, 16, 0, 26.272766396793962),
    (20, 5, 5, 0, 0.0), (20, 6, 6, 0, 4.216780360674508e-10), (20, 8, 8, 0, 9.783574632801898e-07),
    (21, 5, 5, 0, 2.6823673963376067e-22), (21, 5, 5, 1, 2.6823673963376067e-22),
    (21, 8, 8, 0, 4.199242156349399e-22), (21, 10, 10, 0, 2.0641064340039047e-22),
    (21, 12, 12, 0, 1.3221722765707218e-22), (21, 12, 12, 1, 1.3221722765707218e-22),
    (22, 8, 8, 0, 3.402155246760052e-30), (22, 8, 8, 1, 3.352851440183739e-30),
]

BOUNDED = [(4, 2, 2), (5, 3, 3), (6, 4, 4), (7, 2, 2), (8, 3, 15), (9, 4, 11), (12, 3, 10), (13, 2, 10), (14, 4, 20)]
BOUNDED += [(15, 6, 6), (16, 10, 10), (17, 5, 33), (19, 8, 8), (20, 5, 5), (22, 8, 8), (11, 6, 31)]

SIGMA = 1e-3


def smooth() -> list[Problem]:
    """Returns the 53 instances. Their index in the list is their number: even ones are for tuning, odd ones for
    assessment."""
    problems = []
    for k, (number, n, m, exponent, best) in enumerate(INSTANCES):
        free, of = np.full(n, np.inf), partial(residuals, number, m)
        x0 = start(number, n) * 10.0**exponent
        problems.append(Problem(f"{number}/{n}/{exponent}", k, x0, -free, free, best, residuals=of))
    return problems


def stochastic(values: Array, rng: np.random.Generator, x: Array) -> Array:
    """Multiplies each residual by 1 + 1e-3 u, u uniform in [-sqrt 3, sqrt 3], as in Moré and Wild's tests with
    noise."""
    return values * (1.0 + SIGMA * rng.uniform(-math.sqrt(3.0), math.sqrt(3.0), len(values)))


def deterministic(values: Array, rng: np.random.Generator, x: Array) -> Array:
    """Adds relative noise that is a function of x: their cubic Chebyshev polynomial of sines and cosines of norms of
    100 x."""
    norms = (np.abs(x).sum(), np.abs(x).max(), math.sqrt(float(x @ x)))
    phi = 0.9 * math.sin(100.0 * norms[0]) * math.cos(100.0 * norms[1]) + 0.1 * math.cos(norms[2])
    return values * math.sqrt(max(0.0, 1.0 + SIGMA * phi * (4.0 * phi * phi - 3.0)))


def noisy(kind: str) -> list[Problem]:
    """Returns the smooth problems with relative noise of 1e-3; they are assessed without it."""
    disturb = {"stochastic": stochastic, "deterministic": deterministic}[kind]
    return [dataclasses.replace(p, disturb=disturb) for p in smooth()]


def _absolute(number: int, m: int, x: Array) -> float:
    """Returns the sum of absolute residuals; Moré and Wild clip x at 0 for some problems."""
    with np.errstate(all="ignore"):
        r = residuals(number, m, np.maximum(x, 0.0) if number in (8, 9, 13, 16, 17, 18) else x)
        cost = float(np.abs(r).sum())
    return cost if np.isfinite(cost) else np.inf


def nonsmooth() -> list[Problem]:
    """Returns the sums of absolute residuals; the best value comes from the solvers of a run."""
    problems = []
    for k, (number, n, m, exponent, _) in enumerate(INSTANCES):
        free, x0 = np.full(n, np.inf), start(number, n) * 10.0**exponent
        cost = partial(_absolute, number, m)
        problems.append(Problem(f"|{number}|/{n}/{exponent}", k, x0, -free, free, np.inf, cost=cost))
    return problems


def bounded(active: bool) -> list[Problem]:
    """Returns 16 of the problems in boxes around start and minimum; `active` cuts every other coordinate before the
    minimum.

    The best value comes from bounded least squares from three starts, and from the solvers of a run."""
    problems = []
    for place, (number, n, m) in enumerate(BOUNDED):
        x0 = start(number, n)

        def r(x: Array, number: int = number, m: int = m) -> Array:
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
        best = min(sum_of_squares(least_squares(r, s, bounds=(lower, upper), **solve).fun) for s in inside)
        of = partial(residuals, number, m)
        problems.append(Problem(f"{number}/{n}", place, x0, lower, upper, best, residuals=of))
    return problems


def failing() -> list[Problem]:
    """Returns the bounded problems with minima inside that fail beyond a random plane through the box.

    Start and minimum are on the other side of the plane (seed: the number of the problem). The list also contains
    Rosenbrock's function with three failing regions near the path."""
    problems = []
    for p in bounded(False):
        rng, of = np.random.default_rng([7, p.number]), p.residuals
        assert of is not None
        minimum = least_squares(of, p.x0, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac").x
        normal = rng.normal(size=p.n) / (p.upper - p.lower)
        reach = max(normal @ p.x0, normal @ minimum)
        corner = np.where(normal > 0, p.upper, p.lower) @ normal
        level = reach + 0.1 * (corner - reach)
        fails = partial(lambda normal, level, x: bool(normal @ x > level), normal, level)
        problems.append(dataclasses.replace(p, name=f"failing {p.name}", fails=fails))
    box = np.full(2, 2.0)
    problems.append(
        Problem(
            "failing regions", 17, np.array([-0.5, 1.0]), -box, box, 0.0, residuals=partial(residuals, 4, 2),
            fails=lambda x: bool(x[0] + x[1] < -0.2 or (x[0] > 0.2 and x[1] < 0.02) or x[1] > 1.6),
        )
    )  # fmt: skip
    return problems
