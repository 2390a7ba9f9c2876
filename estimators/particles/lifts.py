"""Masses from lifts: in the air the wrench is linear in them, with no friction between.

Held still, the object shows M and c; rocked, the second moments about the TCP: six numbers with x, y and z of their
own, where turns on the table show four.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from testbed.actions.lift import Lift
from testbed.objects.model import GRAVITY, ObjectShape
from testbed.sensing.lift_windows import LiftWindow, lift_windows
from testbed.sensing.windows import reduced_trials
from testbed.trajectory import Trajectory

ROUNDS = 2
"""Rounds of solving for the masses by which the errors are weighed."""
SHIFT = 1e-3
"""Step of the derivative in the object's place in the grip, m."""


@dataclass(frozen=True)
class LiftErrors:
    """Errors of what is taken as known of a lifted object; one draw a trial, unless noted otherwise."""

    grip: float = 5e-4
    """Place of the object between the pads, along x and along y, m."""
    sag: float = 1e-3
    """Height of the TCP over the object's bottom: it lies on felt, and sinks between the pads, m."""
    slip: float = 1e-3
    """Way that it creeps down between the pads from the first window to the last, m."""
    height: float = 0.25
    """Height of the center of mass, as a part of the object's: the tilts show it themselves."""
    inertia: float = 0.005
    """Wrench of the acceleration, as a part of itself."""
    gain: float = 3e-4
    """All wrenches, as a part of themselves."""
    wrench: float = 3e-4
    """Each window's own wrench, as a part of the weight, and of the weight at the particles' mean distance."""


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
    whitened = [lift_information(shape, windows, mass, errors) for windows in trials]
    rows, values = np.vstack([r for r, _ in whitened]), np.concatenate([v for _, v in whitened])
    left, strength, right = np.linalg.svd(rows, full_matrices=False)
    seen = strength > 1e-6 * strength[0]
    return LiftedRows(strength[seen, None] * right[seen], left[:, seen].T @ values)


def lift_information(
    shape: ObjectShape,
    windows: Sequence[LiftWindow],
    mass: Float[np.ndarray, "n_m"],
    errors: LiftErrors | None = None,
) -> tuple[Float[np.ndarray, "R n_m"], Float[np.ndarray, "R"]]:
    """Rows and values of one trial's K windows, R = 6 K, independent and of unit error.

    Args:
        shape: geometry and groups.
        windows: windows of one trial.
        mass: particle masses by which the errors are weighed, kg.
        errors: errors of what is taken as known.
    """
    errors = errors or LiftErrors()

    def maps(shift: np.ndarray | None = None, *, moving: bool = True) -> np.ndarray:
        return np.vstack([wrench_of_mass(shape, window, shift, moving=moving) for window in windows])

    moved = maps()
    by_shift = np.column_stack(
        [(maps(SHIFT * axis) @ mass - maps(-SHIFT * axis) @ mass) / (2 * SHIFT) for axis in np.eye(3)]
    )
    by_slip = errors.slip * by_shift[:, 2] * creep(windows)
    by_shift *= [errors.grip, errors.grip, errors.height * shape.height]
    inertial = errors.inertia * (moved - maps(moving=False)) @ mass
    common = np.column_stack([by_shift, by_slip, inertial, errors.gain * moved @ mass])
    covariance = lift_covariance(shape, windows, common, errors.wrench, float(mass @ shape.particles_per_group))
    root = np.linalg.cholesky(covariance)
    return np.linalg.solve(root, moved), np.linalg.solve(root, np.concatenate([w.wrench for w in windows]))


def creep(windows: Sequence[LiftWindow]) -> Float[np.ndarray, "R"]:
    """Part of a creep at each row of one trial's K windows, R = 6 K: 0 at the first, 1 at the last."""
    middle = np.array([w.since_tare.mean() for w in windows])
    return np.repeat((middle - middle[0]) / max(middle[-1] - middle[0], 1e-9), 6)


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
