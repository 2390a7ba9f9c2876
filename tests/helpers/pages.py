"""Pages of the documentation: fenced blocks, sections and tables."""

import re
import runpy
from dataclasses import dataclass
from pathlib import Path
from shutil import copy

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
DOCS = ROOT / "docs"
EXAMPLES = DOCS / "examples"
PAGES = sorted(DOCS.glob("*.md"))
FENCE = re.compile(
    r"(?:^<!-- (?P<mark>[^\n]+) -->\n)?^```(?P<info>[^\n]*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: str
    mark: str
    """Text of the comment above it: object, scenario, slow, output: ..."""
    language: str
    title: str
    text: str


def blocks_of(page: Path) -> list[Block]:
    found = []
    for match in FENCE.finditer(page.read_text(encoding="utf-8")):
        language, _, rest = match["info"].partition(" ")
        title = re.search(r'title="([^"]+)"', rest)
        found.append(Block(page.name, match["mark"] or "", language, title[1] if title else "", match["text"]))
    return found


BLOCKS = [block for page in PAGES for block in blocks_of(page)]
TUTORIAL = [block for block in BLOCKS if block.page in ("tutorial.md", "python.md", "write_an_estimator.md")]


def write_tutorial(folder: Path) -> Path:
    """The folder, with every titled file of the tutorial and the examples that it names."""
    for name in ("own_policy.py", "own_simulator.py"):
        copy(EXAMPLES / name, folder)
    for block in TUTORIAL:
        if block.title:
            (folder / block.title).write_text(block.text, encoding="utf-8")
    return folder


def run_file(name: str) -> None:
    """Run a Python file of the current folder as a script."""
    runpy.run_path(name, run_name="__main__")


def headings(page: str) -> list[str]:
    """Headings of a page, of any level."""
    return re.findall(r"^#+ (.+)$", FENCE.sub("", (DOCS / page).read_text(encoding="utf-8")), re.MULTILINE)


def section(page: str, heading: str) -> str:
    """Text under a heading, up to the next one of any level."""
    text = (DOCS / page).read_text(encoding="utf-8")
    found = re.search(rf"^#+ {re.escape(heading)}\n(.*?)(?=^#+ |\Z)", text, re.MULTILINE | re.DOTALL)
    assert found, f"{page} has no section {heading}"
    return found[1]


def table(page: str, heading: str) -> list[list[str]]:
    """Cells of the first table of a section, without its head."""
    lines = [line for line in section(page, heading).splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def names(cells: list[list[str]]) -> list[str]:
    """All code names in the first column."""
    return [name for row in cells for name in re.findall(r"`([^`]+)`", row[0])]


def options(page: str, heading: str) -> set[str]:
    """Command-line options that a section names."""
    return set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", section(page, heading)))
