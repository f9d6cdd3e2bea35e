"""Checks the imports between modules of a crate: no cycles, and imports only from lower layers.

The layers at the top of each crate are listed once, here. Inside a folder there are no cycles among the files. None
of them imports from the `mod.rs` of the folder, which imports them.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# The modules at the top of each crate, lowest layers first. Each line is a layer; modules of a layer do not import
# each other.
LAYERS = {
    "calibration": """
        error expression findings
        data
        problem
        cost
        loaded
        check uncertainty
        fit
        intervals sensitivity validation
        report export
        design jobs live_page
    """,
    "dfo": """
        values
        outcome
        error
        problem
        method_interface
        evaluation methods sampler
        run
        sensitivity
    """,
    "fmi": """
        macros
        value
        error
        cancel_request fair_lock log platform
        archive
        description
        sys
        source worker
        libraries open_options
        fmu
        fmu_cache instance
        simulation
        simulators write_start_values
        session driven_instance
    """,
    "fmufit-cli": """
        error
        arguments console interrupt output_paths
        problem
        commands
    """,
    "ode": """
        sparsity stats stages stopwatch tableau times
        system options error
        error_norm event lu observer
        sampling step_size stepper
        explicit_rk jacobian
        implicit
        auto
        driver
        solve
    """,
    "pydfo": """
        command_line interrupt
        convert
        optimize model
        ode calibration
    """,
}

Module = tuple[str, ...]
PATH = re.compile(r"\b(?:crate|super|self)(?:::[A-Za-z_]\w*)+")
TESTS = re.compile(r"^(?:#\[.*\]\n)+mod tests", re.M)
USE = re.compile(r"^\s*(?:pub(?:\([^)]*\))? )?use ([^;]+);", re.S | re.M)


def code(path: Path) -> str:
    """Returns the source without comments, the scopes of `pub(in ...)`, and the test module at its end."""
    text = TESTS.split(path.read_text(encoding="utf-8"), maxsplit=1)[0].replace("pub(in crate::", "pub(")
    return re.sub(r"(^|\s)//.*$", "", text, flags=re.M)


def expand(tree: str) -> Iterator[str]:
    """Yields the paths of one `use`: `a::{b, c::d}` gives `a::b` and `a::c::d`."""
    head, brace, rest = tree.partition("{")
    if not brace:
        yield tree
        return
    depth, part = 0, ""
    for character in rest[: rest.rindex("}")] + ",":
        depth += (character == "{") - (character == "}")
        if character == "," and depth == 0:
            if part:
                yield from (head + end for end in expand(part))
            part = ""
        else:
            part += character


class Crate:
    """The modules of a crate with their imports."""

    def __init__(self, source: Path) -> None:
        self.files: dict[Module, Path] = {}
        for path in source.rglob("*.rs"):
            parts = path.relative_to(source).with_suffix("").parts
            if parts[0] == "bin":
                # A separate crate.
                continue
            self.files[parts[:-1] if parts[-1] in ("mod", "lib") else parts] = path
        self.code = {module: code(path) for module, path in self.files.items()}
        self.names = {module: dict(self.reexports(module)) for module in self.files}
        self.imports = {module: set(self.imported(module)) - {module} for module in self.files}

    def reexports(self, module: Module) -> Iterator[tuple[str, Module]]:
        """Yields the names that a module re-exports, with their origins."""
        for use in re.finditer(r"pub(?:\([^)]*\))? use ([^;]+);", self.code[module]):
            for path in expand(re.sub(r"\s+", "", use[1].replace(" as ", "@"))):
                origin, _, name = path.partition("@")
                yield name or origin.split("::")[-1], self.absolute(origin, module)

    def absolute(self, path: str, module: Module) -> Module:
        """Converts a path as written in a module to a path from the root of the crate."""
        first, *rest = path.split("::")
        if first == "crate":
            return tuple(rest)
        while first == "super":
            module, first, rest = module[:-1], (rest or [""])[0], rest[1:]
        return (*module, *rest) if first == "self" else (*module, first, *rest)

    def module_of(self, path: Module, depth: int = 0) -> Module:
        """Returns the module that defines the item of a path."""
        for end in range(len(path) + 1):
            if path[:end] not in self.files:
                break
        else:
            return path
        module, rest = path[: end - 1], path[end - 1 :]
        origin = self.names[module].get(rest[0])
        if origin is None or origin == path or depth > 8:
            return module
        return self.module_of((*origin, *rest[1:]), depth + 1)

    def imported(self, module: Module) -> Iterator[Module]:
        """Yields the modules of the crate that a module uses."""
        text = self.code[module]
        uses = [p for use in USE.finditer(text) for p in expand(re.sub(r"\s+as\s+\w+|\s+", "", use[1]))]
        for path in [*uses, *PATH.findall(USE.sub("", text))]:
            first = path.split("::")[0]
            if first in ("crate", "super", "self") or (*module, first) in self.files:
                yield self.module_of(self.absolute(path, module))

    def within(self, folder: Module) -> dict[str, set[str]]:
        """Returns the imports among the parts of a folder; the `mod.rs` of the folder is the part "mod.rs"."""
        depth = len(folder)
        graph: dict[str, set[str]] = defaultdict(set)
        for module, imports in self.imports.items():
            if module[:depth] == folder and module != folder:
                seen = (m for m in imports if m[:depth] == folder)
                graph[module[depth]] |= {m[depth] if len(m) > depth else "mod.rs" for m in seen} - {module[depth]}
        return graph


def cycles(graph: dict[str, set[str]]) -> list[str]:
    """Returns the parts that are on a cycle."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        todo = list(graph.get(start, ()))
        while todo:
            part = todo.pop()
            if part not in seen:
                seen.add(part)
                todo += graph.get(part, ())
        return seen

    return sorted(part for part in graph if part in reached(part))


def findings(crates: Iterable[str] = LAYERS) -> list[str]:
    """Returns the findings in the layers of these crates."""
    found = []
    for name in crates:
        crate = Crate(ROOT / "crates" / name / "src")
        rank = {m: number for number, line in enumerate(LAYERS[name].strip().splitlines()) for m in line.split()}
        top = crate.within(())
        for module, imports in sorted(top.items()):
            if module not in rank:
                found.append(f"{name}: module {module} is missing in tools/layers.py")
            for other in sorted(imports - {"mod.rs"}):
                if module in rank and rank.get(other, -1) >= rank[module]:
                    found.append(f"{name}: {module} imports from {other}, which is not in a lower layer")
        folders = {module[:depth] for module in crate.files for depth in range(1, len(module))}
        for folder in sorted(folders):
            graph = crate.within(folder)
            where = "/".join((name, *folder))
            upward = sorted(part for part, imports in graph.items() if "mod.rs" in imports)
            found += [f"{where}: {part} imports from mod.rs, which depends on it" for part in upward]
            if ring := cycles(graph):
                found.append(f"{where}: {', '.join(ring)} form an import cycle")
    return found
