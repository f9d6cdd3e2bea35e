"""Design optimisation: criteria, searches, scenarios, constraints, mistakes."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import pydfo
from pydfo import Design, Parameter, Scenario, example_fmu

K = [Parameter("k", 2.0, 0.1, 10.0)]


FIFTY = Scenario(50)


def decay(objective="integral(x) + k**2", scenarios=FIFTY, **given):
    return Design(example_fmu("dahlquist"), K, objective, scenarios, **given)


def test_best_design_matches_closed_form_and_prints_its_criteria():
    result = decay().optimize()
    assert result.success, result
    assert result["k"] == pytest.approx(0.5 ** (1 / 3), rel=3e-3)
    assert result.value == pytest.approx(1.889881574842, rel=1e-4)
    assert result.start.objectives == pytest.approx([4.5], rel=1e-5)
    assert result.point["integral(x)"] == pytest.approx(1 / result["k"], rel=1e-5)
    assert "integral(x) + k**2 = 1.8898" in repr(result) and "(optimised), at the start 4.5" in repr(result)
    assert result.to_dict()["criteria"] == result.point.criteria


def test_maximised_objective_reports_its_own_value():
    result = decay("maximize -integral(x) - k**2").optimize()
    assert result.value == pytest.approx(-1.889881574842, rel=1e-4)


def test_constraint_with_a_criterion_holds_at_the_result():
    result = decay(constraints=["crossing_time(x, 0.4) <= 1"]).optimize()
    assert result.success and result.violation <= 1e-6
    assert result["k"] == pytest.approx(np.log(2.5), rel=1e-3)
    (limited,) = result.point.constraints
    assert limited.text == "crossing_time(x, 0.4) <= 1" and limited.upper == 1.0 and limited.violation <= 1e-6


def test_scenarios_are_weighted_and_combined():
    scenarios = [Scenario(50, name="one"), Scenario(50, start_values={"x": 8.0}, weight=0.25, name="eight")]
    for combine, expected in [("sum", (3 / 2.5) ** (1 / 3)), ("worst", (2 / 0.5) ** (1 / 3))]:
        result = decay(scenarios=scenarios, combine=combine).optimize()
        # Minimum of s/k + w k^2; in the worst case, scenario two has s = 2 and w = 0.25.
        if combine == "worst":
            # Scenario one is worse where k is large: 1/k + k^2 = 2/k + k^2/4 at k^3 = 4/3.
            expected = (4 / 3) ** (1 / 3)
        assert result["k"] == pytest.approx(expected, rel=5e-3), combine
        assert list(result.point.criteria) == ["one", "eight"]


def test_workers_and_resume_give_the_same_bits(tmp_path):
    results = [decay().optimize(workers=workers) for workers in (1, 3)]
    assert results[0].x.tobytes() == results[1].x.tobytes()
    file = tmp_path / "design.ckpt"
    decay().optimize(checkpoint=file, max_evaluations=5)
    resumed = decay().optimize(checkpoint=file, max_evaluations=5)
    assert resumed.nfev == 5
    with pytest.raises(pydfo.CheckpointError, match="objective|goals"):
        decay("integral(x) + 2*k**2").optimize(checkpoint=file)


def test_failed_simulations_rank_last():
    # A tank controller with a negative gain is refused by the model.
    design = Design(example_fmu("tank_control"), [Parameter("K1", 0.5, -2.0, 5.0)], "itae(e1)", Scenario(100))
    result = design.optimize(max_evaluations=40)
    assert result["K1"] > 0 and result.search.nfail > 0


def test_controller_design_meets_its_overshoot_limit():
    design = Design(
        example_fmu("tank_control"),
        [Parameter("K1", 3.0, 0.5, 20.0), Parameter("T1", 30.0, 5.0, 200.0)],
        "itae(e1)",
        Scenario(400, start_values={"r2": 12.783158403008972}),
        constraints=["overshoot(x1, r1) <= 5"],
    )
    result = design.optimize()
    assert result.success, result
    assert result.value < 0.8 * result.start.objectives[0]
    rows = result.simulate(np.linspace(0, 400, 40001), ["x1"])["x1"]
    overshoot = 100 * (rows.max() - 14) / (14 - rows[0])
    assert overshoot <= 5.001
    assert result.point["overshoot(x1, r1)"] == pytest.approx(overshoot, abs=2e-3)


def test_callable_objective_receives_simulation_results():
    design = Design(
        example_fmu("dahlquist"), K, lambda run: np.trapezoid(run["x"], run["time"]) + 0.5, Scenario(5), outputs=["x"], times=np.linspace(0, 5, 501)
    )
    result = design.optimize(max_evaluations=60)
    assert result["k"] == pytest.approx(10.0, abs=1e-2) and result.point is None
    with pytest.raises(ValueError, match="disp is not available for a callable objective"):
        design.optimize(disp=True)


def test_data_columns_are_references_and_inputs():
    table = {"time": [0.0, 5.0], "target": [1.0, 0.0]}
    design = decay("ise(x, target)", Scenario(data=table))
    e5 = np.exp(-5.0)
    expected = (1 - e5**2) / 2 - 2 * (1 - (1 - e5) / 5) + 5 / 3
    assert design.evaluate({"k": 1.0}).objectives[0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"objective": "ise(X2, 1)"}, r"'X2' \('x'\?\) is neither a variable .*column 5"),
        ({"objective": "fnal(x)"}, r"'fnal' is not a function; 'final'\?"),
        ({"objective": "k + 1"}, "contains no criterion"),
        ({"combine": "best"}, "available: sum, mean, worst"),
        ({"constraints": ["max(y) <= 1"]}, r"constraint 'max\(y\) <= 1': 'y' \('x'\?\)"),
        ({"scenarios": []}, "scenarios is empty"),
        ({"scenarios": Scenario(-1)}, "final_time = -1 must be later"),
        ({"scenarios": [Scenario(1, name="a")] * 2}, "two scenarios are named 'a'"),
        ({"objective": lambda run: 0.0}, "requires outputs and times"),
    ],
)
def test_mistakes_are_named(arguments, match):
    with pytest.raises(ValueError, match=match):
        decay(**arguments)


def test_calibration_pickles_with_its_goals():
    design = decay()
    again = pickle.loads(pickle.dumps(design))
    assert again.evaluate([1.0]).objectives == design.evaluate([1.0]).objectives


def test_trajectory_constraint_in_a_fit():
    time = np.linspace(0, 2, 21)
    data = {"time": time, "x": np.exp(-2.0 * time)}
    calibration = pydfo.Calibration(example_fmu("dahlquist"), data, ["x"], [Parameter("k", 0.5, 0.1, 5.0)], constraints=["final(x) >= 0.05"])
    fit = calibration.fit()
    assert fit.parameters["k"] == pytest.approx(np.log(20) / 2, rel=1e-4)
    assert fit.success and fit.constr_violation <= 1e-6
    assert fit.uncertainty.active_constraints == ["final(x) >= 0.05"]


def test_pareto_front_of_a_design_matches_closed_form(tmp_path):
    # x' = -k x: area 1/k and effort k^2, so area^2 * effort = 1.
    design = decay(["integral(x)", "k**2"], Scenario(500))
    front = design.pareto(population=20, rng=1, max_evaluations=400)
    assert front.success and front.criteria.shape == (20, 2)
    assert front.criteria[:, 0] ** 2 * front.criteria[:, 1] == pytest.approx(np.ones(20), rel=1e-4)
    assert front.names == ("integral(x)", "k**2")
    again = design.pareto(population=20, rng=1, max_evaluations=400, workers=2)
    assert again.x.tobytes() == front.x.tobytes()
    for budget in (150, 400):
        resumed = design.pareto(population=20, rng=1, max_evaluations=budget, checkpoint=tmp_path / "front")
    assert resumed.x.tobytes() == front.x.tobytes()
    with pytest.raises(ValueError, match="requires several objectives"):
        decay().pareto()


def test_sensitivity_of_a_design_names_objectives_and_criteria():
    found = decay("integral(x) + 0*final(x)", Scenario(500)).sensitivity("morris", n=4, rng=1)
    assert found.outputs == ["integral(x) + 0*final(x)", "integral(x)", "final(x)"] and found.n_evaluations == 8
    assert found.mu_star[0, 0] == found.mu_star[1, 0] > 0


def test_report_shows_criteria_and_figures(tmp_path):
    result = decay(constraints=["final(x) <= 0.5"]).optimize()
    result.report(tmp_path / "design.html")
    page = (tmp_path / "design.html").read_text()
    assert "Criteria and constraints" in page and "final(x) &lt;= 0.5" in page and "<svg" in page and "NaN" not in page
