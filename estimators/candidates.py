"""Masses and frictions as a search sees them: what it draws, and what it descends in."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.prediction import Problem
from estimators.published import DENSEST, FRICTION_RANGE, LARGEST_SHARE
from testbed.objects import GRAVITY


@dataclass(frozen=True, eq=False)
class Candidates:
    """S guesses of mass and friction."""

    mass: Float[Tensor, "S n_m"]
    """Of a particle, kg."""
    friction: Float[Tensor, "S n_mu"]

    def __getitem__(self, index: Tensor | slice) -> Candidates:
        return Candidates(self.mass[index], self.friction[index])


def from_unit(problem: Problem, unit: Float[np.ndarray, "S n_mu+n_m"]) -> Candidates:
    """Points of the unit cube as candidates: frictions first, then each group's share of the typical mass."""
    low, high = FRICTION_RANGE
    n_mu = problem.shape.n_mu
    friction = low + (high - low) * torch.tensor(unit[:, :n_mu])
    largest = (LARGEST_SHARE * problem.typical_mass(friction.mean(-1))).clamp(max=densest(problem))
    return weighed(problem, Candidates(torch.tensor(unit[:, n_mu:]) * largest[:, None], friction))


def densest(problem: Problem) -> float:
    """Mass of a particle of the densest material that is drawn, kg; where M is known, M alone bounds it."""
    if problem.weight is not None:
        return math.inf
    return DENSEST * problem.shape.cell**2 * problem.shape.height


def weighed(problem: Problem, guesses: Candidates) -> Candidates:
    """The guesses, their masses scaled to M where M is known."""
    if problem.weight is None:
        return guesses
    total = (guesses.mass @ problem.per_group)[:, None]
    even = torch.full_like(guesses.mass, problem.weight / len(problem.shape.particles))
    mass = torch.where(total > 0, guesses.mass * problem.weight / total.clamp(min=1e-300), even)
    return Candidates(mass, guesses.friction)


@dataclass(frozen=True, eq=False)
class LogCoordinates:
    """Positive by parametrisation: logarithms of mass and friction, over those of a first guess."""

    problem: Problem
    first_friction: float
    """Friction to start from; the mass to start from is uniform, as in Algorithm 1."""

    @staticmethod
    def of(problem: Problem, seed: int) -> LogCoordinates:
        """About uniform mass.

        With M known the first friction is the largest drag over the weight, as in our method; without, `seed` draws it,
        and it decides.
        """
        first = float(np.random.default_rng(seed).uniform(*FRICTION_RANGE))
        if problem.weight is not None:
            first = problem.drag / (problem.weight * GRAVITY)
        return LogCoordinates(problem, first)

    @property
    def start(self) -> Float[Tensor, "n"]:
        """The first guess."""
        return torch.zeros(self.problem.shape.n_mu + self.problem.shape.n_m, dtype=torch.float64)

    def candidates(self, z: Float[Tensor, "S n"]) -> Candidates:
        """Mass and friction at points; with M known the masses are a softmax of it."""
        n_mu = self.problem.shape.n_mu
        friction = self.first_friction * z[:, :n_mu].exp()
        typical = self.problem.typical_mass(torch.tensor(self.first_friction, dtype=torch.float64))
        return weighed(self.problem, Candidates(typical * z[:, n_mu:].exp(), friction))
