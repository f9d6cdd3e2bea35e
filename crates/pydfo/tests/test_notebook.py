"""A notebook that shows a fit and a figure of it."""

import pytest

CELLS = [
    """
import numpy as np, pydfo
%matplotlib inline
t = np.linspace(0.0, 3.0, 31)
fit = pydfo.Calibration(pydfo.example_fmu("dahlquist"), {"time": t, "x": np.exp(-2.0 * t)}, ["x"], pydfo.Parameter("k", 1.0, 0.1, 10.0)).fit()
fit
""",
    "figure = fit.plot()",
]


def test_notebook_shows_fit_and_plot():
    nbclient = pytest.importorskip("nbclient", reason="nbclient runs notebooks")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel", reason="ipykernel is the kernel of notebooks")
    pytest.importorskip("matplotlib")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell.strip()) for cell in CELLS])
    nbclient.NotebookClient(notebook, timeout=60, kernel_name="python3").execute()
    shown, drawn = (cell.outputs for cell in notebook.cells)
    (table,) = [output.data for output in shown if "data" in output]
    assert "The fit converged" in table["text/html"] and "The fit converged" in table["text/plain"]
    assert any("image/png" in output.data for output in drawn if "data" in output)
