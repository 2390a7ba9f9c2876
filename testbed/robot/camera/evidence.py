"""Checks of a trial by its camera: coverage of the motion, agreement with the hand, and contact time of a push."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from testbed.actions.push import LEAST_CONTACT
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.robot.camera.interface import BLIND, CameraLostError
from testbed.sensing.camera_poses import APART, frame_mismatch
from testbed.sensing.push_windows import TRIM_END, touching
from testbed.trajectory import Phase, Status, Trajectory


def check_place(seen: tuple[float, float, float], stated: tuple[float, float, float]) -> None:
    """Compare the object's pose by the camera with the stated one, x, y [m] and yaw [rad], before any motion.

    Raises:
        CameraLostError: they differ by more than `APART`.
    """
    way, turn = math.dist(seen[:2], stated[:2]), math.remainder(seen[2] - stated[2], math.tau)
    if way > APART[0] or abs(turn) > APART[1]:
        raise CameraLostError(
            f"camera: it sees the object at ({seen[0]:.3f}, {seen[1]:.3f}) m, turned by "
            f"{math.degrees(math.remainder(seen[2], math.tau)):.1f} deg: {way * 1e3:.0f} mm and "
            f"{math.degrees(turn):+.0f} deg from its place; allowed: {APART[0] * 1e3:.0f} mm and "
            f"{math.degrees(APART[1]):.0f} deg; put it there, or plan from where it is seen"
        )


def seen_doubts(record: Trajectory, shape: ObjectShape) -> Iterator[tuple[Status, str]]:
    """Status and reason of every defect that the camera shows in a compensated record."""
    assert record.camera is not None
    moving = record.time_s[np.isin(record.phase, (Phase.RAMP, Phase.STEADY))]
    if not len(moving):
        return
    camera = record.camera
    seen = camera.time_s[~np.isnan(camera.poses).any(axis=(1, 2))]
    inside = seen[(seen > moving[0]) & (seen < moving[-1])]
    gap = float(np.diff([moving[0], *inside, moving[-1]]).max())
    if not gap <= BLIND:
        yield "fault", f"camera: it did not see the object for {gap:.2f} s of the motion; allowed: {BLIND:g} s"
        return
    if record.action.pushes:
        met, left = contact_of(record)
        if left - met < LEAST_CONTACT * record.action.pace:
            yield "slipped", f"the fingertip met the object for {left - met:.2f} s alone"
            return
    if doubt := frame_mismatch(record, shape):
        yield "fault", f"camera: {doubt}; check its place in the robot file, or put the object at its stated place"


def contact_of(record: Trajectory) -> tuple[float, float]:
    """Times of a push's first and last contact between fingertip and object [s]; two zeros without contact."""
    try:
        contact = record.time_s[touching(record)]
    except InvalidValueError:
        return 0.0, 0.0
    return float(contact[0]), float(contact[-1])


def with_evidence(record: Trajectory, shape: ObjectShape) -> Trajectory:
    """Record with status and reason by its camera; for a push also its contact time, and an early end of contact."""
    figures, reason = record.figures, ""
    if record.action.pushes:
        met, left = contact_of(record)
        figures = figures | {"contact_s": left - met}
        if record.time_s[record.segment >= 0][-1] - left > 2 * TRIM_END:
            reason = f"the fingertip left the object at {left:.2f} s, after {left - met:.2f} s in contact"
    status, why = next(seen_doubts(record, shape), ("ok", reason))
    return replace(record, status=status, reason=why, figures=figures)
