"""Scenario files: random objects, swept axes, changed truths, and a thousand broken files."""

import copy
import json
import random
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.catalog import LIBRARY, scenario_names
from scenarios.config import Scenario, Truth, load_scenario
from testbed import HeftError, InvalidValueError, load_object
from testbed.objects.random import Family
from testbed.toml import InvalidFileError


def test_every_library_scenario_loads_at_every_point():
    assert {"blocks", "paper", "noise", "support", "resolution", "friction", "random"} <= set(scenario_names())
    for name in scenario_names():
        _, scenario = load_scenario(name)
        for axes, point in scenario.points():
            assert set(axes) == set(scenario.sweep.axes)
            assert point.supports()


@pytest.mark.parametrize(
    ("mode", "expected"), [("grid", [(2, 4), (2, 5), (3, 4), (3, 5)]), ("zip", [(2, 4), (3, 5)]), (None, [(3, None)])]
)
def test_axes_are_combined_or_go_side_by_side(mode, expected):
    sweep = {"mode": mode, "axes": {"grid.feet": [2, 3], "policy.pivots": [4, 5]}} if mode else {}
    points = Scenario.model_validate({"objects": ["I1"], "sweep": sweep}).points()
    assert [(p.grid.feet, p.policy.pivots) for _, p in points] == expected
    assert [tuple(axes.values()) for axes, _ in points] == (expected if mode else [()])


def test_a_field_of_one_of_the_swept_policies_and_a_methods_setting_can_be_swept():
    axes = {"policy.kind": ["reversed_pairs", "greedy"], "policy.touches": [2, 3]}
    assert len(Scenario.model_validate({"objects": ["I1"], "sweep": {"axes": axes}}).points()) == 4
    sweep = {"axes": {"methods.weighted_sampling.decay": [0.5, 0.9]}}
    scenario = Scenario.model_validate({"objects": ["I1"], "methods": {"weighted_sampling": {}}, "sweep": sweep})
    assert [p.methods["weighted_sampling"]["decay"] for _, p in scenario.points()] == [0.5, 0.9]


@pytest.mark.parametrize(
    ("axis", "values", "option", "value"),
    [
        ("world.preset", ["ideal", "lab"], "world", "rough"),
        ("seeds", [1, 2], "seeds", 3),
        ("objects", [["L1"], ["L2"]], "objects", ["F1"]),
        ("random", [[{"name": "a", "count": 2}]], "objects", ["F1"]),
        ("methods", [{"bayes": {}}], "methods", ["bayes"]),
    ],
)
def test_an_option_of_a_swept_field_is_refused(axis, values, option, value):
    scenario = Scenario.model_validate({"objects": ["I1"], "sweep": {"axes": {axis: values}}})
    with pytest.raises(InvalidValueError, match=rf"--{option}: got .*; allowed: none: \[sweep\] sets {axis} "):
        scenario.changed(**{option: value})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sensing": ["best"]}, "sensing.*got 'best'; allowed: one of ideal, ft300s"),
        ({"support": ["soft"]}, "support.*got 'soft'; allowed: .*rigid"),
        ({"seeds": 0}, "seeds: got 0; allowed: greater than or equal to 1"),
        ({"seeds": "3"}, "seeds: got '3'; allowed: a valid integer"),
        ({"random": [{"name": "a", "count": "2"}]}, "random.0.count: got '2'; allowed: a valid integer"),
        ({"color": 1}, "color: no such field"),
        ({"methods": {"magic": {}}}, "methods: got 'magic'; allowed: one of hidden_states"),
        ({"methods": {"hidden_states": {"steps": 0}}}, "steps: got 0; allowed: an integer >= 1"),
        ({"methods": {"hidden_states": {"speed": 1}}}, "got 'speed'; allowed: settings method, .*solver"),
        ({"policy": {"pivots": 0}}, "policy.pivots: got 0"),
        ({"grid": {"feet": 0}}, "grid.feet: got 0"),
        ({"sweep": {"axes": {"grid.feets": [1]}}}, "grid.feets"),
        ({"sweep": {"axes": {"grid.feet": [0]}}}, "grid.feet: got 0"),
        ({"sweep": {"axes": {"grid.feet": []}}}, "grid.feet"),
        ({"sweep": {"mode": "zip", "axes": {"grid.feet": [1, 2], "seeds": [1]}}}, "equally many"),
        ({"sweep": {"axes": {"policy.touches": [2, 3]}}}, "policy.touches.*reversed_pairs uses: policy.pivots.*most"),
        ({"policy": {"kind": "greedy"}, "sweep": {"axes": {"policy.most": [2, 3]}}}, "policy.most.*policy.touches"),
        ({"sensing": "ft300s"}, "sensing: got 'ft300s'; allowed: a list: .*ft300s"),
        ({"grid": 3}, r"grid: got 3; allowed: a table: \[grid\]"),
        ({"sweep": {"mode": "both"}}, "mode"),
        ({"sweep": {"axes": {"sweep.mode": ["zip"]}}}, "sweep.mode"),
        ({"sweep": {"axes": {"seeds.more": [1]}}}, "seeds.more"),
        ({"sweep": {"axes": {"support": [["soft"]]}}}, "soft"),
        ({"policy": {"kind": "drag", "pushes": 4}}, "none with drag: after turns by rank, or in a plan"),
        ({"world": {"preset": "labb"}}, "world.*labb"),
        ({"world": {"gian": 0.1}}, "world.*gian"),
        ({"world": {"gain": -1.0}}, "world.*gain"),
        ({"world": {"gain": "much"}}, "world.*gain"),
        ({"world": {"name": "x"}}, "world.*name"),
        (
            {"world": {"preset": "lab"}, "simulation": {"runner": "testbed.simulation.runner:SimulationRunner"}},
            "another runner",
        ),
        ("objects = [", "cannot be read as TOML"),
        ("\x00", "cannot be read as TOML"),
        ("[a]\n[a]", "cannot be read as TOML"),
        ("seed = 2", r"seed: no such field; got 2 \(nearest: seeds\)"),
        ("7 = 1.0", r"7: no such field; got 1\.0"),
        ("[policy]\nseeds = 2", r"policy\.seeds: no such field; got 2 \(nearest: seed\)"),
        ("[grid]\nfeets = 2", r"grid\.feets: no such field; got 2 \(nearest: feet\)"),
        ('[[random]]\nname = "a"\nmass = 2', r"random\.0\.mass: no such field; got 2 \(nearest: mass_kg\)"),
    ],
)
def test_a_wrong_scenario_is_refused_with_its_field(tmp_path, change, message):
    path = tmp_path / "s.toml"
    path.write_text(change if isinstance(change, str) else toml_of({"objects": ["I1"]} | change))
    with pytest.raises(InvalidFileError, match=message) as error:
        load_scenario(str(path))
    assert str(path) in str(error.value)


def test_an_unknown_scenario_is_refused():
    with pytest.raises(InvalidValueError, match=r"one of ablation, articulated, blocks.*nearest: blocks"):
        load_scenario("bloks")


def test_a_family_is_the_same_for_the_same_seed_and_joined_edge_to_edge():
    family = Family(count=40, seed=3, blocks=[2, 9], mass_kg=[0.1, 0.3], friction=[0.2, 0.4])
    objects = [family.draw(i, 0) for i in range(40)]
    assert objects == [family.draw(i, 0) for i in range(40)]
    assert family.draw(0, 0) != family.draw(0, 1)
    assert objects != [family.model_copy(update={"seed": 4}).draw(i, 0) for i in range(40)]
    assert len({o.name for o in objects}) == 40
    counts = [o.build(1, Path()).shape.n_m for o in objects]  # building checks that blocks are joined
    assert (min(counts), max(counts)) == (2, 9)
    for file in objects:
        assert file.blocks is not None and file.blocks.mass_kg is not None
        assert set(np.atleast_1d(file.blocks.mass_kg)) <= {0.1, 0.3}
        assert 0.2 <= float(np.atleast_1d(file.blocks.friction)[0]) <= 0.4
    on_feet = family.model_copy(update={"feet_m": [[-0.02, -0.02], [0.02, -0.02], [0.0, 0.02]]}).draw(0, 0)
    assert on_feet.blocks == objects[0].blocks
    shape = on_feet.build(3, Path()).shape
    assert len(shape.feet) == 3 * shape.n_m
    more = family.model_copy(update={"count": 41})
    assert more.draw(7, 0) == family.draw(7, 0), "a larger family begins with the smaller one"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"blocks": [5, 3]}, "blocks"),
        ({"blocks": [0, 3]}, "blocks"),
        ({"blocks": [1, 65]}, "64"),
        ({"friction": [0.5, 0.2]}, "friction"),
        ({"mass_kg": []}, "mass_kg"),
        ({"mass_kg": [-1.0]}, "mass_kg"),
        ({"count": 0}, "count"),
        ({"name": "a/b"}, "name"),
    ],
)
def test_a_wrong_family_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        Family(**({"count": 3} | change))


def test_another_truth_changes_friction_and_nothing_else():
    model = load_object("hammer")
    other = Truth(friction=0.7).applied(model, "s")
    assert other.truth.friction.tolist() == [0.7, 0.7]
    assert other.shape is model.shape
    spread = Truth(friction_spread=0.2, seed=1).applied(load_object("L2"), "s")
    assert spread.shape.n_mu == 6
    assert spread.group_mass.tolist() == load_object("L2").group_mass.tolist()
    assert 0.02 < np.std(np.log(spread.truth.friction / 0.5)) < 0.5
    again = Truth(friction_spread=0.2, seed=1).applied(load_object("L2"), "s")
    assert (again.truth.friction == spread.truth.friction).all()
    other = Truth(friction_spread=0.2, seed=1).applied(load_object("L2"), "another")
    assert (other.truth.friction != spread.truth.friction).all()
    contact = model.shape.friction_group >= 0
    assert ((Truth(friction_spread=0.1).applied(model, "s").shape.friction_group >= 0) == contact).all()


WILD: tuple[Any, ...] = (
    *(True, -1, 0, 1e9, float("inf"), -0.5, "", "I1", "x" * 300, "../../etc", "é\n"),
    *([], [[]], {}, {"a": 1}, ["I1", 3], [float("nan")]),
)


def toml_of(value: Any, *, top: bool = True) -> str:
    """Any data as TOML, tables inline."""
    if isinstance(value, dict):
        parts = [f"{json.dumps(key)} = {toml_of(inner, top=False)}" for key, inner in value.items()]
        return "\n".join(parts) if top else "{" + ", ".join(parts) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(toml_of(inner, top=False) for inner in value) + "]"
    return str(value) if isinstance(value, float) else json.dumps(value)


def mutated(scenario: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """The scenario with one to three things broken, somewhere."""
    data = copy.deepcopy(scenario)
    for _ in range(rng.randint(1, 3)):
        place: Any = data
        while True:
            keys = list(place) if isinstance(place, dict) else list(range(len(place)))
            if not keys:
                break
            key = rng.choice(keys)
            if isinstance(place[key], dict | list) and rng.random() < 0.6:
                place = place[key]
                continue
            what = rng.randrange(4)
            if what == 0:
                place[key] = copy.deepcopy(rng.choice(WILD))
            elif what == 1:
                del place[key]
            elif isinstance(place, dict):
                word = "".join(rng.sample(str(key), len(str(key)))) if what == 2 else f"{key}{rng.choice('sx_ ')}"
                place[word] = place.pop(key)
            else:
                place.append(copy.deepcopy(rng.choice(WILD)))
            break
    return data


@pytest.mark.slow
def test_a_thousand_broken_files_are_run_or_refused_with_their_field(tmp_path):
    rng = random.Random(0)
    sources = [tomllib.loads(p.read_text()) for p in sorted(LIBRARY.glob("*.toml"))]
    sources.append({"objects": ["I1"], "truth": {"friction": 0.3}, "simulation": {"grip": "weld"}, "grid": {"feet": 2}})
    path, refused = tmp_path / "broken.toml", 0
    for _ in range(1000):
        data = mutated(rng.choice(sources), rng)
        path.write_text(toml_of(data), encoding="utf-8")
        try:
            _, scenario = load_scenario(str(path))
            scenario.points()
        except HeftError as error:
            refused += 1
            text = str(error)
            assert str(path) in text, text
            assert "Traceback" not in text
            assert "allowed" in text or "no such field" in text or "missing" in text or "TOML" in text, text
    assert 300 < refused < 1000


def test_objects_are_looked_up_beside_the_scenario(tmp_path, monkeypatch):
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "pair.toml").write_text('name = "pair"\n[blocks]\nlayout = ["11"]\nmass_kg = 0.2\n')
    (tmp_path / "deep" / "s.toml").write_text('objects = ["pair.toml", "I1", "elsewhere.toml"]\n')
    monkeypatch.chdir(tmp_path)
    _, scenario = load_scenario("deep/s.toml")
    assert scenario.objects == ["deep/pair.toml", "I1", "elsewhere.toml"]
    assert load_object(scenario.objects[0]).name == "pair"
    (tmp_path / "pair.toml").write_text('name = "other"\n[blocks]\nlayout = ["1"]\nmass_kg = 0.2\n')
    assert load_object(load_scenario("deep/s.toml")[1].objects[0]).name == "pair", "beside the scenario comes first"
    (tmp_path / "deep" / "pair.toml").unlink()
    assert load_object(load_scenario("deep/s.toml")[1].objects[0]).name == "other", "then the current folder"
