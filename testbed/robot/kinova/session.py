"""Session with a Gen3 over Kinova's `kortex_api`, in the Kortex process, with a watchdog that stops the arm.

The arm is stopped at the end of the session, at the end of heft, and after a silence of heft while it is engaged: from
the first motion until a stop, also at rest and while the gripper moves. If that fails, the process ends without a
goodbye, and the stand-by stops the arm. The arm's own estimate of the wrench is not used. Written for Python 3.8. SI
units and radians towards heft; meters, degrees and degrees per second towards the arm.
"""

from __future__ import annotations

import math
import os
import threading
import time
import traceback
from dataclasses import asdict, dataclass
from typing import Any

from testbed.robot.kinova.connection import Configuration, Connection, broken, said
from testbed.robot.kinova.standby import Beats

RATE = 100.0
"""Rate of feedback [Hz]."""
POSE_TIME = 60.0
"""Longest time to reach a pose [s]."""
_NOBODYS = -1
"""Epoch after a stop that heft did not request."""


@dataclass
class Feedback:
    """State of the arm, as it reports it."""

    time_s: float
    """Arrival [s], `time.monotonic`."""
    joint_position: list[float]
    """Joint angles [rad]."""
    joint_velocity: list[float]
    """Joint speeds [rad/s]."""
    tool_position: list[float]
    """Position of the TCP [m]."""
    tool_angles: list[float]
    """Euler angles of the tool about the fixed x, y and z axes, in this order [rad]."""
    tool_twist: list[float]
    """Linear and angular velocity of the tool [m/s, rad/s]."""
    gripper: float
    """Closed fraction of the stroke, 0 to 1; -1 without a gripper."""
    faulted: bool
    message: str


class Gen3:
    """One session with the arm, with threads for feedback, watchdog and twists."""

    def __init__(self, configuration: Configuration, line: Any, beats: Beats):
        self._line, self._beats = line, beats
        self._silence, self._watchdog = configuration.silence, configuration.watchdog
        self._connection = connection = Connection(configuration, configuration.silence)
        self._api, router, self._options = connection.api, connection.router, connection.options
        self._base, self._cyclic = connection.base, connection.cyclic
        self._control, self._device = self._api.ControlConfigClient(router), self._api.DeviceConfigClient(router)
        mode = self._api.Base.ServoingModeInformation()
        mode.servoing_mode = self._api.Base.SINGLE_LEVEL_SERVOING
        self._base.SetServoingMode(mode, 0, self._options())
        self._action_over, self._action_end = threading.Event(), ""
        self._base.OnNotificationActionTopic(self._on_action, self._api.Base.NotificationOptions())
        self._epoch = 0
        self._twisting = False
        self._parent = os.getppid()
        self._heard = self._fed = time.monotonic()
        self._wanted = None  # the twist to send next, and its request
        self._something = threading.Condition()
        self._sending = threading.Lock()
        self._over = threading.Event()
        for run in (self._feed, self._watch, self._send):
            threading.Thread(target=self._to_its_end, args=(run,), name=run.__name__, daemon=True).start()

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

    def hear(self, request: dict) -> None:
        """Reset the watchdog by a request of heft; during a twist only by a further twist."""
        if request["do"] == "twist" or not self._twisting:
            self._heard = time.monotonic()

    def twist(self, request: dict) -> None:
        """Queue a twist, which replaces one that has not been sent yet."""
        moves = any(request["twist"])
        with self._something:
            if request["epoch"] == self._epoch:
                if moves and not self._beats.engaged:
                    self._beats.engage(True)
                self._twisting = moves
                self._wanted = request
                self._something.notify()

    def stop(self, epoch: int = _NOBODYS) -> None:
        """Stop, and discard requests of other epochs; stop again after a twist in transit."""
        with self._something:
            self._epoch, self._wanted = epoch, None
        under_way = self._sending.locked()
        stopped = self._stop_now()
        if under_way:
            with self._sending:
                stopped = self._stop_now()
        with self._something:
            if stopped and self._epoch == epoch:
                self._twisting = False
                self._beats.engage(False)

    def pose(self, request: dict) -> None:
        """Move to a pose; the reply is sent on arrival or failure."""
        if not self._engaged_by(request):
            return
        action = self._api.Base.Action()
        action.name, action.application_data = "heft", ""
        target, speed = action.reach_pose.target_pose, action.reach_pose.constraint.speed
        target.x, target.y, target.z = request["position"]
        target.theta_x, target.theta_y, target.theta_z = (math.degrees(a) for a in request["angles"])
        speed.translation, speed.orientation = request["speed"], math.degrees(request["turn"])
        self._action_over.clear()
        self._base.ExecuteAction(action, 0, self._options())
        if request["epoch"] != self._epoch:  # stopped while it was on its way
            self._stop_now()
        if not self._action_over.wait(POSE_TIME):
            self.stop()
            self._reply(request, error=f"not there after {POSE_TIME:.0f} s")
        elif self._action_end:
            self._reply(request, error=self._action_end, stopped=request["epoch"] != self._epoch)
        else:
            self._reply(request)

    def grip(self, request: dict) -> None:
        """Move the fingers to a position, 0 open to 1 closed."""
        if not self._engaged_by(request):
            return
        command = self._api.Base.GripperCommand()
        command.mode = self._api.Base.GRIPPER_POSITION
        finger = command.gripper.finger.add()
        finger.finger_identifier, finger.value = 1, request["position"]
        self._base.SendGripperCommand(command, 0, self._options())
        self._reply(request)

    def close(self) -> None:
        """Stop, end the session, and send the goodbye to the stand-by."""
        self._over.set()
        self.stop()
        self._connection.close()
        self._beats.bye()

    def _engaged_by(self, request: dict) -> bool:
        """Engage the arm; False if it has been stopped since the request."""
        with self._something:
            if request["epoch"] == self._epoch:
                self._twisting = False
                self._beats.engage(True)
                return True
        self._reply(request, error="stopped before it began")
        return False

    def _reply(self, request: dict, **words: Any) -> None:
        self._line.say(id=request["id"], **words)

    def _stop_now(self) -> bool:
        try:
            self._connection.stop()
        except self._api.Failure as error:
            self._give_up(f"its process could not stop it: {said(error)}")
            return False
        return True

    def _give_up(self, why: str) -> None:
        """End without a goodbye, so that the stand-by takes over."""
        self._over.set()
        self._beats.end()
        self._line.say(lost=why)
        self._line.close()
        os._exit(1)

    def _to_its_end(self, run: Any) -> None:
        """Run a thread; its failure ends the process."""
        try:
            run()
        except BaseException as error:
            traceback.print_exc()
            self._give_up(f"its process failed: {said(error)}")

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
        """Thread: send twists one by one. A call takes some 25 ms."""
        command = self._api.Base.TwistCommand()
        command.reference_frame = self._api.Common.CARTESIAN_REFERENCE_FRAME_BASE
        command.duration = 0  # not implemented by the arm, which moves until the next command
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
                refused = ""
            except self._api.Failure as error:
                refused = f"twist refused: {said(error)}"
            finally:
                self._sending.release()
            if refused:
                self._reply(request, error=refused)
                self.stop()  # the previous twist may still be executed

    def _feed(self) -> None:
        """Thread: read feedback, 100 times a second."""
        due = time.monotonic()
        while not self._over.wait(max(due - time.monotonic(), 0.0)):
            due = max(due + 1 / RATE, time.monotonic())
            try:
                got = self._cyclic.RefreshFeedback(0, self._options())
            except self._api.Failure as error:
                if broken(error) and not self._over.is_set():
                    self._give_up(f"its connection has ended: {said(error)}")
                if time.monotonic() - self._fed > self._silence:
                    self._line.say(lost=f"no feedback: {said(error)}")
                continue
            self._fed = time.monotonic()
            self._beats.beat()
            self._line.offer(state=asdict(_feedback(got, self._fed, self._api)))

    def _watch(self) -> None:
        """Thread: stop an engaged arm after a silence of heft, at its end, or after a silence of its own feedback."""
        while not self._over.wait(0.005):
            now = time.monotonic()
            for who, since, allowed in (("heft", self._heard, self._watchdog), ("the arm", self._fed, self._silence)):
                if self._beats.engaged and now - since > allowed:
                    self.stop()
                    self._line.say(lost=f"stopped: {who} was silent for {allowed * 1e3:.0f} ms during a trial")
            if os.getppid() != self._parent:  # another process may hold the pipe open
                self.close()
                os._exit(0)


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
