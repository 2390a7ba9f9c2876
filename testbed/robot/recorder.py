"""Everything that arm and sensor say during a trial, brought onto one time base: the sensor's."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation, Slerp

from testbed.actions.path import Profile
from testbed.robot.interfaces import Arm, ArmState, RobotError, WrenchSample, WrenchSensor
from testbed.trajectory import Phase, Status

_SMOOTHING = 11
"""Feedbacks over which the hand's velocity is smoothed: 0.1 s, as the tool compensation does with it again."""


@dataclass(frozen=True)
class Mark:
    """A moment at which a phase began."""

    time_s: float
    phase: Phase
    profile: Profile | None = None
    """Of the action that began, which tells ramps and steady stretches apart."""


@dataclass(frozen=True, eq=False)
class Record:
    """T frames of the sensor, and what the arm did at each."""

    time_s: Float[np.ndarray, "T"]
    """s, the clock's own."""
    phase: Int[np.ndarray, "T"]
    segment: Int[np.ndarray, "T"]
    wrench: Float[np.ndarray, "T 6"]
    """Raw, sensor axes."""
    tcp_position: Float[np.ndarray, "T 3"]
    """m, base frame."""
    tcp_orientation: Float[np.ndarray, "T 4"]
    """wxyz, base frame."""
    tcp_velocity: Float[np.ndarray, "T 6"]
    """From the poses; base axes, m/s and rad/s."""
    joint_position: Float[np.ndarray, "T 7"]
    """rad, without jumps where a joint has turned round."""
    wrench_gap: float
    """Longest time between frames, s."""
    feedback_gap: float
    """Longest time between feedbacks of the arm, s."""

    def during(self, *phases: Phase) -> np.ndarray:
        """Which frames came in the given phases, (T,) bool."""
        return np.isin(self.phase, phases)


class Recorder:
    """Takes in frames and feedback: one thread takes, any may mark."""

    def __init__(self, arm: Arm, sensor: WrenchSensor):
        self._arm, self._sensor = arm, sensor
        self._states: list[ArmState] = []
        self._samples: list[WrenchSample] = []
        self._marks: list[Mark] = []
        sensor.drain()  # what piled up before is of no trial

    def take(self) -> None:
        """Take in what has come.

        Raises:
            RobotError: sensor or arm is lost.
        """
        self._samples.extend(self._sensor.drain())
        state = self._arm.state()
        if not self._states or state.time_s > self._states[-1].time_s:
            self._states.append(state)

    @property
    def state(self) -> ArmState | None:
        """Newest feedback taken."""
        return self._states[-1] if self._states else None

    @property
    def sample(self) -> WrenchSample | None:
        """Newest frame taken."""
        return self._samples[-1] if self._samples else None

    def mark(self, mark: Mark) -> None:
        """Say what begins now."""
        self._marks.append(mark)

    def mean_wrench(self, begin: float, end: float) -> Float[np.ndarray, "6"]:
        """Mean of the frames between two moments, sensor axes, (6,).

        Raises:
            RobotError: there is none.
        """
        kept = [sample.wrench for sample in list(self._samples) if begin <= sample.time_s <= end]
        if not kept:
            raise RobotError(f"sensor: no frame in the {end - begin:.2f} s in which it was to be zeroed")
        return np.mean(kept, axis=0)

    def record(self, end: float) -> Record | None:
        """The frames from the first mark to `end` (s), as far as the arm's feedback goes; None where there are none."""
        if not self._marks or len(self._states) < 2:
            return None
        at = np.array([state.time_s for state in self._states])
        begin, end = max(self._marks[0].time_s, at[0]), min(end, at[-1])
        samples = [sample for sample in self._samples if begin <= sample.time_s <= end]
        if not samples:
            return None
        time = np.array([sample.time_s for sample in samples])
        keep = np.flatnonzero(np.diff(time, prepend=-np.inf) > 0)
        time = time[keep]
        turn = np.array([state.tcp_pose.orientation for state in self._states])
        position = np.array([state.tcp_pose.position for state in self._states])
        joints = np.unwrap([state.joint_position for state in self._states], axis=0)
        phase, segment = _labels(self._marks, time)
        inside = (at >= begin) & (at <= end)
        return Record(
            time_s=time,
            phase=phase,
            segment=segment,
            wrench=np.array([samples[i].wrench for i in keep]),
            tcp_position=_interpolated(time, at, position),
            tcp_orientation=Slerp(at, _rotation(turn))(time).as_quat(scalar_first=True),
            tcp_velocity=_interpolated(time, at, _velocity(at, position, turn)),
            joint_position=_interpolated(time, at, joints),
            wrench_gap=_longest_gap(time, begin, end),
            feedback_gap=_longest_gap(at[inside], begin, end),
        )


def _labels(marks: list[Mark], time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Phase and steady stretch of each frame."""
    which = np.searchsorted([mark.time_s for mark in marks], time, side="right") - 1
    phase = np.array([marks[i].phase for i in which], dtype=int)
    segment = np.full(len(time), -1)
    for i, mark in enumerate(marks):
        if mark.profile is None:
            continue
        own = np.flatnonzero(which == i)
        tick = np.rint((time[own] - mark.time_s) / mark.profile.step).astype(int) - 1
        running = (tick >= 0) & (tick < len(mark.profile.segment))
        segment[own[running]] = mark.profile.segment[tick[running]]
        phase[own] = np.where(segment[own] >= 0, Phase.STEADY, Phase.RAMP)
    return phase, segment


def _rotation(quaternion: np.ndarray) -> Rotation:
    return Rotation.from_quat(quaternion, scalar_first=True)


def _velocity(time: np.ndarray, position: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Linear and angular velocity from poses, (N, 6): an arm's own twist leaves its axes open."""
    last = len(time) - 1
    before, after = np.maximum(np.arange(last + 1) - 1, 0), np.minimum(np.arange(last + 1) + 1, last)
    step = (time[after] - time[before])[:, None]
    linear = (position[after] - position[before]) / step
    angular = (_rotation(turn[after]) * _rotation(turn[before]).inv()).as_rotvec() / step
    rates = np.hstack([linear, angular])
    return np.asarray(savgol_filter(rates, _SMOOTHING, 2, axis=0)) if len(time) > _SMOOTHING else rates


def _interpolated(time: np.ndarray, at: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(time, at, column) for column in values.T])


def _longest_gap(time: np.ndarray, begin: float, end: float) -> float:
    return float(np.diff([begin, *time, end]).max())


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
    """Every reason, with the status it means; drift is judged by `testbed.sensing.drift`."""
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
