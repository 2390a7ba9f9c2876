"""A session with a Gen3 over Kinova's `kortex_api`, in the process beside heft; it stops the arm by itself.

It does so after a silence of heft while the arm moves, when feedback or heft ends, and when it is closed. The arm's own
estimate of the wrench is never read. Written for Python 3.8. SI units and radians towards heft; meters, degrees and
degrees per second towards the arm.
"""

from __future__ import annotations

import collections
import collections.abc
import importlib
import math
import os
import sys
import threading
import time
from concurrent.futures import TimeoutError as Timeout
from dataclasses import asdict, dataclass
from types import SimpleNamespace
from typing import Any

RATE = 100.0
"""Rate of feedback [Hz]."""
POSE_TIME = 60.0
"""Longest time to reach a pose [s]."""
_NOBODYS = -1
"""Epoch after a stop without a request of heft."""
_STUBS, _MESSAGES = "autogen.client_stubs", "autogen.messages"
_USED = {
    "BaseClient": f"{_STUBS}.BaseClientRpc",
    "BaseCyclicClient": f"{_STUBS}.BaseCyclicClientRpc",
    "ControlConfigClient": f"{_STUBS}.ControlConfigClientRpc",
    "DeviceConfigClient": f"{_STUBS}.DeviceConfigClientRpc",
    "KException": "Exceptions.KException",
    "RouterClient": "RouterClient",
    "RouterClientSendOptions": "RouterClient",
    "SessionManager": "SessionManager",
    "TCPTransport": "TCPTransport",
}
"""Classes of `kortex_api` in use, and their modules."""


@dataclass
class Configuration:
    """Connection to the arm."""

    address: str
    port: int = 10000
    username: str = "admin"
    password: str = "admin"
    silence: float = 0.1
    """Time without feedback after which a moving arm is stopped [s]; the arm itself is told to stop after as long a
    silence of the connection."""
    watchdog: float = 0.05
    """Time without a request of heft after which a moving arm is stopped [s]."""


@dataclass
class Feedback:
    """State of the arm by its own feedback."""

    time_s: float
    """Arrival [s], `time.monotonic`."""
    joint_position: list[float]
    """Joint angles [rad]."""
    joint_velocity: list[float]
    """Joint speeds [rad/s]."""
    tool_position: list[float]
    """Position of the TCP [m]."""
    tool_angles: list[float]
    """Turns of the tool about the fixed x, y and z axes, in this order [rad]."""
    tool_twist: list[float]
    """Linear and angular velocity of the tool [m/s, rad/s]."""
    gripper: float
    """Closed part of the stroke, 0 to 1; -1 without a gripper."""
    faulted: bool
    message: str


class Gen3:
    """One session with the arm, and the two threads that watch over it."""

    def __init__(self, configuration: Configuration, line: Any):
        self._line, self._api = line, kortex_api()
        self._silence, self._watchdog = configuration.silence, configuration.watchdog
        self._transport, self._session, router = _connected(self._api, configuration)
        self._base, self._cyclic = self._api.BaseClient(router), self._api.BaseCyclicClient(router)
        self._control, self._device = self._api.ControlConfigClient(router), self._api.DeviceConfigClient(router)
        mode = self._api.Base.ServoingModeInformation()
        mode.servoing_mode = self._api.Base.SINGLE_LEVEL_SERVOING
        self._base.SetServoingMode(mode, 0, self._options())
        self._action_over, self._action_end = threading.Event(), ""
        self._base.OnNotificationActionTopic(self._on_action, self._api.Base.NotificationOptions())
        self._epoch = 0
        self._moving = False
        self._parent = os.getppid()
        self._heard = self._fed = time.monotonic()
        self._wanted = None  # the twist to send next, and its request
        self._something = threading.Condition()
        self._sending = threading.Lock()
        self._over = threading.Event()
        for run in (self._feed, self._watch, self._send):
            threading.Thread(target=run, name=run.__name__, daemon=True).start()

    def tool(self) -> list[float]:
        """Tool stored in the arm: position of its center point from the interface [m]."""
        t = self._control.GetToolConfiguration(0, self._options()).tool_transform
        return [t.x, t.y, t.z]

    def identity(self) -> list[str]:
        """Model, serial number and firmware of the arm, or "unknown"."""
        d, found = self._device, []
        for call, name in (
            (d.GetModelNumber, "model_number"),
            (d.GetSerialNumber, "serial_number"),
            (d.GetFirmwareVersion, "firmware_version"),
        ):
            try:
                value = getattr(call(0, self._options()), name)
            except self._api.Failure:
                value = "unknown"
            found.append(value if isinstance(value, str) else hex(value))
        return found

    def hear(self) -> None:
        """Note a sign of life of heft."""
        self._heard = time.monotonic()

    def twist(self, request: dict) -> None:
        """Send a twist after the one before it; of several that wait, the newest."""
        with self._something:
            if request["epoch"] == self._epoch:
                self._wanted = request
                self._moving = self._moving or any(request["twist"])
                self._something.notify()

    def stop(self, epoch: int = _NOBODYS) -> None:
        """Stop; requests of another epoch no longer count. A twist on its way is stopped after it."""
        with self._something:
            self._epoch, self._wanted = epoch, None
        under_way = self._sending.locked()
        stopped = self._stop_now()
        if under_way:
            with self._sending:
                stopped = self._stop_now()
        self._moving = self._moving and not stopped  # else the watchdog tries again

    def pose(self, request: dict) -> None:
        """Reach a pose; the reply goes out at its end or its failure."""
        if request["epoch"] != self._epoch:
            self._reply(request, error="stopped before it began")
            return
        action = self._api.Base.Action()
        action.name, action.application_data = "heft", ""
        target, speed = action.reach_pose.target_pose, action.reach_pose.constraint.speed
        target.x, target.y, target.z = request["position"]
        target.theta_x, target.theta_y, target.theta_z = (math.degrees(a) for a in request["angles"])
        speed.translation, speed.orientation = request["speed"], math.degrees(request["turn"])
        self._action_over.clear()
        self._moving = True
        self._base.ExecuteAction(action, 0, self._options())
        if not self._action_over.wait(POSE_TIME):
            self.stop()
            self._reply(request, error=f"not there after {POSE_TIME:.0f} s")
            return
        self._moving = False
        if self._action_end:
            self._reply(request, error=self._action_end, stopped=request["epoch"] != self._epoch)
        else:
            self._reply(request)

    def grip(self, request: dict) -> None:
        """Send the fingers to a position, 0 open to 1 closed."""
        command = self._api.Base.GripperCommand()
        command.mode = self._api.Base.GRIPPER_POSITION
        finger = command.gripper.finger.add()
        finger.finger_identifier, finger.value = 1, request["position"]
        self._base.SendGripperCommand(command, 0, self._options())
        self._reply(request)

    def close(self) -> None:
        """Stop, and end the session."""
        self._over.set()
        self.stop()
        try:
            self._session.CloseSession(self._options())
        except self._api.Failure:
            pass
        self._transport.disconnect()

    def _options(self) -> Any:
        return _options(self._api, self._silence)  # a call that takes longer is a silence too

    def _reply(self, request: dict, **said: Any) -> None:
        self._line.say(id=request["id"], **said)

    def _stop_now(self) -> bool:
        try:
            self._base.Stop(0, self._options())
        except self._api.Failure as error:
            try:
                self._base.ApplyEmergencyStop(0, self._options())
            except self._api.Failure:
                self._line.say(lost=f"the arm could not be told to stop: {_said(error)}")
                return False
        return True

    def _on_action(self, notification: Any, *_: Any) -> None:
        base = self._api.Base
        if notification.action_event == base.ACTION_END:
            self._action_end = ""
        elif notification.action_event == base.ACTION_ABORT:
            self._action_end = f"aborted by the arm (detail {notification.abort_details})"
        else:
            return
        self._action_over.set()

    def _send(self) -> None:
        """Thread: send one twist after the other. A call takes the arm some 25 ms."""
        command = self._api.Base.TwistCommand()
        command.reference_frame = self._api.Common.CARTESIAN_REFERENCE_FRAME_BASE
        command.duration = 0  # not implemented by the arm: it moves on until told otherwise
        while not self._over.is_set():
            with self._something:
                if self._wanted is None:
                    self._something.wait(self._silence)
                if self._wanted is None:
                    continue
                self._sending.acquire()
                request, self._wanted = self._wanted, None
            try:
                vx, vy, vz, wx, wy, wz = request["twist"]
                t = command.twist
                t.linear_x, t.linear_y, t.linear_z = vx, vy, vz
                t.angular_x, t.angular_y, t.angular_z = (math.degrees(w) for w in (wx, wy, wz))
                self._base.SendTwistCommand(command, 0, self._options())
                self._moving = any(request["twist"]) or self._wanted is not None
            except self._api.Failure as error:
                self._reply(request, error=f"twist refused: {_said(error)}")
            finally:
                self._sending.release()

    def _feed(self) -> None:
        """Thread: read feedback, 100 times a second."""
        due = time.monotonic()
        while not self._over.wait(max(due - time.monotonic(), 0.0)):
            due = max(due + 1 / RATE, time.monotonic())
            try:
                got = self._cyclic.RefreshFeedback(0, self._options())
            except self._api.Failure as error:
                if time.monotonic() - self._fed > self._silence:
                    self._line.say(lost=f"no feedback: {_said(error)}")
                continue
            self._fed = time.monotonic()
            self._line.say(state=asdict(_feedback(got, self._fed, self._api)))

    def _watch(self) -> None:
        """Thread: stop a moving arm after a silence of heft, at its end, or after a silence of its own feedback."""
        while not self._over.wait(0.005):
            now = time.monotonic()
            for who, since, allowed in (("heft", self._heard, self._watchdog), ("the arm", self._fed, self._silence)):
                if self._moving and now - since > allowed:
                    self.stop()
                    self._line.say(lost=f"stopped: {who} was silent for {allowed * 1e3:.0f} ms while the arm moved")
            if os.getppid() != self._parent:  # another holds the pipe open, so that it does not end
                self.close()
                os._exit(0)


def stop_once(configuration: Configuration) -> None:
    """Connect, stop the arm, and disconnect."""
    api = kortex_api()
    transport, session, router = _connected(api, configuration)
    base, options = api.BaseClient(router), _options(api, configuration.silence)
    try:
        base.Stop(0, options)
    except api.Failure:
        base.ApplyEmergencyStop(0, options)
    session.CloseSession(options)
    transport.disconnect()


def _connected(api: Any, configuration: Configuration) -> tuple:
    """Transport, session and router of a new connection."""
    transport = api.TCPTransport()
    router = api.RouterClient(transport, lambda error: print(error, file=sys.stderr))
    transport.connect(configuration.address, configuration.port)
    info = api.Session.CreateSessionInfo()
    info.username, info.password = configuration.username, configuration.password
    info.session_inactivity_timeout = 60000
    info.connection_inactivity_timeout = round(configuration.silence * 1000)
    session = api.SessionManager(router)
    session.CreateSession(info)
    return transport, session, router


def _options(api: Any, seconds: float) -> Any:
    options = api.RouterClientSendOptions()
    options.timeout_ms = round(seconds * 1000)
    return options


def _feedback(got: Any, now: float, api: Any) -> Feedback:
    base = got.base
    banks = (base.fault_bank_a, base.fault_bank_b)
    in_fault = base.active_state == api.Common.ARMSTATE_IN_FAULT
    motors = got.interconnect.gripper_feedback.motor
    return Feedback(
        time_s=now,
        joint_position=[math.remainder(math.radians(a.position), math.tau) for a in got.actuators],
        joint_velocity=[math.radians(a.velocity) for a in got.actuators],
        tool_position=[base.tool_pose_x, base.tool_pose_y, base.tool_pose_z],
        tool_angles=[math.radians(a) for a in (base.tool_pose_theta_x, base.tool_pose_theta_y, base.tool_pose_theta_z)],
        tool_twist=[base.tool_twist_linear_x, base.tool_twist_linear_y, base.tool_twist_linear_z]
        + [math.radians(w) for w in (base.tool_twist_angular_x, base.tool_twist_angular_y, base.tool_twist_angular_z)],
        gripper=motors[0].position / 100 if len(motors) else -1.0,
        faulted=in_fault or any(banks),
        message=f"fault banks {banks[0]:#x} {banks[1]:#x}" if in_fault or any(banks) else "",
    )


def _said(error: BaseException) -> str:
    """Name and text of an error; a call that takes too long has no text."""
    return f"{type(error).__name__} {error}".strip()


def kortex_api() -> Any:
    """The used part of `kortex_api`: classes, the messages Base, Common and Session, and the errors of calls (Failure).

    Raises:
        ImportError: it is not installed, or its protobuf does not fit this Python.
    """
    for name in ("MutableMapping", "MutableSequence"):  # protobuf 3.5 on Python 3.10 and later
        if not hasattr(collections, name):
            setattr(collections, name, getattr(collections.abc, name))
    used = {name: getattr(importlib.import_module(f"kortex_api.{module}"), name) for name, module in _USED.items()}
    for name in ("Base", "Common", "Session"):
        used[name] = importlib.import_module(f"kortex_api.{_MESSAGES}.{name}_pb2")
    return SimpleNamespace(Failure=(used["KException"], OSError, Timeout), **used)
