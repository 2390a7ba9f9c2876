"""Drift of a sensor's zero during a trial, and the limit beyond which the trial is invalid.

A trial on the robot begins and ends with a tare in the same place. The first one is the zero of the wrench; the second
one shows the error at the end of the record. Estimators weight a record by the random walk of its zero: the walk that
is assumed for the sensor, or a faster one if the two tares show it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from testbed.sensing.compensation import tare_biases, tare_samples
from testbed.trajectory import SERIES, Phase, Trajectory
from testbed.validation import check_positive_fields, freeze_arrays

ANOTHER_UNIT = 30.0
"""Drift of the torque over its limit beyond which, if the force is steady, its unit is in doubt. Ours."""


@dataclass(frozen=True)
class DriftLimit:
    """Greatest drift of a valid trial.

    The default is a bias that cost 28 % NAD on a block object turned one way, and 3 % there and back. It is some four
    times the scatter of a tare of 0.5 s with an FT-300S.
    """

    force: float = 0.2
    """Force [N]."""
    torque: float = 0.01
    """Torque [N m]."""

    def __post_init__(self) -> None:
        check_positive_fields(self, "force", "torque")


@dataclass(frozen=True, eq=False)
class Drift:
    """The sensor's zero before and after a trial."""

    before: Float[np.ndarray, "6"]
    """Bias at the first tare [N, N m], sensor axes."""
    after: Float[np.ndarray, "6"]
    """Bias at the last tare [N, N m], sensor axes."""
    seconds: float
    """Time from the first tare to the last [s]."""

    def __post_init__(self) -> None:
        freeze_arrays(self, before=(6,), after=(6,))
        check_positive_fields(self, "seconds")

    @property
    def force(self) -> float:
        """Norm of the change of force [N]."""
        return float(np.linalg.norm(self.after[:3] - self.before[:3]))

    @property
    def torque(self) -> float:
        """Norm of the change of torque [N m]."""
        return float(np.linalg.norm(self.after[3:] - self.before[3:]))

    @property
    def walk(self) -> Float[np.ndarray, "6"]:
        """Random walk whose root mean square change is this drift [N/sqrt(s), N m/sqrt(s)], for each axis."""
        return np.repeat([self.force, self.torque], 3) / np.sqrt(3 * self.seconds)

    def exceeds(self, limit: DriftLimit) -> str:
        """Reason why the trial is invalid, in a sentence; empty within the limit."""
        if self.force <= limit.force and self.torque <= limit.torque:
            return ""
        remedy = "let the sensor warm up, and do the trial again"
        if self.torque > ANOTHER_UNIT * limit.torque and self.force <= limit.force:
            remedy = f"its torque alone: is that in N m? Otherwise {remedy}"
        return (
            f"drift: the sensor's zero moved by {self.force:.2f} N and {self.torque:.4f} N m; allowed: "
            f"{limit.force:g} N and {limit.torque:g} N m; {remedy}"
        )


def drift_of(trajectory: Trajectory) -> Drift | None:
    """Drift of a trial; None without two tares or a tool."""
    biases = tare_biases(trajectory)
    if len(biases) < 2:
        return None
    ends = np.flatnonzero(trajectory.mask(Phase.TARE))[-1], tare_samples(trajectory)[-1]
    return Drift(biases[0], biases[-1], float(trajectory.time_s[ends[0]] - trajectory.time_s[ends[1]]))


def judge_drift(trajectory: Trajectory, limit: DriftLimit) -> Trajectory:
    """Trajectory with its biases and drift among its figures; its status is `fault` if the drift exceeds the limit.

    A trial that has failed for another reason keeps that reason. `sensor_drift_std` is the greater of the walk that the
    bench assumes and the walk that the tares show, which may agree by chance. `provenance["drift"]` names both.
    """
    biases, drift = tare_biases(trajectory), drift_of(trajectory)
    figures, axes = dict(trajectory.figures), SERIES["sensor_wrench"]
    for when, bias in zip(("before", "after"), biases[:1] + biases[1:][-1:], strict=False):
        figures |= {f"bias_{when}_{axis}": float(value) for axis, value in zip(axes, bias, strict=True)}
    assumed = trajectory.sensor_drift_std
    if drift is None:
        note = f"assumed, for want of a second tare: {_in_words(assumed)}"
        return replace(trajectory, figures=figures, provenance=trajectory.provenance | {"drift": note})
    note = f"tares {drift.seconds:.0f} s apart show {_in_words(drift.walk)}; assumed at least {_in_words(assumed)}"
    reason = drift.exceeds(limit)
    return replace(
        trajectory,
        figures=figures | {"drift_N": drift.force, "drift_Nm": drift.torque},
        sensor_drift_std=np.maximum(assumed, drift.walk),
        provenance=trajectory.provenance | {"drift": note},
        **({"status": "fault", "reason": reason} if reason and trajectory.ok else {}),
    )


def _in_words(walk: Float[np.ndarray, "6"]) -> str:
    return f"{walk[:3].max():.2g} N and {walk[3:].max():.2g} N m per root second"
