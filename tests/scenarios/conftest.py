"""Finished sweeps that the tests of runs and of results share, each made once; and a user's folder with code."""

import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pandas as pd
import pytest

from testbed import plugins
from testbed.plugins import find_code_here
from tests.helpers.runs import resumed, small_scenario

METHODS = """
held_out = 1
[methods.hidden_states]
[methods.bare]
method = "random_search"
iterations = 20
[methods.given]
method = "random_search"
use_weight = true
iterations = 20
"""


@dataclass(frozen=True)
class Finished:
    """A run that nothing happened to."""

    scenario: Path
    rows: pd.DataFrame
    out: Path


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """One support, three methods."""
    folder = tmp_path_factory.mktemp("finished")
    scenario = small_scenario(folder, ("own_weight",), METHODS)
    return Finished(scenario, resumed(scenario, folder / "out"), folder / "out")


@pytest.fixture(scope="session")
def longer(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """Two supports, the default method."""
    folder = tmp_path_factory.mktemp("longer")
    scenario = small_scenario(folder)
    return Finished(scenario, resumed(scenario, folder / "out"), folder / "out")


@pytest.fixture
def copied(finished: Finished, tmp_path: Path) -> Path:
    """Copy of the finished folder, to damage."""
    return Path(shutil.copytree(finished.out, tmp_path / "out"))


@pytest.fixture
def no_views(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs end without figures, recording and report, which take most of the time of a small one."""
    monkeypatch.setattr("scenarios.views.finished.write_views", lambda *_, **__: ())


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Replaces the entry points of installed packages: `install(estimators="name = module:Class, ...")`."""

    def replaced(**classes: str) -> None:
        named = [(group, entry.split(" = ")) for group, entries in classes.items() for entry in entries.split(", ")]
        points = EntryPoints(EntryPoint(*entry, group=f"heft.{group}") for group, entry in named)
        monkeypatch.setattr(plugins, "entry_points", lambda *, group: points.select(group=group))

    return replaced


@pytest.fixture
def as_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Makes the folder of the test, with some modules by name, the current one, in which heft may look for code."""

    def enter(*, trusted: bool = True, **modules: str) -> Path:
        for name, text in modules.items():
            (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
            monkeypatch.delitem(sys.modules, name, raising=False)
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("sys.path", [path for path in sys.path if path not in ("", str(tmp_path))])
        if trusted:
            find_code_here()
        return tmp_path

    return enter
