"""Errors of arm and sensor in a world, applied to a clean record; noise, bias and drift are added afterwards."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from testbed.frames import perpendicular, rotate_wrench, rotation_2d, rotation_matrix
from testbed.sensing.presets import Sensing
from testbed.sensing.series import interpolated
from testbed.trajectory import Tool, Trajectory
from testbed.worlds.draw import WorldDraw
from testbed.worlds.parameters import FULL_SCALE

REACH = 0.5
"""Lever from the base of the arm to the TCP, at which noise of an encoder moves the TCP [m]."""
_POSES = ("object_pose", "object_velocity", "tcp_position", "tcp_velocity", "sensor_orientation", "joint_position")


def as_measured(clean: Trajectory, draw: WorldDraw) -> Trajectory:
    """Record of a clean trial with the errors of arm and sensor, before noise, bias and drift."""
    assert clean.tool is not None
    wrench = rotate_wrench(mounting(draw), clean.sensor_wrench) @ response(draw).T
    wrench = _filtered(wrench, clean.time_s, draw.world.low_pass)
    stated = _by_stated_tcp(clean, draw)
    tool = Tool(
        max(clean.tool.mass + draw.normal("tool_mass", 1)[0], 0.0),
        clean.tool.com + draw.normal("tool_com", 3),
        clean.tool.inertia,
        clean.tool.tcp + draw.normal("tcp_offset", 3),
    )
    return _late_and_noisy(replace(stated, sensor_wrench=wrench, tool=tool), draw)


def mounting(draw: WorldDraw) -> Float[np.ndarray, "3 3"]:
    """Matrix from components in the stated axes of the sensor to those in its true axes, shape (3, 3)."""
    return Rotation.from_rotvec(draw.normal("mounting_angle", 3)).as_matrix()


def response(draw: WorldDraw) -> Float[np.ndarray, "6 6"]:
    """Matrix from a wrench in the sensor's axes to its reading: gains and cross-talk, (6, 6)."""
    matrix = draw.normal("crosstalk", 36).reshape(6, 6) * np.outer(FULL_SCALE, 1 / FULL_SCALE)
    np.fill_diagonal(matrix, 1 + draw.normal("gain", 6))
    return matrix


def true_sensing(stated: Sensing, draw: WorldDraw) -> Sensing:
    """Sensor with true bias and drift other than the stated ones."""
    bias, drift = draw.world.zero_factor ** draw.rng("zero_factor").uniform(-1, 1, 2)
    return replace(stated, true_bias=stated.true_bias * bias, true_drift=stated.true_drift * drift)


def rounded(wrench: Float[np.ndarray, "T 6"], draw: WorldDraw) -> Float[np.ndarray, "T 6"]:
    """Wrench rounded to the resolution of the sensor, (T, 6)."""
    found = np.array(wrench)
    for axes, step in ((slice(0, 3), draw.world.force_resolution), (slice(3, 6), draw.world.torque_resolution)):
        if step:
            found[:, axes] = np.round(found[:, axes] / step) * step
    return found


def _filtered(wrench: np.ndarray, time: np.ndarray, constant: float) -> np.ndarray:
    """Wrench after a first-order low-pass filter, in steady state at the first sample."""
    if not constant or len(time) < 2:
        return wrench
    keep = np.exp(-float(np.median(np.diff(time))) / constant)
    return lfilter([1 - keep], [1.0, -keep], wrench, axis=0, zi=keep * wrench[:1])[0]


def _by_stated_tcp(clean: Trajectory, draw: WorldDraw) -> Trajectory:
    """Record with TCP and object at the poses that follow from the stated TCP."""
    offset, turn = draw.normal("tcp_offset", 3), draw.normal("tcp_angle", 1)[0]
    if not (offset.any() or turn):
        return clean
    shift = rotation_matrix(clean.sensor_orientation) @ offset
    tcp = clean.tcp_position + shift
    velocity = np.array(clean.tcp_velocity)
    velocity[:, :3] += np.cross(velocity[:, 3:], shift)
    arm = (clean.object_pose[:, :2] - clean.tcp_position[:, :2]) @ rotation_2d(turn).T
    pose = np.column_stack([tcp[:, :2] + arm, clean.object_pose[:, 2] + turn])
    planar = np.column_stack([velocity[:, :2] + velocity[:, 5:] * perpendicular(arm), velocity[:, 5]])
    return replace(clean, tcp_position=tcp, tcp_velocity=velocity, object_pose=pose, object_velocity=planar)


def _late_and_noisy(record: Trajectory, draw: WorldDraw) -> Trajectory:
    """Record with delayed poses and noise of the encoders."""
    time, world = record.time_s, draw.world
    series = {name: np.array(getattr(record, name)) for name in _POSES}
    if world.delay:
        delayed = time - world.delay * draw.rng("delay").uniform()
        series = {name: interpolated(delayed, time, values) for name, values in series.items()}
        series["sensor_orientation"] /= np.linalg.norm(series["sensor_orientation"], axis=1, keepdims=True)
    noise = draw.normal("encoder_noise", 10 * len(time), record.action).reshape(-1, 10)
    place = REACH * noise[:, :2]
    series["joint_position"] += noise[:, 3:]
    series["tcp_position"][:, :2] += place
    series["object_pose"][:, :2] += place
    series["object_pose"][:, 2] += noise[:, 2]
    return replace(record, **series)
