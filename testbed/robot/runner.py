"""Trials on the real robot: `RealRunner` shows a plan, runs it under guard, and makes a `Trajectory` of its record."""

from __future__ import annotations

import math
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.errors import InfeasibleTrialError
from testbed.frames import origin_velocity, pose_from_point, rotation_matrix, transform_point
from testbed.objects.model import GRAVITY
from testbed.robot.camera.evidence import check_place, with_evidence
from testbed.robot.camera.interface import ObjectCamera, SeenPose, seen_stream
from testbed.robot.camera.watch import CameraWatch
from testbed.robot.config import RobotSettings
from testbed.robot.execution import Execution
from testbed.robot.guard import Guard
from testbed.robot.interfaces import Arm, Clock, Gripper, MonotonicClock, ObjectPose, RobotError, WrenchSensor
from testbed.robot.path import RobotPlan, closing_yaw, described, plan_trial
from testbed.robot.raw_record import RawRecord
from testbed.robot.recorder import Record, Recorder, doubts
from testbed.robot.safety import UnsafeError
from testbed.robot.weighing import weigh
from testbed.sensing.camera_poses import with_camera_poses
from testbed.sensing.compensation import compensate, tare_samples
from testbed.sensing.drift import judge_drift
from testbed.trajectory import SERIES, Phase, Status, Trajectory
from testbed.trial import Trial


class RealRunner:
    """A `TrialRunner` on a real arm, gripper and wrench sensor. Entering it connects and moves nothing.

    The arm is stopped at any end of a trial: completion, an error, a limit, Ctrl-C, SIGTERM, SIGHUP, a lost device.
    """

    def __init__(
        self,
        arm: Arm,
        gripper: Gripper,
        sensor: WrenchSensor,
        object_pose: ObjectPose,
        settings: RobotSettings,
        *,
        confirm: Callable[[str], bool],
        tracker: ObjectPose | None = None,
        camera: ObjectCamera | None = None,
        raw: Path | None = None,
        clock: Clock | None = None,
    ):
        """Create the runner without connecting.

        Args:
            arm: arm, entered with the runner.
            gripper: gripper on that arm.
            sensor: wrench sensor between the two, entered with the runner.
            object_pose: source of the object's pose before each trial.
            settings: table, tool, speeds and limits.
            confirm: function of the description of the first motion; True permits it.
            tracker: source of the object's pose after a trial, for its slip in the grip; without it slip is unknown.
            camera: camera, entered with the runner; required for pushes and objects with hinges.
            raw: folder for the raw record of each trial (`RawRecord`); None for none.
            clock: clock of arm and sensor; the computer's monotonic clock if left out.
        """
        self._arm, self._gripper, self._sensor, self._object_pose = arm, gripper, sensor, object_pose
        self._settings, self._confirm, self._tracker = settings, confirm, tracker
        self._camera, self._raw = camera, raw
        self._tool_checked = False
        self._clock = MonotonicClock() if clock is None else clock
        self._confirmed = False
        self._connections: ExitStack | None = None

    def __enter__(self) -> Self:
        """Connect sensor, camera and arm.

        Raises:
            RobotError: a device cannot be reached, or is not the expected one.
        """
        with ExitStack() as stack:
            stack.enter_context(terminable())
            stack.enter_context(self._sensor)
            if self._camera is not None:
                stack.enter_context(self._camera)
            stack.enter_context(self._arm)
            stack.callback(self._arm.stop)
            self._connections = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        connections, self._connections = self._connections, None
        if connections is not None:
            connections.close()

    def plan(self, trial: Trial) -> RobotPlan:
        """Plan a trial, without motion; only the source of the object's pose is read.

        Raises:
            InfeasibleTrialError: a position outside the box, a speed beyond its limit, or a missing camera.
            RobotError: the object's pose is unknown.
        """
        if self._camera is None and trial.action.needs_camera(trial.object.shape):
            raise InfeasibleTrialError(
                "camera: the hand does not hold all that moves, and no camera sees it; state one in the robot file"
            )
        plan = plan_trial(trial, np.array(self._object_pose.read()), self._settings)
        plan.check(self._settings)
        return plan

    def run(self, trial: Trial) -> Trajectory:
        """Run one trial.

        Returns:
            Measured trajectory. Status `limit` after an exceeded limit, `fault` after a failure or with an invalid
            record, `slipped` if the object moved in the grip; each with its reason.

        Raises:
            InfeasibleTrialError: refused before any motion.
            RobotError: not confirmed, not entered, or ended before the record began.
        """
        if self._connections is None:
            raise RobotError("the robot is not connected: use the runner in a with statement")
        plan = self.plan(trial)
        camera = self._camera if trial.action.needs_camera(trial.object.shape) else None
        if camera is not None:
            x, y, yaw = plan.object_pose.tolist()
            check_place(seen_place(camera, self._clock, trial).read(), (x, y, yaw))
        if not (self._confirmed or self._confirm(described(plan, self._settings))):
            raise RobotError("the motion was not confirmed; nothing has moved")
        raw = None if self._raw is None else RawRecord(self._raw)
        self._confirmed = True
        if raw is None:
            return self._run(plan, None, camera)
        ended = "interrupted", ""
        try:
            trajectory = self._run(plan, raw, camera)
            ended = trajectory.status, trajectory.reason
            return trajectory
        except BaseException as error:
            ended = "interrupted", f"{type(error).__name__} {error}"
            raise
        finally:
            raw.end(self._clock.now(), *ended)

    def _run(self, plan: RobotPlan, raw: RawRecord | None, camera: ObjectCamera | None) -> Trajectory:
        chain, action = plan.trial.object.shape.chain, plan.trial.action
        push = max(abs(part.speed) for part in action.steady) if action.pushes else 0.0
        watch = CameraWatch(self._settings.camera, 1 if chain is None else chain.links, push)
        recorder = Recorder(self._arm, self._sensor, raw, camera, watch)
        guard = Guard(self._arm, self._sensor, self._settings.limits, self._clock, recorder)
        execution = Execution(plan, self._arm, self._gripper, self._sensor, guard, self._settings, self._clock)
        failure, began = None, False
        try:
            with guard:
                began = True
                execution.run(check_tool=not self._tool_checked)
                self._tool_checked = True
        except RobotError as error:
            failure = error
        record = recorder.record(self._clock.now()) if began else None
        if record is None:
            place = "; the tool must point down over the table" if isinstance(failure, UnsafeError) else ""
            raise RobotError(f"before anything moved: {failure}{place}") from failure
        figures = execution.figures | {"sensor_gap_s": record.wrench_gap, "feedback_gap_s": record.feedback_gap}
        status, reason = "ok", ""
        if failure is not None or execution.evidence is None:
            limit = isinstance(failure, UnsafeError) and not failure.violation.broken
            status, reason = "limit" if limit else "fault", str(failure)
        else:
            evidence = replace(execution.evidence, slip=self._slip(plan, record))
            figures |= evidence.figures
            path = None if plan.act is None else plan.act.path
            status, reason = next(doubts(record, evidence, path), ("ok", ""))
        provenance = {
            "runner": "robot",
            "recorded": timestamp(),
            "arm": str(self._arm.identity),
            "sensor": " ".join((self._sensor.identity.name, self._sensor.identity.serial)),
            **({} if raw is None else {"raw": raw.path.name}),
            "slip": "measured by a tracker" if "slip_m" in figures else "not known, but for the opening of the gripper",
        }
        whole = trajectory_of(plan, record, self._settings, status, reason, figures, provenance)
        if whole.ok and whole.camera is not None:
            whole = with_evidence(whole, plan.trial.object.shape)
        judged = judge_drift(whole, self._settings.drift)
        return lifted(judged) if not plan.trial.action.moves and judged.ok else judged

    def _slip(self, plan: RobotPlan, record: Record) -> tuple[float, float] | None:
        """Slip of the object in the grip, at the grasp, tracker against hand [m, rad]; None without a tracker."""
        if self._tracker is None or plan.grasp is None:
            return None
        held = np.flatnonzero(record.during(Phase.RAMP, Phase.STEADY))[-1]
        expected = object_poses(plan, record, self._settings)[held]
        try:
            seen = np.array(self._tracker.read())
        except RobotError:  # no pose now; the record is valid nevertheless
            return None
        held_at, seen_at = (transform_point(pose, plan.grasp.position) for pose in (expected, seen))
        return float(np.hypot(*(seen_at - held_at))), abs(math.remainder(seen[2] - expected[2], math.tau))


def trajectory_of(
    plan: RobotPlan,
    record: Record,
    settings: RobotSettings,
    status: Status,
    reason: str,
    figures: dict[str, float],
    provenance: dict[str, str],
) -> Trajectory:
    """Trajectory of an action or a weighing, compensated for the tool if the sensor has been tared."""
    pose, shape, begin = object_poses(plan, record, settings), plan.trial.object.shape, float(record.time_s[0])
    held = (0.0, 0.0) if plan.grasp is None else plan.grasp.position
    parts = 1 if shape.chain is None else shape.chain.links
    tool = Rotation.from_quat(record.tcp_orientation, scalar_first=True)
    sensor = tool * Rotation.from_quat(settings.sensor_orientation, scalar_first=True)
    count = len(record.time_s)
    whole = Trajectory(
        action=plan.trial.action,
        status=status,
        reason=reason,
        time_s=record.time_s - record.time_s[0],
        phase=record.phase,
        segment=record.segment,
        object_pose=pose,
        object_velocity=origin_velocity(record.tcp_velocity, pose[:, 2], np.array(held)),
        tcp_position=record.tcp_position - [0.0, 0.0, settings.table_height],
        tcp_velocity=record.tcp_velocity,
        sensor_orientation=sensor.as_quat(scalar_first=True),
        sensor_wrench=settings.on_tool(record.wrench),
        wrench_on_object_world=np.zeros((count, 6)),
        joint_position=record.joint_position,
        tool=settings.tool,
        sensor_bias_std=np.repeat(settings.bias_std, 3),
        sensor_drift_std=np.repeat(settings.drift_std, 3),
        setup=settings.setup,
        camera=None if record.seen is None else seen_stream(record.seen, settings.camera, begin, parts),
        figures=figures,
        provenance=provenance,
    )
    return with_camera_poses(compensate(whole) if whole.mask(Phase.TARE).any() else whole)


def seen_place(camera: ObjectCamera, clock: Clock, trial: Trial) -> SeenPose:
    """Source of the object's pose by a camera: of the gripped link of an object with hinges."""
    chain, shape, grasp = trial.object.shape.chain, trial.object.shape, trial.action.grasp
    if chain is None or grasp is None:
        return SeenPose(camera, clock)
    return SeenPose(camera, clock, chain.links, int(chain.link[shape.pressed(shape.grasps[grasp])[0]]))


def object_poses(plan: RobotPlan, record: Record, settings: RobotSettings) -> Float[np.ndarray, "T 3"]:
    """Planar pose of the object by the hand's [m, rad], (T, 3), without slip; for a push its initial pose."""
    if plan.grasp is None:
        return np.tile(plan.object_pose, (len(record.time_s), 1))
    yaw = np.unwrap(closing_yaw(record.tcp_orientation, settings)) - plan.grasp.angle
    return pose_from_point(record.tcp_position[:, :2], plan.grasp.position, yaw)


def lifted(measured: Trajectory) -> Trajectory:
    """Convert a weighing by lifting to a scale's reading, its weight in z of `wrench_on_object_world`.

    `figures["weight_std_kg"]` is the standard error by the bias after the tare, the walk of the zero since then, and
    the scatter of both readings.
    """
    kept = measured.mask(Phase.STEADY)
    axes = rotation_matrix(measured.sensor_orientation[kept][0])
    empty = tare_samples(measured)
    since = measured.time_s[kept].mean() - measured.time_s[empty].mean()
    drift = float(np.hypot(measured.sensor_bias_std[2], measured.sensor_drift_std[2] * np.sqrt(since)))
    reading = weigh(measured.sensor_wrench[empty], measured.sensor_wrench[kept], axes[2], drift=drift)
    series = {name: getattr(measured, name)[kept] for name in ("time_s", "phase", *SERIES)}
    series["time_s"] -= series["time_s"][0]
    figures = measured.figures | {"weight_kg": reading.mass, "weight_std_kg": reading.standard_error}
    return replace(measured, **series, segment=np.zeros(kept.sum(), dtype=int), tool=None, figures=figures)


def read_off(weight: float) -> Trajectory:
    """Trajectory of one sample from a scale's reading [kg] by the user."""
    provenance = {"runner": "robot", "recorded": timestamp(), "weight": "read off a scale"}
    return Trajectory.of_scale(np.array([weight * GRAVITY]), np.zeros(1), provenance)


def timestamp() -> str:
    """Current time, UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


@contextmanager
def terminable() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise SystemExit, so that the arm is stopped; in the main thread only."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, _: object) -> None:
        for name in before:
            signal.signal(name, signal.SIG_IGN)  # a second signal must not interrupt the stop
        sys.exit(128 + number)

    kept = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN  # as nohup does
    before = {name: signal.signal(name, end) for name in (signal.SIGTERM, *([] if kept else [signal.SIGHUP]))}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)
