"""Generates furuta.csv: the Furuta pendulum at known frictions with white noise, like a measurement.

    python generate_furuta.py            writes furuta.csv next to this file
    python generate_furuta.py --check    compares the file with the generated data
"""

import csv
import sys
from pathlib import Path

import numpy as np

FILE = Path(__file__).with_name("furuta.csv")
SEED = 2012
FRICTION = {"armFriction": 0.010, "pendulumFriction": 0.001}  # N m
NOISE = {"phi": 0.0305, "theta": 0.0207}  # standard deviations, rad
TIMES = np.arange(801) / 20  # 0 to 40 s, every 0.05 s


def simulate():
    """Returns the two angles at TIMES without noise."""
    from pydfo import FMUModel, example_fmu

    model = FMUModel(example_fmu("furuta"))
    for name, value in FRICTION.items():
        model.set(name, value)
    result = model.simulate(final_time=40, times=TIMES, relative_tolerance=1e-10)
    return result["armJoint.phi"], result["pendulumJoint.phi"]


def measure(phi, theta):
    """Returns the angles with noise: first all values of phi are drawn, then all values of theta."""
    rng = np.random.default_rng(SEED)
    return phi + rng.normal(0, NOISE["phi"], phi.size), theta + rng.normal(0, NOISE["theta"], theta.size)


def write(phi, theta, path=FILE):
    with open(path, "w", newline="") as file:
        file.write("time,phi,theta\n")
        for row in zip(TIMES, phi, theta):
            file.write("{:.2f},{:.7g},{:.7g}\n".format(*row))


def read(path=FILE):
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    return tuple(np.array([float(row[name]) for row in rows]) for name in ("time", "phi", "theta"))


def main():
    phi, theta = measure(*simulate())
    if "--check" not in sys.argv[1:]:
        write(phi, theta)
        return
    stored = read()
    difference = max(np.abs(a - b).max() for a, b in zip(stored, (TIMES, phi, theta), strict=True))
    print(f"largest difference {difference:.1e}")
    if difference > 1e-6:
        sys.exit("furuta.csv differs from the output of this script")


if __name__ == "__main__":
    main()
