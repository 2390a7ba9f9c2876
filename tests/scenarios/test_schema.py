"""Scenario files: drawn objects, swept axes, changed truths; a thousand broken files, each refused in its own words."""

from __future__ import annotations

import copy
import json
import random
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.config import LIBRARY, Scenario, Truth, load_scenario, scenario_names
from testbed.errors import HeftError, InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.random import Family
from testbed.toml import InvalidFileError


def test_every_library_scenario_loads_at_every_point():
    assert {"blocks", "paper", "noise", "support", "resolution", "friction", "random"} <= set(scenario_names())
    for name in scenario_names():
        _, scenario = load_scenario(name)
        for axes, point in scenario.points():
            assert set(axes) == set(scenario.sweep.axes)
            assert point.supports()


def test_axes_are_combined_or_go_side_by_side():
    axes = {"grid.feet": [2, 3], "policy.pivots": [4, 5]}
    crossed = Scenario.model_validate({"objects": ["I1"], "sweep": {"axes": axes}}).points()
    assert [tuple(a.values()) for a, _ in crossed] == [(2, 4), (2, 5), (3, 4), (3, 5)]
    assert [(p.grid.feet, p.policy.pivots) for _, p in crossed] == [(2, 4), (2, 5), (3, 4), (3, 5)]
    zipped = Scenario.model_validate({"objects": ["I1"], "sweep": {"mode": "zip", "axes": axes}}).points()
    assert [(p.grid.feet, p.policy.pivots) for _, p in zipped] == [(2, 4), (3, 5)]
    alone = Scenario(objects=["I1"]).points()
    assert len(alone) == 1
    assert alone[0][0] == {}


def test_a_methods_setting_can_be_swept():
    axes = {"methods.weighted_sampling.decay": [0.5, 0.9]}
    scenario = Scenario.model_validate(
        {"objects": ["I1"], "methods": {"weighted_sampling": {}}, "sweep": {"axes": axes}}
    )
    assert [p.methods["weighted_sampling"]["decay"] for _, p in scenario.points()] == [0.5, 0.9]


@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        ({"axes": {"grid.feets": [1]}}, "grid.feets"),
        ({"axes": {"grid.feet": [0]}}, "grid.feet: got 0"),
        ({"axes": {"grid.feet": []}}, "grid.feet"),
        ({"mode": "zip", "axes": {"grid.feet": [1, 2], "seeds": [1]}}, "equally many"),
        ({"mode": "both"}, "mode"),
        ({"axes": {"sweep.mode": ["zip"]}}, "sweep.mode"),
        ({"axes": {"seeds.more": [1]}}, "seeds.more"),
        ({"axes": {"support": [["soft"]]}}, "soft"),
    ],
)
def test_a_wrong_axis_is_refused(tmp_path, sweep, message):
    path = tmp_path / "s.toml"
    path.write_text(toml_of({"objects": ["I1"], "sweep": sweep}))
    with pytest.raises(InvalidFileError, match=message):
        load_scenario(str(path))


def test_a_family_is_the_same_for_the_same_seed_and_joined_edge_to_edge():
    family = Family(count=40, seed=3, blocks=[2, 9], mass_kg=[0.1, 0.3], friction=[0.2, 0.4])
    objects = [family.draw(i, 0) for i in range(40)]
    assert objects == [family.draw(i, 0) for i in range(40)]
    assert family.draw(0, 0) != family.draw(0, 1)
    assert objects != [family.model_copy(update={"seed": 4}).draw(i, 0) for i in range(40)]
    assert len({o.name for o in objects}) == 40
    counts = [o.build(1, Path()).shape.n_m for o in objects]  # building checks that blocks are joined
    assert min(counts) == 2
    assert max(counts) == 9
    for file in objects:
        assert file.blocks is not None
        assert set(np.atleast_1d(file.blocks.mass_kg)) <= {0.1, 0.3}
        assert 0.2 <= float(np.atleast_1d(file.blocks.friction)[0]) <= 0.4
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
    other = Truth(friction=0.7).applied(model)
    assert other.truth.friction.tolist() == [0.7, 0.7]
    assert other.shape is model.shape
    spread = Truth(friction_spread=0.2, seed=1).applied(load_object("L2"))
    assert spread.shape.n_mu == 6
    assert spread.group_mass.tolist() == load_object("L2").group_mass.tolist()
    assert 0.02 < np.std(np.log(spread.truth.friction / 0.5)) < 0.5
    assert (Truth(friction_spread=0.2, seed=1).applied(load_object("L2")).truth.friction == spread.truth.friction).all()
    contact = model.shape.friction_group >= 0
    assert ((Truth(friction_spread=0.1).applied(model).shape.friction_group >= 0) == contact).all()


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


def test_a_broken_toml_is_refused(tmp_path):
    path = tmp_path / "s.toml"
    for text in ("objects = [", "\x00", "objects = 'I1", "[a]\n[a]", json.dumps({"objects": ["I1"]})):
        path.write_text(text)
        with pytest.raises(InvalidFileError, match="cannot be read as TOML"):
            load_scenario(str(path))
    with pytest.raises(InvalidValueError, match="one of blocks"):
        load_scenario("bloks")


def test_objects_are_looked_up_beside_the_scenario(tmp_path, monkeypatch):
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "pair.toml").write_text('name = "pair"\n[blocks]\nlayout = ["11"]\nmass_kg = 0.2\n')
    (tmp_path / "deep" / "s.toml").write_text('objects = ["pair.toml", "I1", "elsewhere.toml"]\n')
    monkeypatch.chdir(tmp_path)
    _, scenario = load_scenario("deep/s.toml")
    assert scenario.objects == ["deep/pair.toml", "I1", "elsewhere.toml"]
    assert load_object(scenario.objects[0]).name == "pair"
