"""Predicted windows of actions, before any trial, with the errors that a sensor leaves in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from estimators.particles.support import load_map
from estimators.particles.windows import Observations
from testbed.actions.base import Action, TableAction
from testbed.actions.lift import Lift
from testbed.errors import InvalidValueError
from testbed.frames import move_wrench, rotation_2d
from testbed.objects.model import GRAVITY, ObjectShape
from testbed.sensing.lift_windows import LiftWindow
from testbed.sensing.presets import Sensing
from testbed.sensing.windows import TRIM_END, trim_start
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors

RATE = 100.0
"""Sampling rate [Hz]."""
BEFORE = 4.3
"""Time from the middle of the tare to the first steady stretch, as in simulation [s]."""
BETWEEN = 0.8
"""Time from a turn to its turn back [s]."""
TARED = 0.33
"""Duration of the tare [s]."""
REACH = 0.174
"""Distance from the sensor to the TCP [m]."""
TOOL_MASS, TOOL_COM = 0.925, 0.06
"""Mass of the tool [kg], and the distance of its center of mass from the sensor [m]: of a Robotiq 2F-85."""
PARTS = 5
"""Parts of a window at whose middles its pose is taken."""
HEIGHT = 0.022
"""Height of the TCP over the table [m]."""


class _Stretch(NamedTuple):
    """Steady stretch: twist and angular acceleration of the grasp point, object axes, and time since the tare [s]."""

    twist: tuple[float, float, float]
    alpha: float
    begin: float
    end: float
    poses: tuple[tuple[float, float, float], ...]
    """Place of the grasp point, m, and yaw of the object, rad, over the stretch; the motion's middle is the origin."""


def predicted_windows(
    shape: ObjectShape, actions: Sequence[Action], sensing: Sensing, setup: SetupErrors = EXACT_SETUP
) -> Observations | None:
    """Windows of the actions on the table, wrenches left at zero, trials numbered by all actions; None without any.

    The gripper carries nothing, as after nulling, as far as the sensor can tell. All trials have one middle.

    Raises:
        InvalidValueError: a grasp that the shape does not have.
    """
    if shape.chain is not None:
        allowed = 'a rigid object: how links would trail is not predicted; policy "drag" draws slides and turns'
        raise InvalidValueError("object", "one with hinges", allowed)
    places = np.array([grasp.position for grasp in shape.grasps]).reshape(-1, 2)
    held = np.array([shape.pressed(grasp) for grasp in shape.grasps]).reshape(-1, 2)
    at, stretches, trial, grasp = [tuple(place) for place in places.tolist()], [], [], []
    for index, action in enumerate(actions):
        if not isinstance(action, TableAction):  # the others have no such windows
            continue
        if action.grasp >= len(shape.grasps):
            raise InvalidValueError("action.grasp", action.grasp, f"one of the shape's {len(shape.grasps)} grasps")
        found = _stretches(at[action.grasp], shape, action)
        stretches += [(stretch, action.accelerated) for stretch in found]
        trial += [index] * len(found)
        grasp += [action.grasp] * len(found)
    if not stretches:
        return None
    count = len(stretches)
    noise, bias, drift = (torch.tensor(each).expand(count, 6, 6) for each in sensor_at_tcp(sensing))
    since_tare = torch.tensor([(s.begin, s.end) for s, _ in stretches], dtype=torch.float64)
    twist = torch.tensor([s.twist for s, _ in stretches], dtype=torch.float64)
    zeros = torch.zeros(count, 3, dtype=torch.float64)
    sensor = torch.tensor(_to_tcp())
    return Observations(
        setup=setup,
        wrench=zeros,
        noise=noise / since_tare.diff()[..., None],
        bias=bias,
        drift=drift,
        since_tare=since_tare,
        twist=twist,
        twists=twist[:, None],
        acceleration=torch.tensor([(0.0, 0.0, s.alpha) for s, _ in stretches], dtype=torch.float64),
        spin_square=twist[:, 2].square(),
        grasp=torch.tensor(places[grasp]),
        lift=zeros[:, 0],
        tilt=zeros[:, :2],
        yaw=zeros[:, :2],
        poses=torch.tensor([s.poses for s, _ in stretches], dtype=torch.float64),
        sensed=torch.zeros(count, 6, dtype=torch.float64),
        from_sensor=sensor.expand(count, 6, 6),
        load_map=torch.tensor(load_map(HEIGHT)).expand(count, 3, 6),
        load_kept=torch.full((count, 3), float(sensing.force_bias == 0), dtype=torch.float64),
        load_followed=zeros + 1,
        held=torch.tensor(held[grasp]),
        trial=torch.tensor(trial),
        accelerated=torch.tensor([accelerated for _, accelerated in stretches]),
        pushed=torch.zeros(count, dtype=torch.bool),
        seen=torch.zeros(count, 9, 0, dtype=torch.float64),
        links=torch.zeros(count, 1, 0, 9, dtype=torch.float64),
        links_off=torch.zeros(count, 1, 1, 0, 9, dtype=torch.float64),
    )


def sensor_at_tcp(sensing: Sensing) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Covariances of a sensor's errors about the TCP, axes up, each (6, 6).

    They are of the noise of a mean over one second, of the bias after the tare, and of the drift in one second.
    """
    std = np.array([*sensing.force_noise, *sensing.torque_noise])
    std[[0, 1, 3, 4]] = np.sqrt((std[[0, 0, 3, 3]] ** 2 + std[[1, 1, 4, 4]] ** 2) / 2)  # whichever way the hand turned
    noise = std**2 / (RATE * (1 - sensing.lag1) / (1 + sensing.lag1))
    down = _to_tcp()
    each = (noise, sensing.bias_std**2 + noise / TARED, sensing.drift_std**2)
    first, second, third = (down @ np.diag(variance) @ down.T for variance in each)
    return first, second, third


def _to_tcp() -> np.ndarray:
    """Map from a wrench about the sensor's origin to one about the TCP below it, (6, 6)."""
    return move_wrench(np.eye(6), np.array([0.0, 0.0, -REACH])).T


def _stretches(at: tuple[float, float], shape: ObjectShape, action: TableAction) -> list[_Stretch]:
    """Steady stretches of an action of the grasp at `at` [m], trimmed as a record is."""
    about, heading, time, found = action.center(shape), action.heading, BEFORE, []
    steps = [speed * seconds + acceleration * seconds**2 / 2 for speed, acceleration, seconds in action.steady]
    ends = np.cumsum([0.0, *steps])
    gone, facing = -(ends.max() + ends.min()) / 2, -shape.grasps[action.grasp].angle  # midway the pads close along x
    for segment, (speed, acceleration, seconds) in enumerate(action.steady):
        if segment and not action.accelerated:
            time += BETWEEN
        rate = math.copysign(1.0, speed) if action.accelerated else speed  # its sign alone counts there
        x, y = speed * heading[0], speed * heading[1]
        if action.turns:
            x, y = -rate * (at[1] - about[1]), rate * (at[0] - about[0])
        twist = (float(x), float(y), rate if action.turns else 0.0)
        begin, end = trim_start(action, segment), seconds - TRIM_END
        since = begin + (end - begin) * (np.arange(PARTS) + 0.5) / PARTS
        way = gone + speed * since + acceleration * since**2 / 2
        yaw = facing + (way if action.turns else 0 * way)
        if action.turns:
            place = rotation_2d(facing) @ (about - at) - rotation_2d(yaw) @ (about - at)
        else:
            place = way[:, None] * (rotation_2d(facing) @ heading)
        poses = np.column_stack([place, yaw])
        found.append(_Stretch(twist, acceleration, time + begin, time + end, tuple(map(tuple, poses.tolist()))))
        time += seconds
        gone += steps[segment]
    return found


def predicted_lifts(
    actions: Sequence[Action], sensing: Sensing, setup: SetupErrors = EXACT_SETUP
) -> dict[int, list[LiftWindow]]:
    """Windows of the lifts among some actions, by their place, their wrenches left at zero."""
    return {i: predicted_lift(a, sensing, setup) for i, a in enumerate(actions) if isinstance(a, Lift)}


def predicted_lift(action: Lift, sensing: Sensing, setup: SetupErrors = EXACT_SETUP) -> list[LiftWindow]:
    """Windows of one lift, their wrenches left at zero."""
    profile = action.profile(1 / RATE)
    noise, bias, drift = sensor_at_tcp(sensing)
    upwards = _upwards(profile.angle)
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
                from_sensor=_to_tcp(),
                tool=np.concatenate([heavier, np.cross([0.0, 0.0, -TOOL_COM], heavier)]),
                tool_mass=TOOL_MASS,
                tool_rate=tool_rate,
                pull_rate=pull_rate,
                setup=setup,
            )
        )
    return windows


def _upwards(angle: np.ndarray) -> np.ndarray:
    """Vertical unit vectors in the axes of an object that is turned about x or y by the angles, (N, 3)."""
    x, y = angle[:, 0], angle[:, 1]
    return np.column_stack([-np.sin(y), np.sin(x), np.cos(x) * np.cos(y)])
