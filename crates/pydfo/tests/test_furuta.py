"""The Furuta pendulum: trajectories of the original model, the objective of the paper's fit, events, and the way in which
the paper's script uses a model."""

from __future__ import annotations

import shutil
from pathlib import Path

import fmus
import numpy as np
import pytest

from pydfo import FMUModel, dfo, example_fmu

#: Reference data, which are not part of the project.
DATA = Path(__file__).resolve().parents[3].parent / "shared" / "data"
NOMINAL, OPTIMAL = (0.012, 0.002), (0.010, 0.001)
ANGLES = ["armJoint.phi", "pendulumJoint.phi"]


def reference(name):
    path = DATA / name
    if not path.exists():
        pytest.skip(f"no reference data: {path} does not exist")
    return path


def model(friction):
    pendulum = FMUModel(example_fmu("furuta"))
    pendulum.set(["armFriction", "pendulumFriction"], friction)
    return pendulum


def measurements():
    loadmat = pytest.importorskip("scipy.io").loadmat
    data = loadmat(reference("FurutaData.mat"))
    return data["time"][:, 0], np.vstack([data["phi"][:, 0], data["theta"][:, 0]])


@pytest.mark.parametrize(("friction", "name"), [(NOMINAL, "nominal"), (OPTIMAL, "optimal")])
def test_trajectories(friction, name):
    expected = np.genfromtxt(reference(f"furuta_reference_{name}.csv"), delimiter=",", names=True, deletechars="")
    res = model(friction).simulate(0, 40, times=expected["time"], output=ANGLES, relative_tolerance=1e-8)
    assert len(res.time) == 401
    for angle in ANGLES:
        assert np.abs(res[angle] - expected[angle]).max() < 1e-6


@pytest.mark.parametrize(("friction", "cost", "within"), [(NOMINAL, 207.0783, 0.01), (OPTIMAL, 1.09246, 1e-3)])
def test_the_objective_at_the_measured_times(friction, cost, within):
    t_meas, y_meas = measurements()
    res = model(friction).simulate(final_time=40, times=t_meas)
    y_sim = np.vstack([res[angle] for angle in ANGLES])
    assert dfo.quad_err(t_meas, y_meas, res["time"], y_sim) == pytest.approx(cost, abs=within)
    assert np.sum((y_sim - y_meas) ** 2) == pytest.approx(cost, abs=within)


@pytest.mark.parametrize(
    ("friction", "times", "count", "rest"),
    [
        (NOMINAL, [0.418602, 0.944153, 1.309976, 1.346814, 1.356343], 49, 21.437539),
        (OPTIMAL, [0.205273, 0.403215, 0.950970, 1.315331], 74, 33.176408),
    ],
)
def test_events(friction, times, count, rest):
    res = model(friction).simulate(final_time=40, relative_tolerance=1e-10)
    assert len(res.events) == res.stats.state_events == count
    assert res.events["time"][: len(times)] == pytest.approx(times, abs=2e-6)
    assert res.events["time"][-1] == pytest.approx(rest, abs=2e-6)


def test_as_the_script_of_the_paper_uses_it(tmp_path, monkeypatch):
    shutil.copy(example_fmu("furuta"), tmp_path / "Furuta.fmu")
    monkeypatch.chdir(tmp_path)

    def simulate(x):
        fmu = FMUModel("Furuta.fmu")
        fmu.set("armFriction", x[0] / 1e3)
        fmu.set("pendulumFriction", x[1] / 1e3)
        return fmu.simulate(final_time=40)

    first = simulate(np.array([12.0, 2.0]))
    assert first["time"].shape == first["armJoint.phi"].shape == first["pendulumJoint.phi"].shape == (501,)
    assert np.array_equal(first["time"], np.append(0.08 * np.arange(500), 40.0))
    other = simulate(np.array([10.0, 1.0]))
    assert not fmus.same_bits(first, other)
    # Whatever was simulated in between: the same parameters, the same bits.
    assert fmus.same_bits(first, simulate(np.array([12.0, 2.0])))
    stacked = np.vstack((first["armJoint.phi"], first["pendulumJoint.phi"]))
    assert dfo.quad_err(first["time"], stacked, first["time"], stacked) == 0.0
