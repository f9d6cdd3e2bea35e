"""The paper's own script (section 6.1) with only its import lines changed, on the paper's measurements."""

from __future__ import annotations

from pathlib import Path

import numpy as N
import pytest

DATA = Path(__file__).resolve().parents[4] / "shared" / "data"
pytestmark = pytest.mark.skipif(not (DATA / "FurutaData.mat").is_file(), reason="FurutaData.mat is not at hand")


def script(monkeypatch, tmp_path, stop="any", at_measured_times=False):
    """Everything from loading the data to the result, as printed in the paper."""
    import shutil

    from scipy.io import loadmat

    from pydfo import FMUModel, dfo, example_fmu

    shutil.copy(example_fmu("furuta"), tmp_path / "Furuta.fmu")
    shutil.copy(DATA / "FurutaData.mat", tmp_path)
    monkeypatch.chdir(tmp_path)

    # Load measurement data from file
    data = loadmat("FurutaData")

    # Extract data series
    t_meas = data["time"][:, 0]
    phi_meas = data["phi"][:, 0]
    theta_meas = data["theta"][:, 0]

    y_meas = N.vstack((phi_meas, theta_meas))

    # Define the objective function
    def furuta_dfo_cost(x):
        # Scale down
        armFriction = x[0] / 1e3
        pendFriction = x[1] / 1e3

        # Load the FMU Model
        model = FMUModel("Furuta.fmu")

        # Set new parameter values
        model.set("armFriction", armFriction)
        model.set("pendulumFriction", pendFriction)

        # Simulate the model response
        if at_measured_times:
            res = model.simulate(final_time=40, times=t_meas)
        else:
            res = model.simulate(final_time=40)

        # Load simulation result
        phi_sim = res["armJoint.phi"]
        theta_sim = res["pendulumJoint.phi"]
        t_sim = res["time"]

        # Evaluate the objective function
        y_sim = N.vstack((phi_sim, theta_sim))
        obj = dfo.quad_err(t_meas, y_meas, t_sim, y_sim)

        return obj

    # Specify initial conditions (scaled)
    x0 = N.array([0.012, 0.002]) * 1e3

    # Lower and Upper bounds
    lb = N.zeros(2)
    ub = x0 + 10

    # Solve using the Nelder-Mead algorithm
    if stop == "any":
        res = dfo.fmin(furuta_dfo_cost, xstart=x0, lb=lb, ub=ub, x_tol=1e-3, f_tol=1e-2)
    else:
        res = dfo.fmin(furuta_dfo_cost, xstart=x0, lb=lb, ub=ub, x_tol=1e-3, f_tol=1e-2, stop=stop)

    # Optimal point rescaled
    [armFriction_opt, pendFriction_opt] = res[0] / 1e3
    return armFriction_opt, pendFriction_opt, res


def test_the_script_finds_what_the_paper_found(monkeypatch, tmp_path, capsys):
    arm, pendulum, res = script(monkeypatch, tmp_path)
    assert arm == pytest.approx(0.0100, abs=1e-4) and pendulum == pytest.approx(0.00100, abs=1e-5)
    assert 1.1085 - 0.002 <= res.fun <= 1.1085 + 0.012
    assert res.nfev <= 150 and res.success
    assert len(capsys.readouterr().out.splitlines()) == res.nit + 5


def test_with_both_tests_it_is_closer(monkeypatch, tmp_path):
    arm, pendulum, res = script(monkeypatch, tmp_path, stop="all")
    assert arm == pytest.approx(0.0100, abs=3e-5) and pendulum == pytest.approx(0.00100, abs=3e-6)
    assert res.fun == pytest.approx(1.1085, abs=2e-3)


def test_sampled_at_the_measured_times_there_is_no_error_of_interpolation(monkeypatch, tmp_path):
    assert script(monkeypatch, tmp_path, at_measured_times=True)[2].fun <= 1.103
    assert script(monkeypatch, tmp_path, stop="all", at_measured_times=True)[2].fun <= 1.0930
