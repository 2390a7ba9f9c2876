"""Pushes, objects in links, and lifts, on a fake robot in simulated time."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from estimators.inertial import least_squares_inertia, lift_equations, true_body
from scenarios.cli.robot.trial import action_of
from testbed import RIGID, InfeasibleTrialError, Lift, Phase, Push, Rotate, SimulationRunner, Trial, steady_windows
from testbed.robot.calibration.motion import wrong_motion
from testbed.robot.camera.evidence import with_evidence
from testbed.robot.camera.interface import CameraLostError
from testbed.robot.camera.watch import CameraWatch
from testbed.robot.config import LimitsTable, RobotFile, RobotSettings
from testbed.robot.kinova.gripper import data_sheet
from testbed.robot.path import described, plan_trial, starting_pose
from testbed.robot.runner import trajectory_of
from testbed.sensing.link_windows import link_windows
from testbed.sensing.push_windows import push_windows
from tests.fakes.lying_camera import DRAG, LIES, begins, in_links, shifted
from tests.fakes.lying_camera import PUSH as PUSH_TRIAL
from tests.fakes.robot import FakeCamera, briefly, robot_for, run_trial

OBJECT = PUSH_TRIAL.object
PUSH = Push((0.05, -0.01), math.pi)
SLOW = pytest.mark.slow


def run(trial: Trial, watch=lambda _: None, change=briefly, **of_runner):
    return run_trial(trial, watch, seed=1, change=change, **of_runner)


@SLOW
@pytest.mark.parametrize("push", [PUSH, replace(PUSH, direction=math.pi - 0.3, curvature=4.0)], ids=["line", "curve"])
def test_a_push_measures_what_the_simulation_does(push, tmp_path):
    real, robot = run(Trial(OBJECT, push), raw=tmp_path)
    usual = SimulationRunner().run(Trial(OBJECT, push))
    assert real.ok and not real.reason
    assert real.figures["contact_s"] == pytest.approx(usual.figures["contact_s"], abs=0.6)
    assert wrong_motion(OBJECT.shape, [real, usual]) == []
    ours, theirs = push_windows(real), push_windows(usual)
    assert len(ours) >= 5
    for window in ours:  # the same drag where the object has turned as far
        same = min(theirs, key=lambda other: abs(float(np.mean(other.yaw - window.yaw))))
        assert_allclose(window.wrench[:2], same.wrench[:2], atol=0.35)
        assert window.point is not None and same.point is not None
        assert_allclose(window.point, same.point, atol=2e-3)
        claimed = np.linalg.norm(window.camera_errors[3:5], axis=1)
        assert_allclose((window.twist - same.twist)[:2] / (claimed + 1e-3), 0, atol=3.5)
    moving = real.mask(Phase.RAMP, Phase.STEADY)
    assert_allclose(real.tcp_position[moving][0], usual.tcp_position[usual.mask(Phase.RAMP)][0], atol=2e-3)
    assert_allclose((real.object_pose[moving][-1] - robot.world.object_pose) / [3e-3, 3e-3, 0.02], 0, atol=1)
    seen = [line for line in next(tmp_path.iterdir()).read_text().splitlines() if line.startswith("seen,")]
    assert len(seen) > 25 * real.time_s[-1] * 0.9 and all(len(line.split(",")) == 5 for line in seen[1:])


@SLOW
def test_links_are_dragged_as_in_the_simulation():
    real, robot = run(DRAG)
    assert real.ok, real.reason
    assert real.camera is not None and real.camera.parts == 2
    usual = SimulationRunner().run(DRAG)
    (ours,), (theirs,) = steady_windows(real), steady_windows(usual)
    assert_allclose((ours.wrench - theirs.wrench)[[0, 1, 5]] / [0.15, 0.15, 0.006], 0, atol=1)
    assert_allclose((real.camera.poses[-1] - robot.world.link_poses) / [5e-3, 5e-3, 0.03], 0, atol=1)
    for mine, other in zip(link_windows(real), link_windows(usual), strict=True):
        claimed = np.linalg.norm(mine.turned_errors[:, 1], axis=1) + 0.01
        assert_allclose((mine.turned - other.turned).mean(axis=0)[:, 1] / claimed, 0, atol=3.5)


def trouble(**changes):
    """Troubles that begin during the motion."""

    def watch(robot):
        if robot.world.twist[1] > 0.02 and abs(robot.world.twist[2]) < 0.01:
            vars(robot.troubles).update(changes)

    return watch


@SLOW
@pytest.mark.parametrize(
    ("watch", "status", "why"),
    [
        (trouble(camera_lost=True), "fault", "camera: unplugged"),
        (trouble(camera_blind=True), "fault", "did not see the object for"),
        (trouble(load=np.array([0, 0, 100.0, 0, 0, 0])), "limit", "force"),
    ],
    ids=["lost", "blind", "hit"],
)
def test_a_push_that_fails_stops_with_its_reason(watch, status, why):
    record, robot = run(Trial(OBJECT, PUSH), watch)
    assert record.status == status and why in record.reason
    assert not robot.world.driven


@SLOW
def test_a_push_beside_the_object_is_no_data():
    """The camera's place is off by as much as may go unnoticed before; the fingertip then passes the object."""
    trial = Trial(OBJECT, replace(PUSH, point=(0.05, 0.02)))
    robot, runner = robot_for(trial, seed=1, change=briefly)
    x, y, yaw = starting_pose(trial)
    robot.world.place(np.array([x - 0.014, y, yaw]), PUSH.fingertip(OBJECT.shape))
    with runner:
        record = runner.run(trial)
    assert record.status == "slipped" and "met the object for" in record.reason


def test_an_object_out_of_view_or_elsewhere_is_refused_before_any_motion():
    trial = Trial(OBJECT, PUSH)
    for each in (trial, Trial(in_links(), Rotate(0))):
        _, blind = robot_for(each, camera=None)
        with blind, pytest.raises(InfeasibleTrialError, match="no camera sees it"):
            blind.run(each)
    for off, why in (([0.03, 0, 0], "30 mm"), ([0, 0, 0.2], r"\+1\d deg")):
        robot, runner = robot_for(trial)
        robot.camera.off = np.array(off)
        with runner, pytest.raises(CameraLostError, match=f"{why}.*from its place"):
            runner.run(trial)
        assert robot.driven_after(0.0) == 0.0
    robot, runner = robot_for(trial)
    robot.troubles.camera_blind = True
    with runner, pytest.raises(CameraLostError, match="in 0 frames"):
        runner.run(trial)


def test_a_plan_of_a_push_says_what_the_fingers_need():
    settings = RobotSettings(data_sheet(0.0))
    trial = Trial(OBJECT, PUSH)
    pose = np.append(starting_pose(trial)[:2], -5e-4)
    said = described(plan_trial(trial, pose, settings), settings)
    assert "turned by 0.0 deg" in said
    assert "push of two at (50, -10) mm with closed fingers" in said
    assert "of radius 6 mm, has its middle 14.0 mm below" in said
    with pytest.raises(InfeasibleTrialError, match="point of the outline"):
        plan_trial(Trial(OBJECT, replace(PUSH, point=(0.0, 0.0))), np.zeros(3), settings)
    with pytest.raises(InfeasibleTrialError, match="limit"):
        plan_trial(trial, np.array([0.6, 0.5, 0.0]), settings).check(settings)


@SLOW
@pytest.mark.parametrize("links", [False, True], ids=["push", "links"])
@pytest.mark.parametrize("lie", LIES)
def test_a_camera_that_lies_in_the_motion_leaves_a_fault_in_the_record(lie, links):
    record, robot = run(DRAG if links else PUSH_TRIAL, begins(LIES[lie][0]), change=replace)
    assert record.status == "fault" and re.search(LIES[lie][1], record.reason), record.reason
    assert not robot.world.driven


@SLOW
@pytest.mark.parametrize("trial", [PUSH_TRIAL, DRAG], ids=["push", "links"])
def test_an_honest_camera_is_no_liar(trial, monkeypatch):
    """Ten cameras in one trial; a tag that flips for one frame is left out."""
    made, others, arrived = [], [], [[] for _ in range(9)]

    def look(robot):
        if not others:
            others.extend(FakeCamera(robot, seed) for seed in range(1, 10))
            for camera in (robot.camera, *others):
                camera.lies = lambda f: shifted(0.05, 0, 1.5)(f) if len(f) % 40 == 39 else f[-1]
        for camera, frames in zip(others, arrived, strict=True):
            camera.tick()
            frames += [(robot.clock.now(), frame) for frame in camera.drain()]

    monkeypatch.setattr("testbed.robot.runner.trajectory_of", lambda *of: made.append(of) or trajectory_of(*of))
    record, _ = run_trial(trial, look)
    assert record.ok, record.reason
    (plan, rows, settings, *rest), speed = made[0], abs(trial.action.steady[0].speed) if trial.action.pushes else 0.0
    for frames in arrived:
        watch = CameraWatch(settings.camera, len(rows.seen[0].poses), speed)
        kept = tuple(one for now, frame in frames for one in watch.kept([frame], now))
        other = with_evidence(trajectory_of(plan, replace(rows, seen=kept), settings, *rest), trial.object.shape)
        assert len(frames) - 20 < len(kept) < len(frames) and other.ok, other.reason


STEEP = math.radians(21)
TRIAL = Trial(OBJECT, Lift.stop_and_go(0), RIGID)


def tilting(settings: RobotSettings) -> RobotSettings:
    return replace(settings, limits=replace(settings.limits, tilt=STEEP))


@SLOW
def test_velocities_of_the_lifting_leg_are_those_of_its_poses():
    settings = tilting(RobotSettings(data_sheet(0.05), table_height=0.01))
    plan = plan_trial(TRIAL, np.array([0.5, -0.1, 0.4]), settings)
    plan.check(settings)
    assert plan.act is not None
    assert_allclose(plan.act.at(0.0).position, plan.descent.end)
    assert_allclose(plan.act.at(plan.act.duration).position, plan.descent.end, atol=1e-9)
    about_x = plan.act.path.ways[1].slope(np.zeros(1))[0]
    assert_allclose(about_x[4:], [math.cos(0.4), math.sin(0.4), 0.0], atol=1e-12)
    most = 0.0
    for time in np.arange(0.105, plan.act.duration, 0.1):
        ahead, now, behind = (plan.act.at(time + d) for d in (0.004, 0.0, -0.004))
        turned = Rotation.from_rotvec(ahead.tilt) * Rotation.from_rotvec(behind.tilt).inv()
        assert_allclose(turned.as_rotvec() / 0.008, now.angular_velocity, atol=0.03)
        assert_allclose((ahead.position - behind.position) / 0.008, now.velocity, atol=2e-3)
        assert np.linalg.norm(now.velocity) <= settings.descent_speed + 1e-9
        most = max(most, now.tilt_angle)
    assert most == pytest.approx(TRIAL.action.tilt, abs=1e-3)  # pyright: ignore[reportAttributeAccessIssue]
    assert "tilted by up to 20.0 deg" in described(plan, settings)


@pytest.mark.parametrize("action", [Lift(0), Lift.stop_and_go(0)])
def test_a_tilt_beyond_the_robot_files_limit_is_refused_before_it_moves(action):
    trial = Trial(OBJECT, action, RIGID)
    robot, runner = robot_for(trial)
    with runner, pytest.raises(InfeasibleTrialError, match=r"the action: tilt of the tool: 0\.\d+ rad; allowed"):
        runner.run(trial)
    assert robot.driven_after(0.0) == 0.0
    sheet, pose = data_sheet(0.05), starting_pose(trial)
    steep = RobotFile(limits=LimitsTable(tilt_deg=math.degrees(action.tilt) + 0.6)).settings(None, sheet)
    plan_trial(trial, pose, steep).check(steep)
    bare = replace(steep, limits=replace(steep.limits, tilt=action.tilt + 0.001))
    with pytest.raises(InfeasibleTrialError, match="tilt"):
        plan_trial(trial, pose, bare).check(bare)


def test_the_command_names_lifts():
    shape = OBJECT.shape
    name = shape.grasps[1].name
    assert action_of(shape, "lift", name) == Lift(1)
    given = action_of(shape, "stop_and_go", name, seconds=1.5, tilt_deg=10.0)
    assert given == Lift.stop_and_go(1, math.radians(10.0), hold=1.5)


@SLOW
def test_a_lift_on_the_arm_weighs_and_finds_the_center():
    record, robot = run_trial(TRIAL, change=tilting)
    assert record.ok, record.reason
    assert robot.world.grip < 0
    truth = true_body(OBJECT)
    found = least_squares_inertia(lift_equations(OBJECT.shape, [record])).parameters
    assert found.mass == pytest.approx(truth.mass, rel=0.01)
    assert_allclose(found.center_of_mass, truth.center_of_mass, atol=2e-3)


@SLOW
@pytest.mark.parametrize(
    ("trouble", "value", "status", "within_s"),
    [
        ("load", np.array([80.0, 0.0, 0.0, 0.0, 0.0, 0.0]), "limit", 0.3),
        ("sensor_lost", True, "fault", 0.3),
        ("twist_scale", 2.0, "limit", 3.0),
    ],
    ids=["load", "sensor", "tilt"],
)
def test_every_end_of_a_lift_stops_the_arm_and_keeps_the_grip(trouble, value, status, within_s):
    struck: list[float] = []

    def strike(robot):
        if not struck and robot.world.reading.tcp_pose.position[2] >= 0.09 and robot.world.grip >= 1:
            struck.append(robot.clock.now())
            setattr(robot.troubles, trouble, value)

    record, robot = run_trial(replace(TRIAL, action=Lift.stop_and_go(0, hold=0.3)), strike, change=tilting)
    assert record.status == status, record.reason
    assert robot.world.grip == 1.0
    assert robot.driven_after(struck[0]) < within_s
    assert robot.world.reading.tcp_pose.position[2] > 0.08
