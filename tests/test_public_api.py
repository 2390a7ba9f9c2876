"""The reference is the public interface: every name is there, is told of, and keeps its signature.

`python tests/test_public_api.py` writes `public_api.txt` anew, where a change of the interface is meant.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

griffe: Any = pytest.importorskip("griffe", reason="needs the extra docs")
yaml: Any = pytest.importorskip("yaml", reason="needs the extra docs")

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
FROZEN = Path(__file__).with_name("public_api.txt")
ROOMS = ("testbed", "estimators", "scenarios", "viz")
ENTRY = re.compile(r"^::: (\S+)\n((?: {4}.*\n)*)", re.MULTILINE)
PYTHON = re.compile(r"^```python[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Listed:
    """A name of the reference."""

    page: str
    path: str
    members: tuple[str, ...] | None
    """Of a class: those that are shown; None is all that do not begin with an underscore."""
    has_signature: bool
    """Whether it can be called, or its value is told."""

    @property
    def there(self) -> Any:
        """What griffe found."""
        return source()[self.path]

    def shown(self) -> Iterator[Any]:
        """What the reference shows below it."""
        if not self.there.is_class:
            return
        every = self.there.all_members
        names = [name for name in every if not name.startswith("_")] if self.members is None else self.members
        for name in names:
            yield every[name]

    def lines(self) -> Iterator[str]:
        """Its signature, and those of its members."""
        there, given = self.there, set()
        if there.is_class and self.has_signature and "__init__" in there.all_members:
            parameters = list(there.all_members["__init__"].parameters)[1:]
            given = {parameter.name for parameter in parameters}
            yield f"{self.path}({arguments(parameters)})"
        elif there.is_class:
            yield self.path
        else:
            yield signature(self.path, there, with_value=self.has_signature)
        for member in self.shown():
            if member.name not in given:
                yield signature(f"{self.path}.{member.name}", member, with_value=True)


@cache
def source() -> Any:
    """The four rooms as they stand in the source."""
    loader = griffe.GriffeLoader(extensions=griffe.load_extensions(), search_paths=[ROOT])
    for room in ROOMS:
        loader.load(room)
    loader.resolve_aliases()
    return loader.modules_collection


def signature(path: str, there: Any, *, with_value: bool) -> str:
    if there.is_function:
        own = [p for p in there.parameters if p.name not in ("self", "cls")]
        return f"{path}({arguments(own)}) -> {there.returns}"
    said = "" if there.annotation is None else f": {there.annotation}"
    of_itself = {"class-attribute", "module-attribute"} & there.labels and not str(there.value).startswith("field(")
    return path + said + (f" = {there.value}" if with_value and of_itself and there.value is not None else "")


def arguments(parameters: list[Any]) -> str:
    kinds = griffe.ParameterKind
    written, named_only = [], False
    for parameter in parameters:
        if parameter.kind is kinds.keyword_only and not named_only:
            named_only = True
            written.append("*")
        star = {kinds.var_positional: "*", kinds.var_keyword: "**"}.get(parameter.kind, "")
        named_only |= star == "*"
        kind = "" if parameter.annotation is None else f": {parameter.annotation}"
        default = f" = {parameter.default}" if parameter.default is not None and not star else ""
        written.append(f"{star}{parameter.name}{kind}{default}")
    return ", ".join(written)


def listed() -> list[Listed]:
    found = []
    for page in sorted((DOCS / "api").glob("*.md")):
        for path, block in ENTRY.findall(page.read_text(encoding="utf-8")):
            options = (yaml.safe_load(block) or {}).get("options", {})
            members = options.get("members")
            hidden = {options.get("show_signature"), options.get("show_attribute_values")}
            chosen = None if members is None else tuple(members or ())
            found.append(Listed(page.stem, path, chosen, has_signature=False not in hidden))
    return found


LISTED = listed()


def frozen() -> str:
    """The whole interface, a name a line."""
    return "".join(f"{line}\n" for entry in sorted(LISTED, key=lambda e: e.path) for line in entry.lines())


def test_names_are_listed_once():
    paths = [entry.path for entry in LISTED]
    assert len(paths) > 80
    assert sorted(set(paths)) == sorted(paths)


@pytest.mark.parametrize("entry", LISTED, ids=lambda e: e.path)
def test_a_public_name_is_told_of_with_all_its_members(entry):
    silent = [entry.path] if entry.there.docstring is None else []
    if not any("Enum" in str(base) for base in getattr(entry.there, "bases", [])):  # a word of an enumeration says it
        silent += [f"{entry.path}.{m.name}" for m in entry.shown() if m.docstring is None]
    assert not silent


def test_signatures_are_the_frozen_ones():
    assert frozen().splitlines() == FROZEN.read_text(encoding="utf-8").splitlines(), (
        "the public interface changed; where that is meant, run: python tests/test_public_api.py"
    )


def taught() -> Iterator[tuple[str, str]]:
    """Python that the documentation shows: where, and the code."""
    for page in (ROOT / "README.md", *sorted(DOCS.rglob("*.md"))):
        for code in PYTHON.findall(page.read_text(encoding="utf-8")):
            yield page.name, code
    for example in sorted((DOCS / "examples").glob("*.py")):
        yield example.name, example.read_text(encoding="utf-8")
    for notebook in sorted((DOCS / "examples").glob("*.ipynb")):
        cells = yaml.safe_load(notebook.read_text(encoding="utf-8"))["cells"]
        yield notebook.name, "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")


def test_the_documentation_imports_public_names_only():
    public = {entry.path for entry in LISTED}
    imported = {
        (where, f"{node.module}.{name.name}")
        for where, code in taught()
        for node in ast.walk(ast.parse(code))
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in ROOMS
        for name in node.names
    }
    assert len(imported) > 40
    assert sorted(pair for pair in imported if pair[1] not in public) == []


@pytest.mark.slow
def test_python_of_the_reference_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for page in sorted((DOCS / "api").glob("*.md")):
        for code in PYTHON.findall(page.read_text(encoding="utf-8")):
            exec(compile(code, page.name, "exec"), {"__name__": "__main__"})
    assert "estimates: 2 of 2, 0 failed" in capsys.readouterr().out


def test_the_citation_is_of_this_version():
    assert f"version = {{{version('heft')}}}" in (DOCS / "cite.md").read_text(encoding="utf-8")


if __name__ == "__main__":
    FROZEN.write_text(frozen(), encoding="utf-8")
