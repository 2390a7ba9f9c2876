"""How far a sensor's zero moved while a trial ran, and when that makes the trial no data.

A trial on a real bench begins and ends with a tare in the same place. The wrench is counted from the first one; what
the second one shows beside it is what the record may be wrong by at its end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from testbed.arrays import check_positive, frozen_array
from testbed.sensing import tare_biases
from testbed.trajectory import Trajectory

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

    def __post_init__(self) -> None:
        for name in ("before", "after"):
            object.__setattr__(self, name, frozen_array(f"Drift.{name}", getattr(self, name), (6,)))

    @property
    def force(self) -> float:
        """Length of the change of force, N."""
        return float(np.linalg.norm(self.after[:3] - self.before[:3]))

    @property
    def torque(self) -> float:
        """Length of the change of torque, N m."""
        return float(np.linalg.norm(self.after[3:] - self.before[3:]))

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
    return Drift(biases[0], biases[-1]) if len(biases) > 1 else None


def judge_drift(trajectory: Trajectory, limit: DriftLimit) -> Trajectory:
    """The trial with its biases and drift among its figures; a fault, and so no data, where it drifted too far.

    A trial that has failed for another reason keeps that reason.
    """
    biases, drift = tare_biases(trajectory), drift_of(trajectory)
    figures = dict(trajectory.figures)
    for when, bias in zip(("before", "after"), biases[:1] + biases[1:][-1:], strict=False):
        figures |= {f"bias_{when}_{axis}": float(value) for axis, value in zip(_AXES, bias, strict=True)}
    if drift is None:
        return replace(trajectory, figures=figures)
    figures |= {"drift_N": drift.force, "drift_Nm": drift.torque}
    why = drift.exceeds(limit)
    if why and trajectory.ok:
        return replace(trajectory, figures=figures, status="fault", reason=why)
    return replace(trajectory, figures=figures)
