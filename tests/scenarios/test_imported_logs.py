"""Logs become trials of a results folder: what replaces an earlier trial, and the order of the trials."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from estimators.testing.recorded import load_block
from scenarios.cli.main import main
from scenarios.results.logs import ImportedLog, import_logs
from scenarios.results.trials import measured_trials
from testbed import Rotate
from testbed.importers.clocks import Delay
from testbed.importers.mapping import LogMap, moved_as_stored
from testbed.robot.calibration.file import load_calibration, save_calibration
from tests.fakes.lab_bench import columns, mapping_of, write_toml

ARCHIVES = Path(__file__).parents[1] / "archives"
TURNS = [t for t in load_block("L2-own_weight").trials("ft300s") if isinstance(t.action, Rotate)][:3]
TIME = {"column": "stamp"}


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """Folder with the turns as the episodes of one file, and as a log of the first."""
    tables = [pd.DataFrame({"stamp": t.time_s, "episode": i, **columns(t)}) for i, t in enumerate(TURNS)]
    pd.concat(tables).to_parquet(tmp_path / "day.parquet")
    tables[0].to_csv(tmp_path / "0.csv", index=False)
    return tmp_path


def episode(number: int) -> dict[str, Any]:
    return {"file": "day.parquet", "where": {"episode": number}, "action": TURNS[number].action.to_dict()}


def imports(lab: Path, logs: list[dict[str, Any]], weight: float | None = None, **changes: Any) -> list[ImportedLog]:
    mapping = write_toml(lab / "lab.toml", mapping_of(TURNS[0], action=None, time=TIME, logs=logs, **changes))
    return import_logs(mapping, [], lab / "out", None, weight, lambda *_: None)


def kept(lab: Path) -> set[str]:
    return {path.parent.name for path in lab.glob("out/trials/*/trial.json")}


def test_what_changes_a_trajectory_changes_its_key(lab: Path, monkeypatch: pytest.MonkeyPatch):
    """A calibration, and the delay that other logs show; the earlier trial is replaced."""
    wrench = mapping_of(TURNS[0])["sensor"] | {"file": "0.csv", "calibration": "calibration.toml"}
    logs = [{"file": "0.csv", "action": TURNS[0].action.to_dict()}]
    found = load_calibration(ARCHIVES / "0.2.0/calibration.toml")
    keys: list[str] = []
    for gain, late in ((1.0, 0.01), (1.1, 0.01), (1.1, 0.02)):
        save_calibration(lab / "calibration.toml", replace(found, gain=np.full(6, gain)), "x", "2026-01-01")
        monkeypatch.setattr("scenarios.results.logs.pooled_delay", lambda _, late=late: Delay(late, 0.001))
        (log,) = imports(lab, logs, sensor=wrench)
        assert log.replaced == keys[-1:] and kept(lab) == {log.key}
        keys.append(log.key)
    assert len({*keys}) == 3


def test_another_part_of_a_file_replaces_nothing(lab: Path):
    """A second import of one part replaces it, by any mapping; a part of another file of that name is noted."""
    (first,) = imports(lab, [episode(0)])
    (second,) = imports(lab, [episode(1)])
    assert not second.replaced and kept(lab) == {first.key, second.key}
    (later,) = imports(lab, [episode(1) | {"from_s": 0.05}])
    assert later.replaced == [second.key] and kept(lab) == {first.key, later.key}
    pd.read_parquet(lab / "day.parquet").assign(more=0.0).to_parquet(lab / "day.parquet")
    (again,) = imports(lab, [episode(0)])
    assert not again.replaced and again.alike == [first.key]
    assert kept(lab) == {first.key, later.key, again.key}


def test_the_same_stretch_of_another_object_is_named_and_stays(lab: Path, capsys: pytest.CaptureFixture[str]):
    (first,) = imports(lab, [episode(0)])
    (lab / "other.toml").write_text('name = "other"\n[blocks]\nlayout = ["1", "1", "1", "111"]\n', encoding="utf-8")
    (second,) = imports(lab, [episode(0)], object="other.toml")
    assert second.of_others == {first.key: "L2"} and not second.replaced and kept(lab) == {first.key, second.key}
    main(["import", str(lab / "lab.toml"), "--out", str(lab / "out")])
    assert f"trials/{first.key} is of the same stretch, but of the object L2" in capsys.readouterr().out


def test_a_stretch_is_recognized():
    phases = [{"phase": "tare", "from_s": 0.0, "to_s": 1.0}, {"phase": "steady", "from_s": 2.5, "to_s": 9.0}]
    for part in (
        {},
        {"from_s": 4.0},
        {"to_s": 14.12},
        {"from_s": 14.12, "to_s": 28.0},
        {"from_s": 1.0, "phases": phases},
    ):
        entry = LogMap.model_validate({"file": "day.csv", "where": {"episode_index": 1}} | part)
        stored = {"stretch": entry.stretch, "mapping": {"phases": part.get("phases", [])}}
        assert moved_as_stored(stored) == entry.moved


def test_each_object_keeps_its_weighing(lab: Path):
    """Also beside another of the same shape and weight."""
    text = 'name = "{}"\n[blocks]\nlayout = ["1", "1", "1", "111"]\n'
    for name in ("one", "other"):
        (lab / f"{name}.toml").write_text(text.format(name), encoding="utf-8")
        imports(lab, [episode(0)], 1.8, object=f"{name}.toml")
    assert [group.object.name for group in measured_trials(lab / "out")[0]] == ["one", "other"]


def test_trials_without_dates_are_in_the_order_of_import(lab: Path):
    logs = imports(lab, [episode(i) for i in (2, 0, 1)], 1.8)
    (found,), _ = measured_trials(lab / "out", held_out=1)
    assert (*found.moved, *found.held_out) == tuple(log.key for log in logs)


@pytest.mark.parametrize("version", ["0.1.0", "0.2.0"])
def test_a_trial_of_an_older_heft_is_replaced(tmp_path: Path, version: str):
    folder = shutil.copytree(ARCHIVES / version, tmp_path / version)
    (earlier,) = (
        path.parent.name for path in folder.glob("imported/trials/*/trial.json") if '"sha256"' in path.read_text()
    )
    (log,) = import_logs(folder / "bench.toml", [folder / "turn.csv"], folder / "imported", None, None, lambda *_: None)
    assert log.replaced == [earlier]
    assert len(list(folder.glob("imported/trials/*"))) == 2
