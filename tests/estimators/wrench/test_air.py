"""Forward model of an object in the air, against Newton's law by particle and against true flaws of a setup."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from estimators.inertial.parts import column_parts
from estimators.testing.analytic_world import RATE, TOOL, drawn_object
from estimators.wrench.air import Air, Matter, columns, nominal
from estimators.wrench.setup import stated_sizes
from testbed.actions.lift import Lift
from testbed.frames import move_wrench, rotate_wrench, rotation_matrix, rotation_z
from testbed.sensing.compensation import SIDEWAYS, compensate, tool_pulls, tool_wrench
from testbed.sensing.lift_windows import LiftWindow, lift_windows
from testbed.trajectory import Phase, Trajectory
from testbed.worlds.setup_errors import PARAMETERS, SetupErrors
from tests.fakes.lifted_world import lifted

OBJECT, ACTION = drawn_object(1), Lift(0, hold=1.4)
MASS = torch.tensor(OBJECT.truth.mass)


def raw(record: Trajectory) -> np.ndarray:
    """Wrench that a perfect sensor reads: the tool's, and after the tare the object's too."""
    axes = rotation_matrix(record.sensor_orientation)
    own = rotate_wrench(axes.transpose(0, 2, 1), record.wrench_on_object_world)
    assert record.tool is not None
    held = ~record.mask(Phase.TARE)[:, None]
    return held * move_wrench(own, -record.tool.tcp) + tool_wrench(record.tool, record, axes)


PLAIN = lifted(OBJECT, ACTION)
PLAIN = replace(PLAIN, sensor_wrench=raw(PLAIN))
WINDOWS = lift_windows(compensate(PLAIN))


def felt(windows: list[LiftWindow]) -> np.ndarray:
    return np.array([window.wrench for window in windows])


def missing(record: Trajectory) -> np.ndarray:
    """Wrenches of a record over those that its masses take by its own motion."""
    windows = lift_windows(record)
    return felt(windows) - Air.of_masses(OBJECT.shape, windows).wrenches({"mass": MASS}).numpy()


def seen(record: Trajectory, **changes: object) -> np.ndarray:
    """Wrenches unexplained in a record with flaws."""
    return missing(compensate(replace(record, **changes)))  # pyright: ignore[reportArgumentType]


def test_the_wrench_of_given_masses_obeys_newton_and_is_linear_in_them():
    air = Air.of_masses(OBJECT.shape, WINDOWS)
    rows = air.linearized({"mass": MASS})[1]["mass"].numpy()
    for found in (air.wrenches({"mass": MASS}), rows @ OBJECT.truth.mass):
        assert_allclose(found, felt(WINDOWS), atol=1e-8 * np.abs(felt(WINDOWS)).max())


def test_a_body_is_its_groups_together():
    vectors = [part.vector * size for part, size in zip(column_parts(OBJECT.shape), OBJECT.group_mass, strict=True)]
    body = Matter.of_vector(torch.tensor(np.sum(vectors, axis=0)))
    groups = Matter.of_groups(OBJECT.shape).times(MASS).together()
    for name in ("mass", "first", "second"):
        assert_allclose(getattr(body, name), getattr(groups, name), atol=1e-12)


GAIN = np.array([0.01, -0.006, 0.004, 0.008, -0.01, 0.005])
CROSS = 1e-3 * np.random.default_rng(3).standard_normal((6, 6)) * (1 - np.eye(6))
ANGLE, COM, DELAY, HEAVIER = np.array([0.004, -0.003, 0.005]), np.array([1e-3, -5e-4, 8e-4]), 2 / RATE, 0.02
TURNED = Rotation.from_rotvec(ANGLE).as_matrix()[None]
LATE = np.maximum(np.arange(len(PLAIN.time_s)) - 2, 0)
TILT, TILTED = 0.004, lifted(OBJECT, ACTION, tilt=0.004)
ON_TOOL = tool_pulls(TOOL, rotation_matrix(PLAIN.sensor_orientation), SIDEWAYS)[:, 0]
OF_TCP = np.array([4e-4, -3e-4])  # along the axes of the hand, whose z is down
IN_OBJECT_AXES = (*(rotation_z(0.7)[:2, :2] @ [OF_TCP[0], -OF_TCP[1]]).tolist(), 0.0)
FLAWS = {
    "gain": (GAIN, lambda: seen(PLAIN, sensor_wrench=PLAIN.sensor_wrench * (1 + GAIN))),
    "crosstalk": (CROSS.ravel(), lambda: seen(PLAIN, sensor_wrench=PLAIN.sensor_wrench @ (np.eye(6) + CROSS).T)),
    "mounting_angle": (ANGLE, lambda: seen(PLAIN, sensor_wrench=rotate_wrench(TURNED, PLAIN.sensor_wrench))),
    "tool_mass": ([HEAVIER], lambda: seen(PLAIN, tool=replace(TOOL, mass=TOOL.mass - HEAVIER))),
    "tool_com": (COM, lambda: seen(PLAIN, tool=replace(TOOL, com=TOOL.com - COM))),
    "delay": (
        [DELAY],
        lambda: seen(
            PLAIN,
            **{
                name: getattr(PLAIN, name)[LATE]
                for name in ("tcp_position", "tcp_velocity", "sensor_orientation", "object_pose", "object_velocity")
            },
        ),
    ),
    "grasp_offset": ([4e-4, -3e-4], lambda: missing(lifted(OBJECT, ACTION, offset=(4e-4, -3e-4, 0.0)))),
    "tcp_offset": ([*OF_TCP, 0.0], lambda: missing(lifted(OBJECT, ACTION, offset=IN_OBJECT_AXES))),
    "table_tilt": ([TILT, 0.0], lambda: seen(TILTED, sensor_wrench=raw(TILTED) + TILT * ON_TOOL)),
}


@pytest.mark.parametrize("kind", FLAWS)
def test_derivatives_are_those_of_the_true_flaw(kind):
    size, flawed = FLAWS[kind]
    at = nominal({"mass": MASS}, {kind: torch.zeros(PARAMETERS[kind].sized(OBJECT.shape.n_m))})
    slopes = Air.of_masses(OBJECT.shape, WINDOWS).linearized(at)[1][kind].numpy()
    change, predicted = flawed(), slopes @ np.array(size)
    if kind == "tool_com":  # where the tool turns faster, its own inertia is 2 mN of it
        still = [not window.angular_acceleration.any() for window in WINDOWS]
        change, predicted = change[still], predicted[still]
    part = 0.15 if kind == "delay" else 0.03  # at the ends of a swing acceleration and spin come late too
    assert_allclose(predicted, change, atol=part * np.abs(change).max())


def test_errors_that_lifts_share_count_in_each_by_the_root_of_their_number():
    setup = SetupErrors(gain=0.01, grasp_offset=0.001, crosstalk=0.01)
    one, four = stated_sizes(setup, ("air", "reading"), trials=1), stated_sizes(setup, ("air", "reading"), trials=4)
    assert set(one) == {"gain", "grasp_offset", "crosstalk"}
    assert_allclose(four["gain"], 2 * one["gain"])
    assert_allclose(four["grasp_offset"], one["grasp_offset"])
    assert one["crosstalk"][0, 3] == pytest.approx(0.1) and one["crosstalk"][2, 2] == 0
    slopes = Air.of_masses(OBJECT.shape, WINDOWS).linearized(nominal({"mass": MASS}, one))[1]
    assert columns(slopes, one).shape == (6 * len(WINDOWS), 6 + 2 + 36)
