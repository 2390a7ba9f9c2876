"""Draws of masses and frictions by their values and covariance: what trials show of them is kept."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from estimators.posterior.unknowns import SMALLEST
from estimators.support_models.polytope import MassPolytope
from testbed.objects.model import ObjectShape


def draws_of(
    shape: ObjectShape, found: Float[np.ndarray, "n"], covariance: Float[np.ndarray, "n n"], count: int, seed: int
) -> tuple[Float[np.ndarray, "count n_m"], Float[np.ndarray, "count n_mu"]]:
    """Draws of the groups' masses, kg, and of the frictions.

    The trials show products of masses and frictions: those of each group are normal, cut at 0, and the frictions
    log-normal. Masses are then scaled to a draw of M, and frictions inversely, which keeps the products.

    Args:
        shape: geometry and groups.
        found: mass of each group, kg, then the frictions.
        covariance: their covariance.
        count: number of draws.
        seed: seed of the draws.
    """
    rng, groups = np.random.default_rng(seed), shape.n_m
    mass, friction = np.split(found, [groups])
    shares = friction_shares(shape)
    relative = np.hstack([np.diag(1 / mass), shares / np.maximum(shares @ friction, SMALLEST)[:, None]])
    of_drag, of_mass = np.diag(relative @ covariance @ relative.T), np.diag(covariance)[:groups] / mass**2
    # of a group that touches nothing, or whose mass is known better than its drag, the mass takes its place
    shares[of_mass < of_drag] = 0.0
    bare = 1 - shares.sum(1)
    along = shares @ friction + bare
    slopes = np.eye(len(found))
    slopes[:groups] = np.hstack([np.diag(along), mass[:, None] * shares])
    slopes[groups:, groups:] = np.diag(1 / friction)
    spread, drag = slopes @ covariance @ slopes.T, along * mass
    white = np.linalg.inv(np.linalg.cholesky(spread[:groups, :groups]))
    drags = MassPolytope(white, white @ drag).draws(count, seed)
    onto = white.T @ white @ spread[:groups, groups:]
    left = spread[groups:, groups:] - spread[groups:, :groups] @ onto
    own_scatter = rng.multivariate_normal(np.zeros(shape.n_mu), left, count, method="eigh")
    frictions = friction * np.exp((drags - drag) @ onto + own_scatter)
    masses = drags / (frictions @ shares.T + bare)
    whole = rng.normal(mass.sum(), math.sqrt(covariance[:groups, :groups].sum()), (count, 1))
    scale = whole / masses.sum(1, keepdims=True)
    return masses * scale, frictions / scale


def friction_shares(shape: ObjectShape) -> Float[np.ndarray, "n_m n_mu"]:
    """Part of each group's feet that has each friction; zeros of a group without feet."""
    feet = shape.friction_group >= 0
    count = np.zeros((shape.n_m, shape.n_mu))
    np.add.at(count, (shape.mass_group[feet], shape.friction_group[feet]), 1.0)
    return count / np.maximum(shape.feet_per_group, 1)[:, None]
