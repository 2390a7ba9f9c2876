"""A trajectory: all that was measured in one trial, simulated or real. It never carries the truth."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float, Int

from testbed.actions.base import Action, action_from_dict
from testbed.errors import HeftError, InvalidValueError
from testbed.validation import frozen_array, is_number

SCHEMA_VERSION = 1
"""Of trajectory files; another one is refused."""
Status = Literal["ok", "slipped", "limit", "fault"]
"""How a trial ended; only one that is ok may be used as data."""


class Phase(IntEnum):
    """What the robot was doing at a sample."""

    TARE = 0
    APPROACH = 1
    GRASP = 2
    SETTLE = 3
    RAMP = 4
    STEADY = 5
    RELEASE = 6


class TrajectoryFileError(HeftError):
    """A trajectory file that is damaged or of another schema."""


@dataclass(frozen=True, eq=False)
class Tool:
    """What hangs below the sensor: its gravity and inertia are taken off the wrench."""

    mass: float
    """kg."""
    com: Float[np.ndarray, "3"]
    """Centre of mass, m, sensor frame."""
    inertia: Float[np.ndarray, "3 3"]
    """About its centre of mass, kg m^2, sensor axes."""
    tcp: Float[np.ndarray, "3"]
    """TCP, m, sensor frame."""

    def __post_init__(self) -> None:
        if not (is_number(self.mass) and self.mass >= 0):
            raise InvalidValueError("Tool.mass", self.mass, "a finite number >= 0, kg")
        object.__setattr__(self, "com", frozen_array("Tool.com", self.com, (3,)))
        object.__setattr__(self, "inertia", frozen_array("Tool.inertia", self.inertia, (3, 3)))
        object.__setattr__(self, "tcp", frozen_array("Tool.tcp", self.tcp, (3,)))


_SERIES: dict[str, tuple[str, ...]] = {
    "object_pose": ("x_m", "y_m", "yaw_rad"),
    "object_velocity": ("x_m_s", "y_m_s", "yaw_rad_s"),
    "tcp_position": ("x_m", "y_m", "z_m"),
    "tcp_velocity": ("x_m_s", "y_m_s", "z_m_s", "roll_rad_s", "pitch_rad_s", "yaw_rad_s"),
    "sensor_orientation": ("w", "x", "y", "z"),
    "sensor_wrench": ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm"),
    "wrench_on_object_world": ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm"),
    "joint_position": tuple(f"{i}_rad" for i in range(1, 8)),
}


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One trial's record at the sensor's rate, from tare to release. T samples."""

    action: Action
    """The action as executed, after clipping."""
    status: Status
    """ok; slipped in the grip; limit of torque, speed, reach or joint; fault."""
    reason: str
    """Why, in a sentence, where status is not ok; else empty."""
    time_s: Float[np.ndarray, "T"]
    """s, from the start of the tare."""
    phase: Int[np.ndarray, "T"]
    """`Phase` of each sample."""
    segment: Int[np.ndarray, "T"]
    """Which steady stretch of the action a sample belongs to, from 0; -1 outside."""
    object_pose: Float[np.ndarray, "T 3"]
    """Planar pose of the object frame in the world as the hand knows it, m, m, rad."""
    object_velocity: Float[np.ndarray, "T 3"]
    """Planar velocity of the object frame's origin and yaw rate as the hand knows them, world axes."""
    tcp_position: Float[np.ndarray, "T 3"]
    """TCP in the world, m; z is its height over the table."""
    tcp_velocity: Float[np.ndarray, "T 6"]
    """Linear and angular velocity of the tool at the TCP, world axes, m/s and rad/s."""
    sensor_orientation: Float[np.ndarray, "T 4"]
    """Orientation of the sensor frame in the world, wxyz."""
    sensor_wrench: Float[np.ndarray, "T 6"]
    """The raw record: what the arm does to the tool, sensor axes, about the sensor's origin. N, N m."""
    wrench_on_object_world: Float[np.ndarray, "T 6"]
    """What the gripper does to the object, about the TCP, world axes, after tare and tool compensation. N, N m."""
    joint_position: Float[np.ndarray, "T 7"]
    """Joint angles of the arm, rad."""
    tool: Tool | None
    """What hangs below the sensor; None on a scale."""
    sensor_bias_std: Float[np.ndarray, "6"]
    """Constant error that the tare may leave, one standard deviation, as the sensor's data sheet has it. N, N m."""
    sensor_drift_std: Float[np.ndarray, "6"] = field(default_factory=lambda: np.zeros(6))
    """Random walk of the zero from the tare on, one standard deviation, N and N m per square root of a second."""
    figures: dict[str, float] = field(default_factory=dict)
    """Numbers behind the status: peak torque and speed over their limits, slip, grip force, ..."""
    provenance: dict[str, str] = field(default_factory=dict)
    """Where the record comes from: runner, versions, seeds, sensing."""

    def __post_init__(self) -> None:
        time = frozen_array("Trajectory.time_s", self.time_s, (None,))
        if len(time) == 0 or (np.diff(time) <= 0).any():
            raise InvalidValueError(
                "Trajectory.time_s", f"{len(time)} samples", "one or more strictly increasing times, s"
            )
        object.__setattr__(self, "time_s", time)
        for name, columns in _SERIES.items():
            object.__setattr__(
                self, name, frozen_array(f"Trajectory.{name}", getattr(self, name), (len(time), len(columns)))
            )
        for name in ("sensor_bias_std", "sensor_drift_std"):
            object.__setattr__(self, name, frozen_array(f"Trajectory.{name}", getattr(self, name), (6,)))
        for name in ("phase", "segment"):
            values = np.array(getattr(self, name))
            lowest, highest = (0, int(max(Phase))) if name == "phase" else (-1, np.iinfo(np.int64).max)
            bounds = f"from {lowest} to {highest}" if name == "phase" else f"from {lowest}"
            allowed = f"integers {bounds}, one a sample, ({len(time)},)"
            if not np.issubdtype(values.dtype, np.integer) or values.shape != time.shape:
                raise InvalidValueError(f"Trajectory.{name}", f"{values.dtype} of shape {values.shape}", allowed)
            outside = np.unique(values[(values < lowest) | (values > highest)])
            if len(outside):
                raise InvalidValueError(f"Trajectory.{name}", outside.tolist(), allowed)
            values = values.astype(np.int64)
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        if self.status not in get_args(Status):
            raise InvalidValueError("Trajectory.status", self.status, f"one of {', '.join(get_args(Status))}")
        lengths = np.linalg.norm(self.sensor_orientation, axis=1)
        worst = int(np.argmax(np.abs(lengths - 1)))
        if abs(lengths[worst] - 1) > 1e-3:
            raise InvalidValueError(
                "Trajectory.sensor_orientation",
                f"length {lengths[worst]:g} at sample {worst}",
                "unit quaternions, wxyz",
            )
        object.__setattr__(self, "figures", {name: float(value) for name, value in self.figures.items()})

    @property
    def ok(self) -> bool:
        """True if the trial may be used as data."""
        return self.status == "ok"

    @property
    def simulated(self) -> bool:
        """True if a simulator made the record: the truth is known, and sensing presets apply."""
        return self.provenance.get("runner") == "simulation"

    @property
    def is_clean(self) -> bool:
        """True if the record is a simulator's and has no sensor's errors in it yet."""
        return self.simulated and "sensing" not in self.provenance

    def mask(self, *phases: Phase) -> np.ndarray:
        """Which samples are in the given phases, (T,) bool."""
        return np.isin(self.phase, phases)


def save_trajectory(trajectory: Trajectory, path: Path) -> None:
    """Write a trajectory as Parquet (zstd, byte-stream split), whole or not at all."""
    columns: dict[str, np.ndarray] = {
        "time_s": trajectory.time_s,
        "phase": trajectory.phase,
        "segment": trajectory.segment,
    }
    for name, units in _SERIES.items():
        columns |= {f"{name}.{unit}": getattr(trajectory, name)[:, i] for i, unit in enumerate(units)}
    tool = trajectory.tool
    header = {
        "schema_version": SCHEMA_VERSION,
        "action": trajectory.action.to_dict(),
        "status": trajectory.status,
        "reason": trajectory.reason,
        "figures": trajectory.figures,
        "provenance": trajectory.provenance,
        "sensor_bias_std": trajectory.sensor_bias_std.tolist(),
        "sensor_drift_std": trajectory.sensor_drift_std.tolist(),
        "tool": None if tool is None else {k: np.asarray(v).tolist() for k, v in asdict(tool).items()},
    }
    table = pa.table(columns).replace_schema_metadata({b"heft": json.dumps(header).encode()})
    floats = [name for name, values in columns.items() if values.dtype == np.float64]
    write_whole(
        path,
        lambda part: pq.write_table(
            table,
            part,
            compression="zstd",
            use_dictionary=False,
            column_encoding=dict.fromkeys(floats, "BYTE_STREAM_SPLIT"),
        ),
    )


def load_trajectory(path: Path) -> Trajectory:
    """Read a trajectory back.

    Raises:
        TrajectoryFileError: damaged, not a trajectory, or of a schema this version does not know.
    """
    try:
        table = pq.read_table(path)
        header: dict[str, Any] = json.loads((table.schema.metadata or {})[b"heft"])
        if header["schema_version"] != SCHEMA_VERSION:
            raise TrajectoryFileError(
                f"{path}: schema {header['schema_version']}; this version of heft reads {SCHEMA_VERSION}"
            )
        columns = {name: table.column(name).to_numpy() for name in table.column_names}
        series = {name: np.stack([columns[f"{name}.{u}"] for u in units], axis=1) for name, units in _SERIES.items()}
        return Trajectory(
            action=action_from_dict(header["action"]),
            status=header["status"],
            reason=header["reason"],
            time_s=columns["time_s"],
            phase=columns["phase"],
            segment=columns["segment"],
            **series,
            tool=None if header["tool"] is None else Tool(**header["tool"]),
            sensor_bias_std=header["sensor_bias_std"],
            sensor_drift_std=header.get("sensor_drift_std", [0.0] * 6),  # records from before it was kept
            figures=header["figures"],
            provenance=header["provenance"],
        )
    except (OSError, pa.ArrowException, KeyError, ValueError, TypeError) as error:
        raise TrajectoryFileError(f"{path}: not a whole trajectory file: {error}") from None


def write_whole(path: Path, write: Any) -> None:
    """Write a file beside its place, sync and rename: a reader sees the old file, the new one, or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        write(part)
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
