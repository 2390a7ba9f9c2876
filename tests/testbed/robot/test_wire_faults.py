"""Faults of programs and connections on a fake Gen3 without a limit of its own; bench/faults.py measures them all."""

from collections.abc import Iterator

import pytest

from tests.fakes.gen3 import FakeGen3
from tests.fakes.robot import small_object
from tests.fakes.wire_faults import PHASES, WIRE_FAULTS, Phase, freeze_both, stopped_after
from tests.fakes.world import Gen3World

ELSEWHERE = (
    "Ctrl-Z",
    "kill -9 of the stand-by",
    "SIGSTOP of the arm's process",
    "arm resets the connection",
    "SIGSTOP of the arm's process, and both are reset",
)
"""Faults that are struck in every phase; the others amid twists."""
CASES = [(name, phase) for name in WIRE_FAULTS for phase in (PHASES if name in ELSEWHERE else PHASES[:1])]


@pytest.fixture(scope="module")
def gen3() -> Iterator[FakeGen3]:
    with FakeGen3(Gen3World(small_object())) as fake:
        yield fake


@pytest.mark.slow
@pytest.mark.parametrize(("name", "phase"), CASES)
def test_every_fault_stops_the_arm_and_ends_the_trial(name: str, phase: Phase, gen3: FakeGen3):
    """By a command, long before it has gone as far as it was to go; the record does not say that all went well."""
    outcome = stopped_after(gen3, WIRE_FAULTS[name], phase)
    assert outcome.stop_s < 1.0
    assert outcome.moved_mm < 25
    assert "went on" not in outcome.said


@pytest.mark.slow
def test_where_both_processes_are_frozen_the_arm_stops_itself(gen3: FakeGen3):
    outcome = stopped_after(gen3, freeze_both, "twists", own_limit=True)
    assert outcome.stop_s < 1.0 and outcome.moved_mm < 25
