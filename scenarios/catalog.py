"""The library of scenarios: their names, and what each is for. It loads quickly."""

from __future__ import annotations

from itertools import takewhile
from pathlib import Path

from testbed.files import library_names

LIBRARY = Path(__file__).parent / "library"


def scenario_names() -> list[str]:
    """Names of the scenarios in the library."""
    return library_names(LIBRARY)


def purpose(name: str) -> str:
    """The comment at the top of a scenario of the library: what it is for, in a sentence or two."""
    lines = (LIBRARY / f"{name}.toml").read_text(encoding="utf-8").splitlines()
    return " ".join(line.lstrip("# ") for line in takewhile(lambda line: line.startswith("#"), lines))
