"""A Robotiq FT-300S on a serial port: Modbus RTU to identify it, a raw stream of frames at 100 Hz to measure."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Self

from testbed.robot.interfaces import (
    MissingDriverError,
    RobotError,
    SensorHealth,
    SensorIdentity,
    SensorLostError,
    WrenchSample,
)
from testbed.robot.robotiq.serial_port import SerialReader, why_closed
from testbed.robot.robotiq.stream import FRAME_BYTES, RATE, FrameClock, FrameParser
from testbed.sensing.presets import preset
from testbed.validation import Range, check_settings

try:
    import serial
    from pymodbus.client import ModbusSerialClient
    from pymodbus.exceptions import ModbusException
except ImportError:
    raise MissingDriverError("pyserial and pymodbus") from None

BAUD = 19200
"""8 bits, no parity, 1 stop bit."""
MEASURING_RANGE = 300.0, 30.0
"""Largest force and torque on an axis [N, N m], by the manufacturer's data sheet."""
REPEATS = (7, 7, 8, 9, 10, 19)
"""Largest number of equal values in a row of each component: with the preset's noise, and counts of 0.01 N and
0.001 N m, more occur with a probability of 1e-10 to 8e-9 per frame."""
Count = Annotated[int, Range(2, 30, "frames")]
_PRESET = preset("ft300s")
NOISE = (*_PRESET.force_noise, *_PRESET.torque_noise)
"""Standard deviation of each component at rest, per frame [N, N m]."""
Force = Annotated[float, Range(0.01, 1.0, "N")]
Torque = Annotated[float, Range(5e-4, 0.05, "N m")]
DEVICE = 9
"""Modbus address."""
_FIRMWARE, _SERIAL, _STREAM = (500, 3), (510, 4), 410
"""First register and number of registers, from the manufacturer's driver; of the stream the register alone."""
_START = 0x0200
_JAM = b"\xff" * 50
"""Bytes that end a stream; while it runs the sensor answers no request."""
_QUIET = 0.1
"""Silence after which the sensor is not streaming [s]."""
_STARTING = 1.0
"""Longest time for a stream to begin [s]."""
_DROPOUT = 0.05
"""Silence that counts as a dropout [s]."""
_BITS_PER_BYTE = 10
_STOPPING = 1.0
"""Longest time for a stream to end [s]; about half of it is usual."""

logging.getLogger("pymodbus").addHandler(logging.NullHandler())  # its failures are raised as errors of heft


class Ft300s:
    """A `WrenchSensor`. A thread reads the port; the methods parse its bytes.

    Undrained frames are kept: 100 per second, some 300 bytes each.
    """

    def __init__(
        self,
        port: str,
        *,
        stale_after: Annotated[float, Range(0.03, 0.2, "s")] = 0.1,
        repeats: tuple[Count, Count, Count, Count, Count, Count] = REPEATS,
        noise: tuple[Force, Force, Force, Torque, Torque, Torque] = NOISE,
    ):
        """Create the sensor without opening its port.

        Args:
            port: device file: /dev/ttyUSB0 or, better, its name in /dev/serial/by-id.
            stale_after: silence after which the sensor counts as lost [s].
            repeats: largest number of equal values in a row of each component.
            noise: standard deviation of each component at rest, per frame [N, N m].
        """
        check_settings(Ft300s, {"port": port, "stale_after": stale_after, "repeats": repeats, "noise": noise}, "Ft300s")
        self.port, self.stale_after = port, stale_after
        self.identity = SensorIdentity(
            "Robotiq FT-300S", "unknown", "unknown", RATE, *MEASURING_RANGE, tuple(repeats), tuple(noise)
        )
        """Name and characteristics; serial and firmware are "unknown" before it is entered."""
        self._serial: serial.Serial | None = None
        self._reset()

    def _reset(self) -> None:
        self._reader: SerialReader | None = None
        self._parser, self._clock = FrameParser(), FrameClock()
        self._samples: list[WrenchSample] = []
        self._latest: WrenchSample | None = None
        self._sequence = self._dropouts = self._bytes_since = 0
        self._warnings: tuple[str, ...] = ()
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        """Open the port, stop a stream left running, identify the sensor, start the stream, wait for its first frame.

        Raises:
            RobotError: no such port, in use, or another device answers.
            SensorLostError: it answers, but no frame arrives.
        """
        self._reset()
        try:
            # exclusive: two readers would each get half the bytes
            self._serial = serial.Serial(self.port, BAUD, timeout=_QUIET, write_timeout=1.0, exclusive=True)
        except (OSError, ValueError) as error:
            raise RobotError(f"sensor {self.port}: cannot be opened: {why_closed(self.port, error)}") from None
        try:
            self._open(self._serial)
        except OSError as error:
            self.__exit__()
            raise SensorLostError(f"sensor {self.port}: lost while it was being opened: {error}") from None
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        port, self._serial = self._serial, None
        if port is None:
            return
        with closing(port), suppress(OSError):  # it may be gone already
            if self._reader is not None:
                self._reader.stop()
                _silenced(port, streams=True)

    def _open(self, port: serial.Serial) -> None:
        # an adapter may have no such timer, or a fixed one, of which the next line warns
        with suppress(ValueError, NotImplementedError, AttributeError):
            port.set_low_latency_mode(True)
        self._warnings = tuple(filter(None, [latency_warning(self.port)]))
        if not _silenced(port):
            raise RobotError(
                f"sensor {self.port}: bytes keep coming after the stream was told to stop; another device?"
            )
        client = ModbusSerialClient(self.port, baudrate=BAUD, timeout=0.3, retries=2)
        client.socket = port
        self.identity = self._identified(client)
        client.write_registers(_STREAM, [_START], device_id=DEVICE, no_response_expected=True)
        reader = self._reader = SerialReader(port.fileno(), FRAME_BYTES)
        deadline = time.monotonic() + _STARTING
        while math.isinf(self.health().age_s):
            if time.monotonic() > deadline:
                why = reader.failure or self._silence()
                raise SensorLostError(f"sensor {self.port}: it answers, but its stream does not start; {why}")
            time.sleep(0.01)

    def _identified(self, client: ModbusSerialClient) -> SensorIdentity:
        try:
            firmware, number = (
                client.read_holding_registers(first, count=count, device_id=DEVICE)
                for first, count in (_FIRMWARE, _SERIAL)
            )
        except ModbusException:
            raise RobotError(
                f"sensor {self.port}: no answer at {BAUD} baud 8N1, Modbus address {DEVICE}; "
                "check its power, the wires A and B, and that this port is the sensor's"
            ) from None
        if firmware.isError() or number.isError():
            raise RobotError(f"sensor {self.port}: the device refuses to say what it is: {firmware}, {number}")
        words = [*firmware.registers, *number.registers]
        said = b"".join(word.to_bytes(2, "big") for word in words)
        if len(words) != _FIRMWARE[1] + _SERIAL[1] or said[:1] != b"F":
            raise RobotError(f"sensor {self.port}: got firmware {said[:6]!r}; allowed: an FT sensor's, F first")
        digits = words[6] << 16 | words[5]  # low word first
        return replace(
            self.identity,
            serial=f"{said[6:9].decode('ascii', 'replace')}-{digits:04d}" if digits else "unknown",
            firmware=f"{said[:3].decode('ascii', 'replace')}-{said[3]}.{said[4]}.{said[5]}",
        )

    def _update(self) -> None:
        """Parse all bytes received so far to samples; requires the lock."""
        for now, data in self._reader.take() if self._reader else ():
            self._bytes_since += len(data)
            for frame in self._parser.feed(data):
                # less the transmission time of the bytes after it
                arrival = now - frame.behind * _BITS_PER_BYTE / BAUD
                before = self._latest
                if before is not None:
                    arrival = max(arrival, before.time_s + 1e-6)
                    self._dropouts += arrival - before.time_s > _DROPOUT
                self._clock.arrived(arrival)
                frame.wrench.flags.writeable = False
                self._latest = WrenchSample(arrival, frame.wrench, self._sequence)
                self._samples.append(self._latest)
                self._sequence += 1
                self._bytes_since = frame.behind

    def drain(self) -> Sequence[WrenchSample]:
        """Every frame since the last drain, in order."""
        with self._lock:
            self._update()
            samples, self._samples = self._samples, []
            if not samples:
                self._check()
            return samples

    def health(self) -> SensorHealth:
        """Counts so far."""
        with self._lock:
            self._update()
            return SensorHealth(
                frames=self._sequence,
                crc_errors=self._parser.crc_errors,
                resyncs=self._parser.resyncs,
                lost_frames=self._clock.lost,
                dropouts=self._dropouts,
                age_s=self._age(),
                warnings=self._warnings,
            )

    def _age(self) -> float:
        return math.inf if self._latest is None else time.monotonic() - self._latest.time_s

    def _check(self) -> None:
        if self._serial is None or self._reader is None:
            raise RobotError(f"sensor {self.port}: not open; use it in a with statement")
        if self._reader.failure:
            raise SensorLostError(f"sensor {self.port}: unplugged or gone: {self._reader.failure}")
        if self._age() > self.stale_after:
            raise SensorLostError(f"sensor {self.port}: {self._silence()}")

    def _silence(self) -> str:
        age = self._age()
        since = "no frame yet" if math.isinf(age) else f"no frame for {age * 1e3:.0f} ms"
        came = (
            f"{self._bytes_since} bytes that make no frame: a wrong baud rate, noise, or another device"
            if self._bytes_since
            else "nothing came: unpowered, unwired, or its stream was stopped"
        )
        return f"{since} (allowed: {self.stale_after * 1e3:.0f} ms); {came}"


def _silenced(port: serial.Serial, *, streams: bool = False) -> bool:
    """Stop a stream; True once the sensor is silent. `streams` skips the check for a stream."""
    port.timeout = _QUIET
    if not streams and not port.read(4096):
        return True
    for _ in range(2):
        port.write(_JAM)
        deadline = time.monotonic() + _STOPPING
        while time.monotonic() < deadline:
            if not port.read(4096):
                return True
    return False


def latency_warning(port: str, ttys: Path = Path("/sys/class/tty")) -> str | None:
    """Effect of an FTDI adapter's latency timer on the stream, or None without any.

    Args:
        port: device file, or a link to it.
        ttys: folder in which the kernel lists serial ports.
    """
    timer = ttys / Path(port).resolve().name / "device" / "latency_timer"
    try:
        milliseconds = int(timer.read_text())
    except (OSError, ValueError):
        return None
    if milliseconds <= 1:
        return None
    return (
        f"sensor {port}: the adapter's latency timer is {milliseconds} ms, so frames come in bunches; "
        f"set it: echo 1 | sudo tee {timer}"
    )
