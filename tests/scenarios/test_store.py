"""A results folder: content keys, and trials and estimates that are read back as they were written."""

import dataclasses
import json
import math

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal

from estimators.base import Estimate, HiddenStateEstimate, Trace
from estimators.identifiability.report import identifiability
from scenarios.results.estimates import load_estimate
from scenarios.results.files import write_json
from scenarios.results.store import Store, key_of, object_request, trial_request
from scenarios.results.trials import keys_of, read_trial
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.actions.weigh import Weigh
from testbed.errors import HeftError, InvalidValueError
from testbed.files import DamagedFileError
from testbed.objects.files import load_object
from testbed.objects.model import STROKE
from testbed.simulation.settings import GripSettings, SimulationSettings
from testbed.trial import RIGID, Trial
from tests.helpers.recorded import put_trial

SLIDE = Slide(0, duration=0.2)
L2, HAMMER = load_object("L2"), load_object("hammer")


def test_solids_and_gripped_faces_are_in_the_key():
    first, grasp = HAMMER.solids[0], HAMMER.shape.grasps[0]
    stretched = dataclasses.replace(first, vertices=first.vertices * [1.0, 1.0, 1.1])
    others = [
        dataclasses.replace(HAMMER, solids=()),
        dataclasses.replace(HAMMER, solids=(stretched, *HAMMER.solids[1:])),
    ]
    for faces in ({"bottom": 0.001}, {"top": 0.03}, {"top": None}):
        grasps = (dataclasses.replace(grasp, **faces), *HAMMER.shape.grasps[1:])
        others.append(dataclasses.replace(HAMMER, shape=dataclasses.replace(HAMMER.shape, grasps=grasps)))
    keys = [key_of(trial_request(Trial(o, Rotate(0)), SimulationSettings())) for o in (HAMMER, *others)]
    assert len({*keys}) == len(keys)
    assert keys[0] == key_of(trial_request(Trial(load_object("hammer"), Rotate(0)), SimulationSettings()))


def test_a_key_depends_on_content_alone():
    assert key_of({"a": 1, "b": [1, 2]}) == key_of({"b": [1, 2], "a": 1}) != key_of({"a": 1})


def test_a_swept_setting_of_words_and_numbers_is_kept_in_words(tmp_path):
    rows = [{"axis.support": value} for value in (["own_weight"], [10], [1000.0], ["rigid"], None)]
    kept = Store(tmp_path).put_table(rows)["axis.support"]
    assert list(pd.read_parquet(tmp_path / "results.parquet")["axis.support"].dropna()) == list(kept.dropna())
    assert list(kept)[:4] == ["own_weight", "10", "1000.0", "rigid"]


def same(a: object, b: object) -> None:
    """Equal to the last bit, through dataclasses and tuples."""
    if dataclasses.is_dataclass(a):
        assert type(a) is type(b)
        for field in dataclasses.fields(a):
            same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, tuple):
        assert isinstance(b, tuple) and len(a) == len(b)
        for one, other in zip(a, b, strict=True):
            same(one, other)
    else:
        assert_array_equal(a, b)  # pyright: ignore[reportArgumentType]


FULL = Estimate(
    L2.truth,
    "underdetermined",
    "the order of B and C is open",
    np.diag([1e-3, 2e-3, 1e-3, 1e-3, 1e-3, math.inf]),
    identifiability(L2.shape, L2.truth, np.random.default_rng(0).normal(size=(4, L2.shape.n_m + L2.shape.n_mu))),
    HiddenStateEstimate(1.8, math.nan, np.array([0.01, math.nan]), np.ones(6), tuple((g, 0) for g in range(6)), "I_cm"),
    (
        Trace("rms prop", (2.0, 1.0), (0.1, 0.2), 36.0, np.ones((2, 6))),
        Trace("adam", (3.0,), (0.1,), 36.0, np.zeros((0, 0))),
    ),
    0.3,
    {"loss": 1.25, "rank": 6.0},
    "every mass group rests on its own weight",
)


@pytest.mark.parametrize("answer", [FULL, Estimate(None, "no_data", "no trial is usable")], ids=["full", "empty"])
def test_load_estimate_is_the_inverse_of_put_estimate(tmp_path, answer):
    optimizer = answer.traces[0].method if answer.traces else ""
    row = {name: getattr(answer, name) for name in ("status", "message", "seconds", "assumes")} | {
        "optimizer": optimizer
    }
    Store(tmp_path).put_estimate("key", row, answer, L2.shape)
    same(load_estimate(tmp_path, "key"), answer)


@pytest.mark.parametrize(("name", "harm"), [("estimate.npz", b"PK"), ("result.json", b"{")])
def test_a_damaged_estimate_is_an_error(tmp_path, name, harm):
    Store(tmp_path).put_estimate("key", {"status": "ok"}, FULL, L2.shape)
    (tmp_path / "estimates" / "key" / name).write_bytes(harm)
    with pytest.raises(HeftError, match="whole"):
        load_estimate(tmp_path, "key")


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """A folder with a slide of L2, one of the hammer, and a weighing."""
    folder = tmp_path_factory.mktemp("results")
    keys = [put_trial(folder, "L2", SLIDE), put_trial(folder, "hammer", SLIDE, RIGID), put_trial(folder, "L2", Weigh())]
    return folder, dict(zip(("L2", "hammer", "weigh"), keys, strict=True))


@pytest.mark.parametrize(("known", "support"), [(L2, "own_weight"), (HAMMER, "rigid")], ids=["L2", "hammer"])
def test_a_trial_is_read_back(root, known, support):
    record = read_trial(root[0], root[1][known.name][:7])
    assert object_request(record.object) == object_request(known)
    assert (record.object.name, record.support, record.trajectory.action) == (known.name, support, SLIDE)
    assert record.object.shape.group_names == known.shape.group_names
    assert [grasp.name for grasp in record.object.shape.grasps] == [grasp.name for grasp in known.shape.grasps]
    for read, solid in zip(record.object.solids, known.solids, strict=True):
        assert_array_equal(read.vertices, solid.vertices)
    assert record.pads == (known.shape.grasps[0].width, STROKE)
    assert isinstance(read_trial(root[0], root[1]["weigh"]).trajectory.action, Weigh)


@pytest.mark.parametrize("name", ["wrench", "no such object", None])
def test_an_object_that_is_another_now_is_known_by_its_particles(root, tmp_path, name):
    copy, content = copied(root, tmp_path, "hammer")
    content["names"] = {} if name is None else {"object": name}
    del content["asked"]["simulation"]  # as one of a real robot
    write_json(copy / "trial.json", content)
    record = read_trial(tmp_path, copy.name)
    assert record.object.solids == () and record.object.name == (name or "object")
    assert_array_equal(record.object.shape.particles, HAMMER.shape.particles)


def test_welded_fingers_stay_open(tmp_path):
    key = put_trial(tmp_path, "L2", SLIDE, settings=SimulationSettings(grip=GripSettings(mode="weld")))
    assert read_trial(tmp_path, key).pads == (STROKE, STROKE)


def test_no_trial_or_several_are_refused(root):
    keys = keys_of(root[0])
    for wrong, allowed in (("x", "beginning of one trial's key"), ("", "more of the key, this is ambiguous")):
        with pytest.raises(InvalidValueError, match=allowed) as error:
            read_trial(root[0], wrong)
        assert all(key[:8] in str(error.value) for key in keys)
    with pytest.raises(InvalidValueError, match="a results folder"):
        read_trial(root[0] / "trials", "x")


@pytest.mark.parametrize("harm", ["{", "[]", {"asked": {}}, {"asked": {"object": {"particles": "many"}}}, None])
def test_a_damaged_trial_is_an_error_and_stays(root, tmp_path, harm):
    copy, _ = copied(root, tmp_path, "L2")
    if harm is None:
        record = copy / "trajectory.parquet"
        record.write_bytes(record.read_bytes()[:-100])
    elif isinstance(harm, str):
        (copy / "trial.json").write_text(harm)
    else:
        write_json(copy / "trial.json", harm)
    with pytest.raises(
        DamagedFileError, match=f"{'trajectory.parquet' if harm is None else 'trial.json'}: not a whole"
    ):
        read_trial(tmp_path, copy.name)
    assert (copy / "trial.json").is_file()


def copied(root, tmp_path, name):
    """A trial's folder, copied, and the content of its trial.json."""
    source = root[0] / "trials" / root[1][name]
    folder = tmp_path / "trials" / source.name
    folder.mkdir(parents=True)
    for file in source.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    return folder, json.loads((folder / "trial.json").read_text())
