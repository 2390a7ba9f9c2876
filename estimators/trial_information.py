"""What each trial alone would show, so that the information of any set of trials is a sum.

Two trials share some errors: the lift that a nulled gripper hides, the height of the TCP over the feet, and those of
the moments of inertia. With these as unknowns of their own, of unit spread beforehand, trials are independent and their
information adds; what is left once they are eliminated is that of `fisher.information_root`, exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.fisher import Question
from estimators.inertia import slope_variance
from estimators.lifted import lift_information
from estimators.mass_solve import inertia_map
from estimators.observations import Observations
from estimators.particle_loads import ParticleLoads
from estimators.planned import planned_observations
from estimators.planned_lift import planned_lift
from testbed.actions import Action, Lift, Weigh
from testbed.lift_reduction import LiftWindow
from testbed.objects import MassDistribution, ObjectShape
from testbed.sensing import Sensing

ROWS = 6
"""Of a trial; one with fewer has rows of zeros. None shows more: a lift M, c and three second moments."""
CHUNK = 512
"""Trials that are worked on at once."""


@dataclass(frozen=True, eq=False)
class TrialInformation:
    """Whitened rows of C trials, each in masses, frictions and shared errors: U = n_m + n_mu + 3 + J unknowns."""

    rows: Float[np.ndarray, "C ROWS U"]
    known: int
    """n_m + n_mu: the unknowns that are asked for come first."""

    def __len__(self) -> int:
        return len(self.rows)

    def information(self, chosen: Sequence[int] | None = None) -> Float[np.ndarray, "U U"]:
        """Of some of the trials together, or of all; a trial may be named more than once."""
        rows = self.rows if chosen is None else self.rows[list(chosen)]
        flat = rows.reshape(-1, self.rows.shape[-1])
        return flat.T @ flat


def shared_errors(shape: ObjectShape) -> int:
    """Number of errors that trials share: lift, height, all moments of inertia, and those about each grasp point."""
    return 3 + len(_points(shape))


def before_any_trial(shape: ObjectShape, weight_error: float) -> Float[np.ndarray, "U U"]:
    """Information of a weighing, and of shared errors that are of unit spread."""
    known = shape.n_m + shape.n_mu
    information = np.diag(np.concatenate([np.zeros(known), np.ones(shared_errors(shape))]))
    weighed = shape.particles_per_group / weight_error
    information[: shape.n_m, : shape.n_m] += np.outer(weighed, weighed)
    return information


def of_masses(information: Float[np.ndarray, "U U"], known: int) -> Float[np.ndarray, "known known"]:
    """Information of masses and frictions once the shared errors are eliminated."""
    across = information[:known, known:]
    return information[:known, :known] - across @ np.linalg.solve(information[known:, known:], across.T)


def planned_information(
    shape: ObjectShape,
    distribution: MassDistribution,
    actions: Sequence[Action],
    sensing: Sensing,
    question: Question,
) -> TrialInformation:
    """Of actions before they are done, a trial each, in their order.

    On own weight a lift teaches nothing: no block but the one that is gripped would come along.

    Args:
        shape: geometry and grasps.
        distribution: masses and frictions at which it is taken, true or guessed.
        actions: slides, turns and lifts.
        sensing: how the sensor errs.
        question: support model and stated errors.
    """
    moving = [action for action in actions if not isinstance(action, Weigh)]
    windows = planned_observations(shape, moving, sensing) if moving else None
    lifts = {
        index: planned_lift(action, sensing)
        for index, action in enumerate(moving)
        if isinstance(action, Lift) and question.support == "rigid"
    }
    return trial_information(shape, distribution, windows, len(moving), question, lifts)


def trial_information(
    shape: ObjectShape,
    distribution: MassDistribution,
    windows: Observations | None,
    count: int,
    question: Question,
    lifts: Mapping[int, Sequence[LiftWindow]] | None = None,
) -> TrialInformation:
    """Of trials by their windows, planned or felt.

    Args:
        shape: geometry and grasps.
        distribution: masses and frictions at which it is taken.
        windows: of all trials.
        count: number of trials; one without windows has rows of zeros.
        question: support model and stated errors.
        lifts: windows of the trials that are lifts, by the trial's number.
    """
    known = shape.n_m + shape.n_mu
    rows = np.zeros((count, ROWS, known + shared_errors(shape)))
    if windows is not None:
        trial = windows.trial.numpy()
        for accelerated in (False, True):
            of_kind = windows.accelerated.numpy() == accelerated
            sizes = np.bincount(trial[of_kind], minlength=count)
            for size in np.unique(sizes[sizes > 0]):
                chosen = np.flatnonzero(sizes == size)
                of_size = np.flatnonzero(of_kind & (sizes[trial] == size))
                fields = {
                    name: value[of_size].reshape(len(chosen), size, *value.shape[1:])
                    for name, value in vars(windows).items()
                }
                found = (
                    _accelerated_rows(shape, distribution, fields, question)
                    if accelerated
                    else _steady_rows(shape, distribution, fields, question)
                )
                rows[chosen, : found.shape[1]] = found
    for trial_number, in_air in (lifts or {}).items():
        found = _lifted_rows(shape, distribution, in_air)
        rows[trial_number, : len(found), : shape.n_m] = found
    return TrialInformation(rows, known)


def _steady_rows(
    shape: ObjectShape,
    distribution: MassDistribution,
    fields: dict[str, Tensor],
    question: Question,
) -> Float[np.ndarray, "C R U"]:
    """Of trials with as many steady windows each: the equations of one trial, mapped over all."""
    loads = ParticleLoads.of(shape, distribution, question.support)

    def of_trial(of_one: dict[str, Tensor]) -> Tensor:
        windows = Observations(**of_one)
        equations = loads.equations(windows, question.stated)
        root = torch.linalg.cholesky(equations.apart)
        felt_of = torch.cat([equations.q @ loads.slopes, equations.common], 1)
        return torch.linalg.solve_triangular(root, felt_of, upper=False)

    found = torch.vmap(of_trial, chunk_size=CHUNK)(fields).numpy()
    return np.pad(found, ((0, 0), (0, 0), (0, shared_errors(shape) - 2)))


def _accelerated_rows(
    shape: ObjectShape, distribution: MassDistribution, fields: dict[str, Tensor], question: Question
) -> Float[np.ndarray, "C 1 U"]:
    """I_j about the grasp point of every trial, by the slope of torque against acceleration."""
    points, known, error = _points(shape), shape.n_m + shape.n_mu, question.stated.inertia_error
    count = len(fields["trial"])
    rows = np.zeros((count, 1, known + shared_errors(shape)))
    for c in range(count):
        pivots, variance = slope_variance(Observations(**{name: value[c] for name, value in fields.items()}))
        of_mass = inertia_map(shape, pivots)[0]
        shared = error * of_mass @ distribution.mass
        point = int(np.linalg.norm(points - pivots[0], axis=1).argmin())
        rows[c, 0, : shape.n_m] = of_mass
        rows[c, 0, [known + 2, known + 3 + point]] = shared
        rows[c] /= np.sqrt(variance[0])
    return rows


def _lifted_rows(
    shape: ObjectShape, distribution: MassDistribution, windows: Sequence[LiftWindow]
) -> Float[np.ndarray, "R n_m"]:
    """Of a lift, as few rows as say the same; it shares no error with other trials."""
    if not windows:
        return np.zeros((0, shape.n_m))
    rows, _ = lift_information(shape, windows, distribution.mass)
    _, strength, right = np.linalg.svd(rows, full_matrices=False)
    return strength[:ROWS, None] * right[:ROWS]


def _points(shape: ObjectShape) -> Float[np.ndarray, "J 2"]:
    """Where the object can be gripped; two grasps may share a point."""
    return np.unique(np.array([grasp.position for grasp in shape.grasps]).reshape(-1, 2).round(9), axis=0)
