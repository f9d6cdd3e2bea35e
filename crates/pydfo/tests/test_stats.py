"""Costs of simulations: reproducible counts, and times."""

from __future__ import annotations

import time

import numpy as np
import pytest

import pydfo
from pydfo import Calibration, FMUModel, Parameter, example_fmu, ode

TIMES = np.linspace(0.0, 1.5, 16)


def bouncing(**changes):
    """Returns a calibration of a bouncing ball with heights that it cannot reach."""
    data = {"time": TIMES, "h": np.full(16, 0.2)}
    parameters = [Parameter("e", 0.7, 0.1, 0.95)]
    return Calibration(example_fmu("bouncing_ball"), data, outputs=["h"], parameters=parameters, **changes)


@pytest.mark.parametrize("kind", ["me", "cs"])
def test_simulation_reports_its_duration(kind):
    model = FMUModel(example_fmu("van_der_pol", kind=kind.upper()), kind=kind)
    first, second = model.simulate(0, 20), model.simulate(0, 20)
    assert first.stats == second.stats
    for stats in (first.stats, second.stats):
        assert 0 < stats.seconds_in_model <= stats.seconds
    assert "seconds_in_model" in repr(first.stats)


def test_time_in_model_excludes_input_functions():
    calls = 0

    def ramp(t):
        nonlocal calls
        calls += 1
        time.sleep(1e-3)
        return 0.3 * t

    model = FMUModel(example_fmu("switched_input"))
    stats = model.simulate(0, 1, input=("u", ramp), ncp=5).stats
    assert calls > 20 and stats.seconds - stats.seconds_in_model > 0.9e-3 * 20


def test_time_in_model_includes_ode_functions():
    def slow(t, y):
        time.sleep(1e-3)
        return -y

    res = ode.solve(slow, (0, 1), [1.0])
    assert res.stats.seconds == res.seconds >= res.seconds_in_model == res.stats.seconds_in_model
    assert res.seconds_in_model > 0.9e-3 * res.nfev


@pytest.mark.parametrize("workers", [1, 2])
def test_fit_adds_up_its_simulations(workers):
    fit = bouncing().fit(max_evaluations=15, workers=workers, batch=4)
    model = FMUModel(example_fmu("bouncing_ball"))
    counts = np.zeros(3, dtype=int)
    for x, above in zip(fit.trace.x[:, 0], fit.trace.above):
        model.set("e", x)
        stats = model.simulate(final_time=1.5, times=TIMES, solver=fit.solver, output=["h"]).stats
        if np.isnan(above):
            counts += (stats.right_hand_sides, stats.accepted_steps, stats.state_events)
    total = np.array([fit.stats.right_hand_sides, fit.stats.accepted_steps, fit.stats.state_events])
    # Abandoned simulations count up to their end.
    assert (total >= counts).all() and (counts > 0).all()
    assert np.isnan(fit.trace.above).all() or (total > counts).any()
    assert 0 < fit.stats.seconds_in_model <= fit.stats.seconds
    assert f"{fit.stats.right_hand_sides} right-hand sides" in repr(fit) and "inside the model" in repr(fit)
    assert fit["stats"] is fit.stats
    # The speculative simulations depend on the duration of simulations.
    one, other = (bouncing().fit(max_evaluations=15, workers=n, batch="serial").stats for n in (1, workers))
    assert one == other


def test_phase_counts_are_reproducible():
    """The checks of the model depend on the clock and on the process used, so they are not simulations of a phase."""

    def counts(stats):
        return {name: (taken["simulations"], taken["right_hand_sides"]) for name, taken in stats.phases.items()}

    fits = [bouncing().fit(max_evaluations=15, workers=2) for _ in range(5)]
    first = counts(fits[0].stats)
    assert [counts(fit.stats) for fit in fits] == [first] * 5
    assert sum(simulations for simulations, _ in first.values()) == fits[0].stats.runs
    assert fits[0].stats.check_runs > 0


def test_discrete_parameters_are_fitted_by_suitable_methods():
    data = {"time": TIMES, "x": np.exp(-3.0 * TIMES)}
    k = Parameter("k", 1, 1, 8, kind="integer")
    assert repr(k) == "Parameter('k', 1.0, 1.0, 8.0, kind='integer')"
    fit = Calibration(example_fmu("dahlquist"), data, outputs=["x"], parameters=[k]).fit(rng=1, max_evaluations=200)
    assert fit.method == "cma-es" and fit.x.tolist() == [3.0] and (fit.trace.x == np.round(fit.trace.x)).all()
    choice = Parameter("k", 2, 1, 5, kind="categorical")
    calibration = Calibration(example_fmu("dahlquist"), data, outputs=["x"], parameters=[choice])
    fit = calibration.fit(rng=1, max_evaluations=200)
    assert fit.method == "ga" and fit.x.tolist() == [3.0]
    with pytest.raises(ValueError, match=r"not support x\[0\], which is categorical \(x\[0\] is parameter 'k'\)"):
        calibration.fit(method="nelder-mead")
    held = Parameter("k", 2, 1, 5, kind="integer", fixed=True)
    assert Calibration(example_fmu("dahlquist"), data, outputs=["x"], parameters=[held]).fit().method == "least-squares"
    for arguments, expected in [
        ({"start": 1.5, "lower": 1, "upper": 8, "kind": "integer"}, "'k': is integer, so start 1.5 must be an integer"),
        ({"start": 1.5, "lower": 1.2, "upper": 1.8, "kind": "categorical"}, "its bounds 1.2 and 1.8 contain no integer"),
        ({"start": 1, "kind": "odd"}, "kind = 'odd' is invalid; expected one of: 'continuous', 'integer', 'categorical'"),
    ]:
        with pytest.raises(ValueError, match=expected):
            Parameter("k", **arguments)


def test_checkpoint_of_another_fit_is_rejected_with_reason(tmp_path):
    path = tmp_path / "run"
    bouncing().fit("nelder-mead", max_evaluations=5, checkpoint=path)
    for other, expected in [
        (bouncing(max_step=0.5), "max_step of the simulations: none in the file, 0.5 in this run"),
        (bouncing(window=(0.0, 1.0)), "windows of experiment 0: none in the file, 0.0, 1.0 in this run"),
    ]:
        with pytest.raises(pydfo.CheckpointError, match=expected):
            other.fit("nelder-mead", max_evaluations=5, checkpoint=path)
    with pytest.raises(pydfo.CheckpointError, match="option restarts: 20 in the file, 1 in this run"):
        bouncing().fit(max_evaluations=5, checkpoint=path, options={"restarts": 1})
