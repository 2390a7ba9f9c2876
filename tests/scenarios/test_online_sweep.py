"""Sweeps in which the measured wrenches decide each action: each draw of the sensor has trials of its own."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from estimators.action_selection.online import OnlinePolicy
from scenarios.config import Scenario, load_scenario
from scenarios.results.files import done_keys
from scenarios.results.store import Store
from scenarios.results.trials import sensed_trials
from scenarios.study.dry_run import DryRun
from scenarios.study.experiment import experiments_of
from testbed import Action, ObjectShape, Trajectory, weight_of
from tests.helpers.runs import quiet, resumed, small_scenario

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
    """Inputs of all decisions of the policy: a record per trial."""


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
def test_each_draw_follows_its_own_wrenches(scenario: Path, swept: Swept):
    rows, store = swept.rows, Store(swept.out)
    assert rows[["sensing", "seed"]].to_numpy().tolist() == [["ideal", 0], ["ft300s", 0], ["ft300s", 1]]
    assert "failed" not in set(rows["status"]) and set(rows["trials"]) == {4}
    assert {*done_keys(swept.out, "trials")} == {*np.concatenate([*rows["trial_keys"], *rows["held_out_keys"]])}
    cells, _ = experiments_of(load_scenario(str(scenario))[1], store, quiet)
    all_records = set()
    for cell, row in zip(cells, rows.to_dict("records"), strict=True):
        assert cell.draw == (row["sensing"], row["seed"])
        weighing, *measured = sensed_trials(store, tuple(row["trial_keys"]), row["sensing"], row["seed"])
        cell.weighed.append(weight_of(weighing))
        so_far = [measured[:n] for n in range(len(measured) + 1)]
        all_records |= {records(some) for some in so_far}
        chosen = [cell.policy.next(cell.particles.shape, some) for some in so_far]
        assert chosen == [*(trial.action for trial in measured), None]
    assert swept.given == all_records and len(all_records) == 1 + 3 * 3  # of each draw alone


@pytest.mark.slow
def test_a_draw_goes_on_from_its_own_trials(scenario: Path, swept: Swept):
    out, rows = swept.out, swept.rows
    stamps = {path: path.stat().st_mtime_ns for path in out.glob("trials/*/trial.json")}
    keys = rows["trial_keys"].tolist()
    lost = {Path(out, "trials", keys[draw][trial]) for draw, trial in ((1, 3), (2, 2), (2, 3))}
    for path in (*(trial / "trial.json" for trial in lost), *out.glob("estimates/*/result.json")):
        path.unlink()
    for note in out.glob("notes/*.json"):  # as after a kill: a draw's note is written after its last trial
        note.unlink()
    pd.testing.assert_frame_equal(resumed(scenario, out, executor="inline"), rows)
    kept = [path for path in stamps if path.parent not in lost]
    assert kept and all(path.stat().st_mtime_ns == stamps[path] for path in kept)


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
