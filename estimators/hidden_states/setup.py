"""Algorithm 1 where parameters of the setup are unknown: its system is linear in them about the last round's."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.base import Estimate
from estimators.hidden_states.nuisance import ANISOTROPY, NuisanceLayout, NuisancePrior, NuisanceSystem, corrected
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.particles.friction_system import LinearSystem
from estimators.particles.misfit import Misfit
from estimators.particles.pivots import PivotInertia
from estimators.particles.setup_effects import LinearRows
from estimators.wrench.model import inertia_of
from testbed.objects.model import MassDistribution
from testbed.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class UnknownSetup(TrialWindows):
    """Windows of trials in a setup with unknown parameters, linear about those of the round before."""

    prior: NuisancePrior
    linear: NuisanceSystem | None = None
    """The system about the last round's parameters; None before the first round."""

    def refined(self, guess: MassDistribution, s: Float[np.ndarray, "n_s"]) -> Self:
        """The trials, linear about the parameters that fit best with s."""
        layout = self.linear.layout if self.linear else NuisanceLayout.of(self.prior, self.windows)
        at = self.linear.parameters(s) if self.linear else torch.zeros(len(layout.names), dtype=torch.float64)
        linear = NuisanceSystem.of(lambda windows: self.friction_equations(guess, windows), self.windows, layout, at)
        turned = torch.zeros(len(self.accelerated), 7, dtype=torch.float64)
        turned[:, ANISOTROPY] = layout.anisotropy(at)
        return replace(self, linear=linear, accelerated=corrected(self.accelerated, turned))

    def turning(self, guess: MassDistribution) -> LinearRows:
        """Rows of the accelerated windows as corrected."""
        return self.linear_rows(guess, self.accelerated)

    def friction_system(self, guess: MassDistribution) -> LinearSystem:
        """Q s = b with the parameters eliminated, at the guess with which the trials were refined."""
        del guess
        assert self.linear is not None
        return self.linear.reduced()

    def pivot_inertias(self, guess: MassDistribution, s: Float[np.ndarray, "n_s"]) -> PivotInertia | None:
        """I_j, its variance with that of an unknown grasp offset: 2 M (p_j - c) . offset, drawn anew in every trial."""
        pivots = super().pivot_inertias(guess, s)
        if pivots is None or "grasp_offset" not in self.prior.unknown:
            return pivots
        com = inertia_of(self.model, self.model.particle_mass(torch.tensor(guess.mass))).com.numpy()
        windows = self.accelerated
        at = np.linalg.norm(windows.grasp.numpy()[:, None] - pivots.pivot, axis=-1).argmin(axis=1)
        trials = np.array([len(np.unique(windows.trial.numpy()[at == j])) for j in range(len(pivots.pivot))])
        slope = 2 * self.weight * np.linalg.norm(pivots.pivot - com, axis=1)
        return replace(pivots, variance=pivots.variance + (slope * self.prior.grasp_offset) ** 2 / trials)

    def misfit(self, guess: MassDistribution, s: Float[np.ndarray, "n_s"], *, always: bool = False) -> Misfit:
        """Misfit with the parameters that fit s."""
        assert self.linear is not None
        layout, at = self.linear.layout, self.linear.parameters(s)
        windows = corrected(self.windows, layout.spread(at), biased="bias" in layout.kind)
        return self._misfit(windows, guess, s, len(s) + len(at), always=always)

    def annotated(self, estimate: Estimate, s: Float[np.ndarray, "n_s"]) -> Estimate:
        """The estimate with the parameters that fit s, their errors, and in its report which of them were seen."""
        assert self.linear is not None
        layout, values, errors = self.linear.layout, self.linear.parameters(s), self.linear.standard_error()
        numbers = dict(zip(layout.names, values.tolist(), strict=True))
        numbers |= {f"{name}_error": float(e) for name, e in zip(layout.names, errors, strict=True)}
        if "anisotropy" in layout.kind:
            numbers["friction_ratio"], numbers["friction_axis_rad"] = _ellipse(layout.anisotropy(values))
        report, hidden, sentences = estimate.identifiability, estimate.hidden, layout.sentences(np.isfinite(errors))
        blind = [each for each in sentences if not each.endswith(" seen")]
        return replace(
            estimate,
            message="; ".join(filter(None, [estimate.message, *(blind if estimate.distribution is None else ())])),
            identifiability=replace(report, bench=sentences) if report else None,
            hidden=replace(hidden, unobserved="; ".join(filter(None, [hidden.unobserved, *blind]))) if hidden else None,
            diagnostics=estimate.diagnostics | numbers,
        )


def _ellipse(anisotropy: Float[Tensor, "2"]) -> tuple[float, float]:
    """Least over most friction, and the table's direction of most, rad."""
    size = float(anisotropy.norm())
    return (1 - size) / (1 + size), math.atan2(float(anisotropy[1]), float(anisotropy[0])) / 2


def with_found_bias(trajectories: Sequence[Trajectory], found: Mapping[str, float]) -> list[Trajectory]:
    """Trajectories whose sensor states at least as much bias as was found in the components that show it.

    f_z, t_x and t_y bias the gripper's load, which is friction's own size and no constant: their bias is not seen, but
    is as large as that of the others.

    Args:
        trajectories: with the bias that the sensor states.
        found: biases and their errors by name, from an estimate's diagnostics.
    """

    def size(*axes: str) -> float:
        names = [n for n in found if n.startswith("bias_") and n.endswith(axes) and np.isfinite(found[f"{n}_error"])]
        squares = [found[name] ** 2 - found[f"{name}_error"] ** 2 for name in names]
        return math.sqrt(max(float(np.mean(squares)), 0.0)) if squares else 0.0

    least = np.repeat([size("_fx_N", "_fy_N"), size("_tz_Nm")], 3)
    return [replace(t, sensor_bias_std=np.maximum(t.sensor_bias_std, least)) for t in trajectories]
