"""What actions would show, before any trial: their steady windows with the errors that a sensor would leave in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from estimators.felt_load import load_map
from estimators.observations import Observations
from testbed.actions import Accelerate, Action, Lift, Rotate, Slide, TableAction, Weigh, pivot_of
from testbed.errors import InvalidValueError
from testbed.frames import move_wrench, rotation_2d
from testbed.objects import ObjectShape
from testbed.reduction import TRIM_END, TRIM_START, TRIM_STEP
from testbed.sensing import Sensing

RATE = 100.0
"""Samples a second."""
BEFORE = 4.3
"""From the middle of the tare to the first steady stretch, as the simulated bench takes it, s."""
BETWEEN = 0.8
"""From a turn to its turn back, s."""
TARED = 0.33
"""Of the tare that is used, s."""
REACH = 0.174
"""From the sensor to the TCP, m."""
HEIGHT = 0.022
"""Of the TCP over the table, m."""


@dataclass(frozen=True)
class _Stretch:
    """A steady stretch to come: velocity and rate of the grasp point, object axes, and the time since the tare."""

    twist: tuple[float, float, float]
    alpha: float
    begin: float
    end: float


def planned_observations(shape: ObjectShape, actions: Sequence[Action], sensing: Sensing) -> Observations | None:
    """The windows of some actions, their wrenches left at zero; None where no action moves the object over the table.

    The gripper carries nothing, as after nulling, as far as the sensor can tell. Lifts are left out, and numbered.

    Args:
        shape: geometry and grasps.
        actions: what would be done.
        sensing: how the sensor errs.

    Raises:
        InvalidValueError: a grasp that the shape does not have.
    """
    stretches, trial, grasp = [], [], []
    for index, action in enumerate(actions):
        if isinstance(action, Weigh | Lift):
            continue
        if action.grasp >= len(shape.grasps):
            raise InvalidValueError("action.grasp", action.grasp, f"one of the shape's {len(shape.grasps)} grasps")
        found = _stretches(shape, action)
        stretches += [(stretch, isinstance(action, Accelerate)) for stretch in found]
        trial += [index] * len(found)
        grasp += [action.grasp] * len(found)
    if not stretches:
        return None
    count = len(stretches)
    points = np.array([shape.grasps[g].position for g in grasp])
    nearest = np.linalg.norm(shape.particles[None] - points[:, None], axis=-1).argmin(axis=1)
    noise, bias, drift = (torch.tensor(each).expand(count, 6, 6) for each in sensor_at_tcp(sensing))
    since_tare = torch.tensor([(s.begin, s.end) for s, _ in stretches], dtype=torch.float64)
    twist = torch.tensor([s.twist for s, _ in stretches], dtype=torch.float64)
    zeros = torch.zeros(count, dtype=torch.float64)
    return Observations(
        wrench=torch.zeros(count, 3, dtype=torch.float64),
        noise=noise / since_tare.diff()[..., None],
        bias=bias,
        drift=drift,
        since_tare=since_tare,
        twist=twist,
        twists=twist[:, None],
        acceleration=torch.tensor([(0.0, 0.0, s.alpha) for s, _ in stretches], dtype=torch.float64),
        spin_square=twist[:, 2].square(),
        grasp=torch.tensor(points),
        lift=zeros,
        tilt=torch.zeros(count, 2, dtype=torch.float64),
        yaw=torch.zeros(count, 2, dtype=torch.float64),
        load_map=torch.tensor(load_map(HEIGHT)).expand(count, 3, 6),
        load_kept=torch.full((count, 3), float(sensing.force_bias == 0), dtype=torch.float64),
        load_followed=torch.ones(count, 3, dtype=torch.float64),
        held=torch.tensor(shape.mass_group[nearest]),
        trial=torch.tensor(trial),
        accelerated=torch.tensor([accelerated for _, accelerated in stretches]),
    )


def sensor_at_tcp(sensing: Sensing) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Covariances of a sensor's errors about the TCP, axes up, each (6, 6).

    Those of the noise of a mean over one second, of what the tare leaves, and of what the zero walks in one second.
    """
    std = np.array([*sensing.force_noise, *sensing.torque_noise])
    std[[0, 1, 3, 4]] = np.sqrt((std[[0, 0, 3, 3]] ** 2 + std[[1, 1, 4, 4]] ** 2) / 2)  # whichever way the hand turned
    noise = std**2 / (RATE * (1 - sensing.lag1) / (1 + sensing.lag1))
    down = move_wrench(np.eye(6), np.array([0.0, 0.0, -REACH])).T
    each = (noise, sensing.bias_std**2 + noise / TARED, sensing.drift_std**2)
    first, second, third = (down @ np.diag(variance) @ down.T for variance in each)
    return first, second, third


def _stretches(shape: ObjectShape, action: TableAction) -> list[_Stretch]:
    """Steady stretches of one action, trimmed as a record is."""
    if isinstance(action, Slide):
        along = rotation_2d(action.direction) @ [action.speed, 0.0]
        return [_Stretch((along[0], along[1], 0.0), 0.0, BEFORE + TRIM_START, BEFORE + action.duration - TRIM_END)]
    if isinstance(action, Rotate):
        (at_x, at_y), (about_x, about_y) = shape.grasps[action.grasp].position, pivot_of(action, shape)
        x, y = -action.speed * (at_y - about_y), action.speed * (at_x - about_x)
        there = _Stretch((x, y, action.speed), 0.0, BEFORE + TRIM_START, BEFORE + action.duration - TRIM_END)
        later = action.duration + BETWEEN
        back = _Stretch((-x, -y, -action.speed), 0.0, there.begin + later, there.end + later)
        return [there, back] if action.back else [there]
    sign, time, found = math.copysign(1.0, action.start_speed), BEFORE, []
    for alpha in action.accelerations:
        found.append(_Stretch((0.0, 0.0, sign), alpha, time + TRIM_STEP, time + action.hold - TRIM_END))
        time += action.hold
    return found
