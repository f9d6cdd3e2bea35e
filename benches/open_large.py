"""Opens an FMU with 100 000 variables and finds some of them, beside FMPy.

Run in the environment of the benches: `benches/env/.venv/bin/python benches/open_large.py`; `make bench` does.
"""

from __future__ import annotations

import statistics
import tempfile
import time
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import pydfo

VARIABLES = 100_000
ROUNDS = 5


def write(path: Path) -> None:
    """An FMU of version 2.0 that is all description."""
    variables = "\n".join(
        f'<ScalarVariable name="plant.stage[{i}].massFlowRate" valueReference="{i}" description="mass flow rate of stage {i}">'
        f'<Real unit="kg/s" min="0"/></ScalarVariable>'
        for i in range(VARIABLES)
    )
    text = (
        '<fmiModelDescription fmiVersion="2.0" modelName="large" guid="{1}"><ModelExchange modelIdentifier="large"/>'
        f"<ModelVariables>{variables}</ModelVariables></fmiModelDescription>"
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", text)


def median(run: Callable[[], object]) -> float:
    """Median of some calls, in milliseconds."""
    taken = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        run()
        taken.append(time.perf_counter() - begin)
    return 1e3 * statistics.median(taken)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"large{i}.fmu" for i in range(ROUNDS)]
        for path in paths:
            write(path)
        fresh = iter(paths)
        ours = median(lambda: pydfo.read_description(next(fresh)))
        theirs = median(lambda: fmpy.read_model_description(paths[0], validate=False))
        print(f"opening {VARIABLES} variables: pydfo {ours:.0f} ms, FMPy {theirs:.0f} ms, {theirs / ours:.1f} times")
        description = pydfo.read_description(paths[0])
        tracemalloc.start()
        names = [f"plant.stage[{i}].massFlowRate" for i in range(0, VARIABLES, 1000)]
        found = median(lambda: [description.variables[name] for name in names]) / len(names)
        _, most = tracemalloc.get_traced_memory()
        print(f"finding one by name: {1e3 * found:.1f} us; Python objects made on the way: at most {most / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
