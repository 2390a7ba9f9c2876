"""Wrench of an object that slides and turns over the table: friction and inertia, with every error of the setup.

An object is a chain of links; a rigid object has one. The rows are the wrench about the grasp point and the torques
about the hinges. A hinge torque is that of all links beyond the hinge; it has no sensor, and equals the hinge's own
friction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import vmap

from estimators.wrench.jacobian import NONE, Slopes, Theta, Window, linearized, zeros
from estimators.wrench.model import ParticleModel, cross, rotate, turned
from testbed.sensing.compensation import SIDEWAYS

PERIOD, FINEST = 0.8, 8
"""Side of the square over which friction by place is a Fourier series, m, and the order of its shortest waves along an
axis. Ours: trials stay within the square, and shorter waves average out under an object."""
REFERENCE = 0.02
"""Speed at which friction is the stated one, m/s."""
BATCH = 100_000
"""Points of contact, times parts of windows, in a batch."""
SMALLEST = 1e-12
"""Least change of a force of 1 N that counts, N."""
PAIR = torch.zeros(2, dtype=torch.float64)
"""Value of an unknown of two components that is left out."""
IN_PLANE = torch.tensor(SIDEWAYS[:, :2])
"""Acceleration that opposes gravity per tilt about each axis of the table, m/s^2 per rad."""


def _waves() -> tuple[Float[Tensor, "n 2"], Float[Tensor, "n"]]:
    """Wave vectors, rad/m, and the part of the variance of each, uniform in the logarithm of the wavelength."""
    along = torch.cartesian_prod(*[torch.arange(-FINEST, FINEST + 1, dtype=torch.float64)] * 2)
    square = along.square().sum(1)
    half = (along[:, 0] > 0) | ((along[:, 0] == 0) & (along[:, 1] > 0))  # the other half are the same waves
    kept = along[half & (square <= FINEST**2)]
    part = kept.square().sum(1).reciprocal()
    return 2 * math.pi / PERIOD * kept, part / part.sum()


WAVES, WAVE_PARTS = _waves()
"""Wave vectors of a table's friction, and the part of the variance of each."""


@dataclass(frozen=True, eq=False)
class Moved:
    """Positions and motion of points of an object over S parts of a window, from the grasp point, held link's axes."""

    place: Float[Tensor, "S *N 2"]
    """Position, m."""
    velocity: Float[Tensor, "S *N 2"]
    """Velocity, m/s."""
    rate: Float[Tensor, "S *N"]
    """Turn rate of a point's link, rad/s."""


@dataclass(frozen=True, eq=False)
class Table:
    """K windows of an object on the table, measured or planned.

    Unknowns, each 0 where it is left out: errors of the setup, by their names in `SetupErrors`; `place_friction` is the
    relative change of friction at each particle. Further: `mass` of every particle, kg; `friction` of every point of
    contact in addition to that of the windows, N; `twist`, error of the hand's, m/s and rad/s; `lead`, the time by
    which friction leads the motion, s; `inertia`, relative error of the wrench of the acceleration; `force` on every
    particle, N; `camera_errors` and `link_camera`, errors of the camera for a pushed object and for links, in standard
    deviations; and `hinge_friction`, the torque of each hinge's friction, N m.
    """

    model: ParticleModel
    points: Float[Tensor, "P C 2"]
    """Points at which a particle touches the table, of equal load, m, object frame."""
    windows: Window
    """Fields of the windows, as `Observations.table` gives them."""
    pivot_error: float
    """Error of the center of a turn, m; the drag of a point nearer than that fades."""

    def dragged(self, drag: Float[Tensor, "P"] | Float[Tensor, "K P"]) -> Table:
        """The windows with a friction of every particle, N."""
        count = len(self.windows["grasp"])
        return replace(self, windows=self.windows | {"drag": drag.expand(count, len(self.points))})

    @cached_property
    def field(self) -> Float[Tensor, "K P n"]:
        """Derivatives of the friction under each particle in the amplitude of every wave of `WAVES`, cosines first."""
        poses, size = self.windows["poses"], WAVE_PARTS.sqrt().repeat(2)
        field = torch.zeros(*self.lever.shape[:2], len(size), dtype=torch.float64)
        cosines, sines = field.tensor_split(2, -1)
        for pose in poses.unbind(1):  # part by part and in place, to limit memory
            phase = (pose[:, None, :2] + rotate(pose[:, None, 2], self.lever)) @ WAVES.T  # (K, P, n)
            cosines += phase.cos()
            sines += phase.sin_()
        field *= size / poses.shape[1]
        return field

    @cached_property
    def undragged(self) -> Table:
        """The windows without friction."""
        return self.dragged(torch.zeros(len(self.points), dtype=torch.float64))

    @property
    def chunk(self) -> int:
        """Number of windows in a batch."""
        parts = self.windows["rates"].shape[1]
        return max(1, BATCH // (parts * self.points.shape[0] * self.points.shape[1]))

    def rows(self, theta: Theta) -> Float[Tensor, "K 3+H"]:
        """Wrenches of the gripper on the object, N and N m, and torques about hinges, N m."""
        return vmap(self.predict, (None, 0), chunk_size=self.chunk)(theta, self.windows)

    def linearized(self, theta: Theta) -> tuple[Float[Tensor, "K 3+H"], Slopes]:
        """`rows`, and their derivatives in each unknown."""
        return linearized(self.predict, theta, self.windows, self.chunk)

    def sideways(self, tilt: Float[Tensor, "2"], window: Window) -> Float[Tensor, "2"]:
        """Change of the acceleration that opposes gravity by a tilt about the table's axes, rad; m/s^2, object axes."""
        return rotate(-window["poses"][:, 2], tilt @ IN_PLANE).mean(0)

    def drag_rows(self) -> Float[Tensor, "K 3+H P"]:
        """Derivatives in the friction of each particle."""
        slopes = self.undragged.linearized(zeros(friction=self.points.shape[:2]))[1]["friction"]
        return slopes.unflatten(-1, self.points.shape[:2]).mean(-1)

    def motion(self, mass: Float[Tensor, "P"]) -> Float[Tensor, "K 3+H"]:
        """Inertial wrenches and hinge torques of particles of a `mass`, kg, without friction."""
        return self.undragged.at_middles.rows({"mass": mass})

    def inertial_rows(self) -> Float[Tensor, "K 3 P"]:
        """Derivatives of the inertial wrenches in the mass of each particle."""
        one = {"mass": torch.ones(len(self.points), dtype=torch.float64)}

        def each(window: Window) -> Tensor:
            middle = self._moved({}, window, self.model.particles)
            force, torque = self._inertial(one, window, middle)
            return torch.cat([force, (torque + cross(middle.place, force))[..., None]], -1).mean(0).mT

        return vmap(each, chunk_size=self.chunk)(self.windows)

    @cached_property
    def unresolved(self) -> Float[Tensor, "K 3+H P"]:
        """Error of `drag_rows` by motion that changes within a part, by Richardson extrapolation.

        The change between all parts and half as many, times the sum of the geometric series of further changes: a third
        where motion is smooth, the whole where two halvings change the rows alike.
        """
        rows = [self.drag_rows(), self._in_parts_of(2).drag_rows(), self._in_parts_of(4).drag_rows()]
        finer, coarser = rows[0] - rows[1], rows[1] - rows[2]
        fine, coarse = (change.flatten(1).norm(dim=1) for change in (finer, coarser))
        left = (fine / (coarse - fine).clamp(min=SMALLEST)).clamp(max=1.0)
        return finer * torch.where(coarse > fine, left, 1.0)[:, None, None]

    def _in_parts_of(self, count: int) -> Table:
        """The windows with the motion averaged over groups of `count` parts."""
        rates = self.windows["rates"]
        means = [part.mean(1, keepdim=True).expand_as(part) for part in rates.split(count, dim=1)]
        return replace(self, windows=self.windows | {"rates": torch.cat(means, 1)})

    @property
    def at_middles(self) -> Table:
        """The windows with contact at the middle of every particle."""
        return replace(self, points=self.model.particles[:, None])

    def moved(self, theta: Theta) -> Moved:
        """Positions and motion of the particles in all windows, with windows as the leading axis."""

        def of(theta: Theta, window: Window) -> tuple[Tensor, Tensor, Tensor]:
            found = self._moved(theta, window, self.model.particles)
            return found.place, found.velocity, found.rate

        return Moved(*vmap(of, (None, 0))(theta, self.windows))

    @cached_property
    def lever(self) -> Float[Tensor, "K P 2"]:
        """Mean place of each particle from the grasp point, m."""
        return self.moved({}).place.mean(1)

    @cached_property
    def velocity(self) -> Float[Tensor, "K P 2"]:
        """Mean velocity of each particle, m/s."""
        return self.moved({}).velocity.mean(1)

    def predict(self, theta: Theta, window: Window) -> Float[Tensor, "3+H"]:
        """Force x, y and torque about the grasp point of the gripper on the object in one window, and hinge torques."""
        model = self.model
        offset = theta["particle_offset"][model.mass_group] if "particle_offset" in theta else PAIR.expand(1, 2)
        middle = self._moved(theta, window, model.particles + offset)
        touched = self.points + offset[:, None]
        if "foot_offset" in theta:
            touched = touched.index_add(0, model.feet, theta["foot_offset"][:, None].expand(-1, touched.shape[1], -1))
        touching = self._moved(theta, window, touched)
        load, unit = self._load(theta, window, middle), self._directions(touching)
        # positions of a rigid object do not change, so unit vectors are averaged over the parts of a window first
        drag = load[..., None] * (unit.mean(0, keepdim=True) if len(touching.place) == 1 else unit)
        force, torque = drag.sum(-2), cross(touching.place, drag).sum(-1)  # of each particle
        more = self._inertial(theta, window, middle) if "mass" in theta else None
        if "anisotropy" in theta:
            along = unit.mean(-2)
            beside = load.sum(-1)[..., None] * (self._pulled(theta, window, along) - along)
            force, torque = force + beside, torque + cross(middle.place, beside)
        if "friction_law" in theta:
            beside = self._beside_law(theta["friction_law"], load.sum(-1), force, middle.place)
            force, torque = force + beside, torque + cross(middle.place, beside)
        if more is not None:
            force, torque = force + more[0], torque + cross(middle.place, more[0]) + more[1]
        if "force" in theta:
            force, torque = force + theta["force"], torque + cross(middle.place, theta["force"])
        wrench = torch.cat([force.sum(1), torque.sum(1)[:, None]], 1).mean(0)
        if "camera_errors" in theta:
            moved, turn = self._camera_errors(theta, window)[0]
            pull = window["force"]
            wrench = wrench + torch.cat([turn * turned(pull), -cross(moved, pull)[None]])
        if not len(model.hinges):
            return wrench
        frames, _ = self._links(theta, window)
        joint = rotate(frames[:, :-1, 0], model.hinges - window["grasp"]) + frames[:, :-1, 1:3]  # (S, H, 2)
        trails = window["trails"]
        about = torque @ trails.T - cross(joint, trails @ force)
        about = about.mean(0) + window["turning"] * theta.get("hinge_friction", NONE)
        return torch.cat([wrench, about])

    def _links(self, theta: Theta, window: Window) -> tuple[Float[Tensor, "S L 3"], Float[Tensor, "S L 3"]]:
        """Angle and shift of every link, rad and m, and its velocity and turn rate, errors included."""
        frames, rates = window["frames"], window["rates"]
        if "link_camera" in theta:
            off = torch.tensordot(theta["link_camera"], window["links_with_errors"], 1)
            frames, rates = frames + off[..., :3], rates + off[..., 3:6]
        if "lead" in theta:
            rates = rates + theta["lead"] * window["ahead"][:, None]
        twist = theta.get("twist", torch.zeros(3, dtype=torch.float64))
        if "camera_errors" in theta:
            twist = twist + self._camera_errors(theta, window)[1]
        if "twist" in theta or "camera_errors" in theta:  # other links keep their own rate, and follow their hinge
            held = window["held"][:, None]
            velocity = rates[..., :2] + twist[:2] + twist[2] * turned(window["trailing"])
            rates = torch.cat([velocity, rates[..., 2:] + twist[2] * held], -1)
        angle, shift = self._in_hand(theta, window)
        if angle is None:
            return frames, rates
        hand = window["held"] @ rates
        beside = rotate(angle, rates[..., :2] - hand[:, None, :2])
        beside = beside + (hand[:, None, 2:] - rates[..., 2:]) * turned(shift)
        rates = torch.cat([hand[:, None, :2] + beside, rates[..., 2:]], -1)
        return torch.cat([frames[..., :1] + angle, rotate(angle, frames[..., 1:]) + shift], -1), rates

    def _in_hand(self, theta: Theta, window: Window) -> tuple[Tensor | None, Tensor]:
        """Angle and shift of the object in the hand, rad and m; the angle is None where neither is unknown."""
        names = {"grasp_angle", "tcp_angle", "grasp_offset", "tcp_offset"}
        if names.isdisjoint(theta):
            return None, PAIR
        shift = theta.get("grasp_offset", PAIR)
        if "tcp_offset" in theta:
            shift = shift + window["of_hand"] @ theta["tcp_offset"]
        return (theta.get("grasp_angle", NONE) + theta.get("tcp_angle", NONE)) * window["gripped"], (
            shift * window["gripped"]
        )

    def _camera_errors(self, theta: Theta, window: Window) -> tuple[tuple[Tensor, Tensor], Tensor, Tensor]:
        """Errors of a pushed object's motion by the camera.

        Returns:
            Shift of the point of contact, m, and rotation of the object, rad; error of the twist of that point; and
            error of its acceleration: along x, along y, and angular.
        """
        shift, turn, velocity, rate, pull, slope = (window["camera_errors"] @ theta["camera_errors"]).split(
            [2, 1, 2, 1, 2, 1]
        )
        at, (x, y, spin), (a, b, alpha, square) = window["grasp"], window["twist"], window["accelerations"][0, 0]
        from_origin = torch.stack([x, y]) - spin * turned(at)
        pulled = torch.stack([a, b]) - alpha * turned(at) + square * at
        moved = -shift - turn * turned(at)
        twist = torch.cat([velocity - turn * turned(from_origin) + rate * turned(at), rate])
        return (moved, turn[0]), twist, torch.cat([pull - turn * turned(pulled) + slope * turned(at), slope])

    def _moved(self, theta: Theta, window: Window, points: Float[Tensor, "P *C 2"]) -> Moved:
        """Positions and motion of points of each particle."""
        frames, rates = (self._of_particle(each, points) for each in self._links(theta, window))
        place = rotate(frames[..., 0], points - window["grasp"]) + frames[..., 1:]
        return Moved(place, rates[..., :2] + rates[..., 2:] * turned(place), rates[..., 2])

    def _of_particle(self, links: Float[Tensor, "S L n"], points: Float[Tensor, "P *C 2"]) -> Float[Tensor, "S P *C n"]:
        """Values of each point's link; a rigid object has one link for all."""
        own = links if links.shape[1] == 1 else links[:, self.model.link[self.model.mass_group]]
        return own[:, :, None] if points.dim() > 2 else own

    def _load(self, theta: Theta, window: Window, middle: Moved) -> Float[Tensor, "P C"]:
        """Friction of each point, N, the same over the window."""
        load = (window["drag"] / self.points.shape[1])[:, None].expand(self.points.shape[:2])
        load = load + theta.get("friction", NONE)
        more = NONE
        if "group_friction" in theta:
            more = more + theta["group_friction"][self.model.mass_group]
        if "foot_offset" in theta:
            more = more + self._rebalanced(theta["foot_offset"])
        if "place_friction" in theta:
            more = more + theta["place_friction"]
        if "speed_friction" in theta:
            speed = (middle.velocity.mean(0).square().sum(-1) + 1e-18).sqrt()
            more = more + theta["speed_friction"] * torch.log10(speed.clamp(1e-4, 1.0) / REFERENCE)
        return load * (1 + more[..., None])

    def _rebalanced(self, offset: Float[Tensor, "F 2"]) -> Float[Tensor, "P"]:
        """Relative change of each foot's load by which feet with position errors still balance their group."""
        feet, group = self.model.feet, self.model.mass_group[self.model.feet]
        own = torch.nn.functional.one_hot(group, len(self.model.parts)).double()
        mean = own / own.sum(0)
        lever = self.model.particles[feet]
        lever = lever - (mean.T @ lever)[group]
        squares = torch.einsum("fi,fj,fg->gij", lever, lever, mean)
        moment = torch.linalg.solve(squares, mean.T @ offset)
        return torch.zeros(len(self.points), dtype=torch.float64).index_add(0, feet, -(lever * moment[group]).sum(-1))

    def _directions(self, points: Moved) -> Float[Tensor, "S P C 2"]:
        """Unit velocity of each point, shorter near the center of a turn."""
        fade = self.pivot_error * points.rate
        return points.velocity / (points.velocity.square().sum(-1) + fade.square() + 1e-18).sqrt()[..., None]

    def _pulled(self, theta: Theta, window: Window, unit: Float[Tensor, "S P 2"]) -> Float[Tensor, "S P 2"]:
        """Drag of particles of unit velocities u on a table of elliptic friction.

        Friction is 1 + |a| along one axis of the table and 1 - |a| across, with a the anisotropy:
        f = A u / sqrt(u . A u), A = (1 + |a|^2) I + 2 S, with S the reflection scaled by a, in the object's axes.
        """
        anisotropy = theta["anisotropy"]
        size = anisotropy.square().sum()
        a, b = rotate(-2 * window["poses"][:, 2], anisotropy)[:, None].unbind(-1)
        x, y = unit.unbind(-1)
        pulled = (1 + size) * unit + 2 * torch.stack([a * x + b * y, b * x - a * y], -1)
        length = unit.square().sum(-1) + 1e-30
        return pulled * (length / ((pulled * unit).sum(-1) + 1e-30)).sqrt()[..., None]

    def _beside_law(
        self, departure: Float[Tensor, "3"], load: Float[Tensor, "P"], force: Tensor, place: Float[Tensor, "S P 2"]
    ) -> Float[Tensor, "S P 2"]:
        """Departure of friction from Coulomb's, N: along it, across it, and around the middle of the contact."""
        along, across, around = departure
        arm = place - place[:, self.model.contact].mean(1, keepdim=True)
        reach = arm[:, self.model.contact].square().sum(-1).mean().sqrt()
        return along * force + across * turned(force) + around / reach * load[:, None] * turned(arm)

    def _inertial(self, theta: Theta, window: Window, middle: Moved) -> tuple[Tensor, Tensor]:
        """Inertial force on each particle and torque about its middle, N and N m; a tilt of the table included."""
        given = window["accelerations"] * (1 + theta.get("inertia", NONE))
        if "camera_errors" in theta:
            given = given + torch.cat([self._camera_errors(theta, window)[2], NONE[None]])
        angle, shift = self._in_hand(theta, window)
        if angle is not None:
            hand = torch.einsum("l,sln->sn", window["held"], given)[:, None]
            beside = rotate(angle, given[..., :2] - hand[..., :2]) + (hand - given)[..., 2:3] * turned(shift)
            beside = beside - (hand - given)[..., 3:] * shift
            given = torch.cat([hand[..., :2] + beside, given[..., 2:]], -1)
        own = self._of_particle(given, self.model.particles)
        pull = own[..., :2] + own[..., 2:3] * turned(middle.place) - own[..., 3:] * middle.place
        if "table_tilt" in theta:
            pull = pull + self.sideways(theta["table_tilt"], window)
        return theta["mass"][:, None] * pull, own[..., 2] * theta["mass"] * self.model.cell**2 / 6
