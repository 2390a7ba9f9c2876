"""Watch over every frame of a camera during a trial: its parts, its stamp, its size, and jumps that no hand makes."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from testbed.robot.camera.interface import CameraLostError, SeenFrame, check_frame
from testbed.sensing.camera import Camera

EARLY, LATE = 0.05, 0.25
"""Times by which a stamp may be ahead of its arrival or behind it, beyond the stated delay [s]."""
FASTEST, OF_PUSH = (0.15, 1.5), (1.25, 30.0)
"""Speed [m/s] and yaw rate [rad/s] that an object moves at, and both per speed of a push [1, rad/m] where that is more:
one block of 50 mm, pushed at the end of a face, turns by 22 rad a meter."""
_NOISE = 5.0
"""Standard deviations of noise in a jump that is none."""
JUMPS, AMONG = 2, 10
"""Frames that jump, among the last ones, which end a trial. A single one, as of a tag that flips, is left out."""


class CameraWatch:
    """Watch over the frames of one trial."""

    def __init__(self, camera: Camera, parts: int, push: float = 0.0):
        """Watch over so many parts, pushed at a speed [m/s]."""
        self._camera, self._parts = camera, parts
        self._fastest = [max(least, of_push * push) for least, of_push in zip(FASTEST, OF_PUSH, strict=True)]
        self._last: list[tuple[float, np.ndarray] | None] = [None] * parts
        self._jumps: deque[bool] = deque(maxlen=AMONG)

    def kept(self, frames: Sequence[SeenFrame], now: float) -> Iterator[SeenFrame]:
        """The new frames that count, up to the first fault; `now` is the time of their arrival [s].

        Raises:
            CameraLostError: another number of parts, a pose off any table, a stamp of another time, or jumps.
        """
        for frame in frames:
            check_frame(frame, self._parts)
            self._check_stamp(frame.time_s, now)
            words, jump = max((self._jump(frame, part) for part in range(self._parts)), key=lambda found: found[1])
            self._jumps.append(jump > 1)
            if sum(self._jumps) >= JUMPS:
                raise CameraLostError(
                    f"camera: {JUMPS} of its last {len(self._jumps)} frames jump, the last by {words}: "
                    "it sees something else, or another program sends poses too"
                )
            if jump <= 1:
                yield frame
                for part, pose in enumerate(frame.poses):
                    if not np.isnan(pose).any():
                        self._last[part] = frame.time_s, pose

    def _check_stamp(self, time_s: float, now: float) -> None:
        ahead, most = time_s - now, self._camera.delay[1]
        if not -LATE - most <= ahead <= EARLY + most:
            raise CameraLostError(
                f"camera: a frame is stamped {abs(ahead):.3g} s {'after' if ahead > 0 else 'before'} its arrival; "
                f"allowed: {EARLY + most:.3g} s after to {LATE + most:.3g} s before; "
                "synchronize the clocks, or mend age_s"
            )

    def _jump(self, frame: SeenFrame, part: int) -> tuple[str, float]:
        """Jump of a part since its last frame in words, and over what a hand and the noise can make."""
        last, pose = self._last[part], frame.poses[part]
        if last is None or np.isnan(pose).any():
            return "", 0.0
        time = max(frame.time_s - last[0], 0.0)
        way = float(np.linalg.norm(pose[:2] - last[1][:2]))
        turn = abs(math.remainder(pose[2] - last[1][2], math.tau))
        noise = _NOISE * math.sqrt(2)
        most_way = self._fastest[0] * time + noise * self._camera.position + 0.002
        most_turn = self._fastest[1] * time + noise * self._camera.angle + math.radians(0.5)
        words = f"{way * 1e3:.0f} mm and {math.degrees(turn):.0f} deg in {time * 1e3:.0f} ms"
        return words, max(way / most_way, turn / most_turn)
