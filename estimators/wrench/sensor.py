"""Errors of the reading of a wrist sensor, and the random walk of its zero."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.wrench.jacobian import NONE, Theta


def flawed(theta: Theta, reading: Float[Tensor, "6"]) -> Float[Tensor, "6"]:
    """Reading of the sensor with its errors, N and N m, from the reading without any."""
    if "mounting_angle" in theta:
        angle = theta["mounting_angle"].expand(2, 3)
        reading = reading + torch.linalg.cross(angle, reading.reshape(2, 3)).flatten()
    crossed = theta["crosstalk"] @ reading if "crosstalk" in theta else 0.0
    return reading * (1 + theta.get("gain", NONE)) + crossed


def walk(since_tare: Float[Tensor, "*B K 2"]) -> Float[Tensor, "*B K K"]:
    """Covariance of the means over windows of a random walk of variance 1 per second that starts at the tare, s.

    Args:
        since_tare: times of each window's first and last sample, s.
    """
    begin, end = since_tare.unbind(-1)
    middle = (begin + end) / 2
    # covariance of the walk at two times: the earlier one
    walked = torch.minimum(middle[..., :, None], middle[..., None, :])
    walked.diagonal(dim1=-2, dim2=-1).copy_(begin + (end - begin) / 3)
    return walked
