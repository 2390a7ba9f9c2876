"""Predicted windows of lifts, before any trial, with the errors that a sensor leaves in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.identifiability.predicted import BEFORE, HEIGHT, RATE, TOOL_COM, TOOL_MASS, sensor_at_tcp, to_tcp
from testbed.actions.base import Action
from testbed.actions.lift import Lift
from testbed.objects.model import GRAVITY
from testbed.sensing.compensation import SIDEWAYS
from testbed.sensing.lift_windows import LiftWindow
from testbed.sensing.presets import Sensing
from testbed.sensing.windows import TRIM_END, trim_start
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors


def predicted_lifts(
    actions: Sequence[Action], sensing: Sensing, setup: SetupErrors = EXACT_SETUP
) -> dict[int, list[LiftWindow]]:
    """Windows of the lifts among some actions, by their place, their wrenches left at zero."""
    return {i: predicted_lift(a, sensing, setup) for i, a in enumerate(actions) if isinstance(a, Lift)}


def predicted_lift(action: Lift, sensing: Sensing, setup: SetupErrors = EXACT_SETUP) -> list[LiftWindow]:
    """Windows of one lift, their wrenches left at zero."""
    profile = action.sampled(1 / RATE)
    noise, bias, drift = sensor_at_tcp(sensing)
    axes = _level(profile.angle)
    upwards = axes[:, 2]
    windows = []
    for segment in range(profile.segment.max() + 1):
        inside = np.flatnonzero(profile.segment == segment)
        kept = inside[round(trim_start(action, segment) * RATE) : len(inside) - round(TRIM_END * RATE)]
        if len(kept) < 2:  # too short to trim
            continue
        spin, pull = profile.rate[kept], GRAVITY * upwards[kept].mean(axis=0)
        heavier = TOOL_MASS * (pull - [0.0, 0.0, GRAVITY])
        pull_rate = GRAVITY * (upwards[kept[-1]] - upwards[kept[0]]) * RATE / (len(kept) - 1)
        tool_rate = TOOL_MASS * np.concatenate([pull_rate, np.cross([0.0, 0.0, -TOOL_COM], pull_rate)])
        sideways = SIDEWAYS @ axes[kept].mean(axis=0)
        moved = sideways - SIDEWAYS
        windows.append(
            LiftWindow(
                grasp=action.grasp,
                wrench=np.zeros(6),
                covariance=noise * RATE / len(kept),
                pull=pull,
                angular_acceleration=profile.acceleration[kept].mean(axis=0),
                spin_products=spin.T @ spin / len(kept),
                tcp_height=HEIGHT,
                bias_covariance=bias,
                drift_covariance=drift,
                since_tare=BEFORE + kept[[0, -1]] / RATE,
                from_sensor=to_tcp(),
                tool=np.concatenate([heavier, np.cross([0.0, 0.0, -TOOL_COM], heavier)]),
                tool_mass=TOOL_MASS,
                tool_rate=tool_rate,
                pull_rate=pull_rate,
                pull_tilt=sideways,
                tool_tilt=TOOL_MASS * np.hstack([moved, np.cross([0.0, 0.0, -TOOL_COM], moved)]),
                setup=setup,
            )
        )
    return windows


def _level(angle: np.ndarray) -> np.ndarray:
    """The table's axes in those of an object that is turned about x or y by the angles, (N, 3, 3), one a row."""
    x, y, none = angle[:, 0], angle[:, 1], np.zeros(len(angle))
    along_x, along_y = np.stack([np.cos(y), none, np.sin(y)], 1), np.stack([none, np.cos(x), -np.sin(x)], 1)
    upwards = np.column_stack([-np.sin(y), np.sin(x), np.cos(x) * np.cos(y)])
    return np.stack([along_x, along_y, upwards], 1)
