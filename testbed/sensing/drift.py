"""How far a sensor's zero moved while a trial ran, and when that makes the trial no data.

A trial on a real bench begins and ends with a tare in the same place. The wrench is counted from the first one; what
the second one shows beside it is what the record may be wrong by at its end. Estimators weigh a record by how fast its
zero is taken to walk: as the bench assumes of its sensor, or faster where the two tares show it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from testbed.sensing.compensation import tare_biases, tare_samples
from testbed.trajectory import Phase, Trajectory
from testbed.validation import check_positive, frozen_array

_AXES = ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm")


@dataclass(frozen=True)
class DriftLimit:
    """Drift beyond which a trial is no data.

    The default is the bias that cost 28 % NAD on a block object turned one way, and 3 % there and back; a tare of 0.5 s
    with an FT-300S sees it at some four times its own scatter.
    """

    force: float = 0.2
    """N."""
    torque: float = 0.01
    """N m."""

    def __post_init__(self) -> None:
        check_positive("DriftLimit.force", self.force)
        check_positive("DriftLimit.torque", self.torque)


@dataclass(frozen=True, eq=False)
class Drift:
    """The sensor's zero before and after a trial."""

    before: Float[np.ndarray, "6"]
    """Bias at the first tare, N, N m, sensor axes."""
    after: Float[np.ndarray, "6"]
    """Bias at the last tare."""
    seconds: float
    """From the one to the other, s."""

    def __post_init__(self) -> None:
        for name in ("before", "after"):
            object.__setattr__(self, name, frozen_array(f"Drift.{name}", getattr(self, name), (6,)))
        check_positive("Drift.seconds", self.seconds)

    @property
    def force(self) -> float:
        """Length of the change of force, N."""
        return float(np.linalg.norm(self.after[:3] - self.before[:3]))

    @property
    def torque(self) -> float:
        """Length of the change of torque, N m."""
        return float(np.linalg.norm(self.after[3:] - self.before[3:]))

    @property
    def walk(self) -> Float[np.ndarray, "6"]:
        """The random walk that a change of this size is typical of, N and N m per square root of a second, an axis."""
        return np.repeat([self.force, self.torque], 3) / np.sqrt(3 * self.seconds)

    def exceeds(self, limit: DriftLimit) -> str:
        """Why the trial is no data, in a sentence; empty where it is."""
        if self.force <= limit.force and self.torque <= limit.torque:
            return ""
        return (
            f"drift: the sensor's zero moved by {self.force:.2f} N and {self.torque:.4f} N m; allowed: "
            f"{limit.force:g} N and {limit.torque:g} N m; let the sensor warm up, and do the trial again"
        )


def drift_of(trajectory: Trajectory) -> Drift | None:
    """The drift of a trial, or None where it has not two tares, or no tool."""
    biases = tare_biases(trajectory)
    if len(biases) < 2:
        return None
    ends = np.flatnonzero(trajectory.mask(Phase.TARE))[-1], tare_samples(trajectory)[-1]
    return Drift(biases[0], biases[-1], float(trajectory.time_s[ends[0]] - trajectory.time_s[ends[1]]))


def judge_drift(trajectory: Trajectory, limit: DriftLimit) -> Trajectory:
    """The trial with its biases and drift among its figures; a fault, and so no data, where it drifted too far.

    A trial that has failed for another reason keeps that reason. `sensor_drift_std` is at least what the bench assumes
    of its sensor, and more where the tares show more: two tares meet by chance too. `provenance["drift"]` says which.
    """
    biases, drift = tare_biases(trajectory), drift_of(trajectory)
    figures = dict(trajectory.figures)
    for when, bias in zip(("before", "after"), biases[:1] + biases[1:][-1:], strict=False):
        figures |= {f"bias_{when}_{axis}": float(value) for axis, value in zip(_AXES, bias, strict=True)}
    if drift is None:
        said = {"drift": f"assumed, for want of a second tare: {_in_words(trajectory.sensor_drift_std)}"}
        return replace(trajectory, figures=figures, provenance=trajectory.provenance | said)
    said = {"drift": f"tares {drift.seconds:.0f} s apart show {_in_words(drift.walk)}; "}
    said["drift"] += f"assumed at least {_in_words(trajectory.sensor_drift_std)}"
    trajectory = replace(
        trajectory,
        sensor_drift_std=np.maximum(trajectory.sensor_drift_std, drift.walk),
        provenance=trajectory.provenance | said,
    )
    figures |= {"drift_N": drift.force, "drift_Nm": drift.torque}
    why = drift.exceeds(limit)
    if why and trajectory.ok:
        return replace(trajectory, figures=figures, status="fault", reason=why)
    return replace(trajectory, figures=figures)


def _in_words(walk: Float[np.ndarray, "6"]) -> str:
    return f"{walk[:3].max():.2g} N and {walk[3:].max():.2g} N m per root second"
