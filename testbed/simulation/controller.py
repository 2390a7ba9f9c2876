"""Outer loop of the arm at the record rate: integral action, and nulling of load and tilt after the grip closes."""

from __future__ import annotations

import mujoco
import numpy as np

from testbed.simulation.motion import Motion
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Phase

_NULL_TIME_CONSTANT = 0.15
_OPENING_FORCE = -5.0


class Servo:
    """Outer loop of one trial.

    The inner loop, inside MuJoCo, is the position servo of gen3.xml. Its actuators integrate a joint speed, so targets
    move smoothly between ticks without a command per step.
    """

    def __init__(self, data: mujoco.MjData, motion: Motion, settings: SimulationSettings):
        model, tcp, sensor = data.model, data.site("gripper/tcp"), data.site("ft/wrench")
        self._data, self._motion, self._settings = data, motion, settings
        self._dt = 1 / settings.rate
        self._stiffness = model.actuator_gainprm[:7, 0].copy()
        lag = -model.actuator_biasprm[:7, 2] / self._stiffness
        self._ahead = lag * motion.qd
        self._gain = settings.servo.integral_gain * self._dt
        self._integral = np.zeros(7)
        self._shift = np.zeros(7)
        self._tare = np.zeros(6)
        self._jacobian = np.zeros((6, model.nv))
        # Views of the simulation's state: a look-up at every tick would cost as much as the control law
        self._position, self._target, self._control = data.qpos[:7], data.act[:7], data.ctrl
        self._force, self._torque = data.sensor("ft/force").data, data.sensor("ft/torque").data
        self._rotation, self._place = sensor.xmat.reshape(3, 3), sensor.xpos
        self._tcp, self._tcp_at = tcp.id, tcp.xpos
        self._weld = model.equality("weld").id if settings.grip.mode == "weld" else None
        # An integral from the descent would shift the hand as it closes
        self._integrates = motion.phase >= Phase.GRASP
        self._holds = (motion.phase >= Phase.SETTLE) & (motion.phase < Phase.RELEASE)
        self._tares, self._settles = motion.phase == Phase.TARE, motion.phase == Phase.SETTLE

    def command(self, tick: int) -> None:
        """Set joint speeds and grip for the coming tick."""
        reference = self._motion.q[tick] + self._shift
        if self._integrates[tick]:
            self._integral += self._gain * (reference - self._position)
        target = reference + self._ahead[tick] + self._integral
        self._control[:7] = (target - self._target) / self._dt
        if self._weld is None:
            self._control[7] = self._motion.grip[tick] * self._settings.grip.force
        else:
            self._hold(held=bool(self._holds[tick]))

    def _hold(self, *, held: bool) -> None:
        """Weld hand and object in their present pose, or release them; the fingers stay open."""
        data = self._data
        self._control[7] = _OPENING_FORCE
        if held and not data.eq_active[self._weld]:
            model = data.model
            hand, body = model.eq_obj1id[self._weld], model.eq_obj2id[self._weld]
            back = np.zeros(4)
            mujoco.mju_negQuat(back, data.xquat[hand])
            relative = model.eq_data[self._weld]
            relative[:3] = 0.0
            mujoco.mju_rotVecQuat(relative[3:6], data.xpos[body] - data.xpos[hand], back)
            mujoco.mju_mulQuat(relative[6:10], back, data.xquat[body])
        data.eq_active[self._weld] = held

    def measure(self, tick: int) -> None:
        """Read the sensor as the robot does: tare it while hovering, null load and tilt in `nulling` ticks."""
        if self._tares[tick]:
            self._tare = self._wrench_world()
        elif self._motion.nulling[tick]:
            nulls = self._settles[tick] or self._motion.action.pushes
            gain = self._settings.servo.null_gain if nulls else self._settings.servo.comply_gain
            self._shift -= gain * self._dt / _NULL_TIME_CONSTANT * self._deflection()

    def _wrench_world(self) -> np.ndarray:
        return np.concatenate([self._rotation @ self._force, self._rotation @ self._torque])

    def _deflection(self) -> np.ndarray:
        """Joint offsets due to the unwanted load: vertical force, and tilt about the table [rad]."""
        wrench = self._wrench_world() - self._tare
        force = wrench[:3]
        torque = wrench[3:] - np.cross(self._tcp_at - self._place, force)
        height = self._tcp_at[2]
        unwanted = np.array([0, 0, force[2], torque[0] - height * force[1], torque[1] + height * force[0], 0])
        if self._motion.action.pushes:  # a push tilts its object: only the vertical force is unwanted
            unwanted[3:] = 0.0
        mujoco.mj_jacSite(self._data.model, self._data, self._jacobian[:3], self._jacobian[3:], self._tcp)
        return self._jacobian[:, :7].T @ unwanted / self._stiffness
