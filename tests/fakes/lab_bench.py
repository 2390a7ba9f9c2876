"""Another bench's logs, made from a trajectory: odd units, frames and rates, and the mapping to them."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation, Slerp

from testbed import HeftError, Phase, Trajectory, load_object
from testbed.actions.path import minimum_jerk
from testbed.exporters.ros2 import mapping_text, write_mcap
from testbed.importers.importer import import_trajectory
from testbed.toml import toml_text
from tests.helpers.records import series_of

MOUNT = Rotation.from_euler("xyz", [180, 0, 123], degrees=True)
"""Mount of the sensor on the other robot's hand: upside down, and turned."""
TCP_IN_HAND = np.array([0.01, -0.02, 0.15])
TABLE = 0.033
"""Height of its table in its arm's base frame, m."""
EPOCH = 1_767_225_600.0
"""Time of its clock at the begin of the log [s]."""


def through_mcap(t: Trajectory, name: str, folder: Path) -> Trajectory:
    """A trial of an object, by its name or path, as it is after its export and import."""
    write_mcap(t, folder / "trial.mcap")
    text = mapping_text(t, load_object(name).shape, name, "trial.mcap")
    (folder / "trial.toml").write_text(text, encoding="utf-8")
    return import_trajectory(folder / "trial.mcap", folder / "trial.toml")


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


def tared_again(t: Trajectory, drift: float) -> Trajectory:
    """The record, after which the hand goes up again where it came down; its f_y has drifted by then, N."""
    approach = np.flatnonzero(t.phase <= Phase.APPROACH)[::-1]
    series = series_of(t, np.append(np.arange(len(t.time_s)), approach))
    up = slice(len(t.time_s), None)
    series["tcp_position"][up, :2] = t.tcp_position[-1, :2]
    series["sensor_orientation"][up] = t.sensor_orientation[-1]
    series["tcp_velocity"][up] = 0.0
    series["time_s"] = np.arange(len(series["time_s"])) / 100
    series["sensor_wrench"][up, 1] += drift
    return replace(t, **series)


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
        "setup": {"preset": "ideal"},
    }
    return {k: v for k, v in (said | changes).items() if v is not None}


def entry_of(file: str, trial: Trajectory) -> dict[str, Any]:
    """[[logs]] table of a trial; an accelerated turn has its phases."""
    entry: dict[str, Any] = {"file": file, "action": trial.action.to_dict()}
    return entry | ({"phases": phases_of(trial)} if trial.action.accelerated else {})


def phases_of(trial: Trajectory) -> list[dict[str, Any]]:
    """Tare and steady stretches of a trial as [[phases]] tables."""
    parts = [("tare", trial.phase == Phase.TARE)]
    parts += [("steady", trial.segment == i) for i in range(trial.segment.max() + 1)]
    ends = [(name, np.flatnonzero(inside)[[0, -1]] / 100) for name, inside in parts]
    return [{"phase": n, "from_s": max(a - 0.005, 0.0), "to_s": b + 0.005} for n, (a, b) in ends]


def closing_axis(t: Trajectory) -> np.ndarray:
    """Direction in which the pads close at the first sample, world axes: the hand's x there is the sensor's."""
    axis = Rotation.from_quat(t.sensor_orientation[0], scalar_first=True).apply([1.0, 0, 0])
    return np.array([axis[0], axis[1], 0.0])


def write_toml(path: Path, fields: dict[str, Any]) -> Path:
    """A mapping as a file."""
    path.write_text(toml_text(fields), encoding="utf-8")
    return path


def write_csv(path: Path, t: Trajectory, **more: Any) -> Path:
    """One row per sample, milliseconds since 1970."""
    table = pd.DataFrame({"stamp": 1e3 * (EPOCH + t.time_s), **columns(t), **more})
    table.to_csv(path, index=False)
    return path


def import_csv(folder: Path, t: Trajectory, mapping: dict[str, Any] | None = None, **more: Any) -> Trajectory:
    """A trajectory written as CSV, with more columns perhaps, and imported."""
    return imported(write_csv(folder / "log.csv", t, **more), mapping_of(t) if mapping is None else mapping)


def imported(log: Path, mapping: dict[str, Any], **options: Any) -> Trajectory:
    """A log by a mapping, which is written beside it."""
    return import_trajectory(log, write_toml(log.with_name("map.toml"), mapping), **options)


def refused(log: Path, mapping: dict[str, Any]) -> str:
    """Error of the import of a log."""
    with pytest.raises(HeftError) as error:
        imported(log, mapping)
    return str(error.value)


def write_messages(
    path: Path,
    messages: Iterable[tuple[str, str, int, bytes]],
    encoding: str = "json",
    schema: tuple[str, bytes] = ("jsonschema", b"{}"),
    **options: Any,
) -> Path:
    """File of messages (topic, type, time [ns], content), of one encoding, whose types have one definition."""
    mcap = pytest.importorskip("mcap.writer")
    with path.open("wb") as file:
        writer, channels = mcap.Writer(file, **options), {}
        writer.start("ros2" if encoding == "cdr" else "")
        for topic, kind, stamp, content in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, encoding, writer.register_schema(kind, *schema))
            writer.add_message(channels[topic], stamp, content, stamp)
        writer.finish()
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


def strung(trials: Sequence[Trajectory], pose_noise: float = 0.0) -> Trajectory:
    """Trials of one object as one recording: the hand goes up from each to the next, the object lies where it left it.

    Each trial goes from its tare to its last sample with the object; `pose_noise` is that of the TCP, one sigma [m].
    """
    parts: list[dict[str, np.ndarray]] = []
    for trial in trials:
        part = series_of(trial)
        if parts:
            part = _lying_at(part, parts[-1]["object_pose"][-1])
            parts.append(_way(parts[-1], part))
        parts.append(part)
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    whole["time_s"] = np.arange(len(whole["time_s"])) / 100
    whole["tcp_position"] += pose_noise * np.random.default_rng(0).standard_normal(whole["tcp_position"].shape)
    return replace(trials[0], **whole)


def _lying_at(part: dict[str, np.ndarray], pose: np.ndarray) -> dict[str, np.ndarray]:
    """A trial whose object is first grasped at a planar pose."""
    x, y, yaw = part["object_pose"][np.argmax(part["phase"] >= Phase.GRASP)]
    turn = Rotation.from_euler("z", pose[2] - yaw)
    there, here = np.array([x, y, 0.0]), np.array([pose[0], pose[1], 0.0])
    position = turn.apply(part["tcp_position"] - there) + here
    sensor = turn * Rotation.from_quat(part["sensor_orientation"], scalar_first=True)
    planar = turn.apply(part["object_pose"] * [1, 1, 0] - there) + here
    planar[:, 2] = part["object_pose"][:, 2] + pose[2] - yaw
    return part | {
        "tcp_position": position,
        "sensor_orientation": sensor.as_quat(scalar_first=True),
        "object_pose": planar,
    }


def _way(before: dict[str, np.ndarray], after: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Half a second of rest, up, and over to the next trial, the sensor as in its tare."""
    up, over = (
        minimum_jerk(np.clip((np.arange(350) - first) / 100 / seconds, 0, 1))[0]
        for first, seconds in ((50, 1), (150, 2))
    )
    start, end = before["tcp_position"][-1], after["tcp_position"][0]
    position = start + np.column_stack([over, over, up]) * (end - start)
    ends = Rotation.from_quat([before["sensor_orientation"][-1], after["sensor_orientation"][0]], scalar_first=True)
    turned = Slerp([0.0, 1.0], ends)(over).as_quat(scalar_first=True)
    rows = {name: np.repeat(values[-1:], 350, axis=0) for name, values in before.items()}
    rows["sensor_wrench"][100:] = before["sensor_wrench"][0]
    return rows | {"tcp_position": position, "sensor_orientation": turned}
