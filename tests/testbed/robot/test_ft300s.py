"""The FT-300S driver against a sensor on a pseudo terminal: identity, stream, faults of the wire, unplugging."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("pymodbus")
from testbed.errors import InvalidValueError
from testbed.robot.interfaces import RobotError, SensorLostError, WrenchSample, WrenchSensor
from testbed.robot.robotiq.ft300s import Ft300s, latency_warning
from tests.fakes.ft300s import IDENTITY, FakeFt300s

pytestmark = pytest.mark.slow  # real lines and threads in real time

PATIENT = 2.0
"""Silence allowed where silence is not what is tested: a busy machine keeps threads waiting."""


def swing(t: float) -> list[float]:
    return [10 * math.sin(7 * t), 5 * math.cos(3 * t), -9.0, 0.3 * math.sin(5 * t), 0.01, -0.2]


@pytest.fixture
def fake() -> Iterator[FakeFt300s]:
    with FakeFt300s(swing) as running:
        yield running


def sensor_on(fake: FakeFt300s, stale_after: float = PATIENT) -> Ft300s:
    return Ft300s(fake.port, stale_after=stale_after)


def until(said: Callable[[], bool], seconds: float = 5.0) -> None:
    """Wait for something that must come."""
    deadline = time.monotonic() + seconds
    while not said():
        assert time.monotonic() < deadline, "it never came"
        time.sleep(0.01)


def collect(sensor: Ft300s, count: int) -> list[WrenchSample]:
    samples: list[WrenchSample] = []
    until(lambda: samples.extend(sensor.drain()) or len(samples) >= count, 30.0)  # type: ignore[func-returns-value]
    return samples


def wrenches(samples: list[WrenchSample]) -> list[list[float]]:
    return [s.wrench.tolist() for s in samples]


def said_by(fake: FakeFt300s) -> list[list[float]]:
    return [w.tolist() for w in fake.sent]


def test_it_is_a_wrench_sensor_and_says_who_it_is(fake: FakeFt300s):
    sensor = sensor_on(fake)
    assert isinstance(sensor, WrenchSensor)
    assert (sensor.identity.serial, sensor.identity.rate_hz) == ("unknown", 100.0)
    with sensor:
        assert (sensor.identity.serial, sensor.identity.firmware) == ("FSC-1234", "FSC-2.0.1")
    assert (sensor.identity.force_range, sensor.identity.torque_range) == (300.0, 30.0)


def test_naming_it_opens_nothing():
    sensor = Ft300s("/dev/none")
    assert sensor.health().frames == 0
    assert math.isinf(sensor.health().age_s)
    for ask in (sensor.latest, sensor.drain):
        with pytest.raises(RobotError, match="not open; use it in a with statement"):
            ask()
    with pytest.raises(InvalidValueError, match="stale_after"):
        Ft300s("/dev/none", stale_after=0.0)


def test_every_frame_arrives_once_and_in_order(fake: FakeFt300s):
    with sensor_on(fake) as sensor:
        samples = collect(sensor, 250)
        health = sensor.health()
    assert wrenches(samples) == said_by(fake)[: len(samples)]
    assert [s.sequence for s in samples] == list(range(len(samples)))
    assert health.crc_errors == health.resyncs == health.lost_frames == 0


def test_times_are_those_of_the_frames(fake: FakeFt300s):
    with sensor_on(fake) as sensor:
        samples = collect(sensor, 200)
    gaps = np.diff([s.time_s for s in samples])
    assert (gaps > 0).all()
    assert gaps.mean() == pytest.approx(0.01, rel=0.2)


def test_the_latest_frame_stays_for_draining(fake: FakeFt300s):
    with sensor_on(fake) as sensor:
        first = sensor.latest()
        assert first is not None
        until(lambda: (s := sensor.latest()) is not None and s.sequence > first.sequence + 5)
        assert sensor.drain()[0].sequence == 0
        with pytest.raises(ValueError, match="read-only"):
            first.wrench[0] = 0.0


def test_leaving_stops_the_stream_and_entering_starts_it_again(fake: FakeFt300s):
    sensor = sensor_on(fake)
    for turn in (1, 2):
        with sensor:
            assert collect(sensor, 10)[0].sequence == 0
            assert (fake.streaming, fake.starts) == (True, turn)
        assert not fake.streaming
    with pytest.raises(RobotError, match="not open"):
        sensor.latest()


def test_a_stream_left_running_is_stopped_before_it_is_asked():
    with FakeFt300s(swing, streaming=True) as fake, sensor_on(fake) as sensor:
        assert sensor.identity.serial == "FSC-1234"
        collect(sensor, 5)


def test_leaving_after_an_error_stops_the_stream_too(fake: FakeFt300s):
    with pytest.raises(KeyError), sensor_on(fake):
        raise KeyError
    assert not fake.streaming


@pytest.mark.parametrize("fault", [{"corrupt": 0.01}, {"drop": 0.01}, {"garbage": 0.3}, {"corrupt": 0.3}])
def test_damage_on_the_wire_costs_frames_and_never_makes_one(fake: FakeFt300s, fault: dict[str, float]):
    fake.faults.noise = 0.5  # so that no two frames are alike
    with sensor_on(fake) as sensor:
        collect(sensor, 20)
        for name, value in fault.items():
            setattr(fake.faults, name, value)
        begin = len(fake.sent)
        until(lambda: len(fake.sent) > begin + 100)
        for name in fault:
            setattr(fake.faults, name, 0.0)
        before = sensor.health().frames
        until(lambda: sensor.health().frames > before + 45)  # two whole blocks: the clock has counted
        sent, health = len(fake.sent), sensor.health()
        samples = sensor.drain()
    known = {tuple(w) for w in said_by(fake)}
    assert all(tuple(s.wrench.tolist()) in known for s in samples)
    assert health.resyncs > 0
    if "garbage" in fault:
        assert health.lost_frames == 0
    else:
        assert health.lost_frames > 0
        assert health.frames + health.lost_frames == pytest.approx(sent, abs=3)


def test_an_adapter_that_hands_bytes_on_in_bunches_loses_nothing(fake: FakeFt300s):
    fake.faults.latency = 0.016
    with sensor_on(fake) as sensor:
        samples = collect(sensor, 200)
        assert sensor.health().lost_frames == 0
    assert wrenches(samples) == said_by(fake)[: len(samples)]
    assert (np.diff([s.time_s for s in samples]) > 0).all()


def test_a_stall_is_told_and_ends_by_itself(fake: FakeFt300s):
    with sensor_on(fake, stale_after=0.3) as sensor:
        collect(sensor, 10)
        fake.faults.stalled = True
        until(lambda: sensor.health().age_s > 0.35)
        with pytest.raises(SensorLostError, match=r"no frame for \d+ ms \(allowed: 300 ms\); nothing came"):
            sensor.latest()
        with pytest.raises(SensorLostError, match="no frame"):
            until(lambda: sensor.drain() == "never")
        fake.faults.stalled = False
        before = sensor.health().frames
        until(lambda: sensor.health().frames > before + 45)
        assert sensor.latest() is not None
        assert sensor.health().dropouts >= 1
        assert sensor.health().lost_frames >= 25


def test_bytes_that_make_no_frame_are_told_from_silence(fake: FakeFt300s):
    with sensor_on(fake, stale_after=0.3) as sensor:
        collect(sensor, 10)
        fake.faults.corrupt = 1.0
        until(lambda: sensor.health().age_s > 0.35)
        with pytest.raises(SensorLostError, match=r"\d+ bytes that make no frame: a wrong baud rate"):
            sensor.latest()


def test_unplugging_loses_nothing_that_had_come(fake: FakeFt300s):
    with sensor_on(fake) as sensor:
        until(lambda: sensor.health().frames >= 30)
        fake.unplug()
        with pytest.raises(SensorLostError, match="unplugged or gone"):
            until(lambda: sensor.latest() is None)
        samples = sensor.drain()
        assert wrenches(list(samples)) == said_by(fake)[: len(samples)]
        assert len(samples) == sensor.health().frames
        with pytest.raises(SensorLostError, match="unplugged or gone"):
            sensor.drain()


def test_a_port_that_is_not_there_is_refused():
    with (
        pytest.raises(RobotError, match=r"sensor /dev/ttyNONE: cannot be opened: no such device; USB serial ports: "),
        Ft300s("/dev/ttyNONE"),
    ):
        pass


def test_a_port_in_use_is_refused(fake: FakeFt300s):
    with sensor_on(fake) as sensor:
        with pytest.raises(RobotError, match=r"cannot be opened: in use by another program"), sensor_on(fake):
            pass
        collect(sensor, 5)


@pytest.mark.parametrize("why", ["deaf", "another baud rate"])
def test_a_sensor_that_does_not_answer_is_refused(why: str):
    with FakeFt300s(swing, baud=115200 if why != "deaf" else 19200) as fake:
        fake.faults.deaf = why == "deaf"
        with pytest.raises(RobotError, match="no answer at 19200 baud 8N1, Modbus address 9; check its power"):
            sensor_on(fake).__enter__()
        with pytest.raises(RobotError, match="not open"):
            sensor_on(fake).latest()


def test_a_stream_that_will_not_stop_is_refused():
    with FakeFt300s(swing, baud=9600, streaming=True) as fake:
        with pytest.raises(RobotError, match="bytes keep coming"):
            sensor_on(fake).__enter__()


def test_another_device_is_refused():
    with FakeFt300s(identity=IDENTITY | {500: b"GR"}) as gripper:
        with pytest.raises(RobotError, match=r"got firmware b'GR.*; allowed: an FT sensor's"):
            sensor_on(gripper).__enter__()
    with FakeFt300s(identity={}) as other:
        with pytest.raises(RobotError, match="refuses to say what it is"):
            sensor_on(other).__enter__()


def test_a_stream_that_does_not_start_is_told(fake: FakeFt300s):
    fake.faults.stalled = True
    with pytest.raises(SensorLostError, match="its stream does not start; no frame yet"):
        sensor_on(fake).__enter__()
    assert not fake.streaming


def test_a_serial_number_that_was_never_written_is_unknown():
    with FakeFt300s(identity=IDENTITY | {512: b"\0\0"}) as fake, sensor_on(fake) as sensor:
        assert sensor.identity.serial == "unknown"


@pytest.mark.parametrize(("written", "told"), [("16\n", True), ("1\n", False), ("", False)])
def test_a_slow_adapter_is_told(tmp_path: Path, written: str, told: bool):
    (tmp_path / "ttyUSB0" / "device").mkdir(parents=True)
    timer = tmp_path / "ttyUSB0" / "device" / "latency_timer"
    timer.write_text(written)
    link = tmp_path / "usb-FTDI-if00"
    link.symlink_to(tmp_path / "ttyUSB0")
    said = latency_warning(str(link), tmp_path)
    assert (said is not None) == told
    if said is not None:
        assert "latency timer is 16 ms" in said
        assert f"echo 1 | sudo tee {timer}" in said


@pytest.mark.parametrize("package", ["serial", "pymodbus"])
def test_a_missing_driver_is_told(package: str):
    code = f"import sys; sys.modules[{package!r}] = None; import testbed.robot.robotiq.ft300s"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False).stderr
    assert told.splitlines()[-1].endswith("not installed; pip install 'heft[robot]'")


def test_what_it_reports_is_within_half_a_count():
    with FakeFt300s(lambda _: [1.234, -5.678, 250.0, 0.12345, -1.0, 29.9]) as still, sensor_on(still) as sensor:
        latest = sensor.latest()
    assert latest is not None
    assert_allclose(latest.wrench[:3], [1.234, -5.678, 250.0], atol=0.005)
    assert_allclose(latest.wrench[3:], [0.12345, -1.0, 29.9], atol=0.0005)
