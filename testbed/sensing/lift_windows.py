"""Lift windows: stretches of a lift, each reduced to one wrench and one motion in object axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from testbed.errors import InvalidValueError
from testbed.frames import move_wrench, rotate_wrench, rotation_matrix, rotation_z
from testbed.objects.model import GRAVITY
from testbed.sensing.compensation import SIDEWAYS, tare_samples, tool_pulls, tool_wrench, twist_rates
from testbed.sensing.windows import bias_and_drift, scatter_about_parabola, steady_samples
from testbed.trajectory import Phase, Trajectory
from testbed.validation import freeze_arrays
from testbed.worlds.setup_errors import SetupErrors


@dataclass(frozen=True, eq=False)
class LiftWindow:
    """Stretch at rest, or rocked at constant acceleration. Object axes; moments about the TCP.

    The wrench on a body is linear in `pull`, `angular_acceleration` and `spin_products`, so its mean follows from their
    means.
    """

    grasp: int
    """Index of the grasp."""
    wrench: Float[np.ndarray, "6"]
    """Mean wrench of the gripper on the object [N, N m]."""
    covariance: Float[np.ndarray, "6 6"]
    """Covariance of that mean, from the noise in all windows of the lift."""
    pull: Float[np.ndarray, "3"]
    """Mean acceleration of the TCP less gravity [m/s^2]."""
    angular_acceleration: Float[np.ndarray, "3"]
    """Mean angular acceleration [rad/s^2]."""
    spin_products: Float[np.ndarray, "3 3"]
    """Mean products of the components of the angular velocity [rad^2/s^2]."""
    tcp_height: float
    """Height of the TCP over the object's bottom [m]."""
    bias_covariance: Float[np.ndarray, "6 6"]
    """Covariance of the constant error of a trial, as `wrench`: bias, and the tare's own noise."""
    drift_covariance: Float[np.ndarray, "6 6"]
    """Covariance that the random walk of the zero adds per second, as `wrench`."""
    since_tare: Float[np.ndarray, "2"]
    """Time from the tare to the window's first and last sample [s]."""
    from_sensor: Float[np.ndarray, "6 6"]
    """Map from a wrench in the sensor's axes, about its origin, to one as `wrench`."""
    tool: Float[np.ndarray, "6"]
    """Mean wrench on the tool less that at the tare [N, N m], sensor axes, which the sensor measures too."""
    tool_mass: float
    """Mass of the tool [kg]."""
    tool_rate: Float[np.ndarray, "6"]
    """Mean rate of the tool's wrench [N/s, N m/s], sensor axes: its error per delay of the poses."""
    pull_rate: Float[np.ndarray, "3"]
    """Mean rate of `pull` [m/s^3]."""
    pull_tilt: Float[np.ndarray, "2 3"]
    """Change of `pull` with a tilt of the table and robot about the table's x and y axes [m/s^2 per rad]."""
    tool_tilt: Float[np.ndarray, "2 6"]
    """Change of `tool` with such a tilt [N, N m per rad]."""
    setup: SetupErrors
    """Errors of the setup, as stated."""

    def __post_init__(self) -> None:
        square = (6, 6)
        freeze_arrays(self, pull_tilt=(2, 3), tool_tilt=(2, 6))
        freeze_arrays(self, from_sensor=square, tool=(6,), tool_rate=(6,), pull_rate=(3,))
        freeze_arrays(self, wrench=(6,), covariance=square, pull=(3,), angular_acceleration=(3,), spin_products=(3, 3))
        freeze_arrays(self, bias_covariance=square, drift_covariance=square, since_tare=(2,))


def lift_windows(trajectory: Trajectory) -> list[LiftWindow]:
    """Windows of every stretch of a lift.

    The object lies flat while the grip settles: its later orientation follows from the hand's.

    Raises:
        InvalidValueError: not a lift, not `ok`, no samples in phase SETTLE, or a stretch too short to trim.
    """
    action = trajectory.action
    if action.grasp is None or not (action.in_air and trajectory.ok):  # other actions have no lift windows
        raise InvalidValueError("trajectory", f"{action}, {trajectory.status}", "a Lift with status ok")
    tool, tare = trajectory.tool, tare_samples(trajectory)
    if len(tare) < 2 or tool is None:
        raise InvalidValueError("trajectory", "no tare, or no tool", "the record of a whole lift")
    flat, mount, axes = _held_axes(trajectory)
    into_object = axes.transpose(0, 2, 1)
    wrench = rotate_wrench(into_object, trajectory.wrench_on_object_world)
    spin = np.einsum("nij,nj->ni", into_object, trajectory.tcp_velocity[:, 3:])
    motion = rotate_wrench(into_object, twist_rates(trajectory) + np.array([0.0, 0.0, GRAVITY, 0.0, 0.0, 0.0]))

    from_sensor = rotate_wrench(mount.T, move_wrench(np.eye(6), tool.tcp)).T
    bias, drift = bias_and_drift(trajectory, from_sensor)
    sensor_axes = rotation_matrix(trajectory.sensor_orientation)
    on_tool = tool_wrench(tool, trajectory, sensor_axes)
    pulls = tool_pulls(tool, sensor_axes, SIDEWAYS)
    tared = trajectory.time_s[tare].mean()
    stretches = steady_samples(trajectory)
    durations = np.array([np.ptp(trajectory.time_s[kept]) for kept in stretches])
    noise = [scatter_about_parabola(wrench[kept]) for kept in stretches]  # gravity turns in an object that is rocked
    # One noise density for all windows, mostly of the long ones: a few correlated samples underestimate it
    density = np.einsum("k,kij->ij", durations**3, noise) / (durations**2).sum()
    windows = []
    for kept, seconds in zip(stretches, durations, strict=True):
        windows.append(
            LiftWindow(
                grasp=action.grasp,
                wrench=wrench[kept].mean(axis=0),
                covariance=density / seconds,
                pull=motion[kept, :3].mean(axis=0),
                angular_acceleration=motion[kept, 3:].mean(axis=0),
                spin_products=spin[kept].T @ spin[kept] / len(kept),
                tcp_height=float(trajectory.tcp_position[flat, 2]),
                bias_covariance=bias,
                drift_covariance=drift,
                since_tare=trajectory.time_s[kept[[0, -1]]] - tared,
                from_sensor=from_sensor,
                tool=on_tool[kept].mean(axis=0) - on_tool[tare].mean(axis=0),
                tool_mass=tool.mass,
                tool_rate=_rate(trajectory.time_s[kept], on_tool[kept]),
                pull_rate=_rate(trajectory.time_s[kept], motion[kept, :3]),
                pull_tilt=SIDEWAYS @ axes[kept].mean(axis=0),
                tool_tilt=pulls[kept].mean(axis=0) - pulls[tare].mean(axis=0),
                setup=trajectory.setup,
            )
        )
    return windows


def poses_in_space(trajectory: Trajectory) -> tuple[Float[np.ndarray, "T 3"], Float[np.ndarray, "T 3 3"]]:
    """Origin of the object frame, on its bottom [m], and its axes in a lift, from the hand's pose; at rest before it.

    Raises:
        InvalidValueError: a record without samples in phase SETTLE.
    """
    flat, _, axes = _held_axes(trajectory)
    origin = np.append(trajectory.object_pose[flat, :2], 0.0)
    lever = axes[flat].T @ (origin - trajectory.tcp_position[flat])
    released = np.flatnonzero(trajectory.mask(Phase.RELEASE))
    last = released[0] - 1 if len(released) else len(axes) - 1
    held = np.clip(np.arange(len(axes)), flat, max(last, flat))
    return trajectory.tcp_position[held] + axes[held] @ lever, axes[held]


def _held_axes(trajectory: Trajectory) -> tuple[int, Float[np.ndarray, "3 3"], Float[np.ndarray, "T 3 3"]]:
    """Last sample at rest on the table, object axes in sensor axes, and in the world as if the grip held throughout."""
    held = np.flatnonzero(trajectory.mask(Phase.SETTLE))
    if len(held) == 0:
        raise InvalidValueError("trajectory", "no settling of the grip", "the record of a whole lift")
    flat, sensor = int(held[-1]), rotation_matrix(trajectory.sensor_orientation)
    mount = sensor[flat].T @ rotation_z(float(trajectory.object_pose[flat, 2]))
    return flat, mount, sensor @ mount


def _rate(time: Float[np.ndarray, "T"], samples: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "n"]:
    """Slope of samples with time."""
    return np.polynomial.polynomial.polyfit(time - time.mean(), samples, 1)[1]
