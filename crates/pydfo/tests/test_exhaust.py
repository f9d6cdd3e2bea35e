"""The diesel exhaust pipe: derivatives, names, and the response with nominal parameters."""

from __future__ import annotations

import numpy as np
import pytest
import recordings

from pydfo import Calibration, FMUModel, Parameter, example_fmu

INPUTS = recordings.EXHAUST_INPUTS
AT_HAND = recordings.at_hand("exhaust_measurements.csv")
STATES = ["p1", "T1", "Tw1", "p2", "T2", "Tw2"]


def test_flows_and_derivatives_match_reference():
    model = FMUModel(example_fmu("exhaust"))
    model.set(STATES, [1.5e5, 700, 650, 1.1e5, 620, 580])
    model.set(INPUTS, [800, 2.2e5, 5000, 4000, 1.03e5])
    flows = model.get(["m1", "Ta", "m2", "Tb", "m3", "T_out"])
    assert flows == pytest.approx([0.32998356, 746.4529803, 0.36613756, 658.5823759, 0.38753134, 620], rel=2e-8)
    derivatives = model.get([f"der({name})" for name in STATES])
    expected = [-982582.12824, 1073.72134, 1.54356, -50631.61763, 1147.55161, -0.02691111]
    assert derivatives == pytest.approx(expected, rel=5e-8)


def test_names_and_start_values_match_model():
    description = FMUModel(example_fmu("exhaust")).description
    assert description.inputs == INPUTS
    assert [v.name for v in description.variables.values() if v.causality == "output"] == ["T_out"]
    nominal = {"C1": 2500, "G1": 120, "C2": 9000, "G2": 80}
    assert {name: description.variables[name].start for name in nominal} == nominal


def test_nominal_model_reproduces_generated_recording():
    """The recording is the nominal response with a noise of 2 K, so the residuals are this noise."""
    record = recordings.exhaust("own")
    calibration = Calibration(example_fmu("exhaust"), record, ["T_out"], [Parameter("C1", 2500.0, 250.0, 25000.0)], inputs=INPUTS, solver="radau5")
    rms = np.sqrt(calibration.cost() / calibration.n_residuals)
    assert rms == pytest.approx(2.0, abs=4 * 2.0 / np.sqrt(2 * 1801))
    assert calibration.cost([5000.0]) > 1.1 * calibration.cost()


@pytest.mark.parametrize("which", AT_HAND[1:])
def test_nominal_trajectory_matches_reference(which):
    data = recordings.exhaust(which)
    inputs = {name: data[name] for name in ["time", *INPUTS]}
    output = [*STATES, "m2", "T_out"]
    model = FMUModel(example_fmu("exhaust"))
    res = model.simulate(0, 1800, times=data["time"], input=inputs, output=output, relative_tolerance=1e-7)
    expected = {
        1: [103222.03, 479.2013, 431.9388, 101725.71, 440.5308, 400.2193, 0.075866],
        60: [113073.01, 604.1710, 553.7067, 104227.63, 547.7425, 431.9474, 0.169390],
        300: [183688.08, 788.0750, 767.5028, 122726.56, 716.5420, 640.7449, 0.462470],
        600: [122119.57, 684.0618, 683.7916, 106077.66, 650.7654, 602.0183, 0.219721],
        1200: [103652.70, 576.1093, 596.9375, 101974.05, 597.6866, 621.4215, 0.073420],
        1800: [107828.25, 614.3766, 596.5490, 102706.08, 599.7552, 582.3293, 0.125794],
    }
    within = [0.03, 2e-4, 2e-4, 0.03, 2e-4, 2e-4, 1e-6]
    for time, row in expected.items():
        for name, wanted, tolerance in zip(output, row, within):
            assert res[name][time] == pytest.approx(wanted, abs=tolerance), (name, time)
    assert np.array_equal(res["T_out"], res["T2"])
    # calibration set: the first ten minutes; validation set: the rest
    error = res["T_out"] - data["T_out"]
    calibration, validation = error[:601], error[601:]
    assert np.sum(calibration**2) == pytest.approx(290580.7, rel=1e-6)
    assert np.sqrt(np.mean(calibration**2)) == pytest.approx(21.9885, abs=1e-4)
    assert np.sqrt(np.mean(validation**2)) == pytest.approx(13.5848, abs=1e-4)


@pytest.fixture(params=AT_HAND, scope="module")
def record(request):
    return recordings.exhaust(request.param)


@pytest.mark.parametrize("solver", ["radau5", "bdf", "auto"])
def test_stiff_methods_agree_on_nominal_trajectory(solver, record):
    inputs = {name: record[name] for name in ["time", *INPUTS]}

    def run(solver, rtol):
        model = FMUModel(example_fmu("exhaust"))
        return model.simulate(0, 1800, times=record["time"], input=inputs, output=STATES, solver=solver, relative_tolerance=rtol)

    reference, res = run("radau5", 1e-11), run(solver, 1e-8)
    for name in STATES:
        off = np.abs(res[name] - reference[name])
        within = 1e-2 if name.startswith("p") else 1e-4
        assert off[[1, 60, 300, 600, 1200, 1800]].max() < within, name
        # At some other times, the errors of BDF's many steps add up to twice the bound in the first wall.
        assert off.max() < (2 * within if (solver, name) == ("bdf", "Tw1") else within), name
        if solver != "bdf":
            assert (off / np.abs(reference[name])).max() < 2e-8, name
    # "auto" starts with Tsit5, detects stiffness and continues with Newton's method.
    assert res.stats.jacobians > 0 and res.stats.newton_iterations > 0
    explicit = run("tsit5", 1e-8)
    assert res.stats.right_hand_sides < explicit.stats.right_hand_sides


@pytest.mark.parametrize(("solver", "rtol"), [("radau5", 1e-6), ("bdf", 1e-6), ("bdf", 1e-8), ("auto", 1e-6)])
def test_cost_is_smooth_across_kinks_of_inputs(solver, rtol, record):
    """Inputs change their slope at each of 600 times, and the cost must not be noisy.

    At 1e-8, BDF rejects 2300 of 34000 steps, and rounding determines which ones. A cost is then smooth to a few of
    its tolerances (25 points around this one: up to 5)."""
    smooth = 1e-7 if (solver, rtol) == ("bdf", 1e-8) else 1e-8
    first = record["time"] <= 600
    names = ["C1", "G1", "C2", "G2"]
    # a point far from the values of the generated recording, where only noise would remain
    start = [4000.0, 80.0, 6000.0, 120.0]
    data = {name: record[name][first] for name in ["time", *INPUTS, "T_out"]}
    calibration = Calibration(
        example_fmu("exhaust"),
        data=data,
        inputs=INPUTS,
        outputs={"T_out": "T_out"},
        parameters=[Parameter(name, value, 0.1 * value, 10 * value) for name, value in zip(names, start)],
        relative_tolerance=rtol,
        solver=solver,
    )
    cost = calibration.cost(start)
    for k in range(4):
        moved = list(start)
        moved[k] *= 1 + 1e-9
        assert abs(calibration.cost(moved) / cost - 1) < smooth


def test_stiff_fit_compares_and_reports_solver():
    time = np.arange(121.0)
    load = 0.5 - 0.4 * np.cos(0.05 * time)
    inputs = {
        "time": time,
        "T_in": 450 + 450 * load,
        "p_in": 1.1e5 + 1.2e5 * load,
        "w_turb1": 2000 + 4000 * load,
        "w_turb2": 1500 + 3500 * load,
        "p_out": np.full_like(time, 1.013e5),
    }
    truth = FMUModel(example_fmu("exhaust")).simulate(0, 120, times=time, input=inputs, output=["T_out"])

    def calibrate(solver):
        return Calibration(
            example_fmu("exhaust"),
            data=inputs | {"T_out": truth["T_out"]},
            inputs=INPUTS,
            outputs=["T_out"],
            parameters=[Parameter("C1", 4000, 250, 25000, scale="log")],
            solver=solver,
        )

    calibration = calibrate("auto")
    fit = calibration.fit(max_evaluations=5)
    assert fit.solver == calibration.solver == "auto"
    assert calibrate("auto").cost(fit.x) == fit.cost == calibration.cost(fit.x)
    assert calibrate("radau5").fit(max_evaluations=3).solver == "radau5"


@pytest.mark.parametrize("which", AT_HAND)
def test_two_stage_fit_is_as_good_as_with_accurate_method(which):
    """Fits the second half of the pipe, then the first half with the result.

    A method with inaccurate samples makes the cost noisy, so the fit ends at a higher cost after more evaluations.
    Accuracy is therefore important in a comparison of methods."""
    record = recordings.exhaust(which)
    start = {"C1": 2500.0, "G1": 120.0, "C2": 9000.0, "G2": 80.0}
    bounds = {"C": (1.0, 5e4), "G": (0.01, 500.0)}

    def stages(solver, tolerance):
        fixed, found = {}, []
        for names in (["C2", "G2"], ["C1", "G1"]):
            calibration = Calibration(
                example_fmu("exhaust"),
                record,
                ["T_out"],
                [Parameter(name, start[name], *bounds[name[0]]) for name in names],
                inputs=INPUTS,
                window=(0, 600),
                start_values=fixed,
                solver=solver,
                relative_tolerance=tolerance,
            )
            found.append(calibration.fit(x_tol=1e-3, f_tol=1e-3))
            fixed = found[-1].parameters
        return found

    for fit, accurate in zip(stages("auto", None), stages("radau5", 1e-8)):
        assert fit.success and fit.cost == pytest.approx(accurate.cost, rel=1e-4)
        # Least squares needs so few evaluations that one more round of a stencil is a large fraction.
        assert fit.nfev <= max(1.25 * accurate.nfev, accurate.nfev + 3)


@pytest.mark.parametrize(("solver", "most"), [("auto", 200), ("bdf", 1000)])
def test_fit_from_nominal_values_ends_despite_noisy_cost(solver, most):
    """The samples of BDF jump by a few of their tolerances.

    The cost of 9921 is rough by about 10, so models of the residuals always predict too much improvement."""
    nominal = {"C1": 2500.0, "G1": 120.0, "C2": 9000.0, "G2": 80.0}
    fit = Calibration(
        example_fmu("exhaust"),
        data=recordings.OWN / "exhaust.csv",
        inputs=INPUTS,
        outputs=["T_out"],
        window=(0, 500),
        parameters=[Parameter(name, v, 1e-4 * v, 5e4 if name[0] == "C" else 500.0) for name, v in nominal.items()],
        solver=solver,
    ).fit("least-squares")
    assert fit.nfev < most
    assert fit.cost == pytest.approx(9922.5, rel=2e-4)
