"""Steady windows of many trials as one batch: wrench, motion, gripper's load, and the covariances of their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimators.particles.model import Inertia, ParticleModel, cross, direction, inertia_of, rotate, turned
from estimators.particles.support import GripperLoad
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors

PLANAR = [0, 1, 5]
"""f_x, f_y and the torque about the vertical, of a wrench's six components."""
SLOW = 1e-3
"""Speed at which a foot of a pushed object may drag half of its friction less, or another way, m/s: nothing keeps the
center of rotation off a point of contact, and there it sticks. Ours."""


@dataclass(frozen=True, eq=False)
class LinkedParticles:
    """Places and motion of an object's particles in K windows of S parts, about the grasp point, held link's axes."""

    place: Float[Tensor, "K S P 2"]
    """Place, m."""
    velocity: Float[Tensor, "K S P 2"]
    """Velocity, m/s."""
    acceleration: Float[Tensor, "K S P 2"]
    """Acceleration, m/s^2."""
    rate: Float[Tensor, "K S P"]
    """Turn rate, rad/s."""
    slope: Float[Tensor, "K S P"]
    """Angular acceleration, rad/s^2."""

    @staticmethod
    def of(windows: Observations, model: ParticleModel) -> LinkedParticles:
        """Particles of an articulated object, each with its own link."""
        own = windows.links[:, :, model.link[model.mass_group]]
        place = rotate(own[..., 0], (model.particles - windows.grasp[:, None])[:, None]) + own[..., 1:3]
        rate, side = own[..., 5:6], turned(place)
        acceleration = own[..., 6:8] + own[..., 8:9] * side - rate.square() * place
        return LinkedParticles(place, own[..., 3:5] + rate * side, acceleration, own[..., 5], own[..., 8])

    def speed(self, pivot_error: float) -> Float[Tensor, "K S P"]:
        """Speed, m/s, blurred by the error of the center of a turn, m."""
        fade = pivot_error * self.rate
        return (self.velocity.square().sum(-1) + fade.square() + 1e-18).sqrt()

    @staticmethod
    def arms(windows: Observations, model: ParticleModel, lever: Float[Tensor, "K P 2"]) -> Float[Tensor, "K P 2"]:
        """Lever of each particle against the held link's turn, m: its own, or of the first hinge that it trails."""
        held, link = model.link[windows.held[:, :1]], model.link[model.mass_group]
        hinge = torch.where(link > held, held, held - 1).clamp(0, len(model.hinges) - 1)
        return torch.where((link == held)[..., None], lever, model.hinges[hinge] - windows.grasp[:, None])

    def motion_wrench(self, mass: Float[Tensor, "P"], cell: float) -> Float[Tensor, "K 3"]:
        """Force and torque about the grasp point that the motion takes of particles of a `mass`, kg, in solid cells."""
        force = mass[:, None] * self.acceleration
        torque = (cross(self.place, force) + self.slope * mass * cell**2 / 6).sum(-1)
        return torch.cat([force.sum(-2), torque[..., None]], -1).mean(1)


@dataclass(frozen=True, eq=False, kw_only=True)
class Observations:
    """K windows of constant speed or constant acceleration. Object axes; moments about the grasp point."""

    wrench: Float[Tensor, "K 3"]
    """Mean f_x, f_y of the gripper on the object and torque about the grasp point, N and N m."""
    noise: Float[Tensor, "K 6 6"]
    """Covariance of the mean of all six components, about the TCP, from the window's own noise."""
    bias: Float[Tensor, "K 6 6"]
    """Covariance of the bias that the sensor's tare leaves in them, one draw a trajectory."""
    drift: Float[Tensor, "K 6 6"]
    """Covariance that the walk of the sensor's zero adds a second."""
    since_tare: Float[Tensor, "K 2"]
    """Time from the tare to a window's first and last sample, s."""
    twist: Float[Tensor, "K 3"]
    """Velocity of the grasp point, m/s, and turn rate, rad/s."""
    twists: Float[Tensor, "K S 3"]
    """Twist over each of S equal parts of a window."""
    acceleration: Float[Tensor, "K 3"]
    """Acceleration of the grasp point, m/s^2, and angular acceleration, rad/s^2."""
    spin_square: Float[Tensor, "K"]
    """Mean square of the turn rate, rad^2/s^2."""
    grasp: Float[Tensor, "K 2"]
    """Grasp point, or mean place of a push's fingertip, m, object frame."""
    lift: Float[Tensor, "K"]
    """Vertical force of the gripper on the object, N."""
    tilt: Float[Tensor, "K 2"]
    """(t_y + h f_x, -t_x + h f_y): moment that the feet supply where nothing accelerates, N m."""
    yaw: Float[Tensor, "K 2"]
    """Yaw of the object at a window's first and last sample, rad."""
    poses: Float[Tensor, "K S 3"]
    """Place of the TCP, m, and yaw of the object, rad, over each of the parts, world."""
    sensed: Float[Tensor, "K 6"]
    """Mean of all six components in the sensor's axes, about its origin, N and N m."""
    from_sensor: Float[Tensor, "K 6 6"]
    """Map from a wrench in the sensor's axes to one about the TCP in object axes."""
    tool_tilt: Float[Tensor, "K 2 6"]
    """Change of all six components by the tool's weight with a tilt of the table, as `SteadyWindow.tool_tilt`."""
    load_map: Float[Tensor, "K 3 6"]
    """Map from the wrench to lift and tilt."""
    load_kept: Float[Tensor, "K 3"]
    """Part of a trial's common lift and tilt that stands out of the bias, 0 to 1; the rest is taken as none."""
    load_followed: Float[Tensor, "K 3"]
    """Part of their change from window to window of a trial that stands out of the noise, 0 to 1."""
    held: Int[Tensor, "K 2"]
    """Mass groups under the two pads, or twice that under the fingertip."""
    trial: Int[Tensor, "K"]
    """Trajectory that a window is from."""
    accelerated: Tensor
    """True for windows of constant acceleration, (K,) bool."""
    pushed: Tensor
    """True for windows of a push, whose motion a camera sees and the hand does not hold, (K,) bool."""
    seen: Float[Tensor, "K 9 E"]
    """Errors of the object's pose, twist and acceleration by the camera, as `SteadyWindow.seen`; (K, 9, 0) if no
    window is of a push."""
    links: Float[Tensor, "K S L 9"]
    """Motion of each link of an articulated object over each of the parts, as `Chain.moved`; L = 0 of a rigid one."""
    links_off: Float[Tensor, "K E S L 9"]
    """`links` after one standard deviation of each error of the camera that sees them; the last is its delay's."""
    setup: SetupErrors = EXACT_SETUP
    """Errors of the setup as stated, the largest of all trials."""

    def __len__(self) -> int:
        return len(self.wrench)

    def like(self, by_window: dict[str, Tensor]) -> Self:
        """Windows of such fields in this setup."""
        return replace(self, **by_window)  # pyright: ignore[reportArgumentType]

    @property
    def by_window(self) -> dict[str, Tensor]:
        """Fields with a row a window."""
        return {name: value for name, value in vars(self).items() if name != "setup"}

    def where(self, keep: Tensor) -> Self:
        """Windows that `keep` (K,) selects."""
        return self.like({name: value[keep] for name, value in self.by_window.items()})

    def merged(self, group: Int[Tensor, "K"]) -> Self:
        """Means over windows of one group, 0 to G - 1; values that are no numbers are the first window's."""
        first = torch.stack([torch.nonzero(group == g)[0, 0] for g in range(int(group.max()) + 1)])

        def mean(values: Tensor) -> Tensor:
            whole = not values.is_floating_point()
            return values[first] if whole else torch.stack([values[group == g].mean(0) for g in range(len(first))])

        return self.like({name: mean(value) for name, value in self.by_window.items()})

    @staticmethod
    def stacked(draws: Sequence[Observations]) -> Observations:
        """Windows of D draws, equal in number, with leading axes (D, 1): the 1 meets candidates."""
        return draws[0].like(
            {name: torch.stack([getattr(d, name) for d in draws])[:, None] for name in draws[0].by_window}
        )

    @property
    def drag(self) -> float:
        """Largest force measured at constant speed [N]: a lower bound of mu M g."""
        return float(self.wrench[~self.accelerated, :2].norm(dim=1).max())

    @property
    def covariance(self) -> Float[Tensor, "K 3 3"]:
        """Covariance of `wrench` from the window's own noise."""
        return self.noise[:, PLANAR][:, :, PLANAR]

    def shared_covariance(self) -> Float[Tensor, "K 3 K 3"]:
        """Covariance that the windows of one trial share: the tare's bias, and the walk of the sensor's zero since."""
        left = self.together[:, None, :, None] * self.bias[:, PLANAR][:, :, PLANAR][:, :, None]
        return left + self.walk_covariance()

    def walk_covariance(self) -> Float[Tensor, "K 3 K 3"]:
        """Covariance of the walk of the sensor's zero in each window since its trial's tare."""
        return self.walked[:, None, :, None] * self.drift[:, PLANAR][:, :, PLANAR][:, :, None]

    @property
    def trial_mean(self) -> Float[Tensor, "K K"]:
        """Map from values to the means over their trials."""
        return self.together / self.together.sum(1, keepdim=True)

    @property
    def trial_change(self) -> Float[Tensor, "K K"]:
        """Map from values to their differences from the means over their trials."""
        return torch.eye(len(self), dtype=torch.float64) - self.trial_mean

    @property
    def together(self) -> Float[Tensor, "K K"]:
        """1 for windows of the same trial."""
        return (self.trial[:, None] == self.trial).double()

    @property
    def walked(self) -> Float[Tensor, "K K"]:
        """Covariance of the means over two windows of a random walk of 1 a second that began at their trial's tare."""
        begin, end = self.since_tare[:, 0], self.since_tare[:, 1]
        middle = (begin + end) / 2
        walked = torch.minimum(middle[:, None], middle)  # of the walk at two times: the earlier of them
        walked.diagonal().copy_(begin + (end - begin) / 3)
        return self.together * walked

    @property
    def articulated(self) -> bool:
        """True if the object has links, which move on their own."""
        return self.links.shape[-2] > 0

    @property
    def of_row(self) -> Int[Tensor, "R"]:
        """Window of each row: three of every wrench, then one of every hinge; R = 3 K + K H."""
        window = torch.arange(len(self))
        return torch.cat([window.repeat_interleave(3), window.repeat_interleave(self.hinges)])

    @property
    def hinges(self) -> int:
        """Number of hinges: H."""
        return max(self.links.shape[-2] - 1, 0)

    def displaced(self, x: float, y: float, yaw: float) -> Self:
        """Windows of an object in links that is elsewhere in the hand, which moves as it did [m, rad]."""
        links, twist = self.links, self.twists[:, :, None]
        shift = rotate(torch.tensor(yaw).double(), links[..., 1:3]) + torch.tensor([x, y]).double()
        relative = rotate(torch.tensor(yaw).double(), links[..., 3:5] - twist[..., :2])
        aside = (twist[..., 2:] - links[..., 5:6]) * turned(torch.tensor([x, y]).double())
        moved = [links[..., :1] + yaw, shift, twist[..., :2] + relative + aside, links[..., 5:]]
        return replace(self, links=torch.cat(moved, -1))

    def lever(self, model: ParticleModel) -> Float[Tensor, "K P 2"]:
        """Position of each particle from the grasp point, m, in the mean over a window."""
        if self.articulated:
            return LinkedParticles.of(self, model).place.mean(1)
        return model.particles - self.grasp[:, None]

    def particle_velocity(self, model: ParticleModel) -> Float[Tensor, "K P 2"]:
        """Velocity of each particle, m/s."""
        if self.articulated:
            return LinkedParticles.of(self, model).velocity.mean(1)
        return self.twist[:, None, :2] + self.twist[:, None, 2:] * turned(self.lever(model))

    def velocity_by_part(self, lever: Float[Tensor, "K P 2"]) -> Float[Tensor, "K S P 2"]:
        """Velocity of points at a `lever` (m) from the grasp point over each of the parts, m/s; of a rigid object."""
        return self.twists[..., None, :2] + self.twists[..., 2, None, None] * turned(lever)[:, None]

    def drag_directions(self, model: ParticleModel) -> Float[Tensor, "K P 2"]:
        """Direction of each particle's mean velocity, along which friction drags."""
        return direction(self.particle_velocity(model))

    def drag_rows(self, model: ParticleModel, pivot_error: float) -> Float[Tensor, "K 3 P"]:
        """Wrench about the grasp point that drags each particle against a friction of 1 N.

        Means over the parts of each window, since a center that wanders changes the directions of particles near it,
        and over a particle's cell where the object may touch the table anywhere under it.

        Args:
            model: particles of the object.
            pivot_error: error of the center of a turn, m; the drag of a particle nearer than that fades.
        """
        points = model.spread if self.setup.contact_points else [model]
        return torch.stack([self.point_rows(each, pivot_error) for each in points]).mean(0)

    def point_rows(self, model: ParticleModel, pivot_error: float) -> Float[Tensor, "K 3 P"]:
        """Rows of particles that touch the table in their middles alone; arguments as `drag_rows`."""
        if self.articulated:
            moved = LinkedParticles.of(self, model)
            unit = moved.velocity / moved.speed(pivot_error)[..., None]
            return torch.cat([unit.mean(1), cross(moved.place, unit).mean(1)[..., None]], -1).transpose(1, 2)
        lever = self.lever(model)
        velocity, speed = self._blurred(lever, pivot_error)
        unit = (velocity / speed[..., None]).mean(1)
        return torch.stack([unit[..., 0], unit[..., 1], cross(lever, unit)], 1)

    def drag_slopes(
        self, model: ParticleModel, drag: Float[Tensor, "K P"], pivot_error: float
    ) -> Float[Tensor, "K 3 3"]:
        """Change of a `drag` (N) with a window's twist: (f_x, f_y, torque) by (v_x, v_y, rate); else as `drag_rows`."""
        lever = arm = self.lever(model)
        if self.articulated:
            moved, arm = LinkedParticles.of(self, model), LinkedParticles.arms(self, model, lever)
            velocity, speed = moved.velocity, moved.speed(pivot_error)
        else:
            velocity, speed = self._blurred(lever, pivot_error)
        square = velocity[..., :, None] * velocity[..., None, :] / speed.square()[..., None, None]
        turn = ((torch.eye(2, dtype=torch.float64) - square) / speed[..., None, None]).mean(1)
        by = torch.cat([turn, turn @ turned(arm)[..., None]], -1)
        torque = lever[..., :1] * by[..., 1, :] - lever[..., 1:] * by[..., 0, :]
        return torch.einsum("kp,kpij->kij", drag, torch.cat([by, torque[..., None, :]], -2))

    def lead_effect(
        self, model: ParticleModel, drag: Float[Tensor, "K P"], pivot_error: float, lead: float
    ) -> Float[Tensor, "K 3"]:
        """Change of a `drag` (N) whose directions lead the hand's motion by a time, s: half that from -lead to +lead.

        A secant, for near the center of a turn a small shift turns a particle's drag by as much as it can.
        """
        ahead = lead * self.twist_rates
        rows = [replace(self, twists=self.twists + way * ahead).drag_rows(model, pivot_error) for way in (1, -1)]
        return ((rows[0] - rows[1]) @ drag[..., None])[..., 0] / 2

    @property
    def twist_rates(self) -> Float[Tensor, "K S 3"]:
        """Change of `twists` from part to part per second; of one part, of its turn rate alone, m/s^2 and rad/s^2."""
        parts = self.twists.shape[1]
        if parts < 2:
            return torch.nn.functional.pad(self.acceleration[:, None, 2:], (2, 0))
        length = self.since_tare.diff()[:, None] / parts
        return torch.gradient(self.twists, dim=1)[0] / length

    def sticking_covariance(self, model: ParticleModel, drag: Float[Tensor, "K P"]) -> Float[Tensor, "K 3 3"]:
        """Covariance of pushes from feet so slow that they stick: of a part SLOW^2 / (v^2 + SLOW^2) of a `drag` (N)."""
        lever = self.lever(model)
        square = self.velocity_by_part(lever).square().sum(-1)
        stuck = (SLOW**2 / (square + SLOW**2)).mean(1) * self.pushed[:, None]
        along = torch.eye(2, dtype=torch.float64).expand(*lever.shape, 2)
        pull = torch.cat([along, turned(lever)[..., None, :]], -2) * (stuck * drag)[..., None, None]
        return torch.einsum("kpij,kplj->kil", pull, pull)

    @property
    def twist_noise(self) -> Float[Tensor, "3"]:
        """Variance of a window's mean twist from the noise of the hand's measured motion, the same in all windows.

        From fifth differences of its parts, which leave out a center that wanders.
        """
        parts = self.twists.shape[1]
        if parts < 6:
            return torch.zeros(3, dtype=torch.float64)
        spread = torch.diff(self.twists, 5, dim=1).square().mean(1) / (252 * parts)
        if self.seen.shape[-1] == 0:
            return spread.median(0).values
        return spread.masked_fill(self.pushed[:, None], torch.nan).nanmedian(0).values.nan_to_num(0.0)

    def _blurred(
        self, lever: Float[Tensor, "K P 2"], pivot_error: float
    ) -> tuple[Float[Tensor, "K S P 2"], Float[Tensor, "K S P"]]:
        """Velocity of each particle in each part of a window, and its speed, blurred by the pivot's error."""
        velocity, fade = self.velocity_by_part(lever), pivot_error * self.twists[..., 2, None].abs()
        return velocity, (velocity.square().sum(-1) + fade.square() + 1e-18).sqrt()

    def com_acceleration(self, com: Float[Tensor, "... 2"]) -> Float[Tensor, "... K 2"]:
        """Acceleration of the center of mass, m/s^2."""
        arm, a = com - self.grasp, self.acceleration
        return a[..., :2] + a[..., 2:] * turned(arm) - self.spin_square[..., None] * arm

    def inertial_wrench(self, inertia: Inertia) -> Float[Tensor, "K 3"]:
        """Force and torque about the grasp point that the motion itself takes: M a_c, and without I_j alpha."""
        force = inertia.mass * self.com_acceleration(inertia.com)
        torque = inertia.mass * cross(inertia.com - self.grasp, self.acceleration[:, :2])
        return torch.cat([force, torque[:, None]], -1)

    def motion_wrench(self, model: ParticleModel, mass: Float[Tensor, "P"]) -> Float[Tensor, "K 3"]:
        """Force and torque about the grasp point that the motion takes of particles of a `mass`, kg."""
        if self.articulated:
            return LinkedParticles.of(self, model).motion_wrench(mass, model.cell)
        inertia = inertia_of(model, mass)
        return self.inertial_wrench(inertia) + self.spin_up(inertia)

    def spin_up(self, inertia: Inertia) -> Float[Tensor, "K 3"]:
        """Torque I_j alpha about the grasp point."""
        return torch.nn.functional.pad((self.acceleration[:, 2] * inertia.about(self.grasp))[:, None], (2, 0))

    def gripper_load(self, model: ParticleModel, mass: Float[Tensor, "P"], height: float) -> GripperLoad:
        """Load of the gripper; particles of a `mass` (kg) move at half the object's `height` (m) over the feet."""
        moved = height / 2 * self.motion_wrench(model, mass)[:, :2]
        # only the kept parts of the tilt hold the mass's own moment; at one speed it is the same there and back
        kept, followed = self.load_kept[:, 1:], self.load_followed[:, 1:]
        swung = kept * (self.trial_mean @ moved) + followed * (self.trial_change @ moved)
        taken = torch.where(self.accelerated[:, None] | self.articulated, swung, kept * moved)
        balanced = self.articulated and bool(self.setup.contact_points)
        return GripperLoad(self.lift, self.tilt - taken, self.held, self.lever(model), balanced)
