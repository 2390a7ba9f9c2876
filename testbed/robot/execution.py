"""Execution of a plan by the arm: hover, tare, descend, grip, settle, act, release, rise, tare again.

For a push the fingers close before the first tare, and remain closed.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.frames import move_wrench, rotate_wrench
from testbed.objects.model import GRAVITY
from testbed.robot.config import RobotSettings
from testbed.robot.guard import Guard
from testbed.robot.interfaces import Arm, ArmState, Clock, Gripper, Pose, RobotError, WrenchSensor
from testbed.robot.path import Leg, RobotPlan, closing_yaw, tool_down
from testbed.robot.recorder import GripEvidence, Mark
from testbed.robot.safety import UnsafeError, Violation
from testbed.trajectory import Phase

RESPONSE = 0.15
"""Allowed delay between a command and the motion of the arm [s]."""
READ_TIME = 2.0
"""Duration of weighing a lifted object [s]."""
_TILTED = math.radians(4)
"""Tilt of the tool in its check [rad], below the least limit of 5 degrees."""
_SHOWS = 0.3
"""Change of the tool's weight along the sensor's axes that a tilt must show [N]: half of it is five standard errors."""
_STILL = 0.3
"""Time for the arm to come to rest [s]."""


class Execution:
    """One run of a plan; its fields hold evidence and figures, also after an early end."""

    def __init__(
        self,
        plan: RobotPlan,
        arm: Arm,
        gripper: Gripper,
        sensor: WrenchSensor,
        guard: Guard,
        settings: RobotSettings,
        clock: Clock,
    ):
        self.evidence: GripEvidence | None = None
        self.figures: dict[str, float] = {}
        self._plan, self._arm, self._gripper, self._sensor, self._guard = plan, arm, gripper, sensor, guard
        self._settings, self._clock = settings, clock
        self._sent: list[float] = []
        self._off_path = 0.0
        self._rest, self._raised, self._tilt = np.zeros(6), np.zeros(3), Rotation.identity()

    def run(self, *, check_tool: bool = True) -> None:
        """Run the plan.

        Args:
            check_tool: tilt the tool above the object first, and compare the change of the wrench with its weight.

        Raises:
            RobotError: a device failed, or a limit was exceeded; the guard has stopped the arm.
        """
        lost = self._sensor.health().lost_frames
        self._go_to_hover()
        if check_tool:
            self._check_tool()
        self._rest = self._tare()
        self._guard.rest(self._rest)
        before = self._grip()
        self._act()
        after = self._let_go()
        self._tare()
        self.evidence = GripEvidence(self._sensor.health().lost_frames - lost, (before, after), None)

    def _go_to_hover(self) -> None:
        """Rise first if the tool is low, so that nothing is swept off the table."""
        hover, now = self._plan.hover, self._guard.state().tcp_pose
        if self._plan.grasp is None:
            self._gripper.close_on(0.0, self._settings.grip_force)
        else:
            self._gripper.open(self._plan.grasp.opening)
        self._guard.check()
        if now.position[2] < hover.position[2]:
            self._move_to(Pose(np.append(now.position[:2], hover.position[2]), now.orientation))
        self._move_to(hover)

    def _move_to(self, pose: Pose) -> None:
        self._arm.move_to(pose, self._settings.travel_speed)
        self._guard.check()

    def _check_tool(self) -> None:
        """Tilt the tool, and back: a wrong sign, rotation, mass or center is detected before any contact."""
        hover = self._plan.hover
        turn = hover.rotation * Rotation.from_rotvec([_TILTED, 0.0, 0.0])
        level = self._held()
        self._move_to(Pose(hover.position, turn.as_quat(scalar_first=True)))
        tilted = self._held()
        self._move_to(hover)
        change, due = tilted[0] - level[0], tilted[1] - level[1]
        off = np.abs(change - due)
        self.figures |= {"tool_check_N": float(off[:3].max()), "tool_check_Nm": float(off[3:].max())}
        for what, error, allowed, unit in (
            ("force", off[:3].max(), self._settings.tool_error[0], "N"),
            ("torque", off[3:].max(), self._settings.tool_error[1], "N m"),
        ):
            if not error <= allowed:
                raise RobotError(
                    f"tool: tilted by {math.degrees(_TILTED):.0f} deg, its {what} changed by {error:.3g} {unit} "
                    f"otherwise than its weight says; allowed: {allowed:g} {unit}; calibrate the sensor again, and "
                    "look for cables that pull"
                )
        weight = float(np.linalg.norm(due[:3]))
        if weight >= _SHOWS and not (shown := float(change[:3] @ due[:3]) / weight) >= weight / 2:
            raise RobotError(
                f"tool: tilted by {math.degrees(_TILTED):.0f} deg, the force changed by {shown:.2f} N of the "
                f"{weight:.2f} N of its weight; allowed: at least half; the sensor is dead, or the tool's mass is wrong"
            )

    def _held(self) -> tuple[np.ndarray, np.ndarray]:
        """Measured wrench at rest, and the wrench of the tool's weight [N, N m], sensor axes, each (6,)."""
        self._wait(_STILL)
        begin, settings = self._clock.now(), self._settings
        self._wait(_STILL)
        measured = settings.on_tool(self._guard.recorder.mean_wrench(begin, self._clock.now()))
        tool = self._guard.state().tcp_pose.rotation
        axes = tool * Rotation.from_quat(settings.sensor_orientation, scalar_first=True)
        force = axes.inv().apply([0.0, 0.0, settings.tool.mass * GRAVITY])
        return measured, np.concatenate([force, np.cross(settings.tool.com, force)])

    def _tare(self) -> np.ndarray:
        """Mean wrench at rest above the object, without the first third of the tare [N, N m], shape (6,)."""
        begin = self._clock.now()
        self._guard.recorder.mark(Mark(begin, Phase.TARE))
        self._wait(self._settings.tare_time)
        return self._guard.recorder.mean_wrench(begin + self._settings.tare_time / 3, self._clock.now())

    def _grip(self) -> float:
        """Descend; unless the action is a push, also close and settle. Returns the opening of the gripper [m]."""
        settings, mark = self._settings, self._guard.recorder.mark
        mark(Mark(self._clock.now(), Phase.APPROACH))
        self._follow(self._plan.descent)
        if self._plan.grasp is None:
            return self._gripper.width()
        mark(Mark(self._clock.now(), Phase.GRASP))
        self._gripper.close_on(self._plan.grasp.width, settings.grip_force)
        self._guard.check()
        mark(Mark(self._clock.now(), Phase.SETTLE))
        self._settle()
        return self._gripper.width()

    def _settle(self) -> None:
        """Yield to vertical load and tilting moment (admittance control); the action keeps that height and tilt."""
        settings, step = self._settings, 1 / self._settings.rate
        begin, way = self._clock.now(), np.zeros(6)
        for tick in range(round(settings.settle_time * settings.rate)):
            self._clock.sleep(begin + tick * step - self._clock.now())
            fx, fy, fz, tx, ty, _ = self._load(self._guard.state())
            # the load on the feet: vertical force, and moments about the table
            moment = np.array([tx - settings.grip_height * fy, ty + settings.grip_height * fx])
            twist = np.array([0.0, 0.0, -settings.null_gain[0] * fz, *(-settings.null_gain[1] * moment), 0.0])
            far = np.linalg.norm((way + twist * step)[:3]), np.linalg.norm((way + twist * step)[3:])
            twist[:3] *= far[0] <= settings.null_travel[0]
            twist[3:] *= far[1] <= settings.null_travel[1]
            way += twist * step
            self._guard.twist(twist[:3], twist[3:])
        self._guard.twist(np.zeros(3), np.zeros(3))
        self._wait(_STILL)
        pose = self._guard.state().tcp_pose
        yaw = float(closing_yaw(pose.orientation, settings))
        upright = Rotation.from_quat(tool_down(yaw, settings), scalar_first=True)
        self._tilt = upright.inv() * pose.rotation
        self._raised[2] = pose.position[2] - settings.table_height - settings.grip_height

    def _load(self, state: ArmState) -> np.ndarray:
        """Wrench of the gripper on the object about the TCP [N, N m], base axes, shape (6,)."""
        sample = self._guard.recorder.sample
        assert sample is not None
        axes = state.tcp_pose.rotation * Rotation.from_quat(self._settings.sensor_orientation, scalar_first=True)
        load = self._settings.on_tool(sample.wrench - self._rest)
        return rotate_wrench(axes.as_matrix(), move_wrench(load, self._settings.tool.tcp))

    def _act(self) -> None:
        mark, plan = self._guard.recorder.mark, self._plan
        if plan.act is not None:
            mark(Mark(self._clock.now(), Phase.RAMP, plan.act.path))
            self._follow(plan.act)
            return
        lift, down = plan.lift_and_down
        mark(Mark(self._clock.now(), Phase.RAMP))
        self._follow(lift)
        self._wait(self._settings.settle_time)
        mark(Mark(self._clock.now(), Phase.STEADY))
        self._wait(READ_TIME)
        mark(Mark(self._clock.now(), Phase.RAMP))
        self._follow(down)

    def _let_go(self) -> float:
        """Open the gripper and rise; returns the opening before [m]."""
        held = self._gripper.width()
        self._guard.recorder.mark(Mark(self._clock.now(), Phase.RELEASE))
        if self._plan.grasp is not None:
            self._gripper.open(self._plan.grasp.opening)
            self._guard.check()
        self._follow(self._plan.rise)
        return held

    def _wait(self, seconds: float) -> None:
        """Wait, checking the guard at every tick."""
        until = self._clock.now() + seconds
        while (left := until - self._clock.now()) > 0:
            self._guard.check()
            self._clock.sleep(min(left, 1 / self._settings.rate))
        self._guard.check()

    def _give_way(self, step: float) -> None:
        """Yield to the vertical load on the fingertip, within `null_travel`, since pushed faces tilt."""
        rate, most = self._settings.null_gain[0], self._settings.null_travel[0]
        way = -rate * step * float(self._load(self._guard.state())[2])
        self._raised[2] = np.clip(self._raised[2] + way, -most, most)

    def _follow(self, leg: Leg) -> None:
        """Follow a leg by twists: its velocity plus a correction of the pose error."""
        begin, step = self._clock.now(), 1 / self._settings.rate
        for tick in range(math.ceil(leg.duration / step)):
            self._clock.sleep(begin + tick * step - self._clock.now())
            self._sent.append(self._clock.now() - begin - tick * step)
            if leg is self._plan.act and self._plan.trial.action.pushes:
                self._give_way(step)
            self._guard.twist(*self._correction(leg, self._guard.state(), begin))
        self._clock.sleep(begin + leg.duration - self._clock.now())
        self._guard.twist(np.zeros(3), np.zeros(3))
        late = np.array(self._sent)
        self.figures |= {"command_late_p99_s": float(np.quantile(late, 0.99)), "off_path_m": self._off_path}

    def _correction(self, leg: Leg, state: ArmState, begin: float) -> tuple[np.ndarray, np.ndarray]:
        settings = self._settings
        then, ahead = leg.at(state.time_s - begin), leg.at(self._clock.now() - begin + 0.5 / settings.rate)
        off = then.position + self._raised - state.tcp_pose.position
        down = Rotation.from_quat(tool_down(then.yaw, settings), scalar_first=True)
        wanted = Rotation.from_rotvec(then.tilt) * down * self._tilt
        turn = (wanted * state.tcp_pose.rotation.inv()).as_rotvec()
        self._off_path = max(self._off_path, float(np.linalg.norm(off)))
        for name, error, rate, allowed, unit in (
            ("distance from the path", off, then.velocity, settings.off_path[0], "m"),
            ("angle from the path", turn, then.angular_velocity, settings.off_path[1], "rad"),
        ):
            limit = allowed + RESPONSE * float(np.linalg.norm(rate))
            if not np.linalg.norm(error) <= limit:
                raise UnsafeError(Violation(name, float(np.linalg.norm(error)), limit, unit))
        return ahead.velocity + settings.gain * off, ahead.angular_velocity + settings.gain * turn
