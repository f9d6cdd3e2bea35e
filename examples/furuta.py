"""Calibrates the friction of a Furuta pendulum from recorded angles (Gedda, Andersson, Åkesson and Diehl 2012, section 6.1).

It does so twice. The first fit uses a cost function in Python with the calls of the paper's tools (`FMUModel`,
`quad_err`, `fmin`), which allows any computation between simulation and cost. The second fit uses a `Calibration`, in
which the whole fit runs in native code, in parallel. Prints both results, and draws measurements, responses and
residuals into furuta.png.
"""

from pathlib import Path

import numpy as np

import pydfo
from pydfo import FMUModel, dfo

RECORDING = Path(__file__).resolve().parent / "data" / "furuta.csv"
PENDULUM = pydfo.example_fmu("furuta")  # a bundled model; the path of an .fmu file also works
ANGLES = {"armJoint.phi": "phi", "pendulumJoint.phi": "theta"}  # variables of the model, and their columns in the recording
NOMINAL = {"armFriction": 0.012, "pendulumFriction": 0.002}  # in N m s
WIDEST = 0.01  # distance above its nominal value within which a friction is searched, in N m s


def by_a_cost_function() -> None:
    """Fits with a Python function that simulates and compares, and is called by `fmin`."""
    recording = np.genfromtxt(RECORDING, delimiter=",", names=True)
    measured = np.array([recording[column] for column in ANGLES.values()])
    # in thousandths, so that one tolerance suits both
    unit = 1e-3
    nominal = np.array(list(NOMINAL.values())) / unit

    model = FMUModel(PENDULUM)

    def squared_error(frictions: np.ndarray) -> float:
        model.set(list(NOMINAL), frictions * unit)
        response = model.simulate(final_time=recording["time"][-1], outputs=list(ANGLES))
        return dfo.quad_err(recording["time"], measured, response["time"], np.array([response[angle] for angle in ANGLES]))

    best, cost, _, n_evaluations, seconds = dfo.fmin(
        squared_error, xstart=nominal, lb=np.zeros(2), ub=nominal + WIDEST / unit, x_tol=1e-3, f_tol=1e-2
    )
    found = ", ".join(f"{name} = {value:.6f}" for name, value in zip(NOMINAL, best * unit))
    print(f"\nWith a cost function: {found}")
    print(f"cost {cost:.4f} after {n_evaluations} evaluations in {seconds:.2f} s\n")


def by_a_calibration() -> pydfo.Fit:
    """Fits with a `Calibration`, which runs as native code."""
    calibration = pydfo.Calibration(
        PENDULUM,
        data=RECORDING,
        outputs=ANGLES,
        parameters=[pydfo.Parameter(name, start, 0.0, start + WIDEST) for name, start in NOMINAL.items()],
    )
    fit = calibration.fit()
    print(f"With a calibration:\n{fit}")
    return fit


if __name__ == "__main__":
    by_a_cost_function()
    fit = by_a_calibration()
    try:
        figure = fit.plot()
    except ImportError as error:  # matplotlib is an extra
        print(error)
    else:
        figure.savefig("furuta.png", dpi=120)
        print("\nplot written to furuta.png")
