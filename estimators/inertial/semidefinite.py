"""Least squares on physically consistent inertial parameters: a semidefinite program (Wensing, Kim, Slotine 2018)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
from jaxtyping import Float
from scipy import sparse

from estimators.inertial.body import SIZE, InertialParameters, pseudo_inertia
from estimators.inertial.equations import InertialEquations
from estimators.inertial.estimate import OPEN, InertialEstimate, drawn_values, is_observed
from testbed.errors import HeftError
from testbed.validation import freeze_arrays

CONES: Any = clarabel  # untyped
TYPICAL_SIZE = 0.1
"""Assumed half size of a body without an ellipsoid, m; it scales the program without bounding the body."""
SLACK = 1e-7
"""Slack of the bounds, in units of the body's mass and size, for parameters that lie on them."""
NAME = "consistent_inertia: the semidefinite program"
_TRIANGLE = [(i, j) for j in range(4) for i in range(j + 1)]
"""Entries of a symmetric 4 x 4 matrix as the solver counts them: the upper triangle, column by column."""


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """Ellipsoid along the axes of a body that contains all of it."""

    center: Float[np.ndarray, "3"]
    """Center, m."""
    half: Float[np.ndarray, "3"]
    """Half axes, m."""

    def __post_init__(self) -> None:
        freeze_arrays(self, center=(3,), half=(3,))

    @staticmethod
    def around(low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> Ellipsoid:
        """Smallest ellipsoid around a box from `low` to `high`, m."""
        return Ellipsoid((low + high) / 2, np.maximum(high - low, 1e-4) / 2 * math.sqrt(3))


def consistent_inertia(
    equations: InertialEquations, within: Ellipsoid | None = None, seed: int = 0
) -> InertialEstimate:
    """Least-squares parameters of a body of positive density that lies `within` an ellipsoid.

    Draws are such parameters for draws of the equations' values; where a bound is active they lie on it. Along
    directions that the equations do not show they lie on the bounds of a body within the ellipsoid, in directions drawn
    at random; without an ellipsoid parameters and draws are NaN there.

    Args:
        equations: equations of the body.
        within: ellipsoid that contains the body; None for no bound.
        seed: seed of the draws.

    Raises:
        HeftError: the solver finds no solution.
    """
    plain = np.linalg.lstsq(
        equations.rows, np.column_stack([equations.values, drawn_values(equations, seed).T]), rcond=1e-12
    )
    program = _Program(equations, within)
    solved = np.array([program.nearest(each) for each in plain[0].T])
    if within is None:
        solved[:, ~is_observed(equations)] = np.nan
    elif equations.rank < SIZE:
        unseen = np.linalg.qr(program.entries @ (equations.unseen / equations.scale[:, None]))[0]
        ways = np.random.default_rng([seed, 1]).standard_normal((len(solved) - 1, unseen.shape[1])) @ unseen.T
        solved[1:] = [program.farthest(*each, unseen) for each in zip(solved[1:], ways, strict=True)]
    message = OPEN if equations.rank < SIZE else ""
    return InertialEstimate(InertialParameters.of_vector(solved[0]), solved[1:], equations.misfit, message)


class _Program:
    """Program min |R (x - x_0)|^2 with P(x) positive semidefinite, in the entries of P about the body's middle."""

    def __init__(self, equations: InertialEquations, within: Ellipsoid | None):
        fit = np.linalg.lstsq(equations.rows, equations.values, rcond=1e-9)[0]
        self.mass = max(abs(float(fit[0])), 1e-6)
        center, half = (within.center, within.half) if within else (fit[1:4] / self.mass, np.full(3, TYPICAL_SIZE))
        about = np.eye(4)  # a congruence, which keeps definiteness
        about[:3, :3], about[:3, 3] = np.diag(1 / half), -center / half
        parts = [about @ pseudo_inertia(one) @ about.T for one in np.eye(SIZE)]
        entries = np.array([[(2**0.5 if i != j else 1.0) * part[i, j] for part in parts] for i, j in _TRIANGLE])
        self.entries = entries / self.mass
        self.rows = equations.rows @ np.linalg.inv(self.entries)
        self.rows /= np.linalg.norm(self.rows)
        blocks, self.cones = [np.eye(SIZE)], [CONES.PSDTriangleConeT(4)]
        if within is not None:
            inside = np.diag([-1.0, -1.0, -1.0, 1.0])  # tr(P Q) >= 0 with the quadric Q of the unit sphere
            blocks.append(np.array([[inside[i, j] for i, j in _TRIANGLE]]))
            self.cones.append(CONES.NonnegativeConeT(1))
        self.bounds = np.vstack(blocks)
        self.quadratic = sparse.csc_matrix(np.triu(self.rows.T @ self.rows))

    def farthest(
        self, start: Float[np.ndarray, "10"], way: Float[np.ndarray, "10"], unseen: Float[np.ndarray, "10 k"]
    ) -> Float[np.ndarray, "10"]:
        """Consistent parameters from `start` as far along `way` as the bounds let them, within directions `unseen`.

        Both directions are in the entries of P.
        """
        slack = SLACK * np.array([float(i == j) for i, j in _TRIANGLE] + [1.0])[: len(self.bounds)]
        program = -unseen.T @ way, sparse.csc_matrix(-self.bounds @ unseen), self.bounds @ self.entries @ start + slack
        none = sparse.csc_matrix((unseen.shape[1], unseen.shape[1]))
        return start + np.linalg.solve(self.entries, unseen @ minimizer(NAME, none, *program, self.cones))

    def nearest(self, plain: Float[np.ndarray, "10"]) -> Float[np.ndarray, "10"]:
        """Least-squares consistent parameters, from the unbounded least-squares parameters `plain`."""
        start = self.entries @ plain
        whole = np.zeros((4, 4))
        for value, (i, j) in zip(start, _TRIANGLE, strict=True):
            whole[i, j] = whole[j, i] = value / (2**0.5 if i != j else 1.0)
        if np.linalg.eigvalsh(whole)[0] >= 0 and (self.bounds[SIZE:] @ start >= 0).all():
            return plain
        linear = -self.rows.T @ (self.rows @ start)
        program = self.quadratic, linear, sparse.csc_matrix(-self.bounds), np.zeros(len(self.bounds)), self.cones
        return np.linalg.solve(self.entries, minimizer(NAME, *program))


def minimizer(name: str, *program: Any) -> np.ndarray:
    """Minimizer of a program: quadratic and linear terms, matrix, bounds and cones, as arguments of clarabel.

    Raises:
        HeftError: the solver finds no solution.
    """
    settings = CONES.DefaultSettings()
    settings.verbose = False
    found = CONES.DefaultSolver(*program, settings).solve()
    if str(found.status) not in ("Solved", "AlmostSolved"):
        raise HeftError(f"{name} ended as {found.status}")
    return np.array(found.x)
