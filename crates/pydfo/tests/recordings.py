"""Recordings for the tests: generated from known parameters and seeded noise, and the published ones, if available.

The published ones are not part of the project."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pydfo import FMUModel, example_fmu

OWN = Path(__file__).resolve().parents[3] / "examples" / "data"
PUBLISHED = Path(__file__).resolve().parents[4] / "shared" / "data"

#: Seed of the noise of all generated recordings.
SEED = 2012

LEVELS = ["qt.x1", "qt.x2", "qt.x3", "qt.x4"]
EXHAUST_INPUTS = ["T_in", "p_in", "w_turb1", "w_turb2", "p_out"]


def at_hand(file):
    """Returns parameters for tests: the generated recordings, and the published ones if available."""
    return ["own", "published"] if (PUBLISHED / file).is_file() else ["own"]


def columns(path):
    """Returns the columns of a CSV file by name."""
    data = np.genfromtxt(path, delimiter=",", names=True)
    return {name: data[name] for name in data.dtype.names}


def furuta(which):
    """Returns both angles of the pendulum in rad, over 40 s.

    The generated recording uses armFriction = 0.010 and pendulumFriction = 0.001."""
    if which == "own":
        return columns(OWN / "furuta.csv")
    from scipy.io import loadmat

    data = loadmat(PUBLISHED / "FurutaData.mat")
    return {name: data[name].ravel() for name in ("time", "phi", "theta")}


def quad_tank(which):
    """Returns the levels in m and the voltages, one row per second over 60 s."""
    if which == "own":
        data = columns(OWN / "quad_tank.csv")
        return {"time": data["time"], "u1": data["u1"], "u2": data["u2"]} | {x: data[x[3:]] for x in LEVELS}
    from scipy.io import loadmat

    mat = loadmat(PUBLISHED / "qt_par_est_data.mat")
    rows = slice(6000, 12001, 100)
    column = {name: mat[name].ravel()[rows] for name in ("t", "y1_f", "y2_f", "y3_d", "y4_d", "u1_d", "u2_d")}
    data = {"time": np.round(column["t"] - 60.0, 9), "u1": column["u1_d"], "u2": column["u2_d"]}
    return data | {x: column[y] / 100 for x, y in zip(LEVELS, ("y1_f", "y2_f", "y3_d", "y4_d"))}


def exhaust(which):
    """Returns the inputs and the temperature of the gas at the outlet of the pipe, one row per second over 1800 s.

    In the generated recording, a load with random levels moves all inputs. The nominal model responds, with a noise
    of 2 K."""
    if which == "published":
        return columns(PUBLISHED / "exhaust_measurements.csv")
    rng = np.random.default_rng(SEED)
    time = np.arange(1801.0)
    corners = np.arange(0, 1801, 30)
    load = np.interp(time, corners, rng.uniform(0.1, 0.9, corners.size))
    data = {
        "time": time,
        "T_in": 450 + 450 * load,
        "p_in": 1.1e5 + 1.2e5 * load,
        "w_turb1": 2000 + 4000 * load,
        "w_turb2": 1500 + 3500 * load,
        "p_out": np.full_like(time, 1.013e5),
    }
    res = FMUModel(example_fmu("exhaust")).simulate(0, 1800, times=time, input=data, output=["T_out"], solver="radau5", relative_tolerance=1e-9)
    return data | {"T_out": res["T_out"] + rng.normal(0, 2.0, time.size)}
