"""Runs every code block of README and docs/, and compares the printed output with the page.

The blocks of a page share their variables and a folder with the files that docs/example_files.py writes. The language of a block decides:

- ``python`` is executed; ``pycon`` is executed and compared like a doctest, in which ``...`` matches any text;
- ``console``: the lines after ``$`` are executed by a shell in which ``fmufit`` is the command line of this module. The output is
  compared in the same way. Only a block that shows ``error:`` may fail;
- ``toml`` and ``python`` with ``title="NAME"`` are first written to the folder;
- blocks without a language, and ``text``, ``rust`` and ``sh``, are not executed here. Rust blocks are doctests of Rust; ``sh`` blocks
  change the machine.

If a block imports a package that is not installed, this block and the following ones are skipped with a message.
"""

from __future__ import annotations

import contextlib
import doctest
import io
import json
import os
import re
import runpy
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the pages contain commands for a shell of Unix")

ROOT = Path(__file__).resolve().parents[3]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "crates" / "pydfo" / "README.md", *sorted(DOCS.rglob("*.md"))]
NOTEBOOKS = sorted(DOCS.rglob("*.ipynb"))
SETUPS = sorted((DOCS / "setups").glob("*.py"))
FENCE = re.compile(r"^```(?P<info>[^\n]*)\n(?P<code>.*?)^```$", re.M | re.S)
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
#: Languages that are not executed here.
AT_REST = {"", "text", "rust", "sh", "toml"}
#: Packages that a block may need and a machine may lack.
OPTIONAL = {"ray", "dask", "mpi4py", "joblib", "pandas", "scipy", "matplotlib", "xarray", "polars", "fmpy", "h5py", "openpyxl", "pyarrow"}


def blocks(page: Path) -> list[tuple[str, str, str, int]]:
    """Language, file name, code and first line of each block of a page."""
    text = page.read_text(encoding="utf-8")
    found = []
    for fence in FENCE.finditer(text):
        language, _, rest = fence["info"].partition(" ")
        title = re.search(r'title="([^"]+)"', rest)
        found.append((language, title[1] if title else "", fence["code"], text.count("\n", 0, fence.start()) + 2))
    return found


@pytest.fixture(scope="module")
def example_files() -> dict[str, bytes]:
    """Contents of the files that docs/example_files.py writes, by name."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        runpy.run_path(str(DOCS / "example_files.py"))["write"](folder)
        return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


@pytest.fixture
def folder(tmp_path, example_files, monkeypatch):
    """A folder with the example files and the command line, in which the blocks run."""
    for name, content in example_files.items():
        (tmp_path / name).write_bytes(content)
    commands = tmp_path / ".bin"
    commands.mkdir()
    for command, arguments in (("fmufit", "-m pydfo"), ("python", "")):
        (commands / command).write_text(f'#!/bin/sh\nexec "{sys.executable}" {arguments} "$@"\n', encoding="utf-8")
        (commands / command).chmod(0o755)
    monkeypatch.setenv("PATH", f"{commands}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.chdir(tmp_path)
    # Pages import the setups, which read files of the working folder.
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for setup in SETUPS:
        sys.modules.pop(setup.stem, None)


def executed(code: str, names: dict[str, object], place: str, line: int) -> None:
    """Runs a block of Python; its line numbers are the line numbers of the page."""
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(compile("\n" * (line - 1) + code, place, "exec"), names)


def compared(code: str, names: dict[str, object], place: str, line: int) -> None:
    """Runs a session and compares what it prints."""
    session = doctest.DocTestParser().get_doctest(code, names, place, place, line - 1)
    output = io.StringIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = doctest.DocTestRunner(optionflags=OPTIONS).run(session, out=output.write, clear_globs=False)
    # The runner works on the dict of the session, a copy.
    names.update(session.globs)
    assert result.failed == 0, output.getvalue()


def run_commands(code: str, place: str) -> None:
    """Runs the commands of a block and compares what they print with what it shows."""
    for step in re.split(r"^\$ ", code, flags=re.M)[1:]:
        command, _, shown = step.partition("\n")
        while command.endswith("\\"):
            more, _, shown = shown.partition("\n")
            command = command[:-1] + more.strip()
        done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False, timeout=120)
        output = done.stdout + done.stderr
        assert (done.returncode == 0) or "error:" in shown, f"{place}: {command}: {done.returncode}\n{output}"
        if shown.strip():
            assert doctest.OutputChecker().check_output(shown, output, OPTIONS), f"{place}: {command}: printed\n{output}\nnot\n{shown}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_blocks_run(page: Path, folder: Path) -> None:
    name = str(page.relative_to(ROOT))
    names: dict[str, object] = {"__name__": "__main__"}
    for language, title, code, line in blocks(page):
        place = f"{name}, line {line}"
        assert language in {*AT_REST, "python", "pycon", "console"}, f"{place}: nothing is known of blocks in {language!r}"
        if title:
            (folder / title).write_text(code, encoding="utf-8")
        if title.endswith(".py") or language in AT_REST:
            continue
        try:
            if language == "python":
                executed(code, names, place, line)
            elif language == "pycon":
                compared(code, names, place, line)
            else:
                run_commands(code, place)
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] not in OPTIONAL:
                raise
            pytest.skip(f"{place} and what follows it: {error.name} is not installed")


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.name)
def test_notebooks_run(notebook: Path, folder: Path) -> None:
    pytest.importorskip("matplotlib")
    names: dict[str, object] = {"__name__": "__main__"}
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    assert any(cell["cell_type"] == "code" for cell in cells)
    for index, cell in enumerate(cells):
        if cell["cell_type"] == "code":
            # Lines that begin with % are commands for notebooks only.
            code = "".join(line for line in cell["source"] if not line.startswith("%"))
            executed(code, names, f"{notebook.name}, cell {index}", 1)


def test_pictures_are_drawn(folder: Path) -> None:
    pytest.importorskip("matplotlib")
    drawn = runpy.run_path(str(DOCS / "pictures.py"))["write"](folder / "pictures")
    assert sorted(path.name for path in drawn) == sorted(path.name for path in (DOCS / "pictures").iterdir())


def test_every_page_is_in_the_menu() -> None:
    menu = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    missing = [str(page.relative_to(DOCS)) for page in (*PAGES[2:], *NOTEBOOKS) if str(page.relative_to(DOCS)) not in menu]
    assert not missing


def test_first_fit_shows_the_setup_of_the_other_pages() -> None:
    page = (DOCS / "first-fit.md").read_text(encoding="utf-8")
    setup = (DOCS / "setups" / "pendulum.py").read_text(encoding="utf-8").partition("import pydfo\n\n")[2]
    assert setup in page


GUIDES = [page for page in sorted(DOCS.glob("*.md")) if page.name != "index.md"]


@pytest.mark.parametrize("page", GUIDES, ids=lambda page: page.name)
def test_guide_begins_with_its_purpose(page: Path) -> None:
    title, _, text = page.read_text(encoding="utf-8").partition("\n\n")
    assert title.startswith("# ")
    assert re.match(r"This page (explains|lists|shows) ", text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(page: Path) -> None:
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        path, _, anchor = link.partition("#")
        if "://" in link:
            continue
        target = (page.parent / path) if path else page
        assert target.exists(), link
        if anchor:
            assert anchor in headings(target), link


def headings(page: Path) -> set[str]:
    """Anchors of the headings of a page."""
    titles = re.findall(r"^#+ (.+)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.M)
    return {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", title).strip().lower()) for title in titles}
