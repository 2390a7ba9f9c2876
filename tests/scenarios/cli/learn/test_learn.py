"""heft learn: one file in the end, from the examples that are there."""

import pytest

from estimators.learned.checkpoint import Checkpoint, Origin, save_examples
from estimators.learned.examples import make_examples
from scenarios.cli.main import main
from tests.helpers.commands import refusal

pytest.importorskip("zuko", reason="needs the extra learned")
pytestmark = pytest.mark.slow


def test_the_command_goes_on_with_examples_that_are_there(tmp_path, monkeypatch, capsys):
    path = tmp_path / "out" / "learned.pt"
    for index in range(2):
        save_examples(path.with_name("learned.pt.parts") / f"3-0000{index}.pt", make_examples(7, [index]), 4.0)
    monkeypatch.setattr("estimators.learned.checkpoint.make_part", pytest.fail)
    words = ["learn", "--objects", "20", "--epochs", "1", "--seed", "3", "--workers", "0"]
    main([*words, "--out", str(path)])
    assert "20 objects" in capsys.readouterr().out and [each.name for each in path.parent.iterdir()] == ["learned.pt"]
    learned = Checkpoint.load(path)
    assert learned.origin == Origin(20, 3) and learned.core_seconds > 8.0


def test_too_few_objects_are_refused(capsys):
    assert "--objects" in refusal(capsys, "learn", "--objects", "5")
