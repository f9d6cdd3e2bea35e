"""Right-hand sides against correct digits: our BDF and Radau5 compared with CVODE and SciPy, in one run.

    cargo bench -p fmufit-ode --bench work_precision > ours.csv
    python benches/work_precision.py ours.csv

The last output is stored in `work_precision.md`. Needs numpy, scipy and scikit-sundae. For each solver and problem, a
straight line of log(right-hand sides) against digits over rtol 1e-4 ... 1e-9 is evaluated at 4, 5 and 6 digits.
Right-hand sides for Jacobians count on both sides. All Jacobians are dense differences. atol is the same multiple of
rtol for all.
"""

from __future__ import annotations

import csv
import re
import sys
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from sksundae.cvode import CVODE

SOURCE = Path(__file__).resolve().parent.parent / "crates" / "ode" / "tests" / "problems"
TOLERANCES = [10.0 ** (-k / 2) for k in range(8, 19)]
LEVELS = (4.0, 5.0, 6.0)


def hires(t, y, d):
    r = 280 * y[5] * y[7]
    d[0] = -1.71 * y[0] + 0.43 * y[1] + 8.32 * y[2] + 0.0007
    d[1] = 1.71 * y[0] - 8.75 * y[1]
    d[2] = -10.03 * y[2] + 0.43 * y[3] + 0.035 * y[4]
    d[3] = 8.32 * y[1] + 1.71 * y[2] - 1.12 * y[3]
    d[4] = -1.745 * y[4] + 0.43 * y[5] + 0.43 * y[6]
    d[5] = -r + 0.69 * y[3] + 1.71 * y[4] - 0.43 * y[5] + 0.69 * y[6]
    d[6] = r - 1.81 * y[6]
    d[7] = -r + 1.81 * y[6]


def rober(t, y, d):
    a, b, c = 0.04 * y[0], 1e4 * y[1] * y[2], 3e7 * y[1] ** 2
    d[0], d[1], d[2] = -a + b, a - b - c, c


def orego(t, y, d):
    d[0] = 77.27 * (y[1] + y[0] * (1 - 8.375e-6 * y[0] - y[1]))
    d[1] = (y[2] - (1 + y[0]) * y[1]) / 77.27
    d[2] = 0.161 * (y[0] - y[2])


def vdpol(t, y, d):
    d[0], d[1] = y[1], ((1 - y[0] ** 2) * y[1] - y[0]) / 1e-6


def vdpolm(t, y, d):
    d[0], d[1] = y[1], 1000 * (1 - y[0] ** 2) * y[1] - y[0]


def e5(t, y, d):
    a, b, c, e = 7.89e-10 * y[0], 1.1e7 * y[0] * y[2], 1.13e9 * y[1] * y[2], 1.13e3 * y[3]
    d[0], d[1], d[3] = -a - b, a - c, b - e
    d[2] = d[1] - d[3]


def brusselator(t, y, d):
    d[0] = 1 + y[0] ** 2 * y[1] - 4 * y[0]
    d[1] = 3 * y[0] - y[0] ** 2 * y[1]


def pollu(t, y, d):
    k = (0.35, 26.6, 1.23e4, 8.6e-4, 8.2e-4, 1.5e4, 1.3e-4, 2.4e4, 1.65e4, 9e3, 2.2e-2, 1.2e4, 1.88, 1.63e4, 4.8e6,
         3.5e-4, 1.75e-2, 1e8, 4.44e11, 1.24e3, 2.1, 5.78, 4.74e-2, 1.78e3, 3.12)  # fmt: skip
    s = (y[0], y[1] * y[3], y[4] * y[1], y[6], y[6], y[6] * y[5], y[8], y[8] * y[5], y[10] * y[1], y[10] * y[0], y[12],
         y[9] * y[1], y[13], y[0] * y[5], y[2], y[3], y[3], y[15], y[15], y[16] * y[5], y[18], y[18], y[0] * y[3],
         y[18] * y[0], y[19])  # fmt: skip
    r = [a * b for a, b in zip(k, s)]
    d[0] = -r[0] - r[9] - r[13] - r[22] - r[23] + r[1] + r[2] + r[8] + r[10] + r[11] + r[21] + r[24]
    d[1] = -r[1] - r[2] - r[8] - r[11] + r[0] + r[20]
    d[2] = -r[14] + r[0] + r[16] + r[18] + r[21]
    d[3] = -r[1] - r[15] - r[16] - r[22] + r[14]
    d[4] = -r[2] + 2 * r[3] + r[5] + r[6] + r[12] + r[19]
    d[5] = -r[5] - r[7] - r[13] - r[19] + r[2] + 2 * r[17]
    d[6] = -r[3] - r[4] - r[5] + r[12]
    d[7] = r[3] + r[4] + r[5] + r[6]
    d[8] = -r[6] - r[7]
    d[9] = -r[11] + r[6] + r[8]
    d[10] = -r[8] - r[9] + r[7] + r[10]
    d[11] = r[8]
    d[12] = -r[10] + r[9]
    d[13] = -r[12] + r[11]
    d[14] = r[13]
    d[15] = -r[17] - r[18] + r[15]
    d[16] = -r[19]
    d[17] = r[19]
    d[18] = -r[20] - r[21] - r[23] + r[22] + r[24]
    d[19] = -r[24] + r[23]


def numbers(text: str) -> list[float]:
    return [float(v) for v in re.findall(r"-?\d+\.\d+(?:e-?\d+)?", text)]


def reference(function: str, occurrence: int = -1) -> np.ndarray:
    """Returns the reference values of the Rust tests: the last list of numbers in the function of that name."""
    text = "".join((SOURCE / name).read_text() for name in ("stiff.rs", "nonstiff.rs"))
    body = re.search(rf"pub fn {function}\(\).*?\n}}\n", text, re.S).group(0)
    return np.array(numbers(re.findall(r"\[([^\[\]]*)\]", body, re.S)[occurrence]))


POLLU_START = np.zeros(20)
POLLU_START[[1, 3, 6, 7, 8, 16]] = 0.2, 0.04, 0.1, 0.3, 0.01, 0.007
PROBLEMS = {
    "HIRES": (hires, [1, 0, 0, 0, 0, 0, 0, 0.0057], 321.8122, 1e-4, reference("hires")),
    "ROBER": (rober, [1, 0, 0], 1e11, 1e-8, reference("rober")),
    "OREGO": (orego, [1, 2, 3], 360.0, 1e-2, reference("orego")),
    "VDPOL": (vdpol, [2, 0], 2.0, 1e-2, reference("vdpol")),
    "VDPOLM": (vdpolm, [2, 0], 2000.0, 1e-4, reference("vdpolm")),
    "E5 1e3": (e5, [1.76e-3, 0, 0, 0], 1e3, 1e-14, reference("e5_1e3")),
    "E5 1e5": (e5, [1.76e-3, 0, 0, 0], 1e5, 1e-14, reference("e5_1e5")),
    "POLLU": (pollu, POLLU_START, 60.0, 1e-14, reference("pollu")),
    "Brusselator": (brusselator, [1.5, 3], 20.0, 1e-2, reference("brusselator")),
}
PEERS = ("CVODE BDF", "SciPy Radau", "SciPy BDF", "SciPy LSODA")


def peer(solver: str, problem: str, rtol: float) -> tuple[float, int] | None:
    """Returns correct digits and right-hand sides; None if the solver fails."""
    rhs, x0, end, atol, exact = PROBLEMS[problem]
    calls = 0

    def counted(t, y, d):
        nonlocal calls
        calls += 1
        rhs(t, y, d)

    x0 = np.array(x0, dtype=float)
    if solver == "CVODE BDF":
        options = dict(rtol=rtol, atol=rtol * atol, method="BDF", max_num_steps=1_000_000)
        result = CVODE(counted, **options).solve(np.array([0.0, end]), x0)
        final, good = result.y[-1], result.success
    else:

        def allocating(t, y):
            d = np.empty_like(y)
            counted(t, y, d)
            return d

        result = solve_ivp(allocating, (0, end), x0, method=solver.split()[1], rtol=rtol, atol=rtol * atol)
        final, good = result.y[:, -1], result.success
    if not good:
        return None
    return -np.log10(max(np.max(np.abs((final - exact) / exact)), 1e-17)), calls


def at_digits(points: list[tuple[float, int]]) -> list[float]:
    """Returns right-hand sides at the levels, from the straight line of their logarithm against digits."""
    digits, calls = np.array(points).T
    slope, offset = np.polyfit(digits, np.log(calls), 1)
    return [float(np.exp(offset + slope * level)) for level in LEVELS]


def main() -> None:
    ours: dict[tuple[str, str], list[tuple[float, int]]] = {}
    with open(sys.argv[1], newline="", encoding="utf-8") as file:
        for row in csv.reader(file):
            if len(row) > 4 and TOLERANCES[-1] * 0.99 <= float(row[2]) <= TOLERANCES[0] * 1.01:
                ours.setdefault((row[0], row[1]), []).append((float(row[3]), int(row[4])))
    peers = {
        (solver, problem): [p for p in (peer(solver, problem, rtol) for rtol in TOLERANCES) if p]
        for solver in (PEERS if "--all" in sys.argv else PEERS[:2])
        for problem in PROBLEMS
    }
    print("digits/right-hand sides at rtol 1e-4, 1e-6, 1e-8, then right-hand sides at 4, 5, 6 digits")
    for problem in PROBLEMS:
        for solver, points in [(s, p) for (s, q), p in [*ours.items(), *peers.items()] if q == problem]:
            shown = "  ".join(f"{d:5.2f}/{n:<6d}" for d, n in points[0:9:4])
            print(f"{problem:12s} {solver:12s} {shown}  ->", "  ".join(f"{v:7.0f}" for v in at_digits(points)))
    for solver, peer in (("bdf", "CVODE BDF"), ("radau5", "SciPy Radau")):
        print(f"\n{solver} / {peer}, right-hand sides at equal digits")
        ratios = []
        for problem in PROBLEMS:
            a, b = at_digits(ours[solver, problem]), at_digits(peers[peer, problem])
            ratios.append([x / y for x, y in zip(a, b)])
            print(f"  {problem:12s}", "  ".join(f"{r:5.2f}" for r in ratios[-1]))
        print(f"  geometric mean {np.exp(np.mean(np.log(ratios))):.3f}, largest {np.max(ratios):.2f}")


if __name__ == "__main__":
    main()
