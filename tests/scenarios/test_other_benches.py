"""Runners of somebody else's: the documentation's own bench in a scenario, and what is said of others."""

import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from scenarios import load_results, run_scenario
from scenarios.config import Scenario, Simulation, load_scenario
from scenarios.policies import Policy
from scenarios.runners import feasible_grasps
from scenarios.study.dry_run import check_code
from testbed import HeftError, InfeasibleTrialError, Slide, Trial, TrialRunner, load_object
from tests.helpers.pages import BLOCKS, EXAMPLES
from tests.helpers.runs import quiet

MORE = '''
from dataclasses import replace
import numpy as np
from own_simulator import DragSimulator
from testbed import InfeasibleTrialError, Phase, Slide, Weigh

class Measured(DragSimulator):
    """The same, said to be measured."""
    def run(self, trial):
        return replace(super().run(trial), provenance={"runner": "of mine"})

class Narrow(DragSimulator):
    """It reaches the first grasps only."""
    def check(self, trial):
        if trial.action.grasp > 1:
            raise InfeasibleTrialError("reach: too far")

class Stiff(DragSimulator):
    """It turns one way only, and says so too late."""
    def run(self, trial):
        if getattr(trial.action, "speed", 0) > 0:
            raise InfeasibleTrialError("joints: not that way")
        return super().run(trial)

class Bare:
    """No more than it must have."""
    def __enter__(self):
        return self
    def __exit__(self, kind, error, trace):
        pass
    def run(self, trial):
        record = DragSimulator().run(trial)
        return record if not trial.action.moves else replace(record, tool=None)

class Untared(Bare):
    def run(self, trial):
        record = DragSimulator().run(trial)
        moves = record.phase > Phase.TARE
        return replace(record, phase=np.where(moves, record.phase, Phase.APPROACH)) if trial.action.moves else record

class Another(Bare):
    def run(self, trial):
        record = DragSimulator().run(trial)
        return replace(record, action=Slide(0, 0.5)) if trial.action.moves else record

class Words(Bare):
    def run(self, trial):
        return "it went well"

class Open:
    def run(self, trial):
        raise NotImplementedError
'''
SHORT = {"pivots": 3, "duration": 2.0, "accelerated": 2, "held_out": 1}


@pytest.fixture
def here(as_user) -> Path:
    """A user's folder with the documentation's own code."""
    (estimator,) = (block.text for block in BLOCKS if block.title == "my_estimator.py")
    examples = {name: (EXAMPLES / f"{name}.py").read_text("utf-8") for name in ("own_policy", "own_simulator")}
    return as_user(my_estimator=estimator, more=MORE, **examples)


def ran(folder: Path, out: str, runner: str, **fields: Any) -> list[dict[str, Any]]:
    asked = {"objects": ["L2"], "simulation": {"runner": runner}, "policy": SHORT} | fields
    run_scenario(Scenario.model_validate(asked), folder / out, 0, quiet)
    return load_results(folder / out).to_dict("records")  # pyright: ignore[reportReturnType]


@pytest.mark.slow
def test_the_bench_of_the_documentation_with_its_policy_gives_the_truth_back(here):
    policy = SHORT | {"kind": "own_policy:FarthestFirst", "touches": 5, "settings": {"turns": 4, "duration": 2.0}}
    (row,) = ran(here, "out", "own_simulator:DragSimulator", policy=policy)
    assert row["status"] == "ok", row["message"]
    assert row["nad"] < 2e-3
    made = {path.parent.name for path in here.glob("out/trials/*/trial.json")}
    assert len(made) == 1 + 5 + 1
    (here / "own_simulator.py").write_text((here / "own_simulator.py").read_text() + "# more\n", encoding="utf-8")
    del sys.modules["own_simulator"]
    ran(here, "out", "own_simulator:DragSimulator", policy=policy)
    assert len({*here.glob("out/trials/*/trial.json")}) == 2 * len(made), "another source makes trials of its own"


@pytest.mark.slow
def test_a_sensors_errors_are_drawn_on_what_is_simulated_and_on_nothing_else(here):
    drawn = ran(here, "drawn", "own_simulator:DragSimulator", sensing=["ft300s"], seeds=2)
    measured = ran(here, "measured", "more:Measured", sensing=["ft300s"], seeds=2)
    assert drawn[0]["nad"] != drawn[1]["nad"]
    assert measured[0]["nad"] == measured[1]["nad"] < 2e-3


@pytest.mark.usefixtures("here")
def test_a_runners_own_check_says_which_grasps_can_be_used():
    l2 = load_object("L2")
    runners = {name: Simulation(runner=f"more:{name}").build() for name in ("Narrow", "Bare", "Measured")}
    checks = {name: Policy().check(l2, runner, "s") for name, runner in runners.items()}
    grasps = {name: feasible_grasps("L2", check) for name, check in checks.items()}
    assert grasps["Narrow"] == (0, 1)
    assert grasps["Bare"] == grasps["Measured"] == tuple(range(len(l2.shape.grasps)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["greedy", "batch", "random", "online"])
def test_what_the_bench_refuses_when_it_is_run_is_chosen_around(here, kind):
    policy = {"kind": kind, "touches": 3, "candidates": 120, "held_out": 0, "assumed_support": "own_weight"}
    (row,) = ran(here, "out", "more:Stiff", policy=policy, sensing=["ft300s"], seeds=1)
    assert row["status"] == "ok", row["message"]
    said = [json.loads(path.read_text())["asked"]["action"] for path in here.glob("out/trials/*/trial.json")]
    turns = [action for action in said if action["kind"] == "rotate"]
    assert len(said) == 4 and turns and all(action["speed"] < 0 for action in turns)
    assert not [*here.glob("out/trials/*/error.txt")]
    before = sorted(path.stat().st_mtime_ns for path in here.glob("out/trials/*/*"))
    ran(here, "out", "more:Stiff", policy=policy, sensing=["ft300s"], seeds=1)
    assert sorted(path.stat().st_mtime_ns for path in here.glob("out/trials/*/*")) == before


def test_an_object_that_is_refused_about_every_grasp_fails_with_the_first_reason(here):
    (row,) = ran(here, "out", "more:Stiff")
    said = "policy: the bench refused an action about every grasp; rotate: joints: not that way"
    assert row["status"] == "failed" and row["message"] == said


@pytest.mark.parametrize(
    ("runner", "message"),
    [
        ("more:Words", r"weigh: more:Words.run\(\): got 'it went well'; allowed: a Trajectory"),
        ("more:Bare", r"accelerate: more:Bare.run\(\).tool: got None; allowed: the Tool below"),
        ("more:Untared", r"accelerate: more:Untared.run\(\).phase: got 'no sample of TARE'; allowed: a tare before"),
        ("more:Another", r"accelerate: more:Another.run\(\).action: got .*; allowed: the trial's own: "),
    ],
)
def test_what_cannot_be_used_fails_in_words(here, runner, message):
    (row,) = ran(here, "out", runner)
    assert row["status"] == "failed"
    assert re.search(message, row["message"])


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("simulation", "message"),
    [
        ('runner = "more:Open"', r"simulation.runner: got 'more:Open'; .*__enter__\(self\) and __exit__.*no __enter__"),
        ('runner = "more:Naro"', r"a class of more: .*nearest: Narrow"),
        ('runner = "drag"', r"simulation.runner: got 'drag'; allowed: package:Class"),
        ('runner = "own_simulator:DragSimulator"\nsettings = {tar = 1}', r"settings: got 'tar'; .*nearest: tare"),
        ('runner = "own_simulator:DragSimulator"\ngrip = "weld"', r"settings of its own in place of grip"),
        ("settings = {tare = 1}", r"settings are for a runner"),
    ],
)
def test_what_is_wrong_is_said_before_anything_runs(simulation, message, tmp_path):
    file = tmp_path / "s.toml"
    file.write_text(f'objects = ["I1"]\n[simulation]\n{simulation}\n', encoding="utf-8")
    with pytest.raises(HeftError, match=message):
        check_code(load_scenario(str(file))[1])


@pytest.mark.usefixtures("here")
def test_an_entry_point_is_a_runner_by_name(install):
    install(runners="drag = own_simulator:DragSimulator")
    bench: Any = Simulation(runner="drag", settings={"tare": 3.0}).build()
    assert isinstance(bench.open(), TrialRunner)
    assert bench.open().tare == 3.0
    with pytest.raises(InfeasibleTrialError, match="weighs and turns"):
        bench.check(Trial(load_object("L2"), Slide(0)))


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["local", "ray"])
def test_workers_find_the_runner_the_policy_and_the_estimator_in_the_current_folder(here, executor):
    if executor == "ray":
        pytest.importorskip("ray", reason="Ray is not installed: pip install 'heft-testbed[ray]'")
    asked = {
        "objects": ["L2"],
        "simulation": {"runner": "own_simulator:DragSimulator"},
        "policy": SHORT | {"kind": "own_policy:FarthestFirst", "settings": {"turns": 4, "duration": 2.0}},
        "methods": {"mine": {"method": "my_estimator:LeastSquares"}},
    }
    run_scenario(Scenario.model_validate(asked), here / "out", 1, quiet, executor)
    (row,) = load_results(here / "out").to_dict("records")
    assert (row["status"], row["kind"]) == ("ok", "my_estimator:LeastSquares"), row["message"]
    assert row["nad"] < 0.02
