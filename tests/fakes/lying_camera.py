"""Cameras of the fake robot that send other frames than the true ones, from the begin of the motion on."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from testbed import ObjectModel, Push, Slide, Trial
from testbed.objects.chain import Chain
from testbed.robot.camera.interface import SeenFrame
from tests.fakes.robot import FakeRobot, small_object

Lie = Callable[[list[SeenFrame]], SeenFrame]
"""Frame in place of the last one, by all true frames so far."""

PUSH = Trial(small_object(), Push((0.05, -0.01), math.pi))


def in_links() -> ObjectModel:
    """The two blocks of `small_object` on a hinge between them."""
    chain, obj = Chain(np.array([0, 1]), np.zeros((1, 2))), small_object()
    return replace(obj, shape=replace(obj.shape, chain=chain), hinge_friction=(0.01,))


DRAG = Trial(in_links(), Slide(0, direction=0.5, duration=1.6))


def begins(lie: Lie) -> Callable[[FakeRobot], None]:
    """Let the camera lie once the hand moves over the table."""

    def watch(robot: FakeRobot) -> None:
        low = robot.world.reading.tcp_pose.position[2] < 0.05
        if robot.camera.lies is None and robot.world.twist[:2].any() and low:
            robot.camera.lies, robot.camera.lied_at = lie, robot.clock.now()

    return watch


def shifted(*off: float) -> Lie:
    return lambda frames: SeenFrame(frames[-1].time_s, frames[-1].poses + off)


def forged(*off: float) -> Lie:
    """Every other frame is another program's."""
    return lambda frames: SeenFrame(frames[-1].time_s, frames[-1].poses + np.multiply(off, len(frames) % 2))


def stamped(seconds: float) -> Lie:
    return lambda frames: SeenFrame(frames[-1].time_s + seconds, frames[-1].poses)


def late(seconds: float) -> Lie:
    """Poses of some time ago with the stamps of now."""
    return lambda frames: SeenFrame(
        frames[-1].time_s, [f for f in frames if f.time_s <= frames[-1].time_s - seconds][-1].poses
    )


def scaled(factor: float) -> Lie:
    return lambda frames: SeenFrame(frames[-1].time_s, frames[0].poses + factor * (frames[-1].poses - frames[0].poses))


LIES: dict[str, tuple[Lie, str]] = {
    "30 mm beside": (shifted(0.03, 0, 0), "frames jump"),
    "17 deg": (shifted(0, 0, 0.3), "frames jump"),
    "300 ms late": (late(0.3), "late against the hand|from where the hand has it"),
    "stamped 500 ms before": (stamped(-0.5), "before its arrival"),
    "stamped 1 s after": (stamped(1.0), "after its arrival"),
    "scale 1.1": (scaled(1.1), "against the hand|off the hand's"),
    "every other frame 50 mm off": (forged(0.05, 0, 0), "frames jump"),
    "every other frame 10 mm off": (forged(0.01, 0, 0), "frames scatter|frames jump"),
    "two objects": (lambda f: SeenFrame(f[-1].time_s, np.vstack([f[-1].poses] * 2)), "poses of"),
    "1e308": (lambda f: SeenFrame(f[-1].time_s, np.full_like(f[-1].poses, 1e308)), "got a pose"),
}
"""Lies, and what the record then says."""
