"""Trajectory: the measurements of one trial, simulated or real, without the true masses and frictions."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import IntEnum
from pathlib import Path
from typing import Any, Literal, Self, get_args

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int

from testbed.actions.base import Action, action_from_dict
from testbed.actions.weigh import Weigh
from testbed.errors import InvalidValueError
from testbed.files import load_sealed, read_table, write_table
from testbed.sensing.camera import PoseStream
from testbed.sensing.series import unwrapped
from testbed.validation import freeze_arrays, frozen_array, is_number
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors

SCHEMA_VERSION = 1
"""Version of trajectory files; other versions are refused."""
Status = Literal["ok", "slipped", "limit", "fault"]
"""Status of a trial; only ok trials may be used as data."""


class Phase(IntEnum):
    """Phase of a trial."""

    TARE = 0
    APPROACH = 1
    GRASP = 2
    SETTLE = 3
    RAMP = 4
    STEADY = 5
    RELEASE = 6


@dataclass(frozen=True, eq=False)
class Tool:
    """Tool below the sensor, whose gravity and inertia are subtracted from the wrench."""

    mass: float
    """Mass [kg]."""
    com: Float[np.ndarray, "3"]
    """Center of mass [m], sensor frame."""
    inertia: Float[np.ndarray, "3 3"]
    """Inertia about its center of mass [kg m^2], sensor axes."""
    tcp: Float[np.ndarray, "3"]
    """TCP [m], sensor frame."""

    def __post_init__(self) -> None:
        if not (is_number(self.mass) and self.mass >= 0):
            raise InvalidValueError("Tool.mass", self.mass, "a finite number >= 0, kg")
        freeze_arrays(self, com=(3,), inertia=(3, 3), tcp=(3,))


SERIES: dict[str, tuple[str, ...]] = {
    "object_pose": ("x_m", "y_m", "yaw_rad"),
    "object_velocity": ("x_m_s", "y_m_s", "yaw_rad_s"),
    "tcp_position": ("x_m", "y_m", "z_m"),
    "tcp_velocity": ("x_m_s", "y_m_s", "z_m_s", "roll_rad_s", "pitch_rad_s", "yaw_rad_s"),
    "sensor_orientation": ("w", "x", "y", "z"),
    "sensor_wrench": ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm"),
    "wrench_on_object_world": ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm"),
    "joint_position": tuple(f"{i}_rad" for i in range(1, 8)),
}
"""Measured series of a trajectory, with the suffixes of their columns in a file."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Record of one trial at the sensor's rate, from tare to release: T samples."""

    action: Action
    """The action as executed, after clipping."""
    status: Status
    """Status: ok; slipped in the grip; limit of torque, speed, reach or joint; fault."""
    reason: str
    """Reason for a status other than ok, or for the early end of a push with status ok; else empty."""
    time_s: Float[np.ndarray, "T"]
    """Time since the start of the tare [s]."""
    phase: Int[np.ndarray, "T"]
    """`Phase` of each sample."""
    segment: Int[np.ndarray, "T"]
    """Index of each sample's steady stretch, from 0; -1 outside."""
    object_pose: Float[np.ndarray, "T 3"]
    """Planar pose of the object frame [m, m, rad], world, from the hand's pose; in a push, from the camera. Yaws are
    unwrapped on construction."""
    object_velocity: Float[np.ndarray, "T 3"]
    """Planar velocity of the object frame's origin and yaw rate [m/s, m/s, rad/s], world axes, as `object_pose`."""
    tcp_position: Float[np.ndarray, "T 3"]
    """Position of the TCP [m], world; z is its height over the table."""
    tcp_velocity: Float[np.ndarray, "T 6"]
    """Linear and angular velocity of the tool at the TCP [m/s, rad/s], world axes."""
    sensor_orientation: Float[np.ndarray, "T 4"]
    """Orientation of the sensor frame in the world, wxyz."""
    sensor_wrench: Float[np.ndarray, "T 6"]
    """Raw record: wrench of the arm on the tool [N, N m], sensor axes, about the sensor's origin."""
    wrench_on_object_world: Float[np.ndarray, "T 6"]
    """Wrench of the gripper on the object [N, N m], world axes, about the TCP, after tare and tool compensation."""
    joint_position: Float[np.ndarray, "T 7"]
    """Joint angles of the arm [rad]."""
    tool: Tool | None
    """Tool below the sensor; None on a scale."""
    sensor_bias_std: Float[np.ndarray, "6"]
    """Standard deviation of the constant error left by the tare, by the sensor's data sheet [N, N m]."""
    sensor_drift_std: Float[np.ndarray, "6"] = field(default_factory=lambda: np.zeros(6))
    """Standard deviation of the random walk of the zero after the tare [N/sqrt(s), N m/sqrt(s)]."""
    setup: SetupErrors = EXACT_SETUP
    """Errors of the setup other than the sensor's, as stated."""
    camera: PoseStream | None = None
    """Poses of the object by a camera, the true ones in a clean record; None without a camera."""
    figures: dict[str, float] = field(default_factory=dict)
    """Numbers for the status: peak torque and speed over their limits, slip, grip force, ..."""
    provenance: dict[str, str] = field(default_factory=dict)
    """Origin of the record: runner, versions, support. Hidden from methods and policies: see `blinded`."""

    @classmethod
    def of_scale(
        cls, weight: Float[np.ndarray, "T"], time_s: Float[np.ndarray, "T"], provenance: dict[str, str]
    ) -> Self:
        """Record of a weighing: vertical force of a scale on the object [N] at `time_s` [s]."""
        count = len(weight)
        wrench = np.zeros((count, 6))
        wrench[:, 2] = weight
        return cls(
            action=Weigh(),
            status="ok",
            reason="",
            time_s=time_s,
            phase=np.full(count, Phase.STEADY),
            segment=np.zeros(count, dtype=int),
            object_pose=np.zeros((count, 3)),
            object_velocity=np.zeros((count, 3)),
            tcp_position=np.zeros((count, 3)),
            tcp_velocity=np.zeros((count, 6)),
            sensor_orientation=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
            sensor_wrench=wrench,
            wrench_on_object_world=wrench,
            joint_position=np.zeros((count, 7)),
            tool=None,
            sensor_bias_std=np.zeros(6),
            provenance=provenance,
        )

    def __post_init__(self) -> None:
        if not isinstance(self.action, Action):
            raise InvalidValueError("Trajectory.action", self.action, "an action, such as heft.Rotate(0)")
        time = frozen_array("Trajectory.time_s", self.time_s, (None,))
        if len(time) == 0 or (np.diff(time) <= 0).any():
            raise InvalidValueError(
                "Trajectory.time_s", f"{len(time)} samples", "one or more strictly increasing times, s"
            )
        object.__setattr__(self, "time_s", time)
        freeze_arrays(self, **{name: (len(time), len(columns)) for name, columns in SERIES.items()})
        object.__setattr__(self, "object_pose", unwrapped(self.object_pose[:, None])[:, 0])
        freeze_arrays(self, sensor_bias_std=(6,), sensor_drift_std=(6,))
        largest = int(np.iinfo(np.int64).max)
        for name, lowest, highest in (("phase", 0, int(max(Phase))), ("segment", -1, largest)):
            values = np.array(getattr(self, name))
            to = "" if highest == largest else f" to {highest}"
            allowed = f"integers from {lowest}{to}, one per sample, ({len(time)},)"
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
        """True if the record is of a simulation: the truth is known, and sensing presets apply."""
        return self.provenance.get("runner") == "simulation"

    @property
    def is_clean(self) -> bool:
        """True if the record is of a simulation and without sensor errors."""
        return self.simulated and "sensing" not in self.provenance

    def blinded(self) -> Self:
        """Record for methods and policies: its provenance has only runner and sensing, and it has no figures."""
        kept = {name: value for name, value in self.provenance.items() if name in ("runner", "sensing")}
        return replace(self, figures={}, provenance=kept)

    def mask(self, *phases: Phase) -> np.ndarray:
        """Mask of the samples in the given phases, shape (T,).

        Raises:
            InvalidValueError: a value that is not a `Phase`.
        """
        if unknown := [phase for phase in phases if not isinstance(phase, Phase)]:
            raise InvalidValueError("phases", unknown, "members of heft.Phase, such as Phase.STEADY")
        return np.isin(self.phase, phases)


_CAMERA = ("camera.time_s", "camera.poses")
"""Columns of a camera's frames, as lists in the first row, since there are not as many frames as samples."""
_CAMERA_HEADER = ("parts", "position_std", "angle_std", "delay_std")


def header_of(trajectory: Trajectory) -> dict[str, Any]:
    """Trajectory without its series and its camera's frames, as plain data."""
    tool, camera = trajectory.tool, trajectory.camera
    return {
        "schema_version": SCHEMA_VERSION,
        "action": trajectory.action.to_dict(),
        "status": trajectory.status,
        "reason": trajectory.reason,
        "figures": trajectory.figures,
        "provenance": trajectory.provenance,
        "sensor_bias_std": trajectory.sensor_bias_std.tolist(),
        "sensor_drift_std": trajectory.sensor_drift_std.tolist(),
        "setup": asdict(trajectory.setup),
        "tool": None if tool is None else {k: np.asarray(v).tolist() for k, v in asdict(tool).items()},
        "camera": None if camera is None else {name: getattr(camera, name) for name in _CAMERA_HEADER},
    }


def save_trajectory(trajectory: Trajectory, path: Path | str) -> None:
    """Write a trajectory as Parquet (zstd, byte-stream split), atomically."""
    path = Path(path)
    columns: dict[str, np.ndarray] = {name: getattr(trajectory, name) for name in ("time_s", "phase", "segment")}
    for name, units in SERIES.items():
        columns |= {f"{name}.{unit}": getattr(trajectory, name)[:, i] for i, unit in enumerate(units)}
    table = _with_camera(pa.table(columns), trajectory.camera)
    floats = [name for name, values in columns.items() if values.dtype == np.float64]
    split = dict.fromkeys(floats, "BYTE_STREAM_SPLIT")
    write_table(path, table, {"heft": json.dumps(header_of(trajectory))}, use_dictionary=False, column_encoding=split)


def trajectory_of(header: dict[str, Any], series: Mapping[str, np.ndarray], camera: PoseStream | None) -> Trajectory:
    """Trajectory of a header from `header_of`, its series and its camera.

    Args:
        header: plain data.
        series: `time_s`, `phase`, `segment` and the arrays of `SERIES`, by name; others are ignored.
        camera: poses of the object by a camera, or None.

    Raises:
        ValueError: a header of another schema.
        KeyError: a missing entry of the header or the series.
    """
    if header["schema_version"] != SCHEMA_VERSION:
        raise ValueError(f"schema {header['schema_version']}; this version of heft reads {SCHEMA_VERSION}")
    return Trajectory(
        action=action_from_dict(header["action"]),
        status=header["status"],
        reason=header["reason"],
        **{name: series[name] for name in ("time_s", "phase", "segment", *SERIES)},
        tool=None if header["tool"] is None else Tool(**header["tool"]),
        sensor_bias_std=header["sensor_bias_std"],
        sensor_drift_std=header.get("sensor_drift_std", [0.0] * 6),  # missing in older records
        setup=SetupErrors(**header.get("setup", {})),
        camera=camera,
        figures=header["figures"],
        provenance=header["provenance"],
    )


def load_trajectory(path: Path) -> Trajectory:
    """Read a trajectory back.

    Raises:
        DamagedFileError: a file that is damaged, not a trajectory, or of an unknown schema.
    """

    def parsed(data: bytes) -> Trajectory:
        table = read_table(data)
        header: dict[str, Any] = json.loads((table.schema.metadata or {})[b"heft"])
        columns = {name: table.column(name).to_numpy() for name in table.column_names if name not in _CAMERA}
        series = {name: np.stack([columns[f"{name}.{u}"] for u in units], axis=1) for name, units in SERIES.items()}
        return trajectory_of(header, columns | series, _camera_of(table, header.get("camera")))

    return load_sealed(path, "trajectory file", parsed)


def _with_camera(table: pa.Table, camera: PoseStream | None) -> pa.Table:
    """Table of a record with its camera's frames."""
    if camera is None:
        return table
    rest: list[list[float]] = [[]] * (len(table) - 1)
    for name, values in zip(_CAMERA, (camera.time_s, camera.poses.ravel()), strict=True):
        table = table.append_column(name, pa.array([values, *rest], type=pa.list_(pa.float64())))
    return table


def _camera_of(table: pa.Table, header: dict[str, Any] | None) -> PoseStream | None:
    if header is None:
        return None
    return camera_of(header, *(table.column(name)[0].values.to_numpy(zero_copy_only=False) for name in _CAMERA))


def camera_of(header: Mapping[str, Any], time_s: Float[np.ndarray, "F"], poses: Float[np.ndarray, "n"]) -> PoseStream:
    """Frames of a camera from their header, which in older records lacks the number of parts."""
    parts = header.get("parts", len(poses) // (3 * len(time_s)) if len(time_s) else 1)
    errors = {name: header[name] for name in _CAMERA_HEADER if name != "parts"}
    return PoseStream(time_s, poses.reshape(len(time_s), parts, 3), **errors)
