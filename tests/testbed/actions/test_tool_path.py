"""Profiles and tool paths: what simulation and the real bench both follow."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from testbed.actions.accelerate import Accelerate
from testbed.actions.lift import Lift
from testbed.actions.path import RAMP_TIME, WORKSPACE
from testbed.actions.push import Push
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.frames import transform_point
from testbed.objects.faces import faces
from testbed.objects.files import load_object

SHAPE = load_object("L2").shape
ACTIONS = [
    Rotate(2, pivot=(0.01, -0.02), back=True, duration=3.0),
    Rotate(0, speed=-0.3, duration=2.0),
    Slide(1, direction=0.7, duration=2.0),
    Accelerate(1),
    Accelerate(0, (-1.0, 1.0), 0.6, -0.7),
]


@pytest.mark.parametrize("action", ACTIONS, ids=str)
def test_distance_is_the_integral_of_the_rate(action):
    profile = action.profile(0.01)
    rate = np.concatenate([[0.0], profile.rate])
    assert_allclose(profile.distance, np.cumsum((rate[1:] + rate[:-1]) / 2) * 0.01, atol=1e-12)
    assert rate[-1] == pytest.approx(0.0)


@pytest.mark.parametrize("action", [*ACTIONS, Push.into(faces(SHAPE)[2], 0.4, 0.2, 5.0), Lift(1)], ids=str)
def test_between_ticks_a_tool_path_is_that_of_finer_ticks_and_its_rate_is_the_derivative(action):
    path, fine = (action.tool_path(SHAPE, np.array([0.4, 0.1, 0.3]), step) for step in (0.01, 0.001))
    times = np.arange(1, len(fine.segment), 37) * 0.001
    poses, rates = (np.array(each) for each in zip(*map(fine.at, times), strict=True))
    ahead, behind = (np.array([fine.at(t + d)[0] for t in times]) for d in (5e-4, -5e-4))
    assert_allclose((ahead - behind) / 1e-3, rates, atol=2e-3)
    if not action.in_air:  # where every stretch lasts whole ticks
        assert_allclose([path.at(t)[0] for t in times], poses, atol=5e-5)
        assert_allclose([path.at(t)[1] for t in times], rates, atol=3e-3)
    for time, there in ((-1.0, path.start), (1e3, path.at(path.duration)[0])):
        pose, rate = path.at(time)
        assert_allclose(pose, there)
        assert not rate.any()
    assert path.duration == pytest.approx(action.tool_path(SHAPE, np.zeros(3), 0.01).duration)


def test_a_turn_there_and_back_ends_where_it_began():
    profile = ACTIONS[0].profile(0.01)
    assert profile.distance[-1] == pytest.approx(0.0, abs=1e-12)
    assert profile.length == pytest.approx(math.radians(10) * (3.0 + RAMP_TIME))


@pytest.mark.parametrize("action", ACTIONS, ids=str)
def test_a_path_keeps_its_pivot_and_its_grasp_and_leads_on_from_its_start(action):
    path = action.centered_path(SHAPE, 0.6)
    part = np.linspace(-0.5, 0.5, 11)
    objects, tools = path.object_pose(part), path.tool_pose(part)
    grasp = SHAPE.grasps[action.grasp]
    assert_allclose(tools[5, :2], WORKSPACE, atol=1e-12)
    assert_allclose(tools[5, 2], 0.0, atol=1e-12)
    assert_allclose(transform_point(objects, grasp.position), tools[:, :2], atol=1e-12)
    assert_allclose(tools[:, 2] - objects[:, 2], grasp.angle)
    pivot = transform_point(objects, path.pivot)
    if not action.turns:
        assert_allclose(np.linalg.norm(pivot[-1] - pivot[0]), 0.6)
        heading = np.arctan2(*(pivot[-1] - pivot[0])[::-1]) - objects[0, 2]
        assert heading == pytest.approx(0.7)
    else:
        assert_allclose(pivot, np.tile(pivot[0], (11, 1)), atol=1e-12)
        assert objects[-1, 2] - objects[0, 2] == pytest.approx(math.copysign(0.6, action.steady[0].speed))
    again = action.path_from(SHAPE, 0.6, objects[0])
    assert_allclose(again.tool_pose(part), tools, atol=1e-12)
