"""Fisher information of trials about particle masses and frictions, as a sum over trials.

The forward model of the posterior gives the rows of each trial, made or planned, and the errors that are drawn anew in
each trial are marginalized. So the information of any set of trials about masses, frictions and the errors that trials
share is a sum, and the shared errors are eliminated in the end.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import get_args

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from estimators.identifiability.predicted import predicted_drags, predicted_lifts, predicted_pushes, predicted_windows
from estimators.identifiability.quasi_static import Drag
from estimators.identifiability.report import Identifiability, identifiability
from estimators.particles.lifts import lifts_among
from estimators.particles.links import HINGE_PRIOR
from estimators.particles.observe import observe
from estimators.particles.windows import Observations
from estimators.posterior.in_air import InAir
from estimators.posterior.on_table import OnTable
from estimators.posterior.posterior import OBJECT
from estimators.posterior.priors import priors
from estimators.posterior.scale import Weighing
from estimators.posterior.solver import Measurement
from estimators.posterior.unknowns import Block, Unknowns
from estimators.wrench.model import ModelErrors, ParticleModel
from estimators.wrench.support import ERRORS, LOADS, GripperLoad, SupportModel
from testbed.actions.base import Action
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.sensing.lift_windows import LiftWindow
from testbed.sensing.presets import Sensing
from testbed.trajectory import Trajectory
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors

SUPPORTS: tuple[str, ...] = get_args(SupportModel)
"""Support models."""
FAINT = 1e-6
"""Information of a row, in units of the prior's, below which it is left out."""
SURE = 1e-6
"""Tolerance of the angles in a predicted push [rad]."""
CHUNK = 256
"""Number of trials in a batch."""
LEAST_SCALE = 1e-6
"""Error of a perfect scale [kg]."""


@dataclass(frozen=True)
class Assumptions:
    """Support model and errors under which information is counted."""

    support: str = "own_weight"
    """own_weight or rigid."""
    errors: ModelErrors | None = None
    """Errors of model and weighing beyond the sensor's own; None is the errors measured under this support."""
    setup: SetupErrors = EXACT_SETUP
    """Errors of the setup as stated, for planned trials; trials that were made state their own."""
    hinge_friction: tuple[float, ...] | None = None
    """Torque of friction of each hinge of an object in links [N m]; None is a guess."""

    def __post_init__(self) -> None:
        if self.support not in SUPPORTS:
            raise InvalidValueError("support", self.support, f"one of {', '.join(SUPPORTS)}")

    @property
    def model_errors(self) -> ModelErrors:
        """The given errors, or those measured under this support."""
        return self.errors or ERRORS[self.support]


@dataclass(frozen=True, eq=False)
class TrialInformation:
    """Whitened rows of C trials in U unknowns: masses, frictions, and the errors that trials share."""

    rows: Float[np.ndarray, "C R U"]
    known: int
    """n_m + n_mu: masses and frictions come first."""
    hinges: Bool[np.ndarray, "U"]
    """True for the friction of hinges."""

    @cached_property
    def lengths(self) -> Int[np.ndarray, "C"]:
        """Number of rows of each trial; zeros follow."""
        return (self.rows.any(axis=2) * np.arange(1, self.rows.shape[1] + 1)).max(axis=1, initial=0)

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
        whole = prior + self.information()
        # masses in kg and errors in units of their priors differ by many orders: the pseudo-inverse cuts by size
        unit = 1 / np.sqrt(np.where(whole.diagonal() > 0, whole.diagonal(), 1.0))
        spread = unit**2 * np.linalg.pinv(whole * np.outer(unit, unit), hermitian=True).diagonal()
        return replace(found, hinge_error=tuple(HINGE_PRIOR * np.sqrt(spread[self.hinges])))


def expected(
    shape: ObjectShape,
    distribution: MassDistribution,
    actions: Sequence[Action],
    sensing: Sensing,
    assumptions: Assumptions | None = None,
) -> Identifiability:
    """Report of actions before any trial: at the truth, its errors are the Cramer-Rao bound.

    Args:
        shape: geometry and groups.
        distribution: masses and frictions, true or guessed; the open directions hardly depend on them.
        actions: actions in order; a weighing is always included.
        sensing: errors of the sensor.
        assumptions: support model and model errors.

    Raises:
        InvalidValueError: the name of a sensor in place of its errors.
    """
    if not isinstance(sensing, Sensing):
        raise InvalidValueError("expected.sensing", sensing, 'a Sensing, such as heft.preset("ft300s")')
    assumptions = assumptions or Assumptions()
    trials = predicted_information(shape, distribution, actions, sensing, assumptions)
    of_model = 0.0 if assumptions.errors is None else assumptions.errors.weight_error
    scale = max(sensing.scale, of_model, LEAST_SCALE)
    return trials.report(shape, distribution, Weighing.of(shape, scale, assumptions.setup))


def observed(
    shape: ObjectShape,
    distribution: MassDistribution,
    trajectories: Sequence[Trajectory],
    assumptions: Assumptions | None = None,
) -> Identifiability:
    """Report of trials of an object with the given masses and frictions; arguments as `expected`."""
    assumptions = assumptions or Assumptions()
    setup = SetupErrors.largest([trajectory.setup for trajectory in trajectories])
    trials = shown_information(shape, distribution, trajectories, replace(assumptions, setup=setup))
    return trials.report(shape, distribution, Weighing.of(shape, assumptions.model_errors.weight_error, setup))


def shown_information(
    shape: ObjectShape, distribution: MassDistribution, trajectories: Sequence[Trajectory], assumptions: Assumptions
) -> TrialInformation:
    """Information of each trial made, in their order; arguments as `predicted_information`.

    Trials that are not usable have rows of zeros.
    """
    windows = observe(shape, trajectories, assumptions.model_errors)
    lifts = lifts_among(shape, trajectories)
    return _Trials(shape, distribution, assumptions).information(
        len(trajectories), [] if windows is None else [replace(windows, setup=assumptions.setup)], lifts
    )


def predicted_information(
    shape: ObjectShape,
    distribution: MassDistribution,
    actions: Sequence[Action],
    sensing: Sensing,
    assumptions: Assumptions,
) -> TrialInformation:
    """Information of each planned action, in their order.

    On own weight a lift shows nothing: only the gripped block would be lifted.

    Args:
        shape: geometry and grasps.
        distribution: masses and frictions at which information is taken, true or guessed.
        actions: actions; a weighing has rows of zeros.
        sensing: errors of the sensor.
        assumptions: support model and model errors.
    """
    setup, errors = assumptions.setup, assumptions.model_errors
    lifts = predicted_lifts(actions, sensing, setup) if assumptions.support == "rigid" else {}
    trials = _Trials(shape, distribution, assumptions)
    if shape.chain is not None:
        hinges = assumptions.hinge_friction
        each = [predicted_drags(shape, trials.mass.numpy(), trials.friction, actions, sensing, setup, hinges)]
    else:
        drag = Drag(shape.particles, trials.friction, SURE)
        each = [
            predicted_windows(shape, actions, sensing, setup, errors),
            predicted_pushes(shape, drag, actions, sensing, setup),
        ]
    return trials.information(len(actions), [w for w in each if w is not None], lifts, planned=True)


def prior_information(shape: ObjectShape, weighing: Weighing, assumptions: Assumptions) -> Float[np.ndarray, "U U"]:
    """Information of the weighing, and of the errors that trials share, which have unit variance."""
    known = shape.n_m + shape.n_mu
    even = MassDistribution(np.ones(shape.n_m), np.ones(shape.n_mu))
    shared = int((~_Trials(shape, even, assumptions).anew).sum())
    scale = weighing.row(shared)
    return np.diag((np.arange(shared) >= known).astype(float)) + np.outer(scale, scale)


class _Trials:
    """Rows of single trials of an object with the given masses and frictions."""

    def __init__(self, shape: ObjectShape, at: MassDistribution, assumptions: Assumptions):
        self.shape, self.at, self.assumptions = shape, at, assumptions
        self.weight = float(at.mass @ shape.particles_per_group)
        self.model = ParticleModel.of(shape)
        self.mass = self.model.particle_mass(torch.tensor(at.mass))
        # linear in masses and frictions, in units of their size
        self.size = np.concatenate([self.weight / shape.particles_per_group, np.ones(shape.n_mu)])
        mass, friction = np.split(self.size, [shape.n_m])
        own = {"mass": Block(torch.tensor(at.mass), torch.tensor(mass))}
        own["friction"] = Block(torch.tensor(at.friction), torch.tensor(friction))
        blocks = priors(shape, assumptions.setup, assumptions.model_errors, self.weight, 1).blocks
        self.unknowns = Unknowns(own | {name: block for name, block in blocks.items() if name not in OBJECT})

    @property
    def friction(self) -> Float[np.ndarray, "P"]:
        """Greatest friction force of each particle under an unloaded gripper [N], shape (P,)."""
        load = LOADS[self.assumptions.support](self.model, self.mass, GripperLoad.none(self.model))[0]
        return (self.model.particle_friction(torch.tensor(self.at.friction)) * load).clamp(min=0.0).numpy()

    @property
    def anew(self) -> Bool[torch.Tensor, "n"]:
        """True for unknowns that are drawn anew in each trial."""
        blocks = self.unknowns.blocks.values()
        return torch.cat([torch.full((block.mean.numel(),), block.by_trial) for block in blocks])

    def information(
        self,
        count: int,
        batches: Sequence[Observations],
        lifts: Mapping[int, Sequence[LiftWindow]],
        *,
        planned: bool = False,
    ) -> TrialInformation:
        """Information of `count` trials from batches of windows on the table and from windows in the air."""
        blocks = [block for batch in batches for block in self._on_table(batch, planned=planned)]
        for trial, windows in lifts.items():
            blocks += self._rows(InAir.of(self.shape, trial, windows, self.weight))
        shared, known = int((~self.anew).sum()), len(self.size)
        found = np.zeros((count, max((block.shape[1] for _, block in blocks), default=0), shared))
        for trials, block in blocks:
            found[trials, : block.shape[1]] = block
        found[..., :known] /= self.size
        hinges = torch.zeros(len(self.unknowns), dtype=torch.bool)
        hinges[self.unknowns.at.get("hinge_friction", slice(0))] = True
        return TrialInformation(found, known, hinges[~self.anew].numpy())

    def _on_table(
        self, windows: Observations, *, planned: bool
    ) -> Iterator[tuple[np.ndarray, Float[np.ndarray, "C R U"]]]:
        """Rows of trials on the table, `CHUNK` trials at once."""
        assumptions, trials = self.assumptions, torch.unique(windows.trial)
        for some in trials.split(CHUNK):
            kept = windows.where((windows.trial >= some[0]) & (windows.trial <= some[-1]))
            found = OnTable.of(self.shape, kept, assumptions.support, assumptions.model_errors)
            found = replace(found, alone=True)
            if planned:
                found = found.predicting(*found.at(self.unknowns, self.unknowns.start()))
            yield from self._rows(found)

    def _rows(self, measurement: Measurement) -> list[tuple[np.ndarray, Float[np.ndarray, "C R U"]]]:
        """Indices of trials with equal numbers of rows, and their whitened rows, reduced to the information's rank."""
        found, anew = measurement.linearized(self.unknowns, self.unknowns.start()), self.anew
        trial = np.concatenate([np.full(rows.count, rows.trial) for rows in measurement.parts])
        each = []
        for rows, covariance in found.blocks:
            slopes = found.slopes[rows]
            drawn = slopes[..., anew]
            root = torch.linalg.cholesky(covariance + drawn @ drawn.mT)
            white = torch.linalg.solve_triangular(root, slopes[..., ~anew], upper=False)
            values, ways = torch.linalg.eigh(white @ white.mT)
            rank = int((values > FAINT).any(0).sum())
            each.append((trial[rows[:, 0]], (ways[..., -rank:].mT @ white).numpy() if rank else white[:, :0].numpy()))
        return each
