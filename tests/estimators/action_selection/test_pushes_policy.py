"""Tests of random pushes as a policy."""

from types import SimpleNamespace

import numpy as np

from estimators.action_selection.pushes import TRIES, RandomPushes, random_pushes
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
