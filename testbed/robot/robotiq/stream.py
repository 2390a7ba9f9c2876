"""The byte stream of an FT-300S: frames found among whatever the wire brings, and the frames that never came.

A frame is 16 bytes: header 0x20 0x4E, six int16 little-endian (force in 1/100 N, torque in 1/1000 N m), Modbus CRC-16
of the first 14, low byte first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from testbed.robot.interfaces import MissingDriverError

try:
    from pymodbus.framer import FramerRTU
except ImportError:
    raise MissingDriverError("pymodbus") from None

RATE = 100.0
"""Frames a second."""
FRAME_BYTES = 16
"""Length of a frame."""
HEADER = b"\x20\x4e"
"""What a frame begins with."""
DIVISOR = np.array([100.0, 100.0, 100.0, 1000.0, 1000.0, 1000.0])
"""Counts in a newton and in a newton metre, (6,)."""
_BLOCK = 20
"""Frames over which lateness must last to be a loss: 0.2 s, longer than an operating system keeps a reader waiting."""


class Frame(NamedTuple):
    """One whole frame."""

    wrench: Float[np.ndarray, "6"]
    """N, N m, sensor axes."""
    behind: int
    """Bytes that had already arrived after it."""


class FrameParser:
    """Finds the frames in a stream of bytes that may begin anywhere and be damaged anywhere."""

    def __init__(self) -> None:
        self.frames = 0
        """Whole frames found."""
        self.crc_errors = 0
        """Headers after which the checksum did not fit."""
        self.resyncs = 0
        """Times that bytes were skipped after a frame."""
        self._buffer = bytearray()
        self._in_step = False

    @property
    def needed(self) -> int:
        """Bytes that could complete the next frame: never more, so that waiting for them delays no frame."""
        return max(FRAME_BYTES - len(self._buffer), 1)

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes in; the frames that they complete, in order."""
        buffer, at, found = self._buffer, 0, []
        buffer += data
        while True:
            start = buffer.find(HEADER, at)
            if start < 0:  # the last byte may be half a header
                start = max(len(buffer) - buffer.endswith(HEADER[:1]), at)
            self._skip(start - at)
            at = start
            if len(buffer) - at < FRAME_BYTES:
                break
            frame = bytes(buffer[at : at + FRAME_BYTES])
            if checksum(frame[:-2]) == frame[-2:]:
                at += FRAME_BYTES
                self._in_step = True
                found.append(Frame(np.frombuffer(frame, "<i2", 6, 2) / DIVISOR, len(buffer) - at))
            else:  # the next header may lie within
                self.crc_errors += 1
                self._skip(1)
                at += 1
        del buffer[:at]
        self.frames += len(found)
        return found

    def _skip(self, count: int) -> None:
        if count and self._in_step:
            self.resyncs += 1
            self._in_step = False


def checksum(data: bytes) -> bytes:
    """Modbus CRC-16 as it goes over the wire, low byte first."""
    return FramerRTU.compute_CRC(data).to_bytes(2, "big")


class FrameClock:
    """Counts the frames that should have come by now and did not.

    A late frame is no lost one: the reader may have been kept waiting, and what queued up meanwhile makes up for it.
    Lateness that no frame of a block made up is loss. The clock follows the sensor's, up to 2 % off.
    """

    def __init__(self, period: float = 1 / RATE):
        self.lost = 0
        """Frames that never came, up to the last whole block."""
        self._period = period
        self._due: float | None = None
        self._late: list[float] = []

    def arrived(self, time_s: float) -> None:
        """Take in the arrival of a frame, s."""
        due = time_s if self._due is None else self._due
        self._late.append(time_s - due)
        self._due = due + self._period
        if len(self._late) == _BLOCK:
            least = min(self._late)
            self.lost += max(round(least / self._period), 0)
            self._due += least
            self._late.clear()
