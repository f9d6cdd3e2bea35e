"""Rejects forbidden content in library code.

It reports unfinished work, unchecked unwraps, unsafe outside `sys`, imports from higher layers, doc comments wider
than the line, tests that are never compiled, and names of deleted files.

It reads every Rust source below crates/*/src and src. Test modules (from `#[cfg(test)]` to the end of the file) may
unwrap. `unsafe` is allowed only in crates/fmi/src/sys. A file in a folder tests/all is compiled only if its main.rs
lists it.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import layers
import rewrap

ROOT = Path(__file__).resolve().parent.parent
UNSAFE_FOLDER = ROOT / "crates" / "fmi" / "src" / "sys"
FORBIDDEN = {
    "unfinished": re.compile(r"\b(todo|unimplemented)!"),
    "unwrap outside tests": re.compile(r"\.unwrap\(\)|\.expect\("),
    "printing or debugging": re.compile(r"\b(dbg|println|eprintln|print|eprint)!"),
}
# Excludes keywords of a Content-Security-Policy.
UNSAFE = re.compile(r"\bunsafe\b(?!-)")


def code_lines(text: str) -> list[tuple[int, str]]:
    """Returns numbered lines outside comments and outside the test module at the end."""
    lines: list[tuple[int, str]] = []
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip().startswith("#[cfg(test)]"):
            break
        stripped = line.lstrip()
        if stripped.startswith("//"):
            continue
        lines.append((number, re.sub(r"\s//.*$", "", line)))
    return lines


def findings(path: Path) -> list[str]:
    """Returns the findings in one file."""
    found = []
    for number, line in code_lines(path.read_text(encoding="utf-8")):
        where = f"{path.relative_to(ROOT)}:{number}"
        for what, pattern in FORBIDDEN.items():
            if pattern.search(line):
                found.append(f"{where}: {what}: {line.strip()}")
        if UNSAFE.search(line) and "unsafe_" not in line and UNSAFE_FOLDER not in path.parents:
            found.append(f"{where}: unsafe outside {UNSAFE_FOLDER.relative_to(ROOT)}: {line.strip()}")
    return found


def tests_left_out() -> list[str]:
    """Returns the files of tests/all that main.rs does not name."""
    found = []
    for main in [ROOT / "tests" / "all" / "main.rs", *ROOT.glob("crates/*/tests/all/main.rs")]:
        named = re.findall(r"^mod (\w+);", main.read_text(encoding="utf-8"), re.M)
        files = sorted(path for path in main.parent.glob("*.rs") if path != main and path.stem not in named)
        found += [f"{path.relative_to(ROOT)}: not named in main.rs" for path in files]
    return found


NAMED_FILE = re.compile(r"`((?:[\w.-]+/)*[\w-]+\.(?:rs|py))(?: [^`]*)?`")


def files_that_are_gone() -> list[str]:
    """Returns sources that comments and pages name but that do not exist."""
    there = [path for path in ROOT.rglob("*") if path.suffix in (".rs", ".py") and not {"target", ".venv"} & set(path.parts)]
    endings_present = {end for path in there for end in endings(path.relative_to(ROOT).parts)}
    found = []
    for path in [*ROOT.glob("crates/*/*/**/*.rs"), *ROOT.glob("docs/*.md"), ROOT / "CONTRIBUTING.md", ROOT / "README.md"]:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if path.suffix == ".md" or line.lstrip().startswith("//"):
                gone = [name for name in NAMED_FILE.findall(line) if name not in endings_present]
                found += [f"{path.relative_to(ROOT)}:{number}: file {name} does not exist" for name in gone]
    return found


def endings(parts: tuple[str, ...]) -> list[str]:
    """Returns the suffixes of a path, starting at each of its folders."""
    return ["/".join(parts[k:]) for k in range(len(parts))]


def main() -> int:
    """Prints every finding; the exit status is 1 if there are any."""
    sources = sorted([*ROOT.glob("src/**/*.rs"), *ROOT.glob("crates/*/src/**/*.rs")])
    found = [line for path in sources for line in findings(path)] + layers.findings()
    found += tests_left_out() + rewrap.findings() + files_that_are_gone()
    print("\n".join(found) if found else f"gate: {len(sources)} files are clean")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
