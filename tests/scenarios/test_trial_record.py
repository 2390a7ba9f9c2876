"""A trial read back: the object is the one that was moved, and what cannot be read is told in a line."""

from __future__ import annotations

import json

import pytest
from numpy.testing import assert_array_equal

from scenarios.results.store import object_request
from scenarios.results.trials import keys_of, read_trial
from testbed.actions.slide import Slide
from testbed.actions.weigh import Weigh
from testbed.errors import HeftError, InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.gripper import STROKE
from testbed.simulation.settings import GripSettings, SimulationSettings
from testbed.trial import RIGID
from tests.helpers.recorded import put_trial

SLIDE = Slide(0, duration=0.2)


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    put_trial(folder, "L2", SLIDE)
    put_trial(folder, "hammer", SLIDE, RIGID)
    put_trial(folder, "L2", Weigh())
    return folder


def key_with(root, name, kind):
    for key in keys_of(root):
        said = json.loads((root / "trials" / key / "trial.json").read_text())
        if said["names"]["object"] == name and said["asked"]["action"]["kind"] == kind:
            return key
    raise AssertionError(name)


@pytest.mark.parametrize("name", ["L2", "hammer"])
def test_the_object_is_the_one_that_was_moved(root, name):
    key = key_with(root, name, "slide")
    record, known = read_trial(root, key[:7]), load_object(name)
    assert object_request(record.object) == object_request(known)
    assert record.object.name == name
    assert record.object.shape.group_names == known.shape.group_names
    assert [grasp.name for grasp in record.object.shape.grasps] == [grasp.name for grasp in known.shape.grasps]
    for read, solid in zip(record.object.solids, known.solids, strict=True):
        assert_array_equal(read.vertices, solid.vertices)
    assert record.support == ("rigid" if name == "hammer" else "own_weight")
    assert record.grip_width == known.shape.grasps[0].width
    assert record.trajectory.action == SLIDE


@pytest.mark.parametrize("called", ["wrench", "no such object", None])
def test_an_object_that_is_another_now_is_known_by_its_particles(root, tmp_path, called):
    copy = copied(root, tmp_path, key_with(root, "hammer", "slide"))
    change(copy, names={} if called is None else {"object": called})
    record = read_trial(tmp_path, copy.name)
    assert record.object.solids == ()
    assert record.object.name == (called or "object")
    assert_array_equal(record.object.shape.particles, load_object("hammer").shape.particles)


def test_a_record_without_names_or_settings_is_read(root, tmp_path):
    """As one of a real bench may be, or of an older run."""
    copy = copied(root, tmp_path, key_with(root, "L2", "slide"))
    said = json.loads((copy / "trial.json").read_text())
    del said["names"], said["asked"]["simulation"]
    (copy / "trial.json").write_text(json.dumps(said))
    assert read_trial(tmp_path, copy.name).object.total_mass == load_object("L2").total_mass


def test_welded_fingers_stay_open(tmp_path):
    key = put_trial(tmp_path, "L2", SLIDE, settings=SimulationSettings(grip=GripSettings(mode="weld")))
    assert read_trial(tmp_path, key).grip_width == STROKE


def test_a_weighing_is_read(root):
    assert isinstance(read_trial(root, key_with(root, "L2", "weigh")).trajectory.action, Weigh)


def test_no_trial_or_several_are_refused(root):
    keys = keys_of(root)
    for wrong in ("x", ""):
        with pytest.raises(InvalidValueError, match="beginning of one trial's key") as told:
            read_trial(root, wrong)
        assert all(key[:8] in str(told.value) for key in keys)
    with pytest.raises(InvalidValueError, match="a results folder"):
        read_trial(root / "trials", "x")


def test_a_damaged_trial_is_told_and_left_alone(root, tmp_path):
    for harm in ("{", "[]", '{"asked": {}}', json.dumps({"asked": {"object": {"particles": "many"}}})):
        copy = copied(root, tmp_path, key_with(root, "L2", "slide"))
        (copy / "trial.json").write_text(harm)
        with pytest.raises(HeftError, match="not a whole trial file"):
            read_trial(tmp_path, copy.name)
    record = copied(root, tmp_path, copy.name) / "trajectory.parquet"
    record.write_bytes(record.read_bytes()[:-100])
    with pytest.raises(HeftError, match="not a whole trajectory file"):
        read_trial(tmp_path, copy.name)
    assert (copy / "trial.json").is_file()


def copied(root, tmp_path, key):
    folder = tmp_path / "trials" / key
    folder.mkdir(parents=True, exist_ok=True)
    for file in (root / "trials" / key).iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    return folder


def change(folder, **changes):
    said = json.loads((folder / "trial.json").read_text())
    (folder / "trial.json").write_text(json.dumps(said | changes))
