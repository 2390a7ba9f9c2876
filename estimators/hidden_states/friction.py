"""Solvers of Q s = b for the friction loads s, Eq. problem_si: closed form and gradient descent."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import nnls

from estimators.base import Trace
from estimators.descent import descend
from estimators.hidden_states.equations import LinearSystem

CONTRADICTORY = 5e4
"""Mean squared residual, in units of the errors, above which trials are contradictory.

It is about 1 on own weight and up to 2e4 under one rigid body; a trial with its sign turned makes it 1e5 and more.
"""


def closed_form(system: LinearSystem) -> Float[np.ndarray, "n_s"]:
    """Non-negative least squares: the exact minimum of Eq. problem_si over s >= 0."""
    return nnls(system.q.numpy(), system.b.numpy())[0]


def closed_form_covariance(system: LinearSystem) -> Float[np.ndarray, "n_s n_s"]:
    """Covariance (Q^T Q)^-1 of the whitened system, by the pseudo-inverse; meaningful only where rank(Q) = n_s."""
    return np.linalg.pinv((system.q.T @ system.q).numpy(), rcond=1e-12, hermitian=True)


def descend_loads(
    system: LinearSystem, optimizers: tuple[str, ...], steps: int, robot_seconds: float
) -> tuple[Float[np.ndarray, "n_s"], tuple[Trace, ...]]:
    """Gradient descent on Eq. problem_si from s = 0 (Algorithm 1 starts with zero friction); the best of `optimizers`.

    In coordinates of unit curvature (s = L^-T z with L L^T = Q^T Q): with pivots in a row the loss is a narrow valley,
    in which no first-order method converges in 500 steps. The result is clipped to s >= 0.
    """
    lower = torch.linalg.cholesky(system.q.T @ system.q)
    to_s = torch.linalg.inv(lower).T
    q = system.q @ to_s
    first = 0.1 * float(system.b.norm() / q.shape[1] ** 0.5)
    rates = {"adam": first, "rmsprop": first, "plain": 0.1 * len(q)}
    runs = descend(
        lambda z: (z @ q.T - system.b).square().mean(-1),
        torch.zeros(q.shape[1], dtype=torch.float64),
        {name: rates[name] for name in optimizers},
        steps,
        robot_seconds=robot_seconds,
    )
    return (to_s @ runs[0].best).clamp(min=0.0).numpy(), tuple(run.trace for run in runs)
