"""A trial as an MCAP file of ROS 2 messages, and the mapping by which `heft import` reads it back."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from testbed.errors import InvalidValueError
from testbed.files import write_whole
from testbed.frames import rotation_matrix
from testbed.objects.model import ROBOTIQ_2F85, SPARE_OPENING, ObjectShape
from testbed.sensing.camera import PoseStream
from testbed.toml import toml_lists, toml_text
from testbed.trajectory import Phase, Trajectory

JOINTS = tuple(f"joint_{i}" for i in range(1, 8))
"""Names of the arm's joints in `/joint_states`."""
_PART = "/camera/part_{}"
"""Topic of a camera's poses of one link, or of a rigid object."""
_SECOND = 1_000_000_000
_Message = Callable[[int], Any]


def write_mcap(trajectory: Trajectory, path: Path) -> None:
    """Write a trial as MCAP: wrenches, poses, transforms and joints as ROS 2 messages in CDR, one of each a sample,
    and a camera's poses of each link at their own times.

    Values are those of the trajectory bit for bit. Stamps are whole nanoseconds from the second in which the trial was
    recorded, or from 0: exact at 100 Hz, else to 0.5 ns. Action, status, figures and provenance are in its metadata.

    Raises:
        InvalidValueError: a weighing, which no arm made; or `mcap` or `rosbags` is not installed.
    """
    if trajectory.tool is None:
        raise InvalidValueError("trajectory.action", trajectory.action.kind, "a trial of an arm")
    try:
        from mcap.writer import Writer  # noqa: PLC0415  an extra
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415
    except ImportError:
        raise InvalidValueError("format", "mcap", "with mcap and rosbags: pip install 'heft-testbed[robot]'") from None
    store = get_typestore(Stores.ROS2_HUMBLE)

    def make(kind: str, *fields: Any) -> Any:
        package, name = kind.split("/")
        return store.types[f"{package}/msg/{name}"](*fields)

    def write(part: Path) -> None:
        with part.open("wb") as file:
            writer = Writer(file)
            writer.start(profile="ros2", library="heft")
            channels, schemas = {}, {}
            for topic, kind, _, _ in topics:
                name = kind.replace("/", "/msg/")
                if kind not in schemas:
                    text = store.generate_msgdef(name, ros_version=2)[0].encode()
                    schemas[kind] = writer.register_schema(name, "ros2msg", text)
                channels[topic] = writer.register_channel(topic, "cdr", schemas[kind])
            due = ((stamp, of, i) for of, (*_, stamps) in enumerate(topics) for i, stamp in enumerate(stamps))
            for stamp, of, i in sorted(due):
                topic, kind, message, _ = topics[of]
                content = bytes(store.serialize_cdr(message(i), kind.replace("/", "/msg/")))
                writer.add_message(channels[topic], stamp, content, stamp)
            writer.add_metadata("heft", _metadata(trajectory))
            writer.finish()

    topics = list(_topics(trajectory, make))
    write_whole(path, write)


def mapping_text(trajectory: Trajectory, shape: ObjectShape, object_file: str, log: str) -> str:
    """Mapping file by which `heft import` reads a trial's MCAP back.

    Args:
        trajectory: the trial.
        shape: its object, whose grasp the mapping names.
        object_file: name of a library object, or of an object file beside the mapping.
        log: name of the MCAP file, beside the mapping.

    Raises:
        InvalidValueError: a lift or a weighing, which no mapping describes; a trial that is no data; or a sensor that
            does not look down.
    """
    action, tool = trajectory.action, trajectory.tool
    if not action.on_table or tool is None:
        raise InvalidValueError("trajectory.action", action.kind, "rotate, accelerate, slide or push")
    if not trajectory.ok:
        raise InvalidValueError("trajectory.status", trajectory.status, "ok")
    grasp = None if action.grasp is None else shape.grasps[action.grasp]
    grip = {}
    if grasp is not None:
        stroke = max(ROBOTIQ_2F85.stroke, grasp.width + SPARE_OPENING)
        grip = {"closing_deg": _closing(trajectory, grasp.angle), "stroke_m": stroke}
    joints = {"topic": "/joint_states", "position": [f"position.{name}" for name in JOINTS]}
    linear, angular = ([f"twist.{part}.{a}" for a in "xyz"] for part in ("linear", "angular"))
    bias, drift = trajectory.sensor_bias_std, trajectory.sensor_drift_std
    setup = {"preset": "ideal"} | {name: value for name, value in asdict(trajectory.setup).items() if value}
    mapping = {
        "object": object_file,
        "action": action.to_dict() | ({} if grasp is None else {"grasp": grasp.name}),
        "sensor": {
            "topic": "/wrench",
            "delay_s": 0.0,
            "bias_std_N": float(bias[:3].max()),
            "bias_std_Nm": float(bias[3:].max()),
            "drift_std_N": float(drift[:3].max()),
            "drift_std_Nm": float(drift[3:].max()),
        },
        "hand": {"topic": "/tcp/pose", **grip},
        "velocity": {"topic": "/tcp/velocity", "linear": linear, "angular": angular},
        **({"joints": joints} if trajectory.joint_position.any() else {}),
        "tool": {
            "mass_kg": float(tool.mass),
            "com_m": tool.com.tolist(),
            "inertia_kg_m2": tool.inertia.tolist(),
            "tcp_m": tool.tcp.tolist(),
        },
        "setup": setup,
        **({} if trajectory.camera is None else {"camera": _camera_map(trajectory.camera)}),
    }
    return toml_text(mapping) + toml_lists(logs=[{"file": log}], phases=_windows(trajectory))


def _topics(trajectory: Trajectory, make: Callable[..., Any]) -> Iterator[tuple[str, str, _Message, list[int]]]:
    """Name and type of every topic, its message of each sample, and their stamps."""
    assert trajectory.tool is not None
    stamps = _stamps(trajectory, trajectory.time_s)
    t = {name: value.tolist() for name, value in vars(trajectory).items() if isinstance(value, np.ndarray)}
    half = trajectory.object_pose[:, 2] / 2
    turned = np.column_stack([np.zeros((len(half), 2)), np.sin(half), np.cos(half)]).tolist()
    below = (-trajectory.tool.tcp).tolist()

    def header(stamp: int, frame: str = "world") -> Any:
        return make("std_msgs/Header", make("builtin_interfaces/Time", *divmod(stamp, _SECOND)), frame)

    def vector(values: list[float]) -> Any:
        return make("geometry_msgs/Vector3", *values)

    def quaternion(i: int) -> Any:
        w, *rest = t["sensor_orientation"][i]
        return make("geometry_msgs/Quaternion", *rest, w)

    def posed(stamp: int, place: list[float], turn: Any) -> Any:
        content = make("geometry_msgs/Pose", make("geometry_msgs/Point", *place), turn)
        return make("geometry_msgs/PoseStamped", header(stamp), content)

    def twist(i: int) -> Any:
        linear, angular = vector(t["tcp_velocity"][i][:3]), vector(t["tcp_velocity"][i][3:])
        return make("geometry_msgs/TwistStamped", header(stamps[i]), make("geometry_msgs/Twist", linear, angular))

    def wrench(series: str, frame: str) -> _Message:
        def of(i: int) -> Any:
            force, torque = vector(t[series][i][:3]), vector(t[series][i][3:])
            return make(
                "geometry_msgs/WrenchStamped", header(stamps[i], frame), make("geometry_msgs/Wrench", force, torque)
            )

        return of

    def transform(i: int, child: str, place: list[float], turn: Any, parent: str = "world") -> Any:
        content = make("geometry_msgs/Transform", vector(place), turn)
        return make("geometry_msgs/TransformStamped", header(stamps[i], parent), child, content)

    none = make("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 1.0)

    def tree(i: int) -> Any:
        where, (x, y, _) = t["tcp_position"][i], t["object_pose"][i]
        yaw = make("geometry_msgs/Quaternion", *turned[i])
        edges = (("tcp", where, quaternion(i)), ("tcp_level", where, none), ("object", [x, y, 0.0], yaw))
        return make("tf2_msgs/TFMessage", [transform(i, *edge) for edge in edges])

    def static(i: int) -> Any:
        return make("tf2_msgs/TFMessage", [transform(i, "sensor", below, none, parent="tcp")])

    def joints(i: int) -> Any:
        angles, rest = np.array(trajectory.joint_position[i], order="C"), np.empty(0)
        return make("sensor_msgs/JointState", header(stamps[i], ""), list(JOINTS), angles, rest, rest)

    def camera_pose(time: list[int], poses: np.ndarray) -> _Message:
        def of(i: int) -> Any:
            x, y, yaw = poses[i].tolist()
            turn = make("geometry_msgs/Quaternion", 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
            return posed(time[i], [x, y, 0.0], turn)

        return of

    yield "/tf_static", "tf2_msgs/TFMessage", static, stamps[:1]
    yield "/wrench", "geometry_msgs/WrenchStamped", wrench("sensor_wrench", "sensor"), stamps
    yield "/wrench_on_object", "geometry_msgs/WrenchStamped", wrench("wrench_on_object_world", "tcp_level"), stamps
    pose = "geometry_msgs/PoseStamped"
    yield "/tcp/pose", pose, lambda i: posed(stamps[i], t["tcp_position"][i], quaternion(i)), stamps
    yield "/tcp/velocity", "geometry_msgs/TwistStamped", twist, stamps
    yield "/tf", "tf2_msgs/TFMessage", tree, stamps
    yield "/phase", "std_msgs/Int32", lambda i: make("std_msgs/Int32", t["phase"][i]), stamps
    yield "/segment", "std_msgs/Int32", lambda i: make("std_msgs/Int32", t["segment"][i]), stamps
    if trajectory.joint_position.any():
        yield "/joint_states", "sensor_msgs/JointState", joints, stamps
    camera = trajectory.camera
    for part in range(0 if camera is None else camera.parts):
        assert camera is not None
        poses = camera.poses[:, part]
        kept = ~np.isnan(poses[:, 0]) & (camera.time_s >= trajectory.time_s[0])
        time = _stamps(trajectory, camera.time_s[kept])
        yield _PART.format(part), pose, camera_pose(time, poses[kept]), time


def _stamps(trajectory: Trajectory, time: np.ndarray) -> list[int]:
    """Stamps of times [ns], from a whole second: times at 100 Hz are then the same numbers when they are read."""
    recorded = trajectory.provenance.get("recorded")
    begin = int(datetime.fromisoformat(recorded).timestamp()) if recorded else 0
    since = np.rint((time - trajectory.time_s[0]) * _SECOND).astype(np.int64)
    return (begin * _SECOND + since).tolist()


def _metadata(trajectory: Trajectory) -> dict[str, str]:
    return {
        "action": json.dumps(trajectory.action.to_dict()),
        "status": trajectory.status,
        "reason": trajectory.reason,
        "phases": ", ".join(f"{phase.value} {phase.name.lower()}" for phase in Phase),
        "figures": json.dumps(trajectory.figures),
        **trajectory.provenance,
    }


def _closing(trajectory: Trajectory, angle: float) -> float:
    """Direction in which the pads close, in the plane of the sensor's axes [deg]."""
    axes, found = rotation_matrix(trajectory.sensor_orientation), 0.0
    if (worst := float(np.abs(axes[:, 2, 2]).min())) < 0.9:
        given = f"{math.degrees(math.acos(worst)):.0f} deg off the vertical"
        raise InvalidValueError("trajectory.sensor_orientation", given, "a sensor whose z axis is near the vertical")
    for _ in range(4):  # seen from above, the direction turns with the plane's tilt: Newton's steps
        x, y, _ = np.moveaxis(axes @ [np.cos(found), np.sin(found), 0.0], -1, 0)
        missed = trajectory.object_pose[:, 2] + angle - np.arctan2(y, x)
        found += float(np.sign(axes[:, 2, 2].mean()) * np.angle(np.exp(1j * missed).mean()))
    return round(math.degrees(math.remainder(found, math.tau)), 9) + 0.0  # not -0


def _camera_map(camera: PoseStream) -> dict[str, Any]:
    return {
        "position_std_m": camera.position_std,
        "angle_std_deg": math.degrees(camera.angle_std),
        "delay_s": 0.0,
        "delay_std_s": camera.delay_std,
        "parts": [{"topic": _PART.format(part)} for part in range(camera.parts)],
    }


def _windows(trajectory: Trajectory) -> list[dict[str, Any]]:
    """Windows of one phase each, with ends halfway between two samples."""
    time, phase = trajectory.time_s - trajectory.time_s[0], trajectory.phase
    changes = np.flatnonzero(np.diff(phase) | np.diff(trajectory.segment)) + 1
    first, middle = np.append(0, changes), (time[changes - 1] + time[changes]) / 2
    ends = [*middle, float(time[-1] + np.median(np.diff(time)) / 2)]
    return [
        {"phase": Phase(int(phase[i])).name.lower(), "from_s": float(begin), "to_s": float(end)}
        for i, begin, end in zip(first, [0.0, *middle], ends, strict=True)
    ]
