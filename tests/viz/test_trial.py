"""Trials in Rerun and in figures: values of the trajectory, contact points, links, hinges and joint angles."""

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.patches import FancyArrowPatch
from numpy.testing import assert_allclose, assert_array_equal

from estimators.testing.analytic_world import drawn_object
from scenarios.results.files import write_json
from scenarios.views.pages import page_of, page_of_trial, trial_page
from scenarios.views.values import POSES_EVERY, friction_of, trial_view, wrench_fit
from testbed import HeftError, InvalidValueError, Push, Rotate, Slide, Weigh, draw_sensing, load_object, preset
from testbed.frames import rotation_2d
from testbed.objects.colors import group_color
from testbed.objects.model import MassDistribution, ObjectModel
from testbed.sensing.push_windows import contact_path, push_samples, push_windows
from testbed.simulation.rendering import body_poses
from testbed.trajectory import Phase, Trajectory, load_trajectory, save_trajectory
from tests.fakes.analytic_links import analytic_links
from tests.fakes.analytic_push import analytic_pushes
from tests.helpers.chunks import Entity, logged
from tests.helpers.rows import row
from tests.helpers.simulated import put_trial
from viz.figures.trials import trials_figure
from viz.recordings.page import SIM_TIME, Page
from viz.recordings.trial import FOOT_ARROW, WRENCH, log_trial, trial_blueprint
from viz.report.report import Results, render
from viz.report.trials import trials_table
from viz.trials import TrialsView
from viz.values import TrialView

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def view(turn_folder, turn_key) -> TrialView:
    return trial_view(turn_folder, turn_key)


@pytest.fixture(scope="module")
def entities(turn_folder, turn_key, tmp_path_factory) -> dict[str, Entity]:
    return logged(page_of(turn_folder, turn_key[:6]), tmp_path_factory.mktemp("recording") / "trial.rrd")


@pytest.fixture
def copy(turn_folder, turn_key, tmp_path) -> Path:
    """The turn alone in a folder of its own."""
    shutil.copytree(turn_folder / "trials" / turn_key, tmp_path / "trials" / turn_key)
    return tmp_path


def values(entities: dict[str, Entity], path: str, component: str = "Scalars:scalars") -> np.ndarray:
    return np.squeeze(np.array(entities[path].values[SIM_TIME][component]))


def joint_angles(trial: Trajectory) -> np.ndarray:
    """Joint angles of every hinge [deg], (T, hinges)."""
    assert trial.camera is not None
    return np.degrees(np.diff(trial.camera.poses[:, :, 2], axis=1))


def test_cells_have_the_colors_and_masses_of_their_groups(entities, view):
    cells, shape = entities["trial/scene/object/cells"], view.shape
    colors, labels = cells.static["Boxes3D:colors"], cells.static["Boxes3D:labels"]
    packed = [int(group_color(group)[1:] + "FF", 16) for group in shape.mass_group]
    assert list(colors) == packed
    assert len(set(packed)) == shape.n_m
    assert labels[0] == f"{shape.group_names[shape.mass_group[0]]}: 0.400 kg"


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


def test_the_band_holds_the_sensors_errors_but_for_its_share(turn_folder, turn_key):
    trajectory = load_trajectory(turn_folder / "trials" / turn_key / "trajectory.parquet")
    clean = wrench_fit("", draw_sensing(trajectory, preset("ideal"), 0), None)
    inside = []
    for seed in range(60):  # bias and drift are one draw per trial
        fit = wrench_fit("", draw_sensing(trajectory, preset("ft300s"), seed), None)
        inside.append((np.abs(fit.measured - clean.measured) < fit.band)[fit.steady].mean(axis=0))
    assert_allclose(np.mean(inside, axis=0), 0.95, atol=0.05)


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


def test_a_push_is_drawn_with_its_fingertip(tmp_path):
    push = Push((-0.05, 0.01), 0.0, speed=0.05, length=0.06)
    key = put_trial(tmp_path, "L2", push)
    write_json(tmp_path / "manifest.json", {"scenario": {"sensing": ["ideal"]}})
    pushed = trial_view(tmp_path, key)
    entities = logged(page_of_trial(pushed, key), tmp_path / "push.rrd")
    (path,) = (name for name in entities if name.endswith("scene/fingertip"))
    place = values(entities, path, "Points3D:positions")
    trajectory = pushed.trajectory
    assert_allclose(place[:, :2], trajectory.tcp_position[:, :2], atol=1e-6)
    assert np.abs(place[trajectory.segment >= 0, 2] - push.fingertip(pushed.shape).height).max() < 5e-4


def test_states_mark_the_phases_and_the_steady_window(entities, view):
    phases = values(entities, "trial/states/phase", "StateChange:state")
    assert list(phases) == [Phase(phase).name.lower() for phase in (0, 1, 2, 3, 4, 5, 4, 6)]
    window = entities["trial/states/window"].times[SIM_TIME]["StateChange:state"]
    assert_allclose(window[1], view.trajectory.time_s[view.fit.steady][0], atol=1e-9)


def test_pages_that_do_not_exist_are_refused_with_those_that_do(turn_folder, turn_key):
    weighing = next(p.parent.name for p in turn_folder.glob("trials/*/trial.json") if p.parent.name != turn_key)
    for what, reason in (("zzz", "beginning of one key"), ("", "2 begin so"), (weighing, "a weighing")):
        with pytest.raises(InvalidValueError, match=reason):
            page_of(turn_folder, what)
    with pytest.raises(InvalidValueError, match="results folder"):
        page_of(turn_folder / "none", None)


def test_a_trial_without_feet_has_no_arrows_there_and_a_damaged_one_is_refused(copy, turn_key):
    (copy / "trials" / turn_key / "foot_forces.parquet").unlink()
    assert not [path for path in logged(trial_page(copy, turn_key), copy / "x.rrd") if "/feet" in path]
    (copy / "trials" / turn_key / "trajectory.parquet").write_bytes(b"PAR1")
    with pytest.raises(HeftError, match=r"trajectory\.parquet"):
        trial_page(copy, turn_key)


def test_a_trial_of_a_robot_is_drawn_from_its_files(copy, turn_key):
    """The wrench as measured: no draw of errors, no truth, and no forces on the feet."""
    folder = copy / "trials" / turn_key
    (folder / "foot_forces.parquet").unlink()
    measured = draw_sensing(load_trajectory(folder / "trajectory.parquet"), preset("ft300s"), 5)
    save_trajectory(replace(measured, provenance={"runner": "robot"}), folder / "trajectory.parquet")
    view = trial_view(copy, turn_key)
    assert (view.truth, view.feet, view.model) == (None, None, "")
    assert (view.trajectory.wrench_on_object_world == measured.wrench_on_object_world).all()
    assert "trial/wrench/force/x/measured" in logged(page_of_trial(view, turn_key), copy / "x.rrd")


def test_frictions_within_a_group_of_the_estimator_are_averaged():
    shape = load_object("I2").shape
    groups = np.arange(len(shape.particles)) % 2  # a friction for every other particle
    finer = replace(shape, friction_group=groups)
    model = ObjectModel("I2", finer, MassDistribution(np.ones(shape.n_m), np.array([0.3, 0.5])))
    assert_allclose(friction_of(model, shape), [0.4])
    assert_allclose(friction_of(load_object("I2"), shape), load_object("I2").truth.friction)


LIBRARY = Path(__file__).parents[2] / "scenarios/library/objects"
BLOCKS = drawn_object(3, ["11", "11", "11"])
SIDE = float(np.abs(BLOCKS.shape.particles[:, 0]).max() + BLOCKS.shape.cell / 2)
FOLD = load_object(str(LIBRARY / "fold_3.toml"))
assert FOLD.shape.chain is not None
HINGES = FOLD.shape.chain.hinges
DRAGS = Slide(2, direction=0.5, duration=2.0), Rotate(0, duration=2.0, pivot=(-0.02, 0.01))


@pytest.fixture(scope="module")
def pushes() -> list[Trajectory]:
    """One push that slides along the left face, and one that sticks."""
    slides = Push((-SIDE, 0.02), math.radians(-50), speed=0.05, length=0.08, friction=0.2)
    return analytic_pushes(BLOCKS, [slides, Push((SIDE, 0.0), math.pi, speed=0.05, length=0.055)])


@pytest.fixture(scope="module")
def drags() -> list[Trajectory]:
    """A slide and a turn of three links."""
    trials = [analytic_links(FOLD, action) for action in DRAGS]
    assert trials[0].camera is not None
    poses = np.array(trials[0].camera.poses)
    poses[3, 1] = np.nan  # a frame in which one link was not seen
    return [replace(trials[0], camera=replace(trials[0].camera, poses=poses)), trials[1]]


def recorded(path: Path, model: ObjectModel, trajectory: Trajectory) -> dict[str, Entity]:
    """Entities of a trial's recording, from its values alone."""
    poses = body_poses(trajectory, (0.02, 0.04), meshes=False, every=100)
    fit = wrench_fit("", trajectory, None)
    view = TrialView("", model.shape, trajectory, poses, trajectory.time_s[::100], fit, truth=model.truth)
    return logged(
        Page("x", "x", lambda stream: log_trial(stream, "t", view), trial_blueprint("t", view), SIM_TIME), path
    )


def test_contact_points_lie_on_the_outline_where_the_fingertip_is(pushes):
    push, trial = pushes[0].action, pushes[0]
    path = contact_path(BLOCKS.shape, trial)
    tips = np.array([window.point for window in push_windows(trial)])
    assert_allclose(path[:, 0], -SIDE, atol=1e-9)
    assert_allclose(path, tips + np.array([push.radius, 0.0]), atol=1e-6)
    assert np.ptp(path[:, 1]) > 1e-3


def test_a_push_is_an_arrow_to_its_contact_point_and_a_line_along_its_way(pushes):
    view = TrialsView.of(BLOCKS.shape, [replace(pushes[0], action=Weigh()), *pushes], "blocks")
    figure = trials_figure(view)
    (axis,) = figure.axes
    arrows = [patch for patch in axis.patches if isinstance(patch, FancyArrowPatch)]
    assert len(arrows) == len(pushes)
    lines = {line.get_gid(): np.asarray(line.get_xydata()) for line in axis.lines if line.get_gid()}
    for number, trial in enumerate(pushes, start=1):
        way = view.arrows[number].way
        heading = [math.cos(trial.action.direction), math.sin(trial.action.direction)]
        assert_allclose((way[1] - way[0]) / np.linalg.norm(way[1] - way[0]), heading, atol=1e-12)
        assert_allclose(way[1], trial.action.point)
        path = lines[f"contact_path_{number}"]
        assert_allclose(path, np.vstack([trial.action.point, contact_path(BLOCKS.shape, trial)]))
    assert {"1", "2"} <= {text.get_text() for text in axis.texts}
    assert view.slid(1) > 5 * view.slid(2)


def test_links_and_hinges_are_on_the_map_and_each_joint_has_its_line(drags):
    view = TrialsView.of(FOLD.shape, drags, "fold_3")
    top, *below = trials_figure(view).axes
    (cells,) = (patches for patches in top.collections if patches.get_array() is not None)
    assert FOLD.shape.chain is not None
    links = FOLD.shape.chain.link[FOLD.shape.mass_group]
    assert_allclose(np.asarray(cells.get_array()), links + 0.5)
    assert any(np.array_equal(line.get_xydata(), HINGES) for line in top.lines)
    assert [axis.get_ylabel() for axis in below] == ["hinge 0, deg", "hinge 1, deg"]
    lines = {line.get_gid(): line for axis in below for line in axis.lines}
    for number, trial in enumerate(drags, start=1):
        for hinge in range(len(HINGES)):
            assert_allclose(np.asarray(lines[f"joint_{number}_{hinge}"].get_ydata()), joint_angles(trial)[:, hinge])


def test_the_report_has_each_objects_actions_and_ranges(pushes, drags):
    views = {
        "L2": TrialsView.of(BLOCKS.shape, pushes, "L2, ideal"),
        "fold_3": TrialsView.of(FOLD.shape, drags, "fold_3, ideal"),
    }
    rows = [row("hidden_states", 0, 0.01, name) for name in (*views, "gone")]
    page = render(Results("x", {}, {}, "", "", rows, lambda _: None, trials_of=views.get))
    assert page.count(": actions by trial</figcaption>") == 2
    assert '<section id="trials">' in page and 'href="#trials"' in page
    for name, view in views.items():
        table = trials_table(view)
        assert len(table.rows) == 2 and all(label[0] in page for label, _ in table.rows), name
    (_, (slid,)), _ = trials_table(views["L2"]).rows
    assert slid.text == f"{1e3 * views['L2'].slid(1):.1f}"
    table = trials_table(views["fold_3"])
    assert table.columns == ("hinge 0, deg", "hinge 1, deg")
    angle = joint_angles(drags[1])[:, 1]
    low, high = (float(value) for value in table.rows[1][1][1].text.split(" to "))
    assert_allclose([low, high], [angle.min(), angle.max()], atol=0.051)


def test_a_recording_of_links_has_hinges_and_joint_angles(drags, tmp_path):
    trial = drags[0]
    found = recorded(tmp_path / "x.rrd", FOLD, trial)
    for hinge, place in enumerate(HINGES):
        entity = found[f"t/joints/hinge_{hinge}"]
        assert_allclose(entity.times[SIM_TIME]["Scalars:scalars"], trial.camera.time_s, atol=1e-8)
        assert_allclose(values(found, f"t/joints/hinge_{hinge}"), joint_angles(trial)[:, hinge], atol=1e-9)
        mark = found[f"t/scene/object/link_{hinge + 1}/hinge"].static["Points3D:positions"]
        assert_allclose(mark, [[*place, FOLD.shape.height]], atol=1e-6)
    assert "t/scene/object/link_0/outline" in found
    labels = found["t/scene/object/link_2/cells"].static["Boxes3D:labels"]
    assert all(label.startswith("link 2, ") for label in labels)


def test_a_recording_of_a_push_has_its_contact_and_direction(pushes, tmp_path):
    trial = pushes[0]
    push, found = trial.action, recorded(tmp_path / "x.rrd", BLOCKS, trial)
    height = push.fingertip(BLOCKS.shape).height
    assert_allclose(found["t/scene/object/contact"].static["Points3D:positions"], [[*push.point, height]], atol=1e-6)
    arrow = found["t/scene/object/push"].static
    vector = np.array(arrow["Arrows3D:vectors"][0])
    assert_allclose(math.atan2(vector[1], vector[0]), push.direction, atol=1e-5)
    assert_allclose(arrow["Arrows3D:origins"][0] + vector, [*push.point, height], atol=1e-6)
    path = np.array(found["t/scene/object/contact_path"].static["LineStrips3D:strips"][0])
    assert_allclose(path[1:, :2], contact_path(BLOCKS.shape, trial), atol=1e-6)


def test_the_steady_samples_of_a_push_are_those_of_its_windows(pushes):
    steady = wrench_fit("", pushes[0], None).steady
    assert set(np.flatnonzero(steady)) == set(np.concatenate(push_samples(pushes[0])))
