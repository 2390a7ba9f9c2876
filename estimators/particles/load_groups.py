"""Groups G_s of the friction loads s = mu m g, and the rank of a system in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.wrench.model import ParticleModel
from testbed.objects.model import GRAVITY, ObjectShape


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

    def spread(self, s: Float[np.ndarray, "... n_s"] | Float[Tensor, "... n_s"]) -> Float[Tensor, "... P"]:
        """Friction load of each particle, G_s^T s, N; 0 without contact."""
        return torch.where(self.index >= 0, torch.as_tensor(s)[..., self.index.clamp(min=0)], 0.0)


def weight_per_mass(shape: ObjectShape, pairs: Sequence[tuple[int, int]]) -> Float[np.ndarray, "n_s"]:
    """Weight on one particle in contact of each pair per kg of its group's particle mass, N/kg."""
    groups = [m for m, _ in pairs]
    return GRAVITY * shape.particles_per_group[groups] / shape.feet_per_group[groups]


def rank_of(q: Float[np.ndarray, "R n_s"]) -> int:
    """Rank of Q with columns scaled to unit length; singular values below 1e-3 of the largest count as 0."""
    scale = np.linalg.norm(q, axis=0)
    values = np.linalg.svd(q / np.where(scale > 0, scale, 1.0), compute_uv=False)
    return int((values > 1e-3 * values.max(initial=1e-300)).sum())
