"""Byte stream of an FT-300S: parser for valid frames among damaged ones, and counter of lost frames.

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
"""Frame rate [Hz]."""
_PERIOD = 1 / RATE
FRAME_BYTES = 16
"""Length of a frame [bytes]."""
HEADER = b"\x20\x4e"
"""First bytes of a frame."""
DIVISOR = np.array([100.0, 100.0, 100.0, 1000.0, 1000.0, 1000.0])
"""Counts per newton and per newton meter, shape (6,)."""
_BLOCK = 20
"""Number of frames over which lateness must persist to be a loss: 0.2 s, longer than a reader is suspended."""


class Frame(NamedTuple):
    """One whole frame."""

    wrench: Float[np.ndarray, "6"]
    """Wrench [N, N m], sensor axes."""
    behind: int
    """Number of bytes that had arrived after it."""


class FrameParser:
    """Parser of a byte stream that may begin within a frame and may be damaged anywhere."""

    def __init__(self) -> None:
        self.crc_errors = 0
        """Headers followed by a wrong checksum."""
        self.resyncs = 0
        """Number of times that bytes were skipped after a frame."""
        self._buffer = bytearray()
        self._in_step = False

    def feed(self, data: bytes) -> list[Frame]:
        """Parse further bytes; returns the frames that they complete, in order."""
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
        return found

    def _skip(self, count: int) -> None:
        if count and self._in_step:
            self.resyncs += 1
            self._in_step = False


def checksum(data: bytes) -> bytes:
    """Modbus CRC-16, low byte first."""
    return FramerRTU.compute_CRC(data).to_bytes(2, "big")


class FrameClock:
    """Counter of frames that were due and did not arrive.

    A late frame is not lost: a suspended reader later receives all queued frames. The least lateness within a block of
    frames counts as loss. The clock follows that of the sensor, up to 2 % off the nominal rate.
    """

    def __init__(self) -> None:
        self.lost = 0
        """Lost frames, up to the last whole block."""
        self._due: float | None = None
        self._late: list[float] = []

    def arrived(self, time_s: float) -> None:
        """Count the arrival of a frame [s]."""
        due = time_s if self._due is None else self._due
        self._late.append(time_s - due)
        self._due = due + _PERIOD
        if len(self._late) == _BLOCK:
            least = min(self._late)
            self.lost += max(round(least / _PERIOD), 0)
            self._due += least
            self._late.clear()
