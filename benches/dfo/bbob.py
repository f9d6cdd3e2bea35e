"""A subset of the noiseless BBOB functions, from the published formulas.

Source: Hansen, Finck, Ros and Auger, "Real-parameter black-box optimization benchmarking 2009: noiseless functions
definitions", INRIA RR-6829. Shifts, signs and rotations are drawn with a fixed seed; the minimum is 0 in [-5,
5]^n."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from problem import Array, Problem

FUNCTIONS = (1, 2, 3, 5, 6, 8, 10, 12, 15, 17, 20, 21, 23)
SEED = 20260


def oscillated(x: Array) -> Array:
    """T_osz."""
    with np.errstate(all="ignore"):
        hat = np.where(x != 0.0, np.log(np.abs(x)), 0.0)
    c1, c2 = np.where(x > 0, 10.0, 5.5), np.where(x > 0, 7.9, 3.1)
    return np.sign(x) * np.exp(hat + 0.049 * (np.sin(c1 * hat) + np.sin(c2 * hat)))


def asymmetric(x: Array, beta: float) -> Array:
    """T_asy^beta."""
    positive = np.maximum(x, 0.0)
    return np.where(x > 0, positive ** (1.0 + beta * ramp(len(x)) * np.sqrt(positive)), x)


def ramp(n: int) -> Array:
    """(i - 1) / (n - 1)."""
    return np.arange(n) / max(n - 1, 1)


def stretched(n: int, alpha: float) -> Array:
    """The diagonal of Lambda^alpha."""
    return alpha ** (0.5 * ramp(n))


def penalty(x: Array) -> float:
    """f_pen: penalty for coordinates beyond 5 in magnitude."""
    return float((np.maximum(0.0, np.abs(x) - 5.0) ** 2).sum())


def rotation(rng: np.random.Generator, n: int) -> Array:
    """Returns an orthogonal matrix, uniformly distributed."""
    q, r = np.linalg.qr(rng.normal(size=(n, n)))
    return q * np.sign(np.diag(r))


def function(number: int, n: int, instance: int) -> Callable[[Array], float]:
    """Returns one function; its minimum is 0."""
    rng = np.random.default_rng([SEED, number, n, instance])
    shift, signs = rng.uniform(-4.0, 4.0, n), rng.choice([-1.0, 1.0], n)
    R, Q, i = rotation(rng, n), rotation(rng, n), ramp(n)
    lam = stretched(n, 10.0)
    conditioned = 10.0 ** (6.0 * i)

    if number == 1:
        return lambda x: float(((x - shift) ** 2).sum())
    if number == 2:
        return lambda x: float(conditioned @ oscillated(x - shift) ** 2)
    if number in (3, 15):
        def rastrigin(x: Array) -> float:
            if number == 3:
                z = lam * asymmetric(oscillated(x - shift), 0.2)
            else:
                z = R @ (lam * (Q @ asymmetric(oscillated(R @ (x - shift)), 0.2)))
            return float(10.0 * (n - np.cos(2.0 * np.pi * z).sum()) + z @ z)

        return rastrigin
    if number == 5:
        optimum, slope = 5.0 * signs, signs * 10.0**i
        return lambda x: float((5.0 * np.abs(slope) - slope * np.where(optimum * x < 25.0, x, optimum)).sum())
    if number == 6:
        def sector(x: Array) -> float:
            z = Q @ (lam * (R @ (x - shift)))
            s = np.where(z * shift > 0.0, 100.0, 1.0)
            return float(oscillated(np.array([((s * z) ** 2).sum()]))[0] ** 0.9)

        return sector
    if number == 8:
        def rosenbrock(x: Array) -> float:
            z = max(1.0, np.sqrt(n) / 8.0) * (x - 0.75 * shift) + 1.0
            return float((100.0 * (z[:-1] ** 2 - z[1:]) ** 2 + (z[:-1] - 1.0) ** 2).sum())

        return rosenbrock
    if number == 10:
        return lambda x: float(conditioned @ oscillated(R @ (x - shift)) ** 2)
    if number == 12:
        def cigar(x: Array) -> float:
            z = R @ asymmetric(R @ (x - shift), 0.5)
            return float(z[0] ** 2 + 1e6 * (z[1:] ** 2).sum())

        return cigar
    if number == 17:
        def schaffer(x: Array) -> float:
            z = lam * (Q @ asymmetric(R @ (x - shift), 0.5))
            s = np.sqrt(z[:-1] ** 2 + z[1:] ** 2)
            return float((np.sqrt(s) * (1.0 + np.sin(50.0 * s**0.2) ** 2)).mean() ** 2 + 10.0 * penalty(x))

        return schaffer
    if number == 20:
        twice = 4.2096874633 * np.ones(n)

        def schwefel(x: Array) -> float:
            hat = 2.0 * signs * x
            z = hat.copy()
            z[1:] += 0.25 * (hat[:-1] - twice[:-1])
            z = 100.0 * (lam * (z - twice) + twice)
            sines = z @ np.sin(np.sqrt(np.abs(z)))
            return float(-sines / (100.0 * n) + 4.189828872724339 + 100.0 * penalty(z / 100.0))

        return schwefel
    if number == 21:
        peaks = 101
        y = rng.uniform(-5.0, 5.0, (peaks, n))
        y[0] = shift
        weights = np.concatenate(([10.0], 1.1 + 8.0 * np.arange(peaks - 1) / (peaks - 2)))
        alphas = np.concatenate(([1000.0], rng.permutation(1000.0 ** (2.0 * np.arange(peaks - 1) / (peaks - 2)))))
        C = np.array([rng.permutation(stretched(n, a)) / a**0.25 for a in alphas])
        centres = y @ R.T

        def gallagher(x: Array) -> float:
            d = R @ x - centres
            highest = (weights * np.exp(-0.5 / n * (C * d * d).sum(axis=1))).max()
            return float(oscillated(np.array([10.0 - highest]))[0] ** 2 + penalty(x))

        return gallagher
    if number == 23:
        powers, wide = 2.0 ** np.arange(1, 33), stretched(n, 100.0)

        def katsuura(x: Array) -> float:
            z = Q @ (wide * (R @ (x - shift)))
            t = np.outer(z, powers)
            sums = (np.abs(t - np.round(t)) / powers).sum(axis=1)
            product = np.prod((1.0 + np.arange(1, n + 1) * sums) ** (10.0 / n**1.2))
            return float(10.0 / n**2 * (product - 1.0) + penalty(x))

        return katsuura
    raise ValueError(f"function {number} is not among {FUNCTIONS}")


def problems(n: int, seeds: int) -> list[Problem]:
    """Returns all functions in one dimension, with `seeds` instances each.

    The start, for solvers that need one, is drawn in the box."""
    found = []
    for number in FUNCTIONS:
        for instance in range(1, seeds + 1):
            x0 = np.random.default_rng([SEED, number, n, instance, 1]).uniform(-5.0, 5.0, n)
            box = np.full(n, 5.0)
            f = function(number, n, instance)
            found.append(Problem(f"f{number}/{n}/{instance}", number, x0, -box, box, 0.0, cost=f, has_start=False))
    return found
