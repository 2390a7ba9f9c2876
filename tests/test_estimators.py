"""Every method of the registry keeps to the protocol."""

from __future__ import annotations

import pytest
from estimator_conformance import CONFORMANCE

from estimators.hidden_states import HiddenStatesEstimator
from estimators.protocol import ActionPolicy, Estimator
from estimators.rank_driven import RankDriven, between_particles, planned_rank
from scenarios.schema import METHODS
from testbed.actions import Accelerate, Rotate
from testbed.object_files import load_object

VARIANTS = {**{name: kind() for name, kind in METHODS.items()}, "descent": HiddenStatesEstimator(solver="descent")}


@pytest.mark.parametrize("holds", CONFORMANCE, ids=lambda f: f.__name__)
@pytest.mark.parametrize("estimator", VARIANTS.values(), ids=list(VARIANTS))
def test_conformance(estimator, holds):
    assert isinstance(estimator, Estimator)
    holds(estimator)


def test_the_policy_asks_until_the_rank_is_full(monkeypatch):
    from analytic_world import felt  # noqa: PLC0415

    shape = (obj := load_object("L1")).shape
    policy = RankDriven(pivots=1, accelerated=3, duration=2.0)
    assert isinstance(policy, ActionPolicy)
    seen = []
    while (action := policy.next(shape, seen)) is not None:
        assert isinstance(action, Accelerate | Rotate)
        seen.append(felt(obj, action))
    turns = [t.action for t in seen if isinstance(t.action, Rotate)]
    assert planned_rank(shape, turns) == 6
    assert planned_rank(shape, turns[:-1]) < 6
    assert sum(isinstance(t.action, Accelerate) for t in seen) == 3


def test_the_policy_takes_every_grasp_before_any_again_and_only_those_allowed():
    from analytic_world import felt  # noqa: PLC0415

    obj = load_object("I1")
    policy = RankDriven(pivots=4, accelerated=0, grasps=(1, 2, 4, 5))
    seen = []
    while (action := policy.next(obj.shape, seen)) is not None:
        assert isinstance(action, Rotate)
        seen.append(felt(obj, action))
    assert sorted(t.action.grasp for t in seen) == [1, 2, 4, 5]
    assert RankDriven(grasps=()).next(obj.shape, []) is None
    assert RankDriven(most=1).next(obj.shape, seen) is None


def test_turns_go_about_points_between_particles():
    import numpy as np  # noqa: PLC0415

    for grid in (1, 2, 3, 4, 5):
        shape = load_object("L1", grid).shape
        for grasp in shape.grasps:
            point = between_particles(shape, grasp.position)
            centre = grasp.position if point is None else np.array(point)
            assert np.linalg.norm(shape.particles - centre, axis=1).min() > shape.cell / 4


@pytest.mark.parametrize(("name", "enough"), [("I1", 3), ("L1", 2), ("F1", 2)])
def test_as_many_turns_as_the_shape_needs_can_fill_the_rank(name, enough):
    from itertools import combinations  # noqa: PLC0415

    shape = load_object(name).shape
    ranks = {
        k: max(planned_rank(shape, [Rotate(g) for g in some]) for some in combinations(range(len(shape.grasps)), k))
        for k in (enough - 1, enough)
    }
    assert ranks[enough] == 6
    assert ranks[enough - 1] < 6
