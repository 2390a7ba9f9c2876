"""A trial in Rerun: what is in the recording is what is in the record."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun.blueprint as rrb
from numpy.testing import assert_allclose

from scenarios.cli.view import page_of, trial_page
from scenarios.results.estimates import friction_of
from scenarios.results.store import Store
from scenarios.results.trials import POSES_EVERY, trial_shown, wrench_fit
from testbed.actions.base import Rotate, Weigh
from testbed.errors import HeftError, InvalidValueError
from testbed.frames import rotation_2d
from testbed.objects.files import load_object
from testbed.objects.model import MassDistribution, ObjectModel
from testbed.sensing.presets import draw_sensing, preset
from testbed.trajectory import Phase, load_trajectory
from tests.helpers.chunks import Entity, read_chunks, verify
from tests.helpers.recorded import put_trial
from viz.recordings.page import SIM_TIME, Page, save
from viz.recordings.trial import FOOT_ARROW
from viz.values import TrialView

IDEAL = preset("ideal")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("results")
    put_trial(root, "L2", Rotate(0, duration=3.0))
    put_trial(root, "L2", Weigh())
    (root / "manifest.json").write_text('{"scenario": {"sensing": ["ideal", "ft300s"]}}', encoding="utf-8")
    return root


@pytest.fixture(scope="module")
def key(folder) -> str:
    return next(path.parent.name for path in folder.glob("trials/*/foot_forces.parquet"))


@pytest.fixture(scope="module")
def shown(folder, key) -> TrialView:
    return trial_shown(folder, key)


@pytest.fixture(scope="module")
def entities(folder, key, tmp_path_factory) -> dict[str, Entity]:
    path = tmp_path_factory.mktemp("recording") / "trial.rrd"
    save(page_of(folder, key[:6]), path)
    verify(path)
    return read_chunks(path)


def series(entities: dict[str, Entity], path: str) -> tuple[np.ndarray, np.ndarray]:
    entity = entities[path]
    return entity.times[SIM_TIME]["Scalars:scalars"], np.ravel(entity.values[SIM_TIME]["Scalars:scalars"])


def test_there_is_one_timeline(entities):
    timelines = {name for entity in entities.values() for name in entity.times}
    assert timelines == {SIM_TIME}


@pytest.mark.parametrize("kind", ["compensated", "raw"])
def test_the_wrench_is_the_record_s(entities, shown, kind):
    record = shown.trajectory
    values = record.wrench_on_object_world if kind == "compensated" else record.sensor_wrench
    for index, name in enumerate(("force/x", "force/y", "force/z", "torque/x", "torque/y", "torque/z")):
        times, logged = series(entities, f"trial/{kind}/{name}")
        assert_allclose(times, record.time_s, atol=1e-9)
        assert_allclose(logged, values[:, index], rtol=1e-12)


def test_the_measured_wrench_and_the_model_are_in_the_object_s_axes(entities, shown):
    record = shown.trajectory
    inward = np.einsum("nij,nj->ni", rotation_2d(-record.object_pose[:, 2]), record.wrench_on_object_world[:, :2])
    for index, axis in enumerate("xy"):
        assert_allclose(series(entities, f"trial/wrench/force/{axis}/measured")[1], inward[:, index], atol=1e-12)
    _, predicted = series(entities, "trial/wrench/torque/z/model")
    _, measured = series(entities, "trial/wrench/torque/z/measured")
    steady = ~np.isnan(predicted)
    np.testing.assert_array_equal(steady, shown.fit.steady)
    assert_allclose(predicted[steady].mean(), measured[steady].mean(), rtol=0.02)  # the true masses explain it


def test_the_band_holds_what_the_sensor_adds_but_for_its_share(folder, key):
    clean = wrench_fit(
        "", draw_sensing(load_trajectory(folder / "trials" / key / "trajectory.parquet"), IDEAL, 0), None
    )
    inside = []
    for seed in range(30):  # the bias is one draw a trial, so that one trial tells little
        fit = trial_shown(folder, key, seed=seed, meshes=False).fit
        inside.append((np.abs(fit.measured - clean.measured) < fit.band)[fit.steady].mean(axis=0))
    assert_allclose(np.mean(inside), 0.95, atol=0.05)


def test_the_object_moves_as_recorded(entities, shown):
    entity, pose = entities["trial/scene/object"], shown.trajectory.object_pose
    places = np.squeeze(entity.values[SIM_TIME]["Transform3D:translation"])
    assert places.shape == (len(pose), 3)
    assert_allclose(places[:, :2], pose[:, :2], atol=1e-6)
    turns = [
        each[0]["angle"] if isinstance(each, list) else each["angle"]
        for each in entity.values[SIM_TIME]["Transform3D:rotation_axis_angle"]
    ]
    assert_allclose(turns, pose[:, 2], atol=1e-6)


def test_the_hand_is_where_the_record_has_the_tcp(entities, shown):
    entity = entities["trial/scene/bench/bodies/gripper/base"]
    places = np.squeeze(entity.values[SIM_TIME]["Transform3D:translation"])
    tcp = shown.trajectory.tcp_position[::POSES_EVERY]
    assert_allclose(places[:, :2], tcp[:, :2], atol=2e-3)  # the tool points down
    assert_allclose(places[:, 2] - tcp[:, 2], 0.174, atol=2e-3)
    base = entities["trial/scene/bench/bodies/arm/base"]
    assert not base.times, "the arm's base does not move"
    assert "Transform3D:translation" in base.static


def test_arrows_at_the_feet_are_the_table_s_forces(entities, shown):
    feet = shown.feet
    assert feet is not None
    normal = np.array(entities["trial/scene/object/feet/normal"].values[SIM_TIME]["Arrows3D:vectors"])
    friction = np.array(entities["trial/scene/object/feet/friction"].values[SIM_TIME]["Arrows3D:vectors"])
    assert normal.shape == feet.force.shape == friction.shape
    assert_allclose(normal[..., 2], FOOT_ARROW * feet.force[..., 2], atol=1e-6)
    assert_allclose(
        np.linalg.norm(friction, axis=-1), FOOT_ARROW * np.linalg.norm(feet.force[..., :2], axis=-1), atol=1e-6
    )


def test_states_mark_the_phases_and_the_steady_window(entities, shown):
    phases = entities["trial/states/phase"]
    said = [each[0] if isinstance(each, list) else each for each in phases.values[SIM_TIME]["StateChange:state"]]
    assert said == [phase.name.lower() for phase in (0, 1, 2, 3, 4, 5, 4, 6) for phase in [Phase(phase)]]
    window = entities["trial/states/window"]
    given = shown.trajectory.time_s[shown.fit.steady]
    assert_allclose(window.times[SIM_TIME]["StateChange:state"][1], given[0], atol=1e-9)


def test_a_weighing_is_refused(folder, key):
    weighing = next(p.parent.name for p in folder.glob("trials/*/trial.json") if p.parent.name != key)
    with pytest.raises(InvalidValueError, match="a weighing"):
        trial_page(folder, weighing)


def test_what_is_not_there_is_told_with_what_is(folder):
    with pytest.raises(InvalidValueError, match="beginning of one key"):
        page_of(folder, "zzz")
    with pytest.raises(InvalidValueError, match="2 begin so"):
        page_of(folder, "")
    with pytest.raises(InvalidValueError, match="results folder"):
        page_of(folder / "none", None)


def test_a_trial_without_feet_is_shown_without_their_arrows(folder, key, tmp_path):
    copy = tmp_path / "trials" / key
    copy.mkdir(parents=True)
    for name in ("trial.json", "trajectory.parquet"):
        (copy / name).write_bytes((folder / "trials" / key / name).read_bytes())
    save(trial_page(tmp_path, key), tmp_path / "x.rrd")
    assert not [path for path in read_chunks(tmp_path / "x.rrd") if "/feet" in path]


def test_a_damaged_record_is_told(folder, key, tmp_path):
    copy = tmp_path / "trials" / key
    copy.mkdir(parents=True)
    (copy / "trial.json").write_bytes((folder / "trials" / key / "trial.json").read_bytes())
    (copy / "trajectory.parquet").write_bytes(b"PAR1")
    with pytest.raises(HeftError, match=r"trajectory\.parquet"):
        trial_page(tmp_path, key)


def test_a_recording_that_fails_leaves_no_file(tmp_path):
    def log(stream):
        raise RuntimeError("cut")

    with pytest.raises(RuntimeError):
        save(Page("x", "x", log, rrb.Spatial3DView(), SIM_TIME), tmp_path / "x.rrd")
    assert not list(tmp_path.iterdir())


KILLED = """
import sys, time
from pathlib import Path
import rerun as rr, rerun.blueprint as rrb
from viz.recordings.page import Page, save

def log(stream):
    stream.log("a", rr.TextDocument("x" * 1_000_000), static=True)
    stream.flush()
    print("logging", flush=True)
    time.sleep(60)

save(Page("x", "x", log, rrb.Spatial3DView(), "sim_time"), Path(sys.argv[1]))
"""


def test_a_recording_cut_by_a_kill_is_not_there(tmp_path):
    path = tmp_path / "x.rrd"
    process = subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "logging\n"
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not path.exists()
    Store(tmp_path).remove_leftovers()
    assert not list(tmp_path.iterdir())


def test_frictions_that_no_method_is_told_of_are_meant_in_the_mean():
    shape = load_object("I2").shape
    groups = np.arange(len(shape.particles)) % 2  # a friction for every other particle
    finer = replace(shape, friction_group=groups)
    model = ObjectModel("I2", finer, MassDistribution(np.ones(shape.n_m), np.array([0.3, 0.5])))
    assert_allclose(friction_of(model, shape), [0.4])
    assert_allclose(friction_of(load_object("I2"), shape), load_object("I2").truth.friction)
