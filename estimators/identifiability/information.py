"""Fisher information of trials about particle masses and frictions, as a sum over trials.

Each trial has whitened rows in the masses, the frictions and a few errors that trials share, which are unknowns of unit
variance. So the information of any set of trials, measured or predicted, is a sum, and the shared errors are eliminated
in the end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import pad

from estimators.identifiability.predicted import (
    predicted_drags,
    predicted_pushes,
    predicted_windows,
)
from estimators.identifiability.predicted_lifts import predicted_lifts
from estimators.identifiability.quasi_static import Drag
from estimators.identifiability.report import Identifiability, identifiability
from estimators.particles.friction_system import wrench_errors
from estimators.particles.lifts import lift_information, lifts_among
from estimators.particles.links import HINGE_PRIOR
from estimators.particles.observe import observe
from estimators.particles.setup_effects import LinearRows
from estimators.particles.windows import PLANAR, Observations
from estimators.particles.wrench import ParticleLoads
from estimators.wrench.model import RIGID, ModelErrors, ParticleModel, inertia_of
from estimators.wrench.weighing import Weighing
from testbed.actions.base import Action
from testbed.actions.push import Push
from testbed.actions.rotate import Rotate
from testbed.errors import InvalidValueError
from testbed.objects.faces import faces
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.sensing.lift_windows import LiftWindow
from testbed.sensing.presets import Sensing
from testbed.trajectory import Trajectory
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors

SUPPORTS = ("own_weight", "rigid")
"""Support models."""
ROWS = 6
"""Least number of rows of a trial; unused ones are zeros. A lift shows no more: M, c and three second moments."""
OF_MODEL = 3
"""Errors of the model that trials share, the first of their columns: lift, height and lead."""
SAME_POINT = 1e-16
"""Squared distance of equal grasp points, m^2."""
SURE = 1e-6
"""Error of the angles by which a push is predicted [rad]."""
CHUNK = 512
"""Trials that are worked on at once."""


@dataclass(frozen=True)
class Assumptions:
    """Support model and errors under which information is counted."""

    support: str = "own_weight"
    """own_weight or rigid."""
    errors: ModelErrors | None = None
    """Errors of model and weighing beyond the sensor's own; None is what was measured under this support."""
    setup: SetupErrors = EXACT_SETUP
    """Errors of the setup as stated, of trials that are yet to be made; those made carry their own."""
    hinge_friction: tuple[float, ...] | None = None
    """Torque of friction of each hinge of an object in links [N m]; None is a guess."""

    def __post_init__(self) -> None:
        if self.support not in SUPPORTS:
            raise InvalidValueError("support", self.support, f"one of {', '.join(SUPPORTS)}")

    @property
    def model_errors(self) -> ModelErrors:
        """The given errors, or those measured under this support."""
        return self.errors or (RIGID if self.support == "rigid" else ModelErrors())


@dataclass(frozen=True, eq=False)
class TrialInformation:
    """Whitened rows of C trials in U = n_m + n_mu + 3 + J + E unknowns: masses, frictions and shared errors."""

    rows: Float[np.ndarray, "C R U"]
    known: int
    """n_m + n_mu: masses and frictions come first."""

    def information(self, chosen: Sequence[int] | None = None) -> Float[np.ndarray, "U U"]:
        """Information of the chosen trials together, or of all; a trial may be named more than once."""
        rows = self.rows if chosen is None else self.rows[list(chosen)]
        flat = rows.reshape(-1, self.rows.shape[-1])
        return flat.T @ flat

    def root(self, weighing: Weighing) -> Float[np.ndarray, "n_m+n_mu n_m+n_mu"]:
        """Root of the information of the weighing and all trials, the shared errors eliminated: R of a QR."""
        flat = self.rows.reshape(-1, self.rows.shape[-1])
        shared = flat.shape[1] - self.known
        prior = np.hstack([np.eye(shared), np.zeros((shared, self.known))])
        scale = np.append(np.zeros(shared), weighing.row(self.known))
        triangle = np.linalg.qr(np.vstack([prior, scale, np.roll(flat, shared, axis=1)]), mode="r")
        return np.asarray(triangle)[shared:, shared:]

    def report(self, shape: ObjectShape, distribution: MassDistribution, weighing: Weighing) -> Identifiability:
        """Report of all trials and the weighing."""
        found = identifiability(shape, distribution, self.root(weighing))
        if shape.chain is None:
            return found
        prior = np.diag((np.arange(self.rows.shape[-1]) >= self.known).astype(float))
        scale = weighing.row(len(prior))
        prior += np.outer(scale, scale)
        spread = np.linalg.pinv(prior + self.information(), hermitian=True).diagonal()
        return replace(found, hinge_error=tuple(HINGE_PRIOR * np.sqrt(spread[-len(shape.chain.hinges) :])))


def expected(
    shape: ObjectShape,
    distribution: MassDistribution,
    actions: Sequence[Action],
    sensing: Sensing,
    assumptions: Assumptions | None = None,
) -> Identifiability:
    """Prediction of what actions show, before any trial: at the truth, its errors are the Cramer-Rao bound.

    Args:
        shape: geometry and groups.
        distribution: masses and frictions, true or guessed; what stays open hardly depends on them.
        actions: actions in order; the object is weighed besides.
        sensing: errors of the sensor.
        assumptions: support model and model errors.
    """
    trials = predicted_information(shape, distribution, actions, sensing, assumptions or Assumptions())
    setup = EXACT_SETUP if assumptions is None else assumptions.setup
    return trials.report(shape, distribution, Weighing.of(shape, max(sensing.scale, 1e-6), setup))


def observed(
    shape: ObjectShape,
    distribution: MassDistribution,
    trajectories: Sequence[Trajectory],
    assumptions: Assumptions | None = None,
) -> Identifiability:
    """Report of what trials show of an object with such masses and frictions; arguments as `expected`."""
    assumptions = assumptions or Assumptions()
    windows, lifts = observe(shape, trajectories), lifts_among(shape, trajectories)
    batches = [] if windows is None else [windows]
    trials = trial_information(shape, distribution, batches, len(trajectories), assumptions, lifts)
    setup = SetupErrors.largest([trajectory.setup for trajectory in trajectories])
    return trials.report(shape, distribution, Weighing.of(shape, assumptions.model_errors.weight_error, setup))


def predicted_information(
    shape: ObjectShape,
    distribution: MassDistribution,
    actions: Sequence[Action],
    sensing: Sensing,
    assumptions: Assumptions,
) -> TrialInformation:
    """Information of actions before they are made, a trial each, in their order.

    On own weight a lift shows nothing: only the gripped block would come along.

    Args:
        shape: geometry and grasps.
        distribution: masses and frictions at which it is taken, true or guessed.
        actions: actions; a weighing has rows of zeros.
        sensing: errors of the sensor.
        assumptions: support model and model errors.
    """
    lifts = predicted_lifts(actions, sensing, assumptions.setup) if assumptions.support == "rigid" else {}
    loads = ParticleLoads.of(shape, distribution, assumptions.support)
    friction = loads.load.clamp(min=0.0).numpy()
    if shape.chain is not None:
        each = [
            predicted_drags(
                shape, loads.mass.numpy(), friction, actions, sensing, assumptions.setup, assumptions.hinge_friction
            )
        ]
    else:
        each = [
            predicted_windows(shape, actions, sensing, assumptions.setup),
            predicted_pushes(shape, Drag(shape.particles, friction, SURE), actions, sensing, assumptions.setup),
        ]
    felt = [w if w.setup.none else _felt(w, loads) for w in each if w is not None]
    return trial_information(shape, distribution, felt, len(actions), assumptions, lifts)


def trial_information(
    shape: ObjectShape,
    distribution: MassDistribution,
    windows: Sequence[Observations],
    count: int,
    assumptions: Assumptions,
    lifts: Mapping[int, Sequence[LiftWindow]],
) -> TrialInformation:
    """Information of trials from their windows, predicted or measured.

    Args:
        shape: geometry and grasps.
        distribution: masses and frictions at which it is taken.
        windows: windows of all trials on the table, in one batch or more; all of one trial are in the same.
        count: number of trials; one without windows has rows of zeros.
        assumptions: support model and model errors.
        lifts: windows of the lifts, by the number of the trial.
    """
    known = shape.n_m + shape.n_mu
    setup = windows[0].setup if windows else EXACT_SETUP
    unknowns = known + shared_error_count(shape, setup)
    blocks = [(np.array([trial]), _lifted_rows(shape, distribution, lift)[None]) for trial, lift in lifts.items()]
    for batch in windows:
        blocks += _table_rows(shape, distribution, batch, count, assumptions)
    needed, filled = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
    for trials, block in blocks:
        needed[trials] += block.shape[1]
    rows = np.zeros((count, max(ROWS, needed.max(initial=0)), unknowns))
    for trials, block in blocks:
        places = filled[trials][:, None] + np.arange(block.shape[1])
        rows[trials[:, None], places, : block.shape[2]] = block
        filled[trials] += block.shape[1]
    return TrialInformation(rows, known)


def prior_information(
    shape: ObjectShape, weighing: Weighing, setup: SetupErrors = EXACT_SETUP
) -> Float[np.ndarray, "U U"]:
    """Information of the weighing, and of the shared errors, which have unit variance."""
    known = shape.n_m + shape.n_mu
    information = np.diag(np.concatenate([np.zeros(known), np.ones(shared_error_count(shape, setup))]))
    scale = weighing.row(len(information))
    return information + np.outer(scale, scale)


def shared_error_count(shape: ObjectShape, setup: SetupErrors = EXACT_SETUP) -> int:
    """Number of errors that trials share: the model's, inertia, that about each grasp, the setup's, and each hinge."""
    hinges = 0 if shape.chain is None else len(shape.chain.hinges)
    return OF_MODEL + 1 + len(_grasp_points(shape)) + (0 if setup.none else _setup_error_count(shape, setup)) + hinges


@lru_cache(maxsize=32)
def _setup_error_count(shape: ObjectShape, setup: SetupErrors) -> int:
    """Number of the setup's errors that trials share."""
    shape = replace(shape, chain=None)  # those of wrenches, whatever trails
    model, exact = ParticleModel.of(shape), Sensing("exact")
    if shape.grasps:
        windows = predicted_windows(shape, [Rotate(0, duration=4.0)], exact, setup)
    else:
        drag = Drag(shape.particles, np.ones(len(shape.particles)), SURE)
        windows = predicted_pushes(shape, drag, [*map(Push.into, faces(shape))], exact, setup)
    if windows is None:  # nothing to hold or to push
        return 0
    none = torch.zeros(len(windows), 3, 3, dtype=torch.float64)
    each, table = torch.ones(len(windows), len(shape.particles), dtype=torch.float64), windows.table(model)
    linear = LinearRows.of(windows, table, each[0], each, 0.0, setup)
    return wrench_errors(windows, linear, none, ModelErrors())[1].shape[1] - OF_MODEL


def _felt(windows: Observations, loads: ParticleLoads) -> Observations:
    """Windows with what a sensor over the TCP feels of friction and of I_j: its errors are parts of that."""
    planar = loads.drag(windows, ModelErrors.pivot_error)
    planar[:, 2] += windows.spin_up(inertia_of(loads.model, loads.mass))
    felt = torch.zeros(len(windows), 6, dtype=torch.float64)
    felt[:, PLANAR] = planar
    return replace(windows, sensed=torch.linalg.solve(windows.from_sensor, felt))


def _by_size(
    trials: Int[Tensor, "K"], values: dict[str, Tensor], count: int
) -> list[tuple[Int[np.ndarray, "C"], dict[str, Tensor]]]:
    """Trials with equally many windows, and their values (C, size, ...) of those of K windows."""
    trial, groups = trials.numpy(), []
    sizes = np.bincount(trial, minlength=count)
    for size in np.unique(sizes[sizes > 0]):
        alike = np.flatnonzero(sizes == size)
        of_size = np.flatnonzero(sizes[trial] == size)
        groups.append((alike, {name: v[of_size].unflatten(0, (len(alike), int(size))) for name, v in values.items()}))
    return groups


def _table_rows(
    shape: ObjectShape, distribution: MassDistribution, windows: Observations, count: int, assumptions: Assumptions
) -> list[tuple[Int[np.ndarray, "C"], Float[np.ndarray, "C R U"]]]:
    """Trials with as many windows each, and their rows: friction and inertia of one trial, mapped over all."""
    loads = ParticleLoads.of(shape, distribution, assumptions.support)
    points, errors = torch.tensor(_grasp_points(shape)), assumptions.model_errors
    measured, linear = loads.measured(windows, errors)

    def of_trial(fields: dict[str, Tensor], rows: dict[str, Tensor]) -> Tensor:
        trial, of_one = measured.like(fields), linear.like(rows)
        equations = loads.equations(trial, of_one, errors)
        root = torch.linalg.cholesky(equations.apart)
        turning = pad((trial.spin_up(inertia_of(loads.model, loads.mass)) * trial.accelerated)[:, None], (2, 0))
        about = (trial.grasp[:, None] - points).square().sum(-1) < SAME_POINT
        of_inertia = errors.inertia_error * torch.cat([turning[..., None], turning[..., None] * about[:, None]], -1)
        seen = equations.q @ loads.slopes
        moving = of_one.slopes["mass"][:, :3] @ loads.model.parts.T * trial.accelerated[:, None, None]
        moved = pad(moving.flatten(0, 1), (0, shape.n_mu))
        more = (0, 0, 0, len(seen) - len(moved))  # rows of hinges; links turn at constant speed alone
        columns = [seen + pad(moved, more), equations.common[:, :OF_MODEL], pad(of_inertia.flatten(0, 1), more)]
        columns.append(equations.common[:, OF_MODEL:])
        if equations.hinges is not None:
            columns.append(HINGE_PRIOR * equations.hinges)
        return torch.linalg.solve_triangular(root, torch.cat(columns, 1), upper=False)

    fields, rows = (_by_size(measured.trial, each.by_window, count) for each in (measured, linear))
    mapped = torch.vmap(of_trial, chunk_size=CHUNK)
    return [(trials, mapped(some, of_them).numpy()) for (trials, some), (_, of_them) in zip(fields, rows, strict=True)]


def _lifted_rows(
    shape: ObjectShape, distribution: MassDistribution, windows: Sequence[LiftWindow]
) -> Float[np.ndarray, "R n_m"]:
    """Rows of a lift, as few as hold the same information; it shares no error with other trials."""
    if not windows:
        return np.zeros((0, shape.n_m))
    rows, _ = lift_information(shape, windows, distribution.mass)
    _, strength, right = np.linalg.svd(rows, full_matrices=False)
    return strength[:ROWS, None] * right[:ROWS]


def _grasp_points(shape: ObjectShape) -> Float[np.ndarray, "J 2"]:
    """Distinct grasp points [m], object frame; two grasps may share one."""
    return np.unique(np.array([grasp.position for grasp in shape.grasps]).reshape(-1, 2).round(9), axis=0)
