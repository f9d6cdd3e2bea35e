"""`least_squares` compared with SciPy: losses, result and rejected arguments."""

from __future__ import annotations

import concurrent.futures

import numpy as np
import pydfo
import pytest
from pydfo import least_squares

scipy_optimize = pytest.importorskip("scipy.optimize")

T = np.linspace(0, 4, 12)
MEASURED = 2 * np.exp(-0.7 * T) + 0.3 + 0.02 * np.sin(9 * T)
START = [1.0, 1.0, 0.0]
LOSSES = ["linear", "soft_l1", "huber", "cauchy"]


def decay(x, measured=MEASURED):
    return x[0] * np.exp(-x[1] * T) + x[2] - measured


def with_outlier(x):
    return decay(x) - np.where(np.arange(12) == 5, 0.7, 0.0)


def columns(x):
    return x[0] * np.exp(-x[1] * T[:, None]) + x[2] - MEASURED[:, None]


def fails_sometimes(x):
    if x[1] > 0.9:
        raise ValueError("too fast")
    return decay(x)


def timeless(result):
    return result.x.tobytes(), result.fun.tobytes(), result.jac.tobytes(), result.nfev, result.nit, result.message.partition("; continued from ")[0]


@pytest.mark.parametrize("loss", LOSSES)
def test_optimum_jacobian_and_covariance_match_scipy(loss):
    ours = least_squares(with_outlier, START, loss=loss, f_scale=0.1)
    theirs = scipy_optimize.least_squares(with_outlier, START, loss=loss, f_scale=0.1, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert ours.success and ours.status == 0, ours
    assert ours.cost == pytest.approx(2 * theirs.cost, rel=1e-8)
    np.testing.assert_allclose(ours.x, theirs.x, rtol=1e-4)
    np.testing.assert_allclose(ours.fun, with_outlier(ours.x), rtol=1e-13, atol=1e-15)
    assert ours.sum_of_squares == pytest.approx(np.sum(with_outlier(ours.x) ** 2), rel=1e-13)
    plain = scipy_optimize.approx_fprime(ours.x, with_outlier, 1e-7)
    np.testing.assert_allclose(ours.jac, plain, atol=2e-3 * np.abs(plain).max())
    assert ours.active_mask.tolist() == [0, 0, 0] and ours.cov_message == ""
    if loss == "linear":
        expected = ours.cost / (12 - 3) * np.linalg.inv(plain.T @ plain)
        np.testing.assert_allclose(ours.cov, expected, rtol=0.02)
        assert (ours.fun == with_outlier(ours.x)).all() and ours.cost == ours.sum_of_squares


def test_covariance_matches_curve_fit():
    def model(t, a, b, c):
        return a * np.exp(-b * t) + c

    expected = scipy_optimize.curve_fit(model, T, MEASURED, START)[1]
    np.testing.assert_allclose(least_squares(decay, START).cov, expected, rtol=0.02)


def test_result_has_residuals_and_common_fields():
    res = least_squares(decay, START)
    x, cost, nit, nfev, seconds = res
    assert x is res.x and cost == res.cost == res["cost"] and (nit, nfev) == (res.nit, res.nfev) and seconds == res.solve_time
    assert "cost" in repr(res) and res.method == "least-squares" and len(res.trace) == nfev
    assert res.trace.fun.min() == res.cost == sum(res.fun**2)
    # A method that uses residuals needs far fewer evaluations than one that uses costs.
    simplex = pydfo.minimize(lambda x: np.sum(decay(x) ** 2), START, method="nelder-mead")
    assert simplex.jac is None and simplex.cov is None and res.nfev < simplex.nfev / 3


def test_bound_fixed_and_undetermined_parameters_are_reported():
    res = least_squares(decay, [1.0, 0.7, 0.1], [(0, 5), (0.7, 0.7), (None, 0.2)])
    assert res.active_mask.tolist() == [0, -1, 1] and res.x[1] == 0.7 and res.x[2] == 0.2
    assert "x[1], x[2]" in res.cov_message and res.cov[0, 0] > 0 and not res.cov[1:].any() and not res.jac[:, 1].any()
    twice = least_squares(lambda x: (x[0] + x[1]) * T - MEASURED, [1.0, 1.0])
    assert np.isinf(twice.cov.diagonal()).all() and "do not determine" in twice.cov_message
    exact = least_squares(lambda x: [x[0] - 1, x[1] + 2], [0.0, 0.0])
    assert exact.cost < 1e-12 and np.isinf(exact.cov.diagonal()).all() and "the variance cannot be estimated" in exact.cov_message


@pytest.mark.parametrize(
    "bounds",
    [
        [(0, 5), (0, 0.5), (None, 1)],
        scipy_optimize.Bounds([0, 0, -np.inf], [5, 0.5, 1]),
        ([0, 0, -np.inf], [5, 0.5, 1]),
        (np.array([0, 0, -np.inf]), [5, 0.5, 1]),
    ],
)
def test_bounds_are_accepted_in_all_forms(bounds):
    res = least_squares(decay, [1.0, 0.4, 0.0], bounds)
    assert res.x[1] == 0.5 and res.active_mask[1] == 1
    assert (res.trace.x >= [0, 0, -np.inf]).all() and (res.trace.x <= [5, 0.5, 1]).all()


def test_tuple_of_two_pairs_is_resolved_by_the_start():
    def line(x):
        return x[0] + x[1] * T - MEASURED

    def reach(bounds, x0):
        return least_squares(line, x0, bounds).trace.x

    # Numbers apply to all parameters; one parameter.
    assert (reach((-1, 3), [0.0, 0.0]) <= 3).all()
    assert least_squares(lambda x: x - 5, [0.5], (0, 1)).x == [1] and least_squares(lambda x: x - 5, [0.5], [(0, 1)]).x == [1]
    # As pairs, the first parameter would be fixed at 0, and the start would be outside.
    assert (reach(([0, 0], [1, 1]), [0.5, 0.5]) <= 1).all()
    # As lower and upper bounds, the start would be outside.
    assert (reach(((0, 2), (-1, 1)), [1.5, -0.5])[:, 0] <= 2).all()
    with pytest.raises(ValueError, match=r"Use a list of pairs.*or scipy.optimize.Bounds"):
        reach(((0, 2), (1, 20)), [0.5, 5.0])
    # A list contains pairs.
    assert reach([(0, 2), (1, 20)], [0.5, 5.0])[:, 1].min() < 2
    with pytest.raises(ValueError, match="outside its bounds"):
        reach(([0, 0], [1, 1]), [5.0, 5.0])


@pytest.mark.parametrize("workers", [2, 5, "executor", "map", "vectorized"])
@pytest.mark.parametrize("loss", ["linear", "cauchy"])
def test_path_is_identical_for_all_evaluators(workers, loss):
    alone = least_squares(decay, START, loss=loss, f_scale=0.1, batch="serial")
    if workers == "executor":
        with concurrent.futures.ThreadPoolExecutor(3) as pool:
            other = least_squares(decay, START, loss=loss, f_scale=0.1, workers=pool, batch="serial")
    elif workers == "vectorized":
        other = least_squares(columns, START, loss=loss, f_scale=0.1, vectorized=True)
        np.testing.assert_allclose(other.x, alone.x, rtol=1e-6)
        return
    else:
        other = least_squares(decay, START, loss=loss, f_scale=0.1, workers=map if workers == "map" else workers, batch="serial")
    assert timeless(other) == timeless(alone)


def test_budgets_are_exact_and_resumed_run_is_identical(tmp_path):
    whole = least_squares(decay, START, loss="huber", f_scale=0.1)
    file = tmp_path / "run.ckpt"
    for limit in range(1, whole.nfev):
        calls = []
        res = least_squares(lambda x: calls.append(x) or decay(x), START, loss="huber", f_scale=0.1, max_evaluations=limit, checkpoint=file)
        assert res.nfev == limit and len(calls) == 1 and res.status == 1 and res.fun.shape == (12,)
    assert timeless(least_squares(decay, START, loss="huber", f_scale=0.1, checkpoint=file, resume="require")) == timeless(whole)
    with pytest.raises(pydfo.CheckpointError, match="loss"):
        least_squares(decay, START, loss="huber", f_scale=0.2, checkpoint=file)
    assert least_squares(decay, START, target=0.5).cost <= 0.5
    assert least_squares(decay, START, max_iterations=3).nit == 3


def test_failures_are_counted_and_not_used():
    def undefined(x):
        return np.where(x[1] > 0.9, np.nan, decay(x))

    def masked(x):
        return np.ma.array(decay(x), mask=T == T[3] if x[1] > 0.9 else False)

    for function, reason in [
        (fails_sometimes, "ValueError: too fast"),
        (undefined, "residual 0 is NaN"),
        (masked, "residual 3 is NaN"),
    ]:
        res = least_squares(function, [1.0, 0.85, 0.0], on_error="fail", options={"radius": 0.3})
        assert res.success and list(res.failures) == [reason] and res.nfail == res.failures[reason] > 0
        assert res.x == pytest.approx(least_squares(decay, START).x, rel=1e-3)
    with pytest.raises(ValueError, match="too fast") as raised:
        least_squares(fails_sometimes, [1.0, 0.85, 0.0], options={"radius": 0.3})
    assert raised.value.partial_result.fun.shape == (12,)
    for function, reason in [(lambda x: [np.inf, 1], "residual 0 is inf"), (lambda x: [], "the objective returned no residuals")]:
        with pytest.raises(pydfo.AllStartsFailed, match=reason):
            least_squares(function, [1.0])


@pytest.mark.parametrize("how", [{}, {"on_error": "fail"}, {"workers": 2}, {"workers": map}])
def test_changed_number_of_residuals_is_an_error(how):
    def short(x):
        return decay(x)[: 11 if x[1] > 0.9 else 12]

    with pytest.raises(ValueError, match=r"11 residuals at x = \[1.0, 1.105, 0.0\], but 12 at earlier points"):
        least_squares(short, [1.0, 0.85, 0.0], options={"radius": 0.3}, **how)


@pytest.mark.parametrize(
    ("returned", "expected"),
    [
        (1.0, r"not one number \(1.0\): use minimize for a cost"),
        (np.float64(1), "not one number"),
        (None, "Check for a missing return statement"),
        ("abc", "not 'abc'"),
        ([[1.0, 2.0]], r"not one of shape \(1, 2\)"),
        ([1, 1j], "one-dimensional array of numbers"),
        (["a"], "one-dimensional array of numbers"),
    ],
)
def test_non_vector_residuals_are_an_error(returned, expected):
    for how in [{}, {"on_error": "fail"}, {"workers": 2}, {"workers": map}]:
        with pytest.raises(TypeError, match=expected):
            least_squares(lambda x: returned, [1.0], **how)


@pytest.mark.parametrize(
    ("how", "error", "expected"),
    [
        ({"loss": "arctan"}, ValueError, "loss = 'arctan' is invalid; expected one of: 'linear'"),
        ({"loss": None}, TypeError, "loss must be a string"),
        ({"f_scale": 0}, ValueError, "f_scale = 0 must be positive"),
        ({"f_scale": "a"}, TypeError, "f_scale must be a number"),
        ({"ftol": 1e-3}, TypeError, "use the argument f_tol"),
        ({"jac": "2-point"}, TypeError, "the methods do not use derivatives"),
        ({"x_tol": 1e-3, "options": {"x_tol": 1e-3}}, ValueError, "x_tol is specified twice"),
        ({"options": {"kinds": "integer"}}, ValueError, r"does not support x\[0\]"),
        ({"x0": None}, ValueError, "is missing"),
        ({"bounds": [(0, 1)]}, ValueError, "expected 3 pairs, one per parameter; got 1"),
    ],
)
def test_bad_arguments_are_rejected(how, error, expected):
    with pytest.raises(error, match=expected):
        least_squares(**{"fun": decay, "x0": START, **how})


def test_any_array_like_vector_is_accepted():
    expected = timeless(least_squares(decay, START))
    for form in (list, tuple, lambda r: np.repeat(r, 2)[::2], lambda r: r.astype(object)):
        assert timeless(least_squares(lambda x: form(decay(x)), START)) == expected
    assert timeless(least_squares(decay, START, args=(MEASURED,))) == expected
    whole = least_squares(lambda x: [int(x[0] > 0), 1], [1.0], max_evaluations=4)
    assert whole.cost == 2 and whole.fun.tolist() == [1, 1]


def test_optimizer_accepts_residual_vectors():
    alone = least_squares(decay, START)
    optimizer = pydfo.Optimizer("least-squares", START)
    while not optimizer.done:
        ids, points, cutoffs = optimizer.ask()
        assert np.isinf(cutoffs).all()
        optimizer.tell(ids[::-1], [decay(x) for x in points[::-1]])
    assert timeless(optimizer.report()) == timeless(alone)
    optimizer = pydfo.Optimizer("least-squares", START)
    ids, points, _ = optimizer.ask()
    with pytest.raises(TypeError, match="not one number"):
        optimizer.tell(ids[0], 1.0)
    optimizer.tell(ids, [decay(points[0]), None, ValueError("no"), [np.nan, 1]])
    optimizer.stop()
    assert optimizer.report().failures == {"no value": 1, "ValueError: no": 1, "residual 0 is NaN": 1}


def test_other_functions_suggest_least_squares():
    for call in (
        lambda: pydfo.minimize(decay, START, method="least-squares"),
        lambda: pydfo.minimize(decay, START, method="least-squares", workers=map),
        lambda: pydfo.fmin(decay, START, alg="least-squares"),
        lambda: scipy_optimize.minimize(decay, START, method=pydfo.scipy_method("least-squares")),
    ):
        with pytest.raises(ValueError, match="pydfo.least_squares"):
            call()


def test_callback_receives_cost_and_may_end_the_run():
    seen = []
    res = least_squares(decay, START, callback=lambda progress: seen.append(progress.fun) or len(seen) == 4)
    assert len(seen) == 4 and res.cost == seen[-1] and res.status == 4


def test_rounds_evaluate_several_points():
    alone = least_squares(decay, START)
    rounds = least_squares(decay, START, batch=6)
    assert rounds.success and rounds.cost == pytest.approx(alone.cost, rel=1e-6) and rounds.n_batches < alone.n_batches
    assert timeless(least_squares(decay, START, batch=6, workers=3)) == timeless(rounds)
    assert timeless(least_squares(decay, START, batch="workers", workers=6)) == timeless(rounds)
    assert timeless(least_squares(decay, START, batch="workers")) == timeless(least_squares(decay, START, batch=1))
    with pytest.raises(ValueError, match="'batch' of least-squares must be an integer"):
        least_squares(decay, START, batch="many")


def test_batch_plan_of_a_result_repeats_its_path(tmp_path):
    path = tmp_path / "run"
    n = len(START)
    planned = least_squares(decay, START, workers=n + 2)
    assert planned.batch_plan == n + 2
    for workers in (1, 2, 8):
        again = least_squares(decay, START, workers=workers, batch=planned.batch_plan)
        assert timeless(again) == timeless(planned) and again.batch_plan == n + 2
    least_squares(decay, START, workers=n + 2, max_evaluations=n + 4, checkpoint=path)
    resumed = least_squares(decay, START, workers=1, checkpoint=path)
    assert resumed.batch_plan == n + 2 and resumed.x.tobytes() == planned.x.tobytes()
    assert least_squares(decay, START).batch_plan == "serial"
