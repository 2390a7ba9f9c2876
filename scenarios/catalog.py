"""Names and purposes of the scenarios in the library. It loads quickly."""

from __future__ import annotations

from itertools import takewhile
from pathlib import Path

from testbed.files import library_names

LIBRARY = Path(__file__).parent / "library"


def scenario_names() -> list[str]:
    """Names of the scenarios in the library."""
    return library_names(LIBRARY)


def purpose(name: str) -> str:
    """Comment at the top of a scenario of the library: its purpose in a sentence or two."""
    lines = (LIBRARY / f"{name}.toml").read_text(encoding="utf-8").splitlines()
    return " ".join(line.lstrip("# ") for line in takewhile(lambda line: line.startswith("#"), lines))
