"""The live line of a fit."""

import io
import os
import subprocess
import sys
import textwrap
from contextlib import redirect_stderr

import numpy as np
import pytest

from pydfo import Calibration, Parameter, example_fmu
from pydfo._optimize import live_line as _live
from pydfo._optimize.progress import Progress

pty = pytest.importorskip("pty")

TIME = np.linspace(0.0, 3.0, 31)


def decay():
    return Calibration(example_fmu("dahlquist"), {"time": TIME, "x": np.exp(-2.0 * TIME)}, ["x"], Parameter("k", 1.0, 0.1, 10.0))


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def terminal(monkeypatch):
    monkeypatch.setattr(_live, "_display", _live._Plain)
    return Terminal()


def progress(**more):
    fields = dict(x=np.array([0.5, 2.0]), fun=1.25, nit=3, nfev=12, nfail=0, n_speculative=0, solve_time=0.1, operation="")
    return Progress(**fields | dict(x_size=None, f_spread=None, final_simplex=None, final_population=None, _recent=[]) | more)


def test_line_shows_results_and_remaining_limits():
    line = _live.LiveLine(["a", "b"], 0.0, 100, None, 60)
    assert line.text(2.0) == "fit: first simulations, 2 s"
    line._progress = progress()
    assert line.text(7.0) == "fit: 12 evaluations, best cost 1.25, a = 0.5, b = 2, 7 s, 88 evaluations left, 53 s left"
    line = _live.LiveLine([f"p{i}" for i in range(30)], 0.0, None, None, None)
    line._progress = progress(x=np.ones(30))
    assert line.text(0.0) == "fit: 12 evaluations, best cost 1.25, p0 = 1, p1 = 1, p2 = 1, ..., 0 s"


def test_line_is_shown_and_removed_in_a_terminal(terminal, capsys):
    with redirect_stderr(terminal):
        decay().fit(disp=True)
    shown = terminal.getvalue()
    assert "\rfit: " in shown and shown.endswith("\r") and shown.split("\r")[-2].strip() == ""
    assert "converged" in capsys.readouterr().out


def test_line_is_hidden_for_short_fits_and_pipes(terminal, monkeypatch, capsys):
    monkeypatch.setattr("pydfo._calibration.display.DELAY", 60.0)
    with redirect_stderr(terminal):
        decay().fit()
        decay().fit(disp=False)
    assert terminal.getvalue() == ""
    with redirect_stderr(io.StringIO()) as pipe:
        decay().fit()
        assert pipe.getvalue() == "" and capsys.readouterr().out == ""
        decay().fit(disp=True)
    assert pipe.getvalue() == "" and capsys.readouterr().out.startswith(" iter")


def test_line_is_removed_after_an_exception(terminal):
    def fail(_):
        raise RuntimeError("mine")

    with pytest.raises(RuntimeError, match="mine"), redirect_stderr(terminal):
        decay().fit(disp=True, callback=fail)
    assert terminal.getvalue().endswith("\r")
    with pytest.raises(TypeError, match="disp"):
        decay().fit(disp="yes")


def test_line_is_updated_between_iterations(terminal):
    # Simulations of a million steps leave time for several ticks before the first iteration.
    data = {"time": TIME, "x": np.exp(-2.0 * TIME)}
    calibration = Calibration(example_fmu("dahlquist"), data, ["x"], Parameter("k", 1.0, 0.1, 10.0), solver="euler", step_size=1e-6)
    with redirect_stderr(terminal):
        calibration.fit("nelder-mead", disp=True, max_evaluations=3, covariance=None)
    assert "\rfit: first simulations" in terminal.getvalue()


def test_closed_terminal_is_tolerated(terminal):
    terminal.close()
    with redirect_stderr(terminal):
        line = _live.LiveLine(["k"], 0.0, None, None, None)
        line(progress())
        line.close()


def test_interrupt_leaves_terminal_clean(tmp_path):
    script = tmp_path / "fit.py"
    script.write_text(
        textwrap.dedent("""
        import os, signal, threading
        import numpy as np, pydfo
        from pydfo._optimize import live_line as _live
        _live._display = _live._Plain
        t = np.linspace(0.0, 3.0, 31)
        calibration = pydfo.Calibration(pydfo.example_fmu("dahlquist"), {"time": t, "x": np.exp(-2.0 * t)}, ["x"],
                                        pydfo.Parameter("k", 1.0, 0.1, 10.0), solver="euler", step_size=1e-6)
        threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT)).start()
        try:
            calibration.fit("nelder-mead", disp=True, x_tol=1e-12, f_tol=1e-14)
        except pydfo.Interrupted:
            os.write(2, b"END")
    """)
    )
    main, other = pty.openpty()
    process = subprocess.Popen([sys.executable, script], stdout=subprocess.DEVNULL, stderr=other)
    os.close(other)
    shown = b""
    while True:
        try:
            part = os.read(main, 4096)
        except OSError:
            break
        if not part:
            break
        shown += part
    assert process.wait(30) == 0
    os.close(main)
    lines = shown.decode().split("\r")
    assert any(line.startswith("fit: ") for line in lines) and lines[-1] == "END" and lines[-2].strip() == ""
