"""Posterior of masses and frictions by sampling, where no Gaussian will do: at a bound, or along m mu = const.

The sampler is emcee's affine-invariant ensemble (Goodman and Weare 2010; Foreman-Mackey et al. 2013).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from estimators.particles.friction_system import weight_per_mass
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectShape

MOST_FRICTION = 2.0
"""Upper end of the uniform prior of a friction, from 0; masses are uniform from 0 on."""
BURN_IN = 0.3
"""Part of the steps that is thrown away."""
LEAST_FRICTION = 1e-3
"""Least friction that a walker starts from."""
SPREAD = 0.05
"""First spread of the walkers where no covariance gives one, as a part of their start."""


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Whitened residuals of the trials: Q s - b of the friction loads, and a linear system in the masses."""

    shape: ObjectShape
    pairs: tuple[tuple[int, int], ...]
    """Mass and friction group of each s."""
    q: Float[np.ndarray, "R n_s"]
    b: Float[np.ndarray, "R"]
    fixed: Float[np.ndarray, "F n_m"]
    """Rows of the weight and the moments of inertia in the particle masses."""
    values: Float[np.ndarray, "F"]
    """Right-hand side of `fixed`."""

    def minus_log(
        self, mass: Float[np.ndarray, "... n_m"], friction: Float[np.ndarray, "... n_mu"]
    ) -> Float[np.ndarray, "..."]:
        """Minus log likelihood, up to a constant, at particle masses [kg] and frictions."""
        mass_groups, friction_groups = (list(groups) for groups in zip(*self.pairs, strict=True))
        loads = mass[..., mass_groups] * friction[..., friction_groups] * weight_per_mass(self.shape, self.pairs)
        residuals = np.concatenate([loads @ self.q.T - self.b, mass @ self.fixed.T - self.values], axis=-1)
        return np.sum(residuals**2, axis=-1) / 2

    def linear(self, friction: Float[np.ndarray, "n_mu"]) -> tuple[Float[np.ndarray, "R+F n_m"], np.ndarray]:
        """Design and right-hand side of the linear system in the particle masses at known friction."""
        columns, per_mass = np.zeros((len(self.q), self.shape.n_m)), weight_per_mass(self.shape, self.pairs)
        for k, (m, f) in enumerate(self.pairs):
            columns[:, m] += self.q[:, k] * friction[f] * per_mass[k]
        return np.vstack([columns, self.fixed]), np.concatenate([self.b, self.values])


@dataclass(frozen=True, eq=False)
class Posterior:
    """Draws from the posterior."""

    mass: Float[np.ndarray, "S n_m"]
    """Mass of each group [kg]."""
    friction: Float[np.ndarray, "S n_mu"]
    independent: float
    """Number of independent draws with as much information, by the longest autocorrelation time."""

    def interval(self, level: float) -> Float[np.ndarray, "n_m 2"]:
        """Central interval of each group's mass [kg] at a level in (0, 1)."""
        if not 0 < level < 1:
            raise InvalidValueError("level", level, "a number between 0 and 1")
        return np.quantile(self.mass, [(1 - level) / 2, (1 + level) / 2], axis=0).T


def sample_posterior(
    likelihood: Likelihood,
    start: MassDistribution,
    seed: int,
    *,
    covariance: Float[np.ndarray, "n_m n_m"] | None = None,
    walkers: int = 64,
    steps: int = 3000,
) -> Posterior:
    """Sample the posterior from an answer on.

    Args:
        likelihood: likelihood of the trials.
        start: answer to start from.
        seed: seed of the draws.
        covariance: covariance of the answer's particle masses [kg^2], infinite where open.
        walkers: number of walkers, at least twice the number of unknowns.
        steps: steps of each walker.

    Raises:
        InvalidValueError: too few walkers.
    """
    import emcee  # noqa: PLC0415  Algorithm 1 needs the likelihood alone

    n_m, n_mu = len(start.mass), len(start.friction)
    if walkers < 2 * (n_m + n_mu):
        raise InvalidValueError("walkers", walkers, f"at least {2 * (n_m + n_mu)}, two for every unknown")
    rng = np.random.default_rng(seed)
    typical = start.mass.mean()
    spread = np.full(n_m, SPREAD * typical)
    if covariance is not None:
        deviation = np.sqrt(np.diagonal(covariance))
        spread = np.where(np.isfinite(deviation), np.minimum(deviation, typical), spread)
    mass = start.mass + spread * rng.standard_normal((walkers, n_m))
    inverse = (1 + SPREAD * rng.standard_normal((walkers, n_mu))) / np.maximum(start.friction, LEAST_FRICTION)

    def log_probability(points: np.ndarray) -> np.ndarray:
        mass, inverse = points[:, :n_m], np.maximum(points[:, n_m:], 1e-12)
        allowed = (points >= 0).all(axis=1) & (inverse >= 1 / MOST_FRICTION).all(axis=1)
        jacobian = -2 * np.log(inverse).sum(axis=1)  # the prior is uniform in friction
        return np.where(allowed, jacobian - likelihood.minus_log(mass, 1 / inverse), -np.inf)

    # in (m, 1 / mu) the valley m mu = const is straight, and these moves care for no scale
    moves = [(emcee.moves.StretchMove(), 0.5), (emcee.moves.DEMove(), 0.5)]
    sampler = emcee.EnsembleSampler(walkers, n_m + n_mu, log_probability, vectorize=True, moves=moves)
    sampler.random_state = np.random.RandomState(seed).get_state()  # emcee takes no other
    sampler.run_mcmc(np.abs(np.hstack([mass, inverse])), steps)
    kept = np.array(sampler.get_chain(discard=round(BURN_IN * steps)))
    times = emcee.autocorr.integrated_time(kept, tol=0, quiet=True)
    draws = kept.reshape(-1, n_m + n_mu)
    count = likelihood.shape.particles_per_group
    return Posterior(draws[:, :n_m] * count, 1 / draws[:, n_m:], float(len(draws) / np.nanmax(times)))


def friction_profile(
    likelihood: Likelihood, friction: Float[np.ndarray, "n"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n n_m"]]:
    """Least minus log likelihood over non-negative masses at each friction, and those masses [kg], one a group.

    Raises:
        InvalidValueError: more than one friction group; with one, the masses follow by linear least squares.
    """
    if likelihood.shape.n_mu != 1:
        raise InvalidValueError("friction groups", likelihood.shape.n_mu, "one; sample the posterior of more")
    least, masses = np.empty(len(friction)), np.empty((len(friction), likelihood.shape.n_m))
    for i, mu in enumerate(friction):
        masses[i], residual = nnls(*likelihood.linear(np.array([mu])))
        least[i] = residual**2 / 2
    return least, masses * likelihood.shape.particles_per_group
