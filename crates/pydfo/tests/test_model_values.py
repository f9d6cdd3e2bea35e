"""Opening models, setting and getting values, closing."""

from __future__ import annotations

import enum
import os
import shutil
import subprocess
import sys
import textwrap
import zipfile
from decimal import Decimal
from pathlib import Path

import fmus
import numpy as np
import pytest

import pydfo
from pydfo import FMUModel, example_fmu, load_fmu


@pytest.fixture
def furuta():
    return FMUModel(example_fmu("furuta"))


@pytest.fixture
def switched():
    return FMUModel(example_fmu("switched_input"))


# --- opening ----------------------------------------------------------------------------------------------------------


class Located:
    def __init__(self, path):
        self.path = path

    def __fspath__(self):
        return str(self.path)


@pytest.mark.parametrize("form", [str, Path, Located])
@pytest.mark.parametrize("load", [FMUModel, load_fmu, pydfo.read_description])
def test_paths_are_accepted_in_all_forms(form, load):
    path = example_fmu("dahlquist")
    assert Path(load(form(path)).path) == path


def test_relative_paths_and_folders_are_opened(tmp_path, monkeypatch):
    shutil.copy(example_fmu("dahlquist"), tmp_path / "d.fmu")
    shutil.unpack_archive(tmp_path / "d.fmu", tmp_path / "folder", format="zip")
    monkeypatch.chdir(tmp_path)
    for name in ("d.fmu", "folder"):
        model = FMUModel(name)
        assert model.simulate(final_time=1).final("x") == pytest.approx(np.exp(-1), rel=1e-5)


@pytest.mark.parametrize("load", [FMUModel, load_fmu, pydfo.read_description])
def test_missing_file_is_reported(load, tmp_path):
    with pytest.raises(FileNotFoundError) as info:
        load(tmp_path / "none.fmu")
    assert info.value.filename == str(tmp_path / "none.fmu")
    assert "none.fmu" in str(info.value)


@pytest.mark.parametrize("path", [None, 3, b"x.fmu", ["x.fmu"]])
def test_non_path_is_rejected(path):
    with pytest.raises(TypeError):
        FMUModel(path)


def test_kind_selects_the_interface():
    path = example_fmu("dahlquist")
    for kind in ("auto", "ME", "me"):
        assert load_fmu(path, kind).description.model_name == "Dahlquist"
    assert load_fmu(path, kind="ME").path == path
    with pytest.raises(pydfo.FmuError, match="co-simulation"):
        load_fmu(path, kind="CS")
    with pytest.raises(ValueError, match="'XY'"):
        load_fmu(path, kind="XY")


def test_unsupported_interface_is_rejected_but_described(tmp_path):
    path = fmus.write(tmp_path / "cs.fmu", fmus.xml(interface='<CoSimulation modelIdentifier="m"/>'))
    with pytest.raises(pydfo.FmuError, match="model exchange"):
        FMUModel(path, kind="ME")
    assert FMUModel(path).kind == "CS"
    description = pydfo.read_description(path)
    assert description.model_exchange is None and description.co_simulation.model_identifier == "m"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not replace an open file")
def test_replaced_file_is_another_model(tmp_path):
    path = tmp_path / "m.fmu"
    shutil.copy(example_fmu("dahlquist"), path)
    first = FMUModel(path)
    os.replace(shutil.copy(example_fmu("van_der_pol"), tmp_path / "new.fmu"), path)
    second = FMUModel(path)
    assert (first.description.model_name, second.description.model_name) == ("Dahlquist", "VanDerPol")
    assert first.simulate(final_time=1, isolation="none").final("x") == pytest.approx(np.exp(-1), rel=1e-5)
    with pytest.raises(ValueError, match="m.fmu has changed"):
        first.simulate(final_time=1)
    assert second.simulate(final_time=1).final("x0") == pytest.approx(1.5, abs=0.5)


def test_model_opened_twice_is_unpacked_once(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path / "unpacked"))
    (tmp_path / "unpacked").mkdir()
    path = shutil.copy(example_fmu("dahlquist"), tmp_path / "m.fmu")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("extra/this_test.txt", "a content that no other test has opened")
    for model in [FMUModel(path) for _ in range(3)]:
        assert model.simulate(final_time=1).termination == "finished"
        # It may also contain a copy of the library, for a simulation that is repeated in a new process.
        assert len(list((tmp_path / "unpacked").iterdir())) <= 2
        model.close()


EXIT = {
    "nothing used": "model = None",
    "kept in a global": "",
    "instance loaded": "model.simulate(final_time=1)",
    "instance loaded by get": "model.get('der(x)')",
    "kept in a cycle": "model.simulate(final_time=1); cycle = [model]; cycle.append(cycle); model.me = model",
    "kept by a function": "def f(m=model): pass",
    "kept by another module": "import math; math.model = model",
    "description alone": "model = model.description; v = model.variables",
    "on another thread": """
import threading
thread = threading.Thread(target=lambda: model.simulate(final_time=1))
thread.start()
thread.join()
""",
    "in fmin": "pydfo.fmin(lambda x: FMUModel(path).simulate(final_time=x[0]).final('x'), [1], [.5], [2], disp=False)",
    "ends by an exception": "raise SystemExit(0)",
}


@pytest.mark.parametrize("script", EXIT.values(), ids=EXIT)
def test_no_files_remain_at_exit(script, tmp_path):
    path = shutil.copy(example_fmu("dahlquist"), tmp_path / "m.fmu")
    unpacked = tmp_path / "unpacked"
    unpacked.mkdir()
    start = f"import os, pydfo\nfrom pydfo import FMUModel\npath = {str(path)!r}\nmodel = FMUModel(path)\n"
    check = f"other = FMUModel(path)\nother.simulate(final_time=1)\nassert os.listdir({str(unpacked)!r})\n"
    done = subprocess.run(
        [sys.executable, "-c", start + check + textwrap.dedent(script)],
        env=os.environ | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(unpacked)),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert list(unpacked.iterdir()) == []


FORK = """
import multiprocessing, os, sys
from pydfo import FMUModel
path, unpacked = sys.argv[1:]
model = FMUModel(path)
expected = model.simulate(0, 1).final("x")
def work(_):
    return FMUModel(path).simulate(0, 1).final("x")
child = os.fork()
if child == 0:
    assert model.simulate(0, 1).final("x") == FMUModel(path).simulate(0, 1).final("x") == expected
    sys.exit(0)
assert os.waitpid(child, 0)[1] == 0
assert len(os.listdir(unpacked)) >= 1, "the child must not remove the folder of its parent"
assert FMUModel(path).simulate(0, 1).final("x") == expected
with multiprocessing.get_context("fork").Pool(2) as pool:
    assert pool.map(work, range(4)) == [expected] * 4
assert len(os.listdir(unpacked)) >= 1
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this platform")
def test_models_work_in_forked_children(tmp_path):
    path = shutil.copy(example_fmu("dahlquist"), tmp_path / "m.fmu")
    unpacked = tmp_path / "unpacked"
    unpacked.mkdir()
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORK, str(path), str(unpacked)],
        env=os.environ | {"TMPDIR": str(unpacked)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert list(unpacked.iterdir()) == []


# --- get --------------------------------------------------------------------------------------------------------------


def test_get_returns_scalar_for_name_and_list_for_list(furuta):
    assert furuta.get("armFriction") == 0.012
    assert furuta.get(["armFriction"]) == [0.012]
    assert furuta.get(("armFriction", "g")) == [0.012, 9.81]
    assert furuta.get(np.array(["armFriction", "g"])) == [0.012, 9.81]
    assert furuta.get([]) == []


def test_values_have_their_types(switched):
    values = switched.get(["K", "enabled", "gear"])
    assert values == [2.0, True, 1]
    assert [type(v) for v in values] == [float, bool, int]


def test_get_returns_initial_values_before_a_simulation(switched):
    switched.set("u", 3.0)
    assert switched.get("target") == 6.0
    switched.set(["K", "gear"], [1.5, 2])
    assert switched.get(["target", "der(x)", "u"]) == [9.0, 18.0, 3.0]


def test_get_returns_final_values_after_a_simulation(furuta):
    result = furuta.simulate(final_time=5)
    names = ["armJoint.phi", "pendulumJoint.phi", "armJoint.w"]
    assert furuta.get(names) == result.final(names) == [result[name][-1] for name in names]
    assert furuta.get("time") == 5.0
    # A value set afterwards is returned at once, and does not change the result of the simulation.
    furuta.set("armFriction", 0.5)
    assert furuta.get("armFriction") == 0.5
    assert furuta.get(names) == result.final(names)


def test_unknown_names_are_rejected(furuta):
    for call in (
        lambda: furuta.get("armFrction"),
        lambda: furuta.get(["g", "armFrction"]),
        lambda: furuta.set("armFrction", 1.0),
        lambda: furuta.simulate(start_values={"armFrction": 1.0}),
        lambda: furuta.simulate(output=["armFrction"]),
        lambda: furuta.simulate(input={"armFrction": 1.0}),
        lambda: furuta.description.variables["armFrction"],
    ):
        with pytest.raises(KeyError) as info:
            call()
        assert isinstance(info.value, pydfo.FmuError)
        assert str(info.value) == 'the model has no variable "armFrction"; did you mean armFriction?'


@pytest.mark.parametrize("name", [None, 3, b"g", ["g", 3], {"g": 1}])
def test_non_names_are_rejected(furuta, name):
    with pytest.raises(TypeError, match="name"):
        furuta.get(name)
    with pytest.raises(TypeError, match="name"):
        furuta.set(name, 1.0)


# --- set --------------------------------------------------------------------------------------------------------------


class Gear(enum.IntEnum):
    LOW = 1
    HIGH = 3


@pytest.mark.parametrize(
    ("name", "given", "value"),
    [
        ("K", 3, 3.0),
        ("K", 3.5, 3.5),
        ("K", np.float64(3.5), 3.5),
        ("K", np.float32(3.5), 3.5),
        ("K", np.int64(3), 3.0),
        ("K", 10**30, 1e30),
        ("K", np.array(3.5), 3.5),
        ("K", np.array([3.5]), 3.5),
        ("K", np.array([[3]]), 3.0),
        ("K", [3.5], 3.5),
        ("K", (3.5,), 3.5),
        ("K", Decimal("3.5"), 3.5),
        ("gear", 3, 3),
        ("gear", 3.0, 3),
        ("gear", np.uint8(3), 3),
        ("gear", np.float64(3.0), 3),
        ("gear", Gear.HIGH, 3),
        ("gear", -(2**31), -(2**31)),
        ("enabled", False, False),
        ("enabled", np.bool_(False), False),
        ("enabled", np.array([False]), False),
    ],
)
def test_values_are_converted_and_set(switched, name, given, value):
    switched.set(name, given)
    assert switched.get(name) == value and type(switched.get(name)) is type(value)
    switched.reset()
    switched.set([name], [given])
    assert switched.get(name) == value


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("K", "3.5"),
        ("K", b"3"),
        ("K", None),
        ("K", True),
        ("K", 1j),
        ("K", {}),
        ("K", object()),
        ("K", np.array(["a"])),
        ("gear", 2.5),
        ("gear", True),
        ("gear", "LOW"),
        ("enabled", 1),
        ("enabled", 1.0),
        ("enabled", "true"),
    ],
)
def test_values_of_wrong_type_are_rejected(switched, name, given):
    with pytest.raises(TypeError, match=name):
        switched.set(name, given)
    with pytest.raises(TypeError, match=name):
        switched.simulate(start_values={name: given})


@pytest.mark.parametrize(
    ("name", "given", "reason"),
    [
        ("K", float("nan"), "NaN"),
        ("K", float("inf"), "inf"),
        ("K", np.array([np.nan]), "NaN"),
        ("K", [1.0, 2.0], "2"),
        ("K", np.zeros(3), "3"),
        ("K", [], "0"),
        ("gear", 2**31, "32 bits, from -2147483648 to 2147483647"),
        ("gear", 2**200, "bits"),
        ("gear", float("nan"), "NaN"),
        ("time", 1.0, "independent"),
        ("target", 1.0, "calculate"),
        ("der(x)", 1.0, "calculate"),
        ("limit", True, "calculate"),
    ],
)
def test_unsettable_values_are_rejected(switched, name, given, reason):
    with pytest.raises(ValueError, match=reason):
        switched.set(name, given)
    with pytest.raises(ValueError, match=reason):
        switched.simulate(start_values={name: given})


def test_lists_of_values_are_set(switched):
    switched.set(["K", "gear", "enabled"], [5.0, 2, False])
    assert switched.get(["K", "gear", "enabled"]) == [5.0, 2, False]
    switched.set(("K", "T"), np.array([1.0, 2.0]))
    assert switched.get(["K", "T"]) == [1.0, 2.0]
    switched.set(["K"], np.array(7.0))
    switched.set(["T"], 8.0)
    assert switched.get(["K", "T"]) == [7.0, 8.0]
    for values in ([1.0], [1.0, 2.0, 3.0], 1.0, "ab"):
        with pytest.raises(ValueError, match="2 values, one per name"):
            switched.set(["K", "T"], values)


def test_all_values_are_set_or_none(switched):
    for names, values, kind in (
        (["K", "nothing"], [5.0, 1.0], KeyError),
        (["K", "target"], [5.0, 1.0], ValueError),
        (["K", "enabled"], [5.0, 1.0], TypeError),
        (["K", "T"], [5.0, np.nan], ValueError),
    ):
        with pytest.raises(kind):
            switched.set(names, values)
        assert switched.get("K") == 2.0


def test_constants_strings_and_enumerations_are_handled(tmp_path):
    path = fmus.write(tmp_path / "m.fmu", fmus.xml(fmus.KINDS))
    model = FMUModel(path)
    with pytest.raises(ValueError, match="constant"):
        model.set("pi", 3.0)
    assert model.get(["pi", "text", "color"]) == [3.14, "abc", 2]
    model.set(["text", "color"], ["xyz", "green"])
    assert model.get(["text", "color"]) == ["xyz", 4]
    model.set("color", 1)
    assert model.get("color") == 1
    for wrong in ("yellow", 3):
        with pytest.raises(ValueError, match=r"red \(1\), blue \(2\), green \(4\)"):
            model.set("color", wrong)
    with pytest.raises(TypeError, match="text"):
        model.set("text", 3)
    with pytest.raises(TypeError, match="NUL"):
        model.simulate(final_time=1, start_values={"text": "a\0b"})
    # The FMU contains no library.
    with pytest.raises(pydfo.FmuError, match="no binary"):
        model.simulate(final_time=1)
    with pytest.raises(pydfo.FmuError, match="no binary"):
        model.get("no start")


# --- persistence, reset, closing --------------------------------------------------------------------------------------


def test_values_persist_until_reset(furuta):
    furuta.set("armFriction", 0.010)
    first = furuta.simulate(final_time=3)
    second = furuta.simulate(final_time=3)
    assert fmus.same_bits(first, second)
    furuta.reset()
    assert furuta.get("armFriction") == 0.012
    third = furuta.simulate(final_time=3)
    assert not fmus.same_bits(first, third)
    assert fmus.same_bits(third, FMUModel(furuta.path).simulate(final_time=3))


def test_start_values_apply_to_one_simulation(furuta):
    plain = furuta.simulate(final_time=3)
    furuta.set("armFriction", 0.011)
    other = furuta.simulate(final_time=3, start_values={"armFriction": 0.010, "armJoint.w": 0.5})
    assert other["armJoint.w"][0] == 0.5
    assert furuta.get("armFriction") == 0.010
    furuta.set("armFriction", 0.012)
    assert fmus.same_bits(plain, furuta.simulate(final_time=3))


def test_models_of_one_file_do_not_share_values():
    one, two = FMUModel(example_fmu("dahlquist")), FMUModel(example_fmu("dahlquist"))
    one.set("k", 2.0)
    assert two.get("k") == 1.0
    a, b = one.simulate(final_time=1), two.simulate(final_time=1)
    assert a.final("x") == pytest.approx(np.exp(-2), rel=1e-5)
    assert b.final("x") == pytest.approx(np.exp(-1), rel=1e-5)
    assert one.get("x") == a.final("x")


def test_context_manager_closes_the_model():
    with FMUModel(example_fmu("dahlquist")) as model:
        assert model.simulate(final_time=1).final("x") == model.get("x")
    assert "closed" in repr(model)
    assert model.description.n_states == 1
    for call in (lambda: model.get("x"), lambda: model.set("k", 1.0), model.reset, model.simulate):
        with pytest.raises(ValueError, match="closed"):
            call()
    model.close()
    with pytest.raises(ZeroDivisionError), FMUModel(example_fmu("dahlquist")) as model:
        1 / 0
    assert "closed" in repr(model)


# --- packing and examples ---------------------------------------------------------------------------------------------


def test_example_fmus_are_built():
    for name in fmus.EXAMPLES:
        path = example_fmu(name)
        assert isinstance(path, Path) and path.is_file() and path.suffix == ".fmu"
    with pytest.raises(ValueError) as info:
        example_fmu("pendulum")
    assert all(name in str(info.value) for name in ("pendulum", *fmus.EXAMPLES))
    with pytest.raises(TypeError):
        example_fmu(None)


def test_packed_folder_runs(tmp_path):
    folder = tmp_path / "folder"
    shutil.unpack_archive(example_fmu("dahlquist"), folder, format="zip")
    shutil.rmtree(folder / "binaries")
    out = pydfo.build_fmu(str(folder), tmp_path / "out.fmu")
    assert out == tmp_path / "out.fmu"
    assert FMUModel(out).simulate(final_time=1).final("x") == pytest.approx(np.exp(-1), rel=1e-5)
    assert pydfo.build_fmu(folder, out) == out


def test_bad_folders_are_not_packed(tmp_path):
    with pytest.raises(FileNotFoundError):
        pydfo.build_fmu(tmp_path / "none", tmp_path / "out.fmu")
    with pytest.raises(pydfo.FmuError, match="modelDescription.xml"):
        pydfo.build_fmu(tmp_path, tmp_path / "out.fmu")
    folder = tmp_path / "folder"
    shutil.unpack_archive(example_fmu("dahlquist"), folder, format="zip")
    with pytest.raises(FileNotFoundError):
        pydfo.build_fmu(folder, tmp_path / "none" / "out.fmu")
    (folder / "sources" / "model.c").write_text("this is not C")
    with pytest.raises(pydfo.FmuError, match="building"):
        pydfo.build_fmu(folder, tmp_path / "out.fmu")
    assert not (tmp_path / "out.fmu").exists()


@pytest.mark.parametrize("sandbox", [False, True] if sys.platform == "linux" else [False])
def test_workers_build_sources(tmp_path, monkeypatch, sandbox):
    folder = tmp_path / "folder"
    shutil.unpack_archive(example_fmu("dahlquist"), folder, format="zip")
    shutil.rmtree(folder / "binaries")
    source = folder / "sources" / "model.c"
    source.write_text(source.read_text() + f"/* {tmp_path} */\n")  # not in any cache
    path = shutil.make_archive(str(tmp_path / "sources"), "zip", folder)
    monkeypatch.setenv("FMUFIT_CACHE", str(tmp_path / "cache"))
    t = np.linspace(0.0, 2.0, 21)
    try:
        calibration = pydfo.Calibration(
            path,
            data={"time": t, "x": np.exp(-2.0 * t)},
            outputs=["x"],
            parameters=[pydfo.Parameter("k", 1.0, 0.1, 10.0)],
            sandbox=sandbox,
        )
    except pydfo.FmuError as error:
        if sandbox and "Landlock" in str(error):
            pytest.skip("this kernel has no Landlock")
        raise
    fit = calibration.fit(method="de", workers=2, max_evaluations=40, rng=1, disp=False)
    assert fit.stats.accepted_steps > 0 and abs(fit.x[0] - 2.0) < 0.5


def test_sources_are_built_when_needed(tmp_path, monkeypatch):
    folder = tmp_path / "folder"
    shutil.unpack_archive(example_fmu("dahlquist"), folder, format="zip")
    shutil.rmtree(folder / "binaries")
    monkeypatch.setenv("FMUFIT_CACHE", str(tmp_path / "cache"))
    path = shutil.make_archive(str(tmp_path / "sources"), "zip", folder)
    model = FMUModel(path)
    assert model.get("k") == 1.0 and not (tmp_path / "cache").exists()
    assert model.simulate(final_time=1).final("x") == pytest.approx(np.exp(-1), rel=1e-5)
    assert list((tmp_path / "cache" / "libraries").iterdir())
    example = example_fmu("dahlquist")
    assert tmp_path in example.parents
    pydfo.clear_caches()
    assert not list((tmp_path / "cache" / "libraries").iterdir()) and not example.exists()
    # Models in use continue to work, and missing files are created again.
    assert model.simulate(final_time=1).final("x") == pytest.approx(np.exp(-1), rel=1e-5)
    assert example_fmu("dahlquist").is_file()
