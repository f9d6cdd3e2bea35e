"""Checks models of Windows on Linux: they run in worker processes under Wine, and give the results of the native models.

    python tools/wine_check.py FMUFIT WORKER_EXE WORK_FOLDER [32-BIT_WORKER_EXE]

Requires Wine and MinGW-w64. The models are bundled with pydfo and compiled for Windows here. Faults happen in worker
processes of Wine. Only processes that this script has started are ended. With the worker program for 32 bits, 32-bit models
are checked, too.
"""

import csv
import itertools
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pydfo
from pydfo._core import example_names
from windows_check import DECAY, DEEP, FAULTS, FURUTA, ROOT

#: Allocates memory without end, 16 MB every millisecond; Wine ends the process at the limit of the worker.
GREEDY = "for (;;) { char *more = malloc(1 << 24); if (more) memset(more, 1, 1 << 24); }"


def model_folder(work, name, version="2.0", kind="ME", fault=None):
    """Unpacks a bundled model without its binaries, with a fault if k > 3."""
    folder = work / f"{name}-{version}-{kind}{'-fault' if fault else ''}"
    shutil.rmtree(folder, ignore_errors=True)
    zipfile.ZipFile(pydfo.example_fmu(name, version=version, kind=kind)).extractall(folder)
    shutil.rmtree(folder / "binaries")
    if fault:
        source = folder / "sources/model.c"
        begin = "    memory->derivative ="
        text = source.read_text().replace(begin, f"    if (memory->k > 3.0) {{ {fault} }}\n{begin}")
        source.write_text(f"#include <stdio.h>\n#include <stdlib.h>\n#include <string.h>\n{DEEP}{text}")
    return folder


def main(fmufit, worker, work, worker_32=None):
    fmufit, work = Path(fmufit).resolve(), Path(work).resolve()
    work.mkdir(parents=True, exist_ok=True)
    temporary = work / "temporary"
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir()
    environment = {
        **os.environ,
        "FMUFIT_WINDOWS_WORKER": str(Path(worker).resolve()),
        **({"FMUFIT_WINDOWS_WORKER_32": str(Path(worker_32).resolve())} if worker_32 else {}),
        "TMPDIR": str(temporary),
    }

    def run(*arguments, **options):
        command = [fmufit, *arguments]
        return subprocess.run(
            command, cwd=work, env=environment, capture_output=True, text=True, timeout=300, **options
        )

    def windows_fmu(name, *arguments, platform="win64"):
        """Compiles a model for Windows, and removes the sources, which would be compiled for this system."""
        folder = model_folder(work, *arguments)
        built, out = work / f"{name}-built.fmu", work / f"{name}.fmu"
        done = run("build", folder, built, "--platform", platform)
        assert done.returncode == 0, done.stderr
        with zipfile.ZipFile(built) as archive, zipfile.ZipFile(out, "w") as stripped:
            for entry in archive.namelist():
                if not entry.startswith("sources/"):
                    stripped.writestr(entry, archive.read(entry))
        return out

    def rows(*arguments):
        done = run("simulate", *arguments, "-o", "out.csv")
        assert done.returncode == 0, (arguments, done.stderr)
        with (work / "out.csv").open() as file:
            names, *values = csv.reader(file)
        return names, [[float(value) for value in row] for row in values]

    platforms = {"win64": "x86_64-windows (runs here under Wine)"}
    if worker_32:
        platforms["win32"] = "x86-windows (runs here in a 32-bit process)"
    for platform, shown in platforms.items():
        worst = 0.0
        for name in example_names():
            for version, kind in itertools.product(("1.0", "2.0", "3.0"), ("ME", "CS")):
                model = windows_fmu("model", name, version, kind, platform=platform)
                options = ("--kind", kind, "--final-time", "2", "--interval", "0.02")
                names, found = rows(model, *options)
                expected_names, expected = rows(pydfo.example_fmu(name, version=version, kind=kind), *options)
                assert names == expected_names and len(found) == len(expected)
                for ours, theirs in zip(found, expected, strict=True):
                    for a, b in zip(ours, theirs, strict=True):
                        worst = max(worst, abs(a - b) / max(1.0, abs(b)))
        print(f"{platform}: {len(example_names())} models, FMI 1.0, 2.0, 3.0, ME and CS: largest difference to native {worst:.1e}")
        assert worst < 1e-9
        assert shown in run("info", work / "model.fmu").stdout

    shutil.copy(ROOT / "examples/data/furuta.csv", work)
    decay = ((k / 10, math.exp(-k / 5) + 0.001 * math.sin(17 * k)) for k in range(21))
    (work / "decay.csv").write_text("time,x\n" + "".join(f"{t},{x}\n" for t, x in decay))
    for (name, problem), platform in itertools.product((("furuta", FURUTA), ("dahlquist", DECAY)), reversed(platforms)):
        results = []
        for label, model in (("wine", windows_fmu(name, name, platform=platform)), ("native", pydfo.example_fmu(name))):
            (work / f"{name}-{label}.toml").write_text(problem.format(model=model, seconds=60))
            began = time.perf_counter()
            done = run("fit", f"{name}-{label}.toml", "--quiet", "--json")
            results.append((json.loads(done.stdout), time.perf_counter() - began))
        (found, seconds), (expected, native_seconds) = results
        for ours, theirs in zip(found["parameters"], expected["parameters"], strict=True):
            value, error = (ours[key] / theirs[key] - 1 for key in ("value", "standard_error"))
            print(f"{platform} {name} {ours['name']}: value {value:.1e}, standard error {error:.1e} relative to native")
            assert abs(value) < 1e-6 and abs(error) < 1e-3
        extra = 1e3 * (seconds - native_seconds) / found["n_evaluations"]
        print(f"{platform} {name}: {seconds:.2f} s, native {native_seconds:.2f} s, {extra:.2f} ms more per evaluation")

    faults = {**FAULTS, "memory": (GREEDY, "memory limit of 536870912 bytes exceeded")}
    for (name, (fault, words)), platform in itertools.product(faults.items(), platforms):
        model = windows_fmu(name, "dahlquist", "2.0", "ME", fault, platform=platform)
        seconds = 2 if name == "hang" else 60
        problem = DECAY.format(model=model, seconds=seconds)
        (work / f"{name}.toml").write_text(problem.replace("[settings]", "[settings]\nmemory_limit = 536870912"))
        if name != "memory":
            error = run("simulate", model, "--set", "k=4", "--timeout", str(seconds)).stderr
            assert words in error, (name, error)
        done = run("fit", f"{name}.toml", "--quiet", "--json")
        fit = json.loads(done.stdout)
        print(f"{platform} {name}: fit with {fit['n_failed']} of {fit['n_evaluations']} evaluations failed")
        told = run("fit", f"{name}.toml", "--quiet")
        assert words in told.stdout + told.stderr, (name, told)
        assert fit["n_failed"] > 0 and abs(fit["parameters"][0]["value"] - 2) < 0.02

    generator, cuts = random.Random(1), 0
    long = (work / "furuta-wine.toml").read_text() + 'method = "cma-es"\nrng = 1\nmax_evaluations = 300\n'
    (work / "long.toml").write_text(long)
    began = time.perf_counter()
    whole = json.loads(run("fit", "long.toml", "--quiet", "--json").stdout)
    seconds = time.perf_counter() - began
    for attempt in range(20):
        checkpoint = work / f"cut-{attempt}.checkpoint"
        checkpoint.unlink(missing_ok=True)
        command = [fmufit, "fit", "long.toml", "--quiet", "--json", "--checkpoint", checkpoint]
        process = subprocess.Popen(command, cwd=work, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(generator.uniform(0.0, seconds))
        cuts += process.poll() is None
        process.send_signal(signal.SIGKILL)
        process.wait()
        done = run("fit", "long.toml", "--quiet", "--json", "--checkpoint", checkpoint)
        resumed = json.loads(done.stdout)
        assert resumed["parameters"] == whole["parameters"], (resumed["parameters"], whole["parameters"])
    print(f"{cuts} of 20 fits were killed; all ended with the same numbers after a resume")

    # A fit removes what killed ones have left.
    run("fit", "furuta-wine.toml", "--quiet", "--json")
    left = list(temporary.glob("fmufit-*"))
    listed = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout.splitlines()
    processes = [line for line in listed if "fmufit-worker.exe" in line and "wine_check" not in line]
    print(f"left: {len(left)} folders, {len(processes)} processes")
    assert not left and not processes, (left, processes)


if __name__ == "__main__":
    main(*sys.argv[1:])
