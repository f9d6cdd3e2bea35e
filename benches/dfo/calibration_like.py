"""Typical engineering fits: kinetics, growth, oscillators, thermal, friction.

The models are formulas and ordinary differential equations with parameters of sizes from 1e-6 to 1e6, three starts
each, with and without bounds. Everything is generated with SEED: measurement noise, starts and boxes. The noise has a
normal deviation of 1 % of the range of each output. A start is each parameter times a factor between 1 / 2.5 and 2.5.
Each side of a box is between 2 and 6 times the distance to the farther of truth and start. For every third parameter,
the box ends before the minimum, so that a bound is active. Even numbers are for tuning, odd ones for assessment.
Residuals are in units of the range of their output. The data differ from tests/problems/calibration.rs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, partial

import numpy as np
from problem import Array, Problem, sum_of_squares
from scipy.optimize import least_squares

SEED = 4711
N_STARTS = 3
Model = Callable[[Sequence[float]], Array]
Rhs = Callable[[Sequence[float], float, Sequence[float]], Sequence[float]]


def curve(low: float, high: float, f: Callable[..., Array], samples: int = 40) -> Model:
    """Returns a formula at equidistant points."""
    t = np.linspace(low, high, samples)
    return lambda p: np.asarray(f(t, *p), dtype=float)[:, None]


def system(end: float, start: Sequence[float], rhs: Rhs, samples: int = 25, steps: int = 8) -> Model:
    """Returns all states of an ordinary differential equation at equidistant times, from classical Runge-Kutta
    steps."""
    h = end / (samples * steps)

    def model(p: Sequence[float]) -> Array:
        y, t, rows = list(start), 0.0, []
        p = [float(v) for v in p]
        for _ in range(samples):
            for _ in range(steps):
                k1 = rhs(p, t, y)
                k2 = rhs(p, t + h / 2, [a + h / 2 * b for a, b in zip(y, k1)])
                k3 = rhs(p, t + h / 2, [a + h / 2 * b for a, b in zip(y, k2)])
                k4 = rhs(p, t + h, [a + h * b for a, b in zip(y, k3)])
                y = [a + h / 6 * (b + 2 * c + 2 * d + e) for a, b, c, d, e in zip(y, k1, k2, k3, k4)]
                t += h
            rows.append(y)
        return np.array(rows)

    return model


def root(h: float) -> float:
    """Returns the square root; 0 below 0."""
    return math.sqrt(max(h, 0.0))


def _stribeck(v: Array, level: float, peak: float, speed: float, slope: float) -> Array:
    return np.sign(v) * (level + (peak - level) * np.exp(-((v / speed) ** 2))) + slope * v


def _monod(p: Sequence[float], t: float, y: Sequence[float]) -> Sequence[float]:
    rate = p[0] * y[1] / (p[1] + y[1]) * y[0]
    return rate, -rate / p[2]


def _thermal(p: Sequence[float], t: float, y: Sequence[float]) -> Sequence[float]:
    heat = 200.0 if t < 3e4 else 0.0
    return (p[2] * (y[1] - y[0]) - p[3] * (y[0] - 20.0)) / p[0], (heat - p[2] * (y[1] - y[0])) / p[1]


def _tanks(p: Sequence[float], t: float, y: Sequence[float]) -> Sequence[float]:
    first, second = p[0] * root(19.62 * y[0]), p[1] * root(19.62 * y[1])
    return ((p[2] if t < 300.0 else 0.3 * p[2]) - first) / 2.8e-3, (first - second) / 2.8e-3


def _exchanger(p: Sequence[float], t: float, y: Sequence[float]) -> Sequence[float]:
    return (p[0] * (90.0 - y[0]) - p[1] * (y[0] - y[1])) / 4e3, (p[2] * (15.0 - y[1]) + p[1] * (y[0] - y[1])) / 6e3


# The name, the parameters that generated the data, and the model.
MODELS: list[tuple[str, list[float], Model]] = [
    ("logistic growth", [1e6, 1e-2, 400.0], curve(0, 1000, lambda t, a, b, c: a / (1 + np.exp(-b * (t - c))))),
    ("Gompertz growth", [5e4, 4.0, 0.05], curve(0, 100, lambda t, a, b, c: a * np.exp(-b * np.exp(-c * t)))),
    ("two decays", [10.0, 1.2, 4.0, 0.05], curve(0, 30, lambda t, a, b, c, d: a * np.exp(-b * t) + c * np.exp(-d * t))),
    ("Michaelis and Menten", [3e-6, 2e-4], curve(0, 1e-3, lambda s, v, k: v * s / (k + s))),
    ("substrate inhibition", [120.0, 0.3, 8.0], curve(0, 30, lambda s, v, k, i: v * s / (k + s + s * s / i))),
    ("Hill", [90.0, 1e-5, 2.2], curve(1e-7, 4e-5, lambda c, top, half, h: top / (1 + (half / c) ** h))),
    ("damped oscillation", [0.2, 0.4, 6.0], curve(0, 4, lambda t, a, d, w: a * np.exp(-d * t) * np.cos(w * t))),
    ("ringing", [1e-3, 50.0, 900.0, 0.3], curve(0, 0.01, lambda t, a, d, w, p: a * np.exp(-d * t) * np.cos(w * t + p))),
    ("Arrhenius", [1e-3, 6e4], curve(300, 400, lambda t, k, e: k * np.exp(e / 8.314 * (1 / 350 - 1 / t)))),
    ("Antoine", [8.0, 1700.0, 230.0], curve(0, 100, lambda t, a, b, c: a - b / (c + t))),
    ("Stribeck friction", [10.0, 14.0, 0.05, 30.0], curve(0.001, 0.4, _stribeck)),
    ("van Genuchten", [0.05, 0.43, 0.036, 1.56],
     curve(1, 500, lambda h, r, s, a, n: r + (s - r) * (1 + (a * h) ** n) ** (1 / n - 1))),
    ("cooling", [0.0024, 293.0, 370.0], curve(0, 2000, lambda t, k, low, high: low + (high - low) * np.exp(-k * t))),
    ("two peaks", [8.0, 3.0, 1.0, 5.0, 7.0, 1.5],
     curve(0, 12, lambda t, a, b, c, d, e, f: a * np.exp(-(((t - b) / c) ** 2)) + d * np.exp(-(((t - e) / f) ** 2)))),
    ("power law", [3e-5, 2.7], curve(10, 100, lambda t, a, b: a * t**b)),
    ("Swift hardening", [6e5, 2e-3, 0.2], curve(0, 0.2, lambda e, k, e0, n: k * (e0 + e) ** n)),
    ("Lotka and Volterra", [0.6, 0.025, 0.8, 0.02], system(
        12.0, [30.0, 10.0], lambda p, t, y: (p[0] * y[0] - p[1] * y[0] * y[1], p[3] * y[0] * y[1] - p[2] * y[1]))),
    ("epidemic", [4e-7, 0.1], system(
        80.0, [1e6, 10.0], lambda p, t, y: (-p[0] * y[0] * y[1], p[0] * y[0] * y[1] - p[1] * y[1]))),
    ("chain of reactions", [0.8, 0.2], system(
        15.0, [1.0, 0.0], lambda p, t, y: (-p[0] * y[0], p[0] * y[0] - p[1] * y[1]))),
    ("pendulum with friction", [9e-3, 2e-3, 0.21], system(4.0, [1.2, 0.0], lambda p, t, y: (
        y[1], -9.81 / p[2] * math.sin(y[0]) - 20.0 * (p[0] * y[1] + p[1] * math.tanh(y[1] / 0.05))))),
    ("two tanks", [7e-6, 5e-6, 3e-5], system(600.0, [0.3, 0.1], _tanks)),
    ("van der Pol", [1.5, 2.0], system(
        6.0, [1.0, 0.0], lambda p, t, y: (y[1], p[0] * (1.0 - y[0] * y[0]) * y[1] - p[1] * y[0]))),
    ("Monod growth", [0.4, 0.05, 0.5], system(12.0, [0.05, 2.0], _monod)),
    ("two thermal masses", [1e5, 2e4, 30.0, 5.0], system(6e4, [20.0, 20.0], _thermal)),
    ("hardening spring", [0.3, 40.0, 2e4], system(2.0, [0.05, 0.0], lambda p, t, y: (
        y[1], -p[0] * y[1] - p[1] * y[0] - p[2] * y[0] ** 3))),
    ("Brusselator", [1.0, 2.5], system(8.0, [1.0, 1.5], lambda p, t, y: (
        p[0] + y[0] * y[0] * y[1] - (p[1] + 1.0) * y[0], p[1] * y[0] - y[0] * y[0] * y[1]))),
    ("heat exchanger", [30.0, 55.0, 40.0], system(900.0, [20.0, 15.0], _exchanger)),
    ("friction slide", [2e-3, 0.35, 1.4], system(3.0, [0.0, 2.0], lambda p, t, y: (
        y[1], 1.5 * math.sin(2.0 * t) - p[1] * math.tanh(y[1] / 0.02) - p[2] * y[1] - p[0] * y[1] ** 3))),
]  # fmt: skip


def _residuals(model: Model, data: Array, unit: Array, x: Array) -> Array:
    """Returns simulated minus measured values, in units of the ranges; infinite if the model has no value."""
    try:
        with np.errstate(all="ignore"):
            return ((model(x) - data) / unit).ravel()
    except (OverflowError, ValueError, ZeroDivisionError):
        return np.full(data.size, np.inf)


def _box(rng: np.random.Generator, truth: Array, minimum: Array, x0: Array) -> tuple[Array, Array]:
    """Returns a box around start and truth; every third side ends before the minimum."""
    far = np.maximum(np.abs(x0 - truth), 0.1 * np.abs(truth))
    lower = np.minimum(x0, truth) - rng.uniform(2, 6, len(x0)) * far
    upper = np.maximum(x0, truth) + rng.uniform(2, 6, len(x0)) * far
    lower = np.where(truth > 0, np.maximum(lower, 0.05 * np.minimum(truth, x0)), lower)
    for k in range(int(rng.integers(3)), len(x0), 3):
        cut = x0[k] + 0.6 * (minimum[k] - x0[k])
        if minimum[k] > x0[k]:
            upper[k] = cut
        else:
            lower[k] = cut
    return lower, upper


@cache
def problems(boxed: bool) -> tuple[Problem, ...]:
    """Returns all fits from all starts.

    The best values come from least squares started at the truth and at the start, and from the solvers of a run."""
    found = []
    for number, (name, parameters, model) in enumerate(MODELS):
        truth, rng = np.array(parameters), np.random.default_rng([SEED, number])
        exact = model(truth)
        unit = np.ptp(exact, axis=0)
        of = partial(_residuals, model, exact + 0.01 * unit * rng.normal(size=exact.shape), unit)
        solve = dict(xtol=1e-14, ftol=1e-14, gtol=1e-14, max_nfev=2000)

        def scaled(u: Array, of: Callable[[Array], Array] = of, truth: Array = truth) -> Array:
            return np.nan_to_num(of(u * truth), nan=1e6, posinf=1e6, neginf=-1e6)

        minimum = least_squares(scaled, np.ones(len(truth)), **solve).x * truth
        for k in range(N_STARTS):
            x0 = truth * 2.5 ** rng.uniform(-1, 1, len(truth))
            lower, upper = np.full(len(truth), -np.inf), np.full(len(truth), np.inf)
            box = _box(rng, truth, minimum, x0)
            if boxed:
                lower, upper = box
            starts = [np.clip(s, lower, upper) for s in (minimum, x0)]
            ends = np.sort([lower / truth, upper / truth], axis=0)
            fits = [least_squares(scaled, np.clip(s / truth, *ends), bounds=ends, **solve) for s in starts]
            best = min(sum_of_squares(fit.fun) for fit in fits)
            found.append(Problem(f"{name} {k + 1}", number, x0, lower, upper, best, residuals=of))
    return tuple(found)
