"""What the trajectories say, as one batch of K steady windows in the object frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimators.dynamics import Inertia, ParticleModel, cross, turned
from estimators.support import GripperLoad
from testbed.actions import Accelerate, Lift, Weigh
from testbed.errors import InvalidValueError
from testbed.objects import ObjectShape
from testbed.reduction import SteadyWindow, steady_windows
from testbed.trajectory import Trajectory

PLANAR = [0, 1, 5]
"""f_x, f_y and the torque about the vertical, of a wrench's six components."""


@dataclass(frozen=True, eq=False)
class Observations:
    """K windows of constant speed or constant acceleration. Object axes; moments about the grasp point."""

    wrench: Float[Tensor, "K 3"]
    """Mean f_x, f_y of the gripper on the object and torque about the grasp point, N and N m."""
    noise: Float[Tensor, "K 6 6"]
    """Covariance of the mean of all six components, about the TCP, from the window's own noise."""
    bias: Float[Tensor, "K 6 6"]
    """Covariance of what the sensor's tare leaves in them, one draw a trajectory."""
    drift: Float[Tensor, "K 6 6"]
    """What the walk of the sensor's zero adds to their covariance a second."""
    since_tare: Float[Tensor, "K 2"]
    """Time from the tare to a window's first and last sample, s."""
    twist: Float[Tensor, "K 3"]
    """Velocity of the grasp point, m/s, and turn rate, rad/s."""
    twists: Float[Tensor, "K S 3"]
    """The same over each of S equal parts of a window."""
    acceleration: Float[Tensor, "K 3"]
    """Acceleration of the grasp point, m/s^2, and angular acceleration, rad/s^2."""
    spin_square: Float[Tensor, "K"]
    """Mean square of the turn rate, rad^2/s^2."""
    grasp: Float[Tensor, "K 2"]
    """Grasp point, m, object frame."""
    lift: Float[Tensor, "K"]
    """Vertical force of the gripper on the object, N."""
    tilt: Float[Tensor, "K 2"]
    """(t_y + h f_x, -t_x + h f_y): moment that the feet supply where nothing accelerates, N m."""
    yaw: Float[Tensor, "K 2"]
    """Yaw of the object at a window's first and last sample, rad."""
    load_map: Float[Tensor, "K 3 6"]
    """From the wrench to lift and tilt."""
    load_kept: Float[Tensor, "K 3"]
    """Part of a trial's common lift and tilt that stands out of the bias, 0 to 1; the rest is taken as none."""
    held: Int[Tensor, "K"]
    """Mass group between the fingers."""
    trial: Int[Tensor, "K"]
    """Which trajectory a window is from."""
    accelerated: Tensor
    """Whether it is from an `Accelerate`, (K,) bool."""

    def __len__(self) -> int:
        return len(self.wrench)

    def where(self, keep: Tensor) -> Observations:
        """The windows that `keep` (K,) selects."""
        return Observations(**{name: value[keep] for name, value in vars(self).items()})

    def merged(self, group: Int[Tensor, "K"]) -> Observations:
        """Means over windows of the same group, 0 to G - 1; what is not a number is the first window's."""
        first = torch.stack([torch.nonzero(group == g)[0, 0] for g in range(int(group.max()) + 1)])

        def mean(values: Tensor) -> Tensor:
            if not values.is_floating_point():
                return values[first]
            return torch.stack([values[group == g].mean(0) for g in range(len(first))])

        return Observations(**{name: mean(value) for name, value in vars(self).items()})

    @property
    def covariance(self) -> Float[Tensor, "K 3 3"]:
        """Of `wrench`, from the window's own noise."""
        return self.noise[:, PLANAR][:, :, PLANAR]

    def shared_covariance(self) -> Float[Tensor, "K 3 K 3"]:
        """Of what the windows of one trial share: what its tare left, and how the sensor's zero has walked since."""
        left = self._together[:, None, :, None] * self.bias[:, PLANAR][:, :, PLANAR][:, :, None]
        return left + self.walk_covariance()

    def walk_covariance(self) -> Float[Tensor, "K 3 K 3"]:
        """Of what the walk of the sensor's zero has added to each window since its trial's tare."""
        return self._walked[:, None, :, None] * self.drift[:, PLANAR][:, :, PLANAR][:, :, None]

    def load_covariance(self) -> Float[Tensor, "K K 3"]:
        """Of what the sensor's errors make of lift and tilt, between windows, N^2 and (N m)^2."""
        error = self._load_error()
        size = (len(self), 3, len(self), 3)
        whole = (error @ self._sensor_covariance() @ error.T).reshape(size)
        return torch.diagonal(whole, dim1=1, dim2=3)

    def sensor_error(self, response: Float[Tensor, "K 3 3"]) -> Float[Tensor, "3K 3K"]:
        """Covariance of wrenches, less the `response` to lift and tilt, from all of the sensor's errors.

        One force feeds both, so what is common to a wrench and to the load on the feet counts once.
        """
        rows = 3 * len(self)
        planar = torch.block_diag(*[torch.eye(6, dtype=torch.float64)[PLANAR]] * len(self))
        carried = torch.block_diag(*response) @ self._load_error()
        error = planar - carried
        return (error @ self._sensor_covariance() @ error.T).reshape(rows, rows)

    def _sensor_covariance(self) -> Float[Tensor, "6K 6K"]:
        """Of all windows' six components."""
        shared = self._together[:, None, :, None] * self.bias[:, :, None] + (
            self._walked[:, None, :, None] * self.drift[:, :, None]
        )
        return shared.reshape(6 * len(self), 6 * len(self)) + torch.block_diag(*self.noise)

    def _load_error(self) -> Float[Tensor, "3K 6K"]:
        """Errors of lift and tilt as given here from the sensor's: of the mean over a trial only a part was kept."""
        mean = self._together / self._together.sum(1, keepdim=True)
        own = torch.eye(len(self), dtype=torch.float64)[:, None] - (1 - self.load_kept)[..., None] * mean[:, None]
        return torch.einsum("kal,lai->kali", own, self.load_map).reshape(3 * len(self), 6 * len(self))

    @property
    def _together(self) -> Float[Tensor, "K K"]:
        """1 for windows of the same trial."""
        return (self.trial[:, None] == self.trial).double()

    @property
    def _walked(self) -> Float[Tensor, "K K"]:
        """Covariance of the means over two windows of a random walk of 1 a second that began at their trial's tare."""
        begin, end = self.since_tare[:, 0], self.since_tare[:, 1]
        middle = (begin + end) / 2
        walked = torch.minimum(middle[:, None], middle)  # of the walk at two times: the earlier of them
        walked.diagonal().copy_(begin + (end - begin) / 3)
        return self._together * walked

    def lever(self, model: ParticleModel) -> Float[Tensor, "K P 2"]:
        """Particles from the grasp point, m."""
        return model.particles - self.grasp[:, None]

    def particle_velocity(self, model: ParticleModel) -> Float[Tensor, "K P 2"]:
        """Velocity of each particle, m/s."""
        return self.twist[:, None, :2] + self.twist[:, None, 2:] * turned(self.lever(model))

    def drag_rows(
        self, model: ParticleModel, pivot_error: float
    ) -> tuple[Float[Tensor, "K 3 P"], Float[Tensor, "K P"]]:
        """Wrench about the grasp point that drags a particle of unit friction, and how much of its direction is lost.

        Means over the parts of each window: where the centre of a turn wanders, the mean of the directions of a
        particle near it is not the direction of its mean velocity.

        Args:
            model: the object.
            pivot_error: how well the centre of a turn is known, m; a particle nearer than that has no known direction,
                and is lost by up to 1.
        """
        lever = self.lever(model)
        spin = self.twists[..., 2, None]
        velocity = self.twists[..., None, :2] + spin[..., None] * turned(lever)[:, None]
        fade = pivot_error * spin.abs()
        blurred = (velocity.square().sum(-1) + fade.square() + 1e-18).sqrt()
        unit = (velocity / blurred[..., None]).mean(1)
        return torch.stack([unit[..., 0], unit[..., 1], cross(lever, unit)], 1), (fade / blurred).mean(1)

    def com_acceleration(self, com: Float[Tensor, "2"]) -> Float[Tensor, "K 2"]:
        """Acceleration of the centre of mass, m/s^2."""
        arm = com - self.grasp
        return self.acceleration[:, :2] + self.acceleration[:, 2:] * turned(arm) - self.spin_square[:, None] * arm

    def inertial_wrench(self, inertia: Inertia) -> Float[Tensor, "K 3"]:
        """Force and torque about the grasp point that the motion itself takes: M a_c, and without I_j alpha."""
        force = inertia.mass * self.com_acceleration(inertia.com)
        torque = inertia.mass * cross(inertia.com - self.grasp, self.acceleration[:, :2])
        return torch.cat([force, torque[:, None]], -1)

    def gripper_load(self, inertia: Inertia, height: float) -> GripperLoad:
        """What the gripper carries; the mass accelerates at half the object's `height` (m) over the feet."""
        moment = self.tilt - height / 2 * inertia.mass * self.com_acceleration(inertia.com)
        return GripperLoad(self.lift, moment, self.held, self.grasp)


def robot_seconds(trajectories: Sequence[Trajectory]) -> float:
    """Robot time that trajectories took, s."""
    return float(sum(t.time_s[-1] - t.time_s[0] for t in trajectories))


def observe(shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Observations | None:
    """All usable trajectories of one object as one batch; None where there is none.

    Weighings, lifts, trials that did not end well and those too short to reduce are left out.

    Raises:
        InvalidValueError: a grasp that the shape does not have.
    """
    windows: list[SteadyWindow] = []
    trial: list[int] = []
    accelerated: list[bool] = []
    for index, trajectory in enumerate(trajectories):
        if trajectory.ok and not isinstance(trajectory.action, Weigh | Lift):
            if trajectory.action.grasp >= len(shape.grasps):
                raise InvalidValueError(
                    f"trajectories[{index}].action.grasp",
                    trajectory.action.grasp,
                    f"one of the shape's {len(shape.grasps)} grasps, counted from 0: another object's trial?",
                )
            try:
                found = steady_windows(trajectory)
            except InvalidValueError:  # no steady stretch long enough to trim
                continue
            windows += found
            trial += [index] * len(found)
            accelerated += [isinstance(trajectory.action, Accelerate)] * len(found)
    if not windows:
        return None
    wrench = np.array([w.wrench for w in windows])
    carries = np.array([load_map(w.tcp_height) for w in windows])
    load = np.einsum("kij,kj->ki", carries, wrench)
    # a load that wanders within a window is real, and its mean is what counts: bias and drift are its errors
    off = np.array([w.bias_covariance + w.since_tare.mean() * w.drift_covariance for w in windows])
    variance = np.einsum("kij,kjl,kil->ki", carries, off, carries)
    kept = np.ones_like(load)
    for kind in (True, False):  # an accelerating arm swings: its load is of another size
        rows = np.array(accelerated) == kind
        if rows.any():
            load[rows], kept[rows] = _shrunk(load[rows], variance[rows], np.array(trial)[rows])
    points = np.array([shape.grasps[w.grasp].position for w in windows])
    nearest = np.linalg.norm(shape.particles[None] - points[:, None], axis=-1).argmin(axis=1)
    tensor = torch.tensor
    return Observations(
        wrench=tensor(wrench[:, PLANAR]),
        noise=tensor(np.array([w.covariance for w in windows])),
        bias=tensor(np.array([w.bias_covariance for w in windows])),
        drift=tensor(np.array([w.drift_covariance for w in windows])),
        since_tare=tensor(np.array([w.since_tare for w in windows])),
        twist=tensor(np.array([w.twist for w in windows])),
        twists=tensor(np.array([w.twists for w in windows])),
        acceleration=tensor(np.array([w.acceleration for w in windows])),
        spin_square=tensor([w.spin_square for w in windows], dtype=torch.float64),
        grasp=tensor(points),
        lift=tensor(load[:, 0]),
        tilt=tensor(load[:, 1:]),
        yaw=tensor(np.array([w.yaw for w in windows])),
        load_map=tensor(carries),
        load_kept=tensor(kept),
        held=tensor(shape.mass_group[nearest]),
        trial=tensor(trial),
        accelerated=tensor(accelerated),
    )


def load_map(height: float) -> np.ndarray:
    """From a wrench to the gripper's load (fz, t_y + h f_x, -t_x + h f_y), (3, 6)."""
    return np.array([[0, 0, 1, 0, 0, 0], [height, 0, 0, 0, 1, 0], [0, height, 0, -1, 0, 0]], dtype=float)


def _shrunk(load: np.ndarray, variance: np.ndarray, trial: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Loads with what is likely the sensor's bias taken off, and the part of a trial's common load that was kept.

    A bias is common to all windows of a trial, so what differs between them is real and kept. The common part is drawn
    towards zero by how much of its scatter over trials the bias explains (empirical Bayes, beyond two standard errors):
    a gripper that carries less than the sensor can tell is better taken to carry nothing.
    """
    trials, index = np.unique(trial, return_inverse=True)
    common = np.array([load[index == t].mean(axis=0) for t in range(len(trials))])
    bias = np.array([variance[index == t].mean(axis=0) for t in range(len(trials))])
    explained = (1 + 2 * np.sqrt(2 / len(trials))) * bias.mean(axis=0)
    real = np.maximum((common**2).mean(axis=0) - explained, 0.0)
    kept = np.where(bias > 0, real / np.maximum(real + bias, 1e-300), 1.0)
    return load + ((kept - 1) * common)[index], kept[index]
