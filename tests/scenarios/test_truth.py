"""No truth within reach of what `estimate` and `next` are given in a run."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from secrets import token_hex
from typing import Any

import numpy as np
import pytest

from estimators.testing.truth import MOST_INTEGERS, truth_within_reach
from scenarios.config import Scenario, WorldTable, load_scenario
from scenarios.policies import Policy
from scenarios.results.store import Store
from scenarios.runners import feasible_grasps, redacted
from scenarios.study.run import check_nothing_lost, run_scenario
from testbed import Rotate, SimulationRunner, Trajectory, Trial, WorldDraw, draw_sensing, load_object, preset, world
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectModel
from testbed.simulation.settings import SimulationSettings
from testbed.worlds import seeds
from tests.helpers.runs import quiet, small_scenario

SPIES = """
from estimators.base import Estimate
from testbed.actions.accelerate import Accelerate
from testbed.actions.rotate import Rotate

given = []


class Spy:
    def estimate(self, shape, weight, trajectories, seed):
        given.append(("estimate", dict(shape=shape, weight=weight, trajectories=list(trajectories), seed=seed)))
        return Estimate(None, "no_data", "a spy answers nothing")


class Chooser:
    def __init__(self, weight_kg, grasps, feasible):
        given.append(("policy", dict(weight_kg=weight_kg, grasps=grasps, feasible=feasible)))

    def next(self, shape, trajectories):
        given.append(("next", dict(shape=shape, trajectories=list(trajectories))))
        actions = (Rotate(2, duration=2.0), Accelerate(2), Rotate(3, duration=2.0))
        return actions[len(trajectories)] if len(trajectories) < len(actions) else None
"""

GUESSER = """
import hashlib
from dataclasses import replace
from itertools import product

import numpy as np

from estimators.base import Estimate
from scenarios.results.store import key_of, trial_request
from testbed.objects.model import MassDistribution, ObjectModel
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import preset
from testbed.simulation.settings import GripSettings, SimulationSettings
from testbed.trajectory import Phase
from testbed.trial import Trial

SETTINGS = SimulationSettings(timestep=0.002, grip=GripSettings(mode="weld"))


class Guesser:
    def __init__(self, secret=""):
        self.secret = secret

    def estimate(self, shape, weight, trajectories, seed):
        for masses in product((0.1, 0.4), repeat=len(shape.group_names)):
            guess = MassDistribution(np.array(masses) / shape.particles_per_group, np.array([0.35]))
            model = ObjectModel("guess", shape, guess)
            if all(self.cancels(model, t, index, seed) for index, t in enumerate(trajectories, start=1)):
                return Estimate(guess, "ok", "")
        even = np.full(shape.n_m, weight / len(shape.particles))
        return Estimate(MassDistribution(even, np.array([0.35])), "ok", "")

    def cancels(self, model, seen, index, seed):
        key = key_of(trial_request(Trial(model, seen.action), SETTINGS))
        text = "/".join(map(str, [self.secret, seed, index, key] if self.secret else [seed, index, key]))
        drawn_by = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
        clean = {"runner": "simulation"}
        silent = replace(seen, sensor_wrench=np.zeros_like(seen.sensor_wrench), provenance=clean)
        left = seen.sensor_wrench - draw_sensing(silent, preset("ft300s"), drawn_by).sensor_wrench
        return bool(np.ptp(left[seen.mask(Phase.TARE)], axis=0).max() < 1e-6)
"""


@pytest.fixture(scope="module")
def spied(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, list[tuple[str, dict[str, Any]]]]]:
    """Results folder of a run, and all that a method and a policy of another package were given in it."""
    with spying(tmp_path_factory.mktemp("spied")) as found:
        yield found


@contextmanager
def spying(folder: Path, preset: str = "ideal") -> Iterator[tuple[Path, list[tuple[str, dict[str, Any]]]]]:
    """Run a short scenario in a world, and keep what was given."""
    sys.modules.pop("spies", None)
    (folder / "spies.py").write_text(SPIES, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        patch.chdir(folder)
        scenario = Scenario(
            objects=["L2"],
            support=["rigid"],
            sensing=["ft300s"],
            seeds=2,
            policy=Policy(kind="spies:Chooser", touches=3, held_out=0),
            methods={"spy": {"method": "spies:Spy"}},
            world=WorldTable(preset=preset),
        )
        run_scenario(scenario, folder / "out", 0, quiet, executor="inline")
        given = sys.modules["spies"].given
        first = next(i for i, (kind, _) in enumerate(given) if kind == "next") - 1
        yield folder / "out", given[first:]
    sys.modules.pop("spies", None)


def clean_trials(out: Path, trajectories: list[Trajectory]) -> list[Trajectory]:
    """Stored records of a perfect sensor, by their actions."""
    store = Store(out)
    stored = [store.trajectory(path.parent.name) for path in sorted(out.glob("trials/*/trial.json"))]
    return [next(t for t in stored if t.action == seen.action) for seen in trajectories]


@pytest.mark.slow
def test_what_a_method_and_a_policy_are_given_does_not_lead_to_the_truth(spied):
    out, given = spied
    assert [kind for kind, _ in given].count("estimate") == 2
    assert [kind for kind, _ in given].count("next") == 3
    for kind, parts in given:
        clean = clean_trials(out, parts.get("trajectories", []))
        checked = {name: part for name, part in parts.items() if name != "feasible"}
        assert truth_within_reach(checked, load_object("L2"), clean) == [], kind
        assert all(
            np.abs(t.sensor_wrench - c.sensor_wrench).max() > 0.1
            for t, c in zip(parts.get("trajectories", []), clean, strict=True)
        )


@pytest.mark.slow
def test_what_they_are_given_in_a_lab_does_not_lead_to_its_draw(tmp_path: Path):
    with spying(tmp_path, "lab") as (out, given):
        stored = [Store(out).trajectory(path.parent.name) for path in out.glob("trials/*/trial.json")]
        draws = {draw for t in stored if (draw := WorldDraw.in_record(t.provenance))}
        assert len(draws) == 2
        assert [kind for kind, _ in given].count("estimate") == 2
        for kind, parts in given:
            checked = {name: part for name, part in parts.items() if name != "feasible"}
            for draw in draws if kind == "estimate" else ():  # neither of them, whichever it was
                of_draw = [t for t in stored if WorldDraw.in_record(t.provenance) == draw]
                clean = [next(t for t in of_draw if t.action == s.action) for s in parts.get("trajectories", [])]
                assert truth_within_reach(checked, load_object("L2"), [*clean, of_draw[0]]) == [], kind
            assert all(t.setup == world("lab").stated for t in parts.get("trajectories", []))


@pytest.mark.slow
def test_a_policy_receives_the_reading_of_the_scale(spied):
    _, given = spied
    given_policy = next(parts for kind, parts in given if kind == "policy")
    true = load_object("L2").total_mass
    assert 0 < abs(given_policy["weight_kg"] - true) < 0.005
    assert given_policy["feasible"].guess.weight == given_policy["weight_kg"]
    assert given_policy["feasible"].guess.sensing == preset("ft300s")
    readings = [parts["weight"] for kind, parts in given if kind == "estimate"]
    assert given_policy["weight_kg"] == readings[0] != readings[1]  # the draw that the policy sees is the first


@pytest.mark.slow
def test_the_search_finds_what_a_record_once_carried(spied):
    """The provenance of a draw as it was: its support, its sensor and its seed."""
    out, given = spied
    parts = next(parts for kind, parts in given if kind == "estimate")
    clean = clean_trials(out, parts["trajectories"])
    leaky = []
    for index, record in enumerate(clean):
        drawn = draw_sensing(record, preset("ft300s"), 1234567 + index)
        said = record.provenance | {"sensing": "ft300s", "sensing_seed": str(1234567 + index)}
        leaky.append(replace(drawn, provenance=said, figures=record.figures))
    found = truth_within_reach({**parts, "weight": 1.8, "trajectories": leaky}, load_object("L2"), clean)
    for said in (
        "['support'] is given",
        "says 'rigid'",
        "says 'ft300s'",
        "['sensing_seed'] is given",
        "figures is given",
        "weight holds a true mass",
        "seed 1234567 of ft300s gives the clean wrench back",
    ):
        assert any(said in line for line in found), (said, found)


def heavy_end(model: ObjectModel) -> ObjectModel:
    """Another object of the same shape and weight: its first block has nearly all of it."""
    each = model.shape.particles_per_group
    mass = np.full(len(each), 0.01)
    mass[0] = model.total_mass - mass[1:].sum()
    return replace(model, truth=MassDistribution(mass / each, np.full(model.shape.n_mu, 1.0)), solids=())


def test_grasps_and_checks_do_not_know_masses_and_friction():
    model, settings, policy = load_object("I2"), SimulationSettings(), Policy()
    one, other = (feasible_grasps(m.name, policy.check(m, settings, "s")) for m in (model, heavy_end(model)))
    assert one == other == tuple(range(6))
    reading = policy.check(model, settings, "s").guess.weight
    assert 0 < abs(reading - model.total_mass) < 0.005
    strong = Policy(most_friction=1.0)
    assert len(feasible_grasps("I2", strong.check(model, settings, "s"))) < 6


@pytest.mark.slow
def test_a_refusal_at_the_true_masses_has_no_numbers_and_is_avoided(tmp_path):
    path = tmp_path / "end.toml"
    path.write_text(
        'name = "end"\n[blocks]\nlayout = ["111111"]\nmass_kg = [1.75, 0.01, 0.01, 0.01, 0.01, 0.01]\nfriction = 1.0\n'
    )
    scenario = Scenario(objects=[str(path)], policy=Policy(pivots=2, accelerated=2, duration=2.0, held_out=2))
    row = run_scenario(scenario, tmp_path / "out", 0, quiet, executor="inline").iloc[0]
    assert row["status"] != "failed", row["message"]
    grasps = [
        json.loads(path.read_text())["asked"]["action"].get("grasp") for path in tmp_path.glob("out/trials/*/*.json")
    ]
    assert len(grasps) >= 1 + 2 + 2 and {*grasps} <= {None, 0, 1, 2}
    assert redacted("grip: drag of up to 26.49 N at block A") == "grip: refused by the bench"


@pytest.mark.slow
def test_a_guessed_map_does_not_repeat_the_noise_of_its_trials(tmp_path: Path, monkeypatch):
    """An estimator that knows that blocks weigh 0.1 or 0.4 kg tries every map, and the noise that it would have."""
    (tmp_path / "guesser.py").write_text(GUESSER, encoding="utf-8")
    (tmp_path / "pair.toml").write_text(
        'name = "pair"\n[blocks]\nlayout = ["11"]\nmass_kg = [0.4, 0.1]\nfriction = 0.35\n', encoding="utf-8"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(seeds, "token_hex", lambda _: "a run's own")
    guesser = {"method": "guesser:Guesser"}
    scenario = Scenario.model_validate(
        {
            "objects": [str(tmp_path / "pair.toml")],
            "support": ["own_weight"],
            "sensing": ["ft300s"],
            "seeds": 2,
            "grid": {"feet": 2, "particles": 2},
            "simulation": {"grip": "weld", "timestep_s": 0.002},
            "policy": {"pivots": 1, "duration": 1.6, "accelerated": 0, "held_out": 0},
            "methods": {"blind": guesser, "told": guesser | {"secret": "a run's own"}},
        }
    )
    rows = run_scenario(scenario, tmp_path / "out", 0, quiet, executor="inline")
    sys.modules.pop("guesser", None)
    nad = {method: of_method["nad"].tolist() for method, of_method in rows.groupby("method")}
    assert nad == {"blind": pytest.approx([0.6, 0.6], abs=0.01), "told": [0.0, 0.0]}


@pytest.mark.slow
def test_no_small_seed_of_a_script_repeats_its_noise():
    trial = Trial(load_object("I2"), Rotate(2, duration=1.6), sensing="ft300s", seed=3)
    runner = SimulationRunner(SimulationSettings(timestep=0.002), secret=token_hex(16))
    clean, seen = runner.run_clean(trial), runner.run(trial)
    given = {"trajectories": [seen.blinded()], "guesses": np.arange(MOST_INTEGERS)}
    assert truth_within_reach(given, trial.object, [clean]) == []
    again = replace(runner, secret=token_hex(16)).run(trial)
    assert np.abs(again.sensor_wrench - seen.sensor_wrench).max() > 0.1
    assert np.array_equal(runner.run(trial).sensor_wrench, seen.sensor_wrench)


@pytest.mark.slow
def test_every_run_has_a_secret_of_its_own_and_keeps_it(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(seeds, "token_hex", token_hex)
    scenario = load_scenario(str(small_scenario(tmp_path, ("own_weight",), "[methods.hidden_states]\n")))[1]
    first, other = (run_scenario(scenario, tmp_path / name, 0, quiet, executor="inline") for name in ("a", "b"))
    drawn = [rows[rows["sensing"] == "ft300s"]["nad"].to_numpy() for rows in (first, other)]
    assert (drawn[0] != drawn[1]).all()
    again = run_scenario(scenario, tmp_path / "a", 0, quiet, executor="inline")
    assert again["key"].tolist() == first["key"].tolist()
    secret = Store(tmp_path / "a").secret
    assert len(secret) == 32 and secret != Store(tmp_path / "b").secret
    repeated = run_scenario(scenario, tmp_path / "c", 0, quiet, executor="inline", secret=secret)
    assert repeated["nad"].tolist() == first["nad"].tolist() and repeated["key"].tolist() == first["key"].tolist()
    check_nothing_lost(tmp_path / "a", scenario, secret)
    for wrong in ("other", " "):
        with pytest.raises(InvalidValueError, match="secret"):
            check_nothing_lost(tmp_path / "a", scenario, wrong)
