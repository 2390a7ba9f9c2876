"""Reading of a wrist sensor as its errors change it."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.wrench.jacobian import NONE, Theta


def flawed(theta: Theta, reading: Float[Tensor, "6"]) -> Float[Tensor, "6"]:
    """Reading of the sensor, N and N m, of one that it would show without any error."""
    if "mounting_angle" in theta:
        angle = theta["mounting_angle"].expand(2, 3)
        reading = reading + torch.linalg.cross(angle, reading.reshape(2, 3)).flatten()
    crossed = theta["crosstalk"] @ reading if "crosstalk" in theta else 0.0
    return reading * (1 + theta.get("gain", NONE)) + crossed
