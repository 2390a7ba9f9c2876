"""The serial ports of this computer that are USB adapters."""

from __future__ import annotations

import errno
from pathlib import Path

from testbed.robot.ports import MissingDriverError

try:
    from serial.tools.list_ports import comports
except ImportError:
    raise MissingDriverError("pyserial") from None


def usb_serial_ports() -> list[str]:
    """Each with what it says of itself, as "/dev/ttyUSB0 (USB-RS485 adapter)"."""
    return [f"{port.device} ({port.description})" for port in comports() if port.vid is not None]


def why_closed(port: str, error: Exception) -> str:
    """Why a port cannot be opened, in a sentence that says what to do."""
    there = ", ".join(usb_serial_ports()) or "none: plug in the USB adapter"
    if not Path(port).exists():
        return f"no such device; USB serial ports: {there}"
    if getattr(error, "errno", None) == errno.EACCES:
        return "not allowed; add yourself to the group that it belongs to (dialout), and log in again"
    if getattr(error, "errno", None) in (errno.EAGAIN, errno.EBUSY):
        return "in use by another program; end that first"
    return f"no serial port; USB serial ports: {there} ({error})"
