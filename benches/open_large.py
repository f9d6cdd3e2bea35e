"""Opens an FMU with 100 000 variables and looks some of them up, and an FMU with 160 files, compared with FMPy.

Run it in the environment of the benches: `benches/env/.venv/bin/python benches/open_large.py`; `make bench` does so.
"""

from __future__ import annotations

import random
import shutil
import statistics
import tempfile
import time
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import fmpy.fmi2
import pydfo

VARIABLES = 100_000
ROUNDS = 5


def write(path: Path, guid: int) -> None:
    """Writes an FMU of version 2.0 with only a description, and unique content."""
    variables = "\n".join(
        f'<ScalarVariable name="plant.stage[{i}].massFlowRate" valueReference="{i}" description="mass flow rate of stage {i}">'
        f'<Real unit="kg/s" min="0"/></ScalarVariable>'
        for i in range(VARIABLES)
    )
    text = (
        '<fmiModelDescription fmiVersion="2.0" modelName="large" guid="' + str(guid) + '"><ModelExchange modelIdentifier="large"/>'
        f"<ModelVariables>{variables}</ModelVariables></fmiModelDescription>"
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", text)


def write_real_sized(path: Path) -> None:
    """Writes an example with typical additions of tools, 160 entries of 3.4 MB: documentation, resources, another
    platform's library."""
    noise = random.Random(20260101)
    with zipfile.ZipFile(pydfo.example_fmu("furuta")) as example, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        for name in example.namelist():
            out.writestr(name, example.read(name))
        for i in range(120):
            out.writestr(f"documentation/images/figure{i}.png", noise.randbytes(20_000))
        for i in range(20):
            rows = "\n".join(f"{j},{noise.random()!r}" for j in range(1000))
            out.writestr(f"resources/table{i}.csv", rows)
        out.writestr("binaries/win64/furuta.dll", noise.randbytes(700_000))


def loaded_by_fmpy(path: Path) -> None:
    folder = fmpy.extract(str(path))
    try:
        description = fmpy.read_model_description(folder, validate=False)
        fmpy.fmi2.FMU2Model(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.modelExchange.modelIdentifier,
        )
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def real_sized(folder: Path) -> None:
    """Measures opening and loading an FMU that has not been opened before, each time a file with other content."""
    first = folder / "real.fmu"
    write_real_sized(first)
    paths = []
    for i in range(2 * ROUNDS):
        path = folder / f"real{i}.fmu"
        shutil.copy(first, path)
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr(f"documentation/{i}.txt", str(i))
        paths.append(path)
    fresh = iter(paths)
    ours = median(lambda: pydfo.read_description(next(fresh)))
    theirs = median(lambda: fmpy.read_model_description(str(first)))
    unchecked = median(lambda: fmpy.read_model_description(str(first), validate=False))
    print(
        f"reading the description of {first.stat().st_size / 1e6:.1f} MB, 160 files: pydfo {ours:.2f} ms; "
        f"FMPy, which checks it against the schema, {theirs:.2f} ms, {theirs / ours:.1f} times; "
        f"without that (validate=False) {unchecked:.2f} ms, {unchecked / ours:.1f} times"
    )
    # The value must be calculated, so the library is loaded and the model is initialized.
    ours = median(lambda: pydfo.FMUModel(next(fresh)).get("armJoint.tau"))
    theirs = median(lambda: loaded_by_fmpy(first))
    print(f"opening and loading it: pydfo {ours:.1f} ms, FMPy {theirs:.1f} ms, {theirs / ours:.1f} times")
    again = median(lambda: pydfo.read_description(first))
    print(f"reading it again: pydfo {again:.2f} ms")


def median(run: Callable[[], object]) -> float:
    """Returns the median duration of some calls in milliseconds."""
    taken = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        run()
        taken.append(time.perf_counter() - begin)
    return 1e3 * statistics.median(taken)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"large{i}.fmu" for i in range(ROUNDS)]
        for guid, path in enumerate(paths):
            write(path, guid)
        fresh = iter(paths)
        ours = median(lambda: pydfo.read_description(next(fresh)))
        theirs = median(lambda: fmpy.read_model_description(paths[0], validate=False))
        print(f"opening {VARIABLES} variables: pydfo {ours:.0f} ms, FMPy {theirs:.0f} ms, {theirs / ours:.1f} times")
        description = pydfo.read_description(paths[0])
        tracemalloc.start()
        names = [f"plant.stage[{i}].massFlowRate" for i in range(0, VARIABLES, 1000)]
        found = median(lambda: [description.variables[name] for name in names]) / len(names)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        print(f"finding one by name: {1e3 * found:.1f} us; Python objects made on the way: at most {most / 1024:.0f} KiB")
        real_sized(Path(folder))


if __name__ == "__main__":
    main()
