"""Checks an installed pydfo with NumPy alone. The packaging test runs it outside the checkout.

python smoke.py
"""

from __future__ import annotations

import math
import sys

import numpy as np

import pydfo
from pydfo import Calibration, FMUModel, Parameter, dfo, example_fmu


def check(what: str, good: bool) -> None:
    print(f"{'ok  ' if good else 'FAIL'} {what}")
    if not good:
        sys.exit(f"{what} failed")


result = dfo.fmin(lambda x: (x[0] - 1.0) ** 2 + 2.0 * (x[1] + 2.0) ** 2, [0.0, 0.0], disp=False, stop="all")
check("fmin finds the minimum of a quadratic", bool(np.allclose(result.x, [1.0, -2.0], atol=1e-3)))
x_opt, f_opt, nbr_iters, nbr_fevals, solve_time = result
check("the result unpacks", x_opt is result[0] and nbr_fevals == len(result.trace))

model = FMUModel(example_fmu("furuta"))
model.set("armFriction", 0.010)
simulated = model.simulate(final_time=1.0)
check("the bundled model is built and simulated", len(simulated["time"]) == 501 and simulated["time"][-1] == 1.0)
check("it moves", float(np.ptp(simulated["armJoint.phi"])) > 1e-3)

time = np.linspace(0.0, 2.0, 21)
data = {"time": time, "x": np.exp(-2.0 * time)}
fit = Calibration(example_fmu("dahlquist"), data, ["x"], [Parameter("k", 1.0, 0.1, 10.0)]).fit()
check("a fit finds the rate of a decay", math.isclose(fit.parameters["k"], 2.0, abs_tol=1e-3))
print(f"pydfo {pydfo.__version__}, Python {sys.version.split()[0]}, NumPy {np.__version__}")
