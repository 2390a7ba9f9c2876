"""Lifts: the profile, what the bench refuses, and the wrench against Newton and Euler."""

import math

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from estimators.testing.analytic_world import record
from estimators.wrench.air import Air
from scenarios.views.pages import page_of
from scenarios.views.values import trial_view
from testbed import Lift, Phase, SimulationRunner, draw_sensing, load_object, preset, steady_windows
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.sensing.lift_windows import lift_windows, poses_in_space
from testbed.simulation.rendering import Playback
from testbed.simulation.settings import GripSettings, SimulationSettings
from testbed.trial import OWN_WEIGHT, RIGID, Support, Trial
from tests.helpers.blocks import blocks
from tests.helpers.simulated import put_trial
from viz.recordings.page import save

RUNNER = SimulationRunner()
CORNER = ["10", "11"]
STILL = Lift(1, tilt=0.0, hold=1.2)
TOOL = 0.925
"""Mass of the gripper, kg."""
SAG = 0.0025
"""Greatest sag of the object between the pads [m]: compression of the felt under the feet and of the pads."""


def measured_and_expected(obj: ObjectModel, action: Lift) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Wrench of every stretch, that of Newton and Euler, and its slope in the object's height [1/m], each (K, 6)."""
    windows = lift_windows(draw_sensing(RUNNER.run_clean(Trial(obj, action, RIGID)), preset("ideal"), 0))
    at = {"mass": torch.tensor(obj.truth.mass), "place": torch.zeros(3, dtype=torch.float64)}
    expected, slopes = Air.of_masses(obj.shape, windows).linearized(at)
    return np.array([w.wrench for w in windows]), expected.numpy(), slopes["place"][..., 2].numpy()


@pytest.mark.parametrize(
    "action",
    [
        Lift(0),
        Lift(0, tilt=0.05, swings=3, acceleration=4.0, poses=3),
        Lift(0, swings=0),
        Lift.stop_and_go(0),
        Lift.stop_and_go(0, tilt=0.0),
        Lift(0, tilt=0.3, poses=4, acceleration=1.0),
    ],
)
def test_a_lift_goes_up_rocks_about_each_axis_and_comes_down(action):
    profile = action.sampled(0.01)
    assert_allclose(profile.height[[0, -1]], 0, atol=1e-4)
    assert_allclose(profile.angle[-1], 0, atol=1e-12)
    assert profile.height.max() == pytest.approx(action.height)
    assert_allclose(np.abs(profile.angle).max(axis=0), action.tilt, rtol=1e-6)
    assert ((profile.angle != 0).sum(axis=1) <= 1).all()
    middle = (profile.rate[1:] + profile.rate[:-1]) / 2
    assert_allclose(np.diff(profile.angle, axis=0), middle * 0.01, atol=1e-4 * action.tilt)
    for segment in range(profile.segment.max() + 1):
        inside = profile.segment == segment
        found = np.abs(profile.acceleration[inside]).max(axis=1)
        assert_allclose(found, found[0])
        assert (found[0] > 0) == action.accelerates(segment)
        assert_allclose(found[0], action.acceleration if action.accelerates(segment) else 0, rtol=0.1)


@pytest.mark.parametrize("swings", [0, 3, 4])
def test_it_holds_still_at_every_tilt_about_both_axes(swings):
    action = Lift(0, tilt=0.3, poses=4, swings=swings, acceleration=1.0)
    profile = action.sampled(0.01)
    still = [s for s in range(profile.segment.max() + 1) if not action.accelerates(s)]
    held = np.array([profile.angle[profile.segment == segment][-1] for segment in still])
    for axis in (0, 1):
        about = held[held[:, axis] != 0, axis]
        assert_allclose(np.unique(about.round(9)), [-0.3, -0.1, 0.1, 0.3], atol=1e-6)
    moves = [s for s in range(profile.segment.max() + 1) if action.accelerates(s)]
    assert len(moves) >= 3 * (swings or 6)


@pytest.mark.parametrize("rate", [96, 110, 128])
def test_its_stretches_are_the_same_at_any_rate(rate):
    action = Lift.stop_and_go(0)
    profile = action.sampled(1 / rate)
    for segment in range(profile.segment.max() + 1):
        moves = bool((profile.acceleration[profile.segment == segment] != 0).any())
        assert moves == action.accelerates(segment)


def test_it_goes_as_high_as_its_tilt_needs():
    shape = load_object("I2").shape
    steep = Lift(0, tilt=0.5, height=0.02)
    assert Lift(0, tilt=0.0, height=0.02).clear_height(shape) == pytest.approx(0.02)
    low = np.abs(shape.particles - shape.grasps[0].position).max() * math.sin(0.5)
    assert low < steep.clear_height(shape) < low + 0.03
    assert steep.sampled(0.01, 0.3).height.max() == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("obj", "action", "support", "reason"),
    [
        (load_object("L2"), Lift(2), OWN_WEIGHT, "support"),
        (load_object("L2"), Lift(2), Support(1e4), "support"),
        (blocks(CORNER, [1.0, 1.0, 0.7]), Lift(1), RIGID, "payload"),
        (load_object("I2"), Lift(0), RIGID, "grip"),
        (load_object("L2"), Lift(2, acceleration=6.0), RIGID, "speed"),
    ],
)
def test_an_infeasible_lift_is_refused_before_it_moves(obj, action, support, reason):
    with pytest.raises(InfeasibleTrialError, match=f"^{reason}"):
        RUNNER.check(Trial(obj, action, support))


@pytest.mark.slow
def test_a_runner_without_checks_lets_an_object_slip():
    gentle = SimulationSettings(grip=GripSettings(force=20.0))
    trial = Trial(blocks(["1111"], [0.3] * 4), Lift(0, tilt=0.0), RIGID)
    with pytest.raises(InfeasibleTrialError, match="grip"):
        SimulationRunner(gentle).run_clean(trial)
    slipped = SimulationRunner(gentle, refuses=False).run_clean(trial)
    assert slipped.status == "slipped"
    assert "in the grip" in slipped.reason


def test_a_lift_is_no_turn():
    with pytest.raises(InvalidValueError, match="lift_windows"):
        steady_windows(record(action=STILL))


@pytest.mark.parametrize("mass", [[0.5, 0.1, 0.3], [0.0005, 0.0003, 0.0004]])
def test_at_rest_the_wrench_is_the_weight_at_the_center_of_mass(mass):
    """An object of almost no mass leaves the tool alone, compensated."""
    obj = blocks(CORNER, mass)
    measured, expected, _ = measured_and_expected(obj, STILL)
    tolerance = max(0.005 * obj.total_mass, 5e-4 * TOOL) * GRAVITY
    assert_allclose(measured[:, :3], expected[:, :3], atol=tolerance)
    assert_allclose(measured[:, 3:], expected[:, 3:], atol=0.05 * tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("make", [Lift, Lift.stop_and_go])
@pytest.mark.parametrize("name", ["L2", "tool alone"])
def test_tilted_and_rocked_the_wrench_is_newtons_and_eulers(name, make):
    obj = load_object(name) if name == "L2" else blocks(CORNER, [5e-4, 3e-4, 4e-4])
    action = make(2 if name == "L2" else 1)
    measured, expected, with_height = measured_and_expected(obj, action)
    low = with_height.ravel() @ (measured - expected).ravel() / np.sum(with_height**2)
    assert abs(low) < SAG or name != "L2"
    missing = measured - expected - low * with_height
    weight = (obj.total_mass + TOOL * math.sin(action.tilt)) * GRAVITY
    assert_allclose(missing[:, :3], 0, atol=0.005 * weight)
    assert_allclose(missing[:, 3:], 0, atol=0.005 * weight * 0.1)


@pytest.mark.slow
def test_a_lift_is_shown_in_space(tmp_path):
    key = put_trial(tmp_path, "L2", Lift(2, tilt=0.1, swings=0, hold=0.1, height=0.12), RIGID)
    shown = trial_view(tmp_path, key, meshes=False)
    assert shown.title.startswith("L2: lift at A2")
    place, axes = poses_in_space(shown.trajectory)
    steady = shown.trajectory.mask(Phase.STEADY)
    assert_allclose(place[0, 2], 0, atol=1e-3)
    assert place[steady, 2].max() == pytest.approx(0.12, abs=0.02)
    assert_allclose(np.arccos(axes[steady, 2, 2]).max(), 0.1, atol=0.01)
    grasp = shown.shape.grasps[2].position
    held = place + axes @ [*grasp, shown.trajectory.tcp_position[~steady][200, 2]]
    assert_allclose(held[steady], shown.trajectory.tcp_position[steady], atol=2e-3)
    save(page_of(tmp_path, key[:6]), tmp_path / "lift.rrd")
    playback = Playback(shown.trajectory, load_object("L2"), (0.05, 0.085), meshes=False)
    playback.show(int(np.flatnonzero(steady)[-1]))
    body = playback.data.body("object")
    assert_allclose(body.xpos - 0.015 * body.xmat.reshape(3, 3)[:, 2], place[np.flatnonzero(steady)[-1]], atol=1e-9)
