"""A simulator of your own, in numpy: a table with Coulomb friction, under a rigid hand."""

from dataclasses import dataclass

import numpy as np

import heft
from testbed.frames import cross_2d, perpendicular, rotation_2d

RATE = 100.0
# the sensor is in the fingertips
TOOL = heft.Tool(mass=0.0, com=np.zeros(3), inertia=np.zeros((3, 3)), tcp=np.zeros(3))


@dataclass(frozen=True)
class DragSimulator:
    """A table with Coulomb friction and nothing else, and a rigid hand at its level."""

    tare: float = 1.0
    """Time before each action with nothing in the hand [s]."""

    def __enter__(self):  # a real robot connects here
        return self

    def __exit__(self, kind, error, trace):  # and stops here, whatever happened
        return None

    def check(self, trial):
        """Optional: refuses an action before any trial; heft finds the usable grasps with it."""
        if not isinstance(trial.action, heft.Weigh | heft.Rotate | heft.Accelerate):
            raise heft.InfeasibleTrialError("this simulator weighs and turns, and does nothing else")

    def run(self, trial):
        self.check(trial)
        if trial.support != heft.OWN_WEIGHT:
            raise heft.InfeasibleTrialError("in this simulator every block rests on its own weight")
        obj, action = trial.object, trial.action
        if not action.moves:
            scale = np.tile([0, 0, obj.total_mass * heft.GRAVITY, 0, 0, 0], (50, 1))
            return record(action, np.zeros(50, int), scale, np.zeros((50, 3)), np.zeros((50, 2)), None)
        slope, spin, segment = motion(action, round(self.tare * RATE))
        pivot, grasp = action.center(obj.shape), obj.shape.grasps[action.grasp].position

        # object axes: friction against the velocity of every particle, and inertia
        way = perpendicular(obj.shape.particles - pivot)
        way /= np.linalg.norm(way, axis=1, keepdims=True) + 1e-12
        friction = np.where(obj.shape.friction_group < 0, 0, obj.truth.friction[obj.shape.friction_group])
        push = (friction * obj.particle_mass * heft.GRAVITY)[:, None] * way
        arm = obj.center_of_mass - pivot
        inertial = obj.total_mass * (slope[:, None] * perpendicular(arm) - spin[:, None] ** 2 * arm)
        force = np.sign(spin)[:, None] * push.sum(axis=0) + inertial
        torque = np.sign(spin) * cross_2d(obj.shape.particles - grasp, push).sum()
        torque += obj.inertia_cm * slope + cross_2d(obj.center_of_mass - grasp, inertial)

        # world axes: the wrench at the hand, and the poses
        yaw = np.cumsum(spin) / RATE
        turn = rotation_2d(yaw)
        wrench = np.zeros((len(yaw), 6))
        wrench[:, :2] = np.einsum("nij,nj->ni", turn, force)
        wrench[:, 3:5] = obj.shape.height / 2 * np.einsum("nij,nj->ni", turn, perpendicular(inertial))
        wrench[:, 5] = torque
        origin, hand = turn @ -pivot, turn @ (grasp - pivot)
        return record(action, segment, wrench, np.column_stack([origin, yaw]), hand, TOOL)


def motion(action, waits):
    """Angular acceleration, speed and steady segment at every sample; before them nothing moves."""
    slope, spin, segment = [np.zeros(waits)], [np.zeros(waits)], [np.full(waits, -1)]
    for index, (speed, acceleration, seconds) in enumerate(action.steady):
        time = np.arange(1, round(seconds * RATE) + 1) / RATE
        slope.append(np.full(len(time), acceleration))
        spin.append(speed + acceleration * time)
        segment.append(np.full(len(time), index))
    return np.concatenate(slope), np.concatenate(spin), np.concatenate(segment)


def record(action, segment, wrench, pose, hand, tool):
    """Trajectory for heft; velocities are the slopes of the poses, as on a real robot."""
    count = len(segment)
    pose_rate, hand_rate = (np.gradient(where, 1 / RATE, axis=0) for where in (pose, hand))
    still = np.zeros((count, 3))
    return heft.Trajectory(
        action=action,
        status="ok",
        reason="",
        time_s=np.arange(count) / RATE,
        phase=np.where(segment < 0, heft.Phase.TARE, heft.Phase.STEADY),
        segment=segment,
        object_pose=pose,
        object_velocity=pose_rate,
        tcp_position=np.column_stack([hand, still[:, 0]]),
        tcp_velocity=np.column_stack([hand_rate, still, pose_rate[:, 2]]),
        sensor_orientation=np.tile([1.0, 0, 0, 0], (count, 1)),  # its axes are the world's
        sensor_wrench=wrench,
        wrench_on_object_world=wrench,
        joint_position=np.zeros((count, 7)),
        tool=tool,
        sensor_bias_std=np.zeros(6),
        provenance={"runner": "simulation", "simulator": "DragSimulator"},
    )
