"""The Furuta pendulum: trajectories, the objective of the paper's fit, events, and the calls of the paper's script.

Trajectories and measurements of the original are compared if available."""

from __future__ import annotations

import shutil

import fmus
import numpy as np
import pytest
import recordings

from pydfo import FMUModel, dfo, example_fmu

NOMINAL, OPTIMAL = (0.012, 0.002), (0.010, 0.001)
ANGLES = ["armJoint.phi", "pendulumJoint.phi"]


def model(friction):
    pendulum = FMUModel(example_fmu("furuta"))
    pendulum.set(["armFriction", "pendulumFriction"], friction)
    return pendulum


@pytest.mark.parametrize("friction", [NOMINAL, OPTIMAL])
def test_methods_agree_on_the_trajectory(friction):
    times = np.linspace(0, 40, 401)

    def run(solver, rtol):
        return model(friction).simulate(0, 40, times=times, output=ANGLES, solver=solver, relative_tolerance=rtol)

    reference = run("dop853", 1e-12)
    for solver in ("auto", "tsit5", "radau5"):
        res = run(solver, 1e-8)
        assert max(np.abs(res[angle] - reference[angle]).max() for angle in ANGLES) < 1e-6


REFERENCES = [name for name in ("nominal", "optimal") if (recordings.PUBLISHED / f"furuta_reference_{name}.csv").is_file()]


@pytest.mark.parametrize("name", REFERENCES)
def test_trajectories_match_the_original(name):
    path = recordings.PUBLISHED / f"furuta_reference_{name}.csv"
    expected = np.genfromtxt(path, delimiter=",", names=True, deletechars="")
    friction = NOMINAL if name == "nominal" else OPTIMAL
    res = model(friction).simulate(0, 40, times=expected["time"], output=ANGLES, relative_tolerance=1e-8)
    assert len(res.time) == 401
    for angle in ANGLES:
        assert np.abs(res[angle] - expected[angle]).max() < 1e-6


def errors(friction, which):
    """Returns `quad_err` and the explicit sum of squares at the measured times."""
    data = recordings.furuta(which)
    y_meas = np.vstack([data["phi"], data["theta"]])
    res = model(friction).simulate(final_time=40, times=data["time"])
    y_sim = np.vstack([res[angle] for angle in ANGLES])
    return dfo.quad_err(data["time"], y_meas, res["time"], y_sim), np.sum((y_sim - y_meas) ** 2)


def test_objective_equals_noise_at_true_frictions():
    """Uses the generated recording, with the random draws of examples/data/generate_furuta.py."""
    rng = np.random.default_rng(recordings.SEED)
    noise = np.sum(rng.normal(0, 0.0305, 801) ** 2) + np.sum(rng.normal(0, 0.0207, 801) ** 2)
    assert errors(OPTIMAL, "own") == pytest.approx((noise, noise), rel=1e-4)
    assert errors(NOMINAL, "own")[0] > 100 * noise


@pytest.mark.parametrize("which", recordings.at_hand("FurutaData.mat")[1:])
@pytest.mark.parametrize(("friction", "cost", "within"), [(NOMINAL, 207.0783, 0.01), (OPTIMAL, 1.09246, 1e-3)])
def test_objective_matches_reference_at_measured_times(friction, cost, within, which):
    assert errors(friction, which) == pytest.approx((cost, cost), abs=within)


@pytest.mark.parametrize(
    ("friction", "times", "count", "rest"),
    [
        (NOMINAL, [0.418602, 0.944153, 1.309976, 1.346814, 1.356343], 49, 21.437539),
        (OPTIMAL, [0.205273, 0.403215, 0.950970, 1.315331], 74, 33.176408),
    ],
)
def test_events_match_reference(friction, times, count, rest):
    res = model(friction).simulate(final_time=40, relative_tolerance=1e-10)
    assert len(res.events) == res.stats.state_events == count
    assert res.events["time"][: len(times)] == pytest.approx(times, abs=2e-6)
    assert res.events["time"][-1] == pytest.approx(rest, abs=2e-6)


def test_calls_of_the_paper_script_work(tmp_path, monkeypatch):
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
    # Intermediate simulations do not change the result: equal parameters give bit-for-bit identical results.
    assert fmus.same_bits(first, simulate(np.array([12.0, 2.0])))
    stacked = np.vstack((first["armJoint.phi"], first["pendulumJoint.phi"]))
    assert dfo.quad_err(first["time"], stacked, first["time"], stacked) == 0.0
