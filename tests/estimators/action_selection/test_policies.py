"""Policies of somebody else's: in a scenario by their path, checked in the user's words, run beside heft's own."""

from __future__ import annotations

import sys
from collections import Counter
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Any

import pytest

from estimators.base import ActionPolicy
from estimators.evaluation.statistics import axis_columns
from estimators.registry import POLICY
from scenarios.config import Policy, Scenario, load_scenario
from scenarios.results.load import load_results
from scenarios.results.store import read_json
from scenarios.study.run import run_scenario
from testbed import plugins
from testbed.actions.rotate import Rotate
from testbed.errors import HeftError, InvalidValueError
from testbed.objects.files import InvalidFileError, load_object
from testbed.objects.model import ObjectShape
from testbed.plugins import find_class
from testbed.simulation.settings import SimulationSettings

MODULE = '''
from testbed.actions.rotate import Rotate
from testbed.actions.weigh import Weigh

class Outermost:
    """Turns about the grasps farthest from the middle first."""
    def __init__(self, turns: int = 2, duration: float = 2.0, grasps=None):
        if turns < 1:
            raise ValueError("turns is not 1 or more")
        self.turns, self.duration, self.grasps = turns, duration, grasps
    def next(self, shape, trajectories):
        usable = range(len(shape.grasps)) if self.grasps is None else self.grasps
        far = sorted(usable, key=lambda g: -abs(shape.grasps[g].position).max())
        done = len(trajectories)
        return Rotate(far[done], duration=self.duration, back=True) if done < min(self.turns, len(far)) else None

class Told(Outermost):
    def __init__(self, grasps, weight_kg, feasible):
        super().__init__(1, grasps=grasps)
        assert feasible(Rotate(grasps[0])) == "" and weight_kg > 0
        self.weight_kg, self.feasible = weight_kg, feasible

class Endless(Outermost):
    def next(self, shape, trajectories):
        return Rotate(self.grasps[0], duration=2.0)

class Wrong:
    def __init__(self, how="raise"):
        self.how = how
    def next(self, shape, trajectories):
        return {"word": "rotate", "weigh": Weigh(), "beyond": Rotate(77)}[self.how]

class Deaf:
    def next(self, shape):
        return None
'''


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """A folder of a user's, as the current one; what is found there is forgotten again."""
    (tmp_path / "of_mine.py").write_text(MODULE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [p for p in sys.path if p not in ("", str(tmp_path))])
    monkeypatch.delitem(sys.modules, "of_mine", raising=False)
    return tmp_path


def built(kind: str, grasps: tuple[int, ...] = (1, 3), **fields: object) -> tuple[Any, ObjectShape]:
    l2 = load_object("L2")
    return Policy.model_validate({"kind": kind, **fields}).build(grasps, l2, SimulationSettings()), l2.shape


def first(policy: ActionPolicy, shape: ObjectShape) -> Rotate:
    action = policy.next(shape, ())
    assert isinstance(action, Rotate)
    return action


@pytest.mark.usefixtures("here")
def test_it_is_told_what_it_has_an_argument_for():
    policy, shape = built("of_mine:Told", grasps=(1, 3))
    inner = policy.policy
    assert (inner.grasps, inner.weight_kg) == ((1, 3), load_object("L2").total_mass)
    assert first(policy, shape).grasp in (1, 3)
    assert "speed" in inner.feasible(Rotate(1, duration=2.0, speed=90.0))


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ('kind = "gredy"', r"toml: policy.kind: got 'gredy'; allowed: one of paper, .*nearest: greedy.*package:"),
        ('kind = "of_mine:Outermst"', r"a class of of_mine: Outermost, Told.*nearest: Outermost"),
        ('kind = "of_mine:Deaf"', r"a class with next\(self, shape, trajectories\), as .*; Deaf has next\("),
        ('kind = "of_mine:Outermost"\nsettings = {turn = 3}', r"got 'turn'; .*settings turns, duration \(nearest"),
        ('kind = "of_mine:Outermost"\nsettings = {grasps = [1]}', r"got 'grasps'; .*; heft itself gives grasps"),
        ('kind = "of_mine:Outermost"\nsettings = {turns = 0}', r"turns is not 1 or more"),
        ('kind = "greedy"\nsettings = {turns = 2}', r"none: greedy has its fields in \[policy\]"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_before_anything_runs(policy, message, tmp_path):
    file = tmp_path / "s.toml"
    file.write_text(f'objects = ["I1"]\n[policy]\n{policy}\n', encoding="utf-8")
    with pytest.raises(InvalidFileError, match=message):
        load_scenario(str(file))


@pytest.mark.usefixtures("here")
def test_an_entry_point_is_a_policy_by_name(monkeypatch):
    points = EntryPoints([EntryPoint("outermost", "of_mine:Outermost", POLICY.group)])
    monkeypatch.setattr(plugins, "entry_points", lambda *, group: points.select(group=group))
    policy, shape = built("outermost", settings={"turns": 1})
    assert first(policy, shape).duration == 2.0
    with pytest.raises(InvalidValueError, match=r"outermost \(nearest: outermost\)"):
        find_class("outermst", POLICY, "policy.kind")


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("raise", r"of_mine:Wrong.next\(\) ends in KeyError: 'raise' \(of_mine.py, line \d+\)"),
        ("word", r"of_mine:Wrong.next\(\): got 'rotate'; allowed: an action"),
        ("weigh", r"got Weigh\(\); allowed: an action"),
        ("beyond", r"next\(\).grasp: got 77; allowed: a grasp that may be used: \(1, 3\)"),
    ],
)
def test_what_cannot_be_asked_for_is_no_action(how, message):
    policy, shape = built("of_mine:Wrong", settings={"how": how})
    with pytest.raises(HeftError, match=message):
        policy.next(shape, ())


def asked(source: str, folder: Path, **fields: object) -> dict[str, object]:
    sys.modules.pop("of_mine", None)
    (folder / "of_mine.py").write_text(source, encoding="utf-8")
    return Policy.model_validate({"kind": "of_mine:Outermost", **fields}).asked()


def test_what_was_tried_is_kept_under_the_source_and_the_settings(here):
    first, again = asked(MODULE, here), asked(MODULE, here)
    assert first == again
    assert first != asked(MODULE + "# more\n", here)
    assert first != asked(MODULE, here, settings={"turns": 1})
    assert "source" not in Policy().asked()


@pytest.mark.usefixtures("here")
def test_its_settings_are_swept_side_by_side_with_the_kinds():
    axes = {"policy.kind": ["paper", "of_mine:Outermost"], "policy.settings": [{}, {"turns": 1}]}
    points = Scenario.model_validate({"objects": ["I1"], "sweep": {"mode": "zip", "axes": axes}}).points()
    assert [point.policy.settings for _, point in points] == [{}, {"turns": 1}]
    assert [axis_columns(at)["axis.policy.settings"] for at, _ in points] == ["none", "turns = 1"]


@pytest.mark.slow
def test_it_is_swept_beside_hefts_own(here):
    own = {"pivots": 2, "duration": 2.0, "accelerated": 0, "held_out": 0, "touches": 3}
    kinds = ["paper", "of_mine:Outermost", "of_mine:Endless", "of_mine:Wrong"]
    scenario = Scenario.model_validate({"objects": ["I1"], "policy": own, "sweep": {"axes": {"policy.kind": kinds}}})
    run_scenario(scenario, here / "out", 0, lambda *_, **__: None)
    rows = {row["axis.policy.kind"]: row for row in load_results(here / "out").to_dict("records")}
    assert list(rows) == kinds
    assert "policy: of_mine:Wrong.next() ends in KeyError" in rows["of_mine:Wrong"]["message"]
    told = {kind: read_json(here / "out" / "estimates" / rows[kind]["key"] / "result.json") for kind in kinds[:3]}
    made = {kind: Counter(said["trial_keys"]).total() - 1 for kind, said in told.items() if said}
    assert made["of_mine:Outermost"] == 2
    assert made["of_mine:Endless"] == own["touches"]
    assert made["paper"] >= 2
