"""Predicted windows of actions, before any trial, with the errors that a sensor leaves in them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float

from estimators.identifiability.quasi_static import Drag
from estimators.identifiability.trailing import trailing_motions
from estimators.particles.links import carried_moment
from estimators.particles.motion import LinkMotion, Motion, Planned
from estimators.particles.windows import Observations
from estimators.wrench.model import ModelErrors, ParticleModel
from estimators.wrench.support import load_map, nulled_load
from testbed.actions.base import Action
from testbed.actions.lift import Lift
from testbed.actions.path import RAMP_TIME
from testbed.actions.push import Push
from testbed.errors import InvalidValueError
from testbed.frames import move_wrench, perpendicular, rotate_wrench, rotation_2d, rotation_z
from testbed.objects.model import GRAVITY, ObjectShape
from testbed.sensing.camera import SPAN, Camera, PoseStream
from testbed.sensing.compensation import SIDEWAYS
from testbed.sensing.lift_windows import LiftWindow
from testbed.sensing.link_windows import parts_of, turned_errors
from testbed.sensing.presets import Sensing
from testbed.sensing.push_windows import BEGIN, WINDOW, stretches, within_contact
from testbed.sensing.series import interpolated
from testbed.sensing.windows import PARTS as WINDOW_PARTS
from testbed.sensing.windows import TRIM_END, part_means, trim_start
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors

RATE = 100.0
"""Sampling rate [Hz]."""
BEFORE = 4.3
"""Time from the middle of the tare to the first steady stretch, as in simulation [s]."""
BEFORE_PUSH = 1.27
"""Time from the middle of the tare to the start of a push, as in simulation [s]."""
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
STEP = WINDOW / WINDOW_PARTS
"""Step of the motion of a push [s]."""
HEIGHT = 0.022
"""Height of the TCP over the table [m]."""


def predicted_windows(
    shape: ObjectShape,
    actions: Sequence[Action],
    sensing: Sensing,
    setup: SetupErrors = EXACT_SETUP,
    errors: ModelErrors | None = None,
) -> Observations | None:
    """Windows of the slides and turns, with wrenches of zero and the indices of the actions; None without any.

    The load on the gripper is that after nulling, of the size in `errors`. The paths of all trials have one middle.

    Raises:
        InvalidValueError: a grasp that the shape does not have.
    """
    if shape.chain is not None:
        raise InvalidValueError("shape", "one with hinges", "a rigid object; see `predicted_drags`")
    found = []
    for index, action in enumerate(actions):
        if action.grasp is None or not action.dragged:  # the others have no such windows
            continue
        if action.grasp >= len(shape.grasps):
            raise InvalidValueError("action.grasp", action.grasp, f"one of the shape's {len(shape.grasps)} grasps")
        found += _stretches(shape, index, action)
    return _observations(shape, found, sensing, setup, errors) if found else None


def predicted_pushes(
    shape: ObjectShape, drag: Drag, actions: Sequence[Action], sensing: Sensing, setup: SetupErrors = EXACT_SETUP
) -> Observations | None:
    """Windows of quasi-static pushes, as `predicted_windows`; None without any.

    A push that slips off before the end of its first window has none.

    Args:
        shape: geometry.
        drag: friction under the object, true or guessed.
        actions: actions.
        sensing: errors of the sensor and its camera.
        setup: errors of the setup as stated.
    """
    pushes = {index: action for index, action in enumerate(actions) if isinstance(action, Push)}
    if not pushes:
        return None
    found = []
    for (index, push), motion in zip(pushes.items(), drag.motion(shape, list(pushes.values()), STEP), strict=True):
        if len(motion.time_s) < 2:
            continue
        kept = within_contact(motion.time_s, push.pace)[:-1]  # each sample represents the step after it
        camera = _stream(motion.time_s, motion.poses, sensing.camera)
        met = BEFORE_PUSH + RAMP_TIME / 2 + push.gap / push.speed
        within = (push.pace * BEGIN / 2, float(motion.time_s[-1]))
        for part, _, measured in stretches(motion.time_s[kept], motion.places[kept], camera, within, push.pace):
            since_tare = motion.time_s[kept[part[[0, -1]]]] + met
            fields = {
                name: measured[name]
                for name in ("point", "twists", "acceleration", "spin_square", "poses", "camera_errors")
            }
            found.append(Planned(index, False, None, since_tare=since_tare, **fields))
    return _observations(shape, found, sensing, setup, None) if found else None


def predicted_drags(
    shape: ObjectShape,
    mass: Float[np.ndarray, "P"],
    friction: Float[np.ndarray, "P"],
    actions: Sequence[Action],
    sensing: Sensing,
    setup: SetupErrors = EXACT_SETUP,
    hinge_friction: Sequence[float] | None = None,
) -> Observations | None:
    """Windows of slides and turns of an object in links, as `predicted_windows`; None without any.

    Windows that an estimator leaves out are left out, as are accelerated turns.

    Args:
        shape: geometry, with a chain.
        mass: mass of each particle, true or guessed [kg].
        friction: greatest friction of each [N].
        actions: actions.
        sensing: errors of the sensor and its camera.
        setup: errors of the setup as stated.
        hinge_friction: torque of friction of each hinge [N m]; a guess if left out.
    """
    drags = {i: a for i, a in enumerate(actions) if a.dragged_steadily}
    found = []
    for (index, drag), motion in zip(
        drags.items(), trailing_motions(shape, mass, friction, list(drags.values()), STEP, hinge_friction), strict=True
    ):
        stretches = _stretches(shape, index, drag)
        for segment, whole in enumerate(stretches):
            inside = np.flatnonzero(motion.profile.segment == segment)
            kept = inside[round(trim_start(drag, segment) / STEP) : len(inside) - round(TRIM_END / STEP)]
            found += _trailing(shape, whole, motion.turned[kept], sensing.camera)
    carried = carried_moment(ParticleModel.of(shape), torch.tensor(friction.sum()), setup)
    return _observations(shape, found, sensing, setup, None, float(carried)) if found else None


def _trailing(shape: ObjectShape, whole: Planned, turned: Float[np.ndarray, "N L 3"], camera: Camera) -> list[Planned]:
    """Windows of a steady stretch from the yaw, rate and slope of its links, sampled every `STEP`."""
    windows, time = [], whole.since_tare[0] + STEP * np.arange(len(turned))
    middles = np.linspace(whole.since_tare[0], whole.since_tare[1], 2 * PARTS + 1)[1::2]
    path = np.polynomial.polynomial.polyfit(middles, whole.poses, PARTS - 1)
    for part in parts_of(len(turned), STEP):
        if not len(part):
            continue
        middle, shared = part[len(part) // 2], SPAN / (len(part) * STEP)
        errors = []
        for link in turned.transpose(1, 0, 2):
            poses = np.zeros((len(link), 3))
            poses[:, 2] = link[:, 0]
            stream = _stream(time, poses, camera)
            camera_motion = stream.motion(time[[middle]], 0, (time[0] - SPAN / 4, time[-1] + SPAN / 4))
            errors.append(turned_errors(camera_motion.covariance[0], camera_motion.late[0], shared))
        if np.isnan(errors).any():
            continue
        twist = whole.twists[0]
        planned = whole._replace(
            since_tare=time[part[[0, -1]]],
            twists=np.tile(whole.twists, (WINDOW_PARTS, 1)),
            acceleration=np.array([*(twist[2] * perpendicular(twist[:2])), 0.0]),  # the hand's velocity turns with it
            poses=np.polynomial.polynomial.polyval(part_means(time[part]), path).T,
            turned=part_means(turned[part]),
            turned_errors=np.array(errors),
        )
        if not LinkMotion(shape, planned).may_rest:
            windows.append(planned)
    return windows


def _stream(time: Float[np.ndarray, "N"], poses: Float[np.ndarray, "N 3"], camera: Camera) -> PoseStream:
    """Camera frames of poses at given times, without errors; the stream states their size."""
    if camera.rate:
        frames = np.arange(time[0], time[-1], 1 / camera.rate)
        time, poses = frames, interpolated(frames, time, poses)
    return PoseStream(time, poses[:, None], camera.position, camera.angle, camera.delay_std)


def _observations(
    shape: ObjectShape,
    found: list[Planned],
    sensing: Sensing,
    setup: SetupErrors,
    errors: ModelErrors | None,
    carried: float = 0.0,
) -> Observations:
    """Windows of stretches, all of a held or all of a pushed object; `carried` as in `nulled_load`."""
    motion = Motion.of(shape, found, [each.trial for each in found], [each.accelerated for each in found])
    count, pushed = len(found), bool(motion.pushed.any())
    noise, bias, drift = (torch.tensor(each).expand(count, 6, 6) for each in sensor_at_tcp(sensing))
    zeros, kept = torch.zeros(count, 6, dtype=torch.float64), 1.0 if pushed else float(sensing.force_bias == 0)
    sensor = torch.tensor(to_tcp()).expand(count, 6, 6)
    if pushed:  # the hand does not turn with the object
        facing = motion.poses[:, WINDOW_PARTS // 2, 2].tolist()
        sensor = torch.tensor(np.array([rotate_wrench(rotation_z(-yaw), to_tcp().T).T for yaw in facing]))
    nulled = (errors or ModelErrors()).nulled
    size, change = nulled_load(
        nulled, motion.accelerated.numpy(), motion.pushed.numpy(), carried, links=shape.chain is not None
    )
    return Observations(
        **vars(motion),
        setup=setup,
        wrench=zeros[:, :3],
        sensed=zeros,
        from_sensor=sensor,
        tool_tilt=_tool_tilts(motion.poses, [each.begun for each in found]),
        noise=noise / motion.since_tare.diff()[..., None],
        bias=bias,
        drift=drift,
        lift=zeros[:, 0],
        tilt=zeros[:, :2],
        load_map=torch.tensor(load_map(HEIGHT)).expand(count, 3, 6),
        load_kept=torch.full((count, 3), kept, dtype=torch.float64),
        load_followed=torch.ones(count, 3, dtype=torch.float64),
        load_size=torch.tensor(size),
        load_change=torch.tensor(change),
    )


def _tool_tilts(poses: Float[torch.Tensor, "K S 3"], begun: list[float]) -> Float[torch.Tensor, "K 2 6"]:
    """`SteadyWindow.tool_tilt` of a hand with the yaws `begun` [rad] at the tare; NaN for a hand that does not turn."""
    now, then = (rotation_2d(-yaw) for yaw in (poses[..., 2].numpy(), np.array(begun)))
    force = np.zeros((len(poses), 2, 3))
    turned = np.nan_to_num(now.mean(axis=1) - then)
    force[..., :2] = TOOL_MASS * SIDEWAYS[:, :2] @ turned.transpose(0, 2, 1)
    return torch.tensor(np.concatenate([force, np.cross([0.0, 0.0, REACH - TOOL_COM], force)], axis=2))


def sensor_at_tcp(sensing: Sensing) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Covariances of a sensor's errors about the TCP, axes up, each (6, 6).

    In order: noise of the mean over one second, bias after the tare, and drift in one second.
    """
    std = np.array([*sensing.force_noise, *sensing.torque_noise])
    # mean over the directions of the hand
    std[[0, 1, 3, 4]] = np.sqrt((std[[0, 0, 3, 3]] ** 2 + std[[1, 1, 4, 4]] ** 2) / 2)
    noise = std**2 / (RATE * (1 - sensing.lag1) / (1 + sensing.lag1))
    down = to_tcp()
    each = (noise, sensing.bias_std**2 + noise / TARED, sensing.drift_std**2)
    first, second, third = (down @ np.diag(variance) @ down.T for variance in each)
    return first, second, third


def to_tcp() -> np.ndarray:
    """Map from a wrench about the sensor's origin to one about the TCP below it, (6, 6)."""
    return move_wrench(np.eye(6), np.array([0.0, 0.0, -REACH])).T


def predicted_lifts(
    actions: Sequence[Action], sensing: Sensing, setup: SetupErrors = EXACT_SETUP
) -> dict[int, list[LiftWindow]]:
    """Windows of the lifts among the actions, by their index, with wrenches of zero."""
    return {i: predicted_lift(a, sensing, setup) for i, a in enumerate(actions) if isinstance(a, Lift)}


def predicted_lift(action: Lift, sensing: Sensing, setup: SetupErrors = EXACT_SETUP) -> list[LiftWindow]:
    """Windows of one lift, with wrenches of zero."""
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
    """Axes of the table, one per row, in the frame of an object tilted about x and y by `angle`, shape (N, 3, 3)."""
    x, y, none = angle[:, 0], angle[:, 1], np.zeros(len(angle))
    along_x, along_y = np.stack([np.cos(y), none, np.sin(y)], 1), np.stack([none, np.cos(x), -np.sin(x)], 1)
    upwards = np.column_stack([-np.sin(y), np.sin(x), np.cos(x) * np.cos(y)])
    return np.stack([along_x, along_y, upwards], 1)


def _stretches(shape: ObjectShape, trial: int, action: Action) -> list[Planned]:
    """Steady stretches of an action, trimmed like those of a record."""
    (at, angle), about, heading, time = action.hand(shape), action.center(shape), action.heading, BEFORE
    steps = [speed * seconds + acceleration * seconds**2 / 2 for speed, acceleration, seconds in action.steady]
    ends = np.cumsum([0.0, *steps])
    start, middle_yaw = -(ends.max() + ends.min()) / 2, -angle  # midway the pads close along x
    progress = start
    found = []
    for segment, (speed, acceleration, seconds) in enumerate(action.steady):
        if segment and not action.accelerated:
            time += BETWEEN
        rate = math.copysign(1.0, speed) if action.accelerated else speed  # its sign alone counts there
        x, y = speed * heading[0], speed * heading[1]
        if action.turns:
            x, y = -rate * (at[1] - about[1]), rate * (at[0] - about[0])
        twist = np.array([x, y, rate if action.turns else 0.0])
        begin, end = trim_start(action, segment), seconds - TRIM_END
        since = begin + (end - begin) * (np.arange(PARTS) + 0.5) / PARTS
        along = progress + speed * since + acceleration * since**2 / 2
        yaw = middle_yaw + (along if action.turns else 0 * along)
        if action.turns:
            place = rotation_2d(middle_yaw) @ (about - at) - rotation_2d(yaw) @ (about - at)
        else:
            place = along[:, None] * (rotation_2d(middle_yaw) @ heading)
        found.append(
            Planned(
                trial,
                action.accelerated,
                action.grasp,
                None,
                np.array([time + begin, time + end]),
                twist[None],
                np.array([0.0, 0.0, acceleration]),
                action.turns * float(np.mean((speed + acceleration * since) ** 2)),
                np.column_stack([place, yaw]),
                middle_yaw + (start if action.turns else 0.0),
            )
        )
        time += seconds
        progress += steps[segment]
    return found
