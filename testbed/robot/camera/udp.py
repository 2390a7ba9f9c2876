"""Camera by datagrams: the program of any tracker sends the object's poses to a port of this computer.

A datagram is a JSON object: `{"poses": [...], "age_s": 0.02}`. `poses` has an entry for each part of the object: `null`
if it is not seen now; `[x, y, yaw]` on the table [m, rad]; or `[x, y, z, qw, qx, qy, qz]` in space [m]. `age_s` is the
time since the exposure [s], 0 if left out.
"""

from __future__ import annotations

import json
import math
import socket
import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.robot.camera.interface import FARTHEST, CameraLostError, SeenFrame
from testbed.validation import Range, check_settings, frozen_array, is_number, unit_quaternion

_LONGEST = 65535
"""Longest datagram [byte]."""
_LYING = math.radians(20)
"""Largest angle between the z axes of the object and of the base for an object that lies on the table [rad]."""
OLDEST = 1.0
"""Greatest age of a frame at its arrival [s]."""
MOST_PARTS = 100
_QUEUED = 10_000
"""Largest number of undrained frames; older ones are dropped."""


class UdpCamera:
    """An `ObjectCamera` that receives frames at a UDP port. The stamp of a frame is its arrival less its age."""

    def __init__(
        self,
        *,
        port: Annotated[int, Range(0, 65535, "")] = 5005,
        address: str = "127.0.0.1",
        in_base_m: Sequence[Annotated[float, Range(-5, 5, "m")]] = (0.0, 0.0, 0.0),
        in_base_wxyz: Sequence[Annotated[float, Range(-1, 1, "")]] = (1.0, 0.0, 0.0, 0.0),
        object_m: Sequence[Annotated[float, Range(-1, 1, "m")]] = (0.0, 0.0, 0.0),
        object_wxyz: Sequence[Annotated[float, Range(-1, 1, "")]] = (1.0, 0.0, 0.0, 0.0),
    ):
        """Describe the socket; nothing is opened.

        Args:
            port: port to listen at; 0 takes a free one.
            address: address to listen at; 0.0.0.0 accepts datagrams of other computers.
            in_base_m: position of the camera's frame in the arm's base frame.
            in_base_wxyz: its orientation there.
            object_m: position of the object's frame in the tracked frame, such as a tag's, the same for each part.
            object_wxyz: its orientation there.
        """
        given = {"port": port, "in_base_m": in_base_m, "in_base_wxyz": in_base_wxyz}
        given |= {"object_m": object_m, "object_wxyz": object_wxyz}
        check_settings(UdpCamera, given, "UdpCamera")
        self._at = address, port
        self._mount = Rotation.from_quat(unit_quaternion("UdpCamera.in_base_wxyz", in_base_wxyz), scalar_first=True)
        self._tag = Rotation.from_quat(unit_quaternion("UdpCamera.object_wxyz", object_wxyz), scalar_first=True)
        self._place = np.array(frozen_array("UdpCamera.in_base_m", in_base_m, (3,)))
        self._beside = np.array(frozen_array("UdpCamera.object_m", object_m, (3,)))
        self._frames: deque[SeenFrame] = deque(maxlen=_QUEUED)
        self._error: CameraLostError | None = None
        self._lay = False
        self._socket: socket.socket | None = None
        self._thread: threading.Thread | None = None

    @property
    def port(self) -> int:
        """Port that it listens at."""
        return self._at[1] if self._socket is None else self._socket.getsockname()[1]

    def __enter__(self) -> Self:
        """Listen.

        Raises:
            CameraLostError: the port is taken, or the address is not this computer's.
        """
        found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            found.bind(self._at)
        except OSError as error:
            found.close()
            raise CameraLostError(f"camera: {self._at[0]}:{self._at[1]}: {error.strerror}") from None
        found.settimeout(0.1)
        self._frames.clear()
        self._error, self._lay, self._socket = None, False, found
        self._thread = threading.Thread(target=self._listen, args=(found,), name="camera", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        found, self._socket = self._socket, None
        if self._thread is not None:
            self._thread.join(1.0)
        if found is not None:
            found.close()

    def drain(self) -> Sequence[SeenFrame]:
        """Every frame since the last drain.

        Raises:
            CameraLostError: a datagram cannot be read, or the socket failed.
        """
        frames = [self._frames.popleft() for _ in range(len(self._frames))]
        if self._error is None and self._socket is not None and not (self._thread and self._thread.is_alive()):
            self._error = CameraLostError("camera: the thread that listens has ended")
        if self._error is not None:
            raise self._error
        return frames

    def _listen(self, found: socket.socket) -> None:
        while self._socket is found:
            try:
                message = found.recv(_LONGEST)
            except TimeoutError:
                continue
            except OSError as error:
                if self._socket is found:
                    self._error = CameraLostError(f"camera: its socket failed: {error.strerror}")
                return
            try:
                self._frames.append(self._frame(message, time.monotonic()))
            except CameraLostError as error:
                self._error = error

    def _frame(self, message: bytes, now: float) -> SeenFrame:
        try:
            table = json.loads(message)
            age, poses = table.get("age_s", 0.0), table["poses"]
            if not (is_number(age) and 0 <= age <= OLDEST and isinstance(poses, list) and 0 < len(poses) <= MOST_PARTS):
                raise ValueError
            return SeenFrame(now - age, np.array([self._planar(pose) for pose in poses]))
        except CameraLostError:
            raise
        except Exception:  # a stranger's bytes: no kind of error may end the thread
            given = message[:80].decode(errors="replace")
            raise CameraLostError(
                f"camera: got {given!r}; allowed: a JSON object with poses, a list with null, [x, y, yaw] or "
                f"[x, y, z, qw, qx, qy, qz] for each part, within {FARTHEST[0]:g} m, and "
                f"age_s, 0 to {OLDEST:g} s, if known"
            ) from None

    def _planar(self, pose: object) -> np.ndarray:
        """Planar pose of the object frame, arm's base frame, of an entry of a datagram."""
        if pose is None:
            return np.full(3, math.nan)
        if not (isinstance(pose, list) and all(map(is_number, pose))):
            raise ValueError
        numbers = np.array(pose, dtype=float)
        lies = numbers.shape == (3,)
        if not (lies or numbers.shape == (7,)) or not (np.abs(numbers) <= (FARTHEST if lies else FARTHEST[0])).all():
            raise ValueError
        if lies:
            position = np.array([numbers[0], numbers[1], 0.0])
            turn = Rotation.from_euler("z", numbers[2])
        else:
            position, turn = numbers[:3], Rotation.from_quat(numbers[3:], scalar_first=True)
        x, y, _ = self._mount.apply(position + turn.apply(self._beside)) + self._place
        axes = (self._mount * turn * self._tag).as_matrix()
        if axes[2, 2] < math.cos(_LYING):
            if self._lay:  # a tag seen from above flips now and then
                return np.full(3, math.nan)
            tilt = math.degrees(math.acos(float(np.clip(axes[2, 2], -1.0, 1.0))))
            raise CameraLostError(
                f"camera: the object's z axis is {tilt:.0f} deg from the base's; allowed: "
                f"{math.degrees(_LYING):.0f} deg, up from the table: check object_wxyz and in_base_wxyz"
            )
        self._lay = True
        return np.array([x, y, math.atan2(axes[1, 0], axes[0, 0])])
