"""Another bench's logs, made from a trajectory: odd units, frames and rates, and the mapping to them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation, Slerp

from testbed.toml import toml_text
from testbed.trajectory import Trajectory

MOUNT = Rotation.from_euler("xyz", [180, 0, 123], degrees=True)
"""Mount of the sensor on the other robot's hand: upside down, and turned."""
TCP_IN_HAND = np.array([0.01, -0.02, 0.15])
TABLE = 0.033
"""Height of its table in its arm's base frame, m."""
EPOCH = 1_767_225_600.0
"""Time of its clock at the begin of the log [s]."""


def columns(t: Trajectory) -> dict[str, np.ndarray]:
    """The record as the other bench would log it: kgf, mm, xyzw, degrees, the sensor's sign turned."""
    sensor = Rotation.from_quat(t.sensor_orientation, scalar_first=True)
    hand = sensor * MOUNT.inv()
    position = 1e3 * (t.tcp_position + TABLE * np.eye(3)[2] - hand.apply(TCP_IN_HAND))
    said = {f"f{a}": -t.sensor_wrench[:, i] / 9.80665 for i, a in enumerate("xyz")}
    said |= {f"t{a}": -1e3 * t.sensor_wrench[:, 3 + i] for i, a in enumerate("xyz")}
    said |= {f"p{a}": position[:, i] for i, a in enumerate("xyz")}
    said |= {f"q{a}": hand.as_quat()[:, i] for i, a in enumerate("xyzw")}
    said |= {f"j{i + 1}": np.degrees(t.joint_position[:, i]) for i in range(7)}
    return said


def mapping_of(t: Trajectory, **changes: Any) -> dict[str, Any]:
    """The mapping to `columns`; None removes a table."""
    assert t.tool is not None
    hand = Rotation.from_quat(t.sensor_orientation[0], scalar_first=True) * MOUNT.inv()
    along = hand.inv().apply(closing_axis(t))
    said: dict[str, Any] = {
        "object": "L2",
        "action": t.action.to_dict(),
        "time": {"column": "stamp", "unit": "ms"},
        "sensor": {
            "force": ["fx", "fy", "fz"],
            "torque": ["tx", "ty", "tz"],
            "force_unit": "kgf",
            "torque_unit": "N mm",
            "sign": -1,
            "in_hand_wxyz": MOUNT.as_quat(scalar_first=True).tolist(),
        },
        "hand": {
            "position": ["px", "py", "pz"],
            "position_unit": "mm",
            "orientation": ["qx", "qy", "qz", "qw"],
            "orientation_as": "xyzw",
            "tcp_in_hand_m": TCP_IN_HAND.tolist(),
            "closing_deg": float(np.degrees(np.arctan2(along[1], along[0]))),
            "table_height_m": TABLE,
        },
        "tool": {
            "mass_kg": t.tool.mass,
            "com_m": t.tool.com.tolist(),
            "inertia_kg_m2": t.tool.inertia.tolist(),
            "tcp_m": t.tool.tcp.tolist(),
        },
        "joints": {"position": [f"j{i}" for i in range(1, 8)], "unit": "deg"},
    }
    return {k: v for k, v in (said | changes).items() if v is not None}


def closing_axis(t: Trajectory) -> np.ndarray:
    """Direction in which the pads close at the first sample, world axes: the hand's x there is the sensor's."""
    axis = Rotation.from_quat(t.sensor_orientation[0], scalar_first=True).apply([1.0, 0, 0])
    return np.array([axis[0], axis[1], 0.0])


def write_toml(path: Path, fields: dict[str, Any]) -> Path:
    """A mapping as a file."""
    path.write_text(toml_text(fields), encoding="utf-8")
    return path


def write_csv(path: Path, t: Trajectory, **more: Any) -> Path:
    """One row a sample, milliseconds since 1970."""
    table = pd.DataFrame({"stamp": 1e3 * (EPOCH + t.time_s), **columns(t), **more})
    table.to_csv(path, index=False)
    return path


def at_other_rates(t: Trajectory, sensor_hz: float, hand_hz: float, seed: int = 0) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The sensor's rows and the hand's, each at its own jittered times, s."""
    rng = np.random.default_rng(seed)
    said, tables = columns(t), []
    for rate, names in ((sensor_hz, [n for n in said if n[0] in "ft"]), (hand_hz, [n for n in said if n[0] in "pqj"])):
        steps = rng.uniform(0.8, 1.2, int(t.time_s[-1] * rate)) / rate
        time = np.cumsum(steps)
        time = time[time < t.time_s[-1]]
        rows = {n: np.interp(time, t.time_s, said[n]) for n in names}
        if "qx" in names:
            quaternion = np.column_stack([said[f"q{a}"] for a in "xyzw"])
            turned = Slerp(t.time_s, Rotation.from_quat(quaternion))(time).as_quat()
            rows |= {f"q{a}": turned[:, i] for i, a in enumerate("xyzw")}
        tables.append(pd.DataFrame({"stamp": time, **rows}))
    return tables[0], tables[1]


def write_joined_csv(path: Path, sensor: pd.DataFrame, hand: pd.DataFrame) -> Path:
    """Both in one table by time, blank where a row has nothing."""
    pd.concat([sensor, hand]).sort_values("stamp").to_csv(path, index=False)
    return path
