"""Guard over arm, sensor and control loop during a trial: it stops the arm independently of the loop."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import chain
from typing import Self

import numpy as np
from jaxtyping import Float

from testbed.robot.interfaces import Arm, ArmState, Clock, RobotError, WrenchSample, WrenchSensor
from testbed.robot.recorder import Recorder
from testbed.robot.safety import FrameWatch, SafetyLimits, Snapshot, UnsafeError, Violation, load_violations, violations

PERIOD = 0.01
"""Time between checks [s]."""
_GATE_TIME = 0.02
"""Longest time for which the guard waits for a twist in transit before it stops the arm [s]."""
_STOP_AGAIN = 0.1
"""Time between stop commands after the guard has tripped [s]."""


class Guard:
    """Periodic check, every 10 ms in a thread, that also records the trial.

    A guard that has tripped stays tripped: the arm is stopped, and no further twist is sent.
    """

    def __init__(
        self, arm: Arm, sensor: WrenchSensor, limits: SafetyLimits, clock: Clock, recorder: Recorder | None = None
    ):
        self.recorder = Recorder(arm, sensor) if recorder is None else recorder
        self.trouble: RobotError | None = None
        """Reason that it has tripped, or None."""
        self._arm, self._limits, self._clock = arm, limits, clock
        self._gate = threading.Lock()
        self._frames = FrameWatch(sensor.identity)
        self._rest: Float[np.ndarray, "6"] | None = None
        self._command = np.zeros(6)
        self._looked = self._beat = clock.now()
        self._stopped = -np.inf
        self._running = ExitStack()

    def __enter__(self) -> Self:
        """Start, and wait for the first frame and the first feedback.

        Raises:
            RobotError: one of them does not arrive, or a limit is exceeded from the start.
        """
        self._running.enter_context(self._clock.every(PERIOD, self._look))
        deadline = self._clock.now() + 1.0
        try:
            while self.recorder.sample is None or self.recorder.state is None:
                self._clock.sleep(PERIOD)
                self.check()
                if self._clock.now() > deadline:
                    raise RobotError("the robot is silent: no frame of the sensor, or no feedback of the arm")
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._arm.stop()
        finally:
            self._running.close()

    def rest(self, wrench: Float[np.ndarray, "6"]) -> None:
        """Set the wrench from which loads are measured, sensor axes, (6,); until then it is the first frame's."""
        self._rest = wrench

    def check(self) -> None:
        """Give a sign of life of the control loop.

        Raises:
            RobotError: the guard has tripped, or its periodic check has stopped.
        """
        self._beat = self._clock.now()
        if self.trouble is None and self._beat - self._looked > self._limits.age:
            self._trip(_silent("age of the guard's last look", self._beat - self._looked, self._limits.age))
        if self.trouble is not None:
            raise self.trouble

    def state(self) -> ArmState:
        """The newest feedback; raises as `check`."""
        self.check()
        assert self.recorder.state is not None
        return self.recorder.state

    def twist(self, linear: Float[np.ndarray, "3"], angular: Float[np.ndarray, "3"]) -> None:
        """Command a twist [m/s, rad/s], base axes; raises as `check`, also if the twist exceeds a limit."""
        self.check()
        command = np.concatenate([linear, angular])
        found = next(self._violations(self._beat, command), None)
        if found is not None:
            self._trip(UnsafeError(found))
        with self._gate:
            if self.trouble is None:
                self._command = command
                self._arm.twist(linear, angular)
        self.check()

    def _violations(self, now: float, command: np.ndarray) -> Iterator[Violation]:
        state, sample = self.recorder.state, self.recorder.sample
        if state is not None and sample is not None:
            at = Snapshot(now, state, sample.time_s, self._load(sample), command)
            yield from violations(self._limits, self._arm.limits, at)

    def _load(self, sample: WrenchSample) -> np.ndarray:
        if self._rest is None:
            self._rest = sample.wrench
        return sample.wrench - self._rest

    def _frame_violations(self, samples: list[WrenchSample]) -> Iterator[Violation]:
        """Violations by every new frame, not only the newest."""
        for sample in samples:
            yield from self._frames.violations(sample.wrench)
            yield from load_violations(self._limits, self._load(sample))

    def _look(self) -> None:
        now = self._clock.now()
        try:
            new = self.recorder.take(now)
            found = next(chain(self._frame_violations(new), self._violations(now, self._command)), None)
            if found is not None:
                raise UnsafeError(found)
            if self._command.any() and now - self._beat > self._limits.age:
                raise _silent("silence of the control loop", now - self._beat, self._limits.age)
        except RobotError as error:
            self._trip(error)
        except Exception as error:  # an error of a driver must not end the guard
            self._trip(RobotError(f"{type(error).__name__}: {error}"))
        self._looked = now
        if self.trouble is not None and now - self._stopped > _STOP_AGAIN:
            self._stopped = now
            self._arm.stop()

    def _trip(self, error: RobotError) -> None:
        """Stop the arm. A twist that hangs in transit does not delay it: `stop` discards that twist."""
        if self.trouble is not None:
            return
        entered = self._gate.acquire(timeout=_GATE_TIME)
        self.trouble = error
        self._stopped = self._clock.now()
        try:
            self._arm.stop()
        finally:
            if entered:
                self._gate.release()


def _silent(what: str, age: float, allowed: float) -> UnsafeError:
    return UnsafeError(Violation(what, age, allowed, "s", broken=True))
