"""A title and facts in words, as the Markdown that Rerun shows."""

from __future__ import annotations

from collections.abc import Mapping

LONG = 45
"""Letters from which on a fact is a paragraph of its own."""


def facts_markdown(title: str, kind: str, facts: Mapping[str, str]) -> str:
    """Short facts in a table headed by `kind`, long ones below it; those without a value are left out."""
    said = {_plain(name): _plain(value) for name, value in facts.items() if value}
    rows = [f"| {name} | {value} |" for name, value in said.items() if len(value) < LONG]
    rest = [f"**{name}**: {value}\n" for name, value in said.items() if len(value) >= LONG]
    return "\n".join([f"### {_plain(title)}", "", f"| {kind} | |", "|---|---|", *rows, "", *rest])


def _plain(text: str) -> str:
    """Text that Markdown leaves as it is."""
    return "".join(f"\\{c}" if c in "\\`*_[]<>#|" else c for c in " ".join(str(text).split()))
