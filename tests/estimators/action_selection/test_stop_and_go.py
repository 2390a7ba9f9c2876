"""Stop-and-go lifts as a policy, and in a scenario's [policy]."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.rank import RankDriven
from estimators.action_selection.stop_and_go import StopAndGo
from estimators.testing.analytic_world import record
from scenarios.policies import Policy
from testbed.actions.lift import Lift
from testbed.objects.files import load_object
from testbed.simulation.settings import SimulationSettings

SHAPE = load_object("L2").shape


def actions_of(policy, refused=(), failed=()):
    done = []
    while (action := policy.next(SHAPE, done)) is not None:
        assert action not in refused
        status = {"status": "slipped", "reason": "it slipped"} if action in failed else {}
        done.append(replace(record(action=action), **status))
    return [t.action for t in done]


def test_it_lifts_by_the_innermost_grasps_and_goes_on_to_others():
    inner = sorted(range(len(SHAPE.grasps)), key=lambda g: float(np.linalg.norm(SHAPE.grasps[g].position)))
    lifts = [Lift.stop_and_go(g) for g in inner]
    assert actions_of(StopAndGo(lifts=2)) == lifts[:2]
    assert actions_of(StopAndGo(lifts=1), failed=lifts[:1]) == lifts[:2]
    assert actions_of(StopAndGo(lifts=1, refused={lifts[0]: "no"}), refused=lifts[:1]) == lifts[1:2]
    assert actions_of(StopAndGo(lifts=99)) == lifts
    turns = RankDriven(1, accelerated=1)
    both = actions_of(StopAndGo(lifts=1, before=turns))
    assert both == [*actions_of(turns), lifts[0]]


def test_a_scenario_asks_for_lifts():
    settings = SimulationSettings()
    assert Policy(kind="stop_and_go").build((0, 1), SHAPE, settings) == StopAndGo(2, (0, 1))
    ours = Policy(lifts=1).build((0, 1), SHAPE, settings)
    assert ours == StopAndGo(1, (0, 1), Policy().build((0, 1), SHAPE, settings))
    assert Policy(lifts=3).expected_trials == Policy().expected_trials + 3
    assert Policy(kind="stop_and_go", held_out=0).expected_trials == 3
    for kind in ("greedy", "package:Class"):
        with pytest.raises(ValueError, match="lifts"):
            Policy(kind=kind, lifts=1)
    assert Policy(kind="greedy", assumed_support="rigid", lifts=1).lifts_last is None


def test_lifts_that_stop_and_go_are_among_the_candidates():
    drawn = ActionFamily(lifts=True).sample(SHAPE, range(3), 2000, 0)
    lifts = [action for action in drawn if isinstance(action, Lift)]
    assert {Lift(g) for g in range(3)} | {Lift.stop_and_go(g) for g in range(3)} <= set(lifts)
    assert {action.poses for action in lifts} >= {2, 4}
