"""Wraps doc comments that are wider than `max_width` of rustfmt.toml, because rustfmt does not wrap them.

Paragraphs and list items are refilled. Code, tables, headings, link definitions and HTML are unchanged. `--check`
changes nothing and lists the lines instead.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
WIDTH = int(re.search(r"^max_width = (\d+)", (ROOT / "rustfmt.toml").read_text(), re.M)[1])
DOC = re.compile(r"^(\s*//[/!]) ?(.*)$")
ITEM = re.compile(r"^( *)([-*+]|\d+[.)]) +")
# Start of a line that is not part of a paragraph.
FIXED = re.compile(r"^(\s*$|#|\||>|<|\[[^\]]*\]: |    )")
# A word with a special meaning at the start of a line.
SPECIAL = re.compile(r"^([-+*>#|=:]|\d+[.)]$|```|~~~)")


def sources() -> list[Path]:
    """Returns the Rust files to process."""
    return sorted([*ROOT.glob("src/**/*.rs"), *ROOT.glob("crates/*/src/**/*.rs")])


def fill(text: str, width: int, first: str, rest: str) -> list[str]:
    """Fills lines of this width with the words, after a prefix for the first and one for the other lines."""
    lines: list[list[str]] = [[]]
    for word in text.split():
        prefix = first if len(lines) == 1 else rest
        if lines[-1] and len(prefix) + len(" ".join([*lines[-1], word])) > width:
            carried = [word]
            while len(lines[-1]) > 1 and SPECIAL.match(carried[0]):
                carried.insert(0, lines[-1].pop())
            lines.append(carried)
        else:
            lines[-1].append(word)
    return [(rest if number else first) + " ".join(words) for number, words in enumerate(lines)]


def block(marker: str, texts: list[str]) -> Iterator[str]:
    """Yields the lines of one doc comment; paragraphs that are too wide are wrapped."""
    width = WIDTH - len(marker) - 1
    in_code = False
    number = 0
    while number < len(texts):
        text = texts[number]
        in_code ^= text.lstrip().startswith(("```", "~~~"))
        number += 1
        item = ITEM.match(text)
        if in_code or text.lstrip().startswith(("```", "~~~")) or (FIXED.match(text) and not item):
            yield text
            continue
        first = item[0] if item else re.match(r" *", text)[0]
        rest = " " * len(first)
        paragraph = [text]
        while number < len(texts):
            follower = texts[number]
            if ITEM.match(follower) or FIXED.match(follower.lstrip()) or follower.lstrip().startswith(("```", "~~~")):
                break
            paragraph.append(follower)
            number += 1
        is_hard = any(line.endswith(("  ", "\\")) for line in paragraph)
        if is_hard or all(len(line) <= width for line in paragraph):
            yield from paragraph
        else:
            yield from fill(" ".join(paragraph)[len(first) :], width, first, rest)


def rewrapped(source: str) -> str:
    """Returns the source with its doc comments wrapped."""
    result: list[str] = []
    lines = source.split("\n")
    number = 0
    while number < len(lines):
        found = DOC.match(lines[number])
        if not found:
            result.append(lines[number])
            number += 1
            continue
        marker, texts = found[1], []
        while number < len(lines) and (found := DOC.match(lines[number])) and found[1] == marker:
            texts.append(found[2])
            number += 1
        result += [f"{marker} {text}".rstrip() for text in block(marker, texts)]
    return "\n".join(result)


def findings() -> list[str]:
    """Returns the doc comment lines that are too wide and can be wrapped."""
    found = []
    for path in sources():
        source = path.read_text(encoding="utf-8")
        if rewrapped(source) != source:
            wide = [n for n, line in enumerate(source.split("\n"), 1) if DOC.match(line) and len(line) > WIDTH]
            found += [f"{path.relative_to(ROOT)}:{n}: doc comment wider than {WIDTH}: run tools/rewrap.py" for n in wide]
    return found


def main() -> int:
    """Wraps the sources, or lists the lines to wrap."""
    if "--check" in sys.argv[1:]:
        print("\n".join(found := findings()) or "rewrap: nothing to do")
        return 1 if found else 0
    for path in sources():
        source = path.read_text(encoding="utf-8")
        if (wrapped := rewrapped(source)) != source:
            path.write_text(wrapped, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
