"""Folders that earlier versions of heft wrote are read as they read them."""

import json
import shutil
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

from scenarios.cli.main import main
from testbed.importers.importer import import_trajectory
from tests.archives.read import HERE, content, of_trajectory
from tests.helpers.chunks import verify

VERSIONS = sorted(path.name for path in HERE.iterdir() if (path / "read.json").is_file())
HELD = {"0.1.0": (10, 8, 4), "0.2.0": (12, 11, 4)}
"""Numbers of trials, of estimates, and of draws of the sensor's errors in each folder."""


@pytest.fixture(params=VERSIONS)
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A copy of a version's folder: a reader may not write into it."""
    return Path(shutil.copytree(HERE / request.param, tmp_path / request.param))


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def differences(was: Any, now: Any, at: str = "") -> list[str]:
    """Places where two plain values differ, numbers beyond rounding; entries that a later version adds are none."""
    if isinstance(was, dict) and isinstance(now, dict):
        gone = [f"{at}/{name} is gone" for name in was if name not in now]
        return gone + [d for name in was if name in now for d in differences(was[name], now[name], f"{at}/{name}")]
    if isinstance(was, list) and isinstance(now, list) and len(was) == len(now):
        return [d for i, (a, b) in enumerate(zip(was, now, strict=True)) for d in differences(a, b, f"{at}/{i}")]
    if (
        isinstance(was, float | int)
        and isinstance(now, float | int)
        and was == pytest.approx(now, rel=1e-9, abs=1e-12, nan_ok=True)
    ):
        return []
    return [] if was == now else [f"{at}: {was!r} is now {now!r}"]


def plain(value: Any) -> Any:
    return json.loads(json.dumps(value))


def test_a_difference_is_found():
    was = {"a": [1.0, 2], "b": {"c": "x"}}
    assert not differences(was, {"a": [1.0 + 1e-12, 2], "b": {"c": "x", "new": 1}})
    for now in (
        {"a": [1.0, 3], "b": {"c": "x"}},
        {"a": [1.0], "b": {"c": "x"}},
        {"a": [1.0, 2], "b": {}},
        {"a": [1.0, float("nan")], "b": {"c": "x"}},
    ):
        assert differences(was, now)


def test_there_is_a_folder_of_every_version():
    assert set(VERSIONS) == set(HELD) and version("heft-testbed") in VERSIONS


def test_all_is_read_as_it_was(folder: Path):
    before = files_of(folder)
    was = json.loads((folder / "read.json").read_text(encoding="utf-8"))
    assert tuple(len(was[part]) for part in ("trials", "estimates", "draws")) == HELD[folder.name]
    assert not differences(was, plain(content(folder)))
    verify(folder / "run" / "recording.rrd")
    assert files_of(folder) == before


def test_a_log_is_imported_as_it_was(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(folder)
    was = json.loads((folder / "read.json").read_text(encoding="utf-8"))["trials"]
    again = plain(of_trajectory(import_trajectory(Path("turn.csv"), Path("bench.toml"))))
    kept = next(t for name, t in was.items() if name.startswith("imported/") and t["action"]["kind"] == "rotate")
    assert not differences(kept["series"], again["series"])


@pytest.mark.slow
def test_commands_read_it(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Status, a report, recordings, films' trials, exports, a diagnosis, and estimates made anew."""
    monkeypatch.chdir(folder)
    key = next(path.parent.name for path in Path("run").glob("estimates/*/result.json"))
    for words in (
        ["status", "run"],
        ["view", "run", "--report"],
        ["view", "run", "--record"],
        ["view", "run", key, "--record"],
        ["view", "run", "--figures"],
        ["estimate", "imported", "--methods", "hidden_states"],
    ):
        main(words)
        assert capsys.readouterr().out, words
    verify(Path("run/recording.rrd"))
