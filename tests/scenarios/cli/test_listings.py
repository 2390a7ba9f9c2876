"""Commands that only look: they answer at once, tell the truth of a folder, and fit the terminal."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from scenarios.catalog import LIBRARY, purpose, scenario_names
from scenarios.cli.main import main
from scenarios.results.files import exclusive

HEAVY = ["torch", "scipy", "pandas", "pyarrow", "mujoco", "matplotlib", "trimesh", "pydantic"]


def folder_of(path: Path, manifest: dict[str, object], trials: int = 2, estimates: int = 3) -> Path:
    """A results folder with no more than `heft status` looks at."""
    for kind, name, count in (("trials", "trial.json", trials), ("estimates", "result.json", estimates)):
        for i in range(count):
            (path / kind / str(i)).mkdir(parents=True)
            (path / kind / str(i) / name).write_text("{}")
    (path / "manifest.json").write_text(json.dumps(manifest))
    return path


def test_what_only_looks_loads_nothing_heavy(tmp_path):
    folder = folder_of(tmp_path, {"finished": True})
    code = f"""
import sys
from scenarios.cli.main import main
main(["scenarios"]); main(["status", {str(folder)!r}])
print("loaded:", *sorted({{*sys.modules}} & {{*{HEAVY!r}}}))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "loaded:"


EXPECTED = {"trials": 4, "estimates": 3}


@pytest.mark.parametrize(
    ("manifest", "state", "trials"),
    [
        ({"finished": True}, "finished", "2 done, 0 failed"),
        ({"finished": False, "expected": EXPECTED}, "stopped before its end", "2 done of about 4, 0 failed"),
        ({"finished": False, "expected": {"trials": 1, "estimates": 1}}, "stopped before its end", "2 done, 0 failed"),
        ({}, "nothing is running here", "2 done, 0 failed"),  # of an earlier version
    ],
)
def test_status_says_whether_a_run_is_over(tmp_path, capsys, manifest, state, trials):
    main(["status", str(folder_of(tmp_path, manifest))])
    first, second = capsys.readouterr().out.splitlines()
    assert state in first
    assert second == f"trials: {trials}; estimates: 3 done, 0 failed"


def test_status_sees_a_run_and_writes_nothing(tmp_path, capsys):
    folder = folder_of(tmp_path, {"finished": False, "expected": EXPECTED})
    before = sorted(folder.rglob("*"))
    main(["status", str(folder)])
    assert sorted(folder.rglob("*")) == before
    with exclusive(folder):
        main(["status", str(folder)])
    assert "a run is writing here now" in capsys.readouterr().out


@pytest.mark.parametrize("width", [60, 200])
def test_every_scenario_is_described_to_the_end_of_its_sentence(capsys, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    main(["scenarios"])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    shown = " ".join(" ".join(lines).split())
    for name in scenario_names():
        assert purpose(name).endswith(".")
        assert f"{name} {purpose(name)}" in shown
        assert LIBRARY.joinpath(f"{name}.toml").read_text(encoding="utf-8").startswith("# ")
