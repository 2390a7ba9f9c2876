"""Cost and losses of reading the sensor: python bench/robot.py sensor [MINUTES].

sensor  an FT-300S on a pseudo terminal, streaming at 100 Hz from another process, every frame numbered: frames lost,
        and the CPU share of the process that reads (10 minutes unless told otherwise)
"""

from __future__ import annotations

import itertools
import subprocess
import sys
import time

import numpy as np
from rich import box
from shared import head_table, show

from testbed.robot.interfaces import WrenchSample
from testbed.robot.robotiq.ft300s import Ft300s
from tests.fakes.ft300s import FakeFt300s

_WRAP = 30_000
"""Numbers that one axis can say."""


def play() -> None:
    """The other end: stream numbered frames until standard input is closed, then say how many."""
    numbers = itertools.count()

    def numbered(_: float) -> list[float]:
        n = next(numbers)
        return [(n % _WRAP) / 100, (n // _WRAP) / 100, 0, 0, 0, 0]

    with FakeFt300s(numbered) as fake:
        print(fake.port, flush=True)
        sys.stdin.read()
        print(len(fake.sent), flush=True)


def sensor(minutes: float) -> None:
    """Read for a while, as a trial would: drained ten times a second."""
    command = [sys.executable, __file__, "play"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        samples: list[WrenchSample] = []
        with Ft300s(other.stdout.readline().strip()) as reader:
            reader.stale_after = 1.0  # a pause is counted below, and ends nothing
            begin, begin_cpu = time.monotonic(), time.process_time()
            while time.monotonic() < begin + 60 * minutes:
                time.sleep(0.1)
                samples += reader.drain()
            cpu, wall = time.process_time() - begin_cpu, time.monotonic() - begin
            health = reader.health()
        other.communicate()
    numbers = [round(s.wrench[0] * 100) + _WRAP * round(s.wrench[1] * 100) for s in samples]
    missing = np.diff(numbers) - 1
    gaps = np.diff([s.time_s for s in samples]) * 1e3
    table = head_table("figure", "value", left=("figure", "value"), box=box.SIMPLE)
    between = "{:.2f}, {:.2f}, {:.2f} ms".format(*np.quantile(gaps, [0.5, 0.99, 1]))
    for figure, value in (
        ("time", f"{wall:.1f} s"),
        ("frames read", f"{len(numbers)} ({len(numbers) / wall:.2f} a second)"),
        ("frames lost, by their numbers", f"{int(missing.sum())}"),
        ("frames lost, by the driver's clock", f"{health.lost_frames}"),
        ("CRC errors, resyncs, dropouts", f"{health.crc_errors}, {health.resyncs}, {health.dropouts}"),
        ("time between frames: median, p99, most", between),
        ("CPU of the reading process", f"{100 * cpu / wall:.2f} % of one core"),
    ):
        table.add_row(figure, value)
    show(table, width=100)


def main() -> None:
    """Run what was asked for."""
    asked = sys.argv[1:]
    if asked == ["play"]:
        play()
    elif asked[:1] == ["sensor"] and len(asked) <= 2:
        sensor(float(asked[1]) if len(asked) == 2 else 10.0)
    else:
        sys.exit(f"got {' '.join(asked) or 'nothing'}; allowed: sensor [MINUTES]")


if __name__ == "__main__":
    main()
