"""Generates quad_tank.csv: the quadruple tank with known outlets and white noise, like a measurement.

    python generate_quad_tank.py            writes quad_tank.csv next to this file
    python generate_quad_tank.py --check    compares the file with the generated data
"""

import csv
import sys
from pathlib import Path

import numpy as np

FILE = Path(__file__).with_name("quad_tank.csv")
SEED = 2012
OUTLETS = {"qt.a1": 2.66e-6, "qt.a2": 2.71e-6, "qt.a3": 3.01e-6, "qt.a4": 2.93e-6}  # m2
NOISE = 3e-4  # standard deviation, m
LEVELS = ["x1", "x2", "x3", "x4"]
TIMES = np.arange(61.0)  # 0 to 60 s, every second
VOLTAGES = {"u1": 5 + TIMES // 10 % 2, "u2": 5 + TIMES // 7 % 2}  # V, linear between the rows


def simulate():
    """Returns the four levels at TIMES without noise."""
    from pydfo import FMUModel, example_fmu

    model = FMUModel(example_fmu("quad_tank"))
    for name, value in OUTLETS.items():
        model.set(name, value)
    result = model.simulate(final_time=60, times=TIMES, inputs={"time": TIMES, **VOLTAGES}, relative_tolerance=1e-10)
    return [result[f"qt.{level}"] for level in LEVELS]


def measure(levels):
    """Returns the levels with noise, drawn level by level."""
    rng = np.random.default_rng(SEED)
    return [level + rng.normal(0, NOISE, level.size) for level in levels]


def write(levels, path=FILE):
    with open(path, "w", newline="") as file:
        file.write("time,u1,u2,x1,x2,x3,x4\n")
        for time, u1, u2, *row in zip(TIMES, *VOLTAGES.values(), *levels):
            file.write("{:g},{:g},{:g},{:.6g},{:.6g},{:.6g},{:.6g}\n".format(time, u1, u2, *row))


def read(path=FILE):
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    return [np.array([float(row[name]) for row in rows]) for name in ("time", *VOLTAGES, *LEVELS)]


def main():
    levels = measure(simulate())
    if "--check" not in sys.argv[1:]:
        write(levels)
        return
    stored = read()
    difference = max(np.abs(a - b).max() for a, b in zip(stored, (TIMES, *VOLTAGES.values(), *levels), strict=True))
    print(f"largest difference {difference:.1e}")
    if difference > 1e-6:
        sys.exit("quad_tank.csv differs from the output of this script")


if __name__ == "__main__":
    main()
