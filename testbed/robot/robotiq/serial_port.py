"""Serial ports: list of this computer's USB adapters, and a thread that reads a port."""

from __future__ import annotations

import errno
import os
import select
import termios
import threading
import time
from collections import deque
from pathlib import Path

from testbed.robot.interfaces import MissingDriverError

try:
    from serial.tools.list_ports import comports
except ImportError:
    raise MissingDriverError("pyserial") from None


def usb_serial_ports() -> list[str]:
    """Every USB port with its description, such as "/dev/ttyUSB0 (USB-RS485 adapter)"."""
    return [f"{port.device} ({port.description})" for port in comports() if port.vid is not None]


def why_closed(port: str, error: Exception) -> str:
    """Reason that a port cannot be opened, with a remedy."""
    there = ", ".join(usb_serial_ports()) or "none: plug in the USB adapter"
    if not Path(port).exists():
        return f"no such device; USB serial ports: {there}"
    if getattr(error, "errno", None) == errno.EACCES:
        return "not allowed; add yourself to the group that it belongs to (dialout), and log in again"
    if getattr(error, "errno", None) in (errno.EAGAIN, errno.EBUSY):
        return "in use by another program; end that first"
    return f"no serial port; USB serial ports: {there} ({error})"


_LONGEST_WAIT_MS = 50
"""Longest wait of the thread [ms], after which it reads fewer bytes than `wake_at` and checks for its end."""


class SerialReader:
    """Thread that reads a port from its creation until `stop`, or until the port is disconnected."""

    def __init__(self, descriptor: int, wake_at: int):
        """Start reading.

        Args:
            descriptor: file descriptor of an open terminal device, raw and non-blocking, as opened by pyserial.
            wake_at: number of bytes to wait for. An adapter passes bytes singly, and waking for each is costly.

        Raises:
            OSError: the port is disconnected.
        """
        self.failure = ""
        """Reason for an unrequested end of reading, else empty."""
        self._descriptor, self._pieces, self._stopped = descriptor, deque[tuple[float, bytes]](), False
        try:
            settings = termios.tcgetattr(descriptor)
            settings[6][termios.VMIN], settings[6][termios.VTIME] = wake_at, 0
            termios.tcsetattr(descriptor, termios.TCSANOW, settings)
        except termios.error as error:
            raise OSError(*error.args) from None
        self._thread = threading.Thread(target=self._run, name="serial reader", daemon=True)
        self._thread.start()

    def take(self) -> list[tuple[float, bytes]]:
        """Time [s, `time.monotonic`] and bytes of every read since the last call; for one thread at a time."""
        return [self._pieces.popleft() for _ in range(len(self._pieces))]

    def stop(self) -> None:
        """End reading."""
        self._stopped = True
        self._thread.join()

    def _run(self) -> None:
        # runs 100 times per second: as little work as possible
        bytes_there = select.poll()
        bytes_there.register(self._descriptor, select.POLLIN)
        try:
            while not self._stopped:
                bytes_there.poll(_LONGEST_WAIT_MS)
                try:
                    data = os.read(self._descriptor, 4096)
                except BlockingIOError:
                    continue
                if not data:
                    raise OSError("the device hung up")
                self._pieces.append((time.monotonic(), data))
        except OSError as error:
            self.failure = str(error)
