"""The reference in docs/api is the public interface: each name exists, has a docstring, and keeps its signature.

`python tests/test_public_api.py` writes `public_api.txt` anew, for an intended change of the interface.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

import heft

griffe: Any = pytest.importorskip("griffe", reason="needs the extra docs")
yaml: Any = pytest.importorskip("yaml", reason="needs the extra docs")

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
FROZEN = Path(__file__).with_name("public_api.txt")
PACKAGES = ("testbed", "estimators", "scenarios", "viz")
ENTRY = re.compile(r"^::: (\S+)\n((?: {4}.*\n)*)", re.MULTILINE)
PYTHON = re.compile(r"^```python[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class PublicName:
    """An entry of the reference."""

    path: str
    members: tuple[str, ...] | None
    """Listed members of a class; None for all that do not begin with an underscore."""
    has_signature: bool
    """True if the arguments or the value are public."""

    @property
    def source(self) -> Any:
        """griffe's object of the name."""
        return packages()[self.path]

    def listed(self) -> Iterator[Any]:
        """Members of a class in the reference."""
        if self.source.is_class:
            every = self.source.all_members
            public = [name for name in every if not name.startswith("_")]
            yield from (every[name] for name in (public if self.members is None else self.members))

    def lines(self) -> Iterator[str]:
        """Its signature, and those of its members."""
        source, given = self.source, set()
        if source.is_class and self.has_signature and "__init__" in source.all_members:
            parameters = list(source.all_members["__init__"].parameters)[1:]
            given = {parameter.name for parameter in parameters}
            yield f"{self.path}({arguments(parameters)})"
        else:
            yield self.path if source.is_class else signature(self.path, source, with_value=self.has_signature)
        for member in self.listed():
            if member.name not in given:
                yield signature(f"{self.path}.{member.name}", member, with_value=True)


@cache
def packages() -> Any:
    loader = griffe.GriffeLoader(extensions=griffe.load_extensions(), search_paths=[ROOT])
    for package in PACKAGES:
        loader.load(package)
    loader.resolve_aliases()
    return loader.modules_collection


def signature(path: str, source: Any, *, with_value: bool) -> str:
    if source.is_function:
        own = [p for p in source.parameters if p.name not in ("self", "cls")]
        return f"{path}({arguments(own)}) -> {source.returns}"
    annotation = "" if source.annotation is None else f": {source.annotation}"
    constant = {"class-attribute", "module-attribute"} & source.labels and not str(source.value).startswith(
        ("field(", "parameter(")
    )
    return path + annotation + (f" = {source.value}" if with_value and constant and source.value is not None else "")


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


def reference() -> Iterator[PublicName]:
    for page in sorted((DOCS / "api").glob("*.md")):
        for path, block in ENTRY.findall(page.read_text(encoding="utf-8")):
            options = (yaml.safe_load(block) or {}).get("options", {})
            members = options.get("members")
            hidden = {options.get("show_signature"), options.get("show_attribute_values")}
            yield PublicName(path, None if members is None else tuple(members or ()), has_signature=False not in hidden)


REFERENCE = sorted(reference(), key=lambda entry: entry.path)


def frozen() -> str:
    """Text of the whole interface, one name per line."""
    return "".join(f"{line}\n" for entry in REFERENCE for line in entry.lines())


def test_names_are_listed_once():
    paths = [entry.source.canonical_path for entry in REFERENCE]
    assert len(paths) > 80
    assert sorted(set(paths)) == sorted(paths)


def test_public_names_and_their_members_have_docstrings():
    without = [entry.path for entry in REFERENCE if entry.source.docstring is None]
    for entry in REFERENCE:
        if not any("Enum" in str(base) for base in getattr(entry.source, "bases", [])):
            without += [f"{entry.path}.{member.name}" for member in entry.listed() if member.docstring is None]
    assert without == []


def test_signatures_are_the_frozen_ones():
    assert frozen().splitlines() == FROZEN.read_text(encoding="utf-8").splitlines(), (
        "the public interface changed; if intended, run: python tests/test_public_api.py"
    )


def python_of_docs() -> Iterator[tuple[str, str]]:
    """Page or example, and its Python."""
    for page in (ROOT / "README.md", *sorted(DOCS.rglob("*.md"))):
        for code in PYTHON.findall(page.read_text(encoding="utf-8")):
            yield page.name, code
    for example in sorted((DOCS / "examples").glob("*.py")):
        yield example.name, example.read_text(encoding="utf-8")
    for notebook in sorted((DOCS / "examples").glob("*.ipynb")):
        cells = yaml.safe_load(notebook.read_text(encoding="utf-8"))["cells"]
        yield notebook.name, "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")


def test_the_documentation_imports_public_names_only():
    public = {path for entry in REFERENCE for path in (entry.path, entry.source.canonical_path)}
    imported = {
        (where, f"{node.module}.{name.name}")
        for where, code in python_of_docs()
        for node in ast.walk(ast.parse(code))
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in PACKAGES
        for name in node.names
    }
    assert len(imported) > 8
    assert sorted(pair for pair in imported if pair[1] not in public) == []
    used = {
        (where, node.attr)
        for where, code in python_of_docs()
        for node in ast.walk(ast.parse(code))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "heft"
    }
    known = {path.rpartition(".")[2] for path in public if path.count(".") == 1} & set(heft.__all__)
    assert len(used) > 40
    assert sorted(pair for pair in used if pair[1] not in known) == []


@pytest.mark.slow
def test_python_of_the_reference_runs(tmp_path, monkeypatch, capsys):
    """In this process: workers are tested with the executors."""
    run_scenario = heft.run_scenario
    monkeypatch.setattr(heft, "run_scenario", lambda scenario, out, _, report: run_scenario(scenario, out, 0, report))
    monkeypatch.chdir(tmp_path)
    for page in sorted((DOCS / "api").glob("*.md")):
        for code in PYTHON.findall(page.read_text(encoding="utf-8")):
            exec(compile(code, page.name, "exec"), {"__name__": "__main__"})
    assert "estimates: 2 of 2, 0 failed" in capsys.readouterr().out


def test_the_citation_is_of_this_version():
    assert f"version = {{{version('heft-testbed')}}}" in (DOCS / "cite.md").read_text(encoding="utf-8")


if __name__ == "__main__":
    FROZEN.write_text(frozen(), encoding="utf-8")
