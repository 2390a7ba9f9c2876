"""The scene in dm-control's interactive viewer: a trial simulated live, or a record played back."""

from __future__ import annotations

import signal
import threading
from contextlib import suppress

import dm_control.mujoco
import dm_env
import mujoco
import numpy as np
from dm_control.mujoco.wrapper import MjModel
from dm_env.specs import BoundedArray

from testbed.errors import InvalidValueError
from testbed.simulation.controller import Servo
from testbed.simulation.feasibility import check_feasible
from testbed.simulation.monitor import Monitor, Outcome
from testbed.simulation.motion import plan_motion
from testbed.simulation.rendering import Playback, light
from testbed.simulation.runner import place
from testbed.simulation.scene import build_scene
from testbed.simulation.settings import SimulationSettings
from testbed.trial import Trial

KEYS = "space starts and stops, backspace begins again, F1 lists all keys; drag to turn, scroll to come nearer"
"""Keys of the viewer, for the user."""


class _Scripted:
    """Environment of the viewer, with physics, `reset` and `step`, and an empty action."""

    physics: dm_control.mujoco.Physics

    def action_spec(self) -> BoundedArray:
        return BoundedArray((0,), float, 0.0, 0.0)


class LiveTrial(_Scripted):
    """Trial simulated live; a step is one sample of its record."""

    def __init__(self, trial: Trial, settings: SimulationSettings | None = None):
        """Plan the trial and put the object on the table.

        Raises:
            InvalidValueError: a weighing.
            InfeasibleTrialError: the arm, the gripper or the table cannot do it.
        """
        if not trial.action.moves:
            raise InvalidValueError("action", "weigh", "a slide or a turn: on a scale nothing moves")
        self._settings = settings or SimulationSettings()
        shape = trial.object.shape
        self._motion = plan_motion(trial.action, shape, self._settings)
        check_feasible(trial, self._motion, self._settings)
        tip, origin = trial.action.fingertip(shape), self._motion.center
        grasp = None if tip else trial.grasp
        self._scene = build_scene(
            trial.object, trial.support, grasp, self._settings, origin=origin, meshes=True, tip=tip
        )
        light(self._scene.model)
        self.physics = dm_control.mujoco.Physics.from_model(MjModel(self._scene.model))
        self._steps = self._scene.steps
        self.reset()

    def reset(self) -> dm_env.TimeStep:
        """Restart the trial."""
        model, data = self._scene.model, self.physics.data.ptr
        mujoco.mj_resetData(model, data)
        place(self._scene, data, self._motion)
        self._servo = Servo(data, self._motion, self._settings)
        self._monitor = Monitor(self._scene, data, self._motion, self._settings)
        self._tick = 0
        return dm_env.restart({})

    def step(self, action: np.ndarray) -> dm_env.TimeStep:
        """Simulate one sample, as the runner does."""
        model, data = self._scene.model, self.physics.data.ptr
        self._servo.command(self._tick)
        mujoco.mj_step(model, data, self._steps)
        self._servo.measure(self._tick)
        stopped = self._monitor.must_stop(self._tick)
        self._tick += 1
        over = stopped or self._tick == len(self._motion.q)
        return dm_env.termination(0.0, {}) if over else dm_env.transition(0.0, {})

    @property
    def duration(self) -> float:
        """Duration of the trial [s]."""
        return len(self._motion.q) / self._settings.rate

    def outcome(self) -> Outcome:
        """Outcome so far."""
        return self._monitor.outcome()


class Replay(_Scripted):
    """Record played back; a step is one sample."""

    def __init__(self, playback: Playback):
        self._playback = playback
        self.physics = dm_control.mujoco.Physics.from_model(MjModel(playback.model))
        playback.data = self.physics.data.ptr  # shown by the viewer
        self.reset()

    def reset(self) -> dm_env.TimeStep:
        """Restart at the first sample."""
        self._sample = 0
        self._playback.show(0)
        return dm_env.restart({})

    def step(self, action: np.ndarray) -> dm_env.TimeStep:
        """Show the next sample."""
        last = len(self._playback.trajectory.time_s) - 1
        self._sample = min(self._sample + 1, last)
        self._playback.show(self._sample)
        over = self._sample == last
        return dm_env.termination(0.0, {}) if over else dm_env.transition(0.0, {})


def watch(environment: LiveTrial | Replay, title: str) -> None:
    """Open a window, and return when it is closed or Ctrl-C is pressed; call `graphics.choose_window` first."""
    from dm_control.viewer.application import Application  # noqa: PLC0415  needs a display as soon as it is imported

    interrupted = threading.Event()

    class Window(Application):
        def _tick(self):
            if interrupted.is_set():
                raise KeyboardInterrupt
            super()._tick()

    def interrupt(*_) -> None:
        interrupted.set()
        signal.signal(signal.SIGINT, before)  # a second Ctrl-C interrupts a frame that hangs

    # Interrupt between frames: the viewer logs an exception within a step as the environment's, and continues
    before = signal.signal(signal.SIGINT, interrupt)
    try:
        with suppress(KeyboardInterrupt):
            Window(title=title).launch(environment)
    finally:
        signal.signal(signal.SIGINT, before)
