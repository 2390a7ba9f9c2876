"""Equations of the inertial parameters from simulated or recorded lifts, in the object frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from estimators.inertial.body import shift_map
from estimators.inertial.equations import InertialEquations, compressed_rows, joined, regressor
from estimators.inertial.parts import column_parts
from estimators.particles.lifts import (
    SHIFT,
    LiftErrors,
    LiftSlopes,
    along_tilts,
    creep_covariance,
    lift_covariance,
    lifts_among,
    setup_columns,
    slope_of_turn,
)
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.sensing.lift_windows import LiftWindow
from testbed.trajectory import Trajectory

ROUNDS = 2
"""Rounds of solving for the parameters by which the errors are weighed."""


def lift_equations(
    shape: ObjectShape, trajectories: Sequence[Trajectory], errors: LiftErrors | None = None
) -> InertialEquations:
    """Equations of all lifts among some trajectories: object frame, z from the object's bottom.

    Every window is weighed by its own noise, with the bias of its tare and the walk of the sensor's zero shared by the
    windows of a lift.

    Args:
        shape: geometry; of its groups, how far they may be from where they were told, as the setup states it.
        trajectories: lifts that ended well are read, all others left out.
        errors: errors of what is taken as known; that of `height` is not used, as the height is an answer.

    Raises:
        InvalidValueError: no lift, or a grasp that the shape does not have.
    """
    trials = list(lifts_among(shape, trajectories).values())
    if not trials:
        raise InvalidValueError("trajectories", f"{len(trajectories)}, no lift", "one or more lifts that ended well")
    pull, force = (
        np.concatenate([[value(w) for w in windows] for windows in trials])
        for value in (lambda w: w.pull, lambda w: w.wrench[:3])
    )
    even = np.sum([part.vector * part.mass for part in column_parts(shape)], axis=0) / shape.n_m
    even *= (pull.ravel() @ force.ravel()) / (pull.ravel() @ pull.ravel())
    found = even
    equations = _equations(shape, trials, found, errors)
    for _ in range(ROUNDS):
        scale = np.linalg.norm(equations.rows, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        left = equations.values - equations.rows @ even
        found = even + np.linalg.pinv(equations.rows / scale, rcond=1e-6) @ left / scale
        equations = _equations(shape, trials, found, errors)
    return equations


def _equations(
    shape: ObjectShape, trials: Sequence[Sequence[LiftWindow]], body: np.ndarray, errors: LiftErrors | None
) -> InertialEquations:
    """Equations of all trials, their errors weighed by some parameters."""
    return joined([_of_trial(shape, windows, body, errors or LiftErrors(), len(trials)) for windows in trials])


def _of_trial(
    shape: ObjectShape, windows: Sequence[LiftWindow], body: Float[np.ndarray, "10"], errors: LiftErrors, trials: int
) -> InertialEquations:
    about_tcp, still = _regressors(windows), _regressors(windows, moving=False)
    grasp = shape.grasps[windows[0].grasp].position
    tcp = np.array([*grasp, windows[0].tcp_height])
    rows = about_tcp @ shift_map(tcp)
    by_shift = np.column_stack(
        [
            about_tcp @ (shift_map(tcp - SHIFT * axis) - shift_map(tcp + SHIFT * axis)) @ body / (2 * SHIFT)
            for axis in np.eye(3)
        ]
    )
    by_turn = slope_of_turn(lambda angle: _regressors([w.turned(angle) for w in windows]) @ shift_map(tcp) @ body)
    late = _regressors([w.changing() for w in windows], moving=False) @ shift_map(tcp) @ body
    placed = shift_map(tcp) @ body
    tilted = along_tilts(windows, lambda window: _regressors([window], moving=False) @ placed)
    size = shape.per_group(np.ones(len(shape.particles)))
    parts = float(np.linalg.norm(size / size.sum())) * by_shift[:, :2]  # with as much mass as they are large
    slopes = LiftSlopes(by_shift[:, :2], by_turn, parts, late, tilted)
    of_setup = setup_columns(windows, rows @ body, slopes, trials)
    crept = creep_covariance(windows, by_shift * [errors.creep, errors.creep, errors.slip])
    by_shift *= [errors.grip, errors.grip, errors.sag]
    inertial = errors.inertia * (rows - still @ shift_map(tcp)) @ body
    effects = np.column_stack([by_shift, inertial, errors.gain * rows @ body, of_setup])
    covariance = lift_covariance(shape, windows, effects, errors.wrench, float(body[0])) + crept
    return compressed_rows(rows, np.concatenate([w.wrench for w in windows]), covariance)


def _regressors(windows: Sequence[LiftWindow], *, moving: bool = True) -> Float[np.ndarray, "R 10"]:
    """Wrenches about the TCP a unit of each parameter, R = 6 K; not `moving`, of pull alone."""
    pull, spin_rate, products = (
        np.array([value(w) for w in windows])
        for value in (lambda w: w.pull, lambda w: w.angular_acceleration, lambda w: w.spin_products)
    )
    return regressor(pull, moving * spin_rate, moving * products).reshape(6 * len(windows), -1)
