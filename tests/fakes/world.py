"""A Gen3 with sensor, gripper and an object on the table, moved by twists, poses and grip commands: MuJoCo, by ticks.

The maker's controller is not known; this one follows a twist with the joint servo of the simulation.
"""

import math

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from testbed import OWN_WEIGHT, Sensing, SimulationSettings, Support, preset
from testbed.actions.base import Fingertip
from testbed.objects.model import STROKE, ObjectModel
from testbed.robot.interfaces import ArmState, Pose
from testbed.simulation.motion import joint_path
from testbed.simulation.scene import HOME, build_scene

IDEAL = preset("ideal")
TICK = 0.01
"""Time between looks at commands, and between samples of the sensor [s]."""
START = (0.45, 0.0, 0.12, 0.0)
"""First place of the tool: x, y, z [m] and yaw [rad]."""
FASTEST = 0.5, math.radians(100)
"""Largest twist that the arm follows [m/s, rad/s]."""
BIAS = np.array([3.1, -2.2, 5.4, 0.11, -0.06, 0.02])
"""Reading of the sensor without load [N, N m]."""
_CLOSING, _OPENING = 0.8, 0.3
_LAST_JOINT_FIRST = np.array([1.0] * 6 + [100.0])
_FASTEST_TURN = math.radians(30)
_THERE = 5e-4, math.radians(0.05)


class Gen3World:
    """Physics and inner control; its owner calls `tick` 100 times per second of its time."""

    def __init__(
        self,
        obj: ObjectModel,
        support: Support = OWN_WEIGHT,
        *,
        settings: SimulationSettings | None = None,
        noise: Sensing = IDEAL,
        seed: int = 0,
    ):
        self.obj, self.support = obj, support
        self.settings = SimulationSettings() if settings is None else settings
        self.time = 0.0
        self.bias, self.mount = BIAS.copy(), np.ones(6)
        self._sensing, self._rng, self._noise = noise, np.random.default_rng(seed), np.zeros(6)
        self.twist = np.zeros(6)
        """Commanded twist [m/s, rad/s], base axes."""
        self.goal: tuple[np.ndarray, Rotation, float] | None = None
        """Position, orientation and speed while a pose is being reached."""
        self.grip = -0.05
        """Commanded part of the grip force; below 0 opens."""
        self.strength = 1.0
        """Ratio of the fingers' force to the commanded one."""
        self._grip = -0.05
        self.push = (0, np.zeros(3))
        """Ticks for which the object is pushed, and the force [N], world axes."""
        self._start = joint_path(np.array([START]), np.array(HOME))[0]
        self._build(0, np.array([0.45, 0.0, 0.0]))

    def place(self, pose: np.ndarray, grasp: int | Fingertip) -> None:
        """Put the object at a planar pose; only the faces of `grasp` can then be gripped, or pushed.

        The hand is at its start then: after a fault it stands where it stopped, and would push the object aside.
        """
        self.stop()
        self._build(grasp, pose)

    def _build(self, grasp: int | Fingertip, pose: np.ndarray) -> None:
        tip = grasp if isinstance(grasp, Fingertip) else None
        held = None if isinstance(grasp, Fingertip) else self.obj.shape.grasps[grasp]
        scene = build_scene(self.obj, self.support, held, self.settings, tip=tip)
        model, data = scene.model, mujoco.MjData(scene.model)
        address = model.joint("object").qposadr[0]
        data.qpos[:7] = data.act[:7] = self._reference = self._start
        self._integral = np.zeros(7)
        data.qpos[address : address + 2] = pose[:2]
        data.qpos[address + 3 : address + 7] = math.cos(pose[2] / 2), 0.0, 0.0, math.sin(pose[2] / 2)
        self.model, self.data, self._body = model, data, scene.object_body
        self._fingers = [model.joint(f"gripper/{side}_finger").qposadr[0] for side in ("left", "right")]
        self._tcp = model.site("gripper/tcp").id
        self._ft = model.sensor("ft/force").adr[0], model.sensor("ft/torque").adr[0]
        stiffness = model.actuator_gainprm[:7, 0]
        self._lag = -model.actuator_biasprm[:7, 2] / stiffness
        self._jacobian = np.zeros((6, model.nv))
        mujoco.mj_forward(model, data)
        self.reading = self._read()
        self.wrench = self._measured(data.sensordata)

    def open(self, width: float) -> None:
        """Begin to open until the pads are `width` apart [m]."""
        for finger in ("gripper/left_finger", "gripper/right_finger"):
            self.model.jnt_range[self.model.joint(finger).id, 0] = (STROKE - width) / 2
        self.grip = -0.05

    def tick(self) -> None:
        """10 ms: take in the commands, step, measure."""
        speed = self._joint_speeds(self._wanted_twist())
        dt = TICK
        self._reference = self._reference + speed * dt
        self._integral += self.settings.servo.integral_gain * dt * (self._reference - self.data.qpos[:7])
        target = self._reference + self._lag * speed + self._integral
        self.data.ctrl[:7] = (target - self.data.act[:7]) / dt
        rate = 1 / _CLOSING if self.grip > self._grip else 1 / _OPENING
        self._grip += float(np.clip(self.grip - self._grip, -rate * dt, rate * dt))
        self.data.ctrl[7] = self._grip * self.settings.grip.force * self.strength
        left, push = self.push
        self.push = (left - 1, push)
        self.data.xfrc_applied[self._body, :3] = push * (left > 0)
        steps = round(dt / self.model.opt.timestep)
        measured = np.zeros(self.model.nsensordata)
        for _ in range(steps):
            mujoco.mj_step(self.model, self.data)
            measured += self.data.sensordata
        self.time += dt
        self.reading = self._read()
        self.wrench = self._measured(measured / steps)

    def stop(self) -> None:
        """End all motion."""
        self.twist, self.goal = np.zeros(6), None

    @property
    def object_in_hand(self) -> np.ndarray:
        """Planar position of the object in the hand's axes [m], shape (2,)."""
        axes = self.data.site_xmat[self._tcp].reshape(3, 3)
        return (axes.T @ (self.data.xpos[self._body] - self.data.site_xpos[self._tcp]))[:2]

    @property
    def width(self) -> float:
        """Opening between the pads, m."""
        return STROKE - float(self.data.qpos[self._fingers].sum())

    @property
    def object_pose(self) -> np.ndarray:
        """True planar pose of the object [m, rad], shape (3,)."""
        x, y, _ = self.data.xpos[self._body]
        axes = self.data.xmat[self._body].reshape(3, 3)
        return np.array([x, y, math.atan2(axes[1, 0], axes[0, 0])])

    @property
    def link_poses(self) -> np.ndarray:
        """True planar pose of the object frame as each link carries it [m, rad], shape (links, 3)."""
        chain, found = self.obj.shape.chain, []
        for link in range(1 if chain is None else chain.links):
            if mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SENSOR, f"link_{link}/position") < 0:
                found.append(self.object_pose)  # a rigid object, or the link in the hand
                continue
            w, _, _, z = self.data.sensor(f"link_{link}/orientation").data
            found.append(np.append(self.data.sensor(f"link_{link}/position").data[:2], 2 * math.atan2(z, w)))
        return np.array(found)

    @property
    def driven(self) -> bool:
        """True if a motion is commanded."""
        return self.goal is not None or bool(self.twist.any())

    @property
    def speed(self) -> float:
        """Speed of the tool [m/s], a radian counted as 0.1 m."""
        return float(np.linalg.norm(self.reading.tcp_twist * [1, 1, 1, 0.1, 0.1, 0.1]))

    def _wanted_twist(self) -> np.ndarray:
        if self.goal is None:
            linear, angular = self.twist[:3], self.twist[3:]
            fast = max(float(np.linalg.norm(linear)) / FASTEST[0], float(np.linalg.norm(angular)) / FASTEST[1], 1.0)
            return self.twist / fast
        position, orientation, speed = self.goal
        here = self.reading.tcp_pose
        way = position - here.position
        turn = (orientation * Rotation.from_quat(here.orientation, scalar_first=True).inv()).as_rotvec()
        if np.linalg.norm(way) < _THERE[0] and np.linalg.norm(turn) < _THERE[1]:
            self.stop()
            return self.twist
        linear, angular = 4.0 * way, 4.0 * turn
        linear *= min(1.0, speed / max(float(np.linalg.norm(linear)), 1e-9))
        angular *= min(1.0, _FASTEST_TURN / max(float(np.linalg.norm(angular)), 1e-9))
        return np.concatenate([linear, angular])

    def _joint_speeds(self, twist: np.ndarray) -> np.ndarray:
        """Joint speeds by weighted least squares: the arm turns the tool with its last joint."""
        j = self._jacobian_at_tcp()
        weighted = _LAST_JOINT_FIRST[:, None] * j.T
        return weighted @ np.linalg.solve(j @ weighted + 1e-8 * np.eye(6), twist)

    def _jacobian_at_tcp(self) -> np.ndarray:
        mujoco.mj_jacSite(self.model, self.data, self._jacobian[:3], self._jacobian[3:], self._tcp)
        return self._jacobian[:, :7]

    def _read(self) -> ArmState:
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, self.data.site_xmat[self._tcp])
        qd = self.data.qvel[:7].copy()
        pose = Pose(self.data.site_xpos[self._tcp], quaternion)
        return ArmState(self.time, self.data.qpos[:7], qd, pose, self._jacobian_at_tcp() @ qd)

    def _measured(self, data: np.ndarray) -> np.ndarray:
        """Next frame of the sensor: wrench of the arm on the tool, bias, noise."""
        sensing, (force, torque) = self._sensing, self._ft
        white = np.array([*sensing.force_noise, *sensing.torque_noise]) * self._rng.standard_normal(6)
        self._noise = sensing.lag1 * self._noise + math.sqrt(1 - sensing.lag1**2) * white
        measured = np.concatenate([data[force : force + 3], data[torque : torque + 3]])
        return self.mount * measured + self.bias + self._noise
