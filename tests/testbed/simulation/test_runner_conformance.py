"""The conformance suite on simulation and recordings; and it catches every breach."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Self, cast

import numpy as np
import pytest

from testbed import InfeasibleTrialError, ReplayRunner, Rotate, SimulationRunner, Trial, TrialRunner, load_object
from testbed.trajectory import Phase, Trajectory, save_trajectory
from tests.helpers.records import series_of
from tests.helpers.runner_conformance import (
    RECORD_RULES,
    RUNNER_RULES,
    Bench,
    does_what_was_asked,
    friction_opposes_the_motion,
    goes_through_all_phases_in_order,
    is_a_trial_runner,
    it_comes_back_from_a_file,
    samples_at_the_sensors_rate,
    says_how_it_ended,
    the_hand_moves_as_it_says,
    the_truth_is_not_in_it,
    the_wrench_comes_by_the_path_that_all_share,
)

TRIAL = Trial(load_object("L2"), Rotate(2, duration=1.4, pivot=(-0.0333, 0.025), back=True), sensing="ft300s", seed=1)
TOO_FAST = replace(TRIAL, action=Rotate(2, speed=3.0, duration=1.4, back=True))


@pytest.fixture(scope="module")
def simulation() -> Bench:
    return Bench(SimulationRunner, TRIAL, TOO_FAST)


@pytest.fixture(scope="module")
def simulated(simulation: Bench) -> Trajectory:
    return simulation.make().run(TRIAL)


@pytest.fixture(scope="module")
def replay(simulated: Trajectory, tmp_path_factory: pytest.TempPathFactory) -> Bench:
    folder = tmp_path_factory.mktemp("recorded")
    save_trajectory(simulated, folder / "1.parquet")
    return Bench(lambda: ReplayRunner(folder), TRIAL, TOO_FAST)


BENCHES = ("simulation", "replay")


@pytest.mark.parametrize("rule", RUNNER_RULES, ids=lambda f: f.__name__)
@pytest.mark.parametrize("name", BENCHES)
def test_the_runner_keeps(rule: Callable[[Bench], None], name: str, request: pytest.FixtureRequest):
    rule(request.getfixturevalue(name))


@pytest.fixture(scope="module")
def records(simulated: Trajectory, replay: Bench) -> dict[str, Trajectory]:
    with replay.make() as runner:
        return {"simulation": simulated, "replay": runner.run(TRIAL)}


@pytest.mark.parametrize("rule", RECORD_RULES, ids=lambda f: f.__name__)
@pytest.mark.parametrize("name", BENCHES)
def test_the_record_keeps(rule: Callable[[Trajectory, Trial], None], name: str, records: dict[str, Trajectory]):
    rule(records[name], TRIAL)


class Rude:
    """Runner that moves when it is entered and whenever it is called, and swallows errors."""

    commands = 0.0

    def __enter__(self) -> Self:
        Rude.commands += 1
        return self

    def __exit__(self, *_: object) -> bool:
        return True

    def run(self, trial: Trial) -> Trajectory:
        Rude.commands += 1
        raise InfeasibleTrialError(f"rude: {trial.action}")


RUDE = Bench(cast(Any, Rude), TRIAL, TOO_FAST, moved=lambda: Rude.commands)


@pytest.mark.parametrize("rule", RUNNER_RULES, ids=lambda f: f.__name__)
def test_a_rude_runner_is_caught(rule: Callable[[Bench], None]):
    assert isinstance(Rude(), TrialRunner)
    with pytest.raises((AssertionError, pytest.fail.Exception)):
        rule(replace(RUDE, make=cast(Any, object)) if rule is is_a_trial_runner else RUDE)


def rounded_in_time(t: Trajectory) -> Trajectory:
    return replace(t, **series_of(t, np.delete(np.arange(len(t.time_s)), slice(200, 210))))


def without(phase: Phase) -> Callable[[Trajectory], Trajectory]:
    return lambda t: replace(t, phase=np.where(t.phase == phase, Phase.SETTLE, t.phase))


BREACHES: tuple[tuple[Callable[[Trajectory, Trial], None], Callable[[Trajectory], Trajectory]], ...] = (
    (says_how_it_ended, lambda t: replace(t, status="fault", reason="")),
    (says_how_it_ended, lambda t: replace(t, figures={"slip_m": np.nan})),
    (does_what_was_asked, lambda t: replace(t, action=Rotate(1))),
    (does_what_was_asked, lambda t: replace(t, object_velocity=-t.object_velocity)),
    (goes_through_all_phases_in_order, without(Phase.GRASP)),
    (goes_through_all_phases_in_order, without(Phase.RELEASE)),
    (goes_through_all_phases_in_order, lambda t: replace(t, segment=np.minimum(t.segment, 0))),
    (samples_at_the_sensors_rate, lambda t: replace(t, time_s=2 * t.time_s)),
    (samples_at_the_sensors_rate, rounded_in_time),
    (friction_opposes_the_motion, lambda t: replace(t, wrench_on_object_world=-t.wrench_on_object_world)),
    (the_wrench_comes_by_the_path_that_all_share, lambda t: replace(t, sensor_wrench=1.01 * t.sensor_wrench)),
    (the_hand_moves_as_it_says, lambda t: replace(t, tcp_velocity=0 * t.tcp_velocity)),
    (the_truth_is_not_in_it, lambda t: replace(t, figures={"mass": TRIAL.object.total_mass})),
    (the_truth_is_not_in_it, lambda t: replace(t, provenance={"note": "the first block has 0.4 kg"})),
    (it_comes_back_from_a_file, lambda t: replace(t, figures={"slip_m": np.nan})),
)


@pytest.mark.parametrize(("rule", "spoil"), BREACHES)
def test_a_breach_is_caught(rule: Callable[..., None], spoil: Callable[..., Trajectory], simulated: Trajectory):
    with pytest.raises(AssertionError):
        rule(spoil(simulated), TRIAL)


def test_every_rule_has_a_breach():
    assert {rule for rule, _ in BREACHES} == set(RECORD_RULES)
