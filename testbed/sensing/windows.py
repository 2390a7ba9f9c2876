"""Steady windows: stretches of a record, each reduced to a mean wrench in the object frame, with its covariance.

In a turn or slide at constant speed the wrench is constant in the object frame, so the mean over a window is
sufficient. Records are autocorrelated, so the covariance of the mean uses the effective sample size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float, Int

from testbed.actions.base import Action
from testbed.errors import InvalidValueError
from testbed.frames import move_wrench, perpendicular, rotate_wrench, rotation_2d, rotation_matrix
from testbed.objects.model import GRAVITY, ObjectShape, check_shape
from testbed.sensing.compensation import SIDEWAYS, tare_samples, tare_time, tool_pulls
from testbed.trajectory import Phase, Trajectory
from testbed.validation import freeze_arrays

TRIM_START = 1.0
"""Time left out at the start of a window of constant speed [s], in which the arm's outer loop settles."""
TRIM_STEP = 0.2
"""Time left out after each step of acceleration [s]."""
TRIM_END = 0.05
"""Time left out at the end of a window [s]."""
BATCH = 0.2
"""Length of a batch of samples [s]: above the correlation time of the noise, below that of the load."""
LONGEST_STEP = 0.1
"""Longest time between samples [s], at which a batch and a part of a window still have samples."""
PARTS = 10
"""Number of parts of a window, each with its mean motion."""
LEAST_BATCHES = 40
"""Least number of batches for a covariance from their differences; a short window has shorter batches."""
SHORTEST = 0.25
"""Least length of a batch as a part of `BATCH`; with shorter ones a covariance is from the scatter of samples. Ours."""
INDEPENDENT = 18 / 35
"""Effective share of independent values among second differences of white noise: 1 / (1 + 2 (4/6)^2 + 2 (1/6)^2)."""


@dataclass(frozen=True, eq=False)
class SteadyWindow:
    """Stretch of constant speed, or of constant acceleration."""

    grasp: int | None
    """Index of the grasp; None for a push."""
    wrench: Float[np.ndarray, "6"]
    """Mean wrench of the gripper on the object [N, N m], about the TCP, in axes that turn with the object (z up)."""
    covariance: Float[np.ndarray, "6 6"]
    """Covariance of that mean, from the window's own noise, without slow changes of load and sensor."""
    twist: Float[np.ndarray, "3"]
    """Mean velocity of the grasp point and turn rate [m/s, rad/s], object axes."""
    twists: Float[np.ndarray, "S 3"]
    """`twist` over each of `PARTS` equal parts: the drag deflects the arm and so moves the center of a turn."""
    acceleration: Float[np.ndarray, "3"]
    """Mean acceleration of the grasp point and angular acceleration [m/s^2, rad/s^2], object axes."""
    spin_square: float
    """Mean square of the turn rate [rad^2/s^2], above the square of the mean if the turn accelerates."""
    tcp_height: float
    """Mean height of the TCP over the table [m]."""
    yaw: Float[np.ndarray, "2"]
    """Yaw of the object at the window's first and last sample [rad]."""
    poses: Float[np.ndarray, "S 3"]
    """Mean position of the TCP and yaw of the object in each part [m, m, rad], world."""
    from_sensor: Float[np.ndarray, "6 6"]
    """Map from a wrench in the sensor's axes, about its origin, to one as `wrench`."""
    bias_covariance: Float[np.ndarray, "6 6"]
    """Covariance of the constant error of a trial, as `wrench`: bias, and the tare's own noise."""
    drift_covariance: Float[np.ndarray, "6 6"]
    """Covariance that the random walk of the zero adds per second, as `wrench`."""
    since_tare: Float[np.ndarray, "2"]
    """Time from the tare to the window's first and last sample [s]."""
    point: Float[np.ndarray, "2"] | None = None
    """Mean position of the TCP in the object frame by a camera [m]; None for a grip, at its stated position."""
    camera_errors: Float[np.ndarray, "9 10"] = field(default_factory=lambda: np.zeros((9, 10)))
    """Errors of the object's pose, twist and acceleration by a camera, object axes: effects of one standard deviation
    each, nine of the window alone and one that the windows of a trial share; 0 for a grip."""
    tool_tilt: Float[np.ndarray, "2 6"] = field(default_factory=lambda: np.zeros((2, 6)))
    """Change of `wrench` by the tool's weight with a tilt of table and robot about the table's x and y axes [N, N m per
    rad]: the tare removes it in the hand's first orientation alone."""
    turned: Float[np.ndarray, "S L 3"] = field(default_factory=lambda: np.zeros((PARTS, 0, 3)))
    """Mean yaw, yaw rate and angular acceleration of each link of an articulated object in each part, by a camera,
    world [rad, rad/s, rad/s^2]."""
    turned_errors: Float[np.ndarray, "L 3 4"] = field(default_factory=lambda: np.zeros((0, 3, 4)))
    """Errors of `turned`: effects of one standard deviation each, three of the window alone and one of its trial."""

    def __post_init__(self) -> None:
        square, pair = (6, 6), (2,)
        freeze_arrays(self, wrench=(6,), covariance=square, twist=(3,), twists=(PARTS, 3), acceleration=(3,))
        freeze_arrays(self, bias_covariance=square, drift_covariance=square, since_tare=pair, yaw=pair)
        freeze_arrays(self, poses=(PARTS, 3), from_sensor=square, camera_errors=(9, 10), tool_tilt=(2, 6))
        freeze_arrays(self, turned=(PARTS, None, 3), turned_errors=(None, 3, 4))
        if self.point is not None:
            freeze_arrays(self, point=pair)


Window = TypeVar("Window")


def reduced_once(reduce: Callable[[Trajectory], list[Window]]) -> Callable[[Trajectory], list[Window]]:
    """Cache the reduction of a record to its windows: a record never changes, and every method reduces it."""
    cache: WeakKeyDictionary[Trajectory, list[Window]] = WeakKeyDictionary()

    @wraps(reduce)
    def windows(trajectory: Trajectory) -> list[Window]:
        if trajectory not in cache:
            cache[trajectory] = reduce(trajectory)
        return list(cache[trajectory])

    return windows


@reduced_once
def steady_windows(trajectory: Trajectory) -> list[SteadyWindow]:
    """Windows of every steady stretch of a trajectory.

    Raises:
        InvalidValueError: the trajectory is not `ok`, is a weighing, or has a stretch too short to trim.
    """
    if not trajectory.ok:
        raise InvalidValueError(
            "trajectory.status", trajectory.status, f"ok; this trial is no data: {trajectory.reason}"
        )
    if not trajectory.action.dragged:  # other actions have no steady windows
        raise InvalidValueError(
            "trajectory.action",
            trajectory.action,
            "a slide or a turn; read a weighing with weight_of, a lift with lift_windows, a push with push_windows",
        )
    return windows_of(trajectory, [(kept, kept) for kept in steady_samples(trajectory)])


def windows_of(
    trajectory: Trajectory, stretches: Sequence[tuple[Int[np.ndarray, "N"], Int[np.ndarray, "W"]]]
) -> list[SteadyWindow]:
    """Window of each stretch of a record with a grip: the stretch's samples, and those for the noise of its mean."""
    into_object = rotation_2d(-trajectory.object_pose[:, 2])
    in_object = wrench_in_object(trajectory)
    linear = np.einsum("nij,nj->ni", into_object, trajectory.tcp_velocity[:, :2])
    twist = np.column_stack([linear, trajectory.object_velocity[:, 2]])
    world_twist = np.column_stack([trajectory.tcp_velocity[:, :2], trajectory.object_velocity[:, 2]])
    place = np.column_stack([trajectory.tcp_position[:, :2], trajectory.object_pose[:, 2]])
    from_sensor = sensor_map(trajectory)
    bias, drift = bias_and_drift(trajectory, from_sensor)
    tared, tilts = tare_time(trajectory), _tool_tilts(trajectory, [kept for kept, _ in stretches])
    rate = 1 / float(np.median(np.diff(trajectory.time_s)))
    windows = []
    for (kept, whole), tilt in zip(stretches, tilts, strict=True):
        yaw = trajectory.object_pose[kept, 2]
        windows.append(
            SteadyWindow(
                grasp=trajectory.action.grasp,
                wrench=in_object[kept].mean(axis=0),
                covariance=noise_of_mean(in_object[whole], round(BATCH * rate)) * (len(whole) / len(kept)),
                twist=twist[kept].mean(axis=0),
                twists=part_means(twist[kept]),
                acceleration=_slopes(trajectory.time_s[kept], world_twist[kept], yaw),
                spin_square=float(np.mean(twist[kept, 2] ** 2)),
                tcp_height=float(trajectory.tcp_position[kept, 2].mean()),
                yaw=yaw[[0, -1]],
                poses=part_means(place[kept]),
                from_sensor=from_sensor,
                bias_covariance=bias,
                drift_covariance=drift,
                since_tare=trajectory.time_s[kept[[0, -1]]] - tared,
                tool_tilt=tilt @ from_sensor.T,
            )
        )
    return windows


def part_means(samples: Float[np.ndarray, "N ..."]) -> Float[np.ndarray, "S ..."]:
    """Means over `PARTS` parts of equal length; a sample on a border counts in both parts by its shares."""
    edges = np.linspace(0, len(samples), PARTS + 1)[:, None]
    index = np.arange(len(samples))
    shares = (np.minimum(index + 1, edges[1:]) - np.maximum(index, edges[:-1])).clip(min=0)
    return np.tensordot(shares, samples, 1) * PARTS / len(samples)


def _tool_tilts(trajectory: Trajectory, stretches: Sequence[Int[np.ndarray, "N"]]) -> list[Float[np.ndarray, "2 6"]]:
    """Change of the tool's mean wrench since the tare with a tilt about x and y [N, N m per rad], sensor axes."""
    tool, tare = trajectory.tool, tare_samples(trajectory)
    if tool is None or len(tare) == 0:
        return [np.zeros((2, 6))] * len(stretches)
    pulls = tool_pulls(tool, rotation_matrix(trajectory.sensor_orientation), SIDEWAYS)
    return [pulls[kept].mean(axis=0) - pulls[tare].mean(axis=0) for kept in stretches]


def bias_and_drift(
    trajectory: Trajectory, from_sensor: Float[np.ndarray, "6 6"]
) -> tuple[Float[np.ndarray, "6 6"], Float[np.ndarray, "6 6"]]:
    """Covariances of the bias left by the tare, and of the drift per second, in the axes of the map `from_sensor`."""
    tare = tare_samples(trajectory)
    own = mean_covariance(trajectory.sensor_wrench[tare]) if len(tare) > 1 else np.zeros((6, 6))
    bias = from_sensor @ (np.diag(trajectory.sensor_bias_std**2) + own) @ from_sensor.T
    return bias, from_sensor @ np.diag(trajectory.sensor_drift_std**2) @ from_sensor.T


def steady_samples(trajectory: Trajectory) -> list[Int[np.ndarray, "N"]]:
    """Indices of the samples of every steady stretch, its start and end trimmed.

    Raises:
        InvalidValueError: there is none, or one is too short to trim.
    """
    stretches = []
    for segment in range(trajectory.segment.max() + 1):
        inside = np.flatnonzero(trajectory.segment == segment)
        if len(inside) == 0:
            raise InvalidValueError(
                "Trajectory.segment", f"no sample of stretch {segment}", "stretches numbered from 0"
            )
        time = trajectory.time_s[inside]
        trim = trim_start(trajectory.action, segment)
        kept = inside[(time >= time[0] + trim) & (time <= time[-1] - TRIM_END)]
        if len(kept) < 10:
            raise InvalidValueError(
                "trajectory",
                f"{len(kept)} samples in steady stretch {segment}",
                f"at least 10 after trimming {trim + TRIM_END:g} s",
            )
        stretches.append(kept)
    if not stretches:
        raise InvalidValueError("trajectory", "no steady stretch", f"samples in phase {Phase.STEADY.name}")
    return stretches


def trim_start(action: Action, segment: int) -> float:
    """Time left out at the start of a steady stretch of an action [s]."""
    return TRIM_STEP if action.accelerates(segment) else TRIM_START


def wrench_in_object(trajectory: Trajectory) -> Float[np.ndarray, "T 6"]:
    """Wrench of the gripper on the object [N, N m], about the TCP, in axes that turn with the object (z up)."""
    into_object = rotation_2d(-trajectory.object_pose[:, 2])
    force, torque = trajectory.wrench_on_object_world[:, :3], trajectory.wrench_on_object_world[:, 3:]
    planar = [np.einsum("nij,nj->ni", into_object, part[:, :2]) for part in (force, torque)]
    return np.hstack([planar[0], force[:, 2:], planar[1], torque[:, 2:]])


def sample_deviation(trajectory: Trajectory) -> Float[np.ndarray, "T 6"]:
    """Standard deviation of each sample of `wrench_in_object` from the sensor's errors [N, N m].

    The errors are the noise, as measured while hovering, the constant error left by the tare, and the drift since.
    """
    hovering = trajectory.sensor_wrench[trajectory.mask(Phase.TARE)]
    noise = np.cov(hovering, rowvar=False) if len(hovering) > 1 else np.zeros((6, 6))
    move = sensor_map(trajectory)
    constant = np.diag(move @ (noise + np.diag(trajectory.sensor_bias_std**2)) @ move.T)
    drift = np.diag(move @ np.diag(trajectory.sensor_drift_std**2) @ move.T)
    return np.sqrt(constant + np.outer(np.abs(trajectory.time_s - tare_time(trajectory)), drift))


def sensor_map(trajectory: Trajectory, at: tuple[int, float] | None = None) -> Float[np.ndarray, "6 6"]:
    """Map from a wrench in the sensor's axes to the TCP and into object axes.

    Args:
        trajectory: record of a trial.
        at: a sample, and the object's yaw at it [rad]; None for a grip, where the hand turns with the object, and the
            map is the same at all samples.
    """
    tcp = np.zeros(3) if trajectory.tool is None else trajectory.tool.tcp
    first = int(np.argmax(trajectory.segment >= 0))
    sample, yaw = at or (first, float(trajectory.object_pose[first, 2]))
    axes = rotation_matrix(trajectory.sensor_orientation[sample])
    axes[:2] = rotation_2d(-yaw) @ axes[:2]
    return rotate_wrench(axes, move_wrench(np.eye(6), tcp)).T


def _slopes(time: np.ndarray, twist: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Mean acceleration over a window, linear part in object axes, (3,).

    A point of an object in a steady turn accelerates towards the center, constantly in object axes:
    a = R^T d(velocity)/dt.
    """
    into_object = rotation_2d(-yaw)
    in_object = np.einsum("nij,nj->ni", into_object, twist[:, :2])
    slopes = np.polynomial.polynomial.polyfit(time - time.mean(), np.column_stack([in_object, twist[:, 2]]), 1)[1]
    # R^T dv/dt = d(R^T v)/dt + rate e_z x (R^T v)
    turning = (twist[:, 2, None] * perpendicular(in_object)).mean(axis=0)
    return np.array([*(slopes[:2] + turning), slopes[2]])


def noise_of_mean(samples: Float[np.ndarray, "T D"], length: int) -> Float[np.ndarray, "D D"]:
    """Covariance of the mean of a record from its noise alone, (D, D).

    It is from second differences of means over `length` samples or fewer, to which slow changes do not contribute (von
    Neumann 1941), with the factor that makes its inverse unbiased (inverse Wishart distribution); of a window too short
    for that, it is from the scatter about a parabola.
    """
    batch = min(length, len(samples) // LEAST_BATCHES)
    if batch < max(SHORTEST * length, 1):
        return scatter_about_parabola(samples)
    count = len(samples) // batch
    means = samples[len(samples) - count * batch :].reshape(count, batch, -1).mean(axis=1)
    change = np.diff(means, 2, axis=0)
    freedom = INDEPENDENT * len(change)
    return change.T @ change / (6 * len(change) * count) * freedom / (freedom - means.shape[1] - 1)


def scatter_about_parabola(samples: Float[np.ndarray, "T D"]) -> Float[np.ndarray, "D D"]:
    """Covariance of the mean of a record whose load changes slowly, (D, D)."""
    count = len(samples)
    powers = np.polynomial.legendre.legvander(np.linspace(-1, 1, count), 2)
    residuals = samples - powers @ np.linalg.lstsq(powers, samples)[0]
    return mean_covariance(residuals) * count / max(count - powers.shape[1], 1)


def weight_of(trajectory: Trajectory) -> float:
    """Mass read by a scale, kg.

    Raises:
        InvalidValueError: not a weighing, or one that is not `ok`.
    """
    if trajectory.action.moves or not trajectory.ok:
        raise InvalidValueError("trajectory", f"{trajectory.action}, {trajectory.status}", "a Weigh with status ok")
    return float(trajectory.wrench_on_object_world[:, 2].mean()) / GRAVITY


def mean_covariance(samples: Float[np.ndarray, "T D"]) -> Float[np.ndarray, "D D"]:
    """Covariance of the mean of autocorrelated samples, (D, D)."""
    scatter = np.atleast_2d(np.cov(samples, rowvar=False))
    size = np.sqrt(effective_samples(samples))
    return scatter / np.outer(size, size)


def effective_samples(samples: Float[np.ndarray, "T D"]) -> Float[np.ndarray, "D"]:
    """Effective number of independent samples in a record of T samples, per column, at least 1, (D,).

    T over the integrated autocorrelation time, summed while pairs of neighboring lags stay positive (Geyer 1992).
    """
    count = len(samples)
    centered = samples - samples.mean(axis=0)
    power = np.abs(np.fft.rfft(centered, 2 * count, axis=0)) ** 2
    correlation = np.fft.irfft(power, axis=0)[:count]
    variance = correlation[0]
    correlation = correlation / np.where(variance > 0, variance, 1.0)
    pairs = correlation[0 : count - count % 2 : 2] + correlation[1::2][: count // 2]
    positive = np.cumprod(pairs > 0, axis=0)
    time = np.maximum(2 * (pairs * positive).sum(axis=0) - 1, 1.0)
    return np.where(variance > 0, np.maximum(count / time, 1.0), count)


def check_trials(shape: ObjectShape, trajectories: Sequence[Trajectory]) -> None:
    """Raise InvalidValueError unless these are a shape and trajectories of its trials, sampled often enough."""
    check_shape(shape)
    if not isinstance(trajectories, Sequence) or not all(isinstance(each, Trajectory) for each in trajectories):
        raise InvalidValueError("trajectories", trajectories, "a list or tuple of Trajectory objects")
    for index, each in enumerate(trajectories):
        if not (each.ok and each.action.moves and len(each.time_s) > 1):
            continue
        if (step := float(np.median(np.diff(each.time_s)))) > 1.01 * LONGEST_STEP:
            allowed = f"at most {LONGEST_STEP:g} s between samples, in seconds"
            raise InvalidValueError(f"trajectories[{index}].time_s", f"a sample every {step:g} s", allowed)


def reduced_trials(
    shape: ObjectShape,
    trajectories: Sequence[Trajectory],
    kind: Callable[[Action], bool],
    reduce: Callable[[Trajectory], list[Window]],
) -> dict[int, list[Window]]:
    """Windows of every trial of some kinds of action, by its index.

    Left out are trials with a status other than ok, with a stretch too short to trim, and repeated records.

    Args:
        shape: shape of the object.
        trajectories: trials of one object.
        kind: predicate of the actions that count.
        reduce: reduction of a record to its windows; it raises InvalidValueError if a stretch is too short.

    Raises:
        InvalidValueError: a grasp that the shape does not have.
    """
    found, records = {}, set()
    for index, trajectory in enumerate(trajectories):
        action = trajectory.action
        if not trajectory.ok or not kind(action):
            continue
        record = action, trajectory.wrench_on_object_world.tobytes()
        if record in records:
            continue
        if action.grasp is not None and action.grasp >= len(shape.grasps):
            allowed = f"one of the shape's {len(shape.grasps)} grasps, counted from 0: another object's trial?"
            raise InvalidValueError(f"trajectories[{index}].action.grasp", action.grasp, allowed)
        try:
            found[index] = reduce(trajectory)
        except InvalidValueError:  # too short
            continue
        records.add(record)
    return found
