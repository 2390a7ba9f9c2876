"""Trials in MuJoCo: the arm grasps the object on the table and moves it; the result is a trajectory."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace
from typing import Self

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.frames import (
    origin_velocity,
    pose_from_point,
    rotation_2d,
    rotation_matrix,
    transform_point,
)
from testbed.objects.model import STROKE, Grasp
from testbed.sensing.camera import PoseStream
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import preset
from testbed.simulation.controller import Servo
from testbed.simulation.feasibility import check_feasible
from testbed.simulation.monitor import ContactLog, ContactRecord, Monitor, Outcome
from testbed.simulation.motion import Motion, gripper_tool, plan_motion
from testbed.simulation.scene import Scene, build_scene
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Trajectory
from testbed.trial import Trial
from testbed.worlds.seeds import new_secret
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors

_SETTLE_TIME, _READ_TIME = 1.0, 0.5
_SHIFTS = (1.0, 0.5, 0.0)
TOLERANCE_IN_AIR = 1e-12
"""Tolerance of MuJoCo's solver in lifts. At the default 1e-8 the pads' forces and the weight may differ by 0.2 N at
every step."""


@dataclass(frozen=True)
class SimulationRunner:
    """`TrialRunner` in simulation. Entering and leaving it does nothing."""

    settings: SimulationSettings = field(default_factory=SimulationSettings)
    """Settings of the simulation."""
    secret: str = field(default_factory=new_secret, repr=False)
    """Text that seeds the sensor's errors together with a trial's seed, object and action; random by default. Runners
    with the same secret draw the same errors."""
    refuses: bool = True
    """False to run trials that `check` refuses and that may fail, such as grasps chosen with estimated masses."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def run(self, trial: Trial) -> Trajectory:
        """Run one trial: physics, then the trial's sensing draw.

        Raises:
            InfeasibleTrialError: the arm, the gripper or the table cannot do it; nothing has moved.
        """
        return draw_sensing(self.run_clean(trial), preset(trial.sensing), trial.seed_under(self.secret))

    def run_clean(self, trial: Trial) -> Trajectory:
        """Run the physics with a perfect sensor; sensing draws can be applied to the result."""
        return self._simulate(trial, None)

    def run_with_contacts(self, trial: Trial, every: int = 1) -> tuple[Trajectory, ContactRecord]:
        """Run the physics with a perfect sensor and record the true force of the table on every foot.

        Args:
            trial: any trial but a weighing.
            every: read the contacts at every `every`-th sample.
        """
        if not trial.action.moves:
            raise InvalidValueError("trial.action", trial.action, "anything but a weighing")
        log = ContactLog(every)
        trajectory = self._simulate(trial, log)
        return trajectory, log.record()

    def check(self, trial: Trial) -> None:
        """Plan a trial without running it.

        Raises:
            InfeasibleTrialError: as `run` would.
        """
        if trial.action.moves:
            check_feasible(trial, plan_motion(trial.action, trial.object.shape, self.settings), self.settings)

    def _motion(self, trial: Trial) -> Motion:
        """Feasible motion from the world's drawn start, or from one nearer the middle of the workspace."""
        start = np.zeros(3) if trial.world is None else trial.world.start(trial.action)
        for part in _SHIFTS if start.any() else (0.0,):
            x, y, yaw = (part * start).tolist()
            try:
                motion = plan_motion(trial.action, trial.object.shape, self.settings, (x, y, yaw))
                if self.refuses:
                    check_feasible(trial, motion, self.settings)
                return motion
            except InfeasibleTrialError:
                if not part:
                    raise
        raise AssertionError

    def _simulate(self, trial: Trial, log: ContactLog | None) -> Trajectory:
        if not trial.action.moves:
            return weigh(trial, self.settings)
        motion, draw = self._motion(trial), trial.world
        tip = trial.action.fingertip(trial.object.shape)
        held = None if tip else trial.grasp
        if held is not None and draw is not None:
            held = draw.grasp(trial.grasp, trial.action)
            motion = _as_held(motion, trial.grasp, held)
        scene = build_scene(trial.object, trial.support, held, self.settings, origin=motion.center, draw=draw, tip=tip)
        model, data = scene.model, mujoco.MjData(scene.model)
        place(scene, data, motion)
        surface = None if draw is None else draw.surface
        rest, feet = model.pair_friction[scene.foot_pairs], _Feet(scene)
        if log is not None:
            log.start(scene, len(motion.q))
        servo = Servo(data, motion, self.settings)
        monitor = Monitor(scene, data, motion, self.settings)
        # A sample is the mean over its steps, as of a real sensor; an instant would alias with the outer loop
        record, sample = np.empty((len(motion.q), model.nsensordata)), np.zeros(model.nsensordata)
        steps, count, sensors = scene.steps, len(motion.q), data.sensordata
        for tick in range(len(motion.q)):
            servo.command(tick)
            if surface is not None:
                model.pair_friction[scene.foot_pairs] = rest * surface.factor(*feet.motion(data))[:, None]
            sample[:] = 0.0
            for _ in range(steps):
                mujoco.mj_step(model, data)
                sample += sensors
            record[tick] = sample / steps
            servo.measure(tick)
            if log is not None:
                log.measure(data, tick)
            if monitor.must_stop(tick):
                count = max(tick, 1)
                break
        record = np.nan_to_num(record[:count])  # not finite only after a fault in the first sample
        outcome = monitor.outcome()
        return _trajectory(trial, motion, model, record, self.settings, outcome)


def place(scene: Scene, data: mujoco.MjData, motion: Motion) -> None:
    """Put arm and object at the start of a motion; in a lift, set the solver's tolerance to `TOLERANCE_IN_AIR`."""
    model = scene.model
    if motion.action.in_air:
        model.opt.tolerance = TOLERANCE_IN_AIR
    x, y = transform_point(motion.object_pose, np.array(scene.origin))
    yaw = motion.object_pose[2]
    data.qpos[:7] = data.act[:7] = motion.start
    for finger in ("gripper/left_finger", "gripper/right_finger"):
        joint = model.joint(finger)
        data.qpos[joint.qposadr[0]] = joint.range[1 if motion.action.pushes else 0]
    address = model.joint("object").qposadr[0]
    data.qpos[address : address + 2] = x, y
    data.qpos[address + 3 : address + 7] = math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)
    mujoco.mj_forward(model, data)


def weigh(trial: Trial, settings: SimulationSettings) -> Trajectory:
    """Record of a scale under the object at rest."""
    scene = build_scene(trial.object, trial.support, None, settings, draw=trial.world)
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_step(model, data, round(_SETTLE_TIME / settings.timestep))
    count = round(_READ_TIME * settings.rate)
    weight, force = np.zeros(count), np.zeros(6)
    for tick in range(count):
        mujoco.mj_step(model, data, settings.steps)
        for contact in range(data.ncon):
            mujoco.mj_contactForce(model, data, contact, force)
            weight[tick] += force[0]
    trajectory = Trajectory.of_scale(weight, np.arange(count) / settings.rate, _provenance(trial))
    return replace(trajectory, setup=_stated(trial))


def _trajectory(
    trial: Trial,
    motion: Motion,
    model: mujoco.MjModel,
    record: np.ndarray,
    settings: SimulationSettings,
    outcome: Outcome,
) -> Trajectory:
    pushed = trial.action.pushes
    half_step = settings.rate * model.opt.timestep / 2

    def read(name: str) -> np.ndarray:
        first = model.sensor(name).adr[0]
        return record[:, first : first + model.sensor(name).dim[0]]

    def moving(name: str) -> np.ndarray:
        """Velocity at the time of a position: half a step later, since a step moves by the velocity at its end."""
        at_end = read(name)
        return at_end + half_step * np.diff(at_end, axis=0, append=at_end[-1:])

    tcp = read("gripper/tcp_position")
    twist = np.hstack([moving("gripper/tcp_velocity"), moving("gripper/tcp_angular_velocity")])
    if pushed:
        yaw = np.unwrap(Rotation.from_quat(read("object/orientation"), scalar_first=True).as_euler("ZYX")[:, 0])
        pose, width = np.column_stack([read("object/position")[:, :2], yaw]), 0.0
        velocity = np.column_stack([moving("object/velocity")[:, :2], moving("object/angular_velocity")[:, 2]])
    else:
        grasp = trial.grasp
        closing = rotation_matrix(read("gripper/tcp_orientation"))[:, :, 0]
        yaw = np.unwrap(np.arctan2(closing[:, 1], closing[:, 0])) - grasp.angle
        pose = pose_from_point(tcp[:, :2], grasp.position, yaw)
        velocity = origin_velocity(twist, yaw, grasp.position)
        width = grasp.width if settings.grip.mode == "friction" else grasp.opening or STROKE
    count = len(record)
    time = np.arange(count) / settings.rate
    seen = pose[:, None] if pushed else _links(model, record, pose, trial)
    joints = [model.sensor(f"arm/joint_{i}_position").adr[0] for i in range(1, 8)]
    return Trajectory(
        action=trial.action,
        status=outcome.status,
        reason=outcome.reason,
        time_s=time,
        phase=motion.phase[:count],
        segment=motion.segment[:count],
        object_pose=pose,
        object_velocity=velocity,
        tcp_position=tcp,
        tcp_velocity=twist,
        sensor_orientation=read("ft/orientation"),
        sensor_wrench=np.hstack([read("ft/force"), read("ft/torque")]),
        wrench_on_object_world=np.zeros((count, 6)),
        joint_position=record[:, joints],
        tool=gripper_tool(width),
        sensor_bias_std=np.zeros(6),
        camera=None if seen is None else PoseStream(time, seen),
        figures=outcome.figures,
        setup=_stated(trial),
        provenance=_provenance(trial) | ({"state": json.dumps(outcome.state)} if outcome.state else {}),
    )


def _links(
    model: mujoco.MjModel, record: np.ndarray, pose: np.ndarray, trial: Trial
) -> Float[np.ndarray, "N L 3"] | None:
    """Poses of each link's object frame [m, m, rad], that of the held link from the hand; None without links."""
    chain, shape = trial.object.shape.chain, trial.object.shape
    if chain is None:
        return None
    found = np.tile(pose[:, None], (1, chain.links, 1))
    for link in set(range(chain.links)) - {chain.link[shape.pressed(trial.grasp)[0]]}:
        place, axes = (model.sensor(f"link_{link}/{kind}").adr[0] for kind in ("position", "orientation"))
        relative = 2 * np.arctan2(record[:, axes + 3], record[:, axes]) - pose[:, 2]
        found[:, link, :2] = record[:, place : place + 2]
        found[:, link, 2] += np.unwrap((relative + np.pi) % (2 * np.pi) - np.pi)
    return found


def _stated(trial: Trial) -> SetupErrors:
    return EXACT_SETUP if trial.world is None else trial.world.world.stated


def _provenance(trial: Trial) -> dict[str, str]:
    of_world = {} if trial.world is None else trial.world.provenance
    return {"runner": "simulation", "mujoco": mujoco.__version__, "support": trial.support.name} | of_world


def _as_held(motion: Motion, nominal: Grasp, held: Grasp) -> Motion:
    """Motion of the hand to the stated grasp, with the object at the pose in which the pads hold it at `held`."""
    tcp, pivot = (transform_point(motion.object_pose, np.array(p)) for p in (nominal.position, motion.center))
    pose = pose_from_point(tcp, held.position, motion.object_pose[2] + nominal.angle - held.angle)
    x, y = rotation_2d(-pose[2]) @ (pivot - pose[:2])
    return replace(motion, object_pose=pose, center=(float(x), float(y)))


class _Feet:
    """Feet of a scene, for their positions and speeds."""

    def __init__(self, scene: Scene) -> None:
        self._model, self._geoms, self._body = scene.model, scene.foot_geoms, scene.object_body
        self._dof = scene.model.joint("object").dofadr[0]
        self._articulated = mujoco.mj_name2id(scene.model, mujoco.mjtObj.mjOBJ_JOINT, "hinge_0") >= 0

    def motion(self, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m], world, shape (n_feet, 2), and speeds [m/s], shape (n_feet,)."""
        position = data.geom_xpos[self._geoms, :2]
        if self._articulated:  # each link has a velocity of its own
            twists = np.zeros((len(position), 6))
            for geom, twist in zip(self._geoms.tolist(), twists, strict=True):
                mujoco.mj_objectVelocity(self._model, data, mujoco.mjtObj.mjOBJ_GEOM, geom, twist, 0)
            return position, np.hypot(twists[:, 3], twists[:, 4])
        (x, y), spin = data.qvel[self._dof : self._dof + 2], data.qvel[self._dof + 5]
        lever = position - data.xpos[self._body, :2]
        return position, np.hypot(x - spin * lever[:, 1], y + spin * lever[:, 0])
