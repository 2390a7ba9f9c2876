"""Turns over the wires of fakes, in real time: they must end in the masses that the pure simulation ends in."""

import pytest
import torch

from estimators.action_selection.rank import RankDriven
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from testbed.objects.files import load_object
from testbed.simulation.runner import SimulationRunner
from testbed.trial import Trial
from tests.fakes.rig import QUIET, over_wires


@pytest.mark.slow
def test_the_real_path_ends_in_the_simulations_masses():
    torch.set_num_threads(1)
    model, policy, runner = load_object("L2"), RankDriven(pivots=4, duration=4.0, accelerated=0), SimulationRunner()
    simulated = []
    while (action := policy.next(model.shape, simulated)) is not None:
        simulated.append(runner.run(Trial(model, action)))
    real = over_wires(model, [t.action for t in simulated], QUIET)
    if len(real) < len(simulated):
        pytest.skip("this machine is too busy for real time: trials ended as faults or came late")
    nad = []
    for trajectories in (simulated, real):
        answer = HiddenStates().estimate(model.shape, model.total_mass, trajectories, 0)
        assert answer.distribution is not None
        nad.append(100 * normalized_absolute_difference(model.shape, answer.distribution, model.truth))
    assert nad[1] < nad[0] + 1.0, [t.figures for t in real]
    assert all(t.figures["lost_frames"] == 0 for t in real)
