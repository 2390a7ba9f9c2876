"""Tests of the scenario of pushes: objects without a grasp are handled, and pushed."""

import pytest

from estimators.action_selection.greedy import PlannedPolicy
from scenarios.catalog import LIBRARY
from scenarios.config import load_scenario
from scenarios.policies import AfterWeighing, Policy
from scenarios.results.store import Store
from scenarios.study.experiment import experiments_of
from testbed import InfeasibleTrialError, Push


def test_objects_that_nobody_can_grip_are_pushed(tmp_path):
    _, scenario = load_scenario("push")
    found, left_out = experiments_of(
        scenario.model_copy(update={"random": []}), Store(tmp_path), lambda stage, done, total, failed=0: None
    )
    assert not left_out and {e.model.name for e in found} == {"rectangle_2x3", "rectangle_3x3"}
    assert {e.world is None for e in found} == {True, False}
    for experiment in found:
        action = experiment.next_action()
        assert not experiment.model.shape.grasps and not experiment.turns and isinstance(action, Push)


@pytest.mark.slow
def test_pushes_are_planned_where_the_policy_plans(tmp_path):
    _, scenario = load_scenario("push")
    policy = Policy(kind="greedy", touches=5, pushes=2, candidates=20)
    planned = scenario.model_copy(update={"random": [], "objects": [*scenario.objects[:1], "L2"], "policy": policy})
    found, _ = experiments_of(planned, Store(tmp_path), lambda stage, done, total, failed=0: None)
    by_name = {experiment.model.name: experiment for experiment in found}
    for name, most in (("rectangle_2x3", 2), ("L2", 5)):
        experiment = by_name[name]
        experiment.weighed.append(experiment.model.total_mass)
        assert isinstance(experiment.policy, AfterWeighing) and isinstance(experiment.policy.policy, PlannedPolicy)
        made = experiment.policy.policy
        assert made.family.pushes and made.goal.most == most and bool(experiment.turns) == bool(made.grasps)
    assert isinstance(by_name["rectangle_2x3"].next_action(), Push)


@pytest.mark.parametrize(
    ("objects", "changes", "message"),
    [
        (["objects/fold_2.toml"], {"policy": Policy(kind="push")}, "an object with hinges is not pushed"),
        (
            ["objects/fold_2.toml"],
            {"policy": Policy(kind="drag"), "support": ["rigid"]},
            "links rest on their own weight",
        ),
        (["objects/rectangle_2x3.toml"], {"policy": Policy()}, 'it can be pushed: kind = "push"'),
    ],
    ids=["links", "rigid links", "no grasp"],
)
def test_what_cannot_be_done_is_said_before_any_trial(tmp_path, objects, changes, message):
    _, scenario = load_scenario("push")
    paths = [str(LIBRARY / path) for path in objects]
    asked = scenario.model_copy(update={"random": [], "sweep": type(scenario.sweep)(), "objects": paths, **changes})
    with pytest.raises(InfeasibleTrialError, match=message):
        experiments_of(asked, Store(tmp_path), lambda stage, done, total, failed=0: None)


def test_pushes_stand_beside_turns_alone():
    with pytest.raises(ValueError, match="none with drag: after turns by rank, or in a plan"):
        Policy(kind="drag", pushes=4)
