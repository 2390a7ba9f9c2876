"""Tests of the scenario of pushes: objects without a grasp are handled, and pushed."""

from scenarios.config import load_scenario
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
