"""The linear system Q s = b of the friction loads s = mu m g, Eq. dvs, with its errors and its rank."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.particles.errors import ModelErrors
from estimators.particles.model import ParticleModel, inertia_of
from estimators.particles.support import own_weight
from estimators.particles.windows import Observations
from estimators.particles.wrench_errors import wrench_errors
from testbed.objects.model import GRAVITY


@dataclass(frozen=True, eq=False)
class LoadGroups:
    """G_s: particles in contact that share both mass group and friction group share one s."""

    index: Tensor
    """Column of G_s for each particle, -1 without contact, (P,)."""
    pairs: tuple[tuple[int, int], ...]
    """(mass group, friction group) of each column."""

    @staticmethod
    def of(model: ParticleModel) -> LoadGroups:
        """The groups of a model."""
        both = list(zip(model.mass_group.tolist(), model.friction_group.tolist(), strict=True))
        pairs = sorted({(m, f) for m, f in both if f >= 0})
        column = {pair: i for i, pair in enumerate(pairs)}
        return LoadGroups(torch.tensor([column.get(pair, -1) for pair in both]), tuple(pairs))

    def gather(self, values: Float[Tensor, "... P"]) -> Float[Tensor, "... n_s"]:
        """Sum over each group: values @ G_s^T."""
        kept = self.index >= 0
        out = torch.zeros(*values.shape[:-1], len(self.pairs), dtype=values.dtype)
        return out.index_add(-1, self.index[kept], values[..., kept])

    def spread(self, s: Float[np.ndarray, "n_s"]) -> Float[Tensor, "P"]:
        """Friction load of each particle, G_s^T s, N; 0 without contact."""
        return torch.where(self.index >= 0, torch.tensor(s)[self.index.clamp(min=0)], 0.0)


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """Q s = b, whitened: every row has unit variance. 3 rows a window."""

    q: Float[Tensor, "R n_s"]
    b: Float[Tensor, "R"]
    whiten: Float[Tensor, "R R"]
    """Inverse root of the rows' covariance, which whitened them."""

    @property
    def rank(self) -> int:
        """rank(Q)."""
        return rank_of(self.q.numpy())

    def loss(self, s: Float[np.ndarray, "n_s"]) -> float:
        """Mean squared residual, Eq. problem_si in units of the data's own error."""
        return float((self.q @ torch.tensor(s) - self.b).square().mean())


@dataclass(frozen=True, eq=False)
class FrictionEquations:
    """Q s = b in N and N m, with its errors. R = 3 K rows, 3 a window."""

    q: Float[Tensor, "R n_s"]
    b: Float[Tensor, "R"]
    apart: Float[Tensor, "R R"]
    """Covariance of the errors that no two trials share."""
    common: Float[Tensor, "R 2"]
    """Effect on each row of one standard deviation of the lift and of the height that all windows share."""

    def whitened(self) -> LinearSystem:
        """The system in units of its errors."""
        whiten = torch.linalg.inv(torch.linalg.cholesky(self.apart + self.common @ self.common.T))
        return LinearSystem(whiten @ self.q, whiten @ self.b, whiten)


def friction_equations(
    model: ParticleModel,
    groups: LoadGroups,
    windows: Observations,
    mass: Float[Tensor, "P"],
    friction: Float[Tensor, "P"],
    height: float,
    errors: ModelErrors,
) -> FrictionEquations:
    """Eq. dvs for every window, about the grasp point: friction of s balances the measured wrench.

    The present mass and friction enter only through the gripper's load (lift and tilt), which is small.

    Args:
        model: particles of the object.
        groups: G_s.
        windows: windows of constant speed.
        mass: present particle masses, kg.
        friction: present friction coefficients.
        height: height of the object, m.
        errors: errors of the model.
    """
    inertia = inertia_of(model, mass)
    load = windows.gripper_load(inertia, height)
    support = own_weight(model, mass, load)
    rows = windows.drag_rows(model, errors.pivot_error)
    q = groups.gather(rows)
    s = friction * support.share * GRAVITY
    response = rows @ (friction[:, None] * support.response)
    carried = (rows @ (friction * (support.lean + support.change(load)))[..., None])[..., 0]
    b = windows.wrench - windows.inertial_wrench(inertia) - carried
    apart, common = wrench_errors(windows, model, s.expand(len(rows), -1), response, errors)
    return FrictionEquations(q.reshape(-1, q.shape[-1]), b.reshape(-1), apart, common)


def rank_of(q: Float[np.ndarray, "R n_s"]) -> int:
    """rank(Q) with columns scaled to unit length; a direction below 1e-3 of the strongest is not observed."""
    scale = np.linalg.norm(q, axis=0)
    values = np.linalg.svd(q / np.where(scale > 0, scale, 1.0), compute_uv=False)
    return int((values > 1e-3 * values.max(initial=1e-300)).sum())
