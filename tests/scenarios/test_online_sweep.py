"""Sweeps in which the measured wrenches decide each action: each draw of the sensor has trials of its own."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from estimators.action_selection.online import OnlinePolicy
from scenarios.cli.main import main
from scenarios.config import Scenario, load_scenario
from scenarios.results.store import Store
from scenarios.results.trials import sensed_trials
from scenarios.study.dry_run import DryRun
from scenarios.study.experiment import experiments_of
from testbed import Action, ObjectShape, Trajectory, weight_of
from tests.helpers.runs import Killing, kill_a_run, quiet, resumed, small_scenario

ONLINE = """
held_out = 1
kind = "online"
touches = 3
candidates = 60
seed = 1
"""


@dataclass(frozen=True)
class Swept:
    """A run that is done."""

    out: Path
    rows: pd.DataFrame
    given: set[tuple[bytes, ...]]
    """All that the policy was given to choose by: a record a trial."""


def records(trajectories: Sequence[Trajectory]) -> tuple[bytes, ...]:
    return tuple(trajectory.sensor_wrench.tobytes() for trajectory in trajectories)


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_scenario(tmp_path_factory.mktemp("scenario"), ("own_weight",), ONLINE)


@pytest.fixture(scope="module")
def swept(scenario: Path, tmp_path_factory: pytest.TempPathFactory) -> Swept:
    out, given, choose = tmp_path_factory.mktemp("online") / "out", set(), OnlinePolicy.next

    def spied(self: OnlinePolicy, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        given.add(records(trajectories))
        return choose(self, shape, trajectories)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(OnlinePolicy, "next", spied)
        return Swept(out, resumed(scenario, out, executor="inline"), given)


@pytest.mark.slow
def test_each_draw_follows_what_it_felt(scenario: Path, swept: Swept):
    rows, store = swept.rows, Store(swept.out)
    assert rows[["sensing", "seed"]].to_numpy().tolist() == [["ideal", 0], ["ft300s", 0], ["ft300s", 1]]
    assert "failed" not in set(rows["status"]) and set(rows["trials"]) == {4}
    cells, _ = experiments_of(load_scenario(str(scenario))[1], store, quiet)
    felt_by_any = set()
    for cell, row in zip(cells, rows.to_dict("records"), strict=True):
        assert cell.draw == (row["sensing"], row["seed"])
        weighing, *felt = sensed_trials(store, tuple(row["trial_keys"]), row["sensing"], row["seed"])
        cell.weighed.append(weight_of(weighing))
        so_far = [felt[:n] for n in range(len(felt) + 1)]
        felt_by_any |= {records(some) for some in so_far}
        chosen = [cell.policy.next(cell.particles.shape, some) for some in so_far]
        assert chosen == [*(trial.action for trial in felt), None]
    assert swept.given == felt_by_any and len(felt_by_any) == 1 + 3 * 3  # each draw its own, and nothing but these


@pytest.mark.slow
def test_a_draw_goes_on_from_its_own_trials(scenario: Path, swept: Swept):
    out, rows = swept.out, swept.rows
    stamps = {path: path.stat().st_mtime_ns for path in out.glob("trials/*/trial.json")}
    lost = out / "trials" / rows["trial_keys"][2][2]
    (lost / "trial.json").unlink()
    for path in out.glob("estimates/*/result.json"):
        path.unlink()
    pd.testing.assert_frame_equal(resumed(scenario, out, executor="inline"), rows)
    kept = [path for path in stamps if path.parent != lost]
    assert kept and all(path.stat().st_mtime_ns == stamps[path] for path in kept)


@pytest.mark.slow
def test_it_goes_on_after_being_killed(scenario: Path, swept: Swept, tmp_path: Path):
    kill_a_run(scenario, tmp_path / "out", Killing("both", 4, 0.1, 0))
    pd.testing.assert_frame_equal(resumed(scenario, tmp_path / "out", executor="inline"), swept.rows)


@pytest.mark.slow
def test_its_trials_are_counted(swept: Swept, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", "200")
    main(["status", str(swept.out)])
    said = capsys.readouterr().out
    made = len(set(np.concatenate([*swept.rows["trial_keys"], *swept.rows["held_out_keys"]])))
    assert f"finished\ntrials: {made} done, 0 failed; estimates: 3 done, 0 failed" in said


def test_each_draw_may_have_its_own_order_of_grasps(tmp_path: Path):
    asked = {"objects": ["L2"], "sensing": ["ft300s"], "seeds": 3, "policy": {"kind": "published", "seed": 2}}
    shared, apart = (
        experiments_of(Scenario.model_validate(asked | {"policy": asked["policy"] | more}), Store(tmp_path), quiet)[0]
        for more in ({}, {"redraw": True})
    )
    assert [one.draw for one in shared] == [None]
    assert [one.draw for one in apart] == [("ft300s", number) for number in range(3)]
    actions = [one.known_actions() for one in apart]
    assert actions[0] == shared[0].known_actions()
    assert actions[0] != actions[1] != actions[2] != actions[0]
    assert apart[0].turns == shared[0].turns
    assert all(turn.grasp not in one.grasps for one in apart for turn in one.turns), "by a grasp that no trial has"


def test_a_run_is_counted_before_it_is_made():
    policy = {"kind": "online", "touches": 3, "held_out": 1}
    asked = {"objects": ["I1", "L2"], "sensing": ["ideal", "ft300s"], "seeds": 4, "support": ["own_weight", "rigid"]}
    online, planned = (
        DryRun.of(Scenario.model_validate(asked | {"policy": policy | {"kind": k}})) for k in ("online", "greedy")
    )
    assert (planned.experiments, planned.trials, planned.estimates) == (4, 4 * 5, 4 * 5)
    assert (online.experiments, online.trials, online.estimates) == (4 * 5, 4 * 5 * 5, 4 * 5)
    assert online.seconds > planned.seconds
