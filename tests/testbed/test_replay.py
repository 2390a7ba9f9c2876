"""Replay: what was recorded comes back, in order, for the trial it was recorded for and no other."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenarios.results.files import write_json
from testbed.actions.base import Action
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.actions.weigh import Weigh
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.files import DamagedFileError
from testbed.objects.files import load_object
from testbed.replay import Recording, ReplayRunner
from testbed.sensing.compensation import compensate
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import preset
from testbed.trajectory import Trajectory, save_trajectory
from testbed.trial import RIGID, Trial
from tests.helpers.records import moving_hand, record

L2, F2 = load_object("L2"), load_object("F2")
TURN = Rotate(1, duration=3.0, back=True)


def taken(name: str = "L2", action: Action = TURN, mark: float = 0.0, **said: str) -> Trajectory:
    """A record from a bench, told apart by its first reading."""
    wrench = np.zeros((400, 6))
    wrench[0, 0] = mark
    provenance = {"runner": "robot", "object": name, **said}
    return record(action=action, sensor_wrench=wrench, provenance={k: v for k, v in provenance.items() if v})


def mark_of(trajectory: Trajectory) -> float:
    return float(trajectory.sensor_wrench[0, 0])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    back = replace(TURN, speed=-TURN.speed)
    records = [("L2", TURN), ("F2", TURN), ("L2", Slide(1, 0.4)), ("L2", TURN), ("L2", back)]
    for i, (name, action) in enumerate(records, 1):
        save_trajectory(taken(name, action, float(i)), tmp_path / f"{i}.parquet")
    return tmp_path


def test_a_trial_gets_its_own_record(folder: Path):
    with ReplayRunner(folder) as runner:
        assert mark_of(runner.run(Trial(F2, TURN))) == 2.0
        assert mark_of(runner.run(Trial(L2, Slide(1, 0.4 + 1e-9)))) == 3.0
        assert mark_of(runner.run(Trial(L2, replace(TURN, speed=-TURN.speed)))) == 5.0


def test_repeats_come_in_order_and_come_to_an_end(folder: Path):
    runner = ReplayRunner(folder)
    for _ in range(2):
        with runner:
            assert [mark_of(runner.run(Trial(L2, TURN))) for _ in range(2)] == [1.0, 4.0]
            with pytest.raises(InfeasibleTrialError, match=r"L2: rotate \(grasp 1.*all 2 recordings have been played"):
                runner.run(Trial(L2, TURN))


def test_what_was_never_recorded_is_refused_with_what_there_is(folder: Path):
    with pytest.raises(
        InfeasibleTrialError,
        match=r"no L2: rotate \(grasp 0.*support own_weight; it has L2: rotate \(grasp 1, .*; F2: rotate .*; L2: slide",
    ):
        ReplayRunner(folder).run(Trial(L2, Rotate(0)))
    with pytest.raises(InfeasibleTrialError, match="no L2: weigh, support own_weight"):
        ReplayRunner(folder).run(Trial(L2, Weigh()))


def test_a_record_that_does_not_say_its_object_fits_any(tmp_path: Path):
    save_trajectory(taken("", mark=7.0), tmp_path / "a.parquet")
    for model in (L2, F2):
        assert mark_of(ReplayRunner(tmp_path).run(Trial(model, TURN, RIGID))) == 7.0


def test_support_is_told_apart_where_it_is_known(tmp_path: Path):
    save_trajectory(taken(mark=1.0, support="rigid"), tmp_path / "a.parquet")
    save_trajectory(taken(mark=2.0, support="own_weight"), tmp_path / "b.parquet")
    assert mark_of(ReplayRunner(tmp_path).run(Trial(L2, TURN))) == 2.0
    assert mark_of(ReplayRunner(tmp_path).run(Trial(L2, TURN, RIGID))) == 1.0


def test_the_order_is_that_of_recording(tmp_path: Path):
    for name, when, mark in (("a", "2026-01-02", 2.0), ("b", "2026-01-01", 1.0), ("c", "2026-01-03", 3.0)):
        save_trajectory(taken(mark=mark, recorded=when), tmp_path / f"{name}.parquet")
    runner = ReplayRunner(tmp_path)
    assert [mark_of(runner.run(Trial(L2, TURN))) for _ in range(3)] == [1.0, 2.0, 3.0]


def put(root: Path, key: str, trajectory: Trajectory, said: dict[str, object] | None) -> None:
    """A trial as a results folder has it."""
    save_trajectory(trajectory, root / "trials" / key / "trajectory.parquet")
    if said is not None:
        write_json(root / "trials" / key / "trial.json", said)


def test_a_results_folder_says_which_object_it_was(tmp_path: Path):
    put(tmp_path, "k1", taken("", mark=1.0), {"names": {"object": "F2"}})
    put(tmp_path, "k2", taken("", mark=2.0), {"names": {"object": "L2"}})
    put(tmp_path, "k3", taken("", mark=3.0), None)  # never finished
    runner = ReplayRunner(tmp_path)
    assert mark_of(runner.run(Trial(L2, TURN))) == 2.0
    assert len(runner.recordings) == 2


def test_a_results_folder_that_does_not_say_it_is_refused(tmp_path: Path):
    put(tmp_path, "k1", taken(""), {"asked": {}})
    with pytest.raises(InfeasibleTrialError, match=r"it has an object without a name: rotate"):
        ReplayRunner(tmp_path).run(Trial(L2, TURN))


def test_a_simulated_record_gets_the_trials_draw(tmp_path: Path):
    clean = moving_hand(wrench_world=np.arange(6.0))
    clean = replace(clean, provenance={"runner": "simulation", "support": "own_weight"})
    save_trajectory(clean, tmp_path / "a.parquet")
    trial = Trial(L2, Rotate(0), sensing="ft300s", seed=3)
    given = ReplayRunner(tmp_path, secret="s").run(trial)
    expected = draw_sensing(clean, preset("ft300s"), trial.seed_under("s"))
    assert np.array_equal(given.wrench_on_object_world, expected.wrench_on_object_world)
    assert not given.is_clean


def test_what_a_bench_measured_takes_no_draw(tmp_path: Path):
    measured = compensate(replace(moving_hand(), provenance={"runner": "robot"}))
    save_trajectory(measured, tmp_path / "a.parquet")
    given = ReplayRunner(tmp_path).run(Trial(L2, Rotate(0), sensing="ft300s", seed=3))
    assert np.array_equal(given.sensor_wrench, measured.sensor_wrench)
    assert np.array_equal(given.wrench_on_object_world, measured.wrench_on_object_world)


def test_a_folder_without_records_or_with_a_stranger_among_them_is_refused(tmp_path: Path):
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(InvalidValueError, match=r"replay folder: .*a results folder, or one of trajectory files"):
            ReplayRunner(folder)
    (tmp_path / "x.parquet").write_text("time_s\n0.1\n")
    with pytest.raises(DamagedFileError, match=r"x\.parquet: not a trajectory file"):
        ReplayRunner(tmp_path)


def test_a_recording_is_described_in_numbers_of_four_digits():
    action = Rotate(grasp=4, duration=4.0, pivot=(-0.01666666666666667, 0.10833333333333334), back=True)
    said = Recording(Path(), action, "L2", None).description
    assert said == "L2: rotate (grasp 4, speed 0.1745, duration 4, pivot (-0.01667, 0.1083), back True)"
