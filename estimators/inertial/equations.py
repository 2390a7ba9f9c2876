"""Linear equations of the inertial parameters, from the wrench and the motion of a held body in the air."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.func import vmap

from estimators.inertial.body import SIZE
from estimators.wrench.air import Matter
from testbed.errors import InvalidValueError
from testbed.objects.model import GRAVITY
from testbed.sensing.presets import Sensing
from testbed.validation import freeze_arrays

WALK_TERMS = 8, 120
"""Least and largest number of terms of the sensor's random walk, one per second of a motion; the others have
2 / (pi^2 n) of its variance."""
LEAST_NOISE = np.repeat([1e-6, 1e-7], 3)
"""Least standard deviation of a wrench, N and N m, for sensors without noise."""
SLOW = 1.0, 1.0
"""Acceleration [m/s^2] and angular acceleration [rad/s^2] below which a body rests, for HPS as published."""


@dataclass(frozen=True, eq=False)
class HeldMotion:
    """Motion of a held body and the wrench on it, T samples, in axes fixed to it; moments about their origin."""

    time_s: Float[np.ndarray, "T"]
    """Time, s."""
    pull: Float[np.ndarray, "T 3"]
    """Acceleration of the origin less gravity, m/s^2."""
    rate: Float[np.ndarray, "T 3"]
    """Angular velocity, rad/s."""
    angular_acceleration: Float[np.ndarray, "T 3"]
    """Angular acceleration, rad/s^2."""
    wrench: Float[np.ndarray, "T 6"]
    """Force and torque on the body, N and N m."""

    def __post_init__(self) -> None:
        count = len(self.time_s)
        freeze_arrays(
            self, time_s=(None,), pull=(count, 3), rate=(count, 3), angular_acceleration=(count, 3), wrench=(count, 6)
        )
        if count < 2 or not (np.diff(self.time_s) > 0).all():
            raise InvalidValueError("HeldMotion.time_s", f"{count} samples", "two or more, their times rising, s")

    @property
    def regressor(self) -> Float[np.ndarray, "T 6 10"]:
        """Wrench per unit of each inertial parameter."""
        products = np.einsum("ti,tj->tij", self.rate, self.rate)
        return regressor(self.pull, self.angular_acceleration, products)


@dataclass(frozen=True, eq=False)
class InertialEquations:
    """Ten independent equations of unit error of the ten inertial parameters, and the misfit of those compressed."""

    rows: Float[np.ndarray, "10 10"]
    """Coefficients of the parameters."""
    values: Float[np.ndarray, "10"]
    """Measured values of the rows."""
    misfit: float
    """Squared residual over its variance, mean over degrees of freedom, at the best parameters."""
    freedom: int
    """Degrees of freedom of the misfit; negative where rows are fewer than parameters."""

    @property
    def scale(self) -> Float[np.ndarray, "10"]:
        """Norm of the column of each parameter; 1 for a column of zeros."""
        scale = np.linalg.norm(self.rows, axis=0)
        return np.where(scale > 0, scale, 1.0)

    @property
    def directions(self) -> Float[np.ndarray, "10 rank"]:
        """Directions of the values that some parameters explain, as columns; the others hold noise alone."""
        left, strength, _ = np.linalg.svd(self.rows / self.scale)
        return left[:, strength > 1e-6 * strength[0]]

    @property
    def unseen(self) -> Float[np.ndarray, "10 10-rank"]:
        """Directions of the parameters, each times its scale, that no equation shows, as orthonormal columns."""
        return np.linalg.svd(self.rows / self.scale)[2][self.rank :].T

    @property
    def rank(self) -> int:
        """Rank of the equations, at most ten."""
        return self.directions.shape[1]


def regressor(
    pull: Float[np.ndarray, "T 3"], angular_acceleration: Float[np.ndarray, "T 3"], products: Float[np.ndarray, "T 3 3"]
) -> Float[np.ndarray, "T 6 10"]:
    """Wrench per unit of each inertial parameter (Atkeson, An, Hollerbach 1986).

    It is linear in all arguments, so that their means give the mean.

    Args:
        pull: acceleration of the origin less gravity, m/s^2.
        angular_acceleration: rad/s^2.
        products: products of the components of the angular velocity, rad^2/s^2.
    """

    def of(body: Tensor, *motion: Tensor) -> Tensor:
        return Matter.of_vector(body).wrench(*motion)

    motions = [torch.tensor(each) for each in (pull, angular_acceleration, products)]
    of_each = vmap(vmap(of, (0, None, None, None), 1), (None, 0, 0, 0))
    return of_each(torch.eye(SIZE, dtype=torch.float64), *motions).numpy()


def inertial_equations(
    motion: HeldMotion, sensing: Sensing, *, block: int = 10, still_only: bool = False
) -> InertialEquations:
    """Equations of a motion, weighted by the sensor's noise, one bias, and the random walk of its zero.

    Wrench and regressor are averaged over blocks, which is exact, since the equations are linear: noise of the
    accelerations, which biases the inertia downwards, averages out.

    Args:
        motion: motion of the body.
        sensing: errors of the sensor as stated.
        block: number of samples in a block.
        still_only: True leaves out blocks in which the body accelerates by more than `SLOW`.

    Raises:
        InvalidValueError: no block is left.
    """
    count = len(motion.time_s) // block * block
    rows = _means(motion.regressor[:count], block)
    wrench, time = _means(motion.wrench[:count], block), _means(motion.time_s[:count], block)
    kept = _rests(motion, count, block) if still_only else np.ones(len(time), dtype=bool)
    if not kept.any():
        allowed = f"{block} or more in a row{', at rest' * still_only}"
        raise InvalidValueError("motion", f"{len(motion.time_s)} samples", allowed)
    rows, wrench, time = rows[kept], wrench[kept], time[kept]
    noise = np.array([*sensing.force_noise, *sensing.torque_noise])
    noise = np.sqrt((noise**2 * (1 + sensing.lag1) / (1 - sensing.lag1) + LEAST_NOISE**2) / block)
    moved = _acceleration_noise(rows, wrench, sensing) / np.sqrt(block)
    error = np.hypot(noise, moved)
    walk = _walk(time - motion.time_s[0], float(np.ptp(motion.time_s)))
    columns = [np.ones(len(time))[:, None] * sensing.bias_std[None]]
    columns += [walk[:, k, None] * sensing.drift_std[None] for k in range(walk.shape[1])]
    return compressed(rows, wrench, error, np.stack(columns, -1))


def compressed(
    rows: Float[np.ndarray, "K 6 10"],
    wrench: Float[np.ndarray, "K 6"],
    error: Float[np.ndarray, "6"],
    shared: Float[np.ndarray, "K 6 E"],
) -> InertialEquations:
    """Ten rows equivalent to equations of blocks with independent errors and errors that all blocks share.

    Args:
        rows: regressor of each block.
        wrench: wrench of each block, N and N m.
        error: standard deviation of each component, N and N m.
        shared: effect of one standard deviation of each of E shared errors per component, N and N m.
    """
    count, terms = len(wrench), shared.shape[2]
    effects = np.einsum("kae,ab->kabe", shared / error[:, None], np.eye(6)).reshape(6 * count, 6 * terms)
    whole = np.hstack([effects, (rows / error[:, None]).reshape(-1, SIZE), (wrench / error).reshape(-1, 1)])
    prior = np.hstack([np.eye(6 * terms), np.zeros((6 * terms, SIZE + 1))])
    return _as_ten_rows(np.vstack([prior, whole]), 6 * terms)


def compressed_rows(
    rows: Float[np.ndarray, "R 10"], values: Float[np.ndarray, "R"], covariance: Float[np.ndarray, "R R"]
) -> InertialEquations:
    """Ten rows equivalent to equations whose errors have a given covariance."""
    whole = np.linalg.solve(np.linalg.cholesky(covariance), np.column_stack([rows, values]))
    return _as_ten_rows(whole, 0)


def joined(equations: Sequence[InertialEquations]) -> InertialEquations:
    """Ten rows equivalent to the equations of independent motions of one body."""
    stacked = np.hstack(
        [np.vstack([e.rows for e in equations]), np.concatenate([e.values for e in equations])[:, None]]
    )
    triangle = np.asarray(np.linalg.qr(stacked, mode="r"))
    freedom = sum(e.freedom for e in equations) + SIZE * (len(equations) - 1)
    residual = sum(e.misfit * max(e.freedom, 1) for e in equations)
    residual += float(triangle[SIZE, SIZE] ** 2) if len(triangle) > SIZE else 0.0
    return InertialEquations(triangle[:SIZE, :SIZE], triangle[:SIZE, SIZE], residual / max(freedom, 1), freedom)


def _as_ten_rows(whole: Float[np.ndarray, "R n"], nuisance: int) -> InertialEquations:
    """Ten rows of whitened equations, with values in the last column, the first `nuisance` unknowns marginalized."""
    triangle = np.asarray(np.linalg.qr(whole, mode="r"))
    left = np.zeros((SIZE + 1, SIZE + 1))
    part = triangle[nuisance : nuisance + SIZE + 1, nuisance:]
    left[: len(part)] = part
    freedom = len(whole) - nuisance - SIZE
    return InertialEquations(
        left[:SIZE, :SIZE], left[:SIZE, SIZE], float(left[SIZE, SIZE] ** 2) / max(freedom, 1), freedom
    )


def _rests(motion: HeldMotion, count: int, block: int) -> Bool[np.ndarray, "K"]:
    """True for blocks with accelerations below `SLOW`."""
    linear = np.abs(np.linalg.norm(_means(motion.pull[:count], block), axis=1) - GRAVITY)
    angular = np.linalg.norm(_means(motion.angular_acceleration[:count], block), axis=1)
    return (linear < SLOW[0]) & (angular < SLOW[1])


def _means(values: np.ndarray, block: int) -> np.ndarray:
    return values.reshape(-1, block, *values.shape[1:]).mean(axis=1)


def _acceleration_noise(rows: np.ndarray, wrench: np.ndarray, sensing: Sensing) -> Float[np.ndarray, "6"]:
    """Error of each component of a wrench by one sample's noise of the accelerations, N and N m."""
    linear, angular = sensing.linear_acceleration_noise, sensing.angular_acceleration_noise
    if not (linear or angular):
        return np.zeros(6)
    fit = np.linalg.lstsq(rows.reshape(-1, SIZE), wrench.ravel(), rcond=1e-9)[0]
    eye, none = np.eye(3), np.zeros((3, 3))
    by_pull = regressor(eye, none, np.zeros((3, 3, 3))) @ fit
    by_spin = regressor(none, eye, np.zeros((3, 3, 3))) @ fit
    return np.sqrt(((linear * by_pull) ** 2 + (angular * by_spin) ** 2).sum(axis=0))


def _walk(since: Float[np.ndarray, "K"], length: float) -> Float[np.ndarray, "K n"]:
    """Eigenfunctions of a random walk of variance 1 per second, times their standard deviations (Karhunen, Loeve)."""
    turns = (np.arange(int(np.clip(math.ceil(length), *WALK_TERMS))) + 0.5) * np.pi
    return np.sqrt(2 * length) / turns * np.sin(turns * since[:, None] / length)
