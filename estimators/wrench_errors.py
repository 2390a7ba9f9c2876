"""Covariance of what is felt: the sensor's errors, the model's, and what the gripper carries unseen.

The one place where errors become weights, whoever carries the object's weight.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.dynamics import ParticleModel
from estimators.model_errors import ModelErrors
from estimators.observations import Observations


def wrench_errors(
    windows: Observations,
    model: ParticleModel,
    drag: Float[Tensor, "K P"],
    response: Float[Tensor, "K 3 3"],
    errors: ModelErrors,
) -> tuple[Float[Tensor, "R R"], Float[Tensor, "R 2"]]:
    """Errors of wrenches less what the gripper carries: R = 3 K rows.

    Args:
        windows: of constant speed.
        model: the object.
        drag: friction of every particle, N.
        response: change of the wrench with lift and tilt, N/N and N m/N m, (f_x, f_y, torque).
        errors: of the model.

    Returns:
        Covariance of what no two trials share, and what one standard deviation of the lift and of the height that all
        windows share adds to each row.
    """
    slopes = windows.drag_slopes(model, drag, errors.pivot_error)
    force = (errors.force_error * drag.sum(-1)).square()
    own = torch.stack([force, force, (errors.torque_error * windows.wrench[:, 2]).square()], -1) + 1e-10
    moved = errors.pivot_error * windows.twist[:, 2].abs()[:, None, None] * slopes[..., :2]
    by_motion = torch.cat([moved, slopes * windows.twist_noise.sqrt()], -1)
    within = torch.diag_embed(own) + by_motion @ by_motion.transpose(1, 2)
    lift, tilt = errors.lift_error, errors.tilt_error
    shared = torch.tensor([lift / 2**0.5, 0.0, 0.0], dtype=torch.float64)
    alone = torch.tensor([lift / 2**0.5, tilt, tilt], dtype=torch.float64)
    apart = windows.sensor_error(response) + windows.unseen_load(response, alone, shared) + torch.block_diag(*within)
    hidden = (response * (shared * (1 - windows.load_kept))[:, None]).sum(-1)
    # the drag's own moment about the feet is as wrong as the height over them
    raised = errors.height_error * (response[..., 1:] @ windows.wrench[:, :2, None])[..., 0]
    return apart, torch.stack([hidden.flatten(), raised.flatten()], 1)


def torque_covariance(windows: Observations, response: Float[Tensor, "K 3 3"]) -> Float[np.ndarray, "K K"]:
    """Of accelerated windows' torques less what the gripper carries; a trial's constant is not in it."""
    none = torch.zeros(3, dtype=torch.float64)
    whole = windows.sensor_error(response) + windows.unseen_load(response, none, none)
    return whole[2::3, 2::3].numpy()
