"""Handmade FMUs, and helpers for tests of models."""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from pydfo import example_fmu

EXAMPLES = ("furuta", "bouncing_ball", "dahlquist", "van_der_pol", "stair", "switched_input", "quad_tank", "exhaust")

ME = '<ModelExchange modelIdentifier="m"/>'

#: A variable of each kind.
KINDS = """
<ScalarVariable name="pi" valueReference="1" causality="local" variability="constant"><Real start="3.14"/></ScalarVariable>
<ScalarVariable name="text" valueReference="2" causality="parameter" variability="fixed"><String start="abc"/></ScalarVariable>
<ScalarVariable name="color" valueReference="3" causality="parameter" variability="fixed">
  <Enumeration declaredType="Color" start="2"/>
</ScalarVariable>
<ScalarVariable name="no start" valueReference="4" causality="local"><Real/></ScalarVariable>
"""

TYPES = """
<TypeDefinitions><SimpleType name="Color" description="Colours"><Enumeration>
  <Item name="red" value="1"/><Item name="blue" value="2" description="as the sky"/><Item name="green" value="4"/>
</Enumeration></SimpleType></TypeDefinitions>
"""


def xml(variables="", *, interface=ME, before=TYPES, head="", structure="", declaration='<?xml version="1.0" encoding="UTF-8"?>'):
    """Returns a model description of FMI 2.0."""
    return (
        f'{declaration}<fmiModelDescription fmiVersion="2.0" modelName="M" guid="{{1}}" numberOfEventIndicators="0" {head}>'
        f"{interface}{before}<ModelVariables>{variables}</ModelVariables><ModelStructure>{structure}</ModelStructure>"
        "</fmiModelDescription>"
    )


def write(path, description=None, files=()):
    """Writes an archive with a model description and files, a dict or pairs of names and contents."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        if description is not None:
            archive.writestr("modelDescription.xml", description)
        for name, content in dict(files).items():
            archive.writestr(name, content)
    return Path(path)


def changed(example, path, *replacements, version="2.0"):
    """Writes a bundled model with pairs of (old, new) replaced in its description."""
    with zipfile.ZipFile(example_fmu(example, version)) as source, zipfile.ZipFile(path, "w") as out:
        for entry in source.infolist():
            content = source.read(entry)
            if entry.filename == "modelDescription.xml":
                for old, new in replacements:
                    assert old.encode() in content
                    content = content.replace(old.encode(), new.encode())
            out.writestr(entry, content)
    return Path(path)


def same_bits(a, b):
    """Returns True if two results have bit-for-bit identical columns."""
    return list(a) == list(b) and all(a[name].tobytes() == b[name].tobytes() for name in a)


def bounces(n, height=1.0, g=9.81, e=0.7):
    """Returns the times of the first `n` impacts of the bouncing ball."""
    k = np.arange(n)
    return np.sqrt(2 * height / g) * (1 + 2 * e * (1 - e**k) / (1 - e))


def compiled(name, path, *defines, replacements=()):
    """Compiles one of the FMI 3.0 models in C of the importer's tests, as an .fmu with a library for this platform.

    `replacements` are pairs of (old, new) in its description."""
    source = Path(__file__).resolve().parents[2] / "fmi" / "tests" / name
    frontend = source.parents[2] / "example-models" / "models" / "frontend"
    compiler = shutil.which("cc")
    if compiler is None or sys.platform != "linux":
        pytest.skip("needs a C compiler on Linux")
    library = path.with_suffix(".so")
    options = ["-shared", "-fPIC", "-O1", "-ffp-contract=off", *(f"-D{define}" for define in defines)]
    sources = [source / f"{name}.c", source.parent / "support" / "rest.c"]
    subprocess.run([compiler, *options, "-I", frontend, "-o", library, *sources, "-lm"], check=True)
    files = {f"binaries/{platform.machine()}-linux/{name}.so": library.read_bytes()}
    description = (source / "modelDescription.xml").read_text(encoding="utf-8")
    for old, new in replacements:
        assert old in description
        description = description.replace(old, new)
    return write(path, description, files)


def evil(path, *defines, replacements=()):
    """Compiles the FMI 2.0 model with faults in C of the importer's tests (x' = -k x, y = x), for both kinds.

    `replacements` are pairs of (old, new) in its description."""
    source = Path(__file__).resolve().parents[2] / "fmi" / "tests" / "evil"
    frontend = source.parents[2] / "example-models" / "models" / "frontend"
    compiler = shutil.which("cc")
    if compiler is None or (sys.platform, platform.machine()) != ("linux", "x86_64"):
        pytest.skip("needs a C compiler on Linux")
    library = path.with_suffix(".so")
    options = ["-shared", "-fPIC", "-O1", "-ffp-contract=off", *(f"-D{define}" for define in defines)]
    subprocess.run([compiler, *options, "-I", frontend, "-o", library, source / "evil.c", "-lm"], check=True)
    description = (source / "modelDescription.xml").read_text(encoding="utf-8")
    both = ME.replace('"m"', '"evil"') + '<CoSimulation modelIdentifier="evil" canHandleVariableCommunicationStepSize="true"/>'
    description = description.replace(ME.replace('"m"', '"evil"'), both)
    for old, new in replacements:
        assert old in description
        description = description.replace(old, new)
    return write(path, description, {"binaries/linux64/evil.so": library.read_bytes()})
