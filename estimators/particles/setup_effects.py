"""Errors of wrenches on the table, linear about none: of the setup, of the hand's motion and of the cameras.

Each error is normal with its stated standard deviation. Whitening by their covariance marginalizes all of them: the
data decide where they can, error bars hold the rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.particles.links import UNEVEN, resting
from estimators.particles.windows import Observations
from estimators.wrench.jacobian import Slopes, Theta, Window, linearized, zeros
from estimators.wrench.model import ParticleModel, turned
from estimators.wrench.sensor import flawed, turned_wrench
from estimators.wrench.setup import stated_sizes
from estimators.wrench.table import Table
from testbed.worlds.setup_errors import PARAMETERS, SetupErrors

SHARES = 2.0
"""Sum of squared shares of the load of n points, times n: 1 if all carry the same. Ours, of three to eight, uneven."""
MOST_POINTS = 64
"""Points at which the pattern of contact under a group is taken."""
SLOW = 1e-3
"""Speed at which a foot of a pushed object may drag half of its friction less, or another way, m/s: nothing keeps the
center of rotation off a point of contact, and there it sticks. Ours."""
BY_TRIAL = tuple(name for name, each in PARAMETERS.items() if each.scope == "trial")
"""Kinds that are drawn anew in every trial; all others are the same in all."""

Columns = dict[str, Float[Tensor, "R n"]]


@dataclass(frozen=True, eq=False)
class LinearRows:
    """Wrenches, and torques about hinges, of K windows as linear functions of everything that may err."""

    model: ParticleModel
    points: Float[Tensor, "P C 2"]
    """Points at which a particle touches, as in `Table`."""
    lever: Float[Tensor, "K P 2"]
    """Mean place of each particle from the grasp point, m."""
    drag: Float[Tensor, "K P"]
    """Friction of each particle, at which the rows are linear, N."""
    slopes: Slopes
    """Derivatives in the unknowns of `Table`. Besides, changes by one standard deviation: `lead`; `links_seen`;
    `idle`, of particles so slow that they drag any way; and `anisotropy_square`, of its squares and product."""

    @staticmethod
    def of(
        windows: Observations,
        table: Table,
        mass: Float[Tensor, "P"],
        drag: Float[Tensor, "P"] | Float[Tensor, "K P"],
        lead: float,
        setup: SetupErrors,
    ) -> LinearRows:
        """Rows of windows at some masses, kg, and friction of every particle, N.

        Args:
            windows: windows of constant speed or acceleration.
            table: their forward model.
            mass: mass of every particle, kg.
            drag: friction of every particle, N.
            lead: standard deviation of the time by which friction leads the motion, s.
            setup: errors of the setup, of which those of 0 are left out.
        """
        lever, pushed = table.lever, windows.seen.shape[-1] > 0
        table = (table.on_field if setup.place_friction else table).dragged(drag)
        drag, sizes = table.windows["drag"], _sizes(table.model, setup)
        shapes = {name: tuple(size.shape) for name, size in sizes.items()}
        theta = zeros(friction=table.points.shape[:2], **shapes)
        if pushed or windows.articulated:
            theta |= zeros(force=table.model.particles.shape)
        if windows.articulated:
            theta |= zeros(hinge_friction=(windows.hinges,))
        of_motion = zeros(twist=(3,), **({"seen": (windows.seen.shape[-1],)} if pushed else {}))
        spread = table.points.shape[1] > 1
        rows, slopes = table.linearized({"mass": mass} | theta | ({} if spread else of_motion))
        if spread:  # errors of the motion act on feet, each at one place: in the mean over a cell they would cancel
            slopes |= table.at_middles.linearized({"mass": mass} | of_motion)[1]
        if lead and not windows.articulated:
            slopes["lead"] = table.secant({"lead": torch.tensor(lead, dtype=torch.float64)})[..., None]
        if setup.anisotropy:
            mean_square = torch.tensor([3**0.5, 1.0, 3**0.5], dtype=torch.float64)  # roots, of a^2, a b and b^2
            slopes["anisotropy_square"] = table.bends("anisotropy", setup.anisotropy) * mean_square
        if windows.articulated:
            ways = torch.eye(table.windows["links_off"].shape[1], dtype=torch.float64)
            off = [table.rows({"mass": mass, "links_seen": way}) - rows for way in ways]
            slopes["links_seen"] = torch.stack(off, -1)
        if pushed or windows.articulated:
            idle = resting(windows, table) if windows.articulated else _stuck(windows, table)
            slopes["idle"] = slopes.pop("force") * (idle * drag).repeat_interleave(2, 1)[:, None]
        return LinearRows(table.model, table.points, lever, drag, slopes)

    def where(self, keep: Tensor) -> LinearRows:
        """Rows of windows that `keep` (K,) selects."""
        return self.like({name: value[keep] for name, value in self.by_window.items()})

    @property
    def by_window(self) -> dict[str, Tensor]:
        """Values with a row a window."""
        return self.slopes | {"lever": self.lever, "drag": self.drag}

    def like(self, by_window: dict[str, Tensor]) -> LinearRows:
        """Rows of such values."""
        slopes = {name: value for name, value in by_window.items() if name in self.slopes}
        return replace(self, slopes=slopes, lever=by_window["lever"], drag=by_window["drag"])

    @property
    def by_point(self) -> Float[Tensor, "K 3+H P C"]:
        """Derivatives in the friction of each point of contact."""
        return self.slopes["friction"].unflatten(-1, self.points.shape[:2])

    @property
    def by_particle(self) -> Float[Tensor, "K 3+H P"]:
        """Derivatives in the friction of each particle."""
        return self.by_point.mean(-1)

    @property
    def sum_of_drag(self) -> Float[Tensor, "K 3+H"]:
        """Sum over particles of the magnitudes of their drag along each row, N, N and N m, and N m about hinges."""
        one = torch.ones_like(self.drag)
        size = torch.cat([torch.stack([one, one, self.lever.norm(dim=-1)], 1), self.by_particle[:, 3:].abs()], 1)
        return (size @ self.drag[..., None])[..., 0]

    def motion(self, mass: Float[Tensor, "P"]) -> Float[Tensor, "K 3+H"]:
        """Inertial wrenches and hinge torques of particles of a `mass`, kg."""
        return self.slopes["mass"] @ mass


def by_row(columns: Float[Tensor, "K 3+H n"]) -> Float[Tensor, "R n"]:
    """Rows of the wrenches of all windows, then those of the hinges."""
    return torch.cat([columns[:, :3].flatten(0, 1), columns[:, 3:].flatten(0, 1)])


def setup_effects(
    windows: Observations,
    rows: LinearRows,
    to_wrench: Float[Tensor, "R 6K"],
    setup: SetupErrors,
) -> Columns:
    """Change of every measured wrench with one standard deviation of each error of the setup, by kind; R = 3 K + K H.

    Of a kind that is drawn anew in every trial, the columns hold for each trial by itself.

    Args:
        windows: windows of constant speed or acceleration.
        rows: their rows, linear in all errors of `setup`.
        to_wrench: map from errors of all six components of the windows, about the TCP, to those of their wrenches.
        setup: standard deviations; a kind of 0 has no columns.
    """
    found: Columns = {}
    name, uneven = unevenness(setup, rows.model)
    if uneven:
        found[name] = _contact_pattern(rows, uneven)
    for kind, size in _sizes(rows.model, setup).items():
        found[kind] = by_row(rows.slopes[kind] * size.flatten())
    if setup.anisotropy:
        found["anisotropy"] = torch.cat([found["anisotropy"], by_row(rows.slopes["anisotropy_square"])], 1)
    if setup.table_tilt and windows.articulated:  # the tool's weight goes out of turns there and back, not of drags
        found["table_tilt"] += setup.table_tilt * to_wrench @ windows.tool_tilt.transpose(1, 2).flatten(0, 1)
    return found | _sensed(windows, to_wrench, setup)


def shared_and_own(effects: Columns, windows: Observations) -> tuple[Float[Tensor, "R E"], Float[Tensor, "R R"]]:
    """Effects of the errors that all trials share, side by side, and covariance of those drawn anew in each."""
    rows = (3 + windows.hinges) * len(windows)
    none = torch.zeros(rows, 0, dtype=torch.float64)
    own = torch.cat([none, *(effects[kind] for kind in BY_TRIAL if kind in effects)], 1)
    together = windows.together[windows.of_row][:, windows.of_row]
    return torch.cat([none, *(c for kind, c in effects.items() if kind not in BY_TRIAL)], 1), own @ own.T * together


def _stuck(windows: Observations, table: Table) -> Float[Tensor, "K P"]:
    """Part of the drag of each particle of a push that may act any way, one standard deviation along each axis.

    Of one that is slower than `SLOW`, or than its speed errs by the camera: beyond that the error's effect is linear.
    """
    square = table.moved({}).velocity.square().sum(-1)
    place = windows.grasp[:, None] + table.lever
    of_camera = windows.seen[:, None, 3:5] + turned(place)[..., None] * windows.seen[:, None, 5:6]
    slow = SLOW**2 + of_camera.square().sum((2, 3))[:, None]
    return (slow / (square + slow)).mean(1) * windows.pushed[:, None]


def unevenness(setup: SetupErrors, model: ParticleModel) -> tuple[str, float]:
    """Error of the setup that makes the loads of a group's points of contact uneven, and by how much.

    Either unequal loads on known feet, or few points anywhere under a group. Balance decides the loads of a rigid
    body's points.

    Returns:
        Name of the error; and variance of a load, as a part of an even share, over the number of points, 0 if known.
    """
    if model.stands_on_feet:
        return "foot_load", setup.foot_load**2 * len(model.parts) / len(model.feet)
    unknown = setup.contact_points and not bool(model.is_contact.any())
    return "contact_points", SHARES / setup.contact_points if unknown else 0.0


def _sizes(model: ParticleModel, setup: SetupErrors) -> dict[str, Tensor]:
    """Standard deviations of the errors that change wrenches on the table."""
    return stated_sizes(setup, ("table",), len(model.parts), len(model.feet))


def _contact_pattern(rows: LinearRows, uneven: float) -> Float[Tensor, "R n"]:
    """Loads of the points of contact under each group, in one pattern for all trials.

    They carry the group's weight about its own center of mass, so only the part that is not affine in a point's place
    is drawn. For unknown points its variance is that over the area, divided by the number of points.
    """
    model, each, columns = rows.model, rows.by_point, []
    for group in range(int(model.mass_group.max()) + 1):
        inside = torch.nonzero((model.mass_group == group) & model.contact).flatten()
        if len(inside) == 0:
            continue
        load = rows.drag[:, inside].sum(-1)
        every = max(1, math.ceil(4 * len(inside) / MOST_POINTS))
        at = rows.points[inside].flatten(0, 1)[::every]
        affine = torch.linalg.qr(torch.cat([torch.ones(len(at), 1, dtype=torch.float64), at - at.mean(0)], 1))[0]
        own = each[:, :, inside].flatten(2)[..., ::every]
        rest = own - (own @ affine) @ affine.T
        rest[:, 3:] += UNEVEN * (own @ affine[:, 1:] @ affine[:, 1:].T)[:, 3:]
        columns.append(rest * load[:, None, None] * math.sqrt(uneven / len(at)))
    return by_row(torch.cat(columns, -1))


def _sensed(windows: Observations, to_wrench: Float[Tensor, "R 6K"], setup: SetupErrors) -> Columns:
    """Errors of the sensor that go with what it measures, and poses that come late."""
    sizes = stated_sizes(setup, ("reading",))
    if not sizes:
        return {}

    def read(theta: Theta, window: Window) -> Float[Tensor, "6"]:
        """Wrench about the TCP, by poses that come late by a delay of `theta`."""
        wrench = window["from_sensor"] @ flawed(theta, window["sensed"])
        if "delay" not in theta:
            return wrench
        return turned_wrench(theta["delay"] * window["spin"], wrench)

    spin = windows.twist[:, 2] * ~windows.pushed
    fields = {"from_sensor": windows.from_sensor, "sensed": windows.sensed, "spin": spin}
    slopes = linearized(read, zeros(**{name: tuple(size.shape) for name, size in sizes.items()}), fields)[1]
    return {name: to_wrench @ (slopes[name] * size.flatten()).flatten(0, 1) for name, size in sizes.items()}
