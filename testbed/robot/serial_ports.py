"""The serial ports of this computer that are USB adapters."""

from __future__ import annotations

from testbed.robot.ports import MissingDriverError

try:
    from serial.tools.list_ports import comports
except ImportError:
    raise MissingDriverError("pyserial") from None


def usb_serial_ports() -> list[str]:
    """Each with what it says of itself, as "/dev/ttyUSB0 (USB-RS485 adapter)"."""
    return [f"{port.device} ({port.description})" for port in comports() if port.vid is not None]
