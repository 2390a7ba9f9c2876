"""The examples of the documentation run, and say what they say they do."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "docs" / "examples"


@pytest.fixture
def example(tmp_path, monkeypatch, capsys):
    """Runs an example as a script in a folder of its own; what it prints."""
    monkeypatch.chdir(tmp_path)

    def run(name: str, *arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_every_example_has_its_test():
    assert {path.name for path in EXAMPLES.glob("*.py")} == {
        "first_trial.py",
        "own_estimator.py",
        "own_log.py",
        "read_a_sweep.py",
    }


def test_own_estimator(example):
    said = example("own_estimator.py")
    assert float(said.rsplit("NAD ", 1)[1].split()[0]) < 5


@pytest.mark.slow
def test_first_trial(example):
    there, back = example("first_trial.py").splitlines()
    assert there.startswith("+0.17")
    assert back.startswith("-0.17")


@pytest.mark.slow
def test_own_log_and_how_its_results_are_read(example):
    said = example("own_log.py")
    assert "4 trials of L2 in results/lab, 0 of them no data" in said
    nad = next(line for line in said.splitlines() if line.split()[:1] == ["hidden_states"]).split()
    assert float(nad[1]) < 5
    read = example("read_a_sweep.py", "results/lab")
    assert "worst: L2 by" in read
    assert read.count("least_squares") >= 2
