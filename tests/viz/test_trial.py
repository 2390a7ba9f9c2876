"""Trials in Rerun: the recording has the values of the trajectory."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun.blueprint as rrb
from numpy.testing import assert_allclose, assert_array_equal

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
from viz.recordings.trial import FOOT_ARROW, WRENCH
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
def view(folder, key) -> TrialView:
    return trial_shown(folder, key)


@pytest.fixture(scope="module")
def entities(folder, key, tmp_path_factory) -> dict[str, Entity]:
    path = tmp_path_factory.mktemp("recording") / "trial.rrd"
    save(page_of(folder, key[:6]), path)
    verify(path)
    return read_chunks(path)


@pytest.fixture
def copy(folder, key, tmp_path) -> Path:
    """The turn alone in a folder of its own."""
    shutil.copytree(folder / "trials" / key, tmp_path / "trials" / key)
    return tmp_path


def values(entities: dict[str, Entity], path: str, component: str = "Scalars:scalars") -> np.ndarray:
    return np.squeeze(np.array(entities[path].values[SIM_TIME][component]))


def test_every_entity_is_static_or_on_the_time_of_the_trial(entities):
    assert {name for entity in entities.values() for name in entity.times} == {SIM_TIME}
    wrench = {f"trial/{kind}/{name}" for kind in ("raw", "compensated") for name in WRENCH}
    fit = {f"trial/wrench/{name}/{line}" for name in ("force/x", "force/y", "torque/z")
           for line in ("measured", "model", "upper", "lower")}  # fmt: skip
    scene = {f"trial/scene/{name}" for name in ("gripper_force", "object/cells", "object/feet/normal")}
    assert wrench | fit | scene | {"trial/facts", "trial/states/phase", "trial/states/window"} <= set(entities)


@pytest.mark.parametrize("kind", ["compensated", "raw"])
def test_the_wrench_is_the_trajectorys(entities, view, kind):
    record = view.trajectory
    wrench = record.wrench_on_object_world if kind == "compensated" else record.sensor_wrench
    for name, column in zip(WRENCH, wrench.T, strict=True):
        path = f"trial/{kind}/{name}"
        assert_allclose(entities[path].times[SIM_TIME]["Scalars:scalars"], record.time_s, atol=1e-9)
        assert_allclose(values(entities, path), column, rtol=1e-12)


def test_the_measured_wrench_and_the_model_are_in_the_objects_axes(entities, view):
    record = view.trajectory
    inward = np.einsum("nij,nj->ni", rotation_2d(-record.object_pose[:, 2]), record.wrench_on_object_world[:, :2])
    for axis, column in zip("xy", inward.T, strict=True):
        assert_allclose(values(entities, f"trial/wrench/force/{axis}/measured"), column, atol=1e-12)
    predicted, measured = (values(entities, f"trial/wrench/torque/z/{line}") for line in ("model", "measured"))
    steady = ~np.isnan(predicted)
    assert_array_equal(steady, view.fit.steady)
    assert_allclose(predicted[steady].mean(), measured[steady].mean(), rtol=0.02)  # the true masses explain it


def test_the_band_holds_the_sensors_errors_but_for_its_share(folder, key):
    clean = wrench_fit(
        "", draw_sensing(load_trajectory(folder / "trials" / key / "trajectory.parquet"), IDEAL, 0), None
    )
    inside = []
    for seed in range(30):  # the bias is one draw a trial, so that one trial tells little
        fit = trial_shown(folder, key, seed=seed, meshes=False).fit
        inside.append((np.abs(fit.measured - clean.measured) < fit.band)[fit.steady].mean(axis=0))
    assert_allclose(np.mean(inside), 0.95, atol=0.05)


def test_object_and_gripper_move_as_recorded(entities, view):
    record, path = view.trajectory, "trial/scene/object"
    places = values(entities, path, "Transform3D:translation")
    assert_allclose(places, np.column_stack([record.object_pose[:, :2], np.zeros(len(places))]), atol=1e-6)
    turns = [np.ravel(each)[0]["angle"] for each in entities[path].values[SIM_TIME]["Transform3D:rotation_axis_angle"]]
    assert_allclose(turns, record.object_pose[:, 2], atol=1e-6)
    hand = values(entities, "trial/scene/bench/bodies/gripper/base", "Transform3D:translation")
    tcp = record.tcp_position[::POSES_EVERY]
    assert_allclose(hand - tcp, np.tile([0.0, 0.0, 0.174], (len(tcp), 1)), atol=2e-3)  # the tool points down
    base = entities["trial/scene/bench/bodies/arm/base"]
    assert not base.times, "the arm's base does not move"
    assert "Transform3D:translation" in base.static


def test_arrows_at_the_feet_are_the_tables_forces(entities, view):
    feet = view.feet
    assert feet is not None
    normal, friction = (
        values(entities, f"trial/scene/object/feet/{name}", "Arrows3D:vectors") for name in ("normal", "friction")
    )
    assert normal.shape == feet.force.shape == friction.shape
    assert_allclose(normal[..., 2], FOOT_ARROW * feet.force[..., 2], atol=1e-6)
    size = np.linalg.norm(feet.force[..., :2], axis=-1)
    assert_allclose(np.linalg.norm(friction, axis=-1), FOOT_ARROW * size, atol=1e-6)


def test_states_mark_the_phases_and_the_steady_window(entities, view):
    phases = values(entities, "trial/states/phase", "StateChange:state")
    assert list(phases) == [Phase(phase).name.lower() for phase in (0, 1, 2, 3, 4, 5, 4, 6)]
    window = entities["trial/states/window"].times[SIM_TIME]["StateChange:state"]
    assert_allclose(window[1], view.trajectory.time_s[view.fit.steady][0], atol=1e-9)


@pytest.mark.parametrize(
    ("inside", "what", "reason"),
    [
        ("", "zzz", "beginning of one key"),
        ("", "", "2 begin so"),
        ("none", None, "results folder"),
        ("", "weigh", "a weighing"),
    ],
)
def test_pages_that_do_not_exist_are_refused_with_those_that_do(folder, key, inside, what, reason):
    if what == "weigh":
        what = next(p.parent.name for p in folder.glob("trials/*/trial.json") if p.parent.name != key)
    with pytest.raises(InvalidValueError, match=reason):
        page_of(folder / inside, what)


def test_a_trial_without_feet_has_no_arrows_there_and_a_damaged_one_is_refused(copy, key):
    (copy / "trials" / key / "foot_forces.parquet").unlink()
    save(trial_page(copy, key), copy / "x.rrd")
    assert not [path for path in read_chunks(copy / "x.rrd") if "/feet" in path]
    (copy / "trials" / key / "trajectory.parquet").write_bytes(b"PAR1")
    with pytest.raises(HeftError, match=r"trajectory\.parquet"):
        trial_page(copy, key)


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


def test_frictions_within_a_group_of_the_estimator_are_averaged():
    shape = load_object("I2").shape
    groups = np.arange(len(shape.particles)) % 2  # a friction for every other particle
    finer = replace(shape, friction_group=groups)
    model = ObjectModel("I2", finer, MassDistribution(np.ones(shape.n_m), np.array([0.3, 0.5])))
    assert_allclose(friction_of(model, shape), [0.4])
    assert_allclose(friction_of(load_object("I2"), shape), load_object("I2").truth.friction)
