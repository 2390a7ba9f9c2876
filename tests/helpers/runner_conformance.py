"""Conformance of trial runners: of the simulation, of recordings, of the real robot over fakes."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

import numpy as np
import pytest
from numpy.testing import assert_allclose

from testbed import Accelerate, Rotate, SetupErrors, Slide, Trial, TrialRunner, Weigh, steady_windows
from testbed.errors import InfeasibleTrialError
from testbed.objects.model import MassDistribution, ObjectModel
from testbed.sensing.camera import PoseStream
from testbed.sensing.compensation import compensate
from testbed.trajectory import Phase, Status, Tool, Trajectory, load_trajectory, save_trajectory

RATE = 100.0
"""Samples a second."""


@dataclass(frozen=True)
class Bench:
    """A runner, and what to ask of it. Its trial is a turn there and back that it can do."""

    make: Callable[[], TrialRunner]
    """A new runner on the bench."""
    trial: Trial
    """A trial that it can do."""
    infeasible: Trial
    """A trial that it must refuse."""
    moved: Callable[[], float] = lambda: 0.0
    """Motion commanded so far; it must not grow while nothing may move."""


def is_a_trial_runner(bench: Bench) -> None:
    assert isinstance(bench.make(), TrialRunner)


def entering_gives_the_runner_and_moves_nothing(bench: Bench) -> None:
    before, runner = bench.moved(), bench.make()
    for _ in range(2):  # and again after leaving
        with runner as entered:
            assert entered is runner
    assert bench.moved() == before


def an_error_inside_comes_out(bench: Bench) -> None:
    with pytest.raises(KeyError, match="mine"), bench.make():
        raise KeyError("mine")


def what_cannot_be_done_is_refused_before_anything_moves(bench: Bench) -> None:
    refusals = []
    with bench.make() as runner:
        before = bench.moved()
        for _ in range(2):  # a refusal is no state
            try:
                runner.run(bench.infeasible)
            except InfeasibleTrialError as error:
                refusals.append(str(error))
        after = bench.moved()
    assert after == before
    assert len(refusals) == 2
    assert all(re.match(r"\w+: .+", why) for why in refusals), refusals


RUNNER_RULES: tuple[Callable[[Bench], None], ...] = (
    is_a_trial_runner,
    entering_gives_the_runner_and_moves_nothing,
    an_error_inside_comes_out,
    what_cannot_be_done_is_refused_before_anything_moves,
)
"""Rules of a runner; none of them runs the trial."""


def says_how_it_ended(record: Trajectory, trial: Trial) -> None:
    assert record.status in get_args(Status)
    assert (record.reason == "") == record.ok
    assert record.ok, record.reason
    assert record.provenance["runner"]
    assert all(np.isfinite(value) for value in record.figures.values())


def does_what_was_asked(record: Trajectory, trial: Trial) -> None:
    asked = trial.action
    assert asked.moves
    assert isinstance(record.action, type(asked))
    assert record.action.grasp == asked.grasp
    first = record.segment == 0
    if isinstance(asked, Rotate):
        assert_allclose(record.object_velocity[first, 2].mean(), asked.speed, rtol=0.05)
        assert_allclose(first.sum() / RATE, asked.duration, atol=0.1)


def goes_through_all_phases_in_order(record: Trajectory, trial: Trial) -> None:
    changes = np.flatnonzero(np.diff(record.phase)) + 1
    order = [Phase(p) for p in record.phase[[0, *changes]]]
    if order[-1] == Phase.TARE:  # a bench may close with another
        order.pop()
    moving = {Phase.RAMP, Phase.STEADY}
    acting = [i for i, phase in enumerate(order) if phase in moving]
    assert acting == list(range(acting[0], acting[-1] + 1))
    assert order[: acting[0]] == [Phase.TARE, Phase.APPROACH, Phase.GRASP, Phase.SETTLE]
    assert order[acting[-1] + 1 :] == [Phase.RELEASE]
    stretches = {Rotate: 1 + getattr(trial.action, "back", False), Slide: 1}
    stretches[Accelerate] = len(getattr(trial.action, "accelerations", ()))
    steady = record.segment[record.mask(Phase.STEADY)]
    assert (np.diff(steady) >= 0).all()
    assert sorted(set(steady.tolist())) == list(range(stretches[type(trial.action)]))
    assert (record.segment[~record.mask(Phase.STEADY)] == -1).all()


def samples_at_the_sensors_rate(record: Trajectory, trial: Trial) -> None:
    gaps = np.diff(record.time_s)
    assert (gaps > 0).all()
    assert record.time_s[0] == pytest.approx(0.0, abs=1.0 / RATE)
    assert gaps.mean() == pytest.approx(1 / RATE, rel=0.02)
    assert gaps.max() < 5 / RATE


def friction_opposes_the_motion(record: Trajectory, trial: Trial) -> None:
    windows = steady_windows(record)
    for window in windows:
        assert window.wrench[[0, 1, 5]] @ window.twist > 0, "the gripper must put work in"
    there, back = windows
    assert there.wrench[5] * back.wrench[5] < 0
    assert_allclose(there.wrench[5], -back.wrench[5], rtol=0.2)


def the_wrench_comes_by_the_path_that_all_share(record: Trajectory, trial: Trial) -> None:
    assert_allclose(compensate(record).wrench_on_object_world, record.wrench_on_object_world, atol=1e-9)


def the_hand_moves_as_it_says(record: Trajectory, trial: Trial) -> None:
    """Velocities are the poses' own slopes, and the object moves with the hand while it is held."""
    steady = np.flatnonzero(record.segment == 0)
    time = record.time_s[steady]
    for where, how, unit in (
        (record.tcp_position, record.tcp_velocity, 3),
        (record.object_pose, record.object_velocity, 3),
    ):
        moved = where[steady[-1], :unit] - where[steady[0], :unit]
        assert_allclose(np.trapezoid(how[steady, :unit], time, axis=0), moved, atol=3e-3)
    assert_allclose(record.tcp_velocity[steady, 5], record.object_velocity[steady, 2], atol=1e-6)


def the_truth_is_not_in_it(record: Trajectory, trial: Trial) -> None:
    parts = list(vars(record).values())
    allowed = (np.ndarray, str, dict, Tool, SetupErrors, PoseStream, type(None), Rotate, Accelerate, Slide, Weigh)
    assert all(isinstance(part, allowed) for part in parts)
    assert not any(isinstance(part, ObjectModel | MassDistribution) for part in parts)
    obj = trial.object
    truth = {*obj.truth.mass.tolist(), *obj.group_mass.tolist(), *obj.truth.friction.tolist(), obj.total_mass}
    assert not truth & set(record.figures.values())
    assert not any(f"{value:g}" in said.split() for value in truth for said in record.provenance.values())


def it_comes_back_from_a_file(record: Trajectory, trial: Trial) -> None:
    with TemporaryDirectory() as folder:
        save_trajectory(record, Path(folder) / "t.parquet")
        back = load_trajectory(Path(folder) / "t.parquet")
    for name, value in vars(record).items():
        if isinstance(value, np.ndarray):
            assert np.array_equal(getattr(back, name), value), name
    assert (back.action, back.status, back.figures) == (record.action, record.status, record.figures)


RECORD_RULES: tuple[Callable[[Trajectory, Trial], None], ...] = (
    says_how_it_ended,
    does_what_was_asked,
    goes_through_all_phases_in_order,
    samples_at_the_sensors_rate,
    friction_opposes_the_motion,
    the_wrench_comes_by_the_path_that_all_share,
    the_hand_moves_as_it_says,
    the_truth_is_not_in_it,
    it_comes_back_from_a_file,
)
"""Rules of the record of the trial, which is run once."""
