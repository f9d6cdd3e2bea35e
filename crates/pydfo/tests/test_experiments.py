"""Several recordings in one calibration, and pickled calibrations."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
import shutil
import sys

import numpy as np
import pytest

import pydfo
from pydfo import Calibration, Experiment, FMUModel, Hold, Parameter, example_fmu

TIME = np.linspace(0.0, 1.0, 11)
BAD = {"time": [1.0, 0.0], "x": [1.0, 2.0]}
SHARED = Parameter("k", 1.0, 0.1, 10.0)
LOCAL = Parameter("x", 1.0, 0.1, 10.0, local=True)
SHARED_BUT_D = Parameter("k", 1.0, 0.1, 10.0, experiments=["a", "b", "c"])


def decay(x0, k=2.0):
    return {"time": TIME, "y": x0 * np.exp(-k * TIME)}


def two(parameters=(SHARED, LOCAL), **more):
    runs = [
        Experiment(decay(1.5), {"x": "y"}, name="cold"),
        Experiment(decay(3.0), {"x": "y"}, start_values={"x": 2.5}, weights=[0.5], window=(0.0, 0.55)),
    ]
    return Calibration(example_fmu("dahlquist"), runs, parameters, **more)


def test_shared_and_local_parameters_are_fitted_to_both():
    calibration = two()
    assert calibration.experiments == ["cold", "run2"]
    assert calibration.names == ["k", "x[cold]", "x[run2]"]
    np.testing.assert_array_equal(calibration.start, [1.0, 1.0, 2.5])
    assert calibration.n_residuals == 11 + 6
    fit = calibration.fit()
    np.testing.assert_allclose(fit.x, [2.0, 1.5, 3.0], rtol=1e-3)
    assert fit.parameters == dict(zip(calibration.names, fit.x))
    assert "x[run2]" in repr(fit) and fit.start_cost == calibration.cost()
    np.testing.assert_allclose(fit.rms, np.sqrt(fit.cost / 17), rtol=1e-14)
    np.testing.assert_allclose(fit.start_rms, np.sqrt(fit.start_cost / 17), rtol=1e-14)
    # Values by name; omitted parameters have their start values.
    assert calibration.cost({"x[cold]": 1.4}) == calibration.cost([1.0, 1.4, 2.5])
    with pytest.raises(ValueError, match=r"unknown parameter 'x'; expected one of: k, x\[cold\], x\[run2\]"):
        calibration.cost({"x": 1.4})


def test_residuals_and_rows_equal_those_of_single_experiments():
    calibration = two()
    x = [1.9, 1.4, 2.9]
    first = Calibration(example_fmu("dahlquist"), decay(1.5), {"x": "y"}, [SHARED, Parameter("x", 1.0)])
    second = Calibration(example_fmu("dahlquist"), decay(3.0), {"x": "y"}, [SHARED, Parameter("x", 1.0)], weights=[0.5], window=(0.0, 0.55))
    alone = [first.residuals(x[:2]), second.residuals([x[0], x[2]])]
    np.testing.assert_array_equal(calibration.residuals(x), np.concatenate(alone))
    rows = calibration.simulate(x)
    np.testing.assert_array_equal(rows["cold"]["x"], first.simulate(x[:2])["x"])
    assert len(rows["run2"]["time"]) == 6
    measured = calibration.measurements()
    np.testing.assert_array_equal(measured["run2"]["x"][1], decay(3.0)["y"])


@pytest.mark.parametrize("make", [two, lambda: Calibration(example_fmu("dahlquist"), decay(1.0), {"x": "y"}, [SHARED])])
def test_cost_adds_squares_in_order(make):
    calibration = make()
    for x in (calibration.start, 1.3 * calibration.start):
        # NumPy adds pairwise; running sums add from first to last.
        assert calibration.cost(x) == np.cumsum(calibration.residuals(x) ** 2)[-1]
    fit = calibration.fit(max_evaluations=60)
    assert fit.cost == calibration.cost(fit.x) == np.cumsum(fit.residuals() ** 2)[-1]


def test_plot_has_a_column_per_output_and_experiment():
    pytest.importorskip("matplotlib").use("Agg")
    figure = two().fit(max_evaluations=30).plot()
    assert len(figure.axes) == 4
    assert [axes.get_title(loc="left") for axes in figure.axes[::2]] == ["cold: x", "run2: x"]


def test_inputs_are_separate_for_each_experiment():
    time = np.linspace(0.0, 30.0, 31)
    model = FMUModel(example_fmu("quad_tank"))
    runs = []
    for level in (5.0, 6.0):
        inputs = {"u1": np.full(31, level), "u2": np.full(31, 5.0)}
        truth = model.simulate(0, 30, times=time, inputs={"time": time, **inputs}, outputs=["qt.x1"])
        runs.append(Experiment({"time": time, **inputs, "x1": truth["qt.x1"]}, {"qt.x1": "x1"}, ["u1", "u2"]))
    truth = model.get("qt.a1")
    calibration = Calibration(example_fmu("quad_tank"), runs, Parameter("qt.a1", 0.9 * truth, 0.5 * truth, 2.0 * truth))
    assert calibration.names == ["qt.a1"]
    np.testing.assert_allclose(calibration.fit().x, [truth], rtol=1e-3)


def test_held_input_equals_doubled_rows_and_is_not_reported():
    t, u = np.arange(5.0), np.array([0.0, 1.0, 1.0, 0.0, 1.0])
    measured = {"time": t, "x": np.zeros(5), "u": u}
    doubled = {"time": np.repeat(t, 2)[1:], "x": np.r_[np.tile([0.0, np.nan], 4), 0.0], "u": np.repeat(u, 2)[:-1]}
    parameter = Parameter("T", 0.5, 0.1, 2.0)

    def of(data, source):
        return Calibration(example_fmu("switched_input"), data, ["x"], [parameter], inputs={"u": source})

    held = of(measured, Hold("u"))
    # x' = (2 u - x) / T with u = 1 from 1 s to 3 s
    x = 2 * (1 - np.exp(-2 * np.array([0.0, 0.0, 1.0, 2.0])))
    assert held.residuals([0.5]) == pytest.approx([*x, x[3] * np.exp(-2)], abs=1e-5)
    assert held.cost([0.5]) == of(doubled, "u").cost([0.5])
    assert held.cost([0.5]) != of(measured, "u").cost([0.5])
    assert "F065" in {finding.id for finding in of(measured, "u").check(simulate=False)}
    assert "F065" not in {finding.id for finding in held.check(simulate=False)}
    assert pickle.loads(pickle.dumps(held)).cost([0.5]) == held.cost([0.5])


def test_parameter_acts_only_in_its_experiments():
    cases = [("a", 2.0, {}), ("b", 2.0, {}), ("c", 3.0, {}), ("d", 4.0, {"k": 4.0})]
    runs = [Experiment(decay(1.0, k), {"x": "y"}, name=name, start_values=start_values) for name, k, start_values in cases]
    parameters = [
        Parameter("k of a and b", 1.0, 0.1, 10.0, variables="k", experiments=["a", "b"]),
        Parameter("k of c", 1.0, 0.1, 10.0, variables="k", experiments="c"),
    ]
    calibration = Calibration(example_fmu("dahlquist"), runs, parameters)
    assert calibration.names == ["k of a and b", "k of c"]
    assert calibration.fit().x == pytest.approx([2.0, 3.0], rel=1e-3)
    assert calibration.residuals([1.0, 1.0])[-11:] == pytest.approx(np.zeros(11), abs=1e-5)
    local = Calibration(example_fmu("dahlquist"), runs, [SHARED_BUT_D, Parameter("x", 1.0, 0.1, 10.0, local=True, experiments=["a", "c"])])
    assert local.names == ["k", "x[a]", "x[c]"]
    with pytest.raises(ValueError, match="'k': acts in the experiment 'e', which does not exist; available: a, b, c, d"):
        Calibration(example_fmu("dahlquist"), runs, [Parameter("k", 1.0, 0.1, 10.0, experiments=["e"])])
    with pytest.raises(ValueError, match="sets the variable 'k', which parameter 'k of a and b' also sets"):
        Calibration(example_fmu("dahlquist"), runs, [parameters[0], Parameter("k", 1.0, 0.1, 10.0, experiments=["b", "c"])])


def test_errors_name_the_experiment(tmp_path):
    def built(**more):
        runs = [Experiment(decay(1.0), {"x": "y"}, name="cold"), Experiment(decay(1.0), {"x": "y"}, **{"name": "hot", **more})]
        return Calibration(example_fmu("dahlquist"), runs, SHARED)

    with pytest.raises(ValueError, match="^hot: weights: unknown output 'z'"):
        built(weights={"z": 1.0})
    with pytest.raises(KeyError, match='^hot: the model has no variable "zz"'):
        built(start_values={"zz": 1.0})
    with pytest.raises(KeyError, match='^run2: the model has no variable "zz"'):
        built(start_values={"zz": 1.0}, name=None)
    with pytest.raises(ValueError, match="^hot: data: column 'z' not found"):
        Experiment(decay(1.0), {"x": "z"}, name="hot")
    path = tmp_path / "hot.csv"
    path.write_text("time,y\n0,1\n1,2\n")
    with pytest.raises(ValueError, match="^hot: .*'z'"):
        runs = [Experiment(decay(1.0), {"x": "y"}), Experiment(path, {"x": "z"}, name="hot")]
        Calibration(example_fmu("dahlquist"), runs, SHARED)


def test_warnings_name_the_experiment():
    time = np.linspace(0.0, 3.0, 4)
    data = {"time": time, "u1": np.full(4, 5.0), "u2": np.full(4, 5.0), "x1": np.full(4, 1e-2)}
    runs = [Experiment(data, {"qt.x1": "x1"}, inputs, name=name) for name, inputs in [("cold", ["u1", "u2"]), ("hot", ["u1"])]]
    parameter = Parameter("qt.a1", 3e-6, 2e-6, 4e-6)
    for experiments, expected in [(runs, "hot: data: column 'u2'"), (runs[1:], "data: column 'u2'")]:
        with pytest.warns(pydfo.CalibrationWarning) as caught:
            Calibration(example_fmu("quad_tank"), experiments, parameter, step_size=0.1)
        messages = [str(warning.message) for warning in caught]
        assert len(messages) == 2 and any(message.startswith(expected) for message in messages)
        # The settings are shared by all experiments.
        assert sum(message.startswith("step_size") for message in messages) == 1


def test_experiments_may_come_from_a_generator():
    runs = (Experiment(decay(x0), {"x": "y"}, start_values={"x": x0}) for x0 in (1.5, 3.0))
    calibration = Calibration(example_fmu("dahlquist"), runs, SHARED)
    assert calibration.experiments == ["run1", "run2"] and calibration.n_residuals == 22


def test_failures_name_the_experiment():
    runs = [Experiment(decay(1.0), {"x": "y"}), Experiment(decay(1.0), {"x": "y"}, name="late", start_values={"x": 1e308})]
    with pytest.raises(pydfo.SimulationError, match="late: "):
        Calibration(example_fmu("dahlquist"), runs, [SHARED]).cost([-10.0])


@pytest.mark.parametrize(
    ("arguments", "kind", "expected"),
    [
        (([Experiment(decay(1.0), {"x": "y"})], ["x"], [SHARED]), TypeError, "outputs: with experiments.* in each Experiment"),
        (([Experiment(decay(1.0), {"x": "y"}, name="a")] * 2, [SHARED]), ValueError, "two experiments are named 'a'"),
        ((decay(1.0), {"x": "y"}), TypeError, "requires the argument 'parameters'"),
        ((decay(1.0),), TypeError, "requires the argument 'outputs'"),
        (([Experiment(decay(1.0), {"x": "y"}, name="")], [SHARED]), ValueError, 'experiment "": a name must not be empty'),
        (([Experiment(decay(1.0), {"x": "y"}, name="a[1]")], [SHARED]), ValueError, 'experiment "a.* brackets'),
        (([], [SHARED]), ValueError, "the list of experiments is empty"),
        (([Experiment(decay(1.0), {"x": "y"}), decay(1.0)], [SHARED]), TypeError, "entry 1 of the list is a dict, not an Exp"),
        (({"a": Experiment(decay(1.0), {"x": "y"})}, [SHARED]), TypeError, "must be a list, not a dict"),
        (([Experiment(decay(1.0), {"x": "y"}), Experiment(decay(1.0), {"z": "y"}, name="b")], [SHARED]), KeyError, 'b: .*"z"'),
        (([Experiment(decay(1.0), {"x": "y"}, start_values={"x": 20.0})], [LOCAL]), ValueError, r"'x\[run1\]': start 20 is outside"),
        (([Experiment(decay(1.0), {"x": "y"}, start_values={"k": 2.0})], [SHARED]), ValueError, "'k': it is fitted, but start_values"),
    ],
)
def test_mismatched_experiments_are_rejected(arguments, kind, expected):
    with pytest.raises(kind, match=expected):
        Calibration(example_fmu("dahlquist"), *arguments)


def test_recording_is_checked_on_construction():
    with pytest.raises(ValueError, match="^cold: data: time 0 at row 1 follows 1"):
        Experiment(BAD, ["x"], name="cold")


# --- Pickles ------------------------------------------------------------------------------------------------------------


def cost_elsewhere(calibration, x):
    return calibration.cost(x), calibration.solver


def test_calibrations_and_fits_survive_pickles_and_copies():
    calibration = two()
    fit = calibration.fit(max_evaluations=40)
    for again in (pickle.loads(pickle.dumps(fit)), copy.deepcopy(fit)):
        assert list(again.x) == list(fit.x) and again.cost == fit.cost
        np.testing.assert_array_equal(again.residuals(), fit.residuals())
        assert repr(again) == repr(fit)
    again = pickle.loads(pickle.dumps(calibration))
    assert (again.names, again.parameters, again.solver) == (calibration.names, calibration.parameters, calibration.solver)
    more = again.fit(max_evaluations=40)
    assert list(more.x) == list(fit.x)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(cost_elsewhere, (calibration, fit.x)) == (fit.cost, fit.solver)


def test_pickle_contains_data_and_model_path(tmp_path):
    model, data = tmp_path / "model.fmu", tmp_path / "data.csv"
    shutil.copy(example_fmu("dahlquist"), model)
    data.write_text("time,x\n0,1\n0.5,0.4\n")
    stored = pickle.dumps(Calibration(FMUModel(model), data, ["x"], [SHARED]))
    data.unlink()
    assert pickle.loads(stored).cost([2.0]) > 0.0
    shutil.copy(example_fmu("van_der_pol"), model)
    with pytest.raises(ValueError, match=r"model.fmu has changed .* content [0-9a-f]{64}, found [0-9a-f]{64}"):
        pickle.loads(stored)
    if sys.platform == "win32":
        return  # Under Wine, a removed file exists until it is closed.
    model.unlink()
    with pytest.raises(FileNotFoundError, match=r"content: [0-9a-f]{64}\) was not found.*model.fmu"):
        pickle.loads(stored)
