"""heft import --find: the actions of a long recording as a table, and as [[logs]] that import them."""

from pathlib import Path

import pytest

from estimators.testing.recorded import load_block
from scenarios.cli.main import main
from scenarios.results.estimates import load_trajectories
from tests.fakes.lab_bench import mapping_of, strung, write_csv, write_toml


def ended(*words: str) -> int:
    try:
        main([*words])
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_a_recording_is_found_and_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    trials = load_block("L2-own_weight").trials("ft300s")[2:4]
    recording = strung(trials, 1e-5)
    write_csv(tmp_path / "day.csv", recording)
    write_toml(tmp_path / "lab.toml", mapping_of(recording, action=None, joints=None))
    assert ended("import", "lab.toml", "day.csv", "--out", "lab") == 2
    assert "heft import --find" in capsys.readouterr().err
    assert ended("import", "lab.toml", "day.csv", "--find", "--grasps", "A3") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "accelerated turn left 8 steps 140 deg (0, 0) A3 0.0" in said
    assert "turn left and back 10.0 deg/s 41 deg (8, 8) A4 14.1" in said
    assert "lab.found.toml: look it through" in said
    assert ended("import", "lab.found.toml", "--out", "lab") == 0
    said = capsys.readouterr().out
    assert "ok      day.csv, 0 s to 14.12 s: L2: accelerate (grasp 3" in said
    assert "2 trials of L2 in lab, all usable" in said
    stored = [t for _, t in load_trajectories("lab")]
    assert sorted(t.provenance["stretch"] for t in stored) == ["0 s to 14.12 s", "14.12 s to 28 s"]
    assert ended("import", "lab.found.toml", "--out", "lab") == 0  # the same again takes the same place
    assert len(list(load_trajectories("lab"))) == 2
    text = Path("lab.found.toml").read_text(encoding="utf-8")
    Path("lab.found.toml").write_text(text.replace("from_s = 14.12\n", "from_s = 4.0\n"), encoding="utf-8")
    assert ended("import", "lab.found.toml", "--out", "lab") == 2
    error = capsys.readouterr().err
    assert "logs.file: got 'day.csv, 0 s to 14.12 s'; allowed: each stretch" in error
    assert "another [[logs]] has 4 s to 28 s" in error
    assert ended("import", "lab.found.toml", "--find") == 2
    assert "--find: got 'lab.found.toml'; allowed: a mapping without [[logs]]" in capsys.readouterr().err
