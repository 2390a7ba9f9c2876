"""What trials say of masses and frictions, whitened: a likelihood, bilinear in the two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.identifiability.predicted import predicted_lift, predicted_windows
from estimators.identifiability.report import Identifiability, identifiability
from estimators.particles.errors import RIGID, ModelErrors
from estimators.particles.lifts import lift_information, lifts_among
from estimators.particles.pivots import PivotInertia, inertia_map, slope_variance
from estimators.particles.windows import Observations, observe
from estimators.particles.wrench import ParticleLoads
from testbed.actions.base import Action, Lift, Weigh
from testbed.errors import InvalidValueError
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from testbed.sensing.lift_windows import LiftWindow
from testbed.sensing.presets import Sensing
from testbed.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Residuals of unit variance: Q s - b for the friction loads, and a linear system in the masses."""

    shape: ObjectShape
    pairs: tuple[tuple[int, int], ...]
    """Mass and friction group of each s."""
    q: Float[np.ndarray, "R n_s"]
    b: Float[np.ndarray, "R"]
    fixed: Float[np.ndarray, "F n_m"]
    """Of the weight and the moments of inertia."""
    values: Float[np.ndarray, "F"]

    def residuals(
        self, mass: Float[np.ndarray, "... n_m"], friction: Float[np.ndarray, "... n_mu"]
    ) -> Float[np.ndarray, "... R+F"]:
        """For particle masses, kg, and frictions."""
        of_mass, of_friction = (list(groups) for groups in zip(*self.pairs, strict=True))
        loads = mass[..., of_mass] * friction[..., of_friction] * self._carried
        return np.concatenate([loads @ self.q.T - self.b, mass @ self.fixed.T - self.values], axis=-1)

    def minus_log_likelihood(
        self, mass: Float[np.ndarray, "... n_m"], friction: Float[np.ndarray, "... n_mu"]
    ) -> Float[np.ndarray, "..."]:
        """Up to a constant."""
        return np.sum(self.residuals(mass, friction) ** 2, axis=-1) / 2

    def linear(self, friction: Float[np.ndarray, "n_mu"]) -> tuple[Float[np.ndarray, "R+F n_m"], np.ndarray]:
        """With friction known: a design and what it should give, in the particle masses."""
        columns = np.zeros((len(self.q), self.shape.n_m))
        for k, (m, f) in enumerate(self.pairs):
            columns[:, m] += self.q[:, k] * friction[f] * self._carried[k]
        return np.vstack([columns, self.fixed]), np.concatenate([self.b, self.values])

    @property
    def _carried(self) -> Float[np.ndarray, "n_s"]:
        """Load on a particle in contact a kg of its group's particle mass, N/kg."""
        feet = np.bincount(self.shape.mass_group[self.shape.friction_group >= 0], minlength=self.shape.n_m)
        return np.array([GRAVITY * self.shape.particles_per_group[m] / feet[m] for m, _ in self.pairs])


SUPPORTS = ("own_weight", "rigid")


@dataclass(frozen=True)
class Assumptions:
    """Under which support, and with which errors of model and weighing, information is counted."""

    support: str = "own_weight"
    """own_weight or rigid."""
    errors: ModelErrors | None = None
    """Which the data have beyond the sensor's own; None is what was measured under this support."""

    def __post_init__(self) -> None:
        if self.support not in SUPPORTS:
            raise InvalidValueError("support", self.support, f"one of {', '.join(SUPPORTS)}")

    @property
    def stated(self) -> ModelErrors:
        """The errors that count."""
        return self.errors or (RIGID if self.support == "rigid" else ModelErrors())


def expected(
    shape: ObjectShape,
    distribution: MassDistribution,
    actions: Sequence[Action],
    sensing: Sensing,
    question: Assumptions | None = None,
) -> Identifiability:
    """What some actions would show, before any trial: at the truth, its errors are the Cramer-Rao bound.

    Args:
        shape: geometry and groups.
        distribution: masses and frictions, true or guessed; what is open hardly depends on them.
        actions: what would be done; the object is weighed besides.
        sensing: how the sensor errs.
        question: support model and stated errors.
    """
    question = question or Assumptions()
    scale = max(sensing.scale, 1e-6)
    asked = replace(question, errors=replace(question.stated, weight_error=scale))
    windows = predicted_windows(shape, actions, sensing)
    lifts = [predicted_lift(action, sensing) for action in actions if isinstance(action, Lift)]
    return identifiability(shape, distribution, information_root(shape, distribution, windows, asked, lifts))


def observed(
    shape: ObjectShape,
    distribution: MassDistribution,
    trajectories: Sequence[Trajectory],
    question: Assumptions | None = None,
) -> Identifiability:
    """What some trials show of an object with such masses and frictions."""
    windows, lifts = observe(shape, trajectories), list(lifts_among(shape, trajectories).values())
    root = information_root(shape, distribution, windows, question or Assumptions(), lifts)
    return identifiability(shape, distribution, root)


def information_root(
    shape: ObjectShape,
    distribution: MassDistribution,
    windows: Observations | None,
    question: Assumptions,
    lifts: Sequence[Sequence[LiftWindow]] = (),
) -> Float[np.ndarray, "R unknowns"]:
    """Derivatives of the data in particle masses and frictions, over the data's errors, (R, n_m + n_mu)."""
    count = shape.particles_per_group.astype(float)
    weighed = np.append(count, np.zeros(shape.n_mu)) / question.stated.weight_error
    rows = [weighed[None]]
    if windows is not None:
        steady, accelerated = windows.where(~windows.accelerated), windows.where(windows.accelerated)
        if len(steady):
            loads = ParticleLoads.of(shape, distribution, question.support)
            rows.append((loads.equations(steady, question.stated).whitened().q @ loads.slopes).numpy())
        if len(accelerated):
            rows.append(_inertia_rows(shape, distribution, accelerated, question.stated.inertia_error))
    for lift in lifts:
        in_air, _ = lift_information(shape, lift, distribution.mass)
        rows.append(np.hstack([in_air, np.zeros((len(in_air), shape.n_mu))]))
    return np.vstack(rows)


def _inertia_rows(
    shape: ObjectShape, distribution: MassDistribution, windows: Observations, inertia_error: float
) -> np.ndarray:
    """Of I_j about every pivot, by the slope of torque against acceleration."""
    pivots, variance = slope_variance(windows)
    rows = inertia_map(shape, pivots)
    inertia = rows @ distribution.mass
    covariance = PivotInertia(pivots, inertia, variance + (inertia_error * inertia) ** 2, inertia_error).covariance
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), rows)
    return np.hstack([whitened, np.zeros((len(rows), shape.n_mu))])


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


def shared_error_count(shape: ObjectShape) -> int:
    """Number of errors that trials share: lift, height, all moments of inertia, and those about each grasp point."""
    return 3 + len(_points(shape))


def prior_information(shape: ObjectShape, weight_error: float) -> Float[np.ndarray, "U U"]:
    """Information of a weighing, and of shared errors that are of unit spread."""
    known = shape.n_m + shape.n_mu
    information = np.diag(np.concatenate([np.zeros(known), np.ones(shared_error_count(shape))]))
    weighed = shape.particles_per_group / weight_error
    information[: shape.n_m, : shape.n_m] += np.outer(weighed, weighed)
    return information


def of_masses(information: Float[np.ndarray, "U U"], known: int) -> Float[np.ndarray, "known known"]:
    """Information of masses and frictions once the shared errors are eliminated."""
    across = information[:known, known:]
    return information[:known, :known] - across @ np.linalg.solve(information[known:, known:], across.T)


def predicted_information(
    shape: ObjectShape,
    distribution: MassDistribution,
    actions: Sequence[Action],
    sensing: Sensing,
    question: Assumptions,
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
    windows = predicted_windows(shape, moving, sensing) if moving else None
    lifts = {
        index: predicted_lift(action, sensing)
        for index, action in enumerate(moving)
        if isinstance(action, Lift) and question.support == "rigid"
    }
    return trial_information(shape, distribution, windows, len(moving), question, lifts)


def trial_information(
    shape: ObjectShape,
    distribution: MassDistribution,
    windows: Observations | None,
    count: int,
    question: Assumptions,
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
    rows = np.zeros((count, ROWS, known + shared_error_count(shape)))
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
    question: Assumptions,
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
    return np.pad(found, ((0, 0), (0, 0), (0, shared_error_count(shape) - 2)))


def _accelerated_rows(
    shape: ObjectShape, distribution: MassDistribution, fields: dict[str, Tensor], question: Assumptions
) -> Float[np.ndarray, "C 1 U"]:
    """I_j about the grasp point of every trial, by the slope of torque against acceleration."""
    points, known, error = _points(shape), shape.n_m + shape.n_mu, question.stated.inertia_error
    count = len(fields["trial"])
    rows = np.zeros((count, 1, known + shared_error_count(shape)))
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
