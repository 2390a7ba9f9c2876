"""Tests of pushes in MuJoCo: contact, motion, poses by a camera, playback, and refusals."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh

from estimators.hidden_states.estimator import HiddenStates
from estimators.particles.wrench import predicted_wrenches
from estimators.testing.analytic_world import drawn_object
from testbed import RIGID, InfeasibleTrialError, Push, SimulationRunner, Trial, WorldDraw, draw_sensing, preset, world
from testbed.frames import rotation_2d
from testbed.objects.faces import faces, room_at
from testbed.objects.meshes import Part, mesh_object
from testbed.objects.model import GRAVITY, STROKE
from testbed.sensing.push_windows import push_samples, push_windows, touching
from testbed.sensing.windows import wrench_in_object
from testbed.simulation.rendering import Playback
from testbed.trajectory import Trajectory
from tests.helpers.blocks import blocks

BLOCKS = drawn_object(3, ["11", "11", "11"])
RUNNER = SimulationRunner()


@cache
def through_the_middle() -> Trajectory:
    """Clean record of a push through the middle of the blocks."""
    return RUNNER.run_clean(Trial(BLOCKS, Push((-0.05, float(BLOCKS.center_of_mass[1])), 0.0, speed=0.05, length=0.08)))


def pushes(count: int, seed: int) -> list[Push]:
    """Pushes of random faces of the blocks."""
    rng, every = np.random.default_rng(seed), faces(BLOCKS.shape)
    found = []
    for _ in range(count):
        face = every[rng.integers(len(every))]
        x, y = (face.begin + rng.uniform(0.1, 0.9) * (face.end - face.begin)).tolist()
        found.append(Push((x, y), math.atan2(*-face.normal[::-1]) + rng.uniform(-0.5, 0.5)))
    return found


@pytest.mark.slow
def test_a_push_through_the_middle():
    """The object goes with the fingertip, against its friction; a camera sees it, and the hand does not."""
    (x, y), clean = BLOCKS.center_of_mass, through_the_middle()
    assert clean.ok and clean.reason == "" and clean.camera is not None and x > -0.05
    drag = BLOCKS.truth.friction[0] * BLOCKS.total_mass * GRAVITY
    drawn = draw_sensing(clean, preset("ideal"), 0)
    windows = push_windows(drawn)
    assert len(windows) >= 2
    for window in windows:
        assert window.wrench[0] == pytest.approx(drag, rel=0.02) and abs(window.wrench[5]) < 0.02 * drag * 0.1
        assert window.twist[:2] == pytest.approx([0.05, 0.0], abs=2e-3) and abs(window.twist[2]) < 0.05
        assert window.point is not None and window.point == pytest.approx([-0.056, y], abs=2e-3)
    travelled = np.linalg.norm(np.ptp(clean.camera.poses[:, 0, :2], axis=0))
    assert travelled == pytest.approx(0.08, abs=0.004)
    # it meets the object after the gap, and no sooner
    began = drawn.time_s[touching(drawn)[0]] - drawn.time_s[np.flatnonzero(drawn.segment >= 0)[0]]
    assert 0.0 <= began < 0.1
    seen = draw_sensing(clean, preset("ft300s"), 1)
    assert seen.camera is not None and len(seen.camera.time_s) < len(clean.time_s) / 3
    assert np.abs(seen.object_pose - clean.object_pose).max() < 0.02 and (seen.object_pose != clean.object_pose).any()
    assert len(push_windows(seen)) >= 2


@pytest.mark.slow
def test_a_fingertip_slides_along_a_face_without_bouncing():
    """The force of a push is as steady as its motion: at every scale of time it follows its parabola."""
    push = Push((-0.05, 0.03), math.radians(-35), length=0.1)
    drawn = draw_sensing(RUNNER.run_clean(Trial(BLOCKS, push)), preset("ideal"), 0)
    drag = BLOCKS.truth.friction[0] * BLOCKS.total_mass * GRAVITY
    parts = push_samples(drawn)
    assert len(parts) >= 3
    for kept in parts:
        force, since = drawn.wrench_on_object_world[kept, :2], drawn.time_s[kept] - drawn.time_s[kept[0]]
        fit = np.polynomial.polynomial.polyfit(since, force, 2)
        left = force - np.polynomial.polynomial.polyval(since, fit).T
        assert np.sqrt((left**2).sum(1).mean()) < 0.02 * drag


@pytest.mark.slow
def test_playback_shows_the_fingertip_at_the_object():
    """The hand is closed, and the drawn fingertip touches the outline."""
    clean = through_the_middle()
    fingertip = clean.action.fingertip(BLOCKS.shape)
    assert fingertip is not None
    shown = Playback(clean, BLOCKS, (0.0, 0.085), meshes=False)
    sample = int(touching(draw_sensing(clean, preset("ideal"), 0))[-1])
    shown.show(sample)
    x, y, yaw = clean.object_pose[sample]
    tip = rotation_2d(-yaw) @ (shown.data.geom("fingertip").xpos[:2] - [x, y])
    assert room_at(BLOCKS.shape, tip) == pytest.approx(0.006, abs=3e-4)
    assert shown.data.geom("fingertip").xpos[2] == pytest.approx(fingertip.height, abs=5e-4)
    assert shown.data.qpos[shown.model.joint("gripper/left_finger").qposadr[0]] == pytest.approx(STROKE / 2)


@pytest.mark.slow
def test_a_push_that_loses_the_object_keeps_what_it_had():
    face = next(face for face in faces(BLOCKS.shape) if face.normal[0] < 0)
    point = face.begin + 0.1 * (face.end - face.begin)
    x, y = (point if abs(point[1]) > abs(face.end[1]) else face.end - 0.1 * (face.end - face.begin)).tolist()
    lost = RUNNER.run_clean(Trial(BLOCKS, Push((x, y), 0.0, length=0.2, speed=0.05)))
    assert lost.ok and lost.reason.startswith("the fingertip left the object")
    assert len(push_windows(draw_sensing(lost, preset("ideal"), 0))) >= 1
    assert lost.figures["contact_s"] < 4.0


@pytest.mark.slow
def test_a_push_that_tips_the_object_is_no_data():
    """On few points of contact, pushed into a corner, a row of light and heavy blocks goes over its edge."""
    masses = [0.468, 0.114, 0.359, 0.059, 0.433, 0.34]
    tips = blocks(["01111", "11000"], masses, 0.59)
    push = Push((-0.016667, -0.05024), -2.963, curvature=0.883, speed=0.03)
    draw = WorldDraw.of(world("lab"), tips, 2, "tipping")
    tipped = RUNNER.run_clean(Trial(tips, push, world=draw))
    assert tipped.status == "slipped" and tipped.reason.startswith("the object tipped by 5 deg at ")
    assert len(tipped.time_s) < len(RUNNER.run_clean(Trial(tips, push)).time_s)


def test_what_cannot_be_pushed_is_refused():
    ring = drawn_object(3, ["111", "101", "111"])
    hole = Push((0.025, 0.0), 0.0, radius=0.03)
    inwards = Push((-0.05, 0.0), 0.0)
    refused = [
        (BLOCKS, Push((0.0, 0.0), 0.0), "push"),
        (BLOCKS, Push((-0.05, 0.0), math.pi), "push"),
        (BLOCKS, replace(inwards, length=2.0), "table|reach"),
        (ring, hole, "push: .* smaller fingertip"),
    ]
    for obj, action, message in refused:
        with pytest.raises(InfeasibleTrialError, match=message):
            RUNNER.check(Trial(obj, action))
    RUNNER.check(Trial(ring, replace(hole, radius=0.006)))


def test_a_plate_of_a_millimeter_is_pushed_by_its_edge():
    """A low mesh on points of contact: a disc meets it at half its height, and feels mu M g less what it carries."""
    sheet = trimesh.creation.box(bounds=[[0, 0, 0], [0.16, 0.04, 0.001]])
    corners = [(0.002, 0.002), (0.002, 0.038), (0.158, 0.002), (0.158, 0.038)]
    parts = [Part("sheet", sheet, 0.05, 0)]
    plate = mesh_object("sheet", parts, [], friction=[0.5], cell=0.005, grid=3, contacts=corners)
    x, y = min((face.begin[0] for face in faces(plate.shape)), default=0.0), float(plate.center_of_mass[1])
    push = Push((float(x), y), 0.0, speed=0.05)
    assert push.fingertip(plate.shape).height == pytest.approx(5e-4)
    clean = RUNNER.run_clean(Trial(plate, push, RIGID))
    assert clean.ok and clean.reason == ""
    drawn = draw_sensing(clean, preset("ideal"), 0)
    predicted = predicted_wrenches(plate.shape, plate.truth, [drawn])[0]
    within = ~np.isnan(predicted[:, 0])
    missing = predicted[within] - wrench_in_object(drawn)[within][:, [0, 1, 5]]
    assert within.sum() > 100 and np.abs(missing.mean(axis=0)).max() < 0.02 * 0.5 * plate.total_mass * GRAVITY
    for window in push_windows(drawn):
        carried = plate.total_mass * GRAVITY - window.wrench[2]
        assert window.wrench[0] == pytest.approx(0.5 * carried, rel=0.02)
        assert window.point is not None and window.point == pytest.approx([x - 0.006, y], abs=2e-3)


@pytest.mark.slow
def test_masses_from_pushes_in_mujoco():
    trials = [draw_sensing(RUNNER.run_clean(Trial(BLOCKS, push)), preset("ideal"), 0) for push in pushes(12, 3)]
    found = HiddenStates().estimate(BLOCKS.shape, BLOCKS.total_mass, trials, 0)
    assert found.distribution is not None
    assert np.abs(found.distribution.mass - BLOCKS.truth.mass).sum() / BLOCKS.truth.mass.sum() < 0.05
