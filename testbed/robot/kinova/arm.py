"""Driver of a Kinova Gen3 over Kortex, which runs in a process of its own."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import Annotated, Self

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.robot.interfaces import ArmIdentity, ArmLimits, ArmLostError, ArmRefusedError, ArmState, Pose, RobotError
from testbed.robot.kinova.connection import Configuration
from testbed.robot.kinova.link import KortexLink
from testbed.robot.kinova.session import Feedback
from testbed.validation import Range, check_settings

_ENDLESS = (-math.inf, math.inf)
GEN3 = ArmLimits(
    joint_range=np.array([_ENDLESS, (-2.24, 2.24), _ENDLESS, (-2.57, 2.57), _ENDLESS, (-2.09, 2.09), _ENDLESS]),
    joint_speed=np.radians([80, 80, 80, 80, 70, 70, 70]),
    linear_speed=0.5,
    angular_speed=math.radians(100),
)
"""Limits of the seven-joint Gen3, as published by Kinova."""
_ARRIVED = 0.002, math.radians(0.5)
"""Largest distance [m] and angle [rad] from a pose that has been reached."""
_RECHECK = 0.025
"""Time between checks of a reported arrival [s]."""


@dataclass(eq=False)
class KortexArm:
    """An `Arm`. Entering connects and sets the servoing mode, without motion or clearing of faults."""

    address: str = "192.168.1.10"
    """Address of the arm."""
    port: Annotated[int, Range(1, 65535, "")] = 10000
    """TCP port of the arm."""
    username: str = "admin"
    """User of the arm."""
    password: str = field(default="admin", repr=False)
    """Password of that user."""
    tool_length: Annotated[float, Range(0.02, 0.6, "m")] = 0.2115
    """Distance from the arm's interface to the tool center point [m]: sensor, coupling and gripper."""
    turn_speed: Annotated[float, Range(0.01, GEN3.angular_speed, "rad/s")] = math.radians(30)
    """Turn rate during `move_to` [rad/s]."""
    silence: Annotated[float, Range(0.02, 0.2, "s")] = 0.1
    """Time without feedback after which a moving arm is stopped, and counts as lost [s]; also the arm's own timeout. A
    process that is silent for 0.6 times as long counts as frozen."""
    watchdog: Annotated[float, Range(0.02, 0.1, "s")] = 0.05
    """Time after which the arm is stopped [s] if no further twist follows one, or if `state` is not called between the
    first motion and a stop."""
    limits = GEN3
    """Limits of the arm; known before connecting."""

    def __post_init__(self) -> None:
        check_settings(KortexArm, vars(self), "KortexArm")
        self._link: KortexLink | None = None
        self._epoch = 0
        self._engaged = False

    @property
    def identity(self) -> ArmIdentity:
        """Model, serial number and firmware as reported by the arm."""
        return ArmIdentity() if self._link is None else self._link.identity

    def __enter__(self) -> Self:
        """Connect.

        Raises:
            RobotError: no `kortex_api`, no arm, or another tool stored in it than expected.
        """
        self._epoch, self._engaged = 0, False
        who = self.username, self.password
        self._link = KortexLink(Configuration(self.address, self.port, *who, self.silence, self.watchdog))
        x, y, z = self._link.tool
        if max(abs(x), abs(y), abs(z - self.tool_length)) > 1e-3:
            self.__exit__(None, None, None)
            raise RobotError(
                f"arm {self.address}: its stored tool has its center at ({x:.4f}, {y:.4f}, {z:.4f}) m; expected "
                f"(0, 0, {self.tool_length:.4f}) m; set it in the arm's Web App under Configurations, Robot, Arm, Tool"
            )
        return self

    def __exit__(self, *_: object) -> None:
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def state(self) -> ArmState:
        """The newest feedback. From the first motion until a stop each call resets the watchdog.

        Raises:
            ArmLostError: no connection, no fresh feedback, or no stand-by while one is required.
        """
        f = self._feedback()
        turn = Rotation.from_euler("xyz", f.tool_angles)
        return ArmState(
            time_s=f.time_s,
            joint_position=np.array(f.joint_position),
            joint_velocity=np.array(f.joint_velocity),
            tcp_pose=Pose(np.array(f.tool_position), turn.as_quat(scalar_first=True)),
            tcp_twist=np.array(f.tool_twist),
            faulted=f.faulted,
            message=f.message,
        )

    def move_to(self, pose: Pose, speed: float) -> None:
        """Move to a pose at no more than `speed` [m/s]; returns on arrival or after `stop`."""
        epoch = self._epoch
        link = self._ready()
        number = link.ask(
            "pose",
            position=pose.position.tolist(),
            angles=pose.rotation.as_euler("xyz").tolist(),
            speed=min(speed, GEN3.linear_speed),
            turn=self.turn_speed,
            epoch=epoch,
        )
        while (reply := link.reply(number, 1.0)) is None:
            pass
        if epoch != self._epoch:
            return
        if "error" in reply:
            raise ArmRefusedError(f"arm: the pose was not reached: {reply['error']}")
        self._check_arrival(pose)

    def _check_arrival(self, pose: Pose) -> None:
        """Wait up to 0.5 s for the arrival, which the arm may report too early."""
        until = time.monotonic() + 0.5
        while True:
            now = self.state().tcp_pose
            off = float(np.linalg.norm(now.position - pose.position))
            turned = float((now.rotation.inv() * pose.rotation).magnitude())
            if off <= _ARRIVED[0] and turned <= _ARRIVED[1]:
                return
            if time.monotonic() > until:
                raise ArmRefusedError(
                    f"arm: it says that it has arrived, {off * 1e3:.1f} mm and {math.degrees(turned):.2f} deg off; "
                    "choose a slower or nearer pose"
                )
            time.sleep(_RECHECK)

    def twist(self, linear: Float[np.ndarray, "3"], angular: Float[np.ndarray, "3"]) -> None:
        """Move at a velocity [m/s, rad/s], base axes, until the next command or the watchdog's stop."""
        link = self._ready()
        fast = float(np.linalg.norm(linear)), float(np.linalg.norm(angular))
        if not (fast[0] <= GEN3.linear_speed and fast[1] <= GEN3.angular_speed):
            raise ArmRefusedError(
                f"arm: a twist of {fast[0]:.3g} m/s and {fast[1]:.3g} rad/s; allowed: {GEN3.linear_speed:g} m/s and "
                f"{GEN3.angular_speed:.3g} rad/s"
            )
        if said := link.refused():
            raise ArmRefusedError(f"arm: {said}")
        link.ask("twist", twist=[*map(float, linear), *map(float, angular)], epoch=self._epoch)

    def stop(self) -> None:
        """Stop all motion; callable from any thread and repeatedly. Earlier requests are discarded."""
        link = self._link
        if link is None:
            return
        self._epoch += 1
        self._engaged = False
        link.stop(self._epoch)

    def ask(self, do: str, seconds: float = 1.0, **request: float) -> None:
        """Make a request that is answered at once.

        Raises:
            ArmRefusedError: in a fault, or it was refused.
            ArmLostError: no connection, or no answer.
        """
        link = self._ready()
        reply = link.reply(link.ask(do, epoch=self._epoch, **request), seconds)
        if reply is None:
            raise ArmLostError(f"arm: no answer to {do} in {seconds:g} s")
        if "error" in reply:
            raise ArmRefusedError(f"arm: {do}: {reply['error']}")

    def closed_part(self) -> float:
        """Closed part of the gripper's stroke, 0 to 1.

        Raises:
            ArmRefusedError: no gripper is connected to the arm.
            ArmLostError: no connection.
        """
        part = self._feedback().gripper
        if part < 0:
            raise ArmRefusedError("gripper: the arm has none at its interface; check its wiring through the sensor")
        return part

    def _connected(self) -> KortexLink:
        if self._link is None:
            raise ArmLostError("arm: not connected; use it in a with statement")
        return self._link

    def _feedback(self) -> Feedback:
        """The newest feedback; resets the watchdog of an engaged arm."""
        link = self._connected()
        feedback, age = link.feedback, link.age
        if link.lost or feedback is None or age > self.silence:
            raise ArmLostError(f"arm: {link.lost or f'no feedback for {age * 1e3:.0f} ms'}")
        if self._engaged:
            link.check_standby()
            link.send(do="alive")
        return feedback

    def _ready(self) -> KortexLink:
        """Engage the arm, which activates the watchdog; returns the link."""
        self._engaged = True
        feedback = self._feedback()
        if feedback.faulted:
            raise ArmRefusedError(f"arm: in a fault ({feedback.message}); clear it")
        return self._connected()
