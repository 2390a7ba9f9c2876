"""The paper's particle model in torch: Eqs. mass to dv, the updates update1, update2, and the model's errors.

Batched, float64, differentiable. States are of the center of mass, in the world: pose (x, y, yaw) and velocity.
Wrenches are planar (f_x, f_y, torque about the grasped point). Leading dimensions `...` are batch dimensions:
trajectories, samples, seeds.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.validation import check_positive, is_number
from testbed.worlds.parameters import parameter, parameters_of

REST_SPEED = 1e-6
"""Speed below which a particle's direction fades out, m/s: friction has no direction at rest."""


@dataclass(frozen=True)
class ModelErrors:
    """Standard deviations of the particle model, measured with a perfect sensor and known masses."""

    pivot_error: float = 5e-5
    """Center of a turn, m."""
    force_error: float = 0.0001
    """Force, as a part of the total drag."""
    torque_error: float = 0.00055
    """Torque, as a part of itself."""
    height_error: float = parameter(
        default=0.0009,
        unit="m",
        shows=("table",),
        cause="the TCP is higher or lower over the table: measure its height",
    )
    """Height of the TCP over the feet, m."""
    lift_error: float = 0.06
    """Vertical force of a nulled gripper that the sensor cannot measure, N."""
    tilt_error: float = 0.0005
    """Moment of a nulled gripper that the sensor cannot measure, N m."""
    lead_error: float = parameter(
        default=0.02, unit="s", shows=("table",), cause="friction leads or lags the motion: align the clocks"
    )
    """Time by which friction leads the motion, s: MuJoCo's feet drag against v + a / b, b their friction's damping."""
    inertia_error: float = parameter(
        default=0.007,
        shows=("table",),
        cause="accelerated turns show another inertia than the masses have: weigh the object again, check the torque's "
        "unit and the object's size",
    )
    """I_j, as a part of itself: once of each, and once of all together."""
    weight_error: float = 1e-3
    """Weighing, kg."""

    def __post_init__(self) -> None:
        for field in fields(ModelErrors):
            value = getattr(self, field.name)
            if not (is_number(value) and value >= 0):
                raise InvalidValueError(f"{type(self).__name__}.{field.name}", value, "a finite number >= 0")
        check_positive(f"{type(self).__name__}.weight_error", self.weight_error)

    @property
    def nulled(self) -> Float[np.ndarray, "3"]:
        """Mean lift and moments of a nulled gripper over a trial, N and N m."""
        return np.array([self.lift_error, self.tilt_error, self.tilt_error])


EXACT = ModelErrors(**{field.name: 0.0 for field in fields(ModelErrors) if field.name != "weight_error"})
"""Errors of a perfect model: the weighing's alone."""
MODEL_PARAMETERS = {name.removesuffix("_error"): described for name, described in parameters_of(ModelErrors).items()}
"""Uncertain parameters of the model, by the names of their unknowns in the forward model."""
RIGID = ModelErrors(force_error=0.0025, torque_error=0.003, lift_error=0.8, tilt_error=0.07, inertia_error=0.06)
"""Errors under one rigid body: its loads are not exactly affine over the feet, and a gripper that is nulled before the
motion carries far more of a body that does not yield than of blocks that slide apart."""


@dataclass(frozen=True, eq=False)
class ParticleModel:
    """An object's shape as tensors: particles and the group maps G_m and G_mu."""

    particles: Float[Tensor, "P 2"]
    """Positions, m, object frame."""
    mass_group: Int[Tensor, "P"]
    """Column of G_m."""
    friction_group: Int[Tensor, "P"]
    """Column of G_mu; -1 without contact."""
    cell: float
    """Side of a particle's cell, m."""
    fill: Float[Tensor, "P"]
    """Material in each cell over the mean of its group's."""
    link: Int[Tensor, "n_m"]
    """Link of each mass group of a chain, 0 of a rigid object's."""
    hinges: Float[Tensor, "H 2"]
    """Hinge between each link and the next, m, object frame."""
    stands_on_feet: bool = False
    """True if points of contact are feet of the mass groups, False if they are those of one rigid body."""

    @staticmethod
    def of(shape: ObjectShape) -> ParticleModel:
        """Model of a shape."""
        return ParticleModel(
            torch.tensor(shape.particles),
            torch.tensor(shape.mass_group),
            torch.tensor(shape.friction_group),
            shape.cell,
            torch.tensor(shape.fill),
            torch.zeros(shape.n_m, dtype=torch.int64) if shape.chain is None else torch.tensor(shape.chain.link),
            torch.zeros(0, 2, dtype=torch.float64) if shape.chain is None else torch.tensor(shape.chain.hinges),
            shape.stands_on_feet,
        )

    def points(self, *, spread: bool) -> Float[Tensor, "P C 2"]:
        """Points at which each particle touches the table, m: its middle, or four points of its cell.

        The four are the nodes of Gauss quadrature over a square. An object on points of contact has no others.
        """
        if not spread or bool(self.is_contact.any()):
            return self.particles[:, None]
        ends = (-self.cell / 12**0.5, self.cell / 12**0.5)
        offset = torch.tensor([[x, y] for x in ends for y in ends], dtype=torch.float64)
        return self.particles[:, None] + (self.fill > 0)[:, None, None] * offset

    @property
    def reach(self) -> Float[Tensor, ""]:
        """Root mean square distance of the particles from their middle, m."""
        return (self.particles - self.particles.mean(0)).square().sum(-1).mean().sqrt()

    @property
    def contact(self) -> Tensor:
        """True for particles that touch the table, (P,) bool."""
        return self.friction_group >= 0

    @property
    def is_contact(self) -> Tensor:
        """True for particles that are points of contact alone, (P,) bool."""
        return self.contact & (self.fill == 0)

    @property
    def stands_in_groups(self) -> bool:
        """True if every mass group touches the table, so that each may rest on its own weight."""
        count = int(self.mass_group.max()) + 1
        apart = self.stands_on_feet or not bool(self.is_contact.any())
        return apart and len(self.mass_group[self.contact].unique()) == count

    @property
    def feet(self) -> Int[Tensor, "F"]:
        """Particles that are feet of mass groups, whose places are known."""
        return torch.nonzero(self.is_contact & self.stands_on_feet).flatten()

    def particle_mass(self, mass: Float[Tensor, "... n_m"]) -> Float[Tensor, "... P"]:
        """Mass of each particle, G_m^T m, by the fill of its cell, kg."""
        return mass[..., self.mass_group] * self.fill

    @property
    def parts(self) -> Float[Tensor, "n_m P"]:
        """Particle masses of one group after the other: 1 kg per particle in the group, 0 in the others."""
        return self.particle_mass(torch.eye(int(self.mass_group.max()) + 1, dtype=torch.float64))

    def particle_friction(self, friction: Float[Tensor, "... n_mu"]) -> Float[Tensor, "... P"]:
        """Friction coefficient of each particle, G_mu^T mu; 0 without contact."""
        return torch.where(self.contact, friction[..., self.friction_group.clamp(min=0)], 0.0)


@dataclass(frozen=True, eq=False)
class Inertia:
    """Object-level parameters: Eqs. mass, com, inertia."""

    mass: Float[Tensor, "..."]
    """M, kg."""
    com: Float[Tensor, "... 2"]
    """c, m, object frame."""
    about_com: Float[Tensor, "..."]
    """I_cm, kg m^2, cells solid."""

    def about(self, points: Float[Tensor, "K 2"]) -> Float[Tensor, "K"]:
        """Moment of inertia about other points, kg m^2."""
        return self.about_com + self.mass * (self.com - points).square().sum(-1)


def inertia_of(model: ParticleModel, particle_mass: Float[Tensor, "... P"]) -> Inertia:
    """M, c and I_cm of particle masses."""
    total = particle_mass.sum(-1)
    com = particle_mass @ model.particles / total[..., None]
    squares = (model.particles - com[..., None, :]).square().sum(-1) + model.cell**2 / 6
    return Inertia(total, com, (particle_mass * squares).sum(-1))


def turned(vector: Float[Tensor, "... 2"]) -> Float[Tensor, "... 2"]:
    """`vector` turned by +90 degrees."""
    return torch.stack([-vector[..., 1], vector[..., 0]], -1)


def cross(a: Float[Tensor, "... 2"], b: Float[Tensor, "... 2"]) -> Float[Tensor, "..."]:
    """z of a x b."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def rotate(angle: Float[Tensor, "..."], vector: Float[Tensor, "... 2"]) -> Float[Tensor, "... 2"]:
    """`vector` turned by `angle`, rad."""
    return torch.cos(angle)[..., None] * vector + torch.sin(angle)[..., None] * turned(vector)


def direction(velocity: Float[Tensor, "... 2"], rest_speed: float = REST_SPEED) -> Float[Tensor, "... 2"]:
    """Unit velocity, fading to zero below `rest_speed` [m/s]."""
    return velocity / (velocity.square().sum(-1, keepdim=True) + rest_speed**2).sqrt()


def friction_wrench(
    magnitude: Float[Tensor, "... P"], unit_velocity: Float[Tensor, "... P 2"], lever: Float[Tensor, "... P 2"]
) -> Float[Tensor, "... 3"]:
    """Sum of f_i,f (Eq. fif): friction of `magnitude` (N) against each particle's motion, about the levers' origin."""
    force = -magnitude[..., None] * unit_velocity
    return torch.cat([force.sum(-2), cross(lever, force).sum(-1, keepdim=True)], -1)


def acceleration(
    model: ParticleModel,
    inertia: Inertia,
    friction: Float[Tensor, "... P"],
    pose: Float[Tensor, "... 3"],
    velocity: Float[Tensor, "... 3"],
    wrench: Float[Tensor, "... 3"],
    grasp: Float[Tensor, "... 2"],
) -> Float[Tensor, "... 3"]:
    """Acceleration of the center of mass and angular acceleration, Eq. dv.

    Args:
        model: particles of the object.
        inertia: M, c, I_cm.
        friction: mu_i N_i of each particle, N; mu m g where each rests on its own weight.
        pose: pose of the center of mass, m and rad.
        velocity: velocity of the center of mass, m/s and rad/s.
        wrench: f_x, f_y of the gripper on the object, world axes, and torque about the grasped point.
        grasp: grasped point, m, object frame.
    """
    yaw = pose[..., 2]
    lever = rotate(yaw[..., None], model.particles - inertia.com[..., None, :])
    particle_velocity = velocity[..., None, :2] + velocity[..., None, 2:] * turned(lever)
    drag = friction_wrench(friction, direction(particle_velocity), lever)
    torque = wrench[..., 2] + cross(rotate(yaw, grasp - inertia.com), wrench[..., :2])
    total = torch.cat([wrench[..., :2], torque[..., None]], -1) + drag
    return total / torch.stack([inertia.mass, inertia.mass, inertia.about_com], -1)


def step(pose: Tensor, velocity: Tensor, accelerations: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """Eqs. update1 and update2."""
    return pose + velocity * dt, velocity + accelerations * dt


def one_step(
    model: ParticleModel,
    inertia: Inertia,
    friction: Float[Tensor, "... T P"],
    pose: Float[Tensor, "... T 3"],
    velocity: Float[Tensor, "... T 3"],
    wrench: Float[Tensor, "... T 3"],
    grasp: Float[Tensor, "... 2"],
    dt: float | Float[Tensor, "T 1"],
) -> Float[Tensor, "... T 3"]:
    """Velocity one step on, Phi of the problem formulation, from each measured state on its own."""
    a = acceleration(model, inertia, friction, pose, velocity, wrench, grasp[..., None, :])
    return velocity + a * dt
