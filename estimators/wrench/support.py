"""Support models: normal load of every particle on the table from the particle masses and the gripper's load.

All are batched over K windows and differentiable. Loads are not clipped: a negative load means a lifted particle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from estimators.wrench.model import RIGID, ModelErrors, ParticleModel
from testbed.objects.model import GRAVITY

TURNED, SWUNG = np.array([0.0064, 0.0027, 0.0027]), np.array([0.33, 2.5e-3, 2.5e-3])
"""Change of a nulled gripper's lift, N, and moments, N m, one standard deviation: between directions of a turn, and
under acceleration."""
PUSHED = np.array([10.0, 1.0, 1.0])
"""Load of a fingertip, which is not nulled, N and N m: above any actual load, so that the sensor alone decides."""


@dataclass(frozen=True, eq=False)
class GripperLoad:
    """Load of the gripper in K windows, from the measured wrench."""

    lift: Float[Tensor, "K"]
    """Vertical force of the gripper on the object, fz, N."""
    moment: Float[Tensor, "K 2"]
    """Moment that the feet supply beyond the object's own weight: (sum x N, sum y N) about the grasp point, N m."""
    held: Int[Tensor, "K 2"]
    """Mass groups under the two pads, each of which carries half the lift."""
    lever: Float[Tensor, "K P 2"]
    """Position of each particle from the grasp point, m; of links in their current pose."""
    balanced: bool = False
    """True if the unknown feet of each group balance its own weight, so that no group leans on the others."""

    @property
    def carried(self) -> Float[Tensor, "K 3"]:
        """Lift and moment, N and N m."""
        return torch.cat([self.lift[:, None], self.moment], -1)

    @staticmethod
    def none(model: ParticleModel) -> GripperLoad:
        """Zero load in one window, with levers from the origin of the object frame."""
        lift, pair = torch.zeros(1, dtype=torch.float64), torch.zeros(1, 2, dtype=torch.float64)
        return GripperLoad(lift, pair, torch.zeros(1, 2, dtype=torch.int64), model.particles[None])


def load_map(height: float) -> np.ndarray:
    """Map from a wrench to the gripper's load (fz, t_y + h f_x, -t_x + h f_y), (3, 6)."""
    return np.array([[0, 0, 1, 0, 0, 0], [height, 0, 0, 0, 1, 0], [0, height, 0, -1, 0, 0]], dtype=float)


class ShrunkenLoad(NamedTuple):
    """Lift, N, and moments, N m, of the gripper in K windows, shrunken towards zero."""

    load: Float[np.ndarray, "K 3"]
    """Shrunken loads."""
    kept: Float[np.ndarray, "K 3"]
    """Part of a trial's mean load that shrinkage keeps, 0 to 1."""
    followed: Float[np.ndarray, "K 3"]
    """Part of the change from window to window that shrinkage keeps, 0 to 1."""
    size: Float[np.ndarray, "K 3"]
    """Standard deviation of a trial's mean load."""
    change: Float[np.ndarray, "K 3"]
    """Standard deviation of the change from window to window."""


def nulled_load(
    nulled: Float[np.ndarray, "3"],
    accelerated: Bool[np.ndarray, "K"],
    pushed: Bool[np.ndarray, "K"],
    carried: float = 0.0,
    *,
    links: bool = False,
) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3"]]:
    """Prior standard deviations of a nulled gripper's mean load over a trial, and of its change, N and N m.

    Arguments as in `shrunken_load`.
    """
    beside = carried * np.array([0.0, 1.0, 1.0])
    change = np.maximum(np.where(accelerated[:, None], SWUNG, TURNED), links * beside)
    held = ~pushed[:, None]
    return np.where(held, np.maximum(nulled, beside), PUSHED), np.where(held, change, PUSHED)


def shrunken_load(
    load: Float[np.ndarray, "K 3"],
    bias: Float[np.ndarray, "K 3"],
    noise: Float[np.ndarray, "K 3"],
    trial: Int[np.ndarray, "K"],
    accelerated: Bool[np.ndarray, "K"],
    nulled: Float[np.ndarray, "3"],
    pushed: Bool[np.ndarray, "K"],
    carried: float = 0.0,
    *,
    links: bool = False,
) -> ShrunkenLoad:
    """Loads of K windows, shrunken by the sensor's errors, and the sizes of mean and change.

    A trial's mean load and its change from window to window are shrunken towards zero by the part of their scatter that
    the sensor explains (empirical Bayes), since a load below the sensor's resolution is better estimated as zero. A
    scatter within two standard errors is replaced by that of a nulled gripper.

    Args:
        load: measured loads, N and N m.
        bias: variance of the error that the windows of a trial share.
        noise: variance of each window's own error.
        trial: trial that each window is from.
        accelerated: True for windows of an accelerated turn, in which a swinging arm carries larger loads.
        nulled: mean load of a nulled gripper over a trial, one standard deviation.
        pushed: True for windows of a push, whose fingertip is not nulled: its load is kept as measured.
        carried: moment of weights beside their feet that the hand carries, one standard deviation, N m.
        links: True for an object in links, where that moment changes as they turn.
    """
    likely, kept, followed = load.copy(), np.ones_like(load), np.ones_like(load)
    size, change_size = nulled_load(nulled, accelerated, pushed, carried, links=links)
    for rows in (accelerated, ~accelerated & ~pushed):
        if not rows.any():
            continue
        some = load[rows]
        trials, index = np.unique(trial[rows], return_inverse=True)
        mean, together = np.eye(len(trials))[index].T, np.bincount(index)
        mean = mean / together[:, None]
        common = mean @ some
        change, free = some - common[index], max(len(some) - len(trials), 1)
        explained = (mean @ bias[rows] + mean @ noise[rows] / together[:, None]).mean(axis=0)
        kept[rows], size[rows] = _shrinkage((common**2).mean(axis=0), explained, len(trials), size[rows][0])
        followed[rows], change_size[rows] = _shrinkage(
            (change**2).sum(axis=0) / free, noise[rows].mean(axis=0), free, change_size[rows][0]
        )
        likely[rows] = kept[rows] * common[index] + followed[rows] * change
    return ShrunkenLoad(likely, kept, followed, size, change_size)


@dataclass(frozen=True, eq=False)
class OwnWeight:
    """Own-weight loads: N_i = share_i g + lean_i, plus a linear response to the gripper's load."""

    share: Float[Tensor, "P"]
    """Part of its mass group's mass that each particle carries, kg; 0 without contact."""
    lean: Float[Tensor, "K P"]
    """Load of each particle by weights beside the middle of their feet, N; it sums to 0 over a group."""
    response: Float[Tensor, "K P 3"]
    """Change of each particle's load with the gripper's lift (N per N) and moment (N per N m)."""
    beside: Float[Tensor, "K 2"]
    """Moment of weights beside the middles of their feet that all groups share (sum x N, sum y N), N m."""

    def held_by(self, nulled: OwnWeight) -> Float[Tensor, "K 2"]:
        """Moment that the feet hold at the tilt at which the hand was nulled, N m.

        The hand keeps that tilt while links move, and may carry the rest of the moment of their weights.
        """
        tilt, still = self.response[..., 1:], nulled.response[..., 1:]
        stiffness = torch.linalg.pinv(tilt.mT @ tilt, hermitian=True)
        return (stiffness @ still.mT @ still @ nulled.beside[..., None])[..., 0]

    def loads(self, load: GripperLoad) -> Float[Tensor, "K P"]:
        """N_i, N."""
        return self.share * GRAVITY + self.lean + self.change(load)

    def change(self, load: GripperLoad) -> Float[Tensor, "K P"]:
        """Change of N_i with the gripper's load, N."""
        return (self.response @ load.carried[..., None])[..., 0]


def own_weight(model: ParticleModel, mass: Float[Tensor, "P"], load: GripperLoad) -> OwnWeight:
    """Loads with every mass group on its own weight: N_i = m_i g, plus the gripper's load.

    fz reduces the load of the held group, or by half each that of the two groups under the pads. All groups share one
    tilt on a foundation of even stiffness, so that each takes a part of the moment that is affine over its own feet: of
    the gripper's moment, and of that of weights beside their feet. Where groups are `balanced`, or on known feet, each
    takes the moment of its own weight. An object that does not stand in groups is one group, with `rigid_loads`.

    Args:
        model: particles of the object.
        mass: mass of each particle, kg.
        load: the gripper's load; only where it holds the object counts here.
    """
    lever, contact = load.lever, model.contact
    apart = model.stands_in_groups
    group, held = (
        (model.mass_group, load.held) if apart else (torch.zeros_like(each) for each in (model.mass_group, load.held))
    )
    count = int(group.max()) + 1
    zeros, pairs = torch.zeros(count, dtype=torch.float64), torch.zeros(len(lever), count, 2, dtype=torch.float64)
    feet = zeros.index_add(0, group, contact.double())
    whole = zeros.index_add(0, group, mass)
    share = torch.where(contact, (whole / feet)[group], 0.0)
    center = pairs.index_add(1, group, lever * contact[:, None]) / feet[:, None]
    offset = (lever - center[:, group]) * contact[:, None]
    tilt = offset @ torch.linalg.pinv(offset.mT @ offset, hermitian=True)
    weight = whole * GRAVITY
    beside = pairs.index_add(1, group, lever * mass[:, None]) * GRAVITY - weight[:, None] * center
    if load.balanced or model.stands_on_feet:
        own = torch.nn.functional.one_hot(group).double()
        squares = torch.einsum("kpi,kpj,pg->kgij", offset, offset, own)
        alone = (torch.linalg.pinv(squares, hermitian=True) @ beside[..., None])[..., 0]
        lean, shared = (offset * alone[:, group]).sum(-1), torch.zeros_like(center[:, 0])
    else:
        shared = beside.sum(1)
        lean = (tilt @ shared[..., None])[..., 0]
    gripped = ((group == held[..., None]) & contact).double()
    lift = (gripped / gripped.sum(-1, keepdim=True).clamp(min=1)).mean(-2)
    # fz acts at the grasp point: beside the middle of the held groups' feet it has a moment
    middle_held = center.gather(1, held[..., None].expand(-1, -1, 2)).mean(1)
    tilted = (tilt @ middle_held[..., None])[..., 0]
    return OwnWeight(share, lean, torch.cat([(tilted - lift)[..., None], tilt], -1), shared)


def own_weight_loads(model: ParticleModel, mass: Float[Tensor, "P"], load: GripperLoad) -> Float[Tensor, "K P"]:
    """Loads N_i with every mass group on its own weight, N."""
    return own_weight(model, mass, load).loads(load)


def rigid_loads(model: ParticleModel, mass: Float[Tensor, "P"], load: GripperLoad) -> Float[Tensor, "K P"]:
    """Loads of one rigid body, N, in balance: N_i = a + b x_i + c y_i over the particles in contact."""
    from_grasp = load.lever
    total = mass.sum() * GRAVITY
    moment = GRAVITY * torch.einsum("p,kpd->kd", mass, from_grasp) + load.moment
    wanted = torch.cat([(total - load.lift)[:, None], moment], dim=1)
    basis = torch.cat([torch.ones_like(from_grasp[..., :1]), from_grasp], dim=2) * model.contact[None, :, None]
    gram = basis.transpose(1, 2) @ basis
    # a straight row of points carries no moment across itself: the least-norm solution leaves that part out
    coefficients = torch.linalg.pinv(gram, rtol=1e-9, hermitian=True) @ wanted[..., None]
    return (basis @ coefficients)[..., 0]


def contact_spread(model: ParticleModel, mass: Float[Tensor, "P"]) -> Float[Tensor, "P w"]:
    """Standard deviations of the loads on points of contact about `rigid_loads`, N: a column a direction.

    Balance determines the loads of three points. A rigid body on more points rests on an unknown three of them: all
    triples with the center of mass between them are equally likely, about the loads of an even foundation. One column
    per statically indeterminate load, zero where the weight acts outside all triples; continuous in the masses. Shape
    (P, 0) for three points, and for feet of groups and cells, which yield.
    """
    points = torch.nonzero(model.is_contact & (not model.stands_on_feet)).flatten()
    basis = torch.cat([torch.ones(len(points), 1, dtype=torch.float64), model.particles[points]], 1)
    rank = int(torch.linalg.matrix_rank(basis)) if len(points) else 0
    spread = torch.zeros(len(mass), len(points) - rank, dtype=torch.float64)
    if spread.shape[1] == 0:
        return spread
    weight = mass * GRAVITY
    wanted = torch.cat([weight.sum()[None], weight @ model.particles])
    middle = rigid_loads(model, mass, GripperLoad.none(model))[0, points]
    size = (basis[:, 1:].amax(0) - basis[:, 1:].amin(0)).prod()
    differences = []
    for three in combinations(range(len(points)), 3):
        corners = basis[list(three)]
        if torch.linalg.det(corners).abs() > 1e-6 * size:
            loads = torch.zeros_like(middle)
            loads[list(three)] = torch.linalg.solve(corners.T, wanted)
            differences += [loads - middle] if bool((loads >= 0).all()) else []
    if differences:
        free = torch.linalg.svd(basis)[0][:, rank:]
        within = torch.stack(differences) @ free / len(differences) ** 0.5
        squares, axes = torch.linalg.eigh(within.T @ within)
        spread[points] = free @ (axes * squares.clamp(min=0).sqrt()) @ axes.T
    return spread


@dataclass(frozen=True, eq=False)
class Springs:
    """Loads of groups joined by springs, from own weight (share 0) to one rigid body (share 1).

    All groups share one tilt on a foundation of even stiffness, and each has a height of its own, which springs of
    equal stiffness pull towards those of its neighbors. Springs reduce a pattern of load by 1 / (1 + r w), with r their
    stiffness over that of the foundation and w the weight of the pattern.
    """

    span: Float[Tensor, "P r"]
    """Orthonormal basis of the foundation's loads: a height of each group, and one tilt."""
    patterns: Float[Tensor, "P J"]
    """Orthonormal patterns of load that one rigid body does not have."""
    weight: Float[Tensor, "J"]
    """Work of the springs in each pattern, over its mean."""

    @staticmethod
    def of(model: ParticleModel, neighbors: Sequence[tuple[int, int]]) -> Springs:
        """Springs between mass groups.

        Args:
            model: particles of the object.
            neighbors: pairs of mass groups that a spring joins.
        """
        count, feet = len(model.parts), model.contact
        groups = torch.nn.functional.one_hot(model.mass_group, count).double()
        sinks = torch.cat([groups, model.particles], 1) * feet[:, None]
        # rows of zeros keep all moves where there are fewer feet than moves
        padded = torch.nn.functional.pad(sinks, (0, 0, 0, count + 2))
        sink, size, moves = torch.linalg.svd(padded, full_matrices=False)
        ends = torch.zeros(len(neighbors), count + 2, dtype=torch.float64)
        for spring, (a, b) in enumerate(neighbors):
            ends[spring, a], ends[spring, b] = 1.0, -1.0
        stretch = ends @ moves.T
        rank = int((size > 1e-9 * size[0]).sum())
        # moves that sink no foot relax the springs: a straight row of feet may tilt across itself
        free = torch.linalg.qr(stretch[:, rank:])[0]
        stretch = (stretch - free @ (free.T @ stretch))[:, :rank] / size[:rank]
        work, axes = torch.linalg.eigh(stretch.T @ stretch)
        kept = work > 1e-9 * work[-1]
        weight = work[kept]
        span = sink[: len(sinks), :rank]
        return Springs(span, span @ axes[:, kept], weight / weight.mean())

    def joined(self, load: Float[Tensor, "P"], share: Float[Tensor, ""]) -> Float[Tensor, "P"]:
        """Loads at a share r / (1 + r) of springs, N, linear in the share below 0 and above 1.

        Args:
            load: loads without springs, N.
            share: share of springs.
        """
        within = share.clamp(0.0, 1.0)
        taken = within * self.weight / (1 - within + within * self.weight)
        taken = taken + (share - within) * torch.where(share < 0, self.weight, 1 / self.weight)
        own_tilt = load - self.span @ (self.span.T @ load)  # of groups that tilt by themselves
        return load - self.patterns @ (taken * (self.patterns.T @ load)) - share * own_tilt


@dataclass(frozen=True, eq=False)
class Support:
    """Loads of a support model, linear in the masses and the gripper's load."""

    per_mass: Float[Tensor, "K P n_m"]
    """Load of each particle per kg of each group's particle mass, N/kg."""
    response: Float[Tensor, "K P 3"]
    """Change of each load with the gripper's lift, N/N, and moment, N/(N m)."""

    @staticmethod
    def of(
        name: str,
        model: ParticleModel,
        lever: Float[Tensor, "K P 2"],
        held: Int[Tensor, "K 2"],
        *,
        balanced: bool = False,
    ) -> Support:
        """Loads of an entry of `LOADS`.

        Args:
            name: support model.
            model: particles of the object.
            lever: position of each particle from the grasp point, m.
            held: mass groups under the two pads.
            balanced: as in `GripperLoad`.
        """
        count, loads_of = len(lever), LOADS[name]

        def loads(mass: Tensor, carried: Tensor) -> Tensor:
            load = GripperLoad(carried[0].expand(count), carried[1:].expand(count, 2), held, lever, balanced)
            return loads_of(model, mass, load)

        none, weightless = torch.zeros(3, dtype=torch.float64), torch.zeros(len(model.particles), dtype=torch.float64)
        per_mass = [loads(mass, none).expand(count, -1) for mass in model.parts]
        response = [loads(weightless, one) for one in torch.eye(3, dtype=torch.float64)]
        return Support(torch.stack(per_mass, -1), torch.stack(response, -1))


SupportModel = Literal["own_weight", "rigid"]
JoinedSupport = Literal["own_weight", "rigid", "springs"]
"""Support models of the posterior; `springs` between the groups have an unknown stiffness."""
LoadsOf = Callable[[ParticleModel, Tensor, GripperLoad], Tensor]
"""Loads [N], (K, P), from particle masses [kg], (P,), and the gripper's load."""
ASSUMPTION: dict[JoinedSupport, str] = {
    "own_weight": "every mass group rests on its own weight",
    "rigid": "the object is one rigid body",
    "springs": "springs of equal stiffness join the mass groups",
}
"""Assumption of each support model, in words."""
ERRORS: dict[str, ModelErrors] = {"own_weight": ModelErrors(), "rigid": RIGID, "springs": RIGID}
"""Errors of the model under each."""
LOADS: dict[str, LoadsOf] = {"own_weight": own_weight_loads, "rigid": rigid_loads}


def _shrinkage(scatter: np.ndarray, error: np.ndarray, count: int, least: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shrinkage factor of a scatter over `count` values, 1 without sensor error, and standard deviation without it."""
    real = np.maximum(scatter - (1 + 2 * np.sqrt(2 / count)) * error, least**2)
    return np.where(error > 0, real / np.maximum(real + error, 1e-300), 1.0), np.sqrt(real)
