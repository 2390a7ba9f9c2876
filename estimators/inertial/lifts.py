"""Equations of the inertial parameters from simulated or recorded lifts, in the object frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float

from estimators.inertial.equations import InertialEquations, compressed_rows, joined
from estimators.inertial.parts import column_parts
from estimators.particles.lifts import LiftErrors, lift_covariance, lifts_among
from estimators.wrench.air import Air, Matter, nominal
from estimators.wrench.setup import stated_sizes
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.sensing.lift_windows import LiftWindow
from testbed.trajectory import Trajectory

ROUNDS = 2
"""Rounds of solving for the parameters with which the errors scale."""


def lift_equations(
    shape: ObjectShape, trajectories: Sequence[Trajectory], errors: LiftErrors | None = None
) -> InertialEquations:
    """Equations of all lifts among some trajectories, in the object frame with z from the object's bottom.

    Every window is weighted by its own noise; the bias of the tare and the walk of the sensor's zero are shared by the
    windows of a lift.

    Args:
        shape: geometry.
        trajectories: trials; all but lifts that ended well are left out.
        errors: errors of quantities assumed known; `height` is not used, since the height is estimated.

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
    equations = _equations(shape, trials, even, errors or LiftErrors())
    for _ in range(ROUNDS):
        scale, left = equations.scale, equations.values - equations.rows @ even
        found = even + np.linalg.pinv(equations.rows / scale, rcond=1e-6) @ left / scale
        equations = _equations(shape, trials, found, errors or LiftErrors())
    return equations


def _equations(
    shape: ObjectShape, trials: Sequence[Sequence[LiftWindow]], body: Float[np.ndarray, "10"], errors: LiftErrors
) -> InertialEquations:
    """Equations of all trials, with errors at the parameters `body`."""
    found, size = [], shape.per_group(np.ones(len(shape.particles)))
    for windows in trials:
        air = Air.of(shape, windows, lambda theta: Matter.of_vector(theta["body"]))
        sizes = stated_sizes(windows[0].setup, ("air", "reading"), trials=len(trials)) | errors.sizes(errors.sag)
        _, slopes = air.linearized(nominal({"body": torch.tensor(body)}, sizes))
        # for groups of masses in proportion to size
        if offset := windows[0].setup.particle_offset * len(trials) ** 0.5:
            slopes["parts"] = slopes["place"][..., :2]
            sizes["parts"] = torch.full((2,), offset * float(np.linalg.norm(size / size.sum())))
        covariance = lift_covariance(shape, windows, slopes, sizes, errors, float(body[0]))
        rows = slopes["body"].flatten(0, 1).numpy()
        found.append(compressed_rows(rows, np.concatenate([w.wrench for w in windows]), covariance))
    return joined(found)
