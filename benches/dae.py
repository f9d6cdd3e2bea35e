"""Residual calls against correct digits: `ode.solve_dae` compared with IDA of SUNDIALS, in one run.

    python benches/dae.py

The last output is stored in `dae.md`. Needs pydfo, numpy and scikit-sundae. Both solvers receive equal residuals,
tolerances and consistent initial values. Jacobians are dense differences, whose residual calls count on both sides.
The columns for rtol 1e-4, 1e-6 and 1e-8 are correct digits (of the largest relative error at the end), residual
calls, Jacobians and steps. A straight line of log(calls) against digits over rtol 1e-4 ... 1e-9 is evaluated at 4, 5,
6 and 7 digits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from sksundae.ida import IDA

from pydfo import ode

TABLE = (1e-4, 1e-6, 1e-8)
TOLERANCES = [10.0 ** (-k / 2) for k in range(8, 19)]
LEVELS = (4.0, 5.0, 6.0, 7.0)


def robertson(t, y, dy):
    a, b, c = 0.04 * y[0], 1e4 * y[1] * y[2], 3e7 * y[1] ** 2
    return np.array([dy[0] + a - b, dy[1] - a + b + c, y.sum() - 1])


def akzo(t, y, dy):
    r = [
        18.7 * y[0] ** 4 * np.sqrt(y[1]),
        0.58 * y[2] * y[3],
        0.58 / 34.4 * y[0] * y[4],
        0.09 * y[0] * y[3] ** 2,
        0.42 * y[5] ** 2 * np.sqrt(y[1]),
    ]
    inflow = 3.3 * (0.9 / 737.0 - y[1])
    f = [
        -2 * r[0] + r[1] - r[2] - r[3],
        -0.5 * r[0] - r[3] - 0.5 * r[4] + inflow,
        r[0] - r[1] + r[2],
        -r[1] + r[2] - 2 * r[3],
        r[1] - r[2] + r[4],
    ]
    return np.array([*(dy[:5] - f), 115.83 * y[0] * y[3] - y[5]])


def amplifier(t, y, dy):
    ub, uf, alpha, beta, r0, rk = 6.0, 0.026, 0.99, 1e-6, 1e3, 9e3
    ue = 0.1 * np.sin(200 * np.pi * t)
    g23, g56 = (beta * (np.exp(v / uf) - 1) for v in (y[1] - y[2], y[4] - y[5]))
    i = [
        (y[0] - ue) / r0,
        -ub / rk + 2 * y[1] / rk - (alpha - 1) * g23,
        -g23 + y[2] / rk,
        -ub / rk + y[3] / rk + alpha * g23,
        -ub / rk + 2 * y[4] / rk - (alpha - 1) * g56,
        -g56 + y[5] / rk,
        -ub / rk + y[6] / rk + alpha * g56,
        y[7] / rk,
    ]
    d = 1e-6 * dy
    q = [d[1] - d[0], d[0] - d[1], -2 * d[2], 3 * (d[4] - d[3]), 3 * (d[3] - d[4]), -4 * d[5]]
    return np.array([*q, 5 * (d[7] - d[6]), 5 * (d[6] - d[7])]) - i


@dataclass
class Problem:
    """A residual of the IVP test set (Mazzia and Magherini, release 2.4), with its solution at the end."""

    residual: Any
    x0: list[float]
    end: float
    reference: list[float]
    atol: float
    algebraic: list[int] | None = None
    dx0: Any = field(default=None)

    def digits(self, y):
        return -np.log10(np.abs(y / self.reference - 1).max())


PROBLEMS = {
    "Robertson": Problem(
        robertson, [1.0, 0.0, 0.0], 40.0,
        [7.158270687194050905e-1, 9.185534764557763904e-6, 2.841637457458303518e-1], 1e-4, [2],
    ),
    "Akzo Nobel": Problem(
        akzo, [0.444, 0.00123, 0.0, 0.007, 0.0, 115.83 * 0.444 * 0.007], 180.0,
        [1.150794920661702e-1, 1.203831471567715e-3, 1.611562887407974e-1, 3.656156421249283e-4,
         1.708010885264404e-2, 4.873531310307455e-3], 1e-4, [5],
    ),
    "amplifier": Problem(
        amplifier, [0.0, 3.0, 3.0, 6.0, 3.0, 3.0, 6.0, 0.0], 0.2,
        [-5.562145012262709e-3, 3.006522471903042, 2.849958788608128, 2.926422536206241, 2.704617865010554,
         2.761837778393145, 4.770927631616772, 1.236995868091548], 1.0,
    ),
}  # fmt: skip


def consistent(problem):
    """Returns the smallest slopes with zero residual at the start."""
    x0, n = np.array(problem.x0), len(problem.x0)
    at = lambda dy: problem.residual(0.0, x0, dy)  # noqa: E731
    zero = at(np.zeros(n))
    matrix = np.column_stack([at(column) - zero for column in 1e3 * np.eye(n)]) / 1e3
    return -np.linalg.lstsq(matrix, zero, rcond=1e-9)[0]


def ours(problem, rtol):
    res = ode.solve_dae(
        problem.residual, (0, problem.end), problem.x0, problem.dx0, [problem.end], rtol=rtol, atol=problem.atol * rtol
    )
    if not res.success:
        raise RuntimeError(res.message)
    return problem.digits(res.y[:, -1]), res.nfev, res.njev, res.stats.accepted_steps


def ida(problem, rtol):
    calls = 0

    def residual(t, y, dy, r):
        nonlocal calls
        calls += 1
        r[:] = problem.residual(t, y, dy)

    solver = IDA(
        residual, rtol=rtol, atol=problem.atol * rtol, algebraic_idx=problem.algebraic, max_num_steps=1_000_000
    )
    res = solver.solve(np.array([0.0, problem.end]), np.array(problem.x0), problem.dx0)
    if not res.success:
        raise RuntimeError(res.message)
    return problem.digits(res.y[-1]), calls, res.njev, len(res.t) - 1


def main() -> None:
    print("                  digits/calls/Jacobians/steps at rtol 1e-4, 1e-6, 1e-8, then calls at 4, 5, 6, 7 digits")
    for name, problem in PROBLEMS.items():
        problem.dx0 = consistent(problem)
        for solver, run in ("solve_dae", ours), ("IDA", ida):
            # IDA takes minutes for the amplifier at tight tolerances.
            tolerances = [t for t in TOLERANCES if name != "amplifier" or t >= 1e-6]
            rows = {rtol: run(problem, rtol) for rtol in [*tolerances, *TABLE] if rtol in tolerances or run is ours}
            digits, calls = zip(*((rows[rtol][0], rows[rtol][1]) for rtol in tolerances))
            line = np.polyfit(digits, np.log(calls), 1)
            cells = [
                "{:.2f}/{}/{}/{}".format(*rows[rtol]) if rtol in rows else "not run" for rtol in TABLE
            ]
            levels = [f"{np.exp(np.polyval(line, level)):7.0f}" for level in LEVELS]
            print(f"{name:11} {solver:10}" + "".join(f"{c:24}" for c in cells) + "-> " + "".join(levels), flush=True)


if __name__ == "__main__":
    main()
