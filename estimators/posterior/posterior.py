"""Posterior of all unknowns: masses and frictions with their errors, the setup's nuisances, and the misfit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from scipy.stats import chi2
from torch import Tensor

from estimators.base import Estimate
from estimators.identifiability.report import identifiability
from estimators.particles.links import HINGE_PRIOR
from estimators.particles.misfit import UNEXPLAINED, Misfit
from estimators.posterior.solver import Measurement, Optimum, Whitened
from estimators.posterior.unknowns import Unknowns
from estimators.wrench.model import MODEL_PARAMETERS
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.worlds.setup_errors import PARAMETERS

OBJECT = ("mass", "friction")
"""Blocks of the object itself; all others are nuisances."""
CAUSES = dict(PARAMETERS) | MODEL_PARAMETERS
"""Nuisances, by name."""
IMPLAUSIBLE = 1e-6
"""Probability below which a part of a misfit is no chance, many parts being looked at."""


@dataclass(frozen=True)
class Part:
    """Part of a misfit: the rows of a trial, or a nuisance."""

    name: str
    value: float
    """Mean square of its rows, or of its z."""
    log_chance: float
    """Logarithm of the probability of as large a one, under the errors that are stated."""
    trial: int | None = None
    """Trial of a nuisance that is drawn anew in each."""

    @staticmethod
    def of(name: str, values: Float[Tensor, "m"], trial: int | None = None) -> Part:
        """Part of some whitened values."""
        square = float(values.square().sum())
        return Part(name, square / len(values), float(chi2.logsf(square, len(values))), trial)

    @property
    def implausible(self) -> bool:
        """True if the errors that are stated do not allow it."""
        return self.log_chance < math.log(IMPLAUSIBLE) and self.value > UNEXPLAINED


@dataclass(frozen=True, eq=False)
class Posterior:
    """Laplace approximation about the most likely unknowns.

    Slopes where nuisances fit the noise show more information than there is, so the information is taken at the masses
    and frictions found in the nominal setup.
    """

    unknowns: Unknowns
    measurements: Sequence[Measurement]
    optimum: Optimum

    @cached_property
    def nominal(self) -> Float[Tensor, "n"]:
        """z of the masses and frictions found, in a setup without errors."""
        z = torch.zeros_like(self.optimum.z)
        for name in OBJECT:
            z[self.unknowns.at[name]] = self.optimum.z[self.unknowns.at[name]]
        return z

    @cached_property
    def information(self) -> Float[Tensor, "n n"]:
        """Information of the measurements in masses and frictions, in their own units, and in z of the nuisances."""
        slopes = torch.cat([Whitened.of(m.linearized(self.unknowns, self.nominal)).slopes for m in self.measurements])
        return slopes.T @ slopes / (self._unit[:, None] * self._unit)

    @cached_property
    def _unit(self) -> Float[Tensor, "n"]:
        """Derivative of each mass and friction in z; 1 of the nuisances."""
        unit = torch.ones_like(self.nominal)
        for name in OBJECT:
            where = self.unknowns.at[name]
            unit[where] = self.unknowns.blocks[name].scale(self.nominal[where])
        return unit

    @property
    def of_object(self) -> Float[Tensor, "n"]:
        """True for masses and frictions."""
        inside = torch.zeros(len(self.unknowns), dtype=torch.bool)
        for name in OBJECT:
            inside[self.unknowns.at[name]] = True
        return inside

    @cached_property
    def rows(self) -> Float[Tensor, "m m"]:
        """Whitened derivatives of the measurements in masses and frictions, all nuisances marginalized."""
        own = self.of_object
        inner, across = self.information[own][:, own], self.information[own][:, ~own]
        nuisance = self.information[~own][:, ~own]
        root = torch.linalg.cholesky(nuisance + torch.eye(len(nuisance), dtype=torch.float64))
        seen = torch.linalg.solve_triangular(root, across.T, upper=False)
        values, ways = torch.linalg.eigh(inner - seen.T @ seen)
        return values.clamp(min=0).sqrt()[:, None] * ways.T

    @property
    def freedom(self) -> int:
        """Rows less masses and frictions."""
        return len(self.optimum.residual) - int(self.of_object.sum())

    @property
    def misfit(self) -> float:
        """Squared residual and the nuisances' squared z, over the degrees of freedom: about 1 where the model holds."""
        nuisance = self.optimum.z[~self.of_object]
        return float(self.optimum.residual.square().sum() + nuisance.square().sum()) / max(self.freedom, 1)

    @cached_property
    def parts(self) -> list[Part]:
        """Parts of the misfit, the least plausible first: of every measurement, and of every nuisance.

        A nuisance that is drawn anew in each trial is a part for each.
        """
        found, begin = [], 0
        for measurement in self.measurements:
            for name, rows in measurement.parts:
                found.append(Part.of(name, self.optimum.residual[begin : begin + rows]))
                begin += rows
        for name, block in self.unknowns.blocks.items():
            if name in OBJECT:
                continue
            z = self.optimum.z[self.unknowns.at[name]]
            each = z.reshape(len(block.mean), -1) if block.by_trial else z[None]
            found += [Part.of(name, one, k if block.by_trial else None) for k, one in enumerate(each)]
        return sorted(found, key=lambda part: part.log_chance)

    @cached_property
    def covariance(self) -> Float[Tensor, "n n"]:
        """Covariance of masses and frictions in their own units, and of the nuisances in z, with their priors."""
        prior = torch.ones_like(self.nominal)
        for name in OBJECT:
            block = self.unknowns.blocks[name]
            prior[self.unknowns.at[name]] = (block.std * block.mean.exp()).flatten().square().reciprocal()
        return torch.linalg.inv(self.information + prior.diag())

    def estimate(self, shape: ObjectShape) -> Estimate:
        """Masses and frictions as an answer, its status by the misfit and by the directions that are open."""
        values, mass = self.unknowns.values(self.optimum.z), self.unknowns.at["mass"]
        at = MassDistribution(values["mass"].numpy(), values["friction"].numpy())
        report = identifiability(shape, at, self.rows.numpy())
        worst = self.parts[0]
        # one part may be as far off as it likes where many others fit
        misfit = Misfit(max(self.misfit, worst.value) if worst.implausible else self.misfit, self.freedom)
        covariance = misfit.widening * self.covariance[mass, mass].numpy()
        open_ = report.rank < report.unknowns
        directions = f"mass and friction cannot be told apart: {'; '.join(report.unobservable)}" if open_ else ""
        settled = "" if self.optimum.converged else f"the search ended after {self.optimum.rounds} rounds"
        status = "underdetermined" if open_ else misfit.status if self.optimum.converged else "not_converged"
        return Estimate(
            at,
            status,
            "; ".join(filter(None, [directions, settled, misfit.reason, self.why(misfit)])),
            covariance=covariance,
            identifiability=report,
            diagnostics=misfit.diagnostics
            | self._frictions(misfit.widening**0.5)
            | {"rounds": float(self.optimum.rounds)},
        )

    def of(self, name: str) -> tuple[Tensor, Tensor]:
        """Most likely values of a block and their standard deviations, in the block's unit, each in its shape."""
        block, where = self.unknowns.blocks[name], self.unknowns.at[name]
        std = self.covariance.diagonal()[where].clamp(min=0).sqrt()
        scale = 1.0 if name in OBJECT else block.std.flatten()
        return block.value(self.optimum.z[where]), (std * scale).reshape(block.mean.shape)

    def _frictions(self, widening: float) -> dict[str, float]:
        """Standard deviations of the frictions, and the friction of every hinge with its own, N m."""
        found = {f"friction_{k}_std": widening * float(std) for k, std in enumerate(self.of("friction")[1])}
        if "hinge_friction" in self.unknowns.blocks:
            for index, (torque, std) in enumerate(zip(*self.of("hinge_friction"), strict=True)):
                if std < HINGE_PRIOR / 2:
                    found |= {f"hinge_{index}_Nm": float(torque), f"hinge_{index}_std_Nm": widening * float(std)}
        return found

    def why(self, misfit: Misfit) -> str:
        """Part of a misfit that is the least plausible, in words; empty where the answer explains the trials."""
        if misfit.explains:
            return ""
        worst = self.parts[0]
        times = f"{worst.value**0.5:.2g} times as large as stated"
        where = "" if worst.trial is None else f" in trial {worst.trial}"
        described = CAUSES.get(worst.name)
        if described is None:
            return f"least likely: {worst.name}, {times}"
        return f"least likely: {worst.name}{where}, {times}; if that is so, {described.cause}"
