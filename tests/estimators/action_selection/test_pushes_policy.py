"""Tests of random pushes as a policy."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.action_selection.pushes import TRIES, RandomPushes, random_pushes
from estimators.action_selection.rank import RANK_DRIVEN
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import Action
from testbed.actions.push import Push
from testbed.actions.rotate import Rotate
from testbed.objects.files import load_object

SHAPE = load_object("F2").shape


def test_random_pushes_meet_the_whole_outline_and_are_repeatable():
    found = random_pushes(SHAPE, 200, 4)
    assert found[:20] == random_pushes(SHAPE, 20, 4) != random_pushes(SHAPE, 20, 5)
    ways = {tuple(push.face(SHAPE).normal.round().tolist()) for push in found}  # each has a face before it
    assert len(ways) == 4 and len({push.face(SHAPE).group for push in found}) == SHAPE.n_m
    assert np.abs([push.curvature for push in found]).max() > 1


def test_the_policy_tries_others_where_one_is_refused_or_fails_and_ends():
    refused, made = {}, []
    policy = RandomPushes(4, seed=1, refused=refused)
    while (action := policy.next(SHAPE, made)) is not None:
        if len(refused) < 2:
            refused[action] = "reach"
        else:
            made.append(SimpleNamespace(action=action, ok=len(made) != 1))
    assert len(made) == 5 and len({*refused, *(t.action for t in made)}) == 7
    hopeless = RandomPushes(2, refused={action: "no" for action in random_pushes(SHAPE, TRIES * 2, 0)})
    assert hopeless.next(SHAPE, []) is None


@pytest.mark.parametrize(("grasps", "pushed"), [(None, False), ((0,), True)], ids=["enough", "too few"])
def test_pushes_follow_turns_that_leave_masses_open(grasps: tuple[int, ...] | None, pushed: bool):
    shape, made = load_object("L2").shape, []
    policy = RandomPushes(2, before=replace(RANK_DRIVEN["reversed_pairs"], accelerated=1, pivots=2, grasps=grasps))
    while (action := policy.next(shape, made)) is not None:
        made.append(SimpleNamespace(action=action, ok=True))
    kinds = [type(t.action) for t in made]
    assert kinds[:3] == [Accelerate, Rotate, Rotate] and kinds.count(Push) == 2 * pushed
    assert not pushed or kinds[-2:] == [Push, Push]


def test_pushes_follow_where_every_turn_is_refused():
    refused: dict[Action, str] = {Accelerate(0): "reach"}
    before = replace(RANK_DRIVEN["reversed_pairs"], grasps=(0,), refused=refused)
    assert isinstance(RandomPushes(2, refused=refused, before=before).next(SHAPE, []), Push)
