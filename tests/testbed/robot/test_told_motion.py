"""Motion against the actions that are told: a wrong closing direction, TCP, grasp or side is named with its size."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.testing.analytic_world import analytic_trial, drawn_object
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.frames import perpendicular, rotation_2d
from testbed.objects.model import ObjectModel
from testbed.robot.calibration.motion import check_motion
from testbed.trajectory import Trajectory

OBJECT = drawn_object(0)
BESIDE = np.array([[0.02, 0.015], [-0.02, 0.01], [0.015, -0.025], [-0.01, -0.02], [0.03, 0.0]])


def turns(obj: ObjectModel = OBJECT) -> list[Trajectory]:
    grasps = [k % len(obj.shape.grasps) for k in range(len(BESIDE))]
    pivots = [tuple(obj.shape.grasps[g].position + by) for g, by in zip(grasps, BESIDE, strict=True)]
    return [analytic_trial(obj, Rotate(g, duration=2.5, pivot=p)) for g, p in zip(grasps, pivots, strict=True)]


def turn_of(trial: Trajectory) -> Rotate:
    assert isinstance(trial.action, Rotate)
    return trial.action


def told_yaw(trial: Trajectory, more: float) -> Trajectory:
    """The trial with the object told to lie turned by more, about the grasp."""
    pose = trial.object_pose.copy()
    pose[:, 2] += more
    return replace(trial, object_pose=pose)


def wrong(trials: list[Trajectory], shape=OBJECT.shape) -> dict[str, str]:
    return {finding.what: finding.text for finding in check_motion(shape, trials) if not finding.ok}


def test_what_is_told_right_is_right():
    findings = check_motion(OBJECT.shape, [*turns(), analytic_trial(OBJECT, Slide(0, 0.3))])
    assert [finding.what for finding in findings] == ["closing direction", "TCP", "center"]
    assert all(finding.ok for finding in findings)
    assert check_motion(OBJECT.shape, [analytic_trial(OBJECT, Slide(0, 0.3))]) == []


@pytest.mark.parametrize("degrees", [90, -35, 2, -2])
def test_the_closing_direction_is_corrected_by_what_it_is_off(degrees):
    trials = [told_yaw(trial, np.radians(degrees)) for trial in turns()]
    found = wrong(trials)
    assert set(found) == {"closing direction"}
    assert f"correct closing_deg by {-degrees:+d}" in found["closing direction"]
    assert not wrong(turns()[:1]) and set(wrong(trials[:1])) == {"closing direction"}


def test_a_tcp_beside_its_place_is_told_by_how_much():
    offset, trials = np.array([0.003, -0.001]), []
    for trial in turns():
        angle = trial.object_pose[:, 2] + OBJECT.shape.grasps[turn_of(trial).grasp].angle
        by = np.einsum("nij,j->ni", rotation_2d(angle), offset)
        velocity = trial.tcp_velocity.copy()
        velocity[:, :2] += perpendicular(by) * trial.object_velocity[:, 2:]
        trials.append(replace(trial, tcp_velocity=velocity))
    found = wrong(trials)
    assert set(found) == {"TCP"} and "(-3.0, +1.0)" in found["TCP"]


def test_one_wrong_grasp_is_named_with_the_one_that_would_fit():
    trials, shape = turns(), OBJECT.shape
    action = turn_of(trials[2])
    other = (action.grasp + 1) % len(shape.grasps)
    turned = shape.grasps[action.grasp].angle - shape.grasps[other].angle
    trials[2] = replace(told_yaw(trials[2], turned), action=replace(action, grasp=other))
    found = wrong(trials)
    assert set(found) == {"center"}
    assert f"grasp {shape.grasps[action.grasp].name} would fit" in found["center"]


def test_a_mirrored_object_is_told():
    flip = np.array([1.0, -1.0])
    grasps = tuple(replace(g, position=g.position * flip, angle=-g.angle) for g in OBJECT.shape.grasps)
    mirrored = replace(OBJECT.shape, particles=OBJECT.shape.particles * flip, grasps=grasps)
    trials = []
    for trial in turns():
        x, y = turn_of(trial).center(OBJECT.shape)
        angle = OBJECT.shape.grasps[turn_of(trial).grasp].angle
        trials.append(replace(told_yaw(trial, 2 * angle), action=replace(turn_of(trial), pivot=(x, -y))))
    assert "mirrored" in wrong(trials, mirrored)
