"""FMUs in separate processes: bit-for-bit identical results, crashes as failed evaluations, and no leftovers."""

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import zipfile

import numpy as np
import pydfo
import pytest
from fmus import evil, same_bits
from pydfo import Calibration, FMUModel, Parameter

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="faults of an FMU are made for Linux")

TIMES = np.linspace(0, 1, 21)


def decay(fmu, **more):
    """Returns a calibration with y = exp(-1.7 t), which x' = -k x reproduces with k = 1.7."""
    data = {"time": TIMES, "y": np.exp(-1.7 * TIMES)}
    return Calibration(fmu, data, {"y": "y"}, [Parameter("k", 1, 0.1, 5)], **more)


def bits(fit):
    return fit.x.tobytes(), fit.cost, fit.stderr.tobytes(), fit.nfev


def test_results_are_identical_in_all_isolation_modes(tmp_path):
    fmu = evil(tmp_path / "sound.fmu")
    here = decay(fmu, isolation="none")
    for workers in (1, 2, 7):
        assert bits(decay(fmu).fit(batch="serial", workers=workers)) == bits(here.fit(workers=1)), workers
    apart = decay(fmu)
    assert apart.residuals([2.0]).tobytes() == here.residuals([2.0]).tobytes()
    assert same_bits(apart.simulate([2.0]), here.simulate([2.0]))
    one, other = FMUModel(fmu), FMUModel(fmu)
    for model in (one, other):
        model.set("k", 0.5)
    arguments = {"final_time": 2, "start_values": {"x": 3.0}, "outputs": ["x", "y"], "record_events": True}
    assert same_bits(one.simulate(**arguments), other.simulate(isolation="process", **arguments))


#: Faults for k above 2.2, with their messages.
DEATHS = {
    "raise(SIGSEGV)": "segmentation fault in fmi2GetDerivatives",
    "abort()": "abort in fmi2GetDerivatives",
    "exit(3)": r"exit\(3\) in fmi2GetDerivatives",
    "overflow(m->time)": "in fmi2GetDerivatives",
    "close_all()": " in fmi2",
}


@pytest.mark.parametrize("fault", DEATHS)
def test_crash_is_a_failed_evaluation(tmp_path, fault):
    calibration = decay(evil(tmp_path / "deadly.fmu", "FAULT_ABOVE=2.2", f"FAULT={fault}"))
    with pytest.raises(pydfo.SimulationError, match=DEATHS[fault]) as raised:
        calibration.cost([3.0])
    assert "k = 3" in str(raised.value)
    fit = calibration.fit(method="de", max_evaluations=80, rng=1, workers=2)
    assert abs(fit.x[0] - 1.7) < 0.05
    assert fit.nfail > 5
    fit = calibration.fit()
    assert abs(fit.x[0] - 1.7) < 1e-4
    fit.profile()
    fit.validate(windows=[(0.0, 0.5)])
    fit.report(tmp_path / "report.html")
    with pytest.raises(pydfo.SimulationError, match=DEATHS[fault]):
        FMUModel(evil(tmp_path / "again.fmu", "FAULT_ABOVE=2.2", f"FAULT={fault}")).simulate(
            final_time=1, start_values={"k": 3.0}, isolation="process"
        )


def test_hang_ends_soon_after_its_limit(tmp_path):
    fmu = evil(tmp_path / "hangs.fmu", "FAULT_ABOVE=2.2", "FAULT=hang()")
    calibration = decay(fmu, timeout=0.2)
    with pytest.raises(pydfo.SimulationError, match="no answer within the time limit in fmi2GetDerivatives"):
        calibration.cost([3.0])
    fit = calibration.fit(method="de", max_evaluations=30, rng=1, workers=2)
    assert fit.nfail > 0 and abs(fit.x[0] - 1.7) < 0.3
    # Without a separate limit, the hang ends with the limit of the fit.
    fit = decay(fmu).fit(method="de", max_time=2.0, rng=1, workers=2)
    assert "time" in fit.message and np.isfinite(fit.cost)


def test_unsupported_model_raises_fmu_error(tmp_path):
    foreign = tmp_path / "foreign.fmu"
    with zipfile.ZipFile(evil(tmp_path / "sound.fmu")) as source, zipfile.ZipFile(foreign, "w") as out:
        out.writestr("modelDescription.xml", re.sub(r"<SourceFiles>.*</SourceFiles>", "", source.read("modelDescription.xml").decode(), flags=re.S))
        out.writestr("binaries/win64/model.dll", b"not for this platform")
    for isolation in ("process", "none"):
        with pytest.raises(pydfo.FmuError, match="no binary for this platform.*win64"):
            decay(foreign, isolation=isolation).fit(workers=2)


def test_ctrl_c_ends_hanging_fmu(tmp_path):
    calibration = decay(evil(tmp_path / "hangs.fmu", "FAULT_ABOVE=0", "FAULT=hang()"))
    threading.Timer(0.5, os.kill, (os.getpid(), 2)).start()
    with pytest.raises(pydfo.Interrupted):
        calibration.cost([1.0])
    model = FMUModel(evil(tmp_path / "hangs_at_start.fmu", "AT_INITIALIZE=for (;;) {}"))
    threading.Timer(0.5, os.kill, (os.getpid(), 2)).start()
    with pytest.raises(pydfo.Interrupted):
        model.get("y")


def children():
    """Returns the ids of the running child processes of this process."""
    found = []
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{name}/stat") as file:
                fields = file.read().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == os.getpid() and fields[0] != "Z":
            found.append(int(name))
    return found


def test_calibration_leaves_no_processes_or_files(tmp_path, monkeypatch):
    folder = tmp_path / "temporary"
    folder.mkdir()
    fmu = evil(tmp_path / "sound.fmu")
    before = set(children())
    monkeypatch.setenv("TMPDIR", str(folder))
    calibration = decay(fmu)
    calibration.fit(workers=2)
    del calibration
    end = time.monotonic() + 5
    while set(children()) - before and time.monotonic() < end:
        time.sleep(0.02)
    assert not set(children()) - before
    assert not [name for name in os.listdir(folder) if name.startswith("fmufit-worker")]


def test_unused_calibration_leaves_no_processes(tmp_path):
    before = set(children())
    (tmp_path / "broken.fmu").write_bytes(b"PK\x03\x04")
    for path in ("none.fmu", "broken.fmu"):
        with pytest.raises((OSError, pydfo.FmuError)):
            decay(tmp_path / path)
    calibration = decay(evil(tmp_path / "sound.fmu"))
    assert set(children()) - before
    del calibration
    assert not set(children()) - before


def test_state_reset_only_by_new_process_is_detected(tmp_path):
    # The value of k at the first run of a process is kept.
    fmu = evil(tmp_path / "remembers.fmu", "SHARED_GLOBALS", "REMEMBERS=1.2")
    calibration = decay(fmu)
    fit = calibration.fit(workers=1)
    again = decay(fmu).cost(fit.x)
    assert again == fit.cost


def test_state_detected_by_simulations_is_a_quirk(tmp_path, caplog):
    model = FMUModel(evil(tmp_path / "remembers.fmu", "SHARED_GLOBALS", "REMEMBERS=1.2"))
    with caplog.at_level("WARNING", "pydfo"):
        for k in (1.0, 1.5, 2.0, 1.0, 1.5):
            model.simulate(final_time=1, start_values={"k": k})
    assert [quirk.kind for quirk in model.description.quirks] == ["promise", "hidden-state"]
    assert sum("outside of its instances" in message for message in caplog.messages) == 1


def test_new_process_after_crash_is_logged_once(tmp_path, caplog):
    model = FMUModel(evil(tmp_path / "deadly.fmu", "FAULT_ABOVE=2.2", "FAULT=abort()"))
    model.set("x", 3.0)
    with caplog.at_level("WARNING", "pydfo"):
        for _ in range(2):
            with pytest.raises(pydfo.SimulationError, match="abort in fmi2GetDerivatives"):
                model.simulate(final_time=1, start_values={"k": 3.0})
            assert model.simulate(final_time=1).final("x") == pytest.approx(3 * np.exp(-1), rel=1e-5)
    assert sum("a new process is started with the same values" in message for message in caplog.messages) == 1


def test_missing_temporary_folder_is_named(tmp_path, monkeypatch):
    model = FMUModel(evil(tmp_path / "sound.fmu"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "missing"))
    with pytest.raises(pydfo.FmuError, match=r"TMPDIR: cannot create the folder .*missing.*No such file") as info:
        model.simulate(final_time=1)
    assert sys.executable not in str(info.value)


def test_embedding_program_finds_interpreter_or_warns(tmp_path):
    script = tmp_path / "fit.py"
    script.write_text(
        "import sys, warnings\n"
        "sys.executable = '/bin/false'\n"
        "if sys.argv[1] == 'none':\n"
        "    sys._base_executable = sys.exec_prefix = sys.base_exec_prefix = '/nonexistent'\n"
        "import numpy as np, pydfo\n"
        "t = np.linspace(0, 1, 11)\n"
        "with warnings.catch_warnings(record=True) as caught:\n"
        "    warnings.simplefilter('always')\n"
        "    c = pydfo.Calibration(pydfo.example_fmu('dahlquist'), {'time': t, 'x': np.exp(-t)}, ['x'], [pydfo.Parameter('k', 2, 0.1, 5)])\n"
        "print(round(c.fit().x[0], 6), *(str(w.message) for w in caught))\n"
    )
    for case, expected in (("one", "1.0\n"), ("none", "1.0 the FMU runs in this process")):
        done = subprocess.run([sys.executable, script, case], capture_output=True, text=True, check=True)
        assert done.stdout.startswith(expected), done.stdout


FIT = """
import sys, numpy as np, pydfo
t = np.linspace(0, 1, 11)
data = {'time': t, 'y': np.exp(-1.7 * t)}
print(round(pydfo.Calibration(sys.argv[1], data, {'y': 'y'}, [pydfo.Parameter('k', 1, 0.1, 5)]).fit().x[0], 4))
"""


def fitted(fmu, **environment):
    """Returns the output of a program that fits in this environment."""
    command = [sys.executable, "-c", FIT, str(fmu)]
    return subprocess.run(command, capture_output=True, text=True, env={**os.environ, **environment}, check=True).stdout


def test_programs_started_by_fmu_inherit_the_environment(tmp_path):
    fmu = evil(tmp_path / "starts.fmu", "FAULT_ABOVE=0", f'FAULT=(void)!system("env > {tmp_path}/environment")')
    library = next(name for name in ("/lib/x86_64-linux-gnu/libm.so.6", "/lib64/libm.so.6", "/lib/libm.so.6", "") if os.path.exists(name) or not name)
    for before in {"", library}:
        assert fitted(fmu, LD_PRELOAD=before) == "1.7\n"
        found = dict(line.split("=", 1) for line in (tmp_path / "environment").read_text().splitlines() if "=" in line)
        assert found.get("LD_PRELOAD", "") == before
        assert "FMUFIT_WORKER_PRELOADED_BEFORE" not in found


def test_module_that_cannot_be_preloaded_is_imported(tmp_path):
    # The dynamic linker uses spaces as separators of names.
    place = tmp_path / "with a space"
    shutil.copytree(os.path.dirname(pydfo.__file__), place / "pydfo")
    assert fitted(evil(tmp_path / "sound.fmu"), PYTHONPATH=str(place)) == "1.7\n"


def test_isolation_arguments_are_validated(tmp_path):
    fmu = evil(tmp_path / "sound.fmu")
    for wrong in ({"isolation": "thread"}, {"memory_limit": 0}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            decay(fmu, **wrong)
    with pytest.raises(ValueError, match="isolation"):
        FMUModel(fmu).simulate(final_time=1, isolation="thread")


def has_sandbox(tmp_path):
    """Returns True if the kernel can confine a process; otherwise checks that the error states the reason."""
    try:
        decay(evil(tmp_path / "probe.fmu"), sandbox=True)
    except pydfo.FmuError as error:
        assert "Landlock" in str(error) or "does not include the sandbox" in str(error)
        return False
    return True


def test_sandbox_confines_simulations_and_fits(tmp_path):
    if not has_sandbox(tmp_path):
        pytest.skip("needs Landlock")
    outside, inside = tmp_path / "outside", tmp_path / "readable"
    inside.write_text("kept")
    # The working folder can be read. Writing to another folder and opening a socket fail.
    fault = f'if (fopen("{outside}", "w") || socket(AF_INET, SOCK_DGRAM, 0) >= 0 || !fopen("{inside}", "r") || fopen("{inside}", "a")) exit(7)'
    fmu = evil(tmp_path / "writes.fmu", "FAULT_ABOVE=2.2", f"FAULT={fault}")
    sound, model = FMUModel(evil(tmp_path / "sound.fmu")), FMUModel(fmu)
    arguments = {"final_time": 1, "start_values": {"k": 3.0}}
    with pytest.raises(pydfo.SimulationError, match=r"exit\(7\)"):
        model.simulate(isolation="process", **arguments)
    assert outside.exists()
    outside.unlink()
    for more in ({}, {"isolation": "process"}):
        assert same_bits(model.simulate(sandbox=True, **more, **arguments), sound.simulate(**arguments))
    assert decay(fmu, sandbox=True).cost([3.0]) == decay(tmp_path / "sound.fmu").cost([3.0])
    assert not outside.exists() and inside.read_text() == "kept"
    # A process with a sandbox does not simulate the model without a sandbox.
    with pytest.raises(pydfo.SimulationError, match=r"exit\(7\)"):
        model.simulate(isolation="process", **arguments)


def test_sandbox_without_isolation_is_an_error(tmp_path):
    fmu = evil(tmp_path / "sound.fmu")
    with pytest.raises(ValueError if has_sandbox(tmp_path) else pydfo.FmuError, match="sandbox"):
        decay(fmu, sandbox=True, isolation="none")
    with pytest.raises(ValueError, match="sandbox"):
        FMUModel(fmu).simulate(final_time=1, sandbox=True, isolation="none")


def test_input_function_gives_identical_results_in_a_process(tmp_path):
    fmu = pydfo.example_fmu("switched_input")
    variables = FMUModel(fmu).description.variables
    output = next(name for name, variable in variables.items() if variable.causality == "output")
    inputs = {"u": lambda t: np.sin(3 * t)}
    places = [{"isolation": "none"}, {}] + [{"sandbox": True}] * has_sandbox(tmp_path)
    model = FMUModel(fmu)
    runs = [model.simulate(final_time=1, inputs=inputs, **place) for place in places]
    assert len({run[output].tobytes() for run in runs}) == 1

    parameter = next(name for name, variable in variables.items() if variable.causality == "parameter")
    data = {"time": runs[0].time, output: runs[0][output] + 0.1 * np.cos(runs[0].time)}
    fits = [
        Calibration(fmu, data, [output], [Parameter(parameter, 1, 0.1, 5)], inputs=inputs, **place).fit(
            max_evaluations=30, batch="serial", workers=workers
        )
        for place in places
        for workers in (1, 2)
    ]
    assert len({fit.x.tobytes() for fit in fits}) == 1


def test_input_function_exception_ends_the_simulation(tmp_path):
    fmu = pydfo.example_fmu("switched_input")
    model = FMUModel(fmu)

    def failing(t):
        if t > 0.5:
            raise RuntimeError("no value")
        return t

    with pytest.raises(RuntimeError, match="no value"):
        model.simulate(final_time=1, inputs={"u": failing})
    assert model.simulate(final_time=1, inputs={"u": lambda t: t}).time[-1] == 1


def test_input_function_is_called_by_one_simulation_at_a_time():
    model = FMUModel(pydfo.example_fmu("quad_tank"))

    def driven():
        """Returns a function that counts its calls, and must be called by the simulating thread."""
        calls = []

        def pump(t):
            assert lock.acquire(timeout=5)
            lock.release()
            calls.append(t)
            return 5 + 1e-3 * len(calls)

        return {"u1": pump, "u2": 5.0}

    lock = threading.RLock()
    with lock:
        runs = [model.simulate(final_time=1, inputs=driven(), max_step=0.1).final("qt.x1") for _ in range(9)]
    assert len(set(runs)) == 1
    assert model.get("qt.x1") == runs[0]


def test_values_come_from_last_complete_simulation():
    model = FMUModel(pydfo.example_fmu("dahlquist"))
    end = model.simulate(final_time=1).final("x")
    for wrong in ({"final_time": -1}, {"final_time": 1, "solver": "none"}, {"final_time": 1, "start_values": {"k": np.nan}}):
        with pytest.raises((ValueError, pydfo.SimulationError)):
            model.simulate(**wrong)
    assert model.get("x") == end
    tank = FMUModel(pydfo.example_fmu("quad_tank"))
    start = tank.get("qt.x1")

    def interrupting(t):
        os.kill(os.getpid(), signal.SIGINT)
        return 5.0

    with pytest.raises(KeyboardInterrupt):
        tank.simulate(final_time=100, inputs={"u1": interrupting, "u2": 5.0})
    assert tank.get("qt.x1") == start


HOLDS_LOCK = """
import fcntl, sys
with open(sys.argv[1], "r+") as lock:
    fcntl.lockf(lock, fcntl.LOCK_EX)
    print("locked", flush=True)
    sys.stdin.read()
"""


def test_checkpoint_is_locked_by_one_process(tmp_path):
    place, lock = tmp_path / "run.checkpoint", tmp_path / "run.checkpoint.lock"
    lock.write_text("4711")
    with subprocess.Popen([sys.executable, "-c", HOLDS_LOCK, lock], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as owner:
        assert owner.stdout.readline() == b"locked\n"
        with pytest.raises(pydfo.CheckpointError, match="process 4711 is writing to it"):
            pydfo.minimize(lambda x: x[0] ** 2, [1.0], checkpoint=place, resume="never")
        owner.kill()
    pydfo.minimize(lambda x: x[0] ** 2, [1.0], checkpoint=place, resume="never")
