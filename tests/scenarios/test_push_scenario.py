"""Tests of the scenario of pushes: objects without a grasp are handled, and pushed."""

from estimators.action_selection.greedy import PlannedPolicy
from scenarios.config import load_scenario
from scenarios.policies import AfterWeighing, Policy
from scenarios.results.store import Store
from scenarios.study.experiment import experiments_of
from testbed import Push


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
