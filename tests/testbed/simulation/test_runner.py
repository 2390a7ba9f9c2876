"""Trials in simulation, compared with the true contact forces and with Coulomb's law."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from testbed import GRAVITY, Accelerate, ObjectModel, Phase, Rotate, SimulationRunner, Slide, Weigh, load_object
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.frames import cross_2d, perpendicular, rotation_2d, transform_point
from testbed.sensing.compensation import compensate
from testbed.sensing.windows import SteadyWindow, steady_samples, steady_windows, weight_of
from testbed.simulation import feasibility
from testbed.simulation.controller import Servo
from testbed.simulation.settings import GripSettings, SimulationSettings
from testbed.trial import OWN_WEIGHT, RIGID, Support, Trial
from tests.fakes.analytic_links import drawn_chain
from tests.helpers.blocks import blocks

RUNNER, SPRINGS = SimulationRunner(), Support(300.0)
TURN = Rotate(2, duration=2.5, pivot=(-0.0333, 0.025))


def row(mass: list[float], size: float = 0.05, height: float = 0.03) -> ObjectModel:
    return blocks(["1" * len(mass)], mass, size=size, height=height)


def coulomb(obj: ObjectModel, window: SteadyWindow, rigid: bool) -> np.ndarray:
    """Planar wrench that friction takes, from weights and what the gripper was measured to carry: plain numpy."""
    shape = obj.shape
    assert window.grasp is not None
    grasp = shape.grasps[window.grasp].position
    arm = shape.particles - grasp
    fx, fy, fz, tx, ty, _ = window.wrench
    moment = np.array([ty + window.tcp_height * fx, -tx + window.tcp_height * fy])
    if rigid:
        basis = np.column_stack([np.ones(len(arm)), arm])
        balance = np.append(obj.total_mass * GRAVITY - fz, GRAVITY * obj.particle_mass @ arm + moment)
        load = basis @ np.linalg.solve(basis.T @ basis, balance)
    else:
        center = np.array([shape.particles[shape.mass_group == g].mean(axis=0) for g in range(shape.n_m)])
        offset = shape.particles - center[shape.mass_group]
        tilt = offset / (offset**2).sum(axis=0)
        held = shape.mass_group == shape.mass_group[np.argmin(np.linalg.norm(arm, axis=1))]
        load = obj.particle_mass * GRAVITY + tilt @ moment - held * fz / held.sum()
    velocity = window.twist[:2] + window.twist[2] * perpendicular(arm)
    force = (obj.truth.friction[shape.friction_group] * load / np.linalg.norm(velocity, axis=1))[:, None] * velocity
    return np.append(force.sum(axis=0), cross_2d(arm, force).sum())


def missing(obj: ObjectModel, window: SteadyWindow, rigid: bool = False) -> np.ndarray:
    """Planar wrench beyond Coulomb's, as a part of the whole drag and of its moment at 0.1 m."""
    scale = 0.5 * obj.total_mass * GRAVITY * np.array([1, 1, 0.1])
    return (window.wrench[[0, 1, 5]] - coulomb(obj, window, rigid)) / scale


@cache
def turned(support: Support, every: int = 1):
    """Record of a turn of L2, and the contact forces at every `every`-th sample."""
    return RUNNER.run_with_contacts(Trial(load_object("L2"), TURN, support), every)


@pytest.mark.parametrize("support", [OWN_WEIGHT, RIGID], ids=lambda s: s.name)
def test_a_turn_agrees_with_contact_forces_and_coulombs_law(support):
    obj = load_object("L2")
    trajectory, contacts = turned(support)
    assert trajectory.ok
    measured = compensate(trajectory)
    (window,) = steady_windows(measured)
    assert_allclose(missing(obj, window, support.is_rigid), 0, atol=0.01)
    (steady,) = steady_samples(measured)  # before, the sensor feels inertia too
    wrench = measured.wrench_on_object_world[steady]
    difference = (wrench + contacts.wrench_at_tcp[steady]).mean(axis=0)
    assert np.abs(difference[:2]).max() < 5e-3 * np.linalg.norm(wrench[:, :2], axis=1).mean()
    assert abs(difference[5]) < 5e-3 * abs(wrench[:, 5].mean())


@pytest.mark.parametrize("support", [OWN_WEIGHT, RIGID], ids=lambda s: s.name)
def test_the_drag_of_a_slide_is_coulombs(support):
    obj = load_object("L2")
    (window,) = steady_windows(RUNNER.run(Trial(obj, Slide(1, direction=0.4, duration=2.5), support)))
    assert_allclose(missing(obj, window, support.is_rigid), 0, atol=0.01)


def test_a_held_object_does_not_swing():
    """A turn about a point near light blocks: with stiffer pads arm and object swing, and the torque is 1 % off."""
    obj = load_object("L2")
    (window,) = steady_windows(RUNNER.run(Trial(obj, Rotate(3, speed=-0.1074, duration=2.5, pivot=(0.025, -0.0779)))))
    missed = missing(obj, window)
    assert_allclose(missed[:2], 0, atol=0.005)
    assert abs(missed[2]) < 0.001


def test_the_hand_closes_where_the_grasp_is_and_the_object_stays_in_it():
    """What the robot knows of the object's pose is where it meant to grasp it."""
    obj = load_object("L2")
    record, contacts = RUNNER.run_with_contacts(Trial(obj, Accelerate(4, (1.5, -1.5))))
    middle = transform_point(record.object_pose, obj.shape.particles.mean(axis=0))
    off = contacts.position[:, :, :2].mean(axis=1) - middle
    assert np.abs(off[record.mask(Phase.SETTLE)]).max() < 1e-5
    assert record.figures["slip_m"] < 3e-5


CONTACTS = {
    "own weight": lambda: turned(OWN_WEIGHT)[1],
    "springs": lambda: turned(SPRINGS, 10)[1],
    "rigid": lambda: turned(RIGID)[1],
    "links": lambda: RUNNER.run_with_contacts(Trial(drawn_chain(2), Slide(0, math.pi / 2, duration=1.0)))[1],
}


@pytest.mark.parametrize("name", CONTACTS)
def test_every_foot_pushes_at_the_height_of_the_table(name: str):
    """However heavy its group is: drag at another height is another moment on the hand."""
    contacts = CONTACTS[name]()
    load, height = contacts.force_on_object[:, :, 2], contacts.position[:, :, 2]
    assert_allclose((load * height).sum() / load.sum(), 0.0, atol=2e-5)
    assert_allclose(height[load > 0], 0.0, atol=1e-4)


def test_foot_forces_of_a_turn_carry_the_weight_and_oppose_the_motion():
    obj, (trajectory, contacts) = load_object("L2"), turned(SPRINGS, 10)
    feet = contacts.foot_forces(trajectory.time_s)
    assert feet.force.shape == (-(-len(trajectory.time_s) // 10), 54, 3)
    assert np.array_equal(feet.time_s, trajectory.time_s[::10])
    steady = np.flatnonzero(trajectory.phase[::10] == Phase.STEADY)[10:-1]
    weight = feet.force[steady, :, 2].sum(1)
    assert_allclose(weight, obj.total_mass * GRAVITY, rtol=0.05)  # the gripper carries the rest
    drag = np.linalg.norm(feet.force[steady, :, :2], axis=2)
    far = np.linalg.norm(obj.shape.particles[feet.particle] - TURN.pivot, axis=1) > 0.03
    assert_allclose(drag[:, far], 0.5 * feet.force[steady][:, far, 2], rtol=0.01)


def test_there_and_back_flips_the_drag():
    windows = steady_windows(RUNNER.run(Trial(row([0.4, 0.2]), replace(TURN, grasp=0, pivot=(0.0, 0.01), back=True))))
    there, back = (w.wrench[[0, 1, 5]] for w in windows)
    assert_allclose(there, -back, atol=0.01 * 0.5 * 0.6 * GRAVITY)


@pytest.mark.parametrize(("name", "rel"), [("F2", 1e-5), ("hammer", 1e-3), ("wrench", 1e-3)])
@pytest.mark.parametrize("support", [OWN_WEIGHT, RIGID], ids=lambda s: s.name)
def test_a_weighing_reads_the_mass(name, rel, support):
    obj = load_object(name)
    assert weight_of(RUNNER.run(Trial(obj, Weigh(), support))) == pytest.approx(obj.total_mass, rel=rel)


TURN_IN_BRIEF, STEPS = Rotate(0, duration=1.2, back=True), Accelerate(0)
TOOL_TURNS = [("hammer", "handle_mid", OWN_WEIGHT, TURN_IN_BRIEF), ("wrench", "shank_a", RIGID, STEPS)]
ALL_TOOL_TURNS = [
    pytest.param(name, grasp.name, support, action, marks=pytest.mark.slow)
    for name in ("hammer", "wrench")
    for grasp in load_object(name).shape.grasps
    for support, action in ((OWN_WEIGHT, STEPS), (RIGID, replace(TURN_IN_BRIEF, duration=4.0)))
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
    measured = compensate(trajectory).wrench_on_object_world[steady]
    difference = (measured + contacts.wrench_at_tcp[steady]).mean(axis=0)
    if isinstance(action, Rotate):  # steps of acceleration take a wrench for the inertia as well
        assert np.abs(difference[:2]).max() < 5e-3 * drag.sum(axis=1).mean()
        assert abs(difference[5]) < 5e-3 * torque


@pytest.mark.slow
def test_a_weld_measures_what_friction_does():
    obj = load_object("I2")
    welded = SimulationRunner(SimulationSettings(grip=GripSettings(mode="weld")))
    (a,), (b,) = (
        steady_windows(r.run(Trial(obj, replace(TURN, grasp=1, pivot=(-0.07, 0.01))))) for r in (RUNNER, welded)
    )
    assert_allclose(a.wrench[5], b.wrench[5], rtol=5e-3)


def test_the_same_trial_gives_the_same_record():
    trial = Trial(row([0.3, 0.3]), Rotate(0, duration=0.5))
    first, second = RUNNER.run(trial), RUNNER.run(trial)
    assert np.array_equal(first.sensor_wrench, second.sensor_wrench)


def bridge() -> ObjectModel:
    """Two light blocks that carry two heavy ones between them, over the table."""
    obj = row([0.3, 2.4, 2.4, 0.3])
    touches = np.isin(obj.shape.mass_group, (0, 3))
    return replace(obj, shape=replace(obj.shape, friction_group=np.where(touches, 0, -1)))


def low_faces() -> ObjectModel:
    obj = load_object("hammer")
    return replace(obj, shape=replace(obj.shape, grasps=(replace(obj.shape.grasps[0], bottom=0.014, top=0.0165),)))


@pytest.mark.parametrize(
    ("obj", "action", "grip", "why"),
    [
        (row([4.0, 4.0, 4.0]), Rotate(0), "friction", "grip: .*torque"),
        (row([0.4, 0.4], size=0.085), Rotate(0), "friction", "grip: .* 85 mm wide"),
        (row([0.4, 0.4], height=0.005), Rotate(0), "friction", "grip: .* 5 mm high"),
        (low_faces(), Rotate(0), "friction", r"grip: the faces of handle_neck are 14\.0 to 16\.5 mm"),
        (row([0.4, 0.4]), Rotate(0, speed=2.0, duration=1.0), "friction", "speed: joint 7 "),
        (row([0.4, 0.4]), Slide(0, duration=30.0), "friction", "reach: "),
        (row([8.0, 8.0, 8.0, 8.0]), Rotate(0), "weld", r"torque: joint \d"),
        (bridge(), Rotate(0), "friction", "grip: torque"),
    ],
    ids=["too heavy", "too wide", "too low", "low faces", "too fast", "too far", "weak joint", "heavy bridge"],
)
def test_an_infeasible_trial_is_refused_before_anything_moves(obj, action, grip, why):
    with pytest.raises(InfeasibleTrialError, match=why):
        support = OWN_WEIGHT if obj.shape.stands_in_groups else RIGID
        SimulationRunner(SimulationSettings(grip=GripSettings(mode=grip))).run(Trial(obj, action, support))


def test_a_wrong_timestep_and_an_unknown_sensor_are_refused():
    with pytest.raises(InvalidValueError, match="or a whole part of it"):
        SimulationSettings(timestep=0.003)
    with pytest.raises(InvalidValueError, match=r"^sensing: got 'ft300'; allowed: one of ideal, ft300s"):
        Trial(row([0.4, 0.4]), Rotate(0), sensing="ft300")


def test_feet_that_the_objects_own_weight_lifts_are_refused():
    obj = load_object("hammer")
    touching = obj.shape.friction_group.copy()
    end = np.flatnonzero((obj.shape.mass_group == 1) & (obj.shape.particles[:, 0] > 0.1))
    touching[obj.shape.mass_group == 1] = -1
    touching[end] = 1
    tipping = replace(obj, shape=replace(obj.shape, friction_group=touching))
    with pytest.raises(InfeasibleTrialError, match=r"rest: .* foot of handle"):
        RUNNER.check(Trial(tipping, Rotate(0)))
    RUNNER.check(Trial(tipping, Rotate(0), RIGID))


def test_slip_in_the_grip_ends_a_trial(monkeypatch):
    monkeypatch.setattr(feasibility, "MARGIN", 100.0)
    weak = SimulationRunner(SimulationSettings(grip=GripSettings(force=20.0, friction=0.1)))
    trajectory = weak.run(Trial(row([0.8, 0.8, 0.8]), Slide(0, duration=2.0)))
    assert trajectory.status == "slipped"
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

    def explode(self: Servo, tick: int) -> None:
        measure(self, tick)
        if tick == 150:
            self._data.qvel[0] = 1e11

    monkeypatch.setattr(Servo, "measure", explode)
    trajectory = RUNNER.run_clean(Trial(row([0.3, 0.3]), Rotate(0, duration=2.0)))
    assert trajectory.status == "fault"
    assert "diverged at 1.5" in trajectory.reason
    assert "qpos" in trajectory.provenance["state"]
    assert len(trajectory.time_s) <= 152
    assert not list(tmp_path.iterdir())
