"""Wrench of an object in the air: gravity and inertia, with errors of the grip and of the sensor."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import vmap
from torch.nn.functional import pad

from estimators.wrench.jacobian import NONE, Theta, Window, linearized, zeros
from estimators.wrench.sensor import flawed
from testbed.objects.model import ObjectShape
from testbed.sensing.lift_windows import LiftWindow

EYE = torch.eye(3, dtype=torch.float64)
_FIELDS = ("pull", "angular_acceleration", "spin_products", "tcp_height", "from_sensor", "tool", "tool_mass")
_FIELDS += ("tool_rate", "pull_rate", "pull_tilt", "tool_tilt")


@dataclass(frozen=True, eq=False)
class Matter:
    """Moments of the mass of one body, or of B bodies, about a point."""

    mass: Float[Tensor, "*B"]
    """Mass, kg."""
    first: Float[Tensor, "*B 3"]
    """Integral of r, kg m."""
    second: Float[Tensor, "*B 3 3"]
    """Integral of r r^T, kg m^2."""

    @staticmethod
    def of_groups(shape: ObjectShape) -> Matter:
        """Cells of each mass group, of 1 kg per particle, in the object frame."""
        at = torch.tensor(np.column_stack([shape.particles, np.full(len(shape.particles), shape.height / 2)]))
        group = torch.nn.functional.one_hot(torch.tensor(shape.mass_group), shape.n_m).double() * torch.tensor(
            shape.fill[:, None]
        )
        sides = torch.tensor([shape.cell, shape.cell, shape.height], dtype=torch.float64)
        own = at[:, :, None] * at[:, None] + (sides.square() / 12).diag()
        return Matter(group.sum(0), group.T @ at, torch.einsum("pg,pij->gij", group, own))

    @staticmethod
    def of_vector(vector: Float[Tensor, "10"]) -> Matter:
        """Body of some inertial parameters, as `InertialParameters.vector`."""
        about = vector[[4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(3, 3)
        return Matter(vector[0], vector[1:4], about.trace() / 2 * EYE - about)

    def times(self, mass: Float[Tensor, "B"]) -> Matter:
        """The bodies with their masses multiplied by `mass`."""
        return Matter(self.mass * mass, self.first * mass[:, None], self.second * mass[:, None, None])

    def shifted(self, shift: Float[Tensor, "*B 3"]) -> Matter:
        """The bodies moved by a shift, m."""
        first = self.first + self.mass[..., None] * shift
        cross = self.first[..., :, None] * shift[..., None, :]
        square = self.mass[..., None, None] * shift[..., :, None] * shift[..., None, :]
        return Matter(self.mass, first, self.second + cross + cross.mT + square)

    def turned(self, rotation: Float[Tensor, "3 3"]) -> Matter:
        """The bodies rotated about the point."""
        return Matter(self.mass, self.first @ rotation.T, rotation @ self.second @ rotation.T)

    def combined(self) -> Matter:
        """Sum of the bodies, as one body."""
        return Matter(self.mass.sum(0), self.first.sum(0), self.second.sum(0))

    def wrench(
        self, pull: Float[Tensor, "3"], rate: Float[Tensor, "3"], spin: Float[Tensor, "3 3"]
    ) -> Float[Tensor, "6"]:
        """Force and torque about the point that a motion takes, N and N m.

        Args:
            pull: acceleration of the point less gravity, m/s^2.
            rate: angular acceleration, rad/s^2.
            spin: products of the angular velocity's components, rad^2/s^2.
        """
        force = self.mass * pull + torch.linalg.cross(rate, self.first) + (spin - spin.trace() * EYE) @ self.first
        turn = self.second @ spin
        gyroscopic = torch.stack([turn[1, 2] - turn[2, 1], turn[2, 0] - turn[0, 2], turn[0, 1] - turn[1, 0]])
        own = self.second.trace() * rate - self.second @ rate
        return torch.cat([force, torch.linalg.cross(self.first, pull) + own + gyroscopic])


@dataclass(frozen=True, eq=False)
class Air:
    """K windows of one lift, measured or planned.

    Unknowns, each 0 where it is left out: errors of the setup that change wrenches in the air or readings; `place`, the
    position error (x, y, z) of the object in the grip, m; `moving` and `scale`, relative errors of the wrench of the
    acceleration and of the whole wrench; `upright`, changes of the second moments zz, xz and yz, kg m^2; and those of
    the object's `matter`.
    """

    matter: Callable[[Theta], Matter]
    """Mass distribution of the object as a function of the unknowns, object frame."""
    grasp: Float[Tensor, "2"]
    """Grasp point, m, object frame."""
    windows: Window
    """Fields of the windows, as `LiftWindow` names them."""

    @staticmethod
    def of(shape: ObjectShape, windows: Sequence[LiftWindow], matter: Callable[[Theta], Matter]) -> Air:
        """Windows of one lift of an object whose mass distribution is `matter`."""
        fields = {name: torch.tensor(np.array([getattr(window, name) for window in windows])) for name in _FIELDS}
        return Air(matter, torch.tensor(shape.grasps[windows[0].grasp].position), fields)

    @staticmethod
    def of_masses(shape: ObjectShape, windows: Sequence[LiftWindow]) -> Air:
        """Windows of an object of mass groups: unknown `mass`, kg per particle, and `particle_offset`, m."""
        groups = Matter.of_groups(shape)

        def matter(theta: Theta) -> Matter:
            bodies = groups.times(theta["mass"])
            if "particle_offset" in theta:
                bodies = bodies.shifted(pad(theta["particle_offset"], (0, 1)))
            return bodies.combined()

        return Air.of(shape, windows, matter)

    def wrenches(self, theta: Theta) -> Float[Tensor, "K 6"]:
        """Wrenches of the gripper on the object, N and N m."""
        return vmap(self.predict, (None, 0))(theta, self.windows)

    def linearized(self, theta: Theta) -> tuple[Float[Tensor, "K 6"], dict[str, Float[Tensor, "K 6 n"]]]:
        """Wrenches, and their derivatives in each unknown."""
        return linearized(self.predict, theta, self.windows)

    def predict(self, theta: Theta, window: Window) -> Float[Tensor, "6"]:
        """Wrench of the gripper on the object in one window as the sensor shows it, about the assumed TCP."""
        factor = 1 + theta.get("moving", NONE)
        tilt, delay = theta.get("table_tilt", torch.zeros(2, dtype=torch.float64)), theta.get("delay", NONE)
        pull = window["pull"] + tilt @ window["pull_tilt"] + delay * window["pull_rate"]
        rate, spin = factor * window["angular_acceleration"], factor * window["spin_products"]
        wrench = self.in_hand(theta, window).wrench(pull, rate, spin) * (1 + theta.get("scale", NONE))
        # the sensor also carries the tool; its assumed wrench is subtracted below
        tool = window["tool"] * (1 + theta.get("tool_mass", NONE) / window["tool_mass"].clamp(min=1e-9))
        tool = tool + tilt @ window["tool_tilt"] + delay * window["tool_rate"]
        if "tool_com" in theta:
            tool = tool + pad(torch.linalg.cross(theta["tool_com"], window["tool"][:3]), (3, 0))
        read = torch.linalg.solve(window["from_sensor"], wrench) + tool
        return window["from_sensor"] @ (flawed(theta, read) - window["tool"])

    def in_hand(self, theta: Theta, window: Window) -> Matter:
        """The object about the assumed TCP, at its true place in the hand."""
        held = self.matter(theta).shifted(-torch.cat([self.grasp, window["tcp_height"][None]]))
        if "upright" in theta:
            zz, xz, yz, none = *theta["upright"].unbind(), torch.zeros((), dtype=torch.float64)
            more = torch.stack([none, none, xz, none, none, yz, xz, yz, zz]).reshape(3, 3)
            held = Matter(held.mass, held.first, held.second + more)
        angle = theta.get("grasp_angle", NONE) + theta.get("tcp_angle", NONE)
        cos, sin, none, one = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle), torch.ones_like(angle)
        turn = torch.stack([cos, -sin, none, sin, cos, none, none, none, one]).reshape(3, 3)
        place = theta.get("place", torch.zeros(3, dtype=torch.float64))
        if "grasp_offset" in theta:
            place = place + pad(theta["grasp_offset"], (0, 1))
        if "tcp_offset" in theta:
            place = place + pad(window["from_sensor"][:2, :3] @ theta["tcp_offset"], (0, 1))
        return held.turned(turn).shifted(place)


def nominal(known: Theta, sizes: Mapping[str, Tensor]) -> Theta:
    """Known unknowns, and 0 for the errors of the given sizes."""
    return known | zeros(**{name: tuple(size.shape) for name, size in sizes.items()})


def columns(slopes: Mapping[str, Float[Tensor, "K 6 n"]], sizes: Mapping[str, Tensor]) -> Float[Tensor, "R e"]:
    """Effects of one standard deviation of each error, a column an error; R = 6 K."""
    return torch.cat([slopes[name] * size.flatten() for name, size in sizes.items()], -1).flatten(0, 1)
