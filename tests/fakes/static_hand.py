"""A hand held still in many ways with a sensor on it, by the lever law alone."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation, Slerp

from testbed.objects.model import GRAVITY
from testbed.robot.calibration.static_poses import Calibration, StaticPose

DOWN = Rotation.from_euler("x", 180, degrees=True)
"""Hand pointing at the table."""
POSES = [
    DOWN * Rotation.from_euler("xyz", angles, degrees=True)
    for angles in ((0, 0, 0), (40, 0, 0), (-40, 0, 0), (0, 40, 0), (0, -40, 0), (30, 30, 0), (90, 0, 0), (0, 90, 90))
]
"""Orientations of the hand in the base frame."""
MASS, COM = 0.93, np.array([0.003, -0.002, 0.061])
"""Mass and center of the tool [kg, m], hand axes."""
BIAS = np.array([5.0, -3.0, 8.0, 0.1, 0.2, -0.3])
ERROR = np.array([0.012, 0.014, 0.011, 6e-4, 5e-4, 2e-4])
"""Standard error of a pose's mean: some seconds of an FT-300S."""


def readings(
    mount: Rotation,
    sign: int = 1,
    *,
    noise: float = 0.0,
    seed: int = 0,
    hands: Sequence[Rotation] = POSES,
    torque_sign: int = 1,
) -> list[StaticPose]:
    """Readings of a sensor with this orientation in the hand, with `noise` times ERROR.

    A `sign` of -1 is of a sensor that reports what the tool does to the arm; `torque_sign` is of its torque alone.
    """
    rng = np.random.default_rng(seed)
    poses = []
    for hand in hands:
        up = (hand * mount).inv().apply([0.0, 0.0, 1.0])
        force = MASS * GRAVITY * up
        torque = torque_sign * np.cross(mount.inv().apply(COM), force)
        wrench = sign * np.concatenate([force, torque]) + BIAS + noise * ERROR * rng.standard_normal(6)
        poses.append(StaticPose(hand.as_quat(scalar_first=True), wrench, ERROR))
    return poses


RATE = 100.0
NOISE = np.array([0.1, 0.1, 0.1, 0.005, 0.005, 0.005])
MAPPING = """
[time]
column = "t"
[sensor]
force = ["fx", "fy", "fz"]
torque = ["tx", "ty", "tz"]
[hand]
position = ["x", "y", "z"]
orientation = ["qw", "qx", "qy", "qz"]
"""
MOUNT = Rotation.from_euler("xyz", (10, -20, 130), degrees=True)


def recorded(folder: Path, *, rest_s=2.0, way_s=2.0, sign=1, gain=None, seed=0) -> tuple[Path, Path]:
    """A recording of a hand that goes from pose to pose and rests in each, and its mapping."""
    rng, times = np.random.default_rng(seed), [0.0]
    hands = [hand for hand in POSES for _ in range(2)]
    for k in range(1, len(hands)):
        times.append(times[-1] + max(rest_s if k % 2 else way_s, 1e-6))
    time = np.arange(round(times[-1] * RATE)) / RATE
    hand = Slerp(times, Rotation.concatenate(hands))(time)
    up = (hand * MOUNT).inv().apply([0.0, 0.0, 1.0])
    force = MASS * GRAVITY * up
    load = np.hstack([force, np.cross(MOUNT.inv().apply(COM), force)])
    wrench = sign * load * (1 if gain is None else gain) + BIAS + NOISE * rng.standard_normal((len(time), 6))
    columns = np.column_stack([time, wrench, np.zeros((len(time), 3)), hand.as_quat(scalar_first=True)])
    names = ["t", "fx", "fy", "fz", "tx", "ty", "tz", "x", "y", "z", "qw", "qx", "qy", "qz"]
    pd.DataFrame(columns, columns=names).to_csv(folder / "log.csv", index=False)
    (folder / "map.toml").write_text(MAPPING, encoding="utf-8")
    return folder / "log.csv", folder / "map.toml"


def off(found: Calibration, mount: Rotation = MOUNT) -> np.ndarray:
    """Errors over those that it claims: mount, mass, center and bias."""
    turn = (mount.inv() * Rotation.from_quat(found.sensor_in_hand, scalar_first=True)).as_rotvec()
    com = mount.inv().apply(COM)
    return np.concatenate([
        turn / found.sensor_in_hand_std,
        [(found.mass - MASS) / found.mass_std],
        (found.com - com) / found.com_std,
        (found.bias - BIAS) / found.bias_std,
    ])  # fmt: skip
