"""Calibrates the outlets of a quadruple tank driven by recorded voltages, with inputs from the data, in two steps.

The first step fits the outlets of the lower tanks to the lower levels, the second one all four outlets to all four
levels.
"""

from pathlib import Path

import pydfo

DATA = Path(__file__).resolve().parent / "data" / "quad_tank.csv"


def calibrate(outlets, levels):
    """Fits these outlets (numbers of tanks) to these levels, from 3e-6 m2, and prints the result."""
    calibration = pydfo.Calibration(
        pydfo.example_fmu("quad_tank"),
        data=DATA,
        inputs=["u1", "u2"],  # the model's inputs; the columns have the same names
        outputs={f"qt.x{i}": f"x{i}" for i in levels},
        parameters=[pydfo.Parameter(f"qt.a{i}", 3e-6, 2e-6, 4e-6) for i in outlets],
    )
    fit = calibration.fit()
    print(f"{len(fit.parameters)} outlets to {len(levels)} levels:\n{fit}")
    final = fit.simulate(outputs="all")
    print("final levels " + ", ".join(f"{final[f'qt.x{i}'][-1]:.5f}" for i in (1, 2, 3, 4)) + " m\n")
    return fit


calibrate(outlets=[1, 2], levels=[1, 2])
calibrate(outlets=[1, 2, 3, 4], levels=[1, 2, 3, 4])
