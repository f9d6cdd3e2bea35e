"""The 24 noiseless BBOB functions, from the published formulas.

Source: Hansen, Finck, Ros and Auger, "Real-parameter black-box optimization benchmarking 2009: noiseless functions
definitions", INRIA RR-6829. Shifts, signs and rotations are drawn with a fixed seed; the minimum is 0 in [-5,
5]^n."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from problem import Array, Problem

FUNCTIONS = tuple(range(1, 25))
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
    if number == 4:
        shift[::2] = np.abs(shift[::2])

        def bueche(x: Array) -> float:
            z = oscillated(x - shift)
            s = lam * np.where((z > 0.0) & (np.arange(n) % 2 == 0), 10.0, 1.0)
            z = s * z
            return float(10.0 * (n - np.cos(2.0 * np.pi * z).sum()) + z @ z + 100.0 * penalty(x))

        return bueche
    if number == 5:
        optimum, slope = 5.0 * signs, signs * 10.0**i
        return lambda x: float((5.0 * np.abs(slope) - slope * np.where(optimum * x < 25.0, x, optimum)).sum())
    if number == 6:
        def sector(x: Array) -> float:
            z = Q @ (lam * (R @ (x - shift)))
            s = np.where(z * shift > 0.0, 100.0, 1.0)
            return float(oscillated(np.array([((s * z) ** 2).sum()]))[0] ** 0.9)

        return sector
    if number == 7:
        def step(x: Array) -> float:
            hat = lam * (R @ (x - shift))
            rounded = np.where(np.abs(hat) > 0.5, np.floor(0.5 + hat), np.floor(0.5 + 10.0 * hat) / 10.0)
            z = Q @ rounded
            return float(0.1 * max(abs(hat[0]) / 1e4, 10.0 ** (2.0 * i) @ z**2) + penalty(x))

        return step
    if number == 8:
        def rosenbrock(x: Array) -> float:
            z = max(1.0, np.sqrt(n) / 8.0) * (x - 0.75 * shift) + 1.0
            return float((100.0 * (z[:-1] ** 2 - z[1:]) ** 2 + (z[:-1] - 1.0) ** 2).sum())

        return rosenbrock
    if number in (9, 19):
        # The optimum follows from the rotation.
        scale = max(1.0, np.sqrt(n) / 8.0)

        def rotated_rosenbrock(x: Array) -> float:
            z = scale * (R @ x) + 0.5
            s = 100.0 * (z[:-1] ** 2 - z[1:]) ** 2 + (z[:-1] - 1.0) ** 2
            if number == 9:
                return float(s.sum())
            return float(10.0 / (n - 1) * (s / 4000.0 - np.cos(s)).sum() + 10.0)

        return rotated_rosenbrock
    if number == 10:
        return lambda x: float(conditioned @ oscillated(R @ (x - shift)) ** 2)
    if number == 11:
        def discus(x: Array) -> float:
            z = oscillated(R @ (x - shift))
            return float(1e6 * z[0] ** 2 + (z[1:] ** 2).sum())

        return discus
    if number == 12:
        def cigar(x: Array) -> float:
            z = R @ asymmetric(R @ (x - shift), 0.5)
            return float(z[0] ** 2 + 1e6 * (z[1:] ** 2).sum())

        return cigar
    if number == 13:
        def ridge(x: Array) -> float:
            z = Q @ (lam * (R @ (x - shift)))
            return float(z[0] ** 2 + 100.0 * np.sqrt((z[1:] ** 2).sum()))

        return ridge
    if number == 14:
        return lambda x: float(np.sqrt((np.abs(R @ (x - shift)) ** (2.0 + 4.0 * i)).sum()))
    if number == 16:
        halves, threes, narrow = 0.5 ** np.arange(12), 3.0 ** np.arange(12), stretched(n, 0.01)
        lowest = float(halves @ np.cos(np.pi * threes))

        def weierstrass(x: Array) -> float:
            z = R @ (narrow * (Q @ oscillated(R @ (x - shift))))
            sums = np.cos(2.0 * np.pi * np.outer(z + 0.5, threes)) @ halves
            return float(10.0 * (sums.mean() - lowest) ** 3 + 10.0 / n * penalty(x))

        return weierstrass
    if number in (17, 18):
        wide_17 = lam if number == 17 else stretched(n, 1000.0)

        def schaffer(x: Array) -> float:
            z = wide_17 * (Q @ asymmetric(R @ (x - shift), 0.5))
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
    if number in (21, 22):
        peaks, first, reach = (101, 1000.0, 5.0) if number == 21 else (21, 1000.0**2, 4.9)
        y = rng.uniform(-reach, reach, (peaks, n))
        y[0] = shift
        weights = np.concatenate(([10.0], 1.1 + 8.0 * np.arange(peaks - 1) / (peaks - 2)))
        alphas = np.concatenate(([first], rng.permutation(1000.0 ** (2.0 * np.arange(peaks - 1) / (peaks - 2)))))
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
    if number == 24:
        mu_0, d = 2.5, 1.0
        s_24 = 1.0 - 1.0 / (2.0 * np.sqrt(n + 20.0) - 8.2)
        mu_1 = -np.sqrt((mu_0**2 - d) / s_24)
        wide = stretched(n, 100.0)

        def lunacek(x: Array) -> float:
            hat = 2.0 * signs * x
            z = Q @ (wide * (R @ (hat - mu_0)))
            lower = ((hat - mu_0) ** 2).sum()
            upper = d * n + s_24 * ((hat - mu_1) ** 2).sum()
            return float(min(lower, upper) + 10.0 * (n - np.cos(2.0 * np.pi * z).sum()) + 1e4 * penalty(x))

        return lunacek
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
