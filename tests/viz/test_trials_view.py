"""Pushes and objects in links as they are drawn: contact points, directions, links, hinges and joint angles."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.patches import FancyArrowPatch
from numpy.testing import assert_allclose

from estimators.testing.analytic_world import drawn_object
from scenarios.views.values import wrench_fit
from testbed.actions.push import Push
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.actions.weigh import Weigh
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.sensing.push_windows import contact_path, push_samples, push_windows
from testbed.simulation.rendering import body_poses
from testbed.trajectory import Trajectory
from tests.fakes.analytic_links import analytic_links
from tests.fakes.analytic_push import analytic_pushes
from tests.helpers.chunks import Entity, logged
from tests.helpers.rows import row
from viz.figures.trials import trials_figure
from viz.recordings.page import SIM_TIME, Page
from viz.recordings.trial import log_trial, trial_blueprint
from viz.report.report import Results, render
from viz.report.trials import trials_table
from viz.trials import TrialsView
from viz.values import ActionArrow, TrialView

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
    """Entities of a trial's recording."""
    poses = body_poses(trajectory, (0.02, 0.04), meshes=False, every=100)
    fit = wrench_fit("", trajectory, None)
    view = TrialView("", model.shape, trajectory, poses, trajectory.time_s[::100], fit, truth=model.truth)
    return logged(
        Page("x", "x", lambda stream: log_trial(stream, "t", view), trial_blueprint("t", view), SIM_TIME), path
    )


@pytest.mark.slow
def test_contact_points_lie_on_the_outline_where_the_fingertip_is(pushes):
    push, trial = pushes[0].action, pushes[0]
    path = contact_path(BLOCKS.shape, trial)
    tips = np.array([window.point for window in push_windows(trial)])
    assert_allclose(path[:, 0], -SIDE, atol=1e-9)
    assert_allclose(path, tips + np.array([push.radius, 0.0]), atol=1e-6)
    assert np.ptp(path[:, 1]) > 1e-3


@pytest.mark.slow
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


@pytest.mark.slow
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
            yaw = trial.camera.poses[:, :, 2]
            assert_allclose(
                np.asarray(lines[f"joint_{number}_{hinge}"].get_ydata()), np.degrees(yaw[:, hinge + 1] - yaw[:, hinge])
            )


@pytest.mark.slow
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
    angle = np.degrees(np.diff(drags[1].camera.poses[:, :, 2], axis=1))[:, 1]
    low, high = (float(value) for value in table.rows[1][1][1].text.split(" to "))
    assert_allclose([low, high], [angle.min(), angle.max()], atol=0.051)


@pytest.mark.slow
def test_a_recording_of_links_has_hinges_and_joint_angles(drags, tmp_path):
    trial = drags[0]
    found = recorded(tmp_path / "x.rrd", FOLD, trial)
    for hinge, place in enumerate(HINGES):
        entity = found[f"t/joints/hinge_{hinge}"]
        assert_allclose(entity.times[SIM_TIME]["Scalars:scalars"], trial.camera.time_s, atol=1e-8)
        values = np.squeeze(np.array(entity.values[SIM_TIME]["Scalars:scalars"]))
        yaw = trial.camera.poses[:, :, 2]
        assert_allclose(values, np.degrees(yaw[:, hinge + 1] - yaw[:, hinge]), atol=1e-9)
        mark = found[f"t/scene/object/link_{hinge + 1}/hinge"].static["Points3D:positions"]
        assert_allclose(mark, [[*place, FOLD.shape.height]], atol=1e-6)
    assert "t/scene/object/link_0/outline" in found
    labels = found["t/scene/object/link_2/cells"].static["Boxes3D:labels"]
    assert all(label.startswith("link 2, ") for label in labels)


def test_a_push_that_meets_no_face_is_drawn():
    """Shape of another mapping or object file."""
    push = Push((0.0, 0.0), 0.5)
    arrow = ActionArrow.of(BLOCKS.shape, push)
    assert_allclose(arrow.way[-1], push.point)
    assert_allclose(np.arctan2(*(arrow.way[-1] - arrow.way[0])[::-1]), push.direction)


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_steady_samples_of_a_push_are_those_of_its_windows(pushes):
    steady = wrench_fit("", pushes[0], None).steady
    assert set(np.flatnonzero(steady)) == set(np.concatenate(push_samples(pushes[0])))
