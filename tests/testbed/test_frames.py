"""Frames: moving a wrench is a group action, power does not depend on where or how it is written."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from testbed.frames import (
    cross_2d,
    move_wrench,
    perpendicular,
    pose_from_point,
    rotate_wrench,
    rotation_2d,
    rotation_matrix,
    transform_point,
)
from testbed.objects.model import GRAVITY


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(4)


@pytest.fixture
def wrench(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(8, 6))


@pytest.fixture
def rotation(rng: np.random.Generator) -> np.ndarray:
    return Rotation.from_quat(rng.normal(size=(8, 4))).as_matrix()


def test_a_weight_hung_off_the_gripper_pulls_with_the_agreed_sign():
    held = np.array([0, 0, 2.0 * GRAVITY, 0, 0, 0])  # holds 2 kg up, about the weight itself
    at_gripper = move_wrench(held, np.array([-0.1, 0, 0]))  # the weight is 0.1 m along x from the gripper
    assert_allclose(at_gripper, [0, 0, 19.62, 0, -1.962, 0], atol=1e-12)


def test_moving_and_turning_a_wrench_compose_commute_and_do_nothing_by_nothing(
    wrench: np.ndarray, rotation: np.ndarray, rng: np.random.Generator
):
    (a, b), other = rng.normal(size=(2, 8, 3)), rotation[::-1]
    moved, turned = move_wrench(wrench, a), rotate_wrench(rotation, wrench)
    assert_allclose(move_wrench(moved, b), move_wrench(wrench, a + b), atol=1e-12)
    assert_allclose(rotate_wrench(other, turned), rotate_wrench(other @ rotation, wrench), atol=1e-12)
    turned_lever = np.einsum("nij,nj->ni", rotation, a)
    assert_allclose(rotate_wrench(rotation, moved), move_wrench(turned, turned_lever), atol=1e-12)
    assert np.array_equal(move_wrench(wrench, np.zeros(3)), wrench)
    assert np.array_equal(rotate_wrench(np.eye(3), wrench), wrench)


def test_power_depends_neither_on_the_point_nor_on_the_axes(
    wrench: np.ndarray, rotation: np.ndarray, rng: np.random.Generator
):
    twist, to = rng.normal(size=(8, 6)), rng.normal(size=(8, 3))
    power = np.sum(wrench * twist, -1)
    at_point = np.hstack([twist[:, :3] + np.cross(twist[:, 3:], to), twist[:, 3:]])
    assert_allclose(np.sum(move_wrench(wrench, to) * at_point, -1), power, atol=1e-12)
    turned = rotate_wrench(rotation, wrench) * rotate_wrench(rotation, twist)
    assert_allclose(turned.sum(-1), power, atol=1e-12)


def test_a_pose_from_a_point_puts_the_point_there(rng: np.random.Generator):
    target, yaw, point = rng.normal(size=(8, 2)), rng.uniform(-4, 4, 8), rng.normal(size=2)
    pose = pose_from_point(target, point, yaw)
    assert_allclose(pose[:, 2], yaw)
    assert_allclose(transform_point(pose, point), target, atol=1e-12)
    assert_allclose(pose_from_point(transform_point(pose[0], point), point, pose[0, 2]), pose[0], atol=1e-12)


def test_planar_rotations_turn_counter_clockwise_and_add_up(rng: np.random.Generator):
    assert_allclose(rotation_2d(np.pi / 2) @ [1, 0], [0, 1], atol=1e-15)
    a, b = rng.uniform(-4, 4, (2, 8))
    assert_allclose(rotation_2d(a) @ rotation_2d(b), rotation_2d(a + b), atol=1e-12)


def test_perpendicular_and_cross_are_the_planar_parts_of_the_spatial_cross(rng: np.random.Generator):
    a, b = rng.normal(size=(2, 8, 2))
    spatial = np.cross(np.column_stack([a, np.zeros(8)]), np.column_stack([b, np.zeros(8)]))
    assert_allclose(cross_2d(a, b), spatial[:, 2], atol=1e-12)
    assert_allclose(perpendicular(a), np.cross([0, 0, 1], np.column_stack([a, np.zeros(8)]))[:, :2], atol=1e-12)


def test_quaternions_have_the_scalar_first():
    half = np.sqrt(0.5)
    assert_allclose(rotation_matrix(np.array([half, 0, 0, half])) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
