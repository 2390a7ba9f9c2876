"""Tests of pushes: their physics in the analytic world, their windows, and what methods make of them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.hidden_states.estimator import HiddenStates
from estimators.identifiability.quasi_static import Drag
from estimators.particles.load_groups import LoadGroups, rank_of
from estimators.particles.wrench import predicted_wrenches
from estimators.posterior import table_errors
from estimators.registry import build_method
from estimators.testing.analytic_world import drawn_object
from estimators.wrench.model import ParticleModel
from testbed.actions.push import Push
from testbed.errors import InvalidValueError
from testbed.sensing.camera import CAMERAS, draw_camera
from testbed.sensing.push_windows import WINDOW, push_windows, touching
from testbed.sensing.windows import wrench_in_object
from tests.fakes.analytic_push import analytic_pushes, drag_of, steady_pushes
from tests.helpers.answers import ask, claimed, found, windows_of

BLOCKS = drawn_object(3, ["11", "11", "11"])
"""2 x 3 blocks of known masses, which no hand can grip across."""
CENTERS = np.random.default_rng(1).uniform(-0.2, 0.2, (8, 2))


def test_a_pushed_disc():
    grid = np.arange(-40, 41) * 1e-3
    cells = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    cells = cells[np.linalg.norm(cells, axis=1) < 0.04]
    disc = Drag(cells, np.full(len(cells), 3.0 / len(cells)))
    still = np.zeros(2)
    assert disc.wrench(np.array([0.02, 0.0, 0.0]), still) == pytest.approx([3.0, 0.0, 0.0], abs=1e-9)
    assert disc.wrench(np.array([0.0, 0.0, 1.0]), still)[2] == pytest.approx(2 / 3 * 3.0 * 0.04, rel=0.01)
    # through its center it does not turn; beside it, it turns away
    ahead = np.array([[1.0, 0.0], [1.0, 0.0]])
    twists = disc.pushed(np.array([[-0.04, 0.0], [-0.04, 0.01]]), 0.03 * ahead, ahead, np.array([0.4, 0.4]))
    assert twists[0] == pytest.approx([0.03, 0.0, 0.0], abs=1e-9)
    assert twists[1, 2] < -0.05


def test_friction_is_on_a_convex_limit_surface_and_along_its_normal():
    drag, rng = drag_of(BLOCKS), np.random.default_rng(0)
    twists = rng.normal(size=(60, 3)) * [0.03, 0.03, 0.5]
    wrenches = np.array([drag.wrench(twist, np.zeros(2)) for twist in twists])
    power = wrenches @ twists.T
    assert (np.diag(power)[None] >= power - 1e-12).all()  # no other wrench of the surface does more work on a twist


def test_the_fingertip_sticks_or_slides_at_the_edge_of_its_cone():
    drag, normal, point = drag_of(BLOCKS), np.array([1.0, 0.0]), np.array([-0.05, 0.02])
    angles = np.radians([-50, -20, 0, 20, 50])
    velocities = 0.03 * np.column_stack([np.cos(angles), np.sin(angles)])
    twists = drag.pushed(np.tile(point, (5, 1)), velocities, np.tile(normal, (5, 1)), np.full(5, 0.3))
    slid = []
    for velocity, twist in zip(velocities, twists, strict=True):
        force = drag.wrench(twist, point)
        assert twist[0] == pytest.approx(velocity[0]) and force[2] == pytest.approx(0, abs=1e-9)
        steep = abs(force[1]) / force[0]
        slid.append(abs(twist[1] - velocity[1]) > 1e-9)
        assert steep == pytest.approx(0.3) if slid[-1] else steep <= 0.3
        # friction at the fingertip goes against its slip
        assert not slid[-1] or force[1] * (velocity[1] - twist[1]) > 0
    assert any(slid) and not all(slid)


@pytest.mark.slow
def test_masses_from_pushes_without_noise():
    trials = steady_pushes(BLOCKS, CENTERS)
    methods = {name: (build_method(name, {}), 3e-5) for name in ("least_squares", "cma_es")}
    for name, (method, most) in ({"hidden_states": (HiddenStates(pivot_error=1e-7), 1e-6)} | methods).items():
        answer = ask(BLOCKS, trials, method)
        assert answer.status == "ok" and np.abs(found(answer).mass / BLOCKS.truth.mass - 1).max() < most, name
    answer = ask(BLOCKS, trials, build_method("support_aware", {}))
    off = np.abs(found(answer).mass - BLOCKS.truth.mass)
    assert (off < 0.5 * claimed(answer)).all()  # shrinkage toward the prior


@pytest.mark.parametrize("speed", [0.1, 0.2])
def test_a_fast_push_has_windows_over_as_long_a_way(speed):
    push = Push((0.05, -0.01), math.radians(-160), length=0.12, speed=speed, friction=3.0)
    assert push.pace == pytest.approx(0.05 / speed)
    trial = analytic_pushes(BLOCKS, [push])[0]
    windows = push_windows(trial)
    assert windows and all(np.ptp(w.since_tare) < 2 * WINDOW * push.pace for w in windows)
    predicted = predicted_wrenches(BLOCKS.shape, BLOCKS.truth, [trial])[0]
    inside, measured = ~np.isnan(predicted[:, 0]), wrench_in_object(trial)[:, [0, 1, 5]]
    assert inside.any()
    off = (predicted - measured)[inside].mean(axis=0)  # a window has one wrench, that of its mean
    assert (np.abs(off) < [0.03, 0.03, 0.1] * np.abs(measured[inside]).max(axis=0)).all()


@pytest.mark.slow
def test_the_rank_of_q_grows_within_one_push():
    push = Push((0.05, -0.01), math.radians(-160), length=0.1, speed=0.05, friction=3.0)
    windows, model = windows_of(BLOCKS, analytic_pushes(BLOCKS, [push])), ParticleModel.of(BLOCKS.shape)
    assert bool(windows.pushed.all())
    q = LoadGroups.of(model).gather(windows.drag_rows(model, 0.0)).numpy()
    ranks = [rank_of(q[: count + 1].reshape(-1, 6)) for count in range(len(windows))]
    assert ranks == sorted(ranks) and ranks[0] <= 3 < ranks[-1]


def test_the_answer_explains_the_wrench_sample_by_sample():
    trial = steady_pushes(BLOCKS, CENTERS[:1], seconds=2.0)[0]
    predicted = predicted_wrenches(BLOCKS.shape, BLOCKS.truth, [trial])[0]
    inside = ~np.isnan(predicted[:, 0])
    assert inside.sum() > 150 and np.abs(predicted - wrench_in_object(trial)[:, [0, 1, 5]])[inside].max() < 1e-4


def test_windows_are_of_the_stretch_in_contact_that_the_camera_saw():
    trial = steady_pushes(BLOCKS, CENTERS[:1], seconds=2.0)[0]
    wrench = np.array(trial.wrench_on_object_world)
    wrench[150:] = 0.0
    lost = replace(trial, wrench_on_object_world=wrench)
    assert touching(lost)[-1] in range(146, 153)
    assert len(push_windows(lost)) == 2 < len(push_windows(trial)) == 4
    for bad in (
        replace(trial, camera=None),
        replace(trial, status="fault"),
        replace(lost, wrench_on_object_world=0 * wrench),
    ):
        with pytest.raises(InvalidValueError):
            push_windows(bad)
    # without frames in its second half, what was seen still counts
    assert trial.camera is not None
    poses = np.array(trial.camera.poses)
    poses[100:] = np.nan
    assert 0 < len(push_windows(replace(trial, camera=replace(trial.camera, poses=poses)))) < 4


@pytest.mark.slow
def test_intervals_hold_under_a_camera(monkeypatch):
    monkeypatch.setattr(table_errors, "PUSH_ERROR", 0.0)  # this world has no errors but the camera's
    rng, inside = np.random.default_rng(1), []
    for seed in range(10):
        trials = steady_pushes(BLOCKS, rng.uniform(-0.2, 0.2, (12, 2)), seconds=2.0)
        seen = [draw_camera(t.camera, CAMERAS["30hz"], 100 * seed + i) for i, t in enumerate(trials) if t.camera]
        answer = ask(BLOCKS, [replace(t, camera=c) for t, c in zip(trials, seen, strict=True)])
        inside.append(np.abs(found(answer).mass - BLOCKS.truth.mass) < 1.96 * claimed(answer))
    assert 0.88 < np.mean(inside) < 0.995
