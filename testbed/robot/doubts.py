"""What speaks against a record: every reason for which a trial that ran to its end is still no data."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from testbed.profile import Profile
from testbed.robot.recorder import Record
from testbed.trajectory import Phase, Status

SLIP_LIMIT = (0.003, math.radians(1.5))
"""Movement in the grip beyond which a trial is no data, m and rad: the simulated bench's."""
WIDTH_LIMIT = 0.0015
"""Change of the gripper's opening while it held, m: something went out of the grip, or the fingers opened."""
GAP_LIMIT = 0.05
"""Silence of sensor or arm, s."""
LOST_LIMIT = 0.01
"""Part of the sensor's frames that may be lost."""
COVERED = 0.95
"""Part of a steady stretch's frames that must be there."""
FROZEN = 10
"""Equal frames in a row that no living sensor sends: its noise is several counts."""
RESTLESS = 0.5
"""Standard deviation of force during a tare at which something touches or shakes the tool, N."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a trial left besides its record."""

    lost_frames: int
    """Of the sensor, while the trial ran."""
    held_width: tuple[float, float]
    """Opening of the gripper after it closed and before it opened, m."""
    slip: tuple[float, float] | None
    """Movement in the grip, m and rad; None where nothing measures the object's pose."""

    @property
    def figures(self) -> dict[str, float]:
        """As the figures of a trajectory."""
        found = {
            "lost_frames": float(self.lost_frames),
            "grip_change_m": self.held_width[1] - self.held_width[0],
        }
        return found if self.slip is None else found | {"slip_m": self.slip[0], "slip_rad": self.slip[1]}


def doubts(record: Record, evidence: Evidence, profile: Profile | None) -> Iterator[tuple[Status, str]]:
    """Every reason, with the status it means; drift is judged by `testbed.drift`."""
    change = abs(evidence.held_width[1] - evidence.held_width[0])
    if not change <= WIDTH_LIMIT:
        yield "slipped", f"the gripper's opening changed by {change * 1e3:.1f} mm while it held"
    if evidence.slip is not None and not (evidence.slip[0] <= SLIP_LIMIT[0] and evidence.slip[1] <= SLIP_LIMIT[1]):
        moved, turned = evidence.slip
        yield "slipped", f"the object moved {moved * 1e3:.1f} mm and {math.degrees(turned):.2f} deg in the grip"
    for name, gap in (("sensor", record.wrench_gap), ("arm", record.feedback_gap)):
        if not gap <= GAP_LIMIT:
            yield "fault", f"{name}: silent for {gap * 1e3:.0f} ms; allowed: {GAP_LIMIT * 1e3:.0f} ms"
    if evidence.lost_frames > LOST_LIMIT * len(record.time_s):
        yield "fault", f"sensor: {evidence.lost_frames} of {len(record.time_s)} frames lost; allowed: 1 %"
    if (run := _longest_run(record.wrench)) >= FROZEN:
        yield "fault", f"sensor: {run} equal frames in a row; it does not measure any more"
    for tare in _stretches(record.during(Phase.TARE)):
        spread = record.wrench[tare, :3].std(axis=0).max()
        if not spread <= RESTLESS:
            yield (
                "fault",
                f"tare: the force scattered by {spread:.2f} N; allowed: {RESTLESS} N; let nothing touch the tool",
            )
    if profile is not None:
        yield from _uncovered(record, profile)


def _uncovered(record: Record, profile: Profile) -> Iterator[tuple[Status, str]]:
    for segment in range(profile.segment.max() + 1):
        seconds = (profile.segment == segment).sum() * profile.step
        rate = 1 / np.median(np.diff(record.time_s))
        have, wanted = int((record.segment == segment).sum()), seconds * rate
        if have < COVERED * wanted:
            yield "fault", f"sensor: {have} of {wanted:.0f} frames of steady stretch {segment}"


def _longest_run(wrench: np.ndarray) -> int:
    """Greatest number of equal rows in a row."""
    new = np.concatenate([[True], (np.diff(wrench, axis=0) != 0).any(axis=1), [True]])
    return int(np.diff(np.flatnonzero(new)).max())


def _stretches(mask: np.ndarray) -> list[np.ndarray]:
    """Indices of every run of True."""
    inside = np.flatnonzero(mask)
    return np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1) if len(inside) else []
