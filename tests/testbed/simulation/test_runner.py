"""Whole trials on the simulated bench, held against the true contact forces and against Coulomb's law."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from testbed.actions.accelerate import Accelerate
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.actions.weigh import Weigh
from testbed.errors import InfeasibleTrialError
from testbed.frames import cross_2d, perpendicular, rotation_2d
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.files import load_object
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.sensing.compensation import compensate
from testbed.sensing.windows import SteadyWindow, steady_windows, weight_of
from testbed.simulation import feasibility
from testbed.simulation.controller import Servo
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.settings import GripSettings, SimulationSettings
from testbed.trajectory import Phase
from testbed.trial import OWN_WEIGHT, RIGID, Trial, TrialRunner

RUNNER = SimulationRunner()
TURN = Rotate(2, duration=2.5, pivot=(-0.0333, 0.025))


def row(mass: list[float], friction: float = 0.5, size: float = 0.05, height: float = 0.03) -> ObjectModel:
    """Blocks in a row."""
    cells = parse_layout(["1" * len(mass)])
    groups = [0] * len(mass)
    return block_object(
        "row", cells, size=size, height=height, mass=mass, friction=[friction], friction_group=groups, grid=3
    )


def coulomb(obj: ObjectModel, window: SteadyWindow, rigid: bool) -> np.ndarray:
    """Planar wrench that friction takes, from weights and what the gripper was measured to carry: plain numpy."""
    shape = obj.shape
    grasp = shape.grasps[window.grasp].position
    arm = shape.particles - grasp
    fx, fy, fz, tx, ty, _ = window.wrench
    moment = np.array([ty + window.tcp_height * fx, -tx + window.tcp_height * fy])
    if rigid:
        basis = np.column_stack([np.ones(len(arm)), arm])
        balance = np.append(obj.total_mass * GRAVITY - fz, GRAVITY * obj.particle_mass @ arm + moment)
        load = basis @ np.linalg.solve(basis.T @ basis, balance)
    else:
        centre = np.array([shape.particles[shape.mass_group == g].mean(axis=0) for g in range(shape.n_m)])
        offset = shape.particles - centre[shape.mass_group]
        tilt = offset / (offset**2).sum(axis=0)
        held = shape.mass_group == shape.mass_group[np.argmin(np.linalg.norm(arm, axis=1))]
        load = obj.particle_mass * GRAVITY + tilt @ moment - held * fz / held.sum()
    velocity = window.twist[:2] + window.twist[2] * perpendicular(arm)
    force = (obj.truth.friction[shape.friction_group] * load / np.linalg.norm(velocity, axis=1))[:, None] * velocity
    return np.append(force.sum(axis=0), cross_2d(arm, force).sum())


@pytest.mark.parametrize("support", [OWN_WEIGHT, RIGID], ids=lambda s: s.name)
def test_the_sensor_shows_the_true_contact_force(support):
    trajectory, contacts = RUNNER.run_with_contacts(Trial(load_object("L2"), TURN, support))
    assert trajectory.ok
    felt = compensate(trajectory).wrench_on_object_world
    steady = trajectory.mask(Phase.STEADY)
    difference = (felt + contacts.wrench_at_tcp)[steady].mean(axis=0)
    scale = np.linalg.norm(felt[steady][:, :2], axis=1).mean()
    assert np.abs(difference[:2]).max() < 5e-3 * scale
    assert abs(difference[5]) < 5e-3 * abs(felt[steady][:, 5].mean())


@pytest.mark.parametrize("support", [OWN_WEIGHT, RIGID], ids=lambda s: s.name)
@pytest.mark.parametrize("action", [TURN, Slide(1, direction=0.4, duration=2.5)], ids=["turn", "slide"])
def test_the_drag_is_coulombs(support, action):
    obj = load_object("L2")
    (window,) = steady_windows(RUNNER.run(Trial(obj, action, support)))
    expected = coulomb(obj, window, support.is_rigid)
    scale = 0.5 * obj.total_mass * GRAVITY * np.array([1, 1, 0.1])
    assert_allclose((window.wrench[[0, 1, 5]] - expected) / scale, 0, atol=0.01)


def test_what_is_held_does_not_swing():
    """About a point by light blocks: too springy a pad lets arm and object swing unseen, and the torque is 1 % off."""
    obj = load_object("L2")
    (window,) = steady_windows(RUNNER.run(Trial(obj, Rotate(3, speed=-0.1074, duration=2.5, pivot=(0.025, -0.0779)))))
    scale = 0.5 * obj.total_mass * GRAVITY * np.array([1, 1, 0.1])
    missed = (window.wrench[[0, 1, 5]] - coulomb(obj, window, rigid=False)) / scale
    assert_allclose(missed[:2], 0, atol=0.005)
    assert abs(missed[2]) < 0.001


def test_there_and_back_flips_the_drag():
    windows = steady_windows(RUNNER.run(Trial(row([0.4, 0.2]), replace(TURN, grasp=0, pivot=(0.0, 0.01), back=True))))
    there, back = (w.wrench[[0, 1, 5]] for w in windows)
    assert_allclose(there, -back, atol=0.01 * 0.5 * 0.6 * GRAVITY)


def test_a_weighing_reads_the_mass():
    for support in (OWN_WEIGHT, RIGID):
        obj = load_object("F2")
        assert weight_of(RUNNER.run(Trial(obj, Weigh(), support))) == pytest.approx(obj.total_mass, rel=1e-5)


@pytest.mark.parametrize("name", ["hammer", "wrench"])
@pytest.mark.parametrize("support", [OWN_WEIGHT, RIGID], ids=lambda s: s.name)
def test_a_tool_weighs_what_it_should(name: str, support):
    obj = load_object(name)
    assert weight_of(RUNNER.run(Trial(obj, Weigh(), support))) == pytest.approx(obj.total_mass, rel=1e-3)


TURN_IN_BRIEF, STEPS = Rotate(0, duration=1.2, back=True), Accelerate(0)
TOOL_TURNS = [("hammer", "handle_mid", OWN_WEIGHT, TURN_IN_BRIEF), ("wrench", "shank_a", RIGID, STEPS)]
ALL_TOOL_TURNS = [
    pytest.param(name, grasp.name, support, action, marks=pytest.mark.slow)
    for name in ("hammer", "wrench")
    for grasp in load_object(name).shape.grasps
    for support in (OWN_WEIGHT, RIGID)
    for action in (replace(TURN_IN_BRIEF, duration=4.0), STEPS)
]


@pytest.mark.parametrize(("name", "grasp", "support", "action"), TOOL_TURNS + ALL_TOOL_TURNS)
def test_a_tool_drags_by_coulombs_law_on_its_own_feet(name: str, grasp: str, support, action):
    obj = load_object(name)
    index = [g.name for g in obj.shape.grasps].index(grasp)
    trajectory, contacts = RUNNER.run_with_contacts(Trial(obj, replace(action, grasp=index), support))
    assert trajectory.status == "ok", trajectory.reason
    steady = trajectory.mask(Phase.STEADY)
    force, lever = (
        contacts.force_on_object[steady],
        contacts.position[steady] - contacts.tcp_position[steady][:, None],
    )
    turn, velocity = rotation_2d(trajectory.object_pose[steady, 2]), trajectory.object_velocity[steady]
    feet = np.einsum("tij,pj->tpi", turn, obj.shape.particles[contacts.particle])
    slip = velocity[:, None, :2] + velocity[:, None, 2:] * perpendicular(feet)
    drag = obj.truth.friction[obj.shape.friction_group[contacts.particle]] * force[:, :, 2]
    off = force[:, :, :2] + drag[..., None] * slip / np.linalg.norm(slip, axis=2, keepdims=True)
    assert np.linalg.norm(off.sum(axis=1).mean(axis=0)) < 0.01 * drag.sum(axis=1).mean()
    torque = (drag * np.linalg.norm(lever[:, :, :2], axis=2)).sum(axis=1).mean()
    assert abs(cross_2d(lever[:, :, :2], off).sum(axis=1).mean()) < 0.01 * torque
    felt = compensate(trajectory).wrench_on_object_world[steady]
    difference = (felt + contacts.wrench_at_tcp[steady]).mean(axis=0)
    if isinstance(action, Rotate):  # in steps of acceleration its inertia is felt as well
        assert np.abs(difference[:2]).max() < 5e-3 * drag.sum(axis=1).mean()
        assert abs(difference[5]) < 5e-3 * torque


def test_feet_that_the_objects_own_weight_lifts_are_refused():
    obj = load_object("hammer")
    touching = obj.shape.friction_group.copy()
    end = np.flatnonzero((obj.shape.mass_group == 1) & (obj.shape.particles[:, 0] > 0.1))
    touching[obj.shape.mass_group == 1] = -1
    touching[end] = 1
    tipping = replace(obj, shape=replace(obj.shape, friction_group=touching))
    with pytest.raises(InfeasibleTrialError, match=r"rest: on own_weight the foot of handle at .* lift.*as rigid"):
        RUNNER.check(Trial(tipping, Rotate(0)))
    RUNNER.check(Trial(tipping, Rotate(0), RIGID))


def test_faces_that_the_pads_hardly_meet_are_refused():
    obj = load_object("hammer")
    low = replace(obj.shape.grasps[0], bottom=0.014, top=0.019)
    with pytest.raises(
        InfeasibleTrialError, match=r"grip: the faces of handle_neck are 14\.0 to 19\.0 mm over the table"
    ):
        RUNNER.check(Trial(replace(obj, shape=replace(obj.shape, grasps=(low,))), Rotate(0)))


def test_a_weld_feels_what_friction_feels():
    obj = load_object("I2")
    welded = SimulationRunner(SimulationSettings(grip=GripSettings(mode="weld")))
    (a,), (b,) = (
        steady_windows(r.run(Trial(obj, replace(TURN, grasp=1, pivot=(-0.07, 0.01))))) for r in (RUNNER, welded)
    )
    assert_allclose(a.wrench[5], b.wrench[5], rtol=5e-3)


def test_the_same_trial_gives_the_same_record():
    trial = Trial(row([0.3, 0.3]), Rotate(0, duration=1.6))
    first, second = RUNNER.run(trial), RUNNER.run(trial)
    assert np.array_equal(first.sensor_wrench, second.sensor_wrench)


def test_the_simulation_is_a_trial_runner():
    with SimulationRunner() as runner:
        assert isinstance(runner, TrialRunner)


@pytest.mark.parametrize(
    ("obj", "action", "why"),
    [
        (row([4.0, 4.0, 4.0]), Rotate(0), "grip: .*torque"),
        (row([0.4, 0.4], size=0.085), Rotate(0), r"grip: block A1 is 85 mm wide"),
        (row([0.4, 0.4], height=0.005), Rotate(0), "grip: the object is 5 mm high"),
        (row([0.4, 0.4]), Rotate(0, speed=2.0), r"speed: joint 7 .* move slower"),
        (row([0.4, 0.4]), Slide(0, duration=30.0), "reach: "),
    ],
    ids=["too heavy", "too wide", "too low", "too fast", "too far"],
)
def test_what_the_bench_cannot_do_is_refused_before_it_moves(obj, action, why):
    with pytest.raises(InfeasibleTrialError, match=why):
        RUNNER.run(Trial(obj, action))


def test_a_weak_joint_is_refused():
    strong = SimulationRunner(SimulationSettings(grip=GripSettings(mode="weld")))
    with pytest.raises(InfeasibleTrialError, match=r"torque: joint \d .* lighter object"):
        strong.run(Trial(row([8.0, 8.0, 8.0, 8.0]), Rotate(0)))


def test_slip_in_the_grip_ends_a_trial(monkeypatch):
    monkeypatch.setattr(feasibility, "MARGIN", 100.0)
    weak = SimulationRunner(SimulationSettings(grip=GripSettings(force=20.0, friction=0.1)))
    trajectory = weak.run(Trial(row([0.8, 0.8, 0.8]), Slide(0, duration=2.0)))
    assert trajectory.status == "slipped"
    assert "mm" in trajectory.reason
    assert trajectory.figures["slip_m"] > 0.003


def test_a_saturated_joint_ends_a_trial(monkeypatch):
    monkeypatch.setattr(feasibility, "check_feasible", lambda *_: None)
    monkeypatch.setattr("testbed.simulation.runner.check_feasible", lambda *_: None)
    welded = SimulationRunner(SimulationSettings(grip=GripSettings(mode="weld")))
    trajectory = welded.run(Trial(row([9.0, 9.0, 9.0, 9.0]), Rotate(0, duration=3.0)))
    assert trajectory.status == "limit"
    assert trajectory.reason.startswith("torque: joint")
    assert trajectory.figures["peak_torque_over_limit"] >= 0.999


def test_divergence_ends_a_trial_as_a_fault_with_its_state(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    measure = Servo.measure

    def explode(self: Servo, data: mujoco.MjData, tick: int) -> None:
        measure(self, data, tick)
        if tick == 150:
            data.qvel[0] = 1e11

    monkeypatch.setattr(Servo, "measure", explode)
    trajectory = RUNNER.run(Trial(row([0.3, 0.3]), Rotate(0, duration=2.0)))
    assert trajectory.status == "fault"
    assert "diverged at 1.5" in trajectory.reason
    assert "qpos" in trajectory.provenance["state"]
    assert len(trajectory.time_s) <= 152
    assert not list(tmp_path.iterdir())
