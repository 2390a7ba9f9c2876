"""Effects of an inexact setup on the measured wrenches: one column a nuisance parameter, linear about none.

Each parameter is normal with the standard deviation that the setup states. Whoever whitens by a covariance adds these
columns to it, and so marginalizes all of them: the data decide where they can, error bars hold the rest.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from estimators.particles.links import UNEVEN, HingeTorques, standing
from estimators.particles.model import ParticleModel, cross, inertia_of, rotate, turned
from estimators.particles.windows import Observations
from testbed.objects.model import GRAVITY
from testbed.worlds.parameters import FULL_SCALE
from testbed.worlds.setup_errors import PARAMETERS, SetupErrors

SHARES = 2.0
"""Sum of squared shares of the load of n points, times n: 1 if all carry the same. Ours, of three to eight, uneven."""
MOST_POINTS = 64
"""Points at which the pattern of contact under a group is taken."""
WAVELENGTHS = (0.06, 0.6)
"""Least and greatest wavelength of friction over a table, m. Ours: shorter ones average out under an object."""
REFERENCE = 0.02
"""Speed at which friction is the stated one, m/s."""
SMALL = 1e-4
"""Shift by which slopes are taken, m."""


def _waves(count: int) -> Float[Tensor, "n 2"]:
    """Wave vectors, rad/m, even in the logarithm of their length, each a golden angle on from the last."""
    least, most = map(math.log10, WAVELENGTHS)
    length = torch.logspace(least, most, count, dtype=torch.float64)
    way = torch.arange(count, dtype=torch.float64) * math.pi * (3 - 5**0.5)
    return 2 * math.pi / length[:, None] * torch.stack([torch.cos(way), torch.sin(way)], 1)


WAVES = _waves(48)
"""Waves of a table's friction."""

BY_TRIAL = tuple(name for name, each in PARAMETERS.items() if each.scope == "trial")
"""Kinds that are drawn anew in every trial; all others are the same in all."""

Columns = dict[str, Float[Tensor, "R n"]]


def setup_effects(
    windows: Observations,
    model: ParticleModel,
    mass: Float[Tensor, "P"],
    drag: Float[Tensor, "K P"],
    to_wrench: Float[Tensor, "R 6K"],
    pivot_error: float,
    setup: SetupErrors,
) -> Columns:
    """Change of every measured wrench with one standard deviation of each parameter, by kind; R = 3 K rows.

    Of an object in links the torques about its H hinges follow, R = 3 K + K H.

    Of a kind that is drawn anew in every trial, the columns hold for each trial by itself.

    Args:
        windows: windows of constant speed or acceleration.
        model: particles of the object.
        mass: their masses, kg.
        drag: friction of every particle, N.
        to_wrench: map from errors of all six components of the windows, about the TCP, to those of their wrenches.
        pivot_error: error of the center of a turn, m.
        setup: standard deviations; a kind of 0 has no columns.
    """
    found: Columns = {}
    rows = with_hinges(windows, model, windows.drag_rows(model, pivot_error)) * drag[:, None]  # (K, 3 + H, P)
    if setup.contact_points:
        found["contact_points"] = _contact_pattern(windows, model, drag, pivot_error, setup.contact_points)
    if setup.group_friction:
        found["group_friction"] = setup.group_friction * _by_group(model, rows)
    if setup.place_friction:
        found["place_friction"] = setup.place_friction * _place(windows, model, rows)
    if setup.anisotropy:
        found["anisotropy"] = _anisotropy(windows, model, rows, setup.anisotropy)
    if setup.speed_friction:
        decades = torch.log10(windows.particle_velocity(model).norm(dim=-1).clamp(1e-4, 1.0) / REFERENCE)
        found["speed_friction"] = setup.speed_friction * by_row((rows * decades[:, None]).sum(-1, keepdim=True))
    if setup.table_tilt:
        found["table_tilt"] = setup.table_tilt * _tilt(windows, model, mass, to_wrench)
    found |= _displacements(windows, model, mass, drag, pivot_error, setup)
    return found | _sensed(windows, to_wrench, setup)


def by_row(columns: Float[Tensor, "K 3+H n"]) -> Float[Tensor, "R n"]:
    """Rows of the wrenches of all windows, then those of the hinges."""
    return torch.cat([columns[:, :3].flatten(0, 1), columns[:, 3:].flatten(0, 1)])


def shared_and_own(effects: Columns, windows: Observations) -> tuple[Float[Tensor, "R E"], Float[Tensor, "R R"]]:
    """Effects of the errors that all trials share, side by side, and covariance of those drawn anew in each."""
    rows = (3 + windows.hinges) * len(windows)
    none = torch.zeros(rows, 0, dtype=torch.float64)
    own = torch.cat([none, *(effects[kind] for kind in BY_TRIAL if kind in effects)], 1)
    together = windows.together[windows.of_row][:, windows.of_row]
    return torch.cat([none, *(c for kind, c in effects.items() if kind not in BY_TRIAL)], 1), own @ own.T * together


def seen_effects(
    windows: Observations, model: ParticleModel, mass: Float[Tensor, "P"], slopes: Float[Tensor, "K 3 3"]
) -> tuple[Float[Tensor, "K 3 9"], Float[Tensor, "R R"]]:
    """Effects of a camera's errors on the wrenches of pushes, and the covariance of its delay, which a trial shares.

    A turned object turns the measured force in its axes, and a moved one takes the force elsewhere; the drag goes with
    the twist, and the inertia with the acceleration.

    Args:
        windows: windows of constant speed or acceleration; effects on a grip are zero.
        model: particles of the object.
        mass: their masses, kg.
        slopes: change of the drag with a window's twist about the grasp point.
    """
    if windows.seen.shape[-1] == 0:
        return slopes[..., :0], torch.zeros(3 * len(windows), 3 * len(windows), dtype=torch.float64)
    at, turn = windows.grasp[:, None], windows.seen[:, 2]  # (K, 1, 2), (K, 10)
    spin, alpha = windows.twist[:, 2:], windows.acceleration[:, 2:]
    of_origin = windows.twist[:, :2] - spin * turned(windows.grasp)
    pulled = windows.acceleration[:, :2] - alpha * turned(windows.grasp) + windows.spin_square[:, None] * windows.grasp

    def along(values: Tensor, rates: Tensor) -> Tensor:
        """Errors of a vector, (K, 10, 2), that is also turned with the object."""
        return values.transpose(1, 2) - turn[..., None] * turned(rates)[:, None]

    moved = -along(windows.seen[:, :2], torch.zeros_like(spin).expand(-1, 2)) - turn[..., None] * turned(at)
    velocity = along(windows.seen[:, 3:5], of_origin)
    rate, spun = windows.seen[:, 5, :, None], windows.seen[:, 8, :, None]
    drag = torch.cat([velocity + rate * turned(at), rate], -1) @ slopes.transpose(1, 2)
    whole, arms = inertia_of(model, mass), windows.lever(model)
    pull = along(windows.seen[:, 6:8], pulled)
    inertial = whole.mass * (pull + spun * turned(whole.com))
    about = (mass * (arms * model.particles).sum(-1)).sum(-1)[:, None]
    torque = whole.mass * cross(whole.com - at, pull) + about * spun[..., 0]
    force = windows.wrench[:, None, :2]
    measured = torch.cat([-turn[..., None] * turned(force), cross(moved, force)[..., None]], -1)
    found = measured - drag - torch.cat([inertial, torque[..., None]], -1)
    found = (found * windows.pushed[:, None, None]).transpose(1, 2)
    shared = found[..., -1]
    late = shared[:, :, None, None] * shared * windows.together[:, None, :, None]
    return found[..., :-1], late.reshape(3 * len(windows), -1)


def trial_by_trial(effects: Columns, windows: Observations) -> Columns:
    """The effects, with columns for every trial where an error is drawn anew in each."""
    trials = torch.nn.functional.one_hot(torch.unique(windows.trial, return_inverse=True)[1]).double()
    of_rows = trials[windows.of_row]
    return {
        kind: (columns[..., None] * of_rows[:, None]).flatten(1) if kind in BY_TRIAL else columns
        for kind, columns in effects.items()
    }


def with_hinges(
    windows: Observations, model: ParticleModel, rows: Float[Tensor, "K 3 P"], still: Tensor | None = None
) -> Float[Tensor, "K 3+H P"]:
    """Rows of wrenches and, of an object in links, of torques about those of its hinges that are not `still` (K, H)."""
    if not windows.articulated:
        return rows
    return torch.cat([rows, _torques(windows, model, still).rows], 1)


def _torques(windows: Observations, model: ParticleModel, still: Tensor | None = None) -> HingeTorques:
    weightless = torch.zeros(len(model.particles), dtype=torch.float64)
    return HingeTorques.of(windows, model, weightless, standing(windows) if still is None else still)


def _by_group(model: ParticleModel, rows: Float[Tensor, "K 3+H P"]) -> Float[Tensor, "R n_m"]:
    """Sums over mass groups."""
    return by_row(rows @ torch.nn.functional.one_hot(model.mass_group).double())


def _contact_pattern(
    windows: Observations, model: ParticleModel, drag: Float[Tensor, "K P"], pivot_error: float, points: float
) -> Float[Tensor, "R n"]:
    """Few points anywhere under each group, in place of its area, in one pattern for all trials.

    Their loads hold the group's weight about its own center of mass, so only what is not affine in a point's place
    is drawn: its variance over the area, over the number of points.
    """
    spread = model.spread
    rows = torch.stack([with_hinges(windows, each, windows.point_rows(each, pivot_error)) for each in spread], -1)
    places = torch.stack([each.particles for each in spread], 1)  # (P, 4, 2)
    columns = []
    for group in range(int(model.mass_group.max()) + 1):
        inside = torch.nonzero((model.mass_group == group) & model.contact).flatten()
        if len(inside) == 0:
            continue
        load = drag[:, inside].sum(-1)
        every = max(1, math.ceil(4 * len(inside) / MOST_POINTS))
        at = places[inside].flatten(0, 1)[::every]
        affine = torch.linalg.qr(torch.cat([torch.ones(len(at), 1, dtype=torch.float64), at - at.mean(0)], 1))[0]
        own = rows[:, :, inside].flatten(2)[..., ::every]
        rest = own - (own @ affine) @ affine.T
        rest[:, 3:] += UNEVEN * (own @ affine[:, 1:] @ affine[:, 1:].T)[:, 3:]
        columns.append(rest * load[:, None, None] * math.sqrt(SHARES / (points * len(at))))
    return by_row(torch.cat(columns, -1))


def _place(windows: Observations, model: ParticleModel, rows: Float[Tensor, "K 3+H P"]) -> Float[Tensor, "R n"]:
    """Friction as a smooth field of unit variance over the table, of waves of many lengths along many directions."""
    at = windows.poses[..., None, :2] + rotate(windows.poses[..., 2, None], windows.lever(model)[:, None])
    phase = at @ WAVES.T  # (K, S, P, n)
    field = torch.cat([torch.cos(phase), torch.sin(phase)], -1).mean(1) / len(WAVES) ** 0.5
    return by_row(torch.einsum("kip,kpn->kin", rows, field))


def _anisotropy(
    windows: Observations, model: ParticleModel, rows: Float[Tensor, "K 3+H P"], size: float
) -> Float[Tensor, "R 5"]:
    """Elliptic friction, more along one axis of the table by a part h and less across; along x or along a diagonal.

    f = -N A v / sqrt(v . A v), A = mu^2 (1 + H): with h s the turn of a unit u, a along it and p across, the force
    changes by h (a u + 2 p u') and by h^2 (p^2 u / 2 - 2 a p u'), which a strong anisotropy shows in short turns.

    Args:
        windows: windows of constant speed or acceleration.
        model: particles of the object.
        rows: drag of every particle, N and N m.
        size: standard deviation of h along each of the two.
    """
    drag = rows[:, :2].transpose(1, 2)  # N, object axes
    unit = drag / drag.norm(dim=-1, keepdim=True).clamp(min=1e-12)
    aside = turned(unit)
    twice = 2 * windows.poses[..., 2]
    cos, sin = torch.cos(twice)[..., None], torch.sin(twice)[..., None]  # (K, S, 1)
    u, v = unit[:, None].unbind(-1)
    even, odd = u * u - v * v, 2 * u * v
    a = torch.stack([cos * even - sin * odd, sin * even + cos * odd])  # of h along x and along the diagonal
    p = torch.stack([-cos * odd - sin * even, cos * even - sin * odd])
    pairs = ((0, 0, 3**0.5), (0, 1, 2.0), (1, 1, 3**0.5))  # root mean square of h_i h_j, both orders
    along = [size * a[0], size * a[1], *(size**2 * r / 2 * p[i] * p[j] for i, j, r in pairs)]
    across = [2 * size * p[0], 2 * size * p[1], *(-(size**2) * r * (a[i] * p[j] + a[j] * p[i]) for i, j, r in pairs)]
    both = torch.stack([torch.stack(along), torch.stack(across)]).mean(3)[..., None]  # (2, 5, K, P, 1)
    force = drag.norm(dim=-1, keepdim=True) * (both[0] * unit + both[1] * aside)
    torque = cross(windows.lever(model), force).sum(-1, keepdim=True)
    about = torch.cat([force.sum(2), torque, *_about_hinges(windows, model, force)], -1)
    return by_row(about.permute(1, 2, 0))


def _about_hinges(
    windows: Observations, model: ParticleModel, force: Float[Tensor, "... K P 2"]
) -> list[Float[Tensor, "... K H"]]:
    """Torques about the hinges of forces on all that trails; none of a rigid object."""
    if not windows.articulated:
        return []
    return [cross(_torques(windows, model).arm, force[..., None, :, :]).sum(-1)]


def _tilt(
    windows: Observations, model: ParticleModel, mass: Float[Tensor, "P"], to_wrench: Float[Tensor, "R 6K"]
) -> Float[Tensor, "R 2"]:
    """Pull of gravity along a tilted table, along either axis of it, on the object and on the tool.

    The tool's is counted of links, which turn one way: from turns there and back it goes out.
    """
    lever, columns = windows.lever(model), []
    for axis in torch.eye(2, dtype=torch.float64):
        along = rotate(-windows.poses[..., 2], axis.expand(*windows.poses.shape[:2], 2)).mean(1)
        pull = GRAVITY * mass[:, None] * along[:, None]
        torque = cross(lever, pull).sum(-1, keepdim=True)
        columns.append(torch.cat([pull.sum(1), torque, *_about_hinges(windows, model, pull)], -1))
    found = by_row(torch.stack(columns, -1))
    if not windows.articulated:
        return found
    return found + to_wrench @ windows.tool_tilt.transpose(1, 2).flatten(0, 1)


def _displacements(
    windows: Observations,
    model: ParticleModel,
    mass: Float[Tensor, "P"],
    drag: Float[Tensor, "K P"],
    pivot_error: float,
    setup: SetupErrors,
) -> Columns:
    """Particles elsewhere than told: each group's own, the object's in the hand by trial, the hand's."""
    told = (setup.particle_offset, setup.grasp_offset, setup.grasp_angle, setup.tcp_offset, setup.tcp_angle)
    if not any(told):
        return {}
    still = standing(windows) if windows.articulated else None

    def rows(windows: Observations, model: ParticleModel) -> Float[Tensor, "K 3+H P"]:
        return with_hinges(windows, model, windows.drag_rows(model, pivot_error), still) * drag[:, None]

    by = []
    for axis in torch.eye(2, dtype=torch.float64):
        ahead, behind = (rows(windows, model.moved(side * SMALL * axis)) for side in (1, -1))
        lever = windows.lever(model) @ axis
        spun = 2 * windows.acceleration[:, 2, None] * mass * lever  # of the moment of inertia
        by.append((ahead - behind) / (2 * SMALL) + pad(spun[:, None], (0, 0, 2, windows.hinges)))
    slopes = torch.stack(by, -1)  # (K, 3 + H, P, 2)
    if windows.articulated:  # all links go with the one in the hand

        def moved(x: float, y: float, yaw: float) -> Float[Tensor, "K 3+H"]:
            ahead, behind = (rows(windows.displaced(s * x, s * y, s * yaw), model) for s in (1, -1))
            return (ahead - behind).sum(-1) / (2 * SMALL)

        shifted = torch.stack([moved(SMALL, 0.0, 0.0), moved(0.0, SMALL, 0.0)], -1)
        yawed = moved(0.0, 0.0, SMALL)[..., None]
    else:
        shifted = slopes.sum(2)  # (K, 3, 2): the object along its axes
        yawed = torch.einsum("kipa,kpa->ki", slopes, turned(windows.lever(model)))[..., None]
    held = ~windows.pushed[:, None, None]  # of a push, the camera tells where the object is, whatever the hand
    in_hand = shifted @ windows.from_sensor[:, :2, :2]
    of_group = torch.einsum("kipa,pg->kiga", slopes, torch.nn.functional.one_hot(model.mass_group).double())
    columns = {
        "particle_offset": of_group.flatten(2),
        "grasp_offset": shifted * held,
        "grasp_angle": yawed * held,
        "tcp_offset": in_hand * held,
        "tcp_angle": yawed * held,
    }
    return {kind: size * by_row(columns[kind]) for kind, size in zip(columns, told, strict=True) if size}


def _sensed(windows: Observations, to_wrench: Float[Tensor, "R 6K"], setup: SetupErrors) -> Columns:
    """Errors of the sensor that go with what it measures, and poses that come late."""
    signal, eye = windows.sensed, torch.eye(6, dtype=torch.float64)
    errors = {}
    if setup.gain:
        errors["gain"] = setup.gain * torch.diag_embed(signal)
    if setup.crosstalk:
        full = torch.tensor(np.outer(FULL_SCALE, 1 / FULL_SCALE))
        other = full * signal[:, None] * (1 - eye)  # (K, to, from)
        errors["crosstalk"] = setup.crosstalk * torch.diag_embed(other.transpose(1, 2)).transpose(1, 2).flatten(2)
    if setup.mounting_angle:
        axes = torch.eye(3, dtype=torch.float64)
        both = [torch.linalg.cross(axis.expand(len(signal), 2, 3), signal.reshape(-1, 2, 3)) for axis in axes]
        errors["mounting_angle"] = setup.mounting_angle * torch.stack(both, -1).reshape(len(signal), 6, 3)
    errors = {kind: windows.from_sensor @ each for kind, each in errors.items()}
    if setup.delay:
        about = (windows.from_sensor @ signal[..., None])[..., 0]
        late = torch.zeros_like(about)
        for part in (slice(0, 2), slice(3, 5)):
            late[:, part] = turned(about[:, part]) * (windows.twist[:, 2:] * ~windows.pushed[:, None])
        errors["delay"] = setup.delay * late[..., None]
    return {kind: to_wrench @ each.reshape(6 * len(signal), -1) for kind, each in errors.items()}
