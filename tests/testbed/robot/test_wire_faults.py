"""Faults of programs while the fake Gen3 moves, which does not stop by itself; bench/faults.py measures them all."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.fakes.gen3 import FakeGen3
from tests.fakes.robot import small_object
from tests.fakes.wire_faults import WIRE_FAULTS, Way, stopped_after
from tests.fakes.world import Gen3World

POSE = ("Ctrl-Z", "kill -9 of the arm's process")
TWISTS = [name for name in WIRE_FAULTS if name not in ("Ctrl-C", "SIGSTOP of heft")]


@pytest.fixture(scope="module")
def gen3() -> Iterator[FakeGen3]:
    with FakeGen3(Gen3World(small_object())) as fake:
        yield fake


@pytest.mark.slow
@pytest.mark.parametrize(("name", "way"), [*((name, "twists") for name in TWISTS), *((name, "pose") for name in POSE)])
def test_every_end_of_heft_stops_the_arm(name: str, way: Way, gen3: FakeGen3):
    """By a command, long before it has gone as far as it was to go: 80 mm more."""
    outcome = stopped_after(gen3, WIRE_FAULTS[name], way)
    assert outcome.stop_s < 2.0
    assert outcome.moved_mm < 40
