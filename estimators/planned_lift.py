"""The windows that a lift would give, before any trial, with the errors that a sensor would leave in them."""

from __future__ import annotations

import numpy as np

from estimators.planned import BEFORE, HEIGHT, RATE, sensor_at_tcp
from testbed.actions import Lift
from testbed.lift_profile import LiftProfile
from testbed.lift_reduction import LiftWindow
from testbed.objects import GRAVITY
from testbed.reduction import TRIM_END, trim_start
from testbed.sensing import Sensing


def planned_lift(action: Lift, sensing: Sensing) -> list[LiftWindow]:
    """The windows of one lift, their wrenches left at zero.

    Args:
        action: what would be done.
        sensing: how the sensor errs.
    """
    profile = LiftProfile.of(action, 1 / RATE)
    noise, bias, drift = sensor_at_tcp(sensing)
    upwards = _upwards(profile.angle)
    windows = []
    for segment in range(profile.segment.max() + 1):
        inside = np.flatnonzero(profile.segment == segment)
        kept = inside[round(trim_start(action, segment) * RATE) : len(inside) - round(TRIM_END * RATE)]
        if len(kept) < 2:  # too short to trim
            continue
        spin = profile.rate[kept]
        windows.append(
            LiftWindow(
                grasp=action.grasp,
                wrench=np.zeros(6),
                covariance=noise * RATE / len(kept),
                pull=GRAVITY * upwards[kept].mean(axis=0),
                angular_acceleration=profile.acceleration[kept].mean(axis=0),
                spin_products=spin.T @ spin / len(kept),
                tcp_height=HEIGHT,
                bias_covariance=bias,
                drift_covariance=drift,
                since_tare=BEFORE + kept[[0, -1]] / RATE,
            )
        )
    return windows


def _upwards(angle: np.ndarray) -> np.ndarray:
    """The vertical in the object's axes, where it is turned about one of them, (N, 3)."""
    x, y = angle[:, 0], angle[:, 1]
    return np.column_stack([-np.sin(y), np.sin(x), np.cos(x) * np.cos(y)])
