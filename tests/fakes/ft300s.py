"""An FT-300S at the other end of a pseudo terminal: Modbus RTU until its stream is started, then frames until jammed.

It looks at the terminal's speed as the wire would: at another baud rate it understands nothing and is not understood.
"""

import os
import select
import termios
import threading
import time
import tty
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import ReadHoldingRegistersResponse, WriteMultipleRegistersResponse

from testbed.robot.robotiq.stream import DIVISOR, FRAME_BYTES, HEADER, checksum

DEVICE, STREAM, START = 9, 410, 0x0200
JAM = b"\xff" * 50
SPEEDS = {9600: termios.B9600, 19200: termios.B19200, 115200: termios.B115200}
IDENTITY = {500: b"FS", 501: b"C\x02", 502: b"\x00\x01", 510: b"FS", 511: b"C\x00", 512: b"\x04\xd2", 513: b"\0\0"}
"""Registers of its identity: firmware FSC-2.0.1, serial FSC-1234."""
Wrench = Callable[[float], ArrayLike]
"""Time (`time.monotonic`) to wrench, N, N m, sensor axes, (6,)."""


@dataclass
class Faults:
    """Faults from now on; tests change them while it runs."""

    noise: float = 0.0
    """Standard deviation of force, N; a twentieth of it for torque, N m."""
    drop: float = 0.0
    """Probability that a byte is lost."""
    corrupt: float = 0.0
    """Probability that a byte has a bit flipped."""
    garbage: float = 0.0
    """Probability that a few random bytes come before a frame."""
    latency: float = 0.0
    """The adapter hands its bytes on only this often, s."""
    stalled: bool = False
    """The sensor sends nothing."""
    deaf: bool = False
    """It answers no request."""


class FakeFt300s:
    """Runs while it is entered. `port` is what a driver opens; `sent` the wrenches of the frames that went out."""

    def __init__(
        self,
        wrench: Wrench = lambda _: np.zeros(6),
        *,
        rate: float = 100.0,
        baud: int = 19200,
        identity: dict[int, bytes] = IDENTITY,
        streaming: bool = False,
        seed: int = 0,
    ):
        self.faults = Faults()
        self.sent: list[np.ndarray] = []
        self.starts = 0
        """Times that its stream was started."""
        self._wrench, self._period, self._baud, self._identity = wrench, 1 / rate, baud, identity
        self.streaming = streaming
        self._rng = np.random.default_rng(seed)
        self._framer = FramerRTU(DecodePDU(True))
        self._received = b""
        self._due = self._handed_on = 0.0
        self._held = b""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)  # no echo before a driver has opened it
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._due = time.monotonic()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Pull the cable."""
        if not self._stop.is_set():
            self._stop.set()
            self._thread.join()
            os.close(self._slave)
            os.close(self._master)

    def _run(self) -> None:
        while not self._stop.is_set():
            # what is overdue goes out in one go, as from the buffer of a real port
            next_ = min(self._due, self._handed_on + self.faults.latency) if self._held else self._due
            wait = max(next_ - time.monotonic(), 0.0) if self.streaming else 0.02
            if select.select([self._master], [], [], wait)[0]:
                self._hear(os.read(self._master, 4096))
            if not self.streaming:
                self._due = time.monotonic() + self._period
            elif time.monotonic() >= self._due:
                self._send_frame(self._due)
                self._due += self._period
            if self._held and time.monotonic() >= self._handed_on + self.faults.latency:
                self._write(self._held)
                self._held, self._handed_on = b"", time.monotonic()

    def _hear(self, data: bytes) -> None:
        if termios.tcgetattr(self._slave)[5] != SPEEDS[self._baud]:
            return
        self._received = (self._received + data)[-256:]
        if self._received.endswith(JAM):
            self.streaming, self._received = False, b""
        elif self.streaming or self.faults.deaf:
            self._received = self._received[-len(JAM) :]
        elif set(self._received[:1]) <= {0xFF}:
            pass  # a jam on its way
        else:
            used, request = self._framer.handleFrame(self._received, 0, 0)
            self._received = self._received[used:]
            if request is not None and request.dev_id == DEVICE:
                self._write(self._framer.buildFrame(self._answer(request)))

    def _answer(self, request: ModbusPDU) -> ModbusPDU:
        wanted = range(request.address, request.address + request.count)
        if request.function_code == 3 and set(wanted) <= set(self._identity):
            words = [int.from_bytes(self._identity[i], "big") for i in wanted]
            return ReadHoldingRegistersResponse(dev_id=DEVICE, registers=words)
        if request.function_code == 16 and (request.address, request.registers) == (STREAM, [START]):
            self.streaming = True
            self.starts += 1
            return WriteMultipleRegistersResponse(dev_id=DEVICE, address=STREAM, count=1)
        return ExceptionResponse(request.function_code, 2, DEVICE)

    def _send_frame(self, now: float) -> None:
        if self.faults.stalled:
            return
        wrench = np.asarray(self._wrench(now), dtype=float)
        if self.faults.noise:
            wrench = wrench + self.faults.noise * self._rng.standard_normal(6) * np.repeat([1, 0.05], 3)
        data = frame_of(wrench)
        self.sent.append(np.frombuffer(data, "<i2", 6, 2) / DIVISOR)
        if self.faults.garbage and self._rng.random() < self.faults.garbage:
            data = self._rng.bytes(int(self._rng.integers(1, 8))) + data
        if self.faults.corrupt or self.faults.drop:
            data = self._damaged(data)
        self._held += data

    def _damaged(self, data: bytes) -> bytes:
        bytes_ = np.frombuffer(data, np.uint8)
        flips = np.where(self._rng.random(len(data)) < self.faults.corrupt, 1 << self._rng.integers(0, 8, len(data)), 0)
        return (bytes_ ^ flips.astype(np.uint8))[self._rng.random(len(data)) >= self.faults.drop].tobytes()

    def _write(self, data: bytes) -> None:
        try:
            os.write(self._master, data)
        except BlockingIOError:
            pass  # nobody reads: a real port overflows as well


def frame_of(wrench: ArrayLike) -> bytes:
    """The frame that says a wrench, (6,), N and N m."""
    counts = np.clip(np.rint(np.asarray(wrench) * DIVISOR), -(2**15), 2**15 - 1).astype("<i2")
    data = HEADER + counts.tobytes()
    assert len(data) == FRAME_BYTES - 2
    return data + checksum(data)
