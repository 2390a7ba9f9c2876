"""The trained policy: greedy at zero weights, another plan by others, and a file of its own."""

from pathlib import Path

import pytest

from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.design import Design, Guess, prior_belief
from estimators.action_selection.greedy import greedy_plan
from estimators.action_selection.plan import FeasibilityLog, Goal
from estimators.action_selection.trained import SHIPPED, TrainedIndex, TrainedPolicy
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from testbed.sensing.presets import preset

LONG = ((0.0,) * 3, (0.0,) * 3, (5.0, 0.0, 0.0))
"""Weights that prefer long actions."""


@pytest.fixture(scope="module")
def plans():
    model = load_object("I1")
    shape, guess = model.shape, Guess(model.total_mass, preset("ft300s"))
    design = Design.of(shape, ActionFamily().sample(shape, range(len(shape.grasps)), 30, 0), guess)

    def plan(*index):
        return greedy_plan(design, prior_belief(shape, guess), Goal(budget_s=60.0), FeasibilityLog(), *index)

    return plan


def test_zero_weights_are_greedy_and_weights_of_time_change_it(plans):
    assert plans(TrainedIndex()).actions == plans().actions
    first, other = plans(TrainedIndex(LONG)).steps[0], plans().steps[0]
    assert first.seconds > other.seconds


def test_a_file_of_weights_is_the_same_again(tmp_path: Path):
    TrainedIndex(LONG, 60.0).save(tmp_path / "w.json", objects=3)
    assert TrainedIndex.load(tmp_path / "w.json") == TrainedIndex(LONG, 60.0)
    policy = TrainedPolicy(1.0, (0, 1), file=str(tmp_path / "w.json"), most=2, candidates=40).policy
    assert (policy.goal, policy.index) == (Goal(budget_s=60.0, most=2), TrainedIndex(LONG, 60.0))


def test_the_shipped_weights_are_not_greedys():
    assert TrainedIndex.load(SHIPPED).weights != TrainedIndex().weights


@pytest.mark.parametrize("text", [None, "{", '{"weights": [[1, 2]], "budget_s": 3}', '{"budget_s": 3}', "[1]"])
def test_another_file_is_refused(text: str | None, tmp_path: Path):
    if text is not None:
        (tmp_path / "w.json").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidValueError):
        TrainedIndex.load(tmp_path / "w.json")
