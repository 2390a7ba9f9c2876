"""A Gen3 at the other end of the wire: a MuJoCo simulation stepped in real time behind the calls of Kortex.

`tests/fakes/kortex` is what speaks to it; the process that heft starts runs unmodified. Like the real one it turns in
degrees a second, moves on until it is told otherwise, ignores a twist's duration, reports an action's end by a
notification, and stops when a connection has been silent for as long as it was told to allow.
"""

import json
import math
import socket
import struct
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.objects.model import STROKE
from tests.fakes.world import TICK, Gen3World

PASSWORD = "admin"
RESET = struct.pack("ii", 1, 0)
"""Value of SO_LINGER by which a closed connection ends in a reset."""


@dataclass
class Faults:
    """Faults from now on; tests change them while the arm runs."""

    fault_bank: int = 0
    """Not 0: the arm is in a fault, and refuses to move until it is cleared."""
    refuse: str = ""
    """A call that is refused, such as "Base.SendTwistCommand"."""
    aborts: bool = False
    """Poses are aborted half way."""
    short: bool = False
    """Poses end before they are reached, and are reported as reached."""
    endures_silence: bool = False
    """It does not stop by itself when a connection is silent."""


@dataclass
class Session:
    """An open session."""

    allowed: float
    """Longest silence of its connection [s]."""
    heard: float = field(default_factory=time.monotonic)
    """Time of its last call [s]."""
    controls: bool = False
    """True if it has set the servoing mode."""


class FakeGen3:
    """Runs while it is entered. `port` is where it listens."""

    def __init__(self, world: Gen3World):
        self.world, self.faults = world, Faults()
        self.lock = threading.RLock()
        """Held while the world ticks."""
        self.commands: list[str] = []
        """Name of each call that may move the arm."""
        self.was_driven = False
        """True once the arm has been driven."""
        self.sessions: dict[socket.socket, Session] = {}
        """Open sessions by their connection."""
        self._over = threading.Event()
        self._connections: set[socket.socket] = set()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self._reaching = False

    def __enter__(self) -> Self:
        for run in (self._live, self._accept):
            threading.Thread(target=run, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._listening.close()
        self.drop()

    def drop(self) -> None:
        """Close every connection."""
        for connection in list(self._connections):
            self._connections.discard(connection)
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def reset(self, *, controls: bool | None = None) -> None:
        """Reset the connection that controls the arm, those that do not, or all (None); new ones are accepted."""
        for connection in list(self._connections):
            session = self.sessions.get(connection)
            if controls is None or (session is not None and session.controls) == controls:
                with suppress(OSError):
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                    connection.shutdown(socket.SHUT_RD)  # ends the thread that serves it, which closes it

    def _live(self) -> None:
        due = time.monotonic()
        while not self._over.wait(max(due - time.monotonic(), 0.0)):
            due += TICK
            with self.lock:
                if self._silent() or self.faults.fault_bank:
                    self.world.stop()
                self._end_of_pose()
                self.world.tick()
                self.was_driven |= self.world.driven

    def _silent(self) -> bool:
        """End the sessions that have been silent for too long; True if that stops the arm."""
        now, ends = time.monotonic(), not self.faults.endures_silence
        silent = [c for c, session in list(self.sessions.items()) if now - session.heard > session.allowed]
        for connection in silent:
            if ends or connection not in self._connections:
                self.sessions.pop(connection, None)
        if silent and ends:
            self.commands.append("own limit")
        return bool(silent) and ends

    def _end_of_pose(self) -> None:
        if not self._reaching:
            return
        goal, half_way = self.world.goal, self.faults.aborts or self.faults.short
        if goal is not None and half_way and np.linalg.norm(goal[0] - self.world.reading.tcp_pose.position) < 0.01:
            self.world.stop()
        if self.world.goal is None:
            self._reaching = False
            self._notify(2 if self.faults.aborts or self.faults.fault_bank or self._stopped else 1)

    def _accept(self) -> None:
        while not self._over.is_set():
            try:
                connection, _ = self._listening.accept()
            except OSError:
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._connections.add(connection)
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        answering = threading.Lock()
        try:
            with connection, connection.makefile("r", encoding="utf-8") as lines:
                for line in lines:
                    if (session := self.sessions.get(connection)) is not None:
                        session.heard = time.monotonic()
                    threading.Thread(
                        target=self._answer, args=(connection, answering, json.loads(line)), daemon=True
                    ).start()
        except OSError:
            pass
        self._connections.discard(connection)

    def _answer(self, connection: socket.socket, answering: threading.Lock, frame: dict[str, Any]) -> None:
        name, answer = frame["call"], {"id": frame["id"]}
        try:
            if name == self.faults.refuse:
                raise Refusal("refused by order of the test")
            with self.lock:
                reply = self._reply(connection, name, frame["message"])
            time.sleep(0.02 if name == "Base.SendTwistCommand" else 0.0)
            answer["reply"] = reply or {}
        except Refusal as refusal:
            answer["error"] = str(refusal)
        with answering, suppress(OSError):
            connection.sendall((json.dumps(answer) + "\n").encode())

    def _notify(self, event: int) -> None:
        data = json.dumps({"notification": {"action_event": event, "abort_details": 55 if event == 2 else 0}}) + "\n"
        for connection in list(self._connections):
            with suppress(OSError):
                connection.sendall(data.encode())

    def _reply(self, connection: socket.socket, name: str, message: dict[str, Any]) -> dict[str, Any] | None:
        if name == "Session.CreateSession":
            if message["password"] != PASSWORD:
                raise Refusal("wrong password")
            self.sessions[connection] = Session(message["connection_inactivity_timeout"] / 1000)
        elif connection not in self.sessions:
            raise Refusal("no session")
        elif name == "Session.CloseSession":
            del self.sessions[connection]
        elif name == "Base.SetServoingMode":
            assert message["servoing_mode"] == 2
            self.sessions[connection].controls = True
        else:
            return getattr(self, "_" + name.replace(".", "_"))(message)
        return None

    def _Base_SendTwistCommand(self, command: dict[str, Any]) -> None:
        self._check("SendTwistCommand")
        t = command["twist"]
        linear = np.array([t["linear_x"], t["linear_y"], t["linear_z"]])
        angular = np.radians([t["angular_x"], t["angular_y"], t["angular_z"]])
        if command["reference_frame"] != 3:  # the tool's axes
            tool = Rotation.from_quat(self.world.reading.tcp_pose.orientation, scalar_first=True)
            linear, angular = tool.apply(linear), tool.apply(angular)
        self.world.goal, self.world.twist = None, np.concatenate([linear, angular])

    def _Base_ExecuteAction(self, action: dict[str, Any]) -> None:
        self._check("ExecuteAction")
        pose, speed = action["reach_pose"]["target_pose"], action["reach_pose"]["constraint"]["speed"]
        if math.hypot(pose["x"], pose["y"]) > 0.9:
            raise Refusal("outside the workspace")
        turn = Rotation.from_euler("xyz", [pose["theta_x"], pose["theta_y"], pose["theta_z"]], degrees=True)
        self._stopped, self._reaching = False, True
        self.world.goal = (np.array([pose["x"], pose["y"], pose["z"]]), turn, speed["translation"])

    def _Base_Stop(self, _: dict[str, Any]) -> None:
        self.commands.append("Stop")
        self._stopped = True
        self.world.stop()

    _Base_ApplyEmergencyStop = _Base_Stop

    def _Base_SendGripperCommand(self, command: dict[str, Any]) -> None:
        self._check("SendGripperCommand")
        if (closed := command["gripper"]["finger"][0]["value"]) == 1:
            self.world.grip = 1.0
        else:
            self.world.open(STROKE * (1 - closed))

    def _BaseCyclic_RefreshFeedback(self, _: dict[str, Any]) -> dict[str, Any]:
        r, single = self.world.reading, lambda values: np.asarray(values, np.float32).tolist()
        turn = Rotation.from_quat(r.tcp_pose.orientation, scalar_first=True).as_euler("xyz", degrees=True)
        pose = single([*r.tcp_pose.position, *turn])
        twist = single([*r.tcp_twist[:3], *np.degrees(r.tcp_twist[3:])])
        names = ("x", "y", "z", "theta_x", "theta_y", "theta_z")
        base = {f"tool_pose_{name}": value for name, value in zip(names, pose, strict=True)}
        kinds = [f"tool_twist_{kind}_{axis}" for kind in ("linear", "angular") for axis in "xyz"]
        base |= dict(zip(kinds, twist, strict=True))
        base |= {"fault_bank_a": self.faults.fault_bank, "active_state": 4 if self.faults.fault_bank else 7}
        # positions run from 0 to 360 degrees
        joints = zip(single(np.degrees(r.joint_position) % 360), single(np.degrees(r.joint_velocity)), strict=True)
        closed = round(255 * (1 - min(max(self.world.width / STROKE, 0.0), 1.0))) / 255
        return {
            "base": base,
            "actuators": [{"position": q, "velocity": qd} for q, qd in joints],
            "interconnect": {"gripper_feedback": {"motor": [{"position": 100 * closed}]}},
        }

    def _ControlConfig_GetToolConfiguration(self, _: dict[str, Any]) -> dict[str, Any]:
        return {"tool_transform": {"z": 0.2115}, "tool_mass": 1.37}

    def _DeviceConfig_GetModelNumber(self, _: dict[str, Any]) -> dict[str, Any]:
        return {"model_number": "GEN3-7DOF"}

    def _DeviceConfig_GetSerialNumber(self, _: dict[str, Any]) -> dict[str, Any]:
        return {"serial_number": "AC123456-1"}

    def _DeviceConfig_GetFirmwareVersion(self, _: dict[str, Any]) -> dict[str, Any]:
        return {"firmware_version": 0x20600}

    def _check(self, name: str) -> None:
        self.commands.append(name)
        if self.faults.fault_bank:
            raise Refusal("robot in fault")


class Refusal(Exception):
    """Refusal of a call by the arm."""
