"""The quadruple tank: trajectory, cost and both fits, on a generated recording and the public JModelica.org one, if
available.

The generated recording has known outlets and a noise of 0.3 mm. Expected numbers of the public recording were
computed with other tools (SciPy's integrators and a gradient method).
"""

from __future__ import annotations

import numpy as np
import pytest
import recordings

from pydfo import Calibration, FMUModel, Parameter, dfo, example_fmu

LEVELS = recordings.LEVELS
AT_HAND = recordings.at_hand("qt_par_est_data.mat")
published = pytest.mark.parametrize("data", [recordings.quad_tank(which) for which in AT_HAND[1:]], ids=AT_HAND[1:])
every = pytest.mark.parametrize("data", [recordings.quad_tank(which) for which in AT_HAND], ids=AT_HAND)
#: Outlets of the generated recording in 1e-6 m2, and its noise in m.
TRUE_OUTLETS, NOISE = [2.66, 2.71, 3.01, 2.93], 3e-4
PUBLIC_EXAMPLE = {2: [0.07060188, 0.06654621, 0.02736549, 0.02789857], 4: [0.07059621, 0.06672873, 0.02723064, 0.02912602]}


def held(data):
    """Returns the voltages held constant between the rows: each row except the first occurs twice."""
    time, (u1, u2) = np.repeat(data["time"], 2)[1:], (np.repeat(data[u], 2)[:-1] for u in ("u1", "u2"))
    return {"time": time, "u1": u1, "u2": u2}


def calibration(n, data, **more):
    """Returns a calibration of the first `n` outlets with the first `n` levels."""
    outlets = [Parameter(f"qt.a{i}", 3e-6, 2e-6, 4e-6) for i in range(1, n + 1)]
    return Calibration(example_fmu("quad_tank"), data, LEVELS[:n], outlets, inputs=["u1", "u2"], **more)


@published
def test_recording_is_read(data):
    assert data["time"] == pytest.approx(np.arange(61.0), abs=1e-9)
    first, last = ([data[name][row] for name in [*LEVELS, "u1", "u2"]] for row in (0, -1))
    assert first == pytest.approx([0.0627155, 0.0604378, 0.0239493, 0.0232491, 5, 5], abs=5e-8)
    assert last == pytest.approx([0.0694589, 0.0656178, 0.0267666, 0.0299988, 6, 5], abs=5e-8)


@pytest.mark.parametrize("n", [2, 4])
def test_outlets_of_generated_recording_are_found(n):
    data = recordings.quad_tank("own")
    fit = calibration(n, data).fit()
    assert fit.success and not fit.at_bound and not fit.without_effect
    # With this noise, the levels determine the outlets to half a percent.
    assert [1e6 * a for a in fit.parameters.values()] == pytest.approx(TRUE_OUTLETS[:n], rel=5e-3)
    assert fit.rms == pytest.approx(NOISE, rel=4 / np.sqrt(2 * 61 * n))
    measured = np.vstack([data[x] for x in LEVELS[:n]])
    model = FMUModel(example_fmu("quad_tank"))
    model.set(list(fit.parameters), list(fit.parameters.values()))
    inputs = {name: data[name] for name in ("time", "u1", "u2")}
    res = model.simulate(0, 60, times=data["time"], input=inputs, output=LEVELS)
    simulated = np.vstack([res[x] for x in LEVELS[:n]])
    assert dfo.quad_err(data["time"], measured, res["time"], simulated) == pytest.approx(fit.cost, rel=1e-6)


@published
def test_nominal_trajectory_matches_reference(data):
    inputs = {name: data[name] for name in ("time", "u1", "u2")}
    res = FMUModel(example_fmu("quad_tank")).simulate(0, 60, times=[10, 30, 60], input=inputs, relative_tolerance=1e-10)
    expected = [
        [0.05911232, 0.05712876, 0.02746726, 0.0258262],
        [0.05386523, 0.05414662, 0.02581327, 0.02554802],
        [0.05642489, 0.05510474, 0.02736535, 0.02789820],
    ]
    assert np.column_stack([res[x] for x in LEVELS]) == pytest.approx(np.array(expected), abs=5.1e-9)


@pytest.mark.parametrize(
    ("n", "start", "outlets", "cost", "rms", "final"),
    [
        (2, 0.01197096, [2.65838, 2.71220], 3.20422e-5, 0.512, [0.0706447, 0.0666059, 0.0273654, 0.0278982]),
        (
            4,
            0.01209873,
            [2.65931, 2.70252, 3.00666, 2.93158],
            9.44303e-5,
            0.622,
            [0.0706187, 0.0668527, 0.0272434, 0.0291598],
        ),
    ],
)
@published
def test_fits_match_reference(n, start, outlets, cost, rms, final, data):
    problem = calibration(n, data)
    assert problem.cost() == pytest.approx(start, abs=1e-6)
    fit = problem.fit()
    assert fit.success
    assert [1e6 * a for a in fit.parameters.values()] == pytest.approx(outlets, abs=2e-3)
    assert fit.cost == pytest.approx(cost, abs=1e-7)
    assert 1e3 * fit.rms == pytest.approx(rms, abs=0.002)
    assert 1e3 * np.sqrt(fit.cost / (61 * n)) == pytest.approx(1e3 * fit.rms, rel=1e-12)
    model = FMUModel(example_fmu("quad_tank"))
    model.set(list(fit.parameters), list(fit.parameters.values()))
    inputs = {name: data[name] for name in ("time", "u1", "u2")}
    res = model.simulate(0, 60, input=inputs, output=[*LEVELS, "u1", "u2"])
    assert [res.final(x) for x in LEVELS] == pytest.approx(final, abs=5e-5)
    assert [res.final(x) for x in LEVELS] == pytest.approx(PUBLIC_EXAMPLE[n], abs=1e-3)
    assert (res.final("u1"), res.final("u2")) == (6, 5)


@pytest.mark.parametrize("solver", ["auto", "radau5", "dop853"])
@every
def test_cost_is_smooth_across_kinks_of_voltages(solver, data):
    """Voltages change their slope at each second. The cost at rtol 1e-6 must not be noisy."""
    problem = calibration(4, data, solver=solver, relative_tolerance=1e-6)
    start = [3e-6] * 4
    cost = problem.cost(start)
    for k in range(4):
        moved = list(start)
        moved[k] *= 1 + 1e-9
        assert abs(problem.cost(moved) / cost - 1) < 1e-8


@pytest.mark.parametrize(("n", "outlets", "cost"), [(2, [2.6555, 2.7097], 3.911e-5), (4, [2.6564, 2.6998, 3.0059, 2.9297], 1.243e-4)])
@published
def test_held_voltages_give_reference_outlets(n, outlets, cost, data):
    steps = held(data)
    levels = {x: np.full(121, np.nan) for x in LEVELS[:n]}
    for x, column in levels.items():
        column[0::2] = data[x]  # the second of the two rows of a time
    fit = calibration(n, steps | levels).fit()
    assert [1e6 * a for a in fit.parameters.values()] == pytest.approx(outlets, abs=2e-4)
    assert fit.cost == pytest.approx(cost, rel=3e-4)


@every
def test_script_with_cost_function_finds_outlets(data, request):
    """Model, inputs, simulate, quad_err, fmin: as in the 2012 paper, in its units."""
    inputs = {name: data[name] for name in ("time", "u1", "u2")}
    measured = np.vstack([data[x] for x in LEVELS[:2]])

    def cost(a):
        model = FMUModel(example_fmu("quad_tank"))
        model.set(["qt.a1", "qt.a2"], a * 1e-6)
        res = model.simulate(final_time=60, input=inputs)
        return dfo.quad_err(data["time"], measured, res["time"], np.vstack([res[x] for x in LEVELS[:2]]))

    start = np.array([3.0, 3.0])
    from_start = cost(start)
    x_opt, f_opt, _, n_evaluations, _ = dfo.fmin(cost, xstart=start, lb=[2, 2], ub=[4, 4], x_tol=1e-4, f_tol=1e-9)
    assert n_evaluations < 200
    if "published" in request.node.name:
        assert from_start == pytest.approx(0.01197096, abs=1e-6)
        assert x_opt == pytest.approx([2.65838, 2.71220], abs=2e-3)
        assert f_opt == pytest.approx(3.20422e-5, abs=1e-7)
    else:
        assert x_opt == pytest.approx(TRUE_OUTLETS[:2], rel=5e-3)
        assert f_opt <= cost(np.array(TRUE_OUTLETS[:2])) < from_start / 100
