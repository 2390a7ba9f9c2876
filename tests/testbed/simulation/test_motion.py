"""Planned motions: the tool goes where the action says, at the speed it says."""

import math

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from testbed.actions.accelerate import Accelerate
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.errors import InfeasibleTrialError
from testbed.frames import pose_from_point, transform_point
from testbed.objects.files import load_object
from testbed.simulation.motion import Motion, arm_model, joint_path, plan_motion
from testbed.simulation.scene import HOME
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Phase

OBJECT = load_object("L2")
SETTINGS = SimulationSettings()


def tool_poses(motion: Motion, keep: np.ndarray) -> np.ndarray:
    """x, y, z, yaw of the TCP at the kept ticks, (N, 4)."""
    model = arm_model()
    data = mujoco.MjData(model)
    poses = []
    for q in motion.q[keep]:
        data.qpos[:7] = q
        mujoco.mj_kinematics(model, data)
        closing = data.site("gripper/tcp").xmat.reshape(3, 3)[:, 0]
        poses.append([*data.site("gripper/tcp").xpos, math.atan2(closing[1], closing[0])])
    return np.array(poses)


@pytest.mark.parametrize("pivot", [None, (0.01, -0.02)])
def test_a_turn_keeps_its_pivot_and_its_speed(pivot):
    grasp = OBJECT.shape.grasps[2]
    motion = plan_motion(Rotate(2, duration=6.0, pivot=pivot, back=True), OBJECT.shape, SETTINGS)
    steady = motion.phase == Phase.STEADY
    poses = tool_poses(motion, steady)
    yaw = np.unwrap(poses[:, 3]) - grasp.angle
    center = transform_point(
        pose_from_point(poses[:, :2], grasp.position, yaw), grasp.position if pivot is None else np.array(pivot)
    )
    assert_allclose(center, np.broadcast_to(center[0], center.shape), atol=2e-5)
    assert_allclose(poses[:, 2], SETTINGS.grip.tcp_height, atol=2e-6)
    there = motion.segment[steady] == 0
    assert_allclose(np.diff(yaw[there]) * 100, math.radians(10), rtol=1e-3)
    assert_allclose(np.diff(yaw[~there]) * 100, -math.radians(10), rtol=1e-3)


def test_a_slide_is_straight_and_steady():
    motion = plan_motion(Slide(0, direction=0.5, duration=2.0), OBJECT.shape, SETTINGS)
    steps = np.diff(tool_poses(motion, motion.phase == Phase.STEADY)[:, :2], axis=0) * 100
    assert_allclose(np.linalg.norm(steps, axis=1), 0.05, rtol=1e-3)
    assert np.ptp(np.arctan2(steps[:, 1], steps[:, 0])) < 1e-3


def test_accelerations_are_held_one_after_the_other():
    action = Accelerate(1)
    motion = plan_motion(action, OBJECT.shape, SETTINGS)
    for segment, wanted in enumerate(action.accelerations):
        rate = motion.qd[motion.segment == segment, 6]
        assert_allclose(np.diff(np.abs(rate)).mean() * 100, wanted, rtol=2e-2)


def test_the_object_lies_under_the_open_gripper_before_the_grasp():
    for action in (Rotate(0), Slide(3, direction=2.0)):
        grasp = OBJECT.shape.grasps[action.grasp]
        motion = plan_motion(action, OBJECT.shape, SETTINGS)
        pose = tool_poses(motion, np.array([0]))[0]
        assert_allclose(transform_point(motion.object_pose, grasp.position), pose[:2], atol=1e-6)
        assert math.cos(motion.object_pose[2] + grasp.angle - pose[3]) == pytest.approx(1.0)


def test_out_of_reach_is_refused_with_the_place():
    with pytest.raises(InfeasibleTrialError, match=r"reach: .*x=1\.200"):
        joint_path(np.array([[1.2, 0.0, 0.02, 0.0]]), np.array(HOME))
