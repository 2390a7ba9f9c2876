"""Misfit of an answer: how far its wrenches are from the measured ones in units of their errors, and why."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from scipy.stats import chi2
from torch import Tensor

from estimators.particles.friction_system import FrictionEquations, sensor_map
from estimators.particles.links import HINGE_PRIOR
from estimators.particles.pivots import PivotInertia, inertia_map
from estimators.particles.setup_effects import Columns, LinearRows, setup_effects, trial_by_trial
from estimators.particles.windows import Observations
from estimators.wrench.model import ModelErrors, ParticleModel
from estimators.wrench.support import own_weight
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.worlds.parameters import Parameter
from testbed.worlds.setup_errors import LIKELY, PARAMETERS

CHANCE = 1e-3
"""Chance that the stated errors alone give as large a misfit, below which errors are widened."""
UNEXPLAINED = 3.0
"""Misfit from which an answer does not explain the trials, where it is no chance: the status `unexplained` of every
method. Ours: three times the stated variance is more than calibration leaves, and a wrong support, sign or grasp gives
ten and more."""
WIDTHS = (1.0, 3.0)
"""Multiples of them that are tried."""
CAUSES = dict(PARAMETERS) | {
    "support": Parameter(
        scope="object", cause="the groups do not rest on their own weight", shown=(1.0, "of an even load a cell")
    )
}
"""Possible causes of a misfit, by name: errors of the setup, and the support."""


@dataclass(frozen=True)
class Cause:
    """What an error of the setup would explain of a misfit, were it the only one."""

    part: float
    """Part of the squared residual that it would take away."""
    size: float
    """Root mean square of its parameters as they fit best, in units of `LIKELY`; SI where that is."""


@dataclass(frozen=True)
class Misfit:
    """Misfit of an answer, with the trial that fits least and the causes that would explain it."""

    value: float
    """Squared residual over its variance, mean over degrees of freedom: about 1, or less, where the model holds."""
    freedom: int
    """Degrees of freedom: rows less unknowns."""
    trials: dict[int, float] = field(default_factory=dict)
    """Mean squared residual of each trial by its own errors; empty where it is not asked for."""
    explained: dict[str, Cause] = field(default_factory=dict)
    """What each cause would explain alone, likeliest first; empty as `trials`."""
    inertia: float | None = None
    """Inertia that accelerated turns show over that of the masses, where it is what they do not explain."""
    least: float | None = None
    """Mean squared residual that the best friction loads leave; None where it is not asked for."""

    @property
    def by_chance(self) -> bool:
        """True if the stated errors alone may give it."""
        return self.freedom < 1 or self.value <= max(1.0, float(chi2.isf(CHANCE, self.freedom)) / self.freedom)

    @property
    def widening(self) -> float:
        """Factor of the covariance, the square of Birge's ratio; 1 where the misfit may be chance."""
        return 1.0 if self.by_chance else self.value

    @property
    def explains(self) -> bool:
        """True if the answer explains the trials, by the errors stated or nearly."""
        return self.by_chance or self.value <= UNEXPLAINED

    @property
    def status(self) -> Literal["ok", "unexplained"]:
        """Status of an answer of which nothing else is known."""
        return "ok" if self.explains else "unexplained"

    @property
    def diagnostics(self) -> dict[str, float]:
        """Entries of `Estimate.diagnostics`."""
        return {"misfit": self.value, "misfit_freedom": float(self.freedom)}

    def or_of_inertia(self, shape: ObjectShape, pivots: PivotInertia | None, at: MassDistribution) -> Misfit:
        """This one of friction, or that of the masses' inertia about the pivots where friction is explained."""
        if pivots is None or not self.explains:
            return self
        has = inertia_map(shape, pivots.pivot) @ at.mass
        missing, weights = pivots.inertia - has, np.linalg.solve(pivots.covariance, has)
        value = float(missing @ np.linalg.solve(pivots.covariance, missing)) / len(has)
        found = replace(self, value=value, freedom=len(has), inertia=float(weights @ pivots.inertia / (weights @ has)))
        return found if found.widening > self.widening else self

    @property
    def reason(self) -> str:
        """Why the answer does not explain the trials; empty where it does."""
        if self.explains:
            return ""
        size = f"{self.value:.2g}" if self.value < 100 else f"{self.value:.0f}"
        begin = f"the masses do not explain the trials: misfit {size} in place of 1"
        if self.least is not None and self.least <= UNEXPLAINED:
            return f"{begin}, which others do (misfit {self.least:.2g}): the search ended early"
        if self.inertia is not None:
            return f"{begin}; {inertia_in_words(self.inertia)}"
        if not self.explained:
            return begin
        worst = max(self.trials, key=lambda trial: self.trials[trial])
        name, cause = next(iter(self.explained.items()))
        return (
            f"{begin}, most in trial {worst} ({self.trials[worst]:.2g}); likeliest cause, for "
            f"{100 * cause.part:.0f} % of it: {CAUSES[name].cause}; whether they rest on their own weight at all, "
            "support_aware tests; errors are widened"
        )


def inertia_in_words(part: float) -> str:
    """What to check where accelerated turns show another inertia than the masses have, `part` of it."""
    found = f"accelerated turns show {100 * part:.0f} % of the inertia that these masses have"
    return f"{found}: weigh the object again, check the torque's unit and the object's size, or ask support_aware"


def misfit_of(
    equations: FrictionEquations,
    loads: Float[np.ndarray, "n_s"],
    trial: Tensor,
    causes: Callable[[], Columns] | None,
    unknowns: int,
    *,
    always: bool = False,
) -> Misfit:
    """Misfit of friction loads.

    Args:
        equations: Q s = b with its errors.
        loads: s, N.
        trial: trial of each window, (K,).
        causes: effect of each possible cause on the wrenches, by its name, R rows; asked for where the misfit is no
            chance; None asks for neither causes nor trials.
        unknowns: number of loads and of other parameters that were fitted.
        always: True asks for causes of a misfit that may be chance too.
    """
    system = equations.whitened()
    missing = system.b - system.q @ torch.tensor(loads)
    total = float(missing @ missing)
    freedom = len(missing) - unknowns
    found = Misfit(total / max(freedom, 1), freedom)
    if causes is None or (found.by_chance and not always):
        return found
    plain, covariance = equations.b - equations.q @ torch.tensor(loads), equations.covariance
    if equations.hinges is not None:
        covariance = covariance + HINGE_PRIOR**2 * equations.hinges @ equations.hinges.T
    of_row = trial.repeat_interleave(3)
    of_row = torch.cat([of_row, trial.repeat_interleave((len(plain) - len(of_row)) // len(trial))])
    trials = {}
    for index in trial.unique().tolist():
        rows = of_row == index
        own, left = covariance[rows][:, rows], plain[rows]
        trials[index] = float(left @ torch.linalg.solve(own, left)) / len(left)
    span = torch.linalg.qr(system.q)[0]
    ranked: list[tuple[float, str, Cause]] = []
    for name, columns in causes().items():
        seen = system.whiten[:, : len(columns)] @ columns
        seen = seen - span @ (span.T @ seen)
        widest = getattr(LIKELY, name, 1.0) if name != "contact_points" else 1.0
        tried = [_evidence(missing, width * seen, freedom) for width in WIDTHS]
        best = max(range(len(WIDTHS)), key=lambda k: tried[k][0])
        evidence, gain, size = tried[best]
        ranked.append((evidence, name, Cause(gain / max(total, 1e-300), WIDTHS[best] * widest * size)))
    ranked.sort(key=lambda each: each[0], reverse=True)
    explained = {name: cause for _, name, cause in ranked}
    return replace(found, trials=trials, explained=explained)


def likely_causes(
    windows: Observations,
    model: ParticleModel,
    shape: ObjectShape,
    at: MassDistribution,
    drag: Float[Tensor, "P"],
    errors: ModelErrors,
) -> Columns:
    """Effects of errors that a setup may have, `LIKELY` in size, and of loads that are not the groups' own weight.

    Args:
        windows: windows of constant speed.
        model: particles of the object.
        shape: shape of the object.
        at: masses and frictions found.
        drag: friction of every particle, N.
        errors: errors of the model.
    """
    mass = model.particle_mass(torch.tensor(at.mass))
    table = windows.table(model, errors.pivot_error, spread=True)
    linear = LinearRows.of(windows, table, mass, drag.clamp(min=0), 0.0, LIKELY)
    support = own_weight(model, mass, windows.gripper_load(linear.lever, linear.motion(mass), shape.height))
    rows, friction = linear.by_particle, model.particle_friction(torch.tensor(at.friction))
    to_wrench = sensor_map(windows, rows @ (friction[:, None] * support.response))
    causes = trial_by_trial(setup_effects(windows, linear, to_wrench, LIKELY), windows)
    one_hot = torch.nn.functional.one_hot(model.mass_group).double()
    middle = (one_hot @ (one_hot.T @ model.particles / one_hot.sum(0)[:, None]) - model.particles) / model.cell
    # one rigid body's loads rise alike everywhere
    even = (model.contact / model.contact.sum() * drag.sum())[:, None]
    return causes | {"support": (rows[:, :3] @ (even * middle)).reshape(-1, 2)}


def _evidence(missing: Float[Tensor, "R"], columns: Float[Tensor, "R n"], freedom: int) -> tuple[float, float, float]:
    """Evidence for a cause, the squared residual that it takes away, and the size of its n parameters.

    Evidence is twice the negative of Schwarz's criterion, the size of all other errors being unknown: a cause of many
    parameters has to leave less.
    """
    total = float(missing @ missing)
    inner = torch.eye(columns.shape[1], dtype=columns.dtype) + columns.T @ columns
    inverse = torch.linalg.inv(inner)
    toward = columns.T @ missing
    at = inverse @ toward
    gain = float(toward @ at)
    used = columns.shape[1] - float(inverse.trace())
    left = max(total - gain, 1e-9 * total)
    return -freedom * math.log(left) - used * math.log(freedom + 1), gain, float(at.square().mean().sqrt())
