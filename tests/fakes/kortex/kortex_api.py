"""The part of Kinova's `kortex_api` 2.6 that heft uses, typed by hand, towards `tests.fakes.gen3` instead of an arm.

Names, fields and their types are those of the maker's published .proto files and Python examples; a name that is not
there raises AttributeError and a value of the wrong type TypeError, as protobuf does. On the wire there are JSON lines
instead of the maker's frames. Needs nothing but the standard library of Python 3.8.
"""

import itertools
import json
import socket
import sys
import threading
from concurrent.futures import Future
from types import ModuleType
from typing import Any, ClassVar

# a type, a message's name, or [of either] where it may be repeated
MESSAGES = {
    "Common": {"Empty": {}, "NotificationHandle": {"identifier": int}},
    "Session": {
        "CreateSessionInfo": {
            **dict.fromkeys(("username", "password"), str),
            **dict.fromkeys(("session_inactivity_timeout", "connection_inactivity_timeout"), int),
        }
    },
    "Base": {
        "ServoingModeInformation": {"servoing_mode": int},
        "NotificationOptions": {"type": int, "rate_m_sec": int, "threshold_value": float},
        "ActionHandle": {"identifier": int, "action_type": int, "permission": int},
        "ActionNotification": {"action_event": int, "handle": "ActionHandle", "abort_details": int},
        "Twist": dict.fromkeys(("linear_x", "linear_y", "linear_z", "angular_x", "angular_y", "angular_z"), float),
        "TwistCommand": {"reference_frame": int, "twist": "Twist", "duration": int},
        "Pose": dict.fromkeys(("x", "y", "z", "theta_x", "theta_y", "theta_z"), float),
        "CartesianSpeed": {"translation": float, "orientation": float},
        "CartesianTrajectoryConstraint": {"speed": "CartesianSpeed", "duration": float},
        "ConstrainedPose": {"target_pose": "Pose", "constraint": "CartesianTrajectoryConstraint"},
        "Action": {"handle": "ActionHandle", "name": str, "application_data": str, "reach_pose": "ConstrainedPose"},
        "Finger": {"finger_identifier": int, "value": float},
        "Gripper": {"finger": ["Finger"]},
        "GripperCommand": {"mode": int, "gripper": "Gripper", "duration": int},
    },
    "BaseCyclic": {
        "BaseFeedback": {
            **dict.fromkeys(("active_state", "fault_bank_a", "fault_bank_b", "warning_bank_a", "warning_bank_b"), int),
            **{f"tool_pose_{n}": float for n in ("x", "y", "z", "theta_x", "theta_y", "theta_z")},
            **{f"tool_twist_{kind}_{axis}": float for kind in ("linear", "angular") for axis in "xyz"},
            **{f"tool_external_wrench_{kind}_{axis}": float for kind in ("force", "torque") for axis in "xyz"},
        },
        "ActuatorFeedback": {"position": float, "velocity": float, "torque": float, "fault_bank_a": int},
        "MotorFeedback": {"motor_id": int, "position": float, "velocity": float, "current_motor": float},
        "GripperFeedback": {"status_flags": int, "motor": ["MotorFeedback"]},
        "InterconnectFeedback": {"gripper_feedback": "GripperFeedback"},
        "Feedback": {
            "frame_id": int,
            "base": "BaseFeedback",
            "actuators": ["ActuatorFeedback"],
            "interconnect": "InterconnectFeedback",
        },
    },
    "ControlConfig": {
        "CartesianTransform": dict.fromkeys(("x", "y", "z", "theta_x", "theta_y", "theta_z"), float),
        "ToolConfiguration": {"tool_transform": "CartesianTransform", "tool_mass": float},
    },
    "DeviceConfig": {
        "ModelNumber": {"model_number": str},
        "SerialNumber": {"serial_number": str},
        "FirmwareVersion": {"firmware_version": int},
    },
}
CONSTANTS = {
    "Base": {"SINGLE_LEVEL_SERVOING": 2, "GRIPPER_POSITION": 3, "ACTION_END": 1, "ACTION_ABORT": 2},
    "Common": {"CARTESIAN_REFERENCE_FRAME_BASE": 3, "ARMSTATE_IN_FAULT": 4},
}
_IDENTITY = {
    "GetModelNumber": "ModelNumber",
    "GetSerialNumber": "SerialNumber",
    "GetFirmwareVersion": "FirmwareVersion",
}
_BARE = ("Stop", "ApplyEmergencyStop", "RefreshFeedback", "GetToolConfiguration", *_IDENTITY)
"""Calls without a message."""
_BASE = ("SetServoingMode", "ExecuteAction", "SendTwistCommand", "SendGripperCommand", *_BARE[:2])
CALLS = {
    "Base": dict.fromkeys(_BASE, "Empty"),
    "BaseCyclic": {"RefreshFeedback": "Feedback"},
    "ControlConfig": {"GetToolConfiguration": "ToolConfiguration"},
    "DeviceConfig": _IDENTITY,
}


class Repeated(list):
    """Repeated messages."""

    def __init__(self, kind):
        super().__init__()
        self._kind = kind

    def add(self):
        self.append(self._kind())
        return self[-1]


class Message:
    """A message whose fields are those of `fields` and no others."""

    fields: ClassVar[dict] = {}
    kinds: ClassVar[dict] = {}

    def __init__(self):
        for name, kind in self.fields.items():
            if isinstance(kind, list):
                value = Repeated(self.kinds[kind[0]])
            else:
                value = self.kinds[kind]() if isinstance(kind, str) else kind()
            object.__setattr__(self, name, value)

    def __setattr__(self, name, value):
        kind = self.fields.get(name)
        if kind is None:
            raise AttributeError(f"{type(self).__name__} has no field {name}")
        if not isinstance(kind, type):
            raise AttributeError(f"assignment to the message field {name} is not allowed")
        if isinstance(value, bool) or not isinstance(value, (int, float) if kind is float else kind):
            raise TypeError(f"{type(self).__name__}.{name}: {value!r} is no {kind.__name__}")
        object.__setattr__(self, name, value)

    def plain(self):
        def of(value):
            if isinstance(value, Message):
                return value.plain()
            return [of(v) for v in value] if isinstance(value, list) else value

        return {name: of(getattr(self, name)) for name in self.fields}

    def filled(self, data):
        for name, value in data.items():
            here = getattr(self, name)
            if isinstance(here, Message):
                here.filled(value)
            elif isinstance(here, Repeated):
                for item in value:
                    here.add().filled(item)
            else:
                setattr(self, name, value)
        return self


class KException(Exception):
    """Base of what calls raise."""


class KServerException(KException):
    """The arm refused."""


class RouterClientSendOptions:
    def __init__(self):
        self.andForget, self.delay_ms, self.timeout_ms = False, 0, 10000


class TCPTransport:
    def __init__(self):
        self.socket: Any = None
        self.receive: Any = None

    def connect(self, address, port):
        self.socket = socket.create_connection((address, port), 5.0)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket.settimeout(None)
        threading.Thread(target=self._read, daemon=True).start()

    def send(self, data):
        self.socket.sendall(data)

    def disconnect(self):
        self.socket.close()

    def _read(self):
        try:
            for line in self.socket.makefile("r", encoding="utf-8"):
                self.receive(json.loads(line))
        except OSError:
            pass


class RouterClient:
    def __init__(self, transport, error_callback=None):
        self._transport, self.notified = transport, []
        self._waiting, self._numbers = {}, itertools.count(1)
        transport.receive = self._on_frame

    def call(self, name, message, kind, options):
        number, future = next(self._numbers), Future()
        self._waiting[number] = future
        self._transport.send((json.dumps({"id": number, "call": name, "message": message.plain()}) + "\n").encode())
        return kind().filled(future.result((options or RouterClientSendOptions()).timeout_ms / 1000))

    def _on_frame(self, frame):
        if "notification" in frame:
            for callback, kind in self.notified:
                callback(kind().filled(frame["notification"]))
            return
        future = self._waiting.pop(frame["id"], None)
        if future is None:
            return
        if "error" in frame:
            future.set_exception(KServerException(frame["error"]))
        else:
            future.set_result(frame["reply"])


class SessionManager:
    def __init__(self, router):
        self._router = router

    def CreateSession(self, info, options=None):
        self._router.call("Session.CreateSession", info, Message, options)

    def CloseSession(self, options=None):
        self._router.call("Session.CloseSession", Message(), Message, options)


def _module(name, **contents):
    module = ModuleType(f"kortex_api.{name}")
    module.__dict__.update(contents)
    sys.modules[module.__name__] = module
    return module


def _client(service, modules):
    def method(call, returns):
        def with_message(self, message, deviceId=0, options=None):
            return self._router.call(f"{service}.{call}", message, modules[returns], options)

        def without(self, deviceId=0, options=None):
            return self._router.call(f"{service}.{call}", Message(), modules[returns], options)

        return without if call in _BARE else with_message

    def subscribe(self, callback, options_message, deviceId=0, options=None):
        self._router.notified.append((callback, modules["ActionNotification"]))
        return modules["NotificationHandle"]()

    body: dict[str, Any] = {call: method(call, returns) for call, returns in CALLS[service].items()}
    body["__init__"] = lambda self, router: setattr(self, "_router", router)
    if service == "Base":
        body["OnNotificationActionTopic"] = subscribe
    return type(f"{service}Client", (), body)


def _build():
    kinds: dict = {}
    for service, messages in MESSAGES.items():
        own = {name: type(name, (Message,), {"fields": fields, "kinds": kinds}) for name, fields in messages.items()}
        kinds.update(own)
        _module(f"autogen.messages.{service}_pb2", **own, **CONSTANTS.get(service, {}))
    for service in CALLS:
        _module(f"autogen.client_stubs.{service}ClientRpc", **{f"{service}Client": _client(service, kinds)})
    for package in ("autogen", "autogen.messages", "autogen.client_stubs", "Exceptions"):
        _module(package)
    _module("Exceptions.KException", KException=KException)
    _module("RouterClient", RouterClient=RouterClient, RouterClientSendOptions=RouterClientSendOptions)
    _module("SessionManager", SessionManager=SessionManager)
    _module("TCPTransport", TCPTransport=TCPTransport)


_build()
