"""ROS 2 bags are read without ROS, and hold what the same data as CSV does."""

import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from testbed import HeftError, Trajectory
from testbed.importers.columns import HandMap, TimeMap
from testbed.importers.importer import import_trajectory
from testbed.importers.messages import Message, MessageLog, open_messages
from testbed.importers.poses import hand_pose
from tests.fakes.lab_bench import write_messages

rosbag2 = pytest.importorskip("rosbags.rosbag2")
from rosbags.typesys import Stores, get_typestore  # noqa: E402  an extra

ROS = get_typestore(Stores.ROS2_HUMBLE)
EPOCH = 1_767_225_600
"""Second at which the recording begins."""
MASSED = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
URDF = f"""<robot name="gantry">
<mujoco><compiler fusestatic="false"/></mujoco>
<link name="base"/><link name="x">{MASSED}</link><link name="z">{MASSED}</link><link name="yaw">{MASSED}</link>
<link name="tool">{MASSED}</link><link name="finger">{MASSED}</link>
<joint name="slide_x" type="prismatic"><parent link="base"/><child link="x"/>
  <origin xyz="0.3 0 0.1" rpy="0.2 -0.1 0.4"/><axis xyz="2 1 0"/>{LIMIT}</joint>
<joint name="lift" type="prismatic"><parent link="x"/><child link="z"/>
  <origin rpy="-0.25 0.03 -0.35"/><axis xyz="0 0 1"/>{LIMIT}</joint>
<joint name="turn" type="continuous"><parent link="z"/><child link="yaw"/>
  <origin xyz="0 0.05 0"/><axis xyz="0 0 1"/></joint>
<joint name="flange" type="fixed"><parent link="yaw"/><child link="tool"/>
  <origin xyz="0.01 0 -0.02" rpy="3.14 0 0.5"/></joint>
<joint name="grip" type="revolute"><parent link="tool"/><child link="finger"/>{LIMIT}</joint>
</robot>"""
LINES = """
object = "L2"
action = { kind = "rotate", grasp = 2, speed = 0.1745, duration = 2.0 }
[sensor]
topic = "/ft"
in_hand_wxyz = [1, 0, 0, 0]
[hand]
HAND
tcp_in_hand_m = [0, 0, 0.12]
[tool]
mass_kg = 0.9
com_m = [0, 0, 0.06]
inertia_kg_m2 = [[0.003, 0, 0], [0, 0.003, 0], [0, 0, 0.0006]]
tcp_m = [0, 0, 0.174]
"""
"""A mapping of a bag; its hand in one or two lines more."""


class Bench:
    """A gantry that goes down, waits, and turns; joints at 100 Hz, the sensor at 500 Hz, stamps in ns."""

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        self.stamps = EPOCH * 10**9 + np.arange(600) * 10_000_000 + rng.integers(0, 2_000_000, 600)
        time = self.seconds(self.stamps)
        down = np.interp(time, [0, 1, 2], [0.2, 0.2, 0.0])
        turned = 0.1745 * np.interp(time, [0, 2.5, 5.0], [0.0, 0.0, 2.5])
        self.joints = np.column_stack([np.full(600, 0.02), down, turned])
        self.links = {name: self.poses(name) for name in ("x", "z", "yaw", "tool")}
        self.sensed = EPOCH * 10**9 + np.arange(900) * 6_700_000 + rng.integers(0, 400_000, 900)
        self.wrench = rng.normal([1.0, 2.0, -8.0, 0.1, 0.2, 0.3], 0.5, (900, 6))

    @staticmethod
    def seconds(stamps: np.ndarray) -> np.ndarray:
        return (stamps - EPOCH * 10**9) / 10**9

    def poses(self, link: str) -> np.ndarray:
        """Position and quaternion (xyzw) of a link by MuJoCo's own reader of a URDF, shape (600, 7)."""
        model = mujoco.MjModel.from_xml_string(URDF)
        data, found = mujoco.MjData(model), np.empty((600, 7))
        for i, joints in enumerate(self.joints):
            data.qpos[:3] = joints
            mujoco.mj_kinematics(model, data)
            found[i] = [*data.body(link).xpos, *np.roll(data.body(link).xquat, -1)]
        return found

    def csv(self, path: Path) -> Path:
        names = [*"xyz", "qx", "qy", "qz", "qw"]
        hand = pd.DataFrame(self.links["tool"], columns=names).assign(t=self.seconds(self.stamps))
        force = pd.DataFrame(self.wrench, columns=["fx", "fy", "fz", "tx", "ty", "tz"])
        both = pd.concat([hand, force.assign(t=self.seconds(self.sensed))]).sort_values("t")
        both.to_csv(path, index=False)
        return path

    def bag(self, path: Path, kind: str, topic: str, message: Callable[[int], Any], storage: str = "SQLITE3") -> Path:
        """A bag with the wrenches, and a message of the hand at each of its stamps; what is logged comes late."""
        rng = np.random.default_rng(1)
        with rosbag2.Writer(path, version=8, storage_plugin=rosbag2.StoragePlugin[storage]) as writer:
            topics = (
                ("/ft", "geometry_msgs/msg/WrenchStamped", self.sensed, self.wrench_message),
                (topic, kind, self.stamps, message),
                ("/tf_static", "tf2_msgs/msg/TFMessage", self.stamps[:1], self.flange),
            )
            for name, typename, stamps, of in topics:
                connection = writer.add_connection(name, typename, typestore=ROS)
                logged = np.maximum.accumulate(stamps + rng.integers(0, 8_000_000, len(stamps)))
                for i, at in enumerate(logged.tolist()):
                    writer.write(connection, at, ROS.serialize_cdr(of(i), typename))
        return path

    def header(self, stamps: np.ndarray, i: int, frame: str = "base") -> Any:
        return ros("std_msgs/Header", ros("builtin_interfaces/Time", *divmod(int(stamps[i]), 10**9)), frame)

    def wrench_message(self, i: int) -> Any:
        force, torque = (ros("geometry_msgs/Vector3", *part) for part in self.wrench[i].reshape(2, 3))
        return ros(
            "geometry_msgs/WrenchStamped", self.header(self.sensed, i), ros("geometry_msgs/Wrench", force, torque)
        )

    def pose(self, i: int) -> Any:
        p, q = self.links["tool"][i][:3], self.links["tool"][i][3:]
        return ros("geometry_msgs/Pose", ros("geometry_msgs/Point", *p), ros("geometry_msgs/Quaternion", *q))

    def pose_message(self, i: int) -> Any:
        return ros("geometry_msgs/PoseStamped", self.header(self.stamps, i), self.pose(i))

    def odometry(self, i: int) -> Any:
        zero = ros("geometry_msgs/Vector3", 0.0, 0.0, 0.0)
        still = ros("geometry_msgs/TwistWithCovariance", ros("geometry_msgs/Twist", zero, zero), np.zeros(36))
        pose = ros("geometry_msgs/PoseWithCovariance", self.pose(i), np.zeros(36))
        return ros("nav_msgs/Odometry", self.header(self.stamps, i), "tool", pose, still)

    def joint_state(self, i: int) -> Any:
        """The order of the joints changes, and one is not of the arm."""
        order = np.roll(np.arange(4), i)
        names, values = np.array(["slide_x", "lift", "turn", "grip"])[order], np.append(self.joints[i], 0.3)[order]
        return ros("sensor_msgs/JointState", self.header(self.stamps, i), names.tolist(), values, values, values)

    def edge(self, i: int, parent: str, child: str) -> Any:
        below, above = self.links[child][i], self.links[parent][i] if parent in self.links else np.eye(7)[6]
        back = Rotation.from_quat(above[3:]).inv()
        turned = (back * Rotation.from_quat(below[3:])).as_quat()
        moved, turn = back.apply(below[:3] - above[:3]), ros("geometry_msgs/Quaternion", *turned)
        transform = ros("geometry_msgs/Transform", ros("geometry_msgs/Vector3", *moved), turn)
        return ros("geometry_msgs/TransformStamped", self.header(self.stamps, i, parent), child, transform)

    def tree(self, i: int) -> Any:
        edges = [self.edge(i, *pair) for pair in (("z", "yaw"), ("base", "x"), ("x", "z"))]
        return ros("tf2_msgs/TFMessage", edges)

    def flange(self, i: int) -> Any:
        return ros("tf2_msgs/TFMessage", [self.edge(i, "yaw", "tool")])


def ros(kind: str, *values: Any) -> Any:
    return ROS.types[kind.replace("/", "/msg/")](*values)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


@pytest.fixture(scope="module")
def as_csv(bench: Bench, tmp_path_factory: pytest.TempPathFactory) -> Trajectory:
    folder = tmp_path_factory.mktemp("csv")
    columns = """position = ["x", "y", "z"]
orientation = ["qx", "qy", "qz", "qw"]
orientation_as = "xyzw"
"""
    sensor = '[time]\ncolumn = "t"\n[sensor]\nforce = ["fx", "fy", "fz"]\ntorque = ["tx", "ty", "tz"]'
    text = LINES.replace("HAND", columns).replace('[sensor]\ntopic = "/ft"', sensor)
    (folder / "map.toml").write_text(text)
    return import_trajectory(bench.csv(folder / "log.csv"), folder / "map.toml")


def imported(log: Path, hand: str) -> Trajectory:
    text = LINES.replace("HAND", hand).strip()
    assert len(text.splitlines()) <= 15
    mapping = log.parent / "map.toml"
    mapping.write_text(text)
    return import_trajectory(log, mapping)


def same(bag: Trajectory, csv: Trajectory) -> None:
    turned = np.abs(np.sum(bag.sensor_orientation * csv.sensor_orientation, axis=1))
    assert_allclose(turned, 1.0, atol=1e-12, rtol=0)
    for name in ("time_s", "tcp_position", "tcp_velocity", "sensor_wrench", "wrench_on_object_world", "object_pose"):
        assert_allclose(getattr(bag, name), getattr(csv, name), atol=1e-12, rtol=0, err_msg=name)
    assert np.array_equal(bag.phase, csv.phase)
    assert bag.provenance["recorded"].startswith("2026-01-01T00:00:00.")


@pytest.mark.slow
def test_poses_and_odometry(bench: Bench, as_csv: Trajectory, tmp_path: Path):
    bag = bench.bag(tmp_path / "bag", "geometry_msgs/msg/PoseStamped", "/pose", bench.pose_message)
    same(imported(bag, 'topic = "/pose"'), as_csv)
    same(imported(bag / "bag.db3", 'topic = "/pose"'), as_csv)
    bag = bench.bag(tmp_path / "mcap", "nav_msgs/msg/Odometry", "/odom", bench.odometry, "MCAP")
    same(imported(bag / "mcap.mcap", 'topic = "/odom"'), as_csv)
    same(imported(bag, 'topic = "/odom"'), as_csv)


@pytest.fixture(scope="module")
def as_json(bench: Bench, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """MCAP file of JSON messages as Foxglove and others write them: the types by name, the stamps in two parts."""
    streams = (
        ("/ft", "geometry_msgs/WrenchStamped", bench.sensed, bench.wrench_message),
        ("/pose", "geometry_msgs/msg/PoseStamped", bench.stamps, bench.pose_message),
    )
    messages = (
        (topic, kind, at, json.dumps(plain(of(i))).encode())
        for topic, kind, stamps, of in streams
        for i, at in enumerate(stamps.tolist())
    )
    return write_messages(tmp_path_factory.mktemp("json") / "log.mcap", messages)


def test_messages_in_json(as_json: Path, as_csv: Trajectory):
    same(imported(as_json, 'topic = "/pose"'), as_csv)


def plain(message: Any) -> Any:
    """A message as nested dicts."""
    if not is_dataclass(message):
        return message
    return {field.name: plain(getattr(message, field.name)) for field in fields(message)}


@pytest.mark.slow
def test_a_tree_of_transforms(bench: Bench, as_csv: Trajectory, tmp_path: Path):
    bag = bench.bag(tmp_path / "bag", "tf2_msgs/msg/TFMessage", "/tf", bench.tree, "MCAP")
    same(imported(bag / "bag.mcap", 'topic = "/tf"\nframe = "tool"'), as_csv)
    log, hand = open_messages(bag), HandMap(topic="/tf", frame="tool")
    (_, position), turned = hand_pose(log, hand.model_copy(update={"base": "z"}), TimeMap(), tmp_path, 0.1)
    back = Rotation.from_quat(bench.links["z"][:, 3:]).inv()
    assert_allclose(position, back.apply((bench.links["tool"] - bench.links["z"])[:, :3]), atol=1e-12)
    assert (turned.inv() * back * Rotation.from_quat(bench.links["tool"][:, 3:])).magnitude().max() < 1e-12
    for change, error in (
        ({"frame": "toll"}, "hand.frame: got 'toll'; allowed: one of tool, x, yaw, z (nearest: tool)"),
        ({"base": "world"}, "hand.base: got 'world'; allowed: a frame above tool, or base"),
    ):
        assert error in no_pose(log, hand, change, tmp_path)


def test_a_cycle_of_transforms_is_refused(tmp_path: Path):
    def edge(parent: str, child: str, at: int) -> dict[str, Any]:
        header = {"stamp": {"sec": at, "nanosec": 0}, "frame_id": parent}
        moved = {"translation": dict.fromkeys("xyz", at), "rotation": {"x": 0, "y": 0, "z": 0, "w": 1}}
        return {"header": header, "child_frame_id": child, "transform": moved}

    pairs, times = (("x", "tool"), ("tool", "x")), (1, 2, 3)
    texts = [json.dumps({"transforms": [edge(*pair, at) for pair in pairs]}).encode() for at in times]
    sent = [Message(at, at, text) for at, text in zip(times, texts, strict=True)]
    log = MessageLog(tmp_path, {"/tf": "tf2_msgs/TFMessage"}, lambda _: sent)
    said = no_pose(log, HandMap(topic="/tf", frame="tool"), {}, tmp_path)
    assert "hand.frame: a cycle of transforms (tool, x, tool); allowed: a tree" in said


def stamps_of_tool(above: dict[int, float]) -> np.ndarray:
    """Stamps of a tool sent at 100 Hz for 6 s in a wrist sent at some of its samples, each at a place, m."""

    def edge(parent: str, child: str, i: int, x: float) -> dict[str, Any]:
        header = {"stamp": {"sec": i // 100, "nanosec": i % 100 * 10**7}, "frame_id": parent}
        moved = {"translation": {"x": x, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
        return {"header": header, "child_frame_id": child, "transform": moved}

    def sent(i: int) -> bytes:
        wrist = [edge("base", "wrist", i, above[i])] if i in above else []
        return json.dumps({"transforms": [edge("wrist", "tool", i, i / 100), *wrist]}).encode()

    messages = [Message(10**7 * i, 10**7 * i, sent(i)) for i in range(600)]
    log = MessageLog(Path("log.mcap"), {"/tf": "tf2_msgs/msg/TFMessage"}, lambda _: messages)
    return hand_pose(log, HandMap(topic="/tf", frame="tool"), TimeMap(), Path(), 0.1)[0].time_s


def test_no_pose_is_interpolated_where_a_transform_was_silent():
    stamps = stamps_of_tool({i: i / 100 for i in range(600) if not 200 < i < 400})
    assert np.diff(stamps).max() == pytest.approx(2.0) and len(stamps) == 401


@pytest.mark.parametrize(("every", "moves", "kept"), [(10, True, 591), (100, False, 501), (20, True, 30)])
def test_a_transform_that_rests_has_no_gaps(every: int, moves: bool, kept: int):
    assert len(stamps_of_tool({i: i / 100 if moves else 0.5 for i in range(0, 600, every)})) == kept


def test_joint_states_and_a_urdf(bench: Bench, as_csv: Trajectory, tmp_path: Path):
    (tmp_path / "gantry.urdf").write_text(URDF)
    bag = bench.bag(tmp_path / "bag", "sensor_msgs/msg/JointState", "/joint_states", bench.joint_state)
    hand = 'topic = "/joint_states"\nurdf = "gantry.urdf"\nframe = "tool"'
    same(imported(bag, hand), as_csv)
    (tmp_path / "other.urdf").write_text(URDF.replace('name="lift"', 'name="left"'))
    (tmp_path / "ball.urdf").write_text(URDF.replace('type="continuous"', 'type="floating"'))
    (tmp_path / "cut.urdf").write_text(URDF[:900])
    (tmp_path / "ring.urdf").write_text(URDF.replace('<parent link="base"/>', '<parent link="tool"/>'))
    still = URDF.replace("prismatic", "fixed").replace("continuous", "fixed")
    (tmp_path / "still.urdf").write_text(still)
    log, arm = open_messages(bag), HandMap(topic="/joint_states", urdf="gantry.urdf", frame="tool")
    for change, error in (
        ({"urdf": "other.urdf"}, "hand.urdf: got 'position.left'; allowed: one of "),
        ({"urdf": "ball.urdf"}, "joint turn: got 'floating'; allowed: one of revolute"),
        ({"urdf": "cut.urdf"}, "cut.urdf: not a URDF: "),
        ({"urdf": "ring.urdf"}, "ring.urdf: a cycle of links above tool; allowed: a tree"),
        ({"urdf": "still.urdf"}, "still.urdf: hand.frame: got 'tool'; allowed: a link that a joint moves"),
        ({"base": "tool"}, "hand.frame: got 'tool'; allowed: a link that a joint moves against tool"),
        ({"urdf": None}, "hand.urdf: got None; allowed: the arm's URDF"),
        ({"frame": "toll"}, "hand.frame: got 'toll'; allowed: one of x, z, yaw, tool, finger (nearest: tool)"),
        ({"base": "finger"}, "hand.base: got 'finger'; allowed: a link above tool, or base"),
        ({"topic": "/ft"}, "columns of the pose; /ft has geometry_msgs/WrenchStamped"),
        ({"topic": "/joints"}, "hand.topic: got '/joints'; allowed: one of /ft, /joint_states"),
    ):
        assert error in no_pose(log, arm, change, tmp_path)


def no_pose(log: MessageLog, hand: HandMap, change: dict[str, Any], folder: Path) -> str:
    with pytest.raises(HeftError) as raised:
        hand_pose(log, hand.model_copy(update=change), TimeMap(), folder, 0.1)
    return str(raised.value)


def test_a_damaged_file_or_bag_is_refused_in_one_line(bench: Bench, as_json: Path, tmp_path: Path):
    content = as_json.read_bytes()
    for at in np.linspace(1000, len(content) * 0.6, 4).astype(int):
        (tmp_path / "hit.mcap").write_bytes(content[:at] + bytes([content[at] ^ 4]) + content[at + 1 :])
        (tmp_path / "cut.mcap").write_bytes(content[:at])
        for name in ("hit.mcap", "cut.mcap"):
            with pytest.raises(HeftError, match=rf"^\S*{name}: not .* as a whole: [^\n]*$"):
                imported(tmp_path / name, 'topic = "/pose"')
    bag = bench.bag(tmp_path / "bag", "geometry_msgs/msg/PoseStamped", "/pose", bench.pose_message, "MCAP")
    (bag / "bag.mcap").unlink()
    with pytest.raises(HeftError, match=r"bag: not a ROS 2 bag as a whole: Some database files are missing"):
        imported(bag, 'topic = "/pose"')
