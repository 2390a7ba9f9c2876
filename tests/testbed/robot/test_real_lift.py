"""Lifts on the real arm: the leg in the air, its limits, and whole trials on the fake one."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from estimators.inertial import least_squares_inertia, lift_equations, true_body
from scenarios.cli.robot.trial import action_of
from testbed.actions.lift import Lift
from testbed.errors import InfeasibleTrialError
from testbed.robot.config import LimitsTable, RobotFile, RobotSettings
from testbed.robot.path import described, plan_trial, starting_pose
from testbed.robot.robotiq.gripper import data_sheet
from testbed.trial import RIGID, Trial
from tests.fakes.robot import robot_for, small_object

OBJECT = small_object()
STEEP = math.radians(21)
TRIAL = Trial(OBJECT, Lift.stop_and_go(0), RIGID)


def tilting(settings: RobotSettings) -> RobotSettings:
    return replace(settings, limits=replace(settings.limits, tilt=STEEP))


def test_the_leg_in_the_air_moves_as_it_says_it_does():
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


@pytest.mark.slow
def test_a_lift_on_the_arm_weighs_and_finds_the_center():
    robot, runner = robot_for(TRIAL, change=tilting)
    with runner:
        record = runner.run(TRIAL)
    assert record.ok, record.reason
    assert robot.world.grip < 0
    truth = true_body(OBJECT)
    found = least_squares_inertia(lift_equations(OBJECT.shape, [record])).parameters
    assert found.mass == pytest.approx(truth.mass, rel=0.01)
    assert_allclose(found.center_of_mass, truth.center_of_mass, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["load", "sensor", "tilt"])
def test_whatever_ends_a_lift_stops_the_arm_and_holds_on(what):
    struck: list[float] = []

    def strike(robot):
        if struck or robot.world.reading.tcp_pose.position[2] < 0.09 or robot.world.grip < 1:
            return
        struck.append(robot.clock.now())
        if what == "load":
            robot.troubles.load = np.array([80.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        elif what == "sensor":
            robot.troubles.sensor_lost = True
        else:
            robot.troubles.twist_scale = 2.0

    quick = Lift.stop_and_go(0, hold=0.3)
    robot, runner = robot_for(replace(TRIAL, action=quick), strike, change=tilting)
    with runner:
        record = runner.run(replace(TRIAL, action=quick))
    assert record.status == ("fault" if what == "sensor" else "limit"), record.reason
    assert robot.world.grip == 1.0
    assert robot.driven_after(struck[0]) < (3.0 if what == "tilt" else 0.3)
    assert robot.world.reading.tcp_pose.position[2] > 0.08
