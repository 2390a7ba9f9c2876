"""Content keys: what decides a trial changes its key."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from scenarios.results.store import Store, key_of, trial_request
from testbed.actions.rotate import Rotate
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.simulation.settings import SimulationSettings
from testbed.trial import Trial


def key(obj: ObjectModel) -> str:
    return key_of(trial_request(Trial(obj, Rotate(0)), SimulationSettings()))


def test_the_same_tool_has_the_same_key():
    assert key(load_object("hammer")) == key(load_object("hammer"))


def test_solids_and_gripped_faces_are_in_the_key():
    obj = load_object("hammer")
    first = obj.solids[0]
    stretched = replace(first, vertices=first.vertices * [1.0, 1.0, 1.1])
    grasp = obj.shape.grasps[0]
    others = [
        replace(obj, solids=()),
        replace(obj, solids=(stretched, *obj.solids[1:])),
        *(
            replace(obj, shape=replace(obj.shape, grasps=(replace(grasp, **faces), *obj.shape.grasps[1:])))
            for faces in ({"bottom": 0.001}, {"top": 0.03}, {"top": None})
        ),
    ]
    assert len({key(each) for each in [obj, *others]}) == len(others) + 1


def test_a_swept_setting_of_words_and_numbers_is_kept_in_words(tmp_path):
    rows = [{"axis.support": value} for value in (["own_weight"], [10], [1000.0], ["rigid"], None)]
    kept = Store(tmp_path).put_table(rows)["axis.support"]
    assert list(pd.read_parquet(tmp_path / "results.parquet")["axis.support"].dropna()) == list(kept.dropna())
    assert list(kept)[:4] == ["own_weight", "10", "1000.0", "rigid"]
