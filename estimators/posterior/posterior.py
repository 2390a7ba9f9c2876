"""Posterior of masses, frictions and the nuisances of the setup: estimate, covariance, evidence and misfit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.special import chdtrc, gammaln
from torch import Tensor

from estimators.base import Estimate
from estimators.identifiability.report import hardly_known, identifiability
from estimators.particles.links import hinge_frictions
from estimators.particles.misfit import CHANCE, UNEXPLAINED, Misfit
from estimators.posterior.draws import draws_of
from estimators.posterior.on_table import WRENCHES, OnTable
from estimators.posterior.priors import unlevel
from estimators.posterior.solver import ROUNDS, Linearized, Measurement, Optimum, Rows, Whitened, joined, solve
from estimators.posterior.unknowns import SMALLEST, Unknowns
from estimators.wrench.model import MODEL_PARAMETERS
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.worlds.setup_errors import PARAMETERS

OBJECT = ("mass", "friction")
"""Blocks of the object itself; all others are nuisances."""
CAUSES = dict(PARAMETERS) | MODEL_PARAMETERS
"""Nuisances, by name."""
MOST_NUMBERS = 6
"""Numbers of a nuisance up to which each is reported."""
OBSERVED = 1e-6
"""Strength of a direction of the masses, as a part of the strongest, above which it counts as observed."""
LEAST_SHOWN = 0.02
"""Lower bound of the part of a nuisance's prior variance that the measurements explain, against flaws of the model. The
inertia of accelerated turns has the part at the optimum in its place, which a wrong weight makes small. Ours."""
STEP = 0.02
"""Step of z for the finite difference of a volume."""
LEAST_SHIFT = 0.05
"""Shift of a marginal mode, as a part of the standard error, below which the joint mode is kept. Ours."""
LEANS = 0.5
"""Slope of the log evidence in the logarithm of the groups' lean above which they lean further than level ones. Ours,
calibrated on objects of seed 4242 of the honesty bench: level blocks reach it in 1 of 300."""
LEAST_GROUPS = 4
"""Least number of groups whose trials show a size that all share: that of the smallest objects of that calibration."""
LEAST_LEFT = 0.03
"""Lower bound of the part of the variance of a trial's rows that the fit leaves: below it slopes at the optimum say
little of a fit without the trial. Ours, by single trials with a wrong grasp, sign or clock."""
IMPLAUSIBLE = 1e-6
"""Probability below which a part of a misfit is not chance, many parts being tested; that of the inertia, the only part
that shows a wrong weight, is `CHANCE`."""


def log_chance(square: float, count: int) -> float:
    """Log probability that the sum of `count` squared standard normal numbers is at least `square`.

    Where it underflows, the leading term for large sums: parts far from plausible keep their order.
    """
    if chance := float(chdtrc(count, square)):
        return math.log(chance)
    if math.isinf(square):
        return -math.inf
    a, x = count / 2, square / 2
    return float((a - 1) * math.log(x) - x - gammaln(a) - math.log1p((1 - a) / x))


@dataclass(frozen=True)
class Part:
    """Part of a misfit: the rows of a trial, or a nuisance."""

    name: str
    value: float
    """Mean square of its rows, or of its z."""
    log_chance: float
    """Log probability of a value as large under the stated errors."""
    trial: int | None = None
    """Index of its trial among the trajectories; of a nuisance, among those on the table."""
    of_rows: bool = False
    """True for rows, False for a nuisance."""

    @staticmethod
    def of(
        name: str, values: Float[Tensor, "m"], trial: int | None = None, *, idle: int = 0, of_rows: bool = False
    ) -> Part:
        """Part that consists of some whitened values, `idle` of which do not count."""
        square, count = float(values.square().sum()), len(values) - idle
        return Part(name, square / count, log_chance(square, count), trial, of_rows)

    @property
    def sentence(self) -> str:
        """Part in words, with what to check."""
        where = "" if self.trial is None else f" of trial {self.trial + 1}"
        if self.of_rows and where:
            return f"least likely, given the others: {self.name}{where}"
        times = f"{self.value**0.5:.2g} times as large as stated"
        described = None if self.of_rows else CAUSES.get(self.name)
        if described is None:
            return f"least likely: {self.name}{where}, {times}"
        return f"least likely: {self.name}{where}, {times}; if that is so, {described.cause}"

    @property
    def implausible(self) -> bool:
        """True if the stated errors do not explain it."""
        limit = CHANCE if self.name == "inertia" else IMPLAUSIBLE
        return self.log_chance < math.log(limit) and self.value > UNEXPLAINED


@dataclass(frozen=True, eq=False)
class Posterior:
    """Laplace approximation about the most likely unknowns.

    Frictions are those of `mode`, all others those of `optimum`. Slopes at nuisances that fit the noise overstate the
    information, so it is evaluated at the masses and frictions found, in a setup without errors.
    """

    unknowns: Unknowns
    """Masses, frictions and nuisances, with their priors."""
    measurements: Sequence[Measurement]
    """All measurements."""
    optimum: Optimum
    """Most likely unknowns."""

    @cached_property
    def of_object(self) -> Bool[Tensor, "n"]:
        """True for masses and frictions."""
        inside = torch.zeros(len(self.unknowns), dtype=torch.bool)
        for name in OBJECT:
            inside[self.unknowns.at[name]] = True
        return inside

    @property
    def nominal(self) -> Float[Tensor, "n"]:
        """z of the masses, frictions and springs found, in a setup without errors."""
        found = self.of_object.clone()
        if "rigid_share" in self.unknowns.at:
            found[self.unknowns.at["rigid_share"]] = True
        return self.optimum.z * found

    @cached_property
    def mode(self) -> Float[Tensor, "n"]:
        """`optimum.z` with a single friction at the mode of its marginal density.

        `optimum` is the mode of the joint density. A friction scales the effects of masses and nuisances, and with them
        the volume that the measurements leave to them; the slope of its logarithm moves the mode by up to a standard
        error (Laplace's approximation to the marginal density, to first order). Several frictions stay at the joint
        mode: the trials show their products with masses, which a shift of frictions alone would change.
        """
        z, std = self.optimum.z, self.unknowns.blocks["friction"].std.flatten()
        if len(std) > 1:
            return z
        (own,) = torch.arange(len(z))[self.unknowns.at["friction"]].tolist()
        variance = self.laplace[own, own]
        error, others = variance.sqrt(), torch.arange(len(z)) != own
        # effects of the others are proportional to friction, so each fitted number counts once
        fitted = (1 - self.laplace.diagonal()[others]).sum()
        if fitted * std[0] * error <= LEAST_SHIFT:
            return z

        def volume(slopes: Sequence[Tensor]) -> float:
            each = torch.cat(list(slopes))[:, others]
            eye = torch.eye(each.shape[1], dtype=torch.float64)
            return -float(torch.linalg.slogdet(each.T @ each + eye)[1]) / 2

        rows, ridge = self._rows_at_optimum, self.laplace[:, own] / variance
        there = [found.slopes_at(z + STEP * ridge) for found in self._at_optimum]
        ahead = volume([row.over(each) for row, each in zip(rows, there, strict=True)])
        slope = (ahead - volume([row.slopes for row in rows])) / STEP
        # the slope holds within about one standard error
        moved = z.clone()
        moved[own] += (variance * slope).clamp(-error, error)
        return moved

    @cached_property
    def information(self) -> Float[Tensor, "n n"]:
        """Information of the measurements on masses and frictions in their own units, and on z of the nuisances."""
        slopes = torch.cat([Whitened.of(m.linearized(self.unknowns, self.nominal)).slopes for m in self.measurements])
        return slopes.T @ slopes / (self._unit[:, None] * self._unit)

    @cached_property
    def _unit(self) -> Float[Tensor, "n"]:
        """Derivative of each mass and friction in z; 1 of the nuisances."""
        unit = torch.ones_like(self.nominal)
        for name in OBJECT:
            where = self.unknowns.at[name]
            unit[where] = self.unknowns.blocks[name].scale(self.nominal[where]).clamp(min=SMALLEST)
        return unit

    @cached_property
    def of_masses_and_frictions(self) -> Float[Tensor, "m m"]:
        """Information of the measurements on masses and frictions in their own units, nuisances marginalized."""
        own = self.of_object
        inner, across = self.information[own][:, own], self.information[own][:, ~own]
        nuisance = self.information[~own][:, ~own]
        root = torch.linalg.cholesky(nuisance + torch.eye(len(nuisance), dtype=torch.float64))
        lost = torch.linalg.solve_triangular(root, across.T, upper=False)
        return inner - lost.T @ lost

    @cached_property
    def rows(self) -> Float[Tensor, "m m"]:
        """Whitened derivatives of the measurements in masses and frictions, all nuisances marginalized."""
        values, axes = torch.linalg.eigh(self.of_masses_and_frictions)
        return values.clamp(min=0).sqrt()[:, None] * axes.T

    def mass_equations(self) -> tuple[Float[np.ndarray, "r n_m"], Float[np.ndarray, "r"]]:
        """Equations of the masses without their prior, all others marginalized, errors widened by the misfit.

        Rows a and values y with a m = y, independent and of unit error, the most precise first. r is n_m where every
        mass is observed; under one rigid body it is 4 at most, or 6 with lifts.
        """
        mass, friction = (self.unknowns.at[name] for name in OBJECT)
        both, z = self.of_masses_and_frictions, self.optimum.z / self._unit
        onto = (torch.linalg.pinv(both[friction, friction], hermitian=True) @ both[friction, mass]).T
        inner = both[mass, mass] - onto @ both[friction, mass]
        # at the most likely unknowns the prior balances the measurements
        pull = z[mass] - onto @ z[friction]
        values, axes = (each.flip(-1) for each in torch.linalg.eigh(inner))
        observed = values > OBSERVED**2 * values[0]
        strength, axes = (values[observed] / self.explained.widening).sqrt(), axes[:, observed]
        at = axes.T @ self.unknowns.values(self.optimum.z)["mass"] + axes.T @ pull / values[observed]
        return (strength[:, None] * axes.T).numpy(), (strength * at).numpy()

    @property
    def swung(self) -> bool:
        """True if any turn is accelerated."""
        return any(bool(each.windows.accelerated.any()) for each in self.measurements if isinstance(each, OnTable))

    @property
    def freedom(self) -> int:
        """Rows that count less masses and frictions.

        All rows count where masses are given and none would be left: if the masses were not fitted to them, a large
        misfit is not by chance.
        """
        rows, known = sum(rows.counted for rows, _ in self._measured), not self.unknowns.blocks["mass"].std.any()
        free = rows - int(self.of_object.sum())
        return rows if known and free < 1 else free

    @property
    def misfit(self) -> float:
        """Squared residual and the nuisances' squared z, over the degrees of freedom: about 1 where the model holds."""
        nuisance = self.optimum.z[~self.of_object]
        return float(self.optimum.residual.square().sum() + nuisance.square().sum()) / max(self.freedom, 1)

    @cached_property
    def parts(self) -> list[Part]:
        """Parts of the misfit, the least plausible first: of every measurement, and of every nuisance.

        A nuisance that is drawn in each trial has a part for each. One of a single number is compared with the scatter
        that its estimate has by the prior: far below 1 where the measurements show little of it.
        """
        found = [
            Part.of(rows.name, self.optimum.residual[where], rows.trial, idle=rows.idle, of_rows=True)
            for rows, where in self._measured
        ]
        on_table = [rows.trial for rows, _ in self._measured if rows.name == WRENCHES]
        for name, block in self.unknowns.blocks.items():
            if name in OBJECT:
                continue
            where = self.unknowns.at[name]
            z = self.optimum.z[where]
            if len(z) == 1:
                shown = (1 - self.covariance.diagonal()[where]).clamp(min=LEAST_SHOWN)
                if name == "inertia" and self.swung:
                    shown = torch.minimum(shown, 1 - self.laplace.diagonal()[where]).clamp(min=SMALLEST)
                z = self._settled[where] / shown.sqrt()
            each = z.reshape(len(block.mean), -1) if block.by_trial else z[None]
            found += [Part.of(name, one, on_table[k] if block.by_trial else None) for k, one in enumerate(each)]
        return sorted(found, key=lambda part: part.log_chance)

    @property
    def _measured(self) -> list[tuple[Rows, slice]]:
        """Every measured part, and the place of its rows among all."""
        parts = [rows for measurement in self.measurements for rows in measurement.parts]
        ends = np.cumsum([rows.count for rows in parts]).tolist()
        return [(rows, slice(end - rows.count, end)) for rows, end in zip(parts, ends, strict=True)]

    @property
    def named(self) -> Part:
        """Part to name where the masses do not explain the trials.

        If the least plausible part is a trial, the trial that all others predict worst: a wrong trial attracts the fit,
        so that the residuals of right ones grow. Residuals of a fit without a trial follow from the leverage of its
        rows (Cook and Weisberg 1982, deletion of cases), at the slopes of the optimum.
        """
        worst = self.parts[0]
        if not worst.of_rows or worst.trial is None:
            return worst
        residual, slopes = self.optimum.residual, torch.cat([rows.slopes for rows in self._rows_at_optimum])
        rows_of = {rows.trial: (rows, where) for rows, where in self._measured}

        def without(part: Part) -> float:
            rows, where = rows_of[part.trial]
            leverage, axes = torch.linalg.eigh(slopes[where] @ self.laplace @ slopes[where].T)
            square = ((axes.T @ residual[where]).square() / (1 - leverage).clamp(min=LEAST_LEFT)).sum()
            return float(square) / rows.counted

        return max((part for part in self.parts if part.of_rows and part.trial is not None), key=without)

    @property
    def explained(self) -> Misfit:
        """Misfit of all rows, or of the least plausible part if it is implausible."""
        worst = self.parts[0]
        if not worst.implausible:
            return Misfit(self.misfit, self.freedom)
        inertia = 1 + self.without_prior("inertia") if worst.name == "inertia" else None
        return Misfit(max(self.misfit, worst.value), self.freedom, inertia)

    def without_prior(self, name: str) -> float:
        """Value of a nuisance of one number by the measurements alone, without its prior, in its own unit."""
        where, block = self.unknowns.at[name], self.unknowns.blocks[name]
        precision = 1 / self.laplace[where, where]
        return float(block.std * self._settled[where] * precision / (precision - 1))

    @property
    def by_trial(self) -> dict[int, float]:
        """Misfit of each trial's rows."""
        return {part.trial: part.value for part in self.parts if part.of_rows and part.trial is not None}

    @cached_property
    def _at_optimum(self) -> list[Linearized]:
        return [measurement.linearized(self.unknowns, self.optimum.z) for measurement in self.measurements]

    @cached_property
    def _rows_at_optimum(self) -> list[Whitened]:
        return [Whitened.of(found) for found in self._at_optimum]

    @cached_property
    def _precision(self) -> Float[Tensor, "n n"]:
        """Precision of z at the most likely unknowns."""
        slopes = torch.cat([rows.slopes for rows in self._rows_at_optimum])
        return slopes.T @ slopes + torch.eye(len(self.unknowns), dtype=torch.float64)

    @cached_property
    def laplace(self) -> Float[Tensor, "n n"]:
        """Covariance of z about the most likely unknowns."""
        return torch.linalg.inv(self._precision)

    @cached_property
    def _settled(self) -> Float[Tensor, "n"]:
        """z one step beyond the optimum: the rest of the search matters where measurements show little of a number."""
        residual, slopes = joined(self._rows_at_optimum)
        return self.optimum.z - self.laplace @ (slopes.T @ residual + self.optimum.z)

    @property
    def _log_determinant(self) -> float:
        """Log determinant of the covariance of all rows."""
        return float(sum(torch.linalg.slogdet(block)[1].sum() for at in self._at_optimum for _, block in at.blocks))

    @property
    def deviance(self) -> float:
        """-2 times the logarithm of the probability density of rows and unknowns, up to a constant."""
        return float(self.optimum.residual.square().sum() + self.optimum.z.square().sum()) + self._log_determinant

    @property
    def log_evidence(self) -> float:
        """Log of the probability density of all rows, up to a constant, by Laplace's approximation."""
        return -(self.deviance + float(torch.linalg.slogdet(self._precision)[1])) / 2

    @cached_property
    def log_evidence_to_scale(self) -> float:
        """`log_evidence` with errors of the rows stated up to a common factor, which the rows determine.

        Stated errors that are too large would hide how much better one model fits than another.
        """
        square = self.optimum.residual.square().sum().clamp(min=SMALLEST)
        free = max(len(self.optimum.residual) - sum(found.absorbed() for found in self._at_optimum), 1.0)
        factor = square / free
        known = torch.linalg.eigvalsh(self._precision) - 1  # of the rows, without the prior
        volume = torch.log1p(known.clamp(min=0) / factor).sum()
        return -float(free * factor.log() + self.optimum.z.square().sum() + volume + self._log_determinant) / 2

    def leaning(self) -> Posterior:
        """Posterior with a wider prior of the groups' lean, where the trials show that they stand off their middles.

        Blocks of one make stand alike, so the size of their lean is common to all. It is larger where the slope of the
        log evidence in its logarithm exceeds `LEANS` (MacKay 1992, evidence approximation); else this posterior is
        returned.
        """
        leans, unknowns = unlevel(self.unknowns)
        shown = (1 - self.covariance.diagonal()[leans]).sum()
        if leans.sum() < 2 * LEAST_GROUPS or self.optimum.z[leans].square().sum() - shown < LEANS:
            return self
        start = unknowns.start(**self.unknowns.values(self.optimum.z))
        return Posterior(unknowns, self.measurements, solve(self.measurements, unknowns, start))

    def given(self, mass: Float[Tensor, "n_m"], rounds: int = ROUNDS) -> Posterior:
        """Posterior of the same measurements at known masses [kg per particle]; the search starts from this optimum."""
        unknowns = self.unknowns.given(mass=mass)
        start = unknowns.start(**self.unknowns.values(self.optimum.z))
        return Posterior(unknowns, self.measurements, solve(self.measurements, unknowns, start, rounds))

    @cached_property
    def covariance(self) -> Float[Tensor, "n n"]:
        """Covariance of masses and frictions in their own units, and of the nuisances in z, with their priors."""
        prior = torch.ones_like(self.nominal)
        for name in OBJECT:
            block = self.unknowns.blocks[name]
            prior[self.unknowns.at[name]] = (block.std * block.mean.exp()).flatten().square().reciprocal()
        return torch.linalg.inv(self.information + prior.diag())

    def estimate(self, shape: ObjectShape) -> Estimate:
        """Estimate of masses and frictions, its status by the misfit and the unobserved directions."""
        values, mass, misfit = self.unknowns.values(self.mode), self.unknowns.at["mass"], self.explained
        at = MassDistribution(values["mass"].numpy(), values["friction"].numpy())
        report = identifiability(shape, at, self.rows.numpy())
        covariance = misfit.widening * self.covariance[mass, mass].numpy()
        open_ = report.rank < report.unknowns
        directions = report.ambiguity
        if misfit.explains and not open_ and (loose := hardly_known(shape, at.mass, covariance)):
            open_, directions = True, loose
        settled = "" if self.optimum.converged else f"the search ended after {self.optimum.rounds} rounds"
        _, unseen = self._hinges
        named = "" if misfit.explains else self.named.sentence
        status = "underdetermined" if open_ else misfit.status if self.optimum.converged else "not_converged"
        return Estimate(
            at,
            status,
            "; ".join(filter(None, [directions, settled, misfit.reason, named, unseen])),
            covariance=covariance,
            identifiability=report,
            diagnostics=self.diagnostics,
        )

    @property
    def diagnostics(self) -> dict[str, float]:
        """Misfit, errors of the frictions, hinges, nuisances and rounds, by name, widened by the misfit."""
        widening = self.explained.widening**0.5
        frictions = {f"friction_{k}_std": widening * float(std) for k, std in enumerate(self.of("friction")[1])}
        rounds = {"rounds": float(self.optimum.rounds)}
        return self.explained.diagnostics | frictions | self._hinges[0] | self.nuisances() | rounds

    def of(self, name: str) -> tuple[Tensor, Tensor]:
        """Most likely values of a block and their standard deviations, in the block's unit and shape."""
        block, where = self.unknowns.blocks[name], self.unknowns.at[name]
        std = self.covariance.diagonal()[where].clamp(min=0).sqrt()
        scale = 1.0 if name in OBJECT else block.std.flatten()
        z = self.mode if name in OBJECT else self.optimum.z
        return block.value(z[where]), (std * scale).reshape(block.mean.shape)

    def draws(self, shape: ObjectShape, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Draws of the groups' masses, kg, (count, n_m), and of the frictions, (count, n_mu).

        The covariance is widened by the misfit; see `estimators.posterior.draws.draws_of`.
        """
        own, unit = self.of_object, np.concatenate([shape.particles_per_group, np.ones(shape.n_mu)])
        covariance = (self.covariance[own][:, own] * self.explained.widening).numpy() * np.outer(unit, unit)
        found = np.concatenate([self.unknowns.values(self.mode)[name].numpy() for name in OBJECT]) * unit
        return draws_of(shape, found, covariance, count, seed)

    def nuisances(self) -> dict[str, float]:
        """Values and standard deviations, SI units, of the nuisances of at most `MOST_NUMBERS` numbers, by name.

        The name of one that is drawn in each trial has the trial first, as in `grasp_offset_0_1`: trial 0, along y.
        """
        found: dict[str, float] = {}
        for name, block in self.unknowns.blocks.items():
            each = block.mean[0] if block.by_trial else block.mean
            if name in OBJECT or name == "hinge_friction" or each.numel() > MOST_NUMBERS:
                continue
            values, stds = (value.flatten().tolist() for value in self.of(name))
            places = list(np.ndindex(*block.mean.shape))
            for place, value, std in zip(places, values, stds, strict=True):
                of = "_".join([name, *map(str, place)])
                found |= {of: value, f"{of}_std": std}
        return found

    @cached_property
    def _hinges(self) -> tuple[dict[str, float], str]:
        """Friction of every hinge that turns, with its error, N m; and a message that names the others."""
        if "hinge_friction" not in self.unknowns.blocks:
            return {}, ""
        torque, std = self.of("hinge_friction")
        return hinge_frictions(torque.tolist(), std.tolist(), self.explained.widening**0.5)
