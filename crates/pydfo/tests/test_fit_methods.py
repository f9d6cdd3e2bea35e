"""Fits by every method, and their continuation from checkpoints."""

from __future__ import annotations

import numpy as np
import pytest
import recordings
from methods import METHODS, timeless
from test_calibration import TIME, TRUE, decay

import pydfo
from pydfo import Calibration, Experiment, Parameter, example_fmu

BOXED = [Parameter("k", 1.0, 0.1, 5.0)]


@pytest.fixture(scope="module")
def dahlquist():
    """x' = -k x, x(0) = 1."""
    return example_fmu("dahlquist")


@pytest.mark.parametrize("method", METHODS)
def test_methods_fit_with_their_options(dahlquist, method):
    calibration = decay(dahlquist, parameters=BOXED)
    options = {"population": 24} if method in ("de", "de-classic", "ga", "cma-es") else {"batch": 4}
    options = {"points": 3} if method == "quadratic-model" else options
    fits = [calibration.fit(method, rng=3, max_evaluations=500, workers=workers, options=options) for workers in (1, 2)]
    fit = fits[0]
    assert fit.method == method and fit.x[0] == pytest.approx(2.0, abs=2e-3)
    assert timeless(fits[0]) == timeless(fits[1])
    if "population" in options:
        assert fit.seed == 3 and np.count_nonzero(fit.trace.batch == 0) == 24
    elif "batch" in options:
        assert fit.batch == str(options["batch"])


@pytest.mark.parametrize("method", METHODS)
def test_fit_resumes_from_checkpoint(dahlquist, method, tmp_path):
    calibration = decay(dahlquist, parameters=BOXED)
    options = {"budget": 200} if method == "de" else {}
    run = {"method": method, "rng": 5, "options": options, "workers": 1}
    whole = calibration.fit(**run, max_evaluations=200)
    path, evaluations = tmp_path / "fit", 0
    while evaluations < 200:
        evaluations = min(evaluations + 23, 200)
        fit = calibration.fit(**run, max_evaluations=evaluations, checkpoint=path)
    assert timeless(fit) == timeless(whole)
    other = decay(dahlquist, data={"time": TIME, "x": TRUE + 1e-9}, parameters=BOXED)
    before = path.read_bytes()
    with pytest.raises(pydfo.CheckpointError, match="data of experiment 0"):
        other.fit(**run, max_evaluations=200, checkpoint=path)
    with pytest.raises(pydfo.CheckpointError, match="relative_tolerance of the simulations: 1e-10 in the file, 1e-9 in this run"):
        decay(dahlquist, parameters=BOXED, relative_tolerance=1e-9).fit(**run, max_evaluations=200, checkpoint=path)
    assert path.read_bytes() == before


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_least_squares_uses_residuals_of_simulations(dahlquist, scale):
    noisy = {"time": TIME, "x": TRUE + 0.01 * np.sin(50 * TIME)}
    calibration = decay(dahlquist, noisy, parameters=[Parameter("k", 1.0, 0.1, 5.0, scale=scale)])
    fits = [calibration.fit("least-squares", batch="serial", workers=workers) for workers in (1, 3)]
    assert timeless(fits[0]) == timeless(fits[1]) and fits[0].success and fits[0].nfev < 20
    fit, simplex = fits[0], calibration.fit("nelder-mead")
    assert fit.cost == pytest.approx(simplex.cost, rel=1e-4) and fit.nfev < simplex.nfev
    assert simplex.jac is None and simplex.cov == pytest.approx(fit.cov, rel=1e-3)
    # x = exp(-k t): derivative with respect to k, even if its logarithm is searched.
    by_k = -TIME * np.exp(-fit.x[0] * TIME)
    np.testing.assert_allclose(fit.jac[:, 0], by_k, atol=2e-3)
    assert fit.cov[0, 0] == pytest.approx(fit.cost / 4 / np.sum(by_k**2), rel=0.01)
    assert fit.cov_message == "" and fit.active_mask.tolist() == [0] and fit["fun"] == fit.cost
    np.testing.assert_array_equal(fit.residuals(), calibration.residuals(fit.x))
    assert "least" in fit.method and "cost" in repr(fit)


def test_least_squares_supports_experiments_bounds_and_stages(dahlquist):
    runs = [
        Experiment({"time": TIME, "x": 1.5 * TRUE}, ["x"], name="cold"),
        Experiment({"time": TIME, "x": 3.0 * TRUE}, ["x"], name="warm", start_values={"x": 2.5}),
    ]
    local = Parameter("x", 1.0, 0.1, 2.9, local=True)
    first = Calibration(dahlquist, runs, [Parameter("k", 1.0, 0.1, 5.0), local]).fit("least-squares")
    assert first.at_bound == {"x[warm]": "upper"} and first.active_mask.tolist() == [0, 0, 1]
    assert first.x[:2] == pytest.approx([2.0, 1.5], rel=0.05) and first.x[2] == 2.9
    assert "x[warm]" in first.cov_message and first.jac.shape == (10, 3)
    # A second stage: one parameter is fixed at the result of the first stage.
    held = Parameter("k", first.parameters["k"], fixed=True)
    second = Calibration(dahlquist, runs, [held, Parameter("x", 1.0, 0.1, 5.0, local=True)]).fit("least-squares")
    assert second.x[0] == first.x[0] and second.cost < first.cost and not second.at_bound
    assert second.jac[:, 0].tolist() == [0.0] * 10 and second.cov_message.endswith("k")


def test_least_squares_tolerates_failed_simulations(dahlquist):
    # Euler's method overflows for large k.
    data = {"time": TIME, "x": np.exp(-4.0 * TIME)}
    parameters = [Parameter("k", 1.0, 0.1, 1e6, nominal=1e5)]
    calibration = decay(dahlquist, data, parameters=parameters, solver="euler", step_size=0.001, relative_tolerance=None)
    fits = [calibration.fit("least-squares", batch="serial", options={"radius": 1.0}, workers=workers) for workers in (1, 4)]
    assert timeless(fits[0]) == timeless(fits[1])
    fit = fits[0]
    assert fit.nfail > 0 and sum(fit.failures.values()) == fit.nfail and fit.cost <= fit.start_cost
    assert np.isfinite(fit.jac).all() and len(fit.residuals()) == 5


def test_least_squares_resumes_from_checkpoint(dahlquist, tmp_path):
    calibration = decay(dahlquist, parameters=BOXED)
    whole = calibration.fit("least-squares", workers=1)
    for evaluations in range(1, whole.nfev + 1):
        fit = calibration.fit("least-squares", workers=1, max_evaluations=evaluations, checkpoint=tmp_path / "fit")
    fit = calibration.fit("least-squares", workers=1, checkpoint=tmp_path / "fit")
    assert timeless(fit) == timeless(whole) and fit.jac.tobytes() == whole.jac.tobytes()


def evaluations_until(fit, x, within):
    """Returns the number of evaluations after which a fit stayed this close to these values."""
    costs = np.minimum.accumulate(np.where(np.isnan(fit.trace.fun), np.inf, fit.trace.fun))
    best = [np.flatnonzero(fit.trace.fun == cost)[0] for cost in costs]
    near = (np.abs(fit.trace.x[best] - x) <= within).all(axis=1)
    assert near[-1], (fit.x, x)
    return len(near) - np.argmin(near[::-1]) + 1 if not near.all() else 1


def furuta(which):
    parameters = [Parameter("armFriction", 0.012, 0, 0.022), Parameter("pendulumFriction", 0.002, 0, 0.012)]
    outputs = {"armJoint.phi": "phi", "pendulumJoint.phi": "theta"}
    return Calibration(example_fmu("furuta"), recordings.furuta(which), outputs, parameters)


def quad_tank(which, n):
    outlets = [Parameter(f"qt.a{i}", 3e-6, 2e-6, 4e-6) for i in range(1, n + 1)]
    data = recordings.quad_tank(which)
    return Calibration(example_fmu("quad_tank"), data, recordings.LEVELS[:n], outlets, inputs=["u1", "u2"])


@pytest.mark.parametrize(
    ("make", "file", "within", "bars"),
    [
        (furuta, "FurutaData.mat", [3e-5, 3e-6], (25, 40)),
        (lambda which: quad_tank(which, 2), "qt_par_est_data.mat", 2e-9, (15, 25)),
        (lambda which: quad_tank(which, 4), "qt_par_est_data.mat", 3e-9, (20, 30)),
    ],
    ids=["furuta", "quad_tank_2", "quad_tank_4"],
)
def test_least_squares_needs_few_simulations(make, file, within, bars):
    for which in recordings.at_hand(file):
        calibration = make(which)
        fit, simplex = calibration.fit("least-squares"), calibration.fit("nelder-mead", x_tol=1e-6, f_tol=1e-9)
        assert fit.success and fit.cost == pytest.approx(simplex.cost, rel=1e-5), which
        used = evaluations_until(fit, simplex.x, within), fit.nfev
        assert used[0] <= bars[0] and used[1] <= bars[1] and fit.nfev < simplex.nfev / 3, (which, used)


@pytest.mark.parametrize("which", recordings.at_hand("exhaust_measurements.csv"))
def test_least_squares_needs_few_simulations_for_exhaust_pipe(which):
    start = {"C1": 2500.0, "G1": 120.0, "C2": 9000.0, "G2": 80.0}
    fixed: dict[str, float] = {}
    for names, within in ((["C2", "G2"], [100, 1]), (["C1", "G1"], [40, 0.6])):
        calibration = Calibration(
            example_fmu("exhaust"),
            recordings.exhaust(which),
            ["T_out"],
            [Parameter(name, start[name], *((1, 5e4) if name[0] == "C" else (0.01, 500))) for name in names],
            inputs=recordings.EXHAUST_INPUTS,
            window=(0, 600),
            start_values=fixed,
        )
        fit = calibration.fit("least-squares")
        accurate = calibration.fit("least-squares", start=fit.x, x_tol=1e-7, f_tol=1e-9, max_evaluations=80)
        assert fit.success and fit.nfev <= 30 and evaluations_until(fit, accurate.x, within) <= 30
        fixed = fit.parameters


@pytest.mark.parametrize("method", ["least-squares", "nelder-mead"])
@pytest.mark.parametrize("loss", ["soft_l1", "huber", "cauchy"])
def test_robust_loss_limits_outliers(dahlquist, method, loss, tmp_path):
    calibration = decay(dahlquist, {"time": TIME, "x": TRUE + [0, 0, 0.5, 0, 0]}, parameters=BOXED)
    plain = calibration.fit(method)
    run = {"method": method, "loss": loss, "f_scale": 0.01, "workers": 1, "x_tol": 1e-6, "f_tol": 1e-8, "batch": "serial"}
    fit = calibration.fit(**run, checkpoint=tmp_path / "fit")
    assert abs(fit.x[0] - 2) < 0.5 * abs(plain.x[0] - 2)

    def counted(k):
        z = (calibration.residuals([k]) / 0.01) ** 2
        rho = {"soft_l1": 2 * (np.sqrt(1 + z) - 1), "huber": np.where(z <= 1, z, 2 * np.sqrt(z) - 1), "cauchy": np.log1p(z)}
        return 1e-4 * np.sum(rho[loss])

    assert fit.cost == pytest.approx(counted(fit.x[0]), rel=1e-10) and fit.start_cost == pytest.approx(counted(1.0), rel=1e-10)
    assert all(fit.cost <= counted(fit.x[0] + step) for step in (-0.01, 0.01))
    again = calibration.fit(**{**run, "workers": 3})
    assert timeless(again) == timeless(fit)
    with pytest.raises(pydfo.CheckpointError, match="loss"):
        calibration.fit(**{**run, "f_scale": 0.02}, checkpoint=tmp_path / "fit")
