"""Adds content outside docs/ to the site: pages at the root of the project, files linked from pages, notebooks.

As a hook of MkDocs (mkdocs.yml), it

- adds CHANGELOG.md, SECURITY.md, CONTRIBUTING.md and CODE_OF_CONDUCT.md as pages of the folder project/,
- copies each other linked file of the project into files/, and changes the link,
- converts notebooks to pages with their text, code and stored output.

As a program, `python tools/doc_site.py target/site`, it rejects a site with dead links or with links that load from a
network.
"""

from __future__ import annotations

import base64
import json
import os
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = ("CHANGELOG.md", "SECURITY.md", "CONTRIBUTING.md", "CODE_OF_CONDUCT.md")
LINK = re.compile(r"(\]\()([^)#\s]+)((?:#[^)\s]*)?\))")


def on_files(files: Any, config: Any) -> Any:
    """Adds pages and linked files, and converts notebooks to pages."""
    from mkdocs.structure.files import File

    for name in PAGES:
        files.append(File.generated(config, f"project/{name}", abs_src_path=str(ROOT / name)))
    for notebook in [file for file in files if file.src_uri.endswith(".ipynb")]:
        cells, pictures = page_of(Path(notebook.abs_src_path))
        files.remove(notebook)
        files.append(File.generated(config, notebook.src_uri + ".md", content=cells))
        for name, content in pictures.items():
            files.append(File.generated(config, str(Path(notebook.src_uri).parent / name), content=content))
    linked = {path for page in [*DOCS.rglob("*.md"), *(ROOT / name for name in PAGES)] for path in outside(page)}
    for path in sorted(linked):
        files.append(File.generated(config, f"files/{path.relative_to(ROOT)}", abs_src_path=str(path)))
    return files


def on_config(config: Any) -> Any:
    """Names the pages of notebooks in the menu as `on_files` does."""

    def renamed(entry: Any) -> Any:
        if isinstance(entry, list):
            return [renamed(one) for one in entry]
        if isinstance(entry, dict):
            return {name: renamed(one) for name, one in entry.items()}
        return f"{entry}.md" if entry.endswith(".ipynb") else entry

    config.nav = renamed(config.nav)
    return config


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Changes links to files of the project to their paths in the site."""
    source = Path(page.file.src_uri)
    if source.suffixes == [".ipynb", ".md"]:
        folder = DOCS / source.parent
    else:
        folder = ROOT if source.parts[0] == "project" else (DOCS / source).parent

    def turned(link: re.Match[str]) -> str:
        place = target(folder, link[2])
        if place is None:
            return link[0]
        there = place_in_site(place)
        return f"{link[1]}{os.path.relpath(there, source.parent)}{link[3]}"

    return LINK.sub(turned, markdown)


def target(folder: Path, link: str) -> Path | None:
    """Returns the file of the project to which a link of a page in a folder points; None if there is none."""
    if "://" in link or link.startswith("mailto:"):
        return None
    path = Path(os.path.normpath(folder / link))
    return path if path.exists() and ROOT in path.parents else None


def place_in_site(path: Path) -> Path:
    """Returns the path of a project file in the site: pages by their sources, other files below files/."""
    if path.parent == ROOT and path.name in PAGES:
        return Path("project") / path.name
    if DOCS in path.parents:
        inside = path.relative_to(DOCS)
        return inside.with_name(f"{inside.name}.md") if inside.suffix == ".ipynb" else inside
    return Path("files") / path.relative_to(ROOT)


def outside(page: Path) -> set[Path]:
    """Returns the linked files of a page that are not pages."""
    found = {target(page.parent, link[2]) for link in LINK.finditer(page.read_text(encoding="utf-8"))}
    return {path for path in found if path is not None and path.is_file() and place_in_site(path).parts[0] == "files"}


def page_of(notebook: Path) -> tuple[str, dict[str, bytes]]:
    """Returns a notebook as Markdown, and its pictures by name."""
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"]).strip()
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                name = f"{notebook.stem}-{len(pictures) + 1}.png"
                pictures[name] = base64.b64decode("".join(data["image/png"]))
                parts.append(f"![plot of this cell]({name})")
            elif plain := "".join(data.get("text/plain", output.get("text", []))).strip():
                parts.append(f"```text\n{plain}\n```")
    return "\n\n".join(parts), pictures


class Links(HTMLParser):
    """The links and anchors of a page, and the resources that it loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = {name: value for name, value in attributes if value}
        self.anchors |= {found[name] for name in ("id", "name") if name in found}
        if tag in ("script", "img", "iframe", "source") and "src" in found:
            self.loaded.append(found["src"])
        elif tag == "link" and found.get("rel") in ("stylesheet", "icon", "preload", "preconnect"):
            self.loaded.append(found.get("href", ""))
        elif tag == "a" and "href" in found:
            self.links.append(found["href"])


def dead_links(site: Path) -> list[str]:
    """Returns the errors in the links of a site. Pages of rustdoc are not checked."""
    pages = {path: Links(path.read_text(encoding="utf-8")) for path in site.rglob("*.html") if (site / "rust") not in path.parents}
    found = []
    for page, seen in pages.items():
        name = page.relative_to(site)
        found += [f"{name}: loads {url} from the network" for url in seen.loaded if urlsplit(url).netloc]
        if name.name == "404.html":
            continue
        for url in [*seen.links, *seen.loaded]:
            parts = urlsplit(url)
            if parts.scheme or parts.netloc:
                continue
            place = Path(os.path.normpath(page.parent / unquote(parts.path))) if parts.path else page
            place = place / "index.html" if place.is_dir() else place
            if not place.exists():
                found.append(f"{name}: the target of {url} does not exist")
            elif parts.fragment and place in pages and unquote(parts.fragment) not in pages[place].anchors | {"__codelineno"}:
                found.append(f"{name}: {url} is not an anchor of {place.relative_to(site)}")
    return found


def main() -> int:
    """Prints all errors; the exit status is 1 if there are any."""
    site = Path(sys.argv[1])
    found = dead_links(site)
    print("\n".join(found) if found else f"site: all links of {len(list(site.rglob('*.html')))} pages are valid")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
