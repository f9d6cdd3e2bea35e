"""Noise of the final states under small changes of a parameter, for `auto`, Radau5 and BDF.

    python benches/solver_noise.py

The last output is stored in `work_precision.md`. Needs pydfo and numpy. A parameter is multiplied by `1 + k step` for k = 0
to 12. The noise is the root mean square of the second differences of the final states divided by sqrt(6), relative to the
states and to rtol.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sin, tanh

import numpy as np
from pydfo import ode


def hires(p: float) -> Callable:
    def f(t, y):
        r = 280 * p * y[5] * y[7]
        return [
            -1.71 * y[0] + 0.43 * y[1] + 8.32 * y[2] + 0.0007,
            1.71 * y[0] - 8.75 * y[1],
            -10.03 * y[2] + 0.43 * y[3] + 0.035 * y[4],
            8.32 * y[1] + 1.71 * y[2] - 1.12 * y[3],
            -1.745 * y[4] + 0.43 * y[5] + 0.43 * y[6],
            -r + 0.69 * y[3] + 1.71 * y[4] - 0.43 * y[5] + 0.69 * y[6],
            r - 1.81 * y[6],
            -r + 1.81 * y[6],
        ]

    return f


def robertson(p: float) -> Callable:
    def f(t, y):
        a, b, c = 0.04 * p * y[0], 1e4 * y[1] * y[2], 3e7 * y[1] ** 2
        return [-a + b, a - b - c, c]

    return f


def motor(p: float) -> Callable:
    def f(t, y):
        voltage = 24 * (1 + 0.2 * sin(4 * t))
        torque = 0.05 * y[0] - 1e-3 * y[1] - 0.02 * tanh(y[1])
        return [(voltage - 0.5 * p * y[0] - 0.05 * y[1]) / 5e-4, torque / 2e-3, y[1]]

    return f


PROBLEMS = {
    "HIRES": (hires, [1, 0, 0, 0, 0, 0, 0, 0.0057], 20.0),
    "Robertson": (robertson, [1, 0, 0], 400.0),
    "motor": (motor, [0, 0, 0], 2.0),
}


def main() -> None:
    print("noise / rtol (right-hand sides)")
    for name, (model, start, end) in PROBLEMS.items():
        for rtol in (1e-4, 1e-6):
            for step in (1e-6, 1e-4):
                cells = []
                for solver in ("auto", "radau5", "bdf"):
                    runs = [
                        ode.solve(model(1 + step * k), (0, end), start, solver, [end], rtol=rtol, atol=1e-4 * rtol)
                        for k in range(13)
                    ]
                    ends = np.array([run.y[:, -1] for run in runs])
                    noise = np.sqrt(np.mean((np.diff(ends, 2, axis=0) / np.abs(ends[0])) ** 2) / 6) / rtol
                    cells.append(f"{solver} {noise:.1e} ({np.mean([run.nfev for run in runs]):.0f})")
                print(f"{name:10s} rtol {rtol:g} step {step:g}: ", "  ".join(cells), flush=True)


if __name__ == "__main__":
    main()
