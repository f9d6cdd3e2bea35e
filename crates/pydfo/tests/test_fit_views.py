"""Views of a fit: text, notebook output, figures, report."""

import numpy as np
import pytest

import pydfo
from pydfo import Calibration, Experiment, FMUModel, Parameter, example_fmu

TIME = np.linspace(0.0, 3.0, 31)


def decay(n=1, **more):
    """Returns n recordings of x' = -2 x with an error of 0.001."""
    noise = 1e-3 * (-1.0) ** np.arange(31)
    runs = [Experiment({"time": TIME, "x": np.exp(-2.0 * TIME) + noise}, {"x": "x"}, name=f"<run> & {k}") for k in range(n)]
    return Calibration(example_fmu("dahlquist"), runs, Parameter("k", 1.0, 0.1, 10.0), **more)


@pytest.fixture(scope="module")
def fit():
    return decay().fit()


@pytest.fixture
def plt():
    pytest.importorskip("matplotlib").use("Agg")
    import matplotlib.pyplot as plt

    yield plt
    plt.close("all")


def test_text_contains_values_units_rms_and_termination(fit):
    text = str(fit)
    assert text == repr(fit)
    assert text.startswith("Fit of Dahlquist\nThe fit converged: RMS 0.001 (at the start 0.1629) over 31 measurements.")
    for part in (f"k  1  -> {fit.x[0]:.4f}", "+- ", "1/s", "RMS 0.001", "fit 99.6 %", "n 31", "right-hand sides", fit.message):
        assert part in text, part
    (output,) = fit.outputs
    assert output.variable == output.column == "x" and output.n == 31
    np.testing.assert_allclose(output.rms, np.sqrt(np.mean(fit.residuals() ** 2)))
    spread = np.linalg.norm(np.exp(-2.0 * TIME) - np.exp(-2.0 * TIME).mean())
    np.testing.assert_allclose(output.fit_percent, 100.0 * (1.0 - np.linalg.norm(fit.residuals()) / spread), atol=0.01)


def test_weights_do_not_change_the_rms_of_an_output():
    data = {"time": TIME, "x": np.exp(-2.0 * TIME) + 1e-3 * (-1.0) ** np.arange(31)}
    for method in ("least-squares", "nelder-mead"):
        fit = Calibration(example_fmu("dahlquist"), data, ["x"], Parameter("k", 1.0, 0.1, 10.0), weights=[100.0]).fit(method)
        assert fit.outputs[0].rms == pytest.approx(1e-3, rel=0.01)
        assert fit.outputs[0].start_rms == pytest.approx(fit.start_rms / 100.0)


def test_rms_of_an_output_excludes_the_loss():
    data = {"time": TIME, "x": np.exp(-2.0 * TIME)}
    data["x"][7] += 5.0
    fit = Calibration(example_fmu("dahlquist"), data, ["x"], Parameter("k", 1.0, 0.1, 10.0)).fit(loss="cauchy", f_scale=1e-3)
    assert fit.outputs[0].rms == pytest.approx(np.sqrt(np.mean(fit.residuals() ** 2)))


def test_failed_start_is_reported(plt, tmp_path):
    data = {"time": TIME, "x": np.exp(-2.0 * TIME)}
    # The start is too stiff for the step size, so the explicit method overflows.
    calibration = Calibration(example_fmu("dahlquist"), data, ["x"], Parameter("k", 9e8, 0.1, 1e9, scale="log"), solver="euler", step_size=0.05)
    fit = calibration.fit("de", rng=1, max_evaluations=400)
    assert fit.outputs[0].start_rms is None and "(start failed)" in str(fit)
    assert len(fit.plot().axes) == 2
    fit.report(tmp_path / "x.html")
    assert "The simulation at the start failed." in (tmp_path / "x.html").read_text()


def test_notebook_tables_use_notebook_colours(fit):
    html = fit._repr_html_()
    assert html.count("<table>") == 2 and "The fit converged" in html and "color: inherit" in html
    assert "&lt;run&gt; &amp; 1" in decay(2).fit()._repr_html_()


def test_report_is_one_page_without_network(tmp_path):
    path = tmp_path / "fit.html"
    path.write_text("an older one")
    fit = decay(2).fit()
    fit.report(path)
    page = path.read_text()
    assert page.startswith("<!DOCTYPE html>") and page.count("<svg width") == 3
    assert "&lt;run&gt; &amp; 0" in page and "<run>" not in page
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "") and "<script" not in page
    assert [p.name for p in tmp_path.iterdir()] == ["fit.html"]
    with pytest.raises(OSError, match="cannot write"):
        fit.report(tmp_path / "no folder" / "x.html")
    with pytest.raises(OSError):
        fit.report(tmp_path)


def test_report_of_long_recording_is_small(tmp_path):
    time = np.linspace(0.0, 3.0, 100_001)
    x = np.exp(-2.0 * time)
    fit = Calibration(example_fmu("dahlquist"), {"time": time, "x": x}, ["x"], Parameter("k", 1.9, 0.1, 10.0)).fit(max_evaluations=5)
    fit.report(tmp_path / "x.html")
    assert (tmp_path / "x.html").stat().st_size < 300_000
    assert "One of 101 of the 100001 measurements is drawn." in (tmp_path / "x.html").read_text()


def test_plot_fits_eight_outputs_and_inputs_on_one_page(plt, tmp_path):
    time = np.linspace(0.0, 20.0, 41)
    inputs = {"u1": np.full(41, 5.0), "u2": np.full(41, 5.5)}
    names = [f"qt.x{i}" for i in range(1, 5)] + [f"der(qt.x{i})" for i in range(1, 5)]
    truth = FMUModel(example_fmu("quad_tank")).simulate(0, 20, times=time, inputs={"time": time, **inputs}, outputs=names)
    data = {"time": time, **inputs} | {f"y{k}": truth[name] for k, name in enumerate(names)}
    outputs = {name: f"y{k}" for k, name in enumerate(names)}
    parameter = Parameter("qt.a1", 2.9e-6, 2e-6, 4e-6)
    fit = Calibration(example_fmu("quad_tank"), data, outputs, parameter, ["u1", "u2"], window=(5.0, 15.0)).fit(max_evaluations=20)
    figure = fit.plot()
    assert len(figure.axes) == 17
    width, height = figure.get_size_inches()
    assert width < 14 and height < 14
    assert [line.get_label() for line in figure.axes[0].lines] == ["measured", "start", "fitted"]
    assert len(figure.legends) == 1 and figure.axes[0].get_ylabel() == "[m]"
    figure.savefig(tmp_path / "x.png")


def test_convergence_plot_has_parameter_names(plt, fit):
    figure = fit.plot_convergence()
    assert figure.axes[1].lines[0].get_label() == "k" and figure.axes[0].get_yscale() == "log"


def test_waterfall_plot_has_a_point_per_local_search(plt, fit):
    several = decay().fit(search="global", max_evaluations=60, rng=1)
    axes = several.plot_waterfall().axes[0]
    assert sum(len(line.get_xdata()) for line in axes.lines) == sum(o.n_starts for o in several.optima)
    with pytest.raises(ValueError, match="multistart"):
        fit.plot_waterfall()


def test_fit_without_native_result_is_reported(fit):
    class Interrupted(pydfo.Fit):
        pass

    left = Interrupted.__new__(Interrupted)
    vars(left).update(vars(fit) | {"_native": None})
    assert "message" in repr(left) and left._repr_html_() is None
    with pytest.raises(pydfo.CalibrationError, match="interrupted twice"):
        left.report("x.html")
