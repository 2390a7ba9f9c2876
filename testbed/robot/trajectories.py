"""Trajectories of the real robot, the same value as simulated ones: from its records, and from a scale's reading."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.actions.weigh import Weigh
from testbed.frames import origin_velocity, pose_from_point, rotation_matrix
from testbed.objects.model import GRAVITY
from testbed.robot.config import RobotSettings
from testbed.robot.path import RobotPlan, closing_yaw
from testbed.robot.recorder import Record
from testbed.robot.weighing import weigh
from testbed.sensing.compensation import compensate
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
    """Trajectory of a turn, a slide or a weighing, compensated if the sensor has been tared."""
    pose = object_poses(plan, record, settings)
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
        object_velocity=origin_velocity(record.tcp_velocity, pose[:, 2], plan.grasp.position),
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
    """Planar pose of the object from the hand's [m, rad], shape (T, 3): true if it does not slip."""
    yaw = np.unwrap(closing_yaw(record.tcp_orientation, settings)) - plan.grasp.angle
    return pose_from_point(record.tcp_position[:, :2], plan.grasp.position, yaw)


def lifted(measured: Trajectory) -> Trajectory:
    """A weighing by lifting as a scale's reading: z of wrench_on_object_world.

    `figures["weight_std_kg"]` is its standard error: bias after the tare, walk of the zero since then, and the scatter
    of both readings.
    """
    kept = measured.mask(Phase.STEADY)
    axes = rotation_matrix(measured.sensor_orientation[kept][0])
    empty = np.flatnonzero(measured.mask(Phase.TARE) & (measured.time_s < measured.time_s[kept][0]))
    empty = empty[len(empty) // 3 :]
    since = measured.time_s[kept].mean() - measured.time_s[empty].mean()
    moved = float(np.hypot(measured.sensor_bias_std[2], measured.sensor_drift_std[2] * np.sqrt(since)))
    reading = weigh(measured.sensor_wrench[empty], measured.sensor_wrench[kept], axes[2], drift=moved)
    return replace(
        measured,
        time_s=measured.time_s[kept] - measured.time_s[kept][0],
        phase=measured.phase[kept],
        segment=np.zeros(kept.sum(), dtype=int),
        object_pose=measured.object_pose[kept],
        object_velocity=measured.object_velocity[kept],
        tcp_position=measured.tcp_position[kept],
        tcp_velocity=measured.tcp_velocity[kept],
        sensor_orientation=measured.sensor_orientation[kept],
        sensor_wrench=measured.sensor_wrench[kept],
        wrench_on_object_world=measured.wrench_on_object_world[kept],
        joint_position=measured.joint_position[kept],
        tool=None,
        figures=measured.figures | {"weight_kg": reading.mass, "weight_std_kg": reading.standard_error},
    )


def read_off(weight: float) -> Trajectory:
    """A user's reading of a scale [kg] as a trajectory of one sample."""
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
        provenance={"runner": "robot", "recorded": timestamp(), "weight": "read off a scale"},
    )


def timestamp() -> str:
    """Time now, UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")
