"""Fits an FMU with its own solver (co-simulation) to a recording in cm and ms instead of the model's units.

The recording of quad_tank.py is in the form that a data logger would write. The columns declare their units, and the
values are converted to the units of the model's variables. The fitted model is then exported: a report, the parameters
for other tools (`.ssv`), and a copy of the FMU with new start values.
"""

import tempfile
from pathlib import Path

import numpy as np

import pydfo

RECORDING = Path(__file__).resolve().parent / "data" / "quad_tank.csv"


def logged():
    """Returns the recording in cm and ms, with the names of a data logger."""
    recording = np.genfromtxt(RECORDING, delimiter=",", names=True)
    columns = {"t [ms]": 1e3 * recording["time"], "u1": recording["u1"], "u2": recording["u2"]}
    return columns | {f"level {i} [cm]": 1e2 * recording[f"x{i}"] for i in (1, 2, 3, 4)}


def main():
    calibration = pydfo.Calibration(
        pydfo.example_fmu("quad_tank", kind="CS"),
        data=logged(),
        time="t",
        inputs=["u1", "u2"],
        outputs={f"qt.x{i}": f"level {i}" for i in (1, 2, 3, 4)},
        parameters=[pydfo.Parameter(f"qt.a{i}", 3e-6, 2e-6, 4e-6) for i in (1, 2, 3, 4)],
        step_size=0.1,
    )
    print(calibration.check())
    fit = calibration.fit()
    print(fit)

    folder = Path(tempfile.mkdtemp(prefix="quad-tank-"))
    fit.report(folder / "report.html")
    fit.save(folder / "quad_tank.fit")
    fit.export_ssv(folder / "quad_tank.ssv")
    fit.export_fmu(folder / "quad_tank.fmu")
    again = pydfo.load_fit(folder / "quad_tank.fit")
    if not np.array_equal(again.x, fit.x):
        raise SystemExit("the loaded fit differs from the saved fit")
    print(f"\nReport, fit, parameters and calibrated FMU are in {folder}")


if __name__ == "__main__":
    main()
