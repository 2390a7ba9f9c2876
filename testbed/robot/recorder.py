"""Record of a trial by arm and sensor on the sensor's time base, and checks of its validity."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation, Slerp

from testbed.actions.path import ToolPath
from testbed.robot.camera.interface import ObjectCamera, SeenFrame
from testbed.robot.camera.watch import CameraWatch
from testbed.robot.interfaces import Arm, ArmState, RobotError, WrenchSample, WrenchSensor
from testbed.robot.raw_record import RawRecord
from testbed.sensing.compensation import SMOOTHING
from testbed.sensing.series import interpolated, runs
from testbed.trajectory import Phase, Status


@dataclass(frozen=True)
class Mark:
    """Begin of a phase."""

    time_s: float
    phase: Phase
    path: ToolPath | None = None
    """Path of the action that begins, with its steady stretches."""


@dataclass(frozen=True, eq=False)
class Record:
    """T frames of the sensor, and the arm's motion at each."""

    time_s: Float[np.ndarray, "T"]
    """Time [s] of the robot's clock."""
    phase: Int[np.ndarray, "T"]
    segment: Int[np.ndarray, "T"]
    wrench: Float[np.ndarray, "T 6"]
    """Raw wrench [N, N m], sensor axes."""
    tcp_position: Float[np.ndarray, "T 3"]
    """Position of the TCP [m], base frame."""
    tcp_orientation: Float[np.ndarray, "T 4"]
    """Orientation of the tool frame, wxyz, base frame."""
    tcp_velocity: Float[np.ndarray, "T 6"]
    """Linear and angular velocity from the poses [m/s, rad/s], base axes."""
    joint_position: Float[np.ndarray, "T 7"]
    """Joint angles [rad], without jumps after full turns."""
    wrench_gap: float
    """Longest time between frames [s]."""
    feedback_gap: float
    """Longest time between feedbacks of the arm [s]."""
    seen: tuple[SeenFrame, ...] | None = None
    """Frames of the camera; None without one."""

    def during(self, *phases: Phase) -> np.ndarray:
        """True for the frames in the given phases, shape (T,)."""
        return np.isin(self.phase, phases)


class Recorder:
    """Recorder of frames and feedback. `take` is for one thread, `mark` for any."""

    def __init__(
        self,
        arm: Arm,
        sensor: WrenchSensor,
        raw: RawRecord | None = None,
        camera: ObjectCamera | None = None,
        watch: CameraWatch | None = None,
    ):
        self._arm, self._sensor, self._raw, self._camera, self._watch = arm, sensor, raw, camera, watch
        self._seen: list[SeenFrame] = []
        self._states: list[ArmState] = []
        self._samples: list[WrenchSample] = []
        self._marks: list[Mark] = []
        sensor.drain()  # frames from before the trial
        if camera is not None:
            camera.drain()

    def take(self, now: float) -> list[WrenchSample]:
        """Record all new frames and feedback at the time `now` [s]; returns the frames.

        Raises:
            RobotError: sensor, arm or camera is lost, or the raw record cannot be written.
        """
        new = list(self._sensor.drain())
        self._samples.extend(new)
        if self._raw is not None:
            self._raw.frames(new)
        if self._camera is not None:
            seen = self._camera.drain()
            if self._raw is not None:
                self._raw.seen(seen)
            for frame in seen if self._watch is None else self._watch.kept(seen, now):
                self._seen.append(frame)
        state = self._arm.state()
        if not self._states or state.time_s > self._states[-1].time_s:
            self._states.append(state)
            if self._raw is not None:
                self._raw.state(state)
        return new

    @property
    def state(self) -> ArmState | None:
        """Newest feedback, or None."""
        return self._states[-1] if self._states else None

    @property
    def sample(self) -> WrenchSample | None:
        """Newest frame, or None."""
        return self._samples[-1] if self._samples else None

    def mark(self, mark: Mark) -> None:
        """Record the begin of a phase."""
        self._marks.append(mark)
        if self._raw is not None:
            self._raw.mark(mark.time_s, mark.phase.name)

    def mean_wrench(self, begin: float, end: float) -> Float[np.ndarray, "6"]:
        """Mean wrench between two moments [N, N m], sensor axes, shape (6,).

        Raises:
            RobotError: no frame lies between them.
        """
        kept = [sample.wrench for sample in list(self._samples) if begin <= sample.time_s <= end]
        if not kept:
            raise RobotError(f"sensor: no frame in the {end - begin:.2f} s in which it was to be zeroed")
        return np.mean(kept, axis=0)

    def record(self, end: float) -> Record | None:
        """Record from the first mark to `end` [s], limited to the range of the arm's feedback; None without frames.

        Without a mark it begins with the first frame, in phase APPROACH. Frames with NaN are omitted; the raw record
        has them.
        """
        if not self._samples or len(self._states) < 2:
            return None
        marks = self._marks or [Mark(self._samples[0].time_s, Phase.APPROACH)]
        at = np.array([state.time_s for state in self._states])
        begin, end = max(marks[0].time_s, at[0]), min(end, at[-1])
        whole = [sample for sample in self._samples if np.isfinite(sample.wrench).all()]
        samples = [sample for sample in whole if begin <= sample.time_s <= end]
        if not samples:
            return None
        time = np.array([sample.time_s for sample in samples])
        keep = np.flatnonzero(np.diff(time, prepend=-np.inf) > 0)
        time = time[keep]
        turn = np.array([state.tcp_pose.orientation for state in self._states])
        position = np.array([state.tcp_pose.position for state in self._states])
        joints = np.unwrap([state.joint_position for state in self._states], axis=0)
        phase, segment = _labels(marks, time)
        inside = (at >= begin) & (at <= end)
        return Record(
            time_s=time,
            phase=phase,
            segment=segment,
            wrench=np.array([samples[i].wrench for i in keep]),
            tcp_position=interpolated(time, at, position),
            tcp_orientation=Slerp(at, _rotation(turn))(time).as_quat(scalar_first=True),
            tcp_velocity=interpolated(time, at, _velocity(at, position, turn)),
            joint_position=interpolated(time, at, joints),
            wrench_gap=_longest_gap(time, begin, end),
            feedback_gap=_longest_gap(at[inside], begin, end),
            seen=None if self._camera is None else tuple(self._seen),
        )


def _labels(marks: list[Mark], time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Phase and steady stretch of each frame, each (T,)."""
    which = np.searchsorted([mark.time_s for mark in marks], time, side="right") - 1
    phase = np.array([marks[i].phase for i in which], dtype=int)
    segment = np.full(len(time), -1)
    for i, mark in enumerate(marks):
        if mark.path is None:
            continue
        own = np.flatnonzero(which == i)
        tick = np.rint((time[own] - mark.time_s) / mark.path.step).astype(int) - 1
        running = (tick >= 0) & (tick < len(mark.path.segment))
        segment[own[running]] = mark.path.segment[tick[running]]
        phase[own] = np.where(segment[own] >= 0, Phase.STEADY, Phase.RAMP)
    return phase, segment


def _rotation(quaternion: np.ndarray) -> Rotation:
    return Rotation.from_quat(quaternion, scalar_first=True)


def _velocity(time: np.ndarray, position: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Linear and angular velocity from poses [m/s, rad/s], (N, 6), since the axes of an arm's own twist may differ."""
    last = len(time) - 1
    before, after = np.maximum(np.arange(last + 1) - 1, 0), np.minimum(np.arange(last + 1) + 1, last)
    step = (time[after] - time[before])[:, None]
    linear = (position[after] - position[before]) / step
    angular = (_rotation(turn[after]) * _rotation(turn[before]).inv()).as_rotvec() / step
    rates = np.hstack([linear, angular])
    window = 2 * max(round(SMOOTHING * last / (time[-1] - time[0]) / 2), 1) + 1 if last else 1
    return np.asarray(savgol_filter(rates, window, 2, axis=0)) if len(time) > window else rates


def _longest_gap(time: np.ndarray, begin: float, end: float) -> float:
    return float(np.diff([begin, *time, end]).max())


SLIP_LIMIT = (0.003, math.radians(1.5))
"""Largest movement in the grip in a valid trial [m, rad], as in the simulation."""
WIDTH_LIMIT = 0.0015
"""Largest change of the gripper's opening while holding [m]; a larger one indicates a lost grip."""
GAP_LIMIT = 0.05
"""Longest gap between frames or feedbacks [s]."""
LOST_LIMIT = 0.01
"""Largest fraction of lost frames."""
COVERED = 0.95
"""Least fraction of a steady stretch's frames."""
_BLOCK = 10
"""Number of frames per mean that is compared with the tare."""
CHANGE = 6.0
"""Least change of the wrench from the tare to the motion, in standard errors of such a mean: 0.13 N, or 0.002 N m about
z, for an FT-300S. With correlated frames it is 4.4 true standard errors, which 100 means do not reach by chance."""
RESTLESS = 0.5
"""Largest standard deviation of the force during a tare [N]; more indicates contact or vibration of the tool."""


@dataclass(frozen=True, eq=False)
class GripEvidence:
    """Measurements of a trial in addition to its record."""

    lost_frames: int
    """Frames lost during the trial."""
    held_width: tuple[float, float]
    """Opening of the gripper after it closed and before it opened [m]."""
    slip: tuple[float, float] | None
    """Movement in the grip [m, rad]; None without a tracker."""

    @property
    def figures(self) -> dict[str, float]:
        """Figures for the trajectory."""
        found = {"lost_frames": float(self.lost_frames), "grip_change_m": self.held_width[1] - self.held_width[0]}
        return found if self.slip is None else found | {"slip_m": self.slip[0], "slip_rad": self.slip[1]}


def doubts(record: Record, evidence: GripEvidence, path: ToolPath | None) -> Iterator[tuple[Status, str]]:
    """Status and reason of every defect of a record, drift excepted, which `testbed.sensing.drift` checks."""
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
    for tare in runs(record.during(Phase.TARE)):
        spread = record.wrench[tare, :3].std(axis=0).max()
        if not spread <= RESTLESS:
            scattered = f"the force scattered by {spread:.2f} N; allowed: {RESTLESS} N"
            yield "fault", f"tare: {scattered}; let nothing touch the tool"
    if path is not None:
        yield from _uncovered(record, path)
    if (change := _change(record)) < CHANGE:
        felt = f"from the tare to the motion no component changed by more than {change:.1f} standard errors"
        yield (
            "fault",
            f"sensor: {felt}; allowed: at least {CHANGE:g}; the sensor feels nothing, or the hand holds nothing",
        )


def _change(record: Record) -> float:
    """Largest change of a component from the first tare to the motion, in standard errors of a `_BLOCK` mean."""
    tares, moving = runs(record.during(Phase.TARE)), np.flatnonzero(record.during(Phase.RAMP, Phase.STEADY))
    if not tares or len(moving) < _BLOCK:
        return math.inf
    tare = record.wrench[tares[0]]
    blocks = record.wrench[moving[: len(moving) // _BLOCK * _BLOCK]].reshape(-1, _BLOCK, 6).mean(axis=1)
    noise = np.diff(tare, axis=0).std(axis=0) / math.sqrt(2)  # slow scatter of a tare is checked elsewhere
    error = np.maximum(noise, 1e-6) / math.sqrt(_BLOCK)
    return float((np.abs(blocks - tare.mean(axis=0)) / error).max())


def _uncovered(record: Record, path: ToolPath) -> Iterator[tuple[Status, str]]:
    for segment in range(path.segment.max() + 1):
        seconds = (path.segment == segment).sum() * path.step
        rate = 1 / np.median(np.diff(record.time_s))
        have, wanted = int((record.segment == segment).sum()), seconds * rate
        if have < COVERED * wanted:
            yield "fault", f"sensor: {have} of {wanted:.0f} frames of steady stretch {segment}"
