"""Every name in docs/paper_to_code.md exists."""

import re
from importlib import import_module
from typing import Any

import pytest

from tests.helpers.pages import DOCS, ROOT

PAGES = ("paper_to_code.md", "architecture.md")
NAME = re.compile(r"(?:testbed|estimators|viz|scenarios)(?:\.\w+)+")
PATH = re.compile(r"(?:[\w.]+/)+[\w*]+\.\w+")
WORDS = {
    "paper_to_code.md": {"_M", "hidden_states", "hidden_states_published", "published", "reversed_pairs"},
    "architecture.md": set[str](),
}
"""Code on a page that is neither a name nor a path."""


def code_on(page: str) -> set[str]:
    return set(re.findall(r"`([^`\n]+)`", (DOCS / page).read_text(encoding="utf-8")))


NAMED = [(page, text) for page in PAGES for text in sorted(code_on(page))]


def member(owner: Any, name: str) -> Any:
    """Attribute, or the annotation of a dataclass field without a default."""
    return getattr(owner, name, None) or getattr(owner, "__annotations__", {})[name]


@pytest.mark.parametrize(("page", "text"), NAMED)
def test_a_name_exists(page, text):
    if PATH.fullmatch(text):
        assert list(ROOT.glob(text)), text
    elif page == "paper_to_code.md" or NAME.fullmatch(text):
        assert NAME.fullmatch(text) or text in WORDS[page], f"{text}: give the full name, as testbed.Rotate"
        if NAME.fullmatch(text):
            owner, *rest = text.split(".")
            there = import_module(owner)
            for part in rest:
                try:
                    owner = f"{owner}.{part}"
                    there = import_module(owner)
                except ModuleNotFoundError:
                    there = member(there, part)


def test_pages_name_enough():
    assert sum(bool(NAME.fullmatch(text)) for _, text in NAMED) > 50
