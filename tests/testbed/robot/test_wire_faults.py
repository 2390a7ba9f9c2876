"""Trials over the wires of fakes in real time: masses as in simulation, and faults that stop the arm."""

from collections.abc import Iterator

import pytest
import torch

from estimators.action_selection.rank import RankDriven
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from testbed.objects.files import load_object
from testbed.simulation.runner import SimulationRunner
from testbed.trial import Trial
from tests.fakes.gen3 import FakeGen3
from tests.fakes.rig import over_wires
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


@pytest.mark.slow
def test_the_real_path_ends_in_the_simulations_masses():
    torch.set_num_threads(1)
    model, policy, runner = load_object("L2"), RankDriven(pivots=4, duration=4.0, accelerated=0), SimulationRunner()
    simulated = []
    while (action := policy.next(model.shape, simulated)) is not None:
        simulated.append(runner.run(Trial(model, action)))
    real = over_wires(model, [t.action for t in simulated])
    if len(real) < len(simulated):
        pytest.skip("this machine is too busy for real time: trials ended as faults or came late")
    nad = []
    for trajectories in (simulated, real):
        answer = HiddenStates().estimate(model.shape, model.total_mass, trajectories, 0)
        assert answer.distribution is not None
        nad.append(100 * normalized_absolute_difference(model.shape, answer.distribution, model.truth))
    assert nad[1] < nad[0] + 1.0, [t.figures for t in real]
    assert all(t.figures["lost_frames"] == 0 for t in real)
