"""Input of the network for the trials of one object: windows, groups, and a first answer by linear equations.

The first answer is a Gauss-Newton fit of the logarithms of the friction loads to Algorithm 1's equations, with the
stated errors as covariance: the network learns how the truth departs from it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.hidden_states.equations import FrictionEquations
from estimators.hidden_states.masses import inertia_map
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.particles.load_groups import rank_of
from estimators.particles.misfit import Misfit
from estimators.particles.observe import NO_DATA, NO_DRAG, observe
from estimators.particles.windows import PLANAR, Observations
from estimators.wrench.support import ERRORS
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.worlds.setup_errors import SetupErrors

ROUNDS = 15
"""Gauss-Newton steps."""
SPREAD, LEVEL = 0.8, 2.0
"""Prior standard deviations of the logarithm of a group's load about the mean over the groups, and of that mean."""
PLAIN = 0.03
"""Error of a window in the guess before the first answer, as a part of the drag."""
VECTORS = 4
"""Number of planar vectors at the start of an edge; `VECTORS` - 1 torques follow, which change sign in a mirror."""
TURNS = "accelerated turns"
MISFIT, MISFIT_OF_INERTIA = "misfit of friction, in logarithm", "misfit of inertia, in logarithm"
SUMMARY = (
    "groups",
    "side of a group, m",
    "height, m",
    "largest group over the smallest",
    "reach over that of a disk",
    "density, kg/m^3 in logarithm",
    "windows at constant speed",
    TURNS,
    "turn rate, rad/s",
    "distance of pivots over the reach",
    "friction",
    "error of a window over the drag, in logarithm",
    "expected error of a mass, in logarithm",
    MISFIT,
    MISFIT_OF_INERTIA,
)
"""Names of `Question.summary`."""


@dataclass(frozen=True, eq=False)
class FirstAnswer:
    """Fit of the friction loads of G groups to Algorithm 1's equations, all loads over the object's weight."""

    mean: Float[Tensor, "G"]
    """Logarithm of each group's load."""
    covariance: Float[Tensor, "G G"]
    """Covariance of `mean`."""
    q: Float[Tensor, "R G"]
    """Rows of friction, whitened."""
    b: Float[Tensor, "R"]
    """Their values."""
    spins: Float[Tensor, "A G"]
    """Rows of the moments of inertia about A pivots of accelerated turns, whitened; they act on shares of the mass."""
    inertia: Float[Tensor, "A"]
    """Their values."""
    equations: FrictionEquations
    """The rows of friction in N and N m, with their errors."""

    def misfit(self, load: Float[np.ndarray, "G"]) -> Misfit:
        """Misfit of loads by the rows of friction."""
        missing, freedom = self.b - self.q @ torch.tensor(load), len(self.b) - len(load)
        return Misfit(float(missing @ missing) / max(freedom, 1), freedom)

    @property
    def misfit_of_inertia(self) -> float:
        """Mean squared residual of the rows of inertia over its variance; 1 without any."""
        missing = self.inertia - self.spins @ torch.softmax(self.mean, 0)
        return float(missing.square().mean()) if len(missing) else 1.0


@dataclass(frozen=True, eq=False)
class Question:
    """Trials of an object of G groups: W windows, an accelerated turn as one. Lengths in units of the object's reach,
    forces in units of its drag."""

    center: Float[Tensor, "G 2"]
    """Middle of each group, from the mean of all."""
    group: Float[Tensor, "G f"]
    """Numbers of each group: `mean` over that of even masses, its error, and its part of the footprint."""
    edges: Float[Tensor, "W G e"]
    """Window with group: force of the group's drag of 1 N, wrench, residual, lever; their torques; errors, kind."""
    summary: Float[Tensor, "n"]
    """Numbers of the whole, `SUMMARY`."""
    rank: int
    """Directions of the friction loads that the trials show."""
    first: FirstAnswer
    """The first answer, with its equations."""
    setup: SetupErrors
    """Errors of the setup as stated."""


def ask(shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory]) -> Question | str:
    """Question of an object on its groups' own weight, with one friction, or the reason for none.

    Args:
        shape: geometry and groups.
        weight: M, kg.
        trajectories: turns.
    """
    every = observe(shape, trajectories, ERRORS["own_weight"])
    if every is None or bool(every.accelerated.all()):
        return NO_DATA
    if not every.drag:
        return NO_DRAG
    windows, turning = merged(every), every.where(every.accelerated)
    trials, accelerated = (TrialWindows.about(shape, weight, each, ERRORS["own_weight"]) for each in (windows, turning))
    per_group = torch.tensor(shape.particles_per_group, dtype=torch.float64)
    start = math.log(float(windows.drag) / (weight * GRAVITY * shape.n_m))
    even = torch.full((shape.n_m,), start, dtype=torch.float64)
    first = _first_answer(trials, accelerated, _guess(trials, even), even)
    mean, covariance, q = first.mean, first.covariance, first.q
    load = mean.exp()
    drag, reach = float(load.sum()) * weight * GRAVITY, float(trials.model.reach)
    unit = torch.tensor([drag, drag, drag * reach], dtype=torch.float64)
    of_loads, wrench, error = _planar(first.equations)
    rows, wrench, error = of_loads / per_group * drag / unit[:, None], wrench / unit, error / unit
    residual = wrench - rows @ (load / load.sum())
    middle = torch.tensor(np.array([shape.middle_of(g) for g in range(shape.n_m)]))
    lever = (middle - windows.grasp[:, None]) / reach
    edges = _edges(rows, wrench, residual, lever, error, windows.accelerated)
    area = per_group / per_group.sum()
    spread = covariance.diagonal().sqrt()
    misfit = first.misfit(load.numpy())
    steady = ~windows.accelerated
    side = shape.cell * math.sqrt(float(per_group.mean()))
    distance = windows.twist[steady, :2].norm(dim=1) / windows.twist[steady, 2].abs()
    summary = (
        shape.n_m,
        side,
        shape.height,
        float(per_group.max() / per_group.min()),
        reach / math.sqrt(len(shape.particles) * shape.cell**2 / (2 * math.pi)),
        math.log(weight / (len(shape.particles) * shape.cell**2 * shape.height)),
        int(steady.sum()),
        int((~steady).sum()),
        float(windows.twist[steady, 2].abs().mean()),
        float(distance.mean()) / reach,
        float(load.sum()),
        float(error.log().mean()),
        float(spread.log().mean()),
        math.log(misfit.value),
        math.log(first.misfit_of_inertia + 1e-3),
    )
    return Question(
        (middle - middle.mean(0)) / reach,
        torch.stack([mean - load.sum().log() - area.log(), spread.log(), area * shape.n_m], 1),
        edges,
        torch.tensor(summary, dtype=torch.float64),
        rank_of(q.numpy()),
        first,
        windows.setup,
    )


def _planar(equations: FrictionEquations) -> tuple[Float[Tensor, "W 3 G"], Float[Tensor, "W 3"], Float[Tensor, "W 3"]]:
    """Planar rows of the equations given the others, which show the gripper's load: q, b and its standard errors."""
    count, rows = equations.b.shape
    precision = torch.linalg.inv(equations.covariance_with(*equations.wide))
    at = (rows * torch.arange(count)[:, None] + torch.tensor(PLANAR)).flatten()
    values = torch.cat([equations.q, equations.b[..., None]], -1).flatten(0, 1)
    own = precision[at[:, None], at]
    given = torch.linalg.solve(own, precision[at] @ values).reshape(count, 3, -1)
    error = torch.linalg.inv(own).diagonal().sqrt().reshape(count, 3)
    return given[..., :-1], given[..., -1], error


def _guess(trials: TrialWindows, prior: Float[Tensor, "G"]) -> Float[Tensor, "G"]:
    """Fit of the logarithms of the loads under plain errors: those of a setup depend on the loads."""
    windows, shape = trials.windows, trials.shape
    of_group = torch.tensor(np.eye(shape.n_m)[shape.mass_group] / shape.particles_per_group)
    rows = windows.drag_rows(trials.model, trials.errors.pivot_error) @ of_group
    plain = PLAIN * windows.drag * torch.tensor([1.0, 1.0, float(trials.model.reach)], dtype=torch.float64)
    error = (windows.covariance.diagonal(dim1=1, dim2=2) + plain.square()).sqrt()
    q, b = (rows / error[..., None]).flatten(0, 1) * trials.weight * GRAVITY, (windows.wrench / error).flatten()
    return _fitted(q, b, torch.zeros(0, shape.n_m).double(), torch.zeros(0).double(), prior)[0]


def _first_answer(
    trials: TrialWindows, accelerated: TrialWindows, guess: Float[Tensor, "G"], prior: Float[Tensor, "G"]
) -> FirstAnswer:
    """Fit with the errors at a guess of the logarithms of the loads; `prior` is their mean before the trials."""
    weight, per_group = trials.weight, torch.tensor(trials.shape.particles_per_group, dtype=torch.float64)
    mass = weight * torch.softmax(guess, 0) / per_group
    at = MassDistribution(mass.numpy(), np.array([float(guess.exp().sum())]))
    equations = trials.friction_equations(at)
    whitened = equations.whitened()
    q, b = whitened.q / per_group * weight * GRAVITY, whitened.b
    spins, inertia = _inertia_rows(accelerated, at)
    return FirstAnswer(*_fitted(q, b, spins, inertia, prior), q, b, spins, inertia, equations)


def merged(windows: Observations) -> Observations:
    """Windows with those of each accelerated turn as one: accelerations of both signs cancel, and friction is left."""
    kinds = zip(windows.trial.tolist(), windows.accelerated.tolist(), strict=True)
    keys = [(trial, 0 if swung else k + 1) for k, (trial, swung) in enumerate(kinds)]
    place = {key: index for index, key in enumerate(dict.fromkeys(keys))}
    group = torch.tensor([place[key] for key in keys])
    found = windows.merged(group)
    return found.like(found.by_window | {"noise": found.noise / torch.bincount(group)[:, None, None]})


def _inertia_rows(accelerated: TrialWindows, at: MassDistribution) -> tuple[Float[Tensor, "A G"], Float[Tensor, "A"]]:
    """Rows a and values y of a x = y, whitened: moments of inertia of the shares x of the mass about the pivots."""
    shape, pivots = accelerated.shape, accelerated.pivot_inertias(at, accelerated.friction_loads(at))
    if pivots is None:
        return torch.zeros(0, shape.n_m, dtype=torch.float64), torch.zeros(0, dtype=torch.float64)
    whiten = np.linalg.inv(np.linalg.cholesky(pivots.covariance))
    of_shares = accelerated.weight * inertia_map(shape, pivots.pivot) / shape.particles_per_group
    return torch.tensor(whiten @ of_shares), torch.tensor(whiten @ pivots.inertia)


def _fitted(
    q: Float[Tensor, "R G"],
    b: Float[Tensor, "R"],
    spins: Float[Tensor, "A G"],
    inertia: Float[Tensor, "A"],
    prior_mean: Float[Tensor, "G"],
) -> tuple[Float[Tensor, "G"], Float[Tensor, "G G"]]:
    """Most likely logarithms of the loads over the weight, and their covariance about it.

    Friction rows are linear in the loads, those of inertia in their shares.
    """
    count = q.shape[1]
    even = torch.full((count, count), 1 / count, dtype=torch.float64)
    prior = (torch.eye(count, dtype=torch.float64) - even) / SPREAD**2 + even / LEVEL**2
    y, information = prior_mean, prior
    for _ in range(ROUNDS):
        load, share = y.exp(), torch.softmax(y, 0)
        known = spins @ share
        slopes = torch.cat([q * load, spins * share - known[:, None] * share])
        missing = torch.cat([b - q @ load, inertia - known])
        information = slopes.T @ slopes + prior
        y = y + torch.linalg.solve(information, slopes.T @ missing - prior @ (y - prior_mean)).clamp(-1, 1)
    return y, torch.linalg.inv(information)


def _edges(
    rows: Float[Tensor, "W 3 G"],
    wrench: Float[Tensor, "W 3"],
    residual: Float[Tensor, "W 3"],
    lever: Float[Tensor, "W G 2"],
    error: Float[Tensor, "W 3"],
    accelerated: Tensor,
) -> Float[Tensor, "W G e"]:
    """Edges of windows and groups: `VECTORS` planar vectors, torques, then numbers that no turn of the axes changes."""
    per = rows.transpose(1, 2)
    own = [each[:, None].expand(-1, per.shape[1], -1) for each in (wrench, residual)]
    plain = torch.cat([error[:, :2].mean(1, keepdim=True), error[:, 2:]], 1).log()
    plain = torch.cat([plain, accelerated[:, None].double()], 1)[:, None].expand(-1, per.shape[1], -1)
    three = [per, *own]
    return torch.cat([*[each[..., :2] for each in three], lever, *[each[..., 2:] for each in three], plain], -1)
