"""The command line ``fmufit`` as installed by a wheel: ``python -m pydfo``."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import pydfo
from pydfo import __main__ as command_line


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pydfo", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_command_line_fits_model_to_recording(tmp_path: Path) -> None:
    shutil.copy(pydfo.example_fmu("dahlquist"), tmp_path / "model.fmu")
    made = run(tmp_path, "simulate", "model.fmu", "--set", "k=2", "--final-time", "2", "--output", "run.csv")
    assert (made.returncode, made.stdout) == (0, ""), made
    assert run(tmp_path, "init", "model.fmu", "run.csv").returncode == 0
    fitted = run(tmp_path, "fit", "problem.toml", "--json", "--quiet", "--save", "decay.fit")
    assert (fitted.returncode, fitted.stderr) == (0, ""), fitted
    result = json.loads(fitted.stdout)
    assert result["parameters"][0]["value"] == pytest.approx(2.0, abs=1e-3)
    assert pydfo.load_fit(tmp_path / "decay.fit").x[0] == result["parameters"][0]["value"]


def test_description_limit_can_be_raised_in_every_command(tmp_path: Path) -> None:
    shutil.copy(pydfo.example_fmu("dahlquist"), tmp_path / "model.fmu")
    limit = ("--max-description-bytes", "100")
    assert run(tmp_path, "simulate", "model.fmu", "--final-time", "2", "--output", "run.csv").returncode == 0
    for command in (("info", "model.fmu"), ("validate", "model.fmu"), ("simulate", "model.fmu"), ("init", "model.fmu", "run.csv")):
        refused = run(tmp_path, *command, *limit)
        assert refused.returncode == 2 and "max_description_bytes" in refused.stderr, refused
    assert run(tmp_path, "init", "model.fmu", "run.csv", "--max-description-bytes", "100000").returncode == 0
    problem = tmp_path / "problem.toml"
    text = problem.read_text(encoding="utf-8")
    assert "\nmax_description_bytes = 100000\n" in text and run(tmp_path, "check", "problem.toml").returncode == 0
    problem.write_text(text.replace("bytes = 100000", "bytes = 100"), encoding="utf-8")
    refused = run(tmp_path, "check", "problem.toml")
    assert refused.returncode == 2 and "the limit of 100" in refused.stderr, refused
    short = ("fit", "model.fmu", "run.csv", "--output", "x", "--parameter", "k=1:0.1:3", "--setting")
    assert run(tmp_path, *short, "max_description_bytes=100").returncode == 2


def test_exit_codes_distinguish_success_and_wrong_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, "fit", "none.toml").returncode == 2
    assert run(tmp_path, "--help").returncode == 0
    monkeypatch.setattr(sys, "argv", ["fmufit", "report", "none.fit", "a.html"])
    monkeypatch.setattr("signal.signal", lambda *_: None)
    assert command_line.main() == 2
    assert "none.fit" in capfd.readouterr().err


def test_missing_command_line_is_reported(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def missing(arguments: list[str]) -> int:
        raise NotImplementedError(f"{arguments[0]}: it is not there")

    monkeypatch.setattr(command_line._core, "command_line", missing)
    monkeypatch.setattr(command_line.signal, "signal", lambda *_: None)
    assert command_line.main() == 2
    assert capsys.readouterr().err == "error: fmufit: it is not there\n"
