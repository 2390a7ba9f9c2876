"""The posterior of masses and frictions by sampling, for where no Gaussian will do: at a bound, or along m mu = const.

The sampler is emcee's affine-invariant ensemble (Goodman and Weare 2010; Foreman-Mackey et al. 2013).
"""

from __future__ import annotations

from dataclasses import dataclass

import emcee
import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from estimators.identifiability.information import Likelihood
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution

MOST_FRICTION = 2.0
"""Friction is even from 0 to here beforehand, masses from 0 on."""
BURNT = 0.3
"""Part of the steps that is thrown away."""
LEAST_FRICTION = 1e-3
"""No walker starts below."""
FREE = 0.05
"""First spread of the walkers where no Gaussian says how wide, as a part of what they start from."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Draws from the posterior."""

    mass: Float[np.ndarray, "S n_m"]
    """kg a group."""
    friction: Float[np.ndarray, "S n_mu"]
    independent: float
    """Draws that these are worth, from the longest autocorrelation time among the unknowns."""

    def interval(self, level: float) -> Float[np.ndarray, "n_m 2"]:
        """Of each group's mass, kg: as much left out below as above."""
        if not 0 < level < 1:
            raise InvalidValueError("level", level, "a number between 0 and 1")
        return np.quantile(self.mass, [(1 - level) / 2, (1 + level) / 2], axis=0).T


def sample_posterior(
    evidence: Likelihood,
    start: MassDistribution,
    seed: int,
    *,
    covariance: Float[np.ndarray, "n_m n_m"] | None = None,
    walkers: int = 64,
    steps: int = 3000,
) -> Posterior:
    """Draw from it.

    Args:
        evidence: what the trials say.
        start: an answer to start from.
        seed: of the draws.
        covariance: Gaussian of the particle masses about the answer, kg^2, infinite where open.
        walkers: at least twice the number of unknowns.
        steps: of every walker.

    Raises:
        InvalidValueError: too few walkers.
    """
    n_m, n_mu = len(start.mass), len(start.friction)
    if walkers < 2 * (n_m + n_mu):
        raise InvalidValueError("walkers", walkers, f"at least {2 * (n_m + n_mu)}, two for every unknown")
    rng = np.random.default_rng(seed)
    typical = start.mass.mean()
    spread = np.full(n_m, FREE * typical)
    if covariance is not None:
        deviation = np.sqrt(np.diagonal(covariance))
        spread = np.where(np.isfinite(deviation), np.minimum(deviation, typical), spread)
    first = np.abs(
        np.hstack(
            [
                start.mass + spread * rng.standard_normal((walkers, n_m)),
                (1 + FREE * rng.standard_normal((walkers, n_mu))) / np.maximum(start.friction, LEAST_FRICTION),
            ]
        )
    )

    def log_probability(points: np.ndarray) -> np.ndarray:
        mass, slipperiness = points[:, :n_m], np.maximum(points[:, n_m:], 1e-12)
        allowed = (points >= 0).all(axis=1) & (slipperiness >= 1 / MOST_FRICTION).all(axis=1)
        even = -2 * np.log(slipperiness).sum(axis=1)  # in friction
        return np.where(allowed, even - evidence.minus_log_likelihood(mass, 1 / slipperiness), -np.inf)

    # in (m, 1 / mu) the valley m mu = const is straight, and these moves care for no scale
    moves = [(emcee.moves.StretchMove(), 0.5), (emcee.moves.DEMove(), 0.5)]
    sampler = emcee.EnsembleSampler(walkers, n_m + n_mu, log_probability, vectorize=True, moves=moves)
    sampler.random_state = np.random.RandomState(seed).get_state()  # emcee takes no other
    sampler.run_mcmc(first, steps)
    kept = np.array(sampler.get_chain(discard=round(BURNT * steps)))
    times = emcee.autocorr.integrated_time(kept, tol=0, quiet=True)
    draws = kept.reshape(-1, n_m + n_mu)
    count = evidence.shape.particles_per_group
    return Posterior(draws[:, :n_m] * count, 1 / draws[:, n_m:], float(len(draws) / np.nanmax(times)))


def friction_profile(
    evidence: Likelihood, friction: Float[np.ndarray, "n"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n n_m"]]:
    """Least of the minus log likelihood over non-negative masses at each friction, and those masses, kg a group.

    For one friction group: then the masses follow by linear least squares.

    Raises:
        InvalidValueError: more than one friction group.
    """
    if evidence.shape.n_mu != 1:
        raise InvalidValueError("friction groups", evidence.shape.n_mu, "one; sample the posterior of more")
    least, masses = np.empty(len(friction)), np.empty((len(friction), evidence.shape.n_m))
    for i, mu in enumerate(friction):
        masses[i], residual = nnls(*evidence.linear(np.array([mu])))
        least[i] = residual**2 / 2
    return least, masses * evidence.shape.particles_per_group
