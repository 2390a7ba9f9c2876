"""Checks on every frame of a camera during a trial: its parts, stamp and size, and jumps faster than any motion."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from testbed.robot.camera.interface import CameraLostError, SeenFrame, check_frame
from testbed.sensing.camera import Camera

EARLY, LATE = 0.05, 0.25
"""Allowed lead and lag of a stamp relative to its arrival, beyond the stated delay [s]."""
FASTEST, OF_PUSH = (0.15, 1.5), (1.25, 30.0)
"""Largest speed [m/s] and yaw rate [rad/s] of an object, and both per speed of a push [1, rad/m] where that is more: a
block of 50 mm that is pushed at the end of a face turns by 22 rad per meter."""
_NOISE = 5.0
"""Standard deviations of noise that do not count as a jump."""
JUMPS, AMONG = 2, 10
"""Number of jumping frames, among so many of the last ones, that ends a trial. A single one, such as a flipped tag, is
skipped."""


class CameraWatch:
    """Checks on the frames of one trial."""

    def __init__(self, camera: Camera, parts: int, push: float = 0.0):
        """Check frames of `parts` parts; `push`: speed of a push [m/s], 0 without one."""
        self._camera, self._parts = camera, parts
        self._fastest = [max(least, of_push * push) for least, of_push in zip(FASTEST, OF_PUSH, strict=True)]
        self._last: list[tuple[float, np.ndarray] | None] = [None] * parts
        self._jumps: deque[bool] = deque(maxlen=AMONG)

    def kept(self, frames: Sequence[SeenFrame], now: float) -> Iterator[SeenFrame]:
        """Valid frames among new ones, up to the first fault; `now` is the time of their arrival [s].

        Raises:
            CameraLostError: wrong number of parts, a pose beyond any table, a stamp outside its range, or jumps.
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
        """Jump of a part since its last frame in words, and its ratio to the largest plausible motion and noise."""
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
