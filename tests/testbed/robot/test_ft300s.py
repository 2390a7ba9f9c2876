"""The FT-300S driver against a sensor on a pseudo terminal: identity, stream, faults of the wire, unplugging."""

import math
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("pymodbus")
from testbed.robot.interfaces import RobotError, SensorLostError, WrenchSample, WrenchSensor
from testbed.robot.robotiq.ft300s import Ft300s, latency_warning
from tests.fakes.ft300s import IDENTITY, FakeFt300s
from tests.helpers.waiting import until

pytestmark = pytest.mark.slow  # real lines and threads in real time


def swing(t: float) -> list[float]:
    return [10 * math.sin(7 * t), 5 * math.cos(3 * t), -9.0, 0.3 * math.sin(5 * t), 0.01, -0.2]


@pytest.fixture
def fake() -> Iterator[FakeFt300s]:
    with FakeFt300s(swing) as running:
        yield running


def sensor_on(fake: FakeFt300s, stale_after: float = 2.0) -> Ft300s:
    """A sensor more patient than a setting may make it: a busy machine keeps threads waiting."""
    sensor = Ft300s(fake.port)
    sensor.stale_after = stale_after
    return sensor


def collect(sensor: Ft300s, count: int) -> list[WrenchSample]:
    samples: list[WrenchSample] = []
    assert until(lambda: samples.extend(sensor.drain()) or len(samples) >= count, 30.0)
    return samples


def assert_whole(samples: list[WrenchSample], fake: FakeFt300s) -> None:
    """Every sent frame once, in order, at times that grow."""
    assert [s.wrench.tolist() for s in samples] == [w.tolist() for w in fake.sent[: len(samples)]]
    assert [s.sequence for s in samples] == list(range(len(samples)))
    assert (np.diff([s.time_s for s in samples]) > 0).all()


def test_it_is_a_wrench_sensor_that_naming_does_not_open():
    sensor = Ft300s("/dev/none")
    assert isinstance(sensor, WrenchSensor)
    assert (sensor.identity.serial, sensor.identity.rate_hz) == ("unknown", 100.0)
    assert sensor.health().frames == 0 and math.isinf(sensor.health().age_s)
    with pytest.raises(RobotError, match="not open; use it in a with statement"):
        sensor.drain()


@pytest.mark.parametrize("latency", [0.0, 0.016])
def test_every_frame_arrives_once_and_in_order(fake: FakeFt300s, latency: float):
    """Also from an adapter that hands bytes on in bunches."""
    fake.faults.latency = latency
    with sensor_on(fake) as sensor:
        assert (sensor.identity.serial, sensor.identity.firmware) == ("FSC-1234", "FSC-2.0.1")
        samples = collect(sensor, 250)
        health = sensor.health()
    assert_whole(samples, fake)
    assert np.diff([s.time_s for s in samples]).mean() == pytest.approx(0.01, rel=0.2)
    assert health.crc_errors == health.resyncs == health.lost_frames == 0


def test_leaving_stops_the_stream_and_entering_starts_it_again():
    """Also a stream left running by somebody else, and after an error."""
    with FakeFt300s(swing, streaming=True) as fake:
        sensor = sensor_on(fake)
        for turn in (1, 2):
            with sensor:
                assert collect(sensor, 10)[0].sequence == 0
                assert (fake.streaming, fake.starts) == (True, turn)
            assert not fake.streaming
        sensor.drain()  # the rest
        with pytest.raises(RobotError, match="not open"):
            sensor.drain()
        with pytest.raises(KeyError), sensor:
            raise KeyError
        assert not fake.streaming


@pytest.mark.parametrize("fault", [{"corrupt": 0.01}, {"drop": 0.01}, {"garbage": 0.3}, {"corrupt": 0.3}])
def test_damage_on_the_wire_costs_frames_and_never_makes_one(fake: FakeFt300s, fault: dict[str, float]):
    fake.faults.noise = 0.5  # so that no two frames are alike
    with sensor_on(fake) as sensor:
        collect(sensor, 20)
        vars(fake.faults).update(fault)
        begin = len(fake.sent)
        assert until(lambda: len(fake.sent) > begin + 100)
        vars(fake.faults).update(dict.fromkeys(fault, 0.0))
        before = sensor.health().frames
        assert until(lambda: sensor.health().frames > before + 45)
        sent, health = len(fake.sent), sensor.health()
        samples = sensor.drain()
    known = {tuple(w.tolist()) for w in fake.sent}
    assert all(tuple(s.wrench.tolist()) in known for s in samples)
    assert health.resyncs > 0
    if "garbage" in fault:
        assert health.lost_frames == 0
    else:
        assert health.lost_frames > 0
        assert health.frames + health.lost_frames == pytest.approx(sent, abs=3)


def test_a_stall_is_an_error_and_ends_by_itself(fake: FakeFt300s):
    """Told from bytes that make no frame."""
    with sensor_on(fake, stale_after=0.3) as sensor:
        collect(sensor, 10)
        fake.faults.stalled = True
        assert until(lambda: sensor.health().age_s > 0.35)
        with pytest.raises(SensorLostError, match=r"no frame for \d+ ms \(allowed: 300 ms\); nothing came"):
            until(lambda: sensor.drain() == "never")
        fake.faults.stalled = False
        before = sensor.health().frames
        assert until(lambda: sensor.health().frames > before + 45)
        assert sensor.drain()
        assert sensor.health().dropouts >= 1
        assert sensor.health().lost_frames >= 25
        fake.faults.corrupt = 1.0
        assert until(lambda: sensor.health().age_s > 0.35)
        with pytest.raises(SensorLostError, match=r"\d+ bytes that make no frame: a wrong baud rate"):
            until(lambda: sensor.drain() == "never")


def test_unplugging_loses_nothing_that_had_come(fake: FakeFt300s):
    with sensor_on(fake) as sensor:
        assert until(lambda: sensor.health().frames >= 30)
        fake.unplug()
        time.sleep(0.2)
        samples = list(sensor.drain())
        assert_whole(samples, fake)
        assert len(samples) == sensor.health().frames
        with pytest.raises(SensorLostError, match="unplugged or gone"):
            sensor.drain()


def test_a_port_is_one_users(fake: FakeFt300s):
    with sensor_on(fake) as sensor:
        with pytest.raises(RobotError, match="in use by another program"), sensor_on(fake):
            pass
        collect(sensor, 5)


@pytest.mark.parametrize(
    ("device", "faults", "reason"),
    [
        ({}, {"deaf": True}, "no answer at 19200 baud 8N1, Modbus address 9; check its power"),
        ({"baud": 115200}, {}, "no answer at 19200 baud"),
        ({"baud": 9600, "streaming": True}, {}, "bytes keep coming"),
        ({"identity": IDENTITY | {500: b"GR"}}, {}, r"got firmware b'GR.*; allowed: an FT sensor's"),
        ({"identity": {}}, {}, "refuses to say what it is"),
        ({}, {"stalled": True}, "its stream does not start; no frame yet"),
    ],
)
def test_another_device_or_a_silent_one_is_refused(device: dict[str, Any], faults: dict[str, bool], reason: str):
    with FakeFt300s(swing, **device) as fake:
        vars(fake.faults).update(faults)
        sensor = sensor_on(fake)
        with pytest.raises(RobotError, match=reason):
            sensor.__enter__()
        with pytest.raises(RobotError, match="not open"):
            sensor.drain()


def test_half_a_count_and_an_unwritten_serial_number():
    wrench = [1.234, -5.678, 250.0, 0.12345, -1.0, 29.9]
    with FakeFt300s(lambda _: wrench, identity=IDENTITY | {512: b"\0\0"}) as still, sensor_on(still) as sensor:
        assert sensor.identity.serial == "unknown"
        (first, *_) = collect(sensor, 1)
    assert_allclose((first.wrench - wrench) / [*[0.005] * 3, *[0.0005] * 3], 0, atol=1)


@pytest.mark.parametrize(("written", "slow"), [("16\n", True), ("1\n", False), ("", False)])
def test_a_slow_adapter_is_named(tmp_path: Path, written: str, slow: bool):
    (tmp_path / "ttyUSB0" / "device").mkdir(parents=True)
    timer = tmp_path / "ttyUSB0" / "device" / "latency_timer"
    timer.write_text(written)
    link = tmp_path / "usb-FTDI-if00"
    link.symlink_to(tmp_path / "ttyUSB0")
    warning = latency_warning(str(link), tmp_path) or ""
    assert ("latency timer is 16 ms" in warning and f"echo 1 | sudo tee {timer}" in warning) == slow


@pytest.mark.parametrize("package", ["serial", "pymodbus"])
def test_a_missing_driver_is_named(package: str):
    code = f"import sys; sys.modules[{package!r}] = None; import testbed.robot.robotiq.ft300s"
    error = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False).stderr
    assert error.splitlines()[-1].endswith("not installed; pip install 'heft-testbed[robot]'")
