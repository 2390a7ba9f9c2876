"""Methods and policies of other packages: found without registration, refused by name, run on worker processes."""

import os
import pickle
import sys
from collections import Counter
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from estimators.evaluation.statistics import axis_columns
from estimators.registry import ESTIMATOR, METHODS, POLICY, build_method
from estimators.testing.recorded import load_block
from scenarios.config import Policy, Scenario, load_scenario
from scenarios.results.estimates import load_results
from scenarios.results.files import read_json
from scenarios.study.dry_run import check_code
from scenarios.study.estimates import judged_answers
from testbed import HeftError, InvalidValueError, ObjectShape, Rotate, SimulationSettings, load_object
from testbed.plugins import configured, find_class, load_class, source_hash
from tests.helpers.commands import ended

MODULE = '''
from dataclasses import dataclass
import numpy as np
from estimators.base import Estimate
from testbed.actions.rotate import Rotate
from testbed.actions.weigh import Weigh
from testbed.objects.model import MassDistribution

@dataclass(frozen=True)
class Even:
    """The same mass everywhere."""
    friction: float = 0.5
    times: tuple = (1.0,)
    def __post_init__(self):
        if not 0 < self.friction < 2:
            raise ValueError("friction is not from 0 to 2")
    def estimate(self, shape, weight, trajectories, seed):
        print("even as ever")
        mass = np.full(shape.n_m, weight / len(shape.particles))
        return Estimate(MassDistribution(mass, np.full(shape.n_mu, self.friction)), "ok", seconds=1e-3)

class Needy:
    def __init__(self, path):
        self.path = path
    def estimate(self, shape, weight, trajectories, seed):
        raise NotImplementedError

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
    def estimate(self, data):
        return data
    def next(self, shape):
        return None

class Mute:
    pass

class Later:
    async def estimate(self, shape, weight, trajectories, seed):
        return None

def function(shape):
    return shape

print("of the user, as it is imported")
'''


@pytest.fixture
def here(as_user) -> Path:
    return as_user(of_user=MODULE, half_done="import no_such_thing\n", wrong_words="def f(:\n")


def built(kind: str, grasps: tuple[int, ...] = (1, 3), **fields: object) -> tuple[Any, ObjectShape]:
    """Policy of a scenario's table on L2."""
    l2 = load_object("L2")
    policy: Any = Policy.model_validate({"kind": kind, **fields}).build(grasps, l2.shape, SimulationSettings(), [1.801])
    return policy.policy, l2.shape


@pytest.mark.usefixtures("here")
def test_a_class_of_the_current_folder_is_a_method_with_its_settings():
    settings = {"method": "of_user:Even", "friction": 0.3, "times": [1, 2]}
    scenario = Scenario(objects=["I1"], methods={"mine": settings})
    mine: Any = build_method("mine", scenario.methods["mine"])
    assert (mine.friction, mine.times) == (0.3, (1, 2))
    asked = scenario.changed(methods=("mine", "of_user:Even", "random_search"))
    assert asked.methods == {**scenario.methods, "of_user:Even": {}, "random_search": {}}


@pytest.mark.slow
@pytest.mark.usefixtures("here")
def test_a_policy_is_given_what_it_has_an_argument_for():
    policy, shape = built("of_user:Told", grasps=(1, 3))
    inner = policy.policy
    assert (inner.grasps, inner.weight_kg) == ((1, 3), 1.801)
    assert policy.next(shape, ()).grasp in (1, 3)
    assert "speed" in inner.feasible(Rotate(1, duration=2.0, speed=90.0))


METHOD = '[methods.mine]\nmethod = "{}"\n'
REFUSED = [
    (METHOD.format("of_user"), "one of hidden_states"),
    (METHOD.format("of_user:"), '"package.module:Class"'),
    (METHOD.format("my user:Even"), '"package.module:Class"'),
    (METHOD.format("of_usr:Even"), "there is no of_usr"),
    (METHOD.format("of_user.deeper:Even"), r"there is no of_user\.deeper"),
    (METHOD.format("half_done:Even"), "half_done needs no_such_thing"),
    (METHOD.format("wrong_words:Even"), "SyntaxError"),
    (METHOD.format("of_user:Evne"), r"nearest: Even\)"),
    (METHOD.format("estimators:HiddenState"), r"nearest: HiddenStates\)"),
    (METHOD.format("of_user:Mute"), "Mute has no estimate"),
    (METHOD.format("of_user:Deaf"), r"Deaf has estimate\(self, data\)"),
    (METHOD.format("of_user:function"), "this is a function"),
    (METHOD.format("of_user:Later"), "Later has an async estimate"),
    ('[sweep.axes]\n"grid.feet" = [3, 4, 3]', r"sweep\.axes: .*no value twice"),
    ('[[random]]\nname = "my objects"\ncount = 1', "letters, digits and any of _ . -"),
    (METHOD.format("estimators.baselines.base:Baseline"), "Baseline is abstract"),
    ('[policy]\nkind = "gredy"', r"policy\.kind: .*nearest: greedy"),
    ('[policy]\nkind = "of_user:Outermst"', "nearest: Outermost"),
    ('[policy]\nkind = "of_user:Deaf"', r"Deaf has next\("),
    ('[policy]\nkind = "of_user:Outermost"\nsettings = {turn = 3}', r"got 'turn'; .*nearest: turns"),
    ('[policy]\nkind = "of_user:Outermost"\nsettings = {grasps = [1]}', "heft itself gives grasps"),
    ('[policy]\nkind = "of_user:Outermost"\nsettings = {turns = 0}', "turns is not 1 or more"),
    ('[policy]\nkind = "greedy"\nsettings = {turns = 2}', "greedy has its fields"),
]


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(("table", "reason"), REFUSED, ids=[reason for _, reason in REFUSED])
def test_what_is_wrong_in_a_scenario_is_refused_before_anything_runs(table, reason, tmp_path):
    (tmp_path / "s.toml").write_text(f'objects = ["I1"]\n{table}\n', encoding="utf-8")
    with pytest.raises(HeftError, match=reason):
        check_code(load_scenario("s.toml")[1])


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("name", "settings", "reason"),
    [
        ("Even", {"fricton": 0.3}, "nearest: friction"),
        ("Even", {"friction": 3.0}, "friction is not from 0 to 2"),
        ("Even", {"friction": {}}, "types"),
        ("Even", {"friction": "high"}, r"types \(friction: a valid number\)"),
        ("Outermost", {"turns": 2.5}, r"types \(turns: a valid integer\)"),
        ("Outermost", {"turns": True}, r"types \(turns: a valid integer\)"),
        ("Needy", {}, "settings path as well"),
    ],
)
def test_a_wrong_setting_of_a_method_is_refused(name, settings, reason):
    role: Any = POLICY if name == "Outermost" else ESTIMATOR
    with pytest.raises(InvalidValueError, match=reason) as raised:
        configured(load_class(f"of_user:{name}", role, "mine"), settings, "mine")
    assert raised.value.field == "mine"


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ("raise", r"of_user:Wrong.next\(\) ends in KeyError: 'raise' \(of_user.py, line \d+\)"),
        ("word", r"got 'rotate'; allowed: an action"),
        ("weigh", r"got Weigh\(\); allowed: an action"),
        ("beyond", r"next\(\).grasp: got 77; .*\(1, 3\)"),
    ],
)
def test_what_is_no_action_of_the_scenario_is_refused(how, reason):
    policy, shape = built("of_user:Wrong", settings={"how": how})
    with pytest.raises(HeftError, match=reason):
        policy.next(shape, ())


@pytest.mark.usefixtures("here")
def test_an_entry_point_is_a_method_or_a_policy_by_name(install):
    install(estimators="even = of_user:Even", policies="outermost = of_user:Outermost")
    assert type(build_method("even", {"friction": 0.2})).__name__ == "Even"
    assert Scenario(objects=["I1"]).changed(methods=("even",)).methods == {"even": {}}
    policy, shape = built("outermost", settings={"turns": 1})
    assert policy.next(shape, ()).duration == 2.0
    with pytest.raises(InvalidValueError, match=r"nearest: even\)"):
        find_class("evn", ESTIMATOR, "name")
    with pytest.raises(InvalidValueError, match=r"nearest: outermost\)"):
        find_class("outermst", POLICY, "name")


def test_an_answer_is_kept_under_the_source_that_gave_it(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    kinds = []
    for name, text in (("one_source", MODULE), ("other_source", MODULE), ("third_source", MODULE + "# more\n")):
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        kinds.append(load_class(f"{name}:Even", ESTIMATOR, "x"))
    first, same, other = map(source_hash, kinds)
    assert first == same != other


def test_a_trial_is_kept_under_the_source_and_the_settings_of_its_policy(here):
    def kept(source: str, **fields: object) -> dict[str, object]:
        sys.modules.pop("of_user", None)
        (here / "of_user.py").write_text(source, encoding="utf-8")
        source_hash.cache_clear()
        return Policy.model_validate({"kind": "of_user:Outermost", **fields}).request()

    first, again = kept(MODULE), kept(MODULE)
    assert first == again
    assert first != kept(MODULE + "# more\n")
    assert first != kept(MODULE, settings={"turns": 1})
    assert "source" not in Policy().request()


def test_every_method_of_heft_is_what_others_must_be():
    for name, kind in METHODS.items():
        assert load_class(f"{kind.__module__}:{kind.__name__}", ESTIMATOR, name) is kind
        assert configured(kind, {}, name) == kind()


@pytest.mark.usefixtures("here")
def test_settings_of_a_policy_are_swept_side_by_side_with_the_kinds():
    axes = {"policy.kind": ["reversed_pairs", "of_user:Outermost"], "policy.settings": [{}, {"turns": 1}]}
    points = Scenario.model_validate({"objects": ["I1"], "sweep": {"mode": "zip", "axes": axes}}).points()
    assert [point.policy.settings for _, point in points] == [{}, {"turns": 1}]
    assert [axis_columns(at)["axis.policy.settings"] for at, _ in points] == ["none", "turns = 1"]


@pytest.mark.slow
def test_worker_processes_run_policies_and_methods_of_the_current_folder(here, capsys):
    kinds = ["reversed_pairs", "of_user:Outermost", "of_user:Endless", "of_user:Wrong"]
    (here / "s.toml").write_text(
        'objects = ["I1"]\n[policy]\npivots = 2\nduration = 2.0\naccelerated = 0\nheld_out = 0\ntouches = 3\n'
        f'[sweep.axes]\n"policy.kind" = {kinds}\n[methods.mine]\nmethod = "of_user:Even"\n',
        encoding="utf-8",
    )
    command = ("run", "s.toml", "--out", "out", "--workers", "1", "--methods", "mine", "of_user:Even")
    assert ended(*command) == 1  # one policy fails
    rows = load_results(here / "out").to_dict("records")
    run = {(row["axis.policy.kind"], row["method"]) for row in rows}
    assert run == set(product(kinds, ("mine", "of_user:Even"))) and len(rows) == len(run)
    good = [row for row in rows if row["axis.policy.kind"] != "of_user:Wrong"]
    assert all((row["status"], row["kind"]) == ("ok", "of_user:Even") and row["nad"] < 1e-3 for row in good)
    assert all("of_user:Wrong.next() ends in KeyError" in row["message"] for row in rows if row not in good)
    made = {}
    for row in good:
        kept = read_json(here / "out" / "estimates" / row["key"] / "result.json")
        made[row["axis.policy.kind"]] = Counter(kept["trial_keys"]).total() - 1 if kept else 0
    assert (made["of_user:Outermost"], made["of_user:Endless"]) == (2, 3) and made["reversed_pairs"] >= 2
    shown = capsys.readouterr()
    assert "report: out" in shown.out and "even as ever" not in shown.out + shown.err
    assert "as it is imported" in shown.err and "as it is imported" not in shown.out
    assert "even as ever" in (here / "out" / "notes" / "mine.log").read_text(encoding="utf-8")


class Meddler:
    """Estimator that changes what others in its process rely on, and ends in an error of two lines."""

    def estimate(self, shape, weight, trajectories, seed):
        os.chdir("/")
        os.environ["OMP_NUM_THREADS"] = "64"
        torch.set_default_dtype(torch.float16)
        np.seterr(all="raise")
        raise RuntimeError("no\nidea")


def test_a_method_leaves_its_process_as_it_was(monkeypatch):
    monkeypatch.setitem(METHODS, "meddler", Meddler)
    before = Path.cwd(), dict(os.environ), torch.get_default_dtype(), np.geterr()
    trials = load_block("I1-own_weight").trials("ideal")
    with pytest.raises(HeftError, match=r"RuntimeError: no idea \(tests/scenarios/test_plugins\.py, line \d+\)"):
        judged_answers("meddler", {}, load_object("I1").shape, [1.8], [trials], [0])
    assert (Path.cwd(), dict(os.environ), torch.get_default_dtype(), np.geterr()) == before


def test_arrays_of_an_object_stay_read_only_in_another_process():
    model = pickle.loads(pickle.dumps(load_object("shears")))
    for owner in (model, model.shape, model.shape.chain, model.shape.grasps[0], model.truth):
        for name, value in vars(owner).items():
            assert not (isinstance(value, np.ndarray) and value.flags.writeable), name
