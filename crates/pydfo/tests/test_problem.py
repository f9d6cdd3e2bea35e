"""Features of problems (ties, priors, delays, offsets, units, initial states, windows, weights per sample, input
functions) and their errors."""

from __future__ import annotations

import copy
import math
import pickle
from typing import Any

import numpy as np
import pytest

import pydfo
from pydfo import Calibration, Experiment, LogNormal, Normal, Parameter

T = np.arange(21) * 0.1
K = Parameter("k", 1.0, 0.1, 10.0)


def decay(x: Any, **options: Any) -> Experiment:
    """Returns an experiment for x' = -k x with the given measurements."""
    return Experiment({"time": T, "x": x}, ["x"], **options)


def dahlquist(experiment: Experiment | list[Experiment], *parameters: Parameter) -> Calibration:
    experiments = [experiment] if isinstance(experiment, Experiment) else experiment
    return Calibration(pydfo.example_fmu("dahlquist"), experiments, parameters)


def u1(t: float) -> float:
    return 5.0 + 0.5 * math.sin(0.3 * t)


def tank(parameters: Any, inputs: Any = None, **options: Any) -> Calibration:
    t = np.arange(31.0)
    data = {"time": t, "u1": 5.0 + 0.5 * np.sin(0.3 * t), "u2": 5.0 + 0.0 * t, "x": 0.06 - 1e-4 * t}
    data["w"] = np.where(t < 10, 0.0, 1.0)
    return Calibration(pydfo.example_fmu("quad_tank"), data, {"qt.x1": "x"}, parameters, inputs or {"u1": "u1", "u2": "u2"}, **options)


A1 = Parameter("qt.a1", 3e-6, 2e-6, 4e-6)


def test_parameter_sets_several_variables_and_tied_values() -> None:
    several = [Parameter("upper", 3e-6, 2e-6, 4e-6, variables=["qt.a1", "qt.a2"]), Parameter("qt.a3", tied_to="upper", factor=2.0)]
    one = tank(several)
    explicit = tank([Parameter(name, 3e-6) for name in ("qt.a1", "qt.a2", "qt.a3")])
    assert one.names == ["upper"]
    assert one.cost([2.5e-6]) == explicit.cost([2.5e-6, 2.5e-6, 5e-6])
    assert one.model_values([2.5e-6]) == {"qt.a1": 2.5e-6, "qt.a2": 2.5e-6, "qt.a3": 5e-6}
    fit = one.fit()
    assert fit.parameters == {"upper": fit.x[0], "qt.a3": 2.0 * fit.x[0]}
    assert np.array_equal(np.asarray(fit.parameters), [fit.x[0], 2.0 * fit.x[0]])
    # Standard errors have the same names.
    assert list(fit.stderr.keys()) == list(fit.parameters) and "qt.a3" in fit.stderr and "q" not in fit.stderr
    assert dict(fit.stderr.items()) == {"upper": fit.stderr[0], "qt.a3": 2.0 * fit.uncertainty.stderr[0]}
    assert type(np.asarray(fit.stderr)) is type(2 * fit.stderr) is type(fit.stderr[:1]) is np.ndarray
    assert isinstance(fit.stderr.sum(), float) and (fit.stderr > 0).all() and repr(fit.stderr).startswith("{'upper': ")
    with pytest.raises(KeyError, match="q"):
        fit.stderr["q"]
    # An offset does not change an error.
    errors = tank([several[0], Parameter("qt.a3", tied_to="upper", factor=-1.0, offset=6e-6)]).fit(max_evaluations=5).stderr
    assert errors["qt.a3"] == errors["upper"]
    # The parameters listed by a fit can be passed again.
    assert one.cost(fit.parameters) == fit.cost
    with pytest.raises(ValueError, match="follows from other parameters"):
        one.cost({"upper": 3e-6, "qt.a3": 3e-6})


def test_values_are_converted_from_user_units() -> None:
    plain, scaled = tank([A1]), tank([Parameter("qt.a1", 3.0, 2.0, 4.0, unit="mm2")])
    assert scaled.cost([2.7]) == pytest.approx(plain.cost([2.7e-6]), rel=1e-9)
    assert scaled.model_values([2.5])["qt.a1"] == pytest.approx(2.5e-6, rel=1e-15)
    with pytest.raises(ValueError, match="'qt.a1'.*kg"):
        tank([Parameter("qt.a1", 3.0, 2.0, 4.0, unit="kg")])


def test_priors_are_residuals_excluded_from_rms() -> None:
    x = np.exp(-T)
    free = dahlquist(decay(x, weights={"x": 10.0}, start_values={"k": 1.0}), Parameter("x", 1.5, 0.1, 10.0))
    with_prior = Parameter("x", 1.5, 0.1, 10.0, prior=Normal(2.0, 0.1))
    calibration = dahlquist(decay(x, weights={"x": 10.0}, start_values={"k": 1.0}), with_prior)
    assert (calibration.n_residuals, calibration.n_measurements, free.n_residuals) == (22, 21, 21)
    fit = calibration.fit()
    e = np.exp(-T)
    expected = (100.0 * np.sum(e * x) + 2.0 / 0.01) / (100.0 * np.sum(e * e) + 1.0 / 0.01)
    assert fit.x[0] == pytest.approx(expected, abs=2e-4)
    assert fit.rms == pytest.approx(np.sqrt(np.mean(fit.residuals()[:21] ** 2)), rel=1e-9)
    assert fit.cost == np.sum(fit.residuals() ** 2) or fit.cost == pytest.approx(np.sum(fit.residuals() ** 2), rel=1e-14)
    relative = dahlquist(decay(x), Parameter("k", 1.0, 0.1, 10.0, prior=LogNormal(2.0, 0.5)))
    assert relative.residuals([1.0])[-1] == pytest.approx(math.log(0.5) / 0.5)


def test_initial_states_are_given_measured_or_fitted() -> None:
    x = 3.0 * np.exp(-T)
    assert dahlquist(decay(x, initial_states={"x": 3.0}), K).cost([1.0]) < 1e-8
    assert dahlquist(decay(x, initial_states={"x": "measured"}), K).cost([1.0]) < 1e-8
    start = Parameter("start", 1.0, 0.1, 10.0)
    two = [decay(x, initial_states={"x": start}), decay(x / 2, initial_states={"x": start}, name="half")]
    fit = dahlquist(two, K).fit()
    assert list(fit.parameters) == ["k", "x[run1]", "x[half]"]
    assert fit.x == pytest.approx([1.0, 3.0, 1.5], rel=1e-3)


def test_delays_and_offsets_are_applied() -> None:
    x = np.exp(-1.5 * np.maximum(T - 0.137, 0.0)) + 0.25
    tau, bias = Parameter("tau", 0.05, 0, 1, delay_of="x"), Parameter("bias", 0.0, -1, 1, offset_of="x")
    calibration = dahlquist(decay(x), K, tau, bias)
    fit = calibration.fit()
    assert fit.x == pytest.approx([1.5, 0.137, 0.25], abs=1e-3)
    assert fit.simulate()["x"] == pytest.approx(x, abs=1e-3)
    fixed = dahlquist(decay(x - 0.25, delays={"x": 0.137}), K)
    assert fixed.cost([1.5]) < 1e-8
    late = tank([A1], delays={"u1": 0.7})
    fitted = tank([A1, Parameter("tau", 0.1, 0, 2, delay_of="u1")])
    assert fitted.cost([3e-6, 0.7]) == late.cost([3e-6]) != fitted.cost([3e-6, 0.0])
    milliseconds = tank([A1, Parameter("tau", 100.0, 0, 2000, delay_of="u1", unit="ms")])
    assert milliseconds.cost([3e-6, 700.0]) == late.cost([3e-6])


def test_windows_weights_and_warm_up_select_measurements() -> None:
    def n(**options: Any) -> int:
        return tank([A1], **options).n_measurements

    assert n() == 31
    assert n(windows=[(0, 4), (10, 12.5)]) == 5 + 3
    assert n(weights={"qt.x1": "w"}) == 21
    mask = np.arange(31) % 2 == 0
    assert n(weights={"qt.x1": mask}) == 16
    assert n(weights=[mask]) == 16
    assert n(warm_up=10) == 21
    half = tank([A1], weights={"qt.x1": np.full(31, 0.5)})
    assert half.residuals() == pytest.approx(0.5 * tank([A1]).residuals(), rel=1e-14)
    # The simulation starts 10 s before the window, from equal start values.
    warmed = tank([A1], window=(20, 30), warm_up=10)
    assert warmed.n_measurements == 11
    assert warmed.cost() == tank([A1], window=(20, 30), start_time=10).cost()


def test_inputs_may_be_columns_numbers_or_functions() -> None:
    recorded = tank([A1])
    assert tank([A1], {"u1": "u1", "u2": 5.0}).cost() == pytest.approx(recorded.cost(), rel=1e-9)
    calibration = tank([A1], {"u1": u1, "u2": 5})
    assert calibration.cost() == pytest.approx(recorded.cost(), rel=1e-2)
    for twin in (pickle.loads(pickle.dumps(calibration)), copy.deepcopy(calibration)):
        assert twin.cost([2.9e-6]) == calibration.cost([2.9e-6])
    fit = calibration.fit(workers=2)
    assert fit.x == pytest.approx(calibration.fit(workers=1, batch=fit.batch_plan).x, rel=0, abs=0)
    with pytest.raises((pickle.PicklingError, AttributeError), match="lambda"):
        pickle.dumps(tank([A1], {"u1": lambda t: 5.0, "u2": 5}))


def test_input_function_exception_propagates_unchanged() -> None:
    class Mine(Exception):
        pass

    def fails(t: float) -> float:
        if armed:
            raise Mine(f"at {t}")
        return 5.0

    armed = False
    calibration = tank([A1], {"u1": fails, "u2": 5.0})
    cost = calibration.cost()
    armed = True
    with pytest.raises(Mine):
        calibration.cost()
    with pytest.raises(Mine):
        calibration.fit()
    armed = False
    assert calibration.cost() == cost
    armed = True
    with pytest.raises(Mine):
        tank([A1], {"u1": fails, "u2": 5.0})


def test_all_features_survive_a_pickle() -> None:
    experiment = decay(
        3.0 * np.exp(-T),
        initial_states={"x": Parameter("x", 1.0, 0.1, 10.0, prior=Normal(3.0, 1.0))},
        windows=[(0, 1), (1.5, 2)],
        weights={"x": np.linspace(1, 2, 21)},
        warm_up=0.1,
        start_time=0.0,
    )
    tied = Parameter("bias", tied_to="k", factor=1e-3, offset=-1e-3, offset_of="x")
    calibration = dahlquist(experiment, K, Parameter("tau", 0.0, -0.5, 0.5, delay_of="x", display_name="late"), tied)
    x = [1.1, 0.05, 2.9]
    for twin in (pickle.loads(pickle.dumps(calibration)), copy.deepcopy(calibration)):
        assert (twin.cost(x), twin.names) == (calibration.cost(x), calibration.names)
        assert twin.parameters == calibration.parameters


def test_checkpoint_depends_on_problem_features(tmp_path: Any) -> None:
    path = tmp_path / "fit.ckpt"
    x = np.exp(-T)
    dahlquist(decay(x), K).fit(checkpoint=path)
    others = [
        dahlquist(decay(x, delays={"x": 0.1}), K),
        dahlquist(decay(x, initial_states={"x": 2.0}), K),
        dahlquist(decay(x, weights={"x": np.linspace(1, 2, 21)}), K),
        dahlquist(decay(x, windows=[(0, 1)]), K),
        dahlquist(decay(x, warm_up=0.5), K),
        dahlquist(decay(x), Parameter("k", 1.0, 0.1, 10.0, prior=Normal(1.0, 1.0))),
        dahlquist(decay(x), K, Parameter("x", tied_to="k")),
    ]
    for other in others:
        with pytest.raises(pydfo.CheckpointError):
            other.fit(checkpoint=path)


def bad(**options: Any) -> Any:
    return lambda: dahlquist(decay(np.exp(-T), **options), K)


def bad_parameter(*parameters: Any) -> Any:
    """Returns a function that creates the parameters, each from its arguments."""
    return lambda: dahlquist(decay(np.exp(-T)), *(p if isinstance(p, Parameter) else p() for p in parameters))


MISTAKES = {
    "tie to nothing": (bad_parameter(K, lambda: Parameter("x", tied_to="q")), "tied to 'q' \\('k'\\?\\), which does not exist; available: k"),
    "tie to itself": (bad_parameter(K, lambda: Parameter("x", tied_to="x")), "it follows from itself: 'x' from 'x'"),
    "tie with a start": (lambda: Parameter("x", 1.0, tied_to="k"), "Omit start"),
    "tie with bounds": (lambda: Parameter("x", None, 0, 1, tied_to="k"), "it is tied to 'k', which determines start"),
    "local tie": (lambda: Parameter("x", tied_to="k", local=True), "Omit them here"),
    "factor 0": (lambda: Parameter("x", tied_to="k", factor=0.0), "factor 0 and offset 0"),
    "factor of nothing": (lambda: Parameter("x", 1.0, factor=2.0), "require tied_to"),
    "no start": (lambda: Parameter("x"), "start is missing"),
    "only ties": (
        bad_parameter(lambda: Parameter("x", tied_to="x2"), lambda: Parameter("x2", tied_to="x")),
        "it follows from itself: 'x' from 'x2' from 'x'",
    ),
    "no variables": (bad_parameter(K, lambda: Parameter("x", 1.0, variables=[])), "variables is empty"),
    "unknown variable": (bad_parameter(lambda: Parameter("any", 1.0, variables=["k", "kk"])), "kk"),
    "variable twice": (bad_parameter(lambda: Parameter("any", 1.0, variables=["k", "k"])), "lists the variable 'k' twice"),
    "variable of two": (bad_parameter(K, lambda: Parameter("any", 1.0, variables=["k"])), "'k', which parameter 'k' also sets"),
    "two roles": (lambda: Parameter("x", 1.0, 0, 2, delay_of="x", offset_of="x"), "at most one of"),
    "delay of nothing": (bad_parameter(K, lambda: Parameter("tau", 0.1, 0, 1, delay_of="y")), "'y', which is not an output or input.*available: x"),
    "delay without bound": (lambda: Parameter("tau", 0.1, delay_of="x"), "finite lower bound"),
    "two delays": (
        bad_parameter(K, *(lambda name=name: Parameter(name, 0.1, 0, 1, delay_of="x") for name in ("a", "b"))),
        "is the delay of 'x', as is parameter 'a'",
    ),
    "delay given and fitted": (
        lambda: dahlquist(decay(np.exp(-T), delays={"x": 0.1}), K, Parameter("tau", 0.1, 0, 1, delay_of="x")),
        "delays also sets it",
    ),
    "unknown delay": (bad(delays={"y": 0.1}), "delays: 'y' is not an output or input.*available: x"),
    "delay not finite": (bad(delays={"x": math.inf}), "delay inf of 'x'"),
    "delay of words": (bad(delays={"x": "late"}), "delays"),
    "unknown unit": (bad_parameter(lambda: Parameter("k", 1.0, unit="furlong")), "unit 'furlong'"),
    "prior of width 0": (lambda: Parameter("k", 1.0, prior=Normal(1.0, 0.0)), "sd must be positive"),
    "log prior below 0": (lambda: Parameter("k", 1.0, 0.0, 2.0, prior=LogNormal(1.0, 0.1)), "lower bound above 0"),
    "prior of words": (lambda: Parameter("k", 1.0, prior="normal"), "pydfo.Normal"),
    "initial state unknown": (bad(initial_states={"xx": 1.0}), "xx"),
    "initial state no state": (bad(initial_states={"k": 1.0}), "'k'"),
    "initial state of words": (bad(initial_states={"x": "first"}), "a number, 'measured', 'measured:' and the name of an output"),
    "initial state not measured": (
        lambda: Calibration(
            pydfo.example_fmu("quad_tank"),
            {"time": [0.0, 1.0], "x": [0.06, 0.06]},
            {"qt.x1": "x"},
            A1,
            {"u1": 5.0, "u2": 5.0},
            initial_states={"qt.x2": "measured"},
        ),
        "no column is compared with 'qt.x2'",
    ),
    "initial state twice": (bad(initial_states={"x": 1.0}, start_values={"x": 1.0}), "in initial_states and in start_values"),
    "initial state and parameter": (
        lambda: dahlquist(decay(np.exp(-T), initial_states={"x": 1.0}), K, Parameter("x", 1.0)),
        "parameter 'x' also sets it",
    ),
    "window backwards": (bad(windows=[(0, 1), (2, 1.5)]), "window from 2 to 1.5"),
    "window with nothing": (bad(windows=[(5, 6)]), "no time of data is in the window from 5 to 6. The times range from 0 to 2"),
    "window and windows": (bad(window=(0, 1), windows=[(0, 1)]), "specify either window or windows, not both"),
    "windows a pair": (bad(windows=(0, 1)), "each of windows must be two times"),
    "no windows": (bad(windows=[]), "omit it"),
    "warm-up too long": (bad(warm_up=5), "after the warm-up of 5 s.*shorter warm_up"),
    "warm-up negative": (bad(warm_up=-1), "warm_up = -1"),
    "weights too few": (bad(weights={"x": [1.0, 2.0]}), "output 'x' has 2 weights for 21 rows"),
    "weights per row in a list": (bad(weights=np.ones(21)), "use a dict"),
    "weights negative": (bad(weights={"x": -np.ones(21)}), "weight -1 of output 'x' at time 0"),
    "weights all 0": (bad(weights={"x": np.zeros(21)}), "no measurement of 'x'.*weight 0"),
    "weight 0": (bad(weights={"x": 0.0}), "Remove the output instead"),
    "weights of no column": (bad(weights={"x": "sigma"}), "column 'sigma' not found"),
    "input not covered": (lambda: tank([A1], delays={"u1": -5.0}), "hold_inputs"),
    "input an array": (lambda: tank([A1], {"u1": np.ones(31), "u2": 5.0}), "columns of the data"),
    "input not finite": (lambda: tank([A1], {"u1": math.nan, "u2": 5.0}), "'u1' = NaN must be finite"),
}


@pytest.mark.parametrize("make, expected", MISTAKES.values(), ids=MISTAKES.keys())
def test_mistakes_are_reported_with_remedies(make: Any, expected: str) -> None:
    with pytest.raises((ValueError, TypeError, KeyError), match=expected):
        make()
