"""Checks `fmufit.exe` under Wine: fits in worker processes give the native results, and faults of a model are named.

    python tools/windows_check.py FMUFIT_EXE WORK_FOLDER

Requires Wine (`wine64`, or the program in the variable WINE) with a folder in WINEPREFIX that `wine_prefix.sh` has made, and
`x86_64-w64-mingw32-gcc`. The models are bundled with pydfo and compiled for Windows here. Faults happen in worker processes of
Wine, in calls that end at once or after 2 s.
"""

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import pydfo

COMPILER = "x86_64-w64-mingw32-gcc"
ROOT = Path(__file__).resolve().parent.parent

FURUTA = """
model = "{model}"
[[experiments]]
data = "furuta.csv"
outputs = {{ "armJoint.phi" = "phi", "pendulumJoint.phi" = "theta" }}
[[parameters]]
name = "armFriction"
start = 0.012
lower = 0
upper = 0.022
[[parameters]]
name = "pendulumFriction"
start = 0.002
lower = 0
upper = 0.012
[fit]
workers = 2
"""

DECAY = """
model = "{model}"
[[experiments]]
data = "decay.csv"
outputs = {{ x = "x" }}
[[parameters]]
name = "k"
start = 1.0
lower = 0.1
upper = 10.0
[settings]
timeout = {seconds}
[fit]
method = "cma-es"
rng = 1
max_evaluations = 40
workers = 2
"""

#: Statements that a model executes if k > 3, and the words of the error.
FAULTS = {
    "crash": ("*(volatile int *)0 = 1;", "access violation in fmi2"),
    "exit": ("exit(7);", "the process called exit(7) in fmi2"),
    "abort": ('fprintf(stderr, "last words"); fflush(stderr); abort();', "abort in fmi2"),
    "stack": ("deep(0);", "stack overflow in fmi2"),
    "hang": ("for (;;) {}", "no answer within the time limit in fmi2"),
}
DEEP = "static int deep(volatile int n) { volatile char b[4096]; b[0] = (char)n; return deep(n + 1) + b[0]; }\n"

def compiled(out, sources, *libraries):
    subprocess.run([COMPILER, "-O2", "-w", "-shared", "-static-libgcc", "-o", out, *sources, *libraries], check=True)


def windows_fmu(name, out, fault=None):
    """Compiles a bundled model for Windows, with a fault if k > 3."""
    folder = out.with_suffix("")
    shutil.rmtree(folder, ignore_errors=True)
    zipfile.ZipFile(pydfo.example_fmu(name)).extractall(folder)
    if fault:
        source = folder / "sources/model.c"
        begin = "    memory->derivative ="
        text = source.read_text().replace(begin, f"    if (memory->k > 3.0) {{ {fault} }}\n{begin}")
        source.write_text(f"#include <stdio.h>\n#include <stdlib.h>\n{DEEP}{text}")
    library = folder / f"binaries/win64/{name}.dll"
    library.parent.mkdir()
    compiled(library, sorted(map(str, folder.glob("sources/*.c"))))
    with zipfile.ZipFile(out, "w") as archive:
        for path in (folder / "modelDescription.xml", library):
            archive.write(path, path.relative_to(folder))


def main(exe, work):
    exe, work = Path(exe).resolve(), Path(work).resolve()
    work.mkdir(parents=True, exist_ok=True)
    wine = os.environ.get("WINE") or shutil.which("wine64") or "/usr/lib/wine/wine64"
    environment = {**os.environ, "WINEDEBUG": "-all"}

    def under_wine(*arguments):
        return subprocess.run([wine, exe, *arguments], cwd=work, env=environment, capture_output=True, text=True, timeout=300)

    version = under_wine("--version")
    assert version.stdout.startswith("fmufit "), version

    shutil.copy(ROOT / "examples/data/furuta.csv", work)
    rows = ((k / 10, math.exp(-k / 5) + 0.001 * math.sin(17 * k)) for k in range(21))
    (work / "decay.csv").write_text("time,x\n" + "".join(f"{t},{x}\n" for t, x in rows))
    native = Path(sys.executable).parent / "fmufit"
    for name, problem in (("furuta", FURUTA), ("dahlquist", DECAY)):
        windows_fmu(name, work / f"{name}.fmu")
        (work / f"{name}.toml").write_text(problem.format(model=f"{name}.fmu", seconds=60))
        (work / f"{name}-native.toml").write_text(problem.format(model=pydfo.example_fmu(name), seconds=60))
        found = json.loads(under_wine("fit", f"{name}.toml", "--quiet", "--json").stdout)
        command = [native, "fit", f"{name}-native.toml", "--quiet", "--json"]
        expected = json.loads(subprocess.run(command, cwd=work, capture_output=True, text=True).stdout)
        for ours, theirs in zip(found["parameters"], expected["parameters"], strict=True):
            value, error = (ours[key] / theirs[key] - 1 for key in ("value", "standard_error"))
            print(f"{name} {ours['name']}: value {value:.1e}, standard error {error:.1e} relative to native")
            assert abs(value) < 1e-6 and abs(error) < 1e-3

    # A fit that would take hours ends at Ctrl-C with its best point.
    slow = DECAY.format(model="dahlquist.fmu", seconds=60).replace("[settings]", '[settings]\nsolver = "euler"\nstep_size = 1e-6')
    (work / "slow.toml").write_text(slow.replace("max_evaluations = 40", "max_evaluations = 100000"))
    command = [wine, exe, "fit", "slow.toml", "--json"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=work, env=environment, **pipes) as process:
        while "searching" not in (line := process.stderr.readline()):
            assert line, "the fit has ended"
        process.send_signal(signal.SIGINT)
        out, error = process.communicate(timeout=60)
    assert process.returncode == 130 and json.loads(out)["n_evaluations"] > 0, (process.returncode, out, error)
    print(f"Ctrl-C: {json.loads(out)['message']}")

    for name, (fault, words) in FAULTS.items():
        windows_fmu("dahlquist", work / f"{name}.fmu", fault)
        seconds = 2 if name == "hang" else 60
        (work / f"{name}.toml").write_text(DECAY.format(model=f"{name}.fmu", seconds=seconds))
        error = under_wine("simulate", f"{name}.fmu", "--set", "k=4", "--timeout", str(seconds)).stderr
        assert words in error, error
        fit = json.loads(under_wine("fit", f"{name}.toml", "--quiet", "--json").stdout)
        print(f"{name}: {error.strip()}; fit with {fit['n_failed']} of {fit['n_evaluations']} evaluations failed")
        assert fit["n_failed"] > 0 and abs(fit["parameters"][0]["value"] - 2) < 0.02

    left = list((Path(os.environ["WINEPREFIX"]) / "drive_c/users").glob("*/**/fmufit-worker-*"))
    assert not left, left


if __name__ == "__main__":
    main(*sys.argv[1:])
