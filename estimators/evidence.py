"""What trials say of masses and frictions, whitened: a likelihood, bilinear in the two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from testbed.objects import GRAVITY, ObjectShape


@dataclass(frozen=True, eq=False)
class Evidence:
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
