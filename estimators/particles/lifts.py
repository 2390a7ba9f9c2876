"""Masses from lifts: in the air the wrench is linear in them, with no friction between.

Held still, the object shows M and c; rocked, the second moments about the TCP: six numbers with x, y and z of their
own, where turns on the table show four.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from estimators.particles.setup_effects import FULL_SCALE
from testbed.actions.lift import Lift
from testbed.frames import rotate_wrench, rotation_z
from testbed.objects.model import GRAVITY, ObjectShape
from testbed.sensing.lift_windows import LiftWindow, lift_windows
from testbed.sensing.windows import reduced_trials
from testbed.trajectory import Trajectory

ROUNDS = 2
"""Rounds of solving for the masses by which the errors are weighed."""
SHIFT = 1e-3
"""Step of the derivative in the object's place in the grip, m."""
TURN = 1e-3
"""Step of the derivative in its angle there, rad."""


@dataclass(frozen=True)
class LiftErrors:
    """Errors of what is taken as known of a lifted object; one draw a trial, unless noted otherwise."""

    grip: float = 5e-4
    """Place of the object between the pads, along x and along y, m."""
    sag: float = 1e-3
    """Height of the TCP over the object's bottom: it lies on felt, and sinks between the pads, m."""
    slip: float = 1e-3
    """Way that it creeps down between the pads from the first window to the last, m, one step after another."""
    creep: float = 4e-4
    """The same along x and along y."""
    height: float = 0.25
    """Height of the center of mass, as a part of the object's: the tilts show it themselves."""
    inertia: float = 0.005
    """Wrench of the acceleration, as a part of itself."""
    gain: float = 3e-4
    """All wrenches, as a part of themselves."""
    wrench: float = 3e-4
    """Each window's own wrench, as a part of the weight, and of the weight at the particles' mean distance."""


class LiftSlopes(NamedTuple):
    """Changes of the wrenches of one trial's K windows by a guess of the masses, R = 6 K."""

    place: Float[np.ndarray, "R 2"]
    """With the object's place along x and y in the grip [N, N m a m]."""
    angle: Float[np.ndarray, "R"]
    """With its angle there [N, N m a rad]."""
    parts: Float[np.ndarray, "R p"]
    """With the places of its parts on it along x or y [N, N m a m]."""
    late: Float[np.ndarray, "R"]
    """With time [N/s, N m/s]."""
    tilted: Float[np.ndarray, "R 2"]
    """With a tilt of the table about its x and its y [N, N m a rad]."""


@dataclass(frozen=True, eq=False)
class LiftedRows:
    """Linear equations of all lifts for the masses: rows a with a m = y, independent and of unit error."""

    rows: Float[np.ndarray, "r n_m"]
    values: Float[np.ndarray, "r"]


def lifted_rows(
    shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory], errors: LiftErrors | None = None
) -> LiftedRows:
    """Equations of the lifts among some trajectories.

    Args:
        shape: geometry and groups.
        weight: M, kg; by it alone the errors are weighed at first.
        trajectories: lifts that ended well are read, all others left out.
        errors: errors of what is taken as known.

    Raises:
        InvalidValueError: a grasp that the shape does not have.
    """
    trials = list(lifts_among(shape, trajectories).values())
    if not trials:
        return LiftedRows(np.empty((0, shape.n_m)), np.empty(0))
    even = np.full(shape.n_m, weight / len(shape.particles))
    known = _compressed(shape, trials, even, errors)
    for _ in range(ROUNDS):
        fitting = even + np.linalg.pinv(known.rows) @ (known.values - known.rows @ even)
        known = _compressed(shape, trials, fitting, errors)
    return known


def lifts_among(shape: ObjectShape, trajectories: Sequence[Trajectory]) -> dict[int, list[LiftWindow]]:
    """Windows of every lift among some trajectories that ended well, by its place among them.

    Raises:
        InvalidValueError: a grasp that the shape does not have.
    """
    return reduced_trials(shape, trajectories, (Lift,), lift_windows)


def _compressed(
    shape: ObjectShape, trials: Sequence[Sequence[LiftWindow]], mass: np.ndarray, errors: LiftErrors | None
) -> LiftedRows:
    """All windows' rows as the fewest of the same content, their errors weighed by some masses."""
    whitened = [lift_information(shape, windows, mass, errors, len(trials)) for windows in trials]
    rows, values = np.vstack([r for r, _ in whitened]), np.concatenate([v for _, v in whitened])
    left, strength, right = np.linalg.svd(rows, full_matrices=False)
    seen = strength > 1e-6 * strength[0]
    return LiftedRows(strength[seen, None] * right[seen], left[:, seen].T @ values)


def lift_information(
    shape: ObjectShape,
    windows: Sequence[LiftWindow],
    mass: Float[np.ndarray, "n_m"],
    errors: LiftErrors | None = None,
    trials: int = 1,
) -> tuple[Float[np.ndarray, "R n_m"], Float[np.ndarray, "R"]]:
    """Rows and values of one trial's K windows, R = 6 K, independent and of unit error.

    Args:
        shape: geometry and groups.
        windows: windows of one trial.
        mass: particle masses by which the errors are weighed, kg.
        errors: errors of what is taken as known.
        trials: lifts that are known together.
    """
    errors = errors or LiftErrors()

    def maps(shift: np.ndarray | None = None, *, moving: bool = True, turn: float = 0.0) -> np.ndarray:
        motion = [window.turned(turn) for window in windows] if turn else windows
        return np.vstack([wrench_of_mass(shape, window, shift, moving=moving) for window in motion])

    moved = maps()
    by_group = [(maps(SHIFT * axis) - maps(-SHIFT * axis)) * mass / (2 * SHIFT) for axis in np.eye(3)]
    by_shift = np.column_stack([each.sum(axis=1) for each in by_group])
    by_turn = slope_of_turn(lambda angle: maps(turn=angle) @ mass)
    late = np.concatenate([wrench_of_mass(shape, w, moving=False) @ mass for w in map(LiftWindow.changing, windows)])
    tilted = along_tilts(windows, lambda window: wrench_of_mass(shape, window, moving=False) @ mass)
    slopes = LiftSlopes(by_shift[:, :2], by_turn, np.hstack(by_group[:2]), late, tilted)
    of_setup = setup_columns(windows, moved @ mass, slopes, trials)
    crept = creep_covariance(windows, by_shift * [errors.creep, errors.creep, errors.slip])
    by_shift *= [errors.grip, errors.grip, errors.height * shape.height]
    inertial = errors.inertia * (moved - maps(moving=False)) @ mass
    upright = _upright_columns(shape, windows, float(mass @ shape.particles_per_group))
    common = np.column_stack([by_shift, inertial, errors.gain * moved @ mass, of_setup, upright])
    covariance = lift_covariance(shape, windows, common, errors.wrench, float(mass @ shape.particles_per_group))
    root = np.linalg.cholesky(covariance + crept)
    return np.linalg.solve(root, moved), np.linalg.solve(root, np.concatenate([w.wrench for w in windows]))


def creep_covariance(windows: Sequence[LiftWindow], steps: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "R R"]:
    """Covariance of a creep of the object in the grip: a random walk from the first of one trial's K windows, R = 6 K.

    Args:
        windows: windows of the trial.
        steps: change of each wrench with one standard deviation of the whole way, along x, y and z.
    """
    middle = np.array([w.since_tare.mean() for w in windows])
    gone = np.repeat((middle - middle[0]) / max(middle[-1] - middle[0], 1e-9), 6)
    return steps @ steps.T * np.minimum(gone[:, None], gone)


def _upright_columns(shape: ObjectShape, windows: Sequence[LiftWindow], weight: float) -> Float[np.ndarray, "R e"]:
    """Effect of second moments with height where cells are not full, so that nobody knows where in them matter is.

    One standard deviation each: of the sum of m z^2, that of a full cell; of those of m x z and m y z, as if height
    went half with place.

    Args:
        shape: geometry.
        windows: windows of one trial.
        weight: M, kg.
    """
    if (shape.fill == 1).all():
        return np.zeros((6 * len(windows), 0))
    reach = float(np.sqrt(np.square(shape.particles - shape.particles.mean(axis=0)).sum(axis=1).mean()))
    high, leaning = weight * shape.height**2 / 12, weight * reach * shape.height / (2 * 12**0.5)
    columns = []
    for window in windows:
        x, y, z = window.angular_acceleration
        about = np.array([[high * x, high * y, 0], [-leaning * z, 0, -leaning * x], [0, -leaning * z, -leaning * y]])
        columns.append(np.vstack([np.zeros((3, 3)), about.T]))
    return np.vstack(columns)


def slope_of_turn(wrench: Callable[[float], np.ndarray]) -> Float[np.ndarray, "R"]:
    """Change of the wrenches (R = 6 K) of an object with its angle in the grip, N and N m a rad.

    Args:
        wrench: wrenches of a motion in axes that are turned about z by an angle, rad.
    """
    ahead, behind = (rotate_wrench(rotation_z(angle), wrench(angle).reshape(-1, 6)).ravel() for angle in (TURN, -TURN))
    return (ahead - behind) / (2 * TURN)


def setup_columns(
    windows: Sequence[LiftWindow],
    wrench: Float[np.ndarray, "R"],
    slopes: LiftSlopes,
    trials: int,
) -> Float[np.ndarray, "R e"]:
    """Effect on one trial's K windows of one standard deviation of each error of the setup, as stated; R = 6 K.

    An error that n trials share counts root n times in each, where they are taken as independent.

    Args:
        windows: windows of the trial.
        wrench: their wrenches by a guess of the masses.
        slopes: changes of these.
        trials: trials that are known together.
    """
    setup, shared = windows[0].setup, trials**0.5
    if setup.none:
        return np.zeros((len(wrench), 0))
    place, angle = (
        math.hypot(setup.grasp_offset, shared * setup.tcp_offset),
        math.hypot(setup.grasp_angle, shared * setup.tcp_angle),
    )
    of_sensor = []
    for window, each, rate in zip(windows, wrench.reshape(-1, 6), slopes.late.reshape(-1, 6), strict=True):
        felt = np.linalg.solve(window.from_sensor, each) + window.tool
        other = FULL_SCALE.numpy()[:, None] / FULL_SCALE.numpy() * felt * (1 - np.eye(6))  # to, from
        crossed = np.concatenate([np.diag(column) for column in other.T], axis=1)
        turned = np.hstack([np.cross(np.eye(3), felt[:3]), np.cross(np.eye(3), felt[3:])]).T
        heavier = window.tool[:, None] * (setup.tool_mass / window.tool_mass if window.tool_mass else 0.0)
        aside = setup.tool_com * np.vstack([np.zeros((3, 3)), np.cross(np.eye(3), window.tool[:3]).T])
        columns = [setup.gain * np.diag(felt), setup.crosstalk * crossed, setup.mounting_angle * turned, heavier, aside]
        behind = setup.delay * (window.from_sensor @ window.tool_rate + rate)[:, None]
        of_sensor.append(shared * np.hstack([window.from_sensor @ np.hstack(columns), behind]))
    tool = np.vstack([window.from_sensor @ window.tool_tilt.T for window in windows])
    of_table = shared * setup.table_tilt * (slopes.tilted + tool)
    of_parts = shared * setup.particle_offset * slopes.parts
    return np.column_stack([place * slopes.place, angle * slopes.angle, np.vstack(of_sensor), of_table, of_parts])


def along_tilts(
    windows: Sequence[LiftWindow], wrench: Callable[[LiftWindow], Float[np.ndarray, "6"]]
) -> Float[np.ndarray, "R 2"]:
    """Change of an object's wrenches with a tilt of the table about its x and its y, N and N m a rad; R = 6 K.

    Args:
        windows: windows of the trial.
        wrench: wrench of a window's pull.
    """
    return np.column_stack([np.concatenate([wrench(w.tilting(axis)) for w in windows]) for axis in (0, 1)])


def lift_covariance(
    shape: ObjectShape,
    windows: Sequence[LiftWindow],
    common: Float[np.ndarray, "R e"],
    own: float,
    weight: float,
) -> Float[np.ndarray, "R R"]:
    """Covariance of all wrenches of one trial's K windows, R = 6 K.

    Args:
        shape: geometry.
        windows: windows of one trial.
        common: effect of one standard deviation of each error that all windows share.
        own: `LiftErrors.wrench`.
        weight: M, kg.
    """
    size = own * GRAVITY * weight
    lever = np.linalg.norm(shape.particles - shape.grasps[windows[0].grasp].position, axis=1).mean()
    each = np.diag(np.tile(np.square([size] * 3 + [size * lever] * 3), len(windows)))
    return _sensor_covariance(windows) + common @ common.T + each


def wrench_of_mass(
    shape: ObjectShape, window: LiftWindow, shift: Float[np.ndarray, "3"] | None = None, *, moving: bool = True
) -> Float[np.ndarray, "6 n_m"]:
    """Wrench of a window a kg of each particle mass, N and N m: every particle a brick of its cell.

    Args:
        shape: geometry and groups.
        window: motion of the object.
        shift: shift of the object in the grip, m, object axes.
        moving: with the wrench of the turning, else of gravity and the TCP's own acceleration alone.
    """
    grasp = shape.grasps[window.grasp].position
    middle = np.full(len(shape.particles), shape.height / 2 - window.tcp_height)
    lever = np.column_stack([shape.particles - grasp, middle]) + (np.zeros(3) if shift is None else shift)
    force, torque = np.tile(window.pull, (len(lever), 1)), np.zeros(3)
    if moving:
        spin = window.spin_products
        force = force + np.cross(window.angular_acceleration, lever)
        force = force + lever @ (spin - np.trace(spin) * np.eye(3))
        across, upright = (shape.cell**2 + shape.height**2) / 12, shape.cell**2 / 6
        brick = np.array([across, across, upright])
        gyroscopic = (upright - across) * np.array([spin[1, 2], -spin[0, 2], 0.0])
        torque = brick * window.angular_acceleration + gyroscopic
    each = np.hstack([force, np.cross(lever, force) + torque])
    return shape.per_group(each.T)


def _sensor_covariance(windows: Sequence[LiftWindow]) -> Float[np.ndarray, "R R"]:
    """Covariance of all windows' wrenches: each one's noise, the tare's bias in all, and the walk of the zero since."""
    count = len(windows)
    begin, end = np.array([w.since_tare for w in windows]).T
    middle = (begin + end) / 2
    walked = np.minimum(middle[:, None], middle)
    np.fill_diagonal(walked, begin + (end - begin) / 3)
    covariance = np.kron(np.ones((count, count)), windows[0].bias_covariance)
    covariance += np.kron(walked, windows[0].drift_covariance)
    for k, window in enumerate(windows):
        covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += window.covariance
    return covariance
