"""Counts instructions of an evaluation of a cost by location: in the FMU's library, in libm, and in our source files.

    python benches/instructions.py [--cases furuta,...] [--solvers tsit5,...] [--few 20 --many 120] [--files 25] [--functions 0]
                                   [--compare | --write]

Runs `cargo bench --bench evaluations` under callgrind with two numbers of evaluations. The difference between the
runs, divided by the difference of the numbers, is the cost of an evaluation without opening, loading and the first
runs. Instruction counts hardly depend on the load of the machine. Needs valgrind. `--compare` fails if our counts
exceed those in `benches/instructions.json` by more than 2 %. `--write` stores the counts, which are specific to a
compiler and must be rewritten for another one.
"""

import argparse
import collections
import json
import pathlib
import re
import shutil
import subprocess
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
CASES = ("furuta", "van_der_pol", "van_der_pol_fmi3", "bouncing_ball", "van_der_pol_co_simulation")
SOLVERS = ("tsit5", "dop853", "radau5", "bdf", "auto")
KEPT = ROOT / "benches" / "instructions.json"
#: Relative increase above which a count is a regression.
TOLERANCE = 0.02


def build(target):
    """Builds the bench and returns its path."""
    command = ["cargo", "bench", "-p", "fmufit", "--bench", "evaluations", "--no-run", "--message-format=json"]
    command += ["--target-dir", target] if target else []
    out = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout
    made = [json.loads(line) for line in out.splitlines()]
    return next(m["executable"] for m in made if m.get("target", {}).get("name") == "evaluations" and m.get("executable"))


def read_profile(path, bench):
    """Returns instructions by (object, function, source file); libc calls of the model count as the model."""
    names = collections.defaultdict(dict)
    counts = collections.Counter()
    object_, function, file_of_function, file, callee = "", "", "", "", ""
    is_call = False
    for line in path.read_text(errors="replace").splitlines():
        if match := re.match(r"(c?ob|c?fn|fl|fi|fe|cfi|cfl)=\((\d+)\)(?: (.*))?$", line):
            kind, number, name = match.groups()
            names_by_number = names[kind[-2:] if kind.endswith(("ob", "fn")) else "file"]
            if name is not None:
                names_by_number[number] = name
            name = names_by_number[number]
            if kind == "ob":
                object_ = callee = name
            elif kind == "cob":
                callee = name
            elif kind == "fl":
                file_of_function = file = name
            elif kind in ("fi", "fe"):
                file = name
            elif kind == "fn":
                function = name
        elif line.startswith("calls="):
            is_call = True
        elif re.match(r"[+*\-\d]", line):
            n = int(line.split()[1])
            if not is_call:
                from_std = "/rustc/" in file or "/library/" in file
                counts[object_, function, file_of_function if from_std else file] += n
            elif place(callee, bench) == "libc" and place(object_, bench) == "model":
                counts[object_, function, "libc"] += n
                counts[callee, "called by others", "libc"] -= n
            if is_call:
                callee = object_
            is_call = False
    return counts


def is_libc(object_):
    return re.match(r"(libc\.|ld-|libgcc|vgpreload)", pathlib.Path(object_).name) is not None


def profile(bench, case, solver, evaluations):
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder, "callgrind.out")
        command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={out}", bench, case, solver, str(evaluations)]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        return read_profile(out, bench), done.stdout.strip()


def place(object_, bench):
    if is_libc(object_):
        return "libc"
    return "ours" if object_ == bench else "libm" if pathlib.Path(object_).name.startswith("libm.") else "model"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", default=",".join(CASES))
    parser.add_argument("--solvers", default=",".join(SOLVERS))
    parser.add_argument("--few", type=int, default=20)
    parser.add_argument("--many", type=int, default=120)
    parser.add_argument("--files", type=int, default=0, help="source files of this project")
    parser.add_argument("--functions", type=int, default=0, help="functions of this project")
    parser.add_argument("--target-dir")
    parser.add_argument("--program", help="the bench, if it is built already")
    parser.add_argument("--compare", action="store_true", help=f"with {KEPT.name}")
    parser.add_argument("--write", action="store_true", help=f"{KEPT.name}")
    arguments = parser.parse_args()
    if shutil.which("valgrind") is None:
        print("instructions are not counted: there is no valgrind")
        return
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    missed = []
    bench = arguments.program or build(arguments.target_dir)
    print("Thousands of instructions of an evaluation; what libc does for the model counts there.\n")
    print("| case | solver | model | libm | ours | ours / (model + libm) | cost |\n|---|---|---|---|---|---|---|")
    for case in arguments.cases.split(","):
        for solver in ("tsit5",) if case.endswith("co_simulation") else arguments.solvers.split(","):
            (few, _), (many, cost) = (profile(bench, case, solver, n) for n in (arguments.few, arguments.many))
            share = {k: (n - few[k]) / (arguments.many - arguments.few) for k, n in many.items()}
            where, files, functions = collections.Counter(), collections.Counter(), collections.Counter()
            for (object_, function, file), n in share.items():
                where[place(object_, bench)] += n
                if place(object_, bench) in ("ours", "libc"):
                    files[re.sub(r".*/(crates|rustc|registry/src)/", "", file)] += n
                    functions[function] += n
            where["ours"] += where["libc"]
            name, ours = f"{case} {solver}", round(where["ours"] / 1e3)
            if arguments.compare and ours > (1 + TOLERANCE) * kept.get(name, ours):
                missed.append(f"{name}: {ours} thousand instructions, {kept[name]} were kept")
            kept[name] = ours
            row = " | ".join(f"{where[key] / 1e3:.0f}" for key in ("model", "libm", "ours"))
            ratio = where["ours"] / (where["model"] + where["libm"])
            print(f"| {case} | {solver} | {row} | {ratio:.2f} | {cost} |", flush=True)
            for list_, most in ((files, arguments.files), (functions, arguments.functions)):
                for name, n in list_.most_common(most):
                    print(f"    {n / 1e3:9.1f}  {name[:150]}")
    if arguments.write:
        KEPT.write_text(json.dumps(kept, indent=1) + "\n")
    if missed:
        raise SystemExit("\n".join(missed))


if __name__ == "__main__":
    main()
