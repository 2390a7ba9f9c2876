"""Object poses by a camera: for objects that the hand does not hold, and compared with the hand's poses."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from testbed.frames import rotation_2d
from testbed.objects.faces import room_at
from testbed.objects.model import ObjectShape
from testbed.sensing.camera import LEAST_FRAMES, PoseStream
from testbed.sensing.push_windows import touching
from testbed.sensing.series import interpolated
from testbed.trajectory import Phase, Trajectory

APART = 0.015, math.radians(6)
"""Largest distance [m] and angle [rad] between the object's poses by hand and by camera."""
DELAY = 0.06
"""Largest error of a delay beyond the stated one [s]."""
SCALE = 0.04
"""Largest relative error of distances: a ruler that is 4 % too long."""
_SURE = 3.0
"""Standard errors by which an error must exceed its limit; also the largest ratio of scatter to that stated."""
_BEFORE = 0.5
"""Time at rest before the motion that is compared too [s]."""
_REST, _CLEAR = 1.5, 0.15
"""Time at rest before the first contact, and time around it that is left out [s]: fingertip slows, force rises."""
_TOUCH = 0.0005
"""Standard deviation of the fingertip's position at the first contact by the force [m]."""
_FACE = 0.0005
"""Error of the outline over a push [m]."""
_MEDIAN = 0.6745
"""Median size of white noise over its standard deviation."""


def with_camera_poses(record: Trajectory) -> Trajectory:
    """Record with the object's poses by its camera if the hand does not hold it; at rest where frames were lost.

    Without a camera, or without frames, it is the record itself.
    """
    if record.action.grasp is not None or record.camera is None:
        return record
    motion = record.camera.motion(record.time_s)
    measured = np.flatnonzero(~np.isnan(motion.pose[:, 0]))
    if len(measured) == 0:
        return record
    following = measured[np.searchsorted(measured, np.arange(len(record.time_s))).clip(max=len(measured) - 1)]
    twist = np.where(np.isnan(motion.twist), 0.0, motion.twist)
    return replace(record, object_pose=motion.pose[following], object_velocity=twist)


def frame_mismatch(record: Trajectory, shape: ObjectShape) -> str:
    """Message when hand and camera disagree; empty if they agree.

    For a held object, the camera's poses are compared with the hand's; for a push, the object's face with the fingertip
    from the first contact on, which the force shows. Detected are an offset, a delay, a wrong scale, and more scatter
    than stated. No single trial shows a constant shift along the face, or a yaw within `APART`.

    Args:
        record: compensated record; without poses of a camera, or without motion, the message is empty.
        shape: geometry of the object.
    """
    if record.camera is None or not record.action.on_table or not _moving(record).any():
        return ""
    check = _of_push if record.action.pushes else _of_held
    return check(record, shape, record.camera) or _scatter(record, record.camera)


def _of_held(record: Trajectory, shape: ObjectShape, camera: PoseStream) -> str:
    grasp = record.action.grasp
    assert grasp is not None
    chain, held = shape.chain, shape.pressed(shape.grasps[grasp])
    poses = camera.poses[:, 0 if chain is None else chain.link[held[0]]]
    moved = record.time_s[_moving(record)]
    kept = ~np.isnan(poses[:, 0]) & (camera.time_s >= moved[0] - _BEFORE) & (camera.time_s <= moved[-1])
    if not kept.any():
        return ""
    time = camera.time_s[kept]
    by_hand, speed = (
        interpolated(time, record.time_s, series) for series in (record.object_pose, record.object_velocity)
    )
    difference = poses[kept] - by_hand
    difference[:, 2] -= math.tau * round(float(np.median(difference[:, 2])) / math.tau)
    shift = float(np.median(np.linalg.norm(difference[:, :2], axis=1)))
    turn = float(np.median(difference[:, 2]))
    if shift > APART[0] or abs(turn) > APART[1]:
        return (
            f"it sees what is held {shift * 1e3:.0f} mm and {math.degrees(turn):+.0f} deg from where the hand has it; "
            f"allowed: {APART[0] * 1e3:.0f} mm and {math.degrees(APART[1]):.0f} deg"
        )
    # difference = constant - delay * velocity + (scale - 1) * path, in units of the noise; no scale changes an angle
    std = _noise(camera)
    path = (by_hand - by_hand[0]) * [1.0, 1.0, 0.0]
    columns = [np.tile(each, (len(time), 1)) for each in np.eye(3)] + [-speed, path]
    design = np.stack([(column / std).ravel() for column in columns], axis=1)
    (delay, delay_std), (scale, scale_std) = _fitted(design, (difference / std).ravel())[3:]
    return _late(delay, delay_std, camera) or _scaled(scale, scale_std)


def _of_push(record: Trajectory, shape: ObjectShape, camera: PoseStream) -> str:
    """Message from the gap between fingertip and face, which is 0 from the first contact on."""
    tip, contact = record.action.fingertip(shape), touching(record)
    assert tip is not None
    begin, radius = record.time_s[contact[0]], tip.radius
    whole = ~np.isnan(camera.poses[:, 0]).any(axis=1)
    time, poses = camera.time_s[whole], camera.poses[whole, 0]
    rests = (time > begin - _REST) & (time < begin - _CLEAR)
    if not rests.any():
        return ""
    rest = np.median(poses[rests], axis=0)
    first = _gaps(shape, rest[None], record.tcp_position[contact[:1], :2], radius)[0]
    if abs(first) > APART[0]:
        return _beside(first)
    pushed = np.flatnonzero((time > begin + _CLEAR) & (time < record.time_s[contact[-1]]))
    tips = interpolated(time[pushed], record.time_s, record.tcp_position[:, :2])
    gaps = _gaps(shape, poses[pushed], tips, radius)
    if len(pushed) < LEAST_FRAMES:
        return ""
    if abs(middle := float(np.median(gaps))) > APART[0]:
        return _beside(middle)
    speed = float(np.median(np.linalg.norm(record.tcp_velocity[contact, :2], axis=1)))
    path = speed * (time[pushed] - begin)
    std = _noise(camera)[0]
    design = np.stack([np.ones(len(path)), path - path.mean()], axis=1) / std
    (level, level_std), (slope, slope_std) = _fitted(design, gaps / std)
    # With a delay the face lies behind the fingertip
    delay, delay_std = -(level - first) / speed, math.hypot(level_std, std / math.sqrt(rests.sum()), _TOUCH) / speed
    return _late(delay, delay_std, camera) or _scaled(slope, slope_std + _FACE / float(np.ptp(path)))


def _gaps(shape: ObjectShape, poses: np.ndarray, tips: np.ndarray, radius: float) -> np.ndarray:
    """Distance between a fingertip and the outline in each frame [m], negative inside."""
    points = np.einsum("nij,nj->ni", rotation_2d(-poses[:, 2]), tips - poses[:, :2])
    return np.array([room_at(shape, point) for point in points]) - radius


def _fitted(design: np.ndarray, values: np.ndarray) -> list[tuple[float, float]]:
    """Least squares in units of the noise: each unknown and its standard deviation."""
    inverse = np.linalg.pinv(design)
    left = values - design @ (inverse @ values)
    scatter = max(1.0, float(np.sqrt(left @ left / max(len(values) - design.shape[1], 1))))
    return list(zip((inverse @ values).tolist(), (scatter * np.linalg.norm(inverse, axis=1)).tolist(), strict=True))


def _late(delay: float, std: float, camera: PoseStream) -> str:
    allowed = DELAY + _SURE * math.hypot(std, camera.delay_std)
    if abs(delay) <= allowed:
        return ""
    return (
        f"its poses are {abs(delay) * 1e3:.0f} ms {'late' if delay > 0 else 'early'} against the hand; allowed: "
        f"{allowed * 1e3:.0f} ms; state its delay"
    )


def _scaled(scale: float, std: float) -> str:
    allowed = SCALE + _SURE * std
    if abs(scale) <= allowed:
        return ""
    return f"its distances are {1e2 * scale:+.0f} % off the hand's; allowed: {1e2 * allowed:.0f} %"


def _beside(gap: float) -> str:
    return f"it sees the face {gap * 1e3:+.0f} mm from the fingertip that pushes it; allowed: {APART[0] * 1e3:.0f} mm"


def _scatter(record: Trajectory, camera: PoseStream) -> str:
    """Message if the frames scatter about a smooth motion by much more than stated."""
    moved = record.time_s[_moving(record)]
    inside = (camera.time_s >= moved[0]) & (camera.time_s <= moved[-1])
    for poses in camera.poses[inside].transpose(1, 0, 2):
        seen = ~np.isnan(poses).any(axis=1)
        measured, time = poses[seen], camera.time_s[inside][seen]
        if len(measured) < LEAST_FRAMES:
            continue
        share = (np.diff(time)[:-1] / (time[2:] - time[:-2]))[:, None]  # frames may be lost, or come unevenly
        off = measured[1:-1] - (1 - share) * measured[:-2] - share * measured[2:]
        usual = np.median(np.abs(off) / np.sqrt(1 + share**2 + (1 - share) ** 2), axis=0) / _MEDIAN
        most = _SURE * _noise(camera)
        if (usual > most).any():
            return (
                f"its frames scatter by {usual[:2].max() * 1e3:.1f} mm and {math.degrees(usual[2]):.2f} deg; allowed: "
                f"{most[0] * 1e3:.1f} mm and {math.degrees(most[2]):.2f} deg, three times what is stated"
            )
    return ""


def _moving(record: Trajectory) -> np.ndarray:
    return record.mask(Phase.RAMP, Phase.STEADY)


def _noise(camera: PoseStream) -> np.ndarray:
    """Standard deviation of a frame's pose as stated, at least that of a good camera [m, m, rad], shape (3,)."""
    return np.maximum([camera.position_std, camera.position_std, camera.angle_std], [5e-4, 5e-4, 2e-3])
