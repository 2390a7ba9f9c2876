"""Worlds in a scenario: every draw has its own trials, content keys differ by world, and draws stay hidden."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenarios.config import Scenario, WorldTable, load_scenario
from scenarios.policies import Policy
from scenarios.results.store import Store, key_of, trial_request
from scenarios.results.trials import sensed_trials
from scenarios.study.dry_run import DryRun
from scenarios.study.run import run_scenario
from testbed import InvalidValueError, Rotate, SimulationSettings, Trial, World, WorldDraw, load_object, world
from tests.helpers.runs import quiet

POLICY = Policy(duration=1.6, pivots=1, accelerated=1, held_out=0)


def short(**world: object) -> Scenario:
    return Scenario(objects=["I2"], sensing=["ft300s"], seeds=2, policy=POLICY, world=WorldTable(**world))  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
def test_every_draw_of_a_world_has_its_own_trials(tmp_path: Path):
    rows = run_scenario(short(preset="lab"), tmp_path, 0, quiet, executor="inline")
    first, second = (set(keys) for keys in rows["trial_keys"])
    assert len(rows) == 2 and not first & second
    key = next(iter(first))
    asked = json.loads((tmp_path / "trials" / key / "trial.json").read_text())["asked"]
    assert asked["world"]["world"]["gain"] == world("lab").gain
    for record in sensed_trials(Store(tmp_path), (key,), "ft300s", 0):
        assert set(record.provenance) == {"runner", "sensing"}
        assert record.setup == world("lab").stated
    again = run_scenario(short(preset="lab"), tmp_path, 0, quiet, executor="inline")
    assert again["key"].tolist() == rows["key"].tolist()


REPEATED = """
from testbed.actions.rotate import Rotate

class Repeated:
    def next(self, shape, trajectories):
        return Rotate(0, duration=1.6) if len(trajectories) < 2 else None
"""


@pytest.mark.slow
def test_a_repeated_action_is_a_trial_of_its_own_where_a_world_errs_anew(tmp_path: Path, monkeypatch):
    tmp_path.joinpath("repeating.py").write_text(REPEATED, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    twice = POLICY.model_copy(update={"kind": "repeating:Repeated"})
    keys = {}
    for preset in ("lab", "ideal"):
        asked = short(preset=preset).model_copy(update={"policy": twice, "seeds": 1})
        rows = run_scenario(asked, tmp_path / preset, 0, quiet, executor="inline")
        _, *keys[preset] = rows["trial_keys"][0]
    assert len(set(keys["lab"])) == 2 and len(set(keys["ideal"])) == 1
    one, other = (Store(tmp_path / "lab").trajectory(key).object_pose[0] for key in keys["lab"])
    assert np.abs(one - other).max() > 1e-4


@pytest.mark.slow
def test_a_run_that_goes_on_makes_the_repeats_that_it_needs_and_no_others(tmp_path: Path):
    """Known turns that repeat one are started at once, and again by a run that goes on, each with the same key."""
    policy = Policy(duration=1.6, pivots=12, accelerated=0, held_out=1)
    asked = short(preset="lab").model_copy(update={"policy": policy, "seeds": 1})
    rows = run_scenario(asked, tmp_path, 0, quiet, executor="inline")
    keys = [*rows["trial_keys"][0], *rows["held_out_keys"][0]]
    actions = [Store(tmp_path).trajectory(key).action for key in keys]
    made = {path.name for path in (tmp_path / "trials").iterdir()}
    assert len(set(actions)) < len(actions) == len(made) and made == set(keys)
    for folder in ("notes", "estimates"):
        shutil.rmtree(tmp_path / folder)
    shutil.rmtree(tmp_path / "trials" / keys[-2])
    again = run_scenario(asked, tmp_path, 0, quiet, executor="inline")
    assert again["key"].tolist() == rows["key"].tolist()
    assert {path.name for path in (tmp_path / "trials").iterdir()} == made


def test_sensors_share_the_trials_of_a_draw_and_a_perfect_one_has_draws_too():
    scenario = short(preset="lab").model_copy(update={"sensing": ["ideal", "ft300s"]})
    assert scenario.own_draws() == [("ideal", 0), ("ideal", 1), ("ft300s", 0), ("ft300s", 1)]
    assert short().own_draws() == [None]
    assert DryRun.of(scenario).estimates == 4
    model = load_object("I2")
    assert scenario.world.draw(model, 0, "s") == scenario.world.draw(model, 0, "s")
    assert scenario.world.draw(model, 0, "s") != scenario.world.draw(model, 1, "s")
    assert short(preset="lab", seed=1).world.draw(model, 0, "s") != scenario.world.draw(model, 0, "s")
    assert scenario.world.draw(model, 0, "other") != scenario.world.draw(model, 0, "s")


def test_a_repeat_without_a_world_has_a_key_of_its_own_where_it_is_asked_for():
    model, settings = load_object("I2"), SimulationSettings()
    keys = {key_of(trial_request(Trial(model, Rotate(0), seed=seed), settings)) for seed in range(3)}
    assert len(keys) == 3


def test_keys_differ_by_world_and_leave_the_ideal_one_out():
    model, action, settings = load_object("I2"), Rotate(0), SimulationSettings()
    plain = trial_request(Trial(model, action), settings)
    assert "world" not in plain
    ideal, lab, rough = (WorldDraw.of(w, model, 0) for w in (World(), world("lab"), world("rough")))
    keys = [key_of(trial_request(Trial(model, action, world=draw), settings)) for draw in (None, ideal, lab, rough)]
    assert keys[0] == keys[1] == key_of(plain)
    assert len(set(keys)) == 3


def test_a_quantity_is_changed_by_its_name_and_swept():
    table = WorldTable(preset="lab", gain=0.0, delay=0.01)  # pyright: ignore[reportCallIssue]
    assert (table.build().gain, table.build().delay, table.build().crosstalk) == (0.0, 0.01, 0.01)
    swept = Scenario(
        objects=["I2"],
        sweep={"axes": {"world.preset": ["ideal", "lab"], "world.group_friction": [0.0, 0.05]}},  # pyright: ignore[reportArgumentType]
    )
    built = [point.world.build() for _, point in swept.points()]
    assert [each.group_friction for each in built] == [0.0, 0.05] * 2
    assert built[0].none and not built[1].none


def test_a_command_line_names_the_world():
    changed = short(gain=0.0).changed(world="rough")
    assert changed.world.preset == "rough"
    assert changed.world.build() == replace(world("rough"), gain=0.0)
    with pytest.raises(InvalidValueError, match="ideal, lab, rough"):
        short().changed(world="rouhg")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["L1", "hammer"])
def test_own_weight_in_a_lab_is_not_taken_for_another_support(name, tmp_path):
    asked = load_scenario("lab_fixed")[1].changed(objects=[name], methods=["support_aware"])
    rows = run_scenario(asked, tmp_path, 2, quiet, secret="calibration")
    assert set(rows["status"]) <= {"ok", "underdetermined"}
