"""From a real bench's record to a `Trajectory`: the same value that the simulated bench gives."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.actions import Weigh
from testbed.frames import perpendicular, pose_from_point, rotation_2d, rotation_matrix
from testbed.objects import GRAVITY
from testbed.robot.plan import RobotPlan, closing_yaw
from testbed.robot.recorder import Record
from testbed.robot.settings import RobotSettings
from testbed.robot.weighing import weigh
from testbed.sensing import compensate
from testbed.trajectory import Phase, Status, Trajectory


def trajectory_of(
    plan: RobotPlan,
    record: Record,
    settings: RobotSettings,
    status: Status,
    reason: str,
    figures: dict[str, float],
    provenance: dict[str, str],
) -> Trajectory:
    """The trajectory of a turn, a slide or a lift, compensated where the sensor has been zeroed."""
    pose, rate = object_poses(plan, record, settings), record.tcp_velocity[:, 5]
    lever = np.einsum("nij,j->ni", rotation_2d(pose[:, 2]), -plan.grasp.position)
    tool = Rotation.from_quat(record.tcp_orientation, scalar_first=True)
    sensor = tool * Rotation.from_quat(settings.sensor_orientation, scalar_first=True)
    count = len(record.time_s)
    whole = Trajectory(
        action=plan.trial.action,
        status=status,
        reason=reason,
        time_s=record.time_s - record.time_s[0],
        phase=record.phase,
        segment=record.segment,
        object_pose=pose,
        object_velocity=np.column_stack([record.tcp_velocity[:, :2] + rate[:, None] * perpendicular(lever), rate]),
        tcp_position=record.tcp_position - [0.0, 0.0, settings.table_height],
        tcp_velocity=record.tcp_velocity,
        sensor_orientation=sensor.as_quat(scalar_first=True),
        sensor_wrench=settings.sensor_sign * record.wrench,
        wrench_on_object_world=np.zeros((count, 6)),
        joint_position=record.joint_position,
        tool=settings.tool,
        sensor_bias_std=np.repeat(settings.bias_std, 3),
        sensor_drift_std=np.repeat(settings.drift_std, 3),
        figures=figures,
        provenance=provenance,
    )
    return compensate(whole) if whole.mask(Phase.TARE).any() else whole


def object_poses(plan: RobotPlan, record: Record, settings: RobotSettings) -> Float[np.ndarray, "T 3"]:
    """Planar pose of the object as the hand knows it, m and rad, (T, 3): where it would be if it did not slip."""
    yaw = np.unwrap(closing_yaw(record.tcp_orientation, settings)) - plan.grasp.angle
    return pose_from_point(record.tcp_position[:, :2], plan.grasp.position, yaw)


def lifted(felt: Trajectory) -> Trajectory:
    """A lift as a scale's reading: what hung in the gripper, wrench_on_object_world z.

    `figures["weight_std_kg"]` is its standard error: what the tare may leave, how far the zero may have walked since,
    and the scatter of both readings.
    """
    kept = felt.mask(Phase.STEADY)
    axes = rotation_matrix(felt.sensor_orientation[kept][0])
    empty = np.flatnonzero(felt.mask(Phase.TARE) & (felt.time_s < felt.time_s[kept][0]))
    empty = empty[len(empty) // 3 :]
    since = felt.time_s[kept].mean() - felt.time_s[empty].mean()
    moved = float(np.hypot(felt.sensor_bias_std[2], felt.sensor_drift_std[2] * np.sqrt(since)))
    reading = weigh(felt.sensor_wrench[empty], felt.sensor_wrench[kept], axes[2], drift=moved)
    return replace(
        felt,
        time_s=felt.time_s[kept] - felt.time_s[kept][0],
        phase=felt.phase[kept],
        segment=np.zeros(kept.sum(), dtype=int),
        object_pose=felt.object_pose[kept],
        object_velocity=felt.object_velocity[kept],
        tcp_position=felt.tcp_position[kept],
        tcp_velocity=felt.tcp_velocity[kept],
        sensor_orientation=felt.sensor_orientation[kept],
        sensor_wrench=felt.sensor_wrench[kept],
        wrench_on_object_world=felt.wrench_on_object_world[kept],
        joint_position=felt.joint_position[kept],
        tool=None,
        figures=felt.figures | {"weight_kg": reading.mass, "weight_std_kg": reading.standard_error},
    )


def read_off(weight: float) -> Trajectory:
    """A scale's reading (kg) that a user gave, as a trajectory of one sample."""
    wrench = np.array([[0.0, 0.0, weight * GRAVITY, 0.0, 0.0, 0.0]])
    return Trajectory(
        action=Weigh(),
        status="ok",
        reason="",
        time_s=np.zeros(1),
        phase=np.array([Phase.STEADY]),
        segment=np.zeros(1, dtype=int),
        object_pose=np.zeros((1, 3)),
        object_velocity=np.zeros((1, 3)),
        tcp_position=np.zeros((1, 3)),
        tcp_velocity=np.zeros((1, 6)),
        sensor_orientation=np.array([[1.0, 0.0, 0.0, 0.0]]),
        sensor_wrench=wrench,
        wrench_on_object_world=wrench,
        joint_position=np.zeros((1, 7)),
        tool=None,
        sensor_bias_std=np.zeros(6),
        provenance={"runner": "robot", "recorded": now_in_words(), "weight": "read off a scale"},
    )


def now_in_words() -> str:
    """The moment, in UTC, as ISO 8601 has it."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")
