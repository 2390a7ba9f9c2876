"""The Kortex arm over its own process, against a fake Gen3 that runs in real time behind a fake `kortex_api`."""

from __future__ import annotations

import ast
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from testbed.errors import InvalidValueError
from testbed.robot.interfaces import (
    Arm,
    ArmLostError,
    ArmRefusedError,
    Gripper,
    Pose,
    RobotError,
)
from testbed.robot.kinova import (
    messages as kortex_messages,
)
from testbed.robot.kinova import (
    process as kortex_process,
)
from testbed.robot.kinova import (
    session as kortex_session,
)
from testbed.robot.kinova.arm import GEN3, KortexArm
from testbed.robot.kinova.gripper import KortexGripper
from testbed.robot.kinova.link import PYTHON_VARIABLE
from testbed.simulation.motion import arm_model
from tests.fakes.gen3 import FakeGen3
from tests.fakes.rig import KORTEX
from tests.fakes.robot import small_object
from tests.fakes.world import Gen3World

pytestmark = pytest.mark.slow  # real lines and processes in real time

STAND = np.zeros(3)


@pytest.fixture(autouse=True)
def fake_api(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", KORTEX)
    monkeypatch.delenv(PYTHON_VARIABLE, raising=False)


@pytest.fixture
def gen3() -> Iterator[FakeGen3]:
    with FakeGen3(Gen3World(small_object())) as fake:
        yield fake


@pytest.fixture
def arm(gen3) -> Iterator[KortexArm]:
    with arm_at(gen3.port) as connected:
        yield connected


def arm_at(port: int, **settings: Any) -> KortexArm:
    """An arm that bears the pauses of a busy machine."""
    return KortexArm("127.0.0.1", port=port, silence=1.0, **settings)


def until(true: Callable[[], bool], seconds: float = 5.0) -> bool:
    """Whether it comes true in time; how soon is not asked, since machines are busy."""
    end = time.monotonic() + seconds
    while not true():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def moved_by(arm: KortexArm, linear: np.ndarray, angular: np.ndarray, gen3: FakeGen3, count: int = 20) -> np.ndarray:
    """The fake arm's twist after some commands."""
    for _ in range(count):
        arm.twist(linear, angular)
        time.sleep(0.02)
    return gen3.world.reading.twist.copy()


def test_they_are_ports(gen3):
    arm = arm_at(gen3.port)
    assert isinstance(arm, Arm)
    assert isinstance(KortexGripper(arm), Gripper)
    assert arm.limits is GEN3


def test_its_limits_are_those_of_the_model():
    model = arm_model()
    limited = model.jnt_limited[:7].astype(bool)
    assert_allclose(GEN3.joint_range[limited], model.jnt_range[:7][limited])
    assert np.isinf(GEN3.joint_range[~limited]).all()


def test_connecting_moves_nothing_and_leaving_ends_the_process(gen3):
    with arm_at(gen3.port) as arm:
        state = arm.state()
        link = arm._link
    assert link is not None and link.dead
    assert [name for _, name in gen3.commands if name != "Stop"] == []
    assert_allclose(state.tcp_pose.position, gen3.world.reading.position, atol=1e-5)
    assert_allclose(np.cos(state.joint_position), np.cos(gen3.world.reading.q), atol=1e-5)
    assert abs(state.joint_position).max() <= math.pi
    with pytest.raises(ArmLostError, match="not connected; use it in a with statement"):
        arm.state()
    arm.stop()  # and this is no error


def test_a_pose_is_reached(arm, gen3):
    start = arm.state().tcp_pose
    goal = Pose(start.position + np.array([0.02, 0.01, 0.03]), start.orientation)
    arm.move_to(goal, 0.2)
    assert_allclose(gen3.world.reading.position, goal.position, atol=2e-3)


@pytest.mark.parametrize("axis", range(3))
def test_twists_are_in_the_base_frame_and_in_radians(arm, gen3, axis):
    linear, angular = 0.04 * np.eye(3)[axis], np.array([0.0, 0.0, 0.2])
    twist = moved_by(arm, linear, angular, gen3)
    assert_allclose(twist[:3], linear, atol=0.012)
    assert_allclose(twist[3:], angular, atol=0.06)


def test_the_pose_that_is_reported_is_the_tools_own(arm, gen3):
    moved_by(arm, STAND, np.array([0.1, 0.1, 0.3]), gen3)
    arm.stop()
    assert until(lambda: not gen3.world.driven and gen3.world.speed < 1e-4)
    time.sleep(0.05)
    ours, truth = arm.state().tcp_pose.orientation, gen3.world.reading.orientation
    assert abs(ours @ truth) == pytest.approx(1.0, abs=1e-6)


def test_stop_ends_motion_also_of_a_pose_under_way(arm, gen3):
    moved_by(arm, np.array([0.03, 0, 0]), STAND, gen3, count=5)
    arm.stop()
    assert until(lambda: not gen3.world.driven)
    start = arm.state().tcp_pose
    Timer(0.3, arm.stop).start()
    arm.move_to(Pose(start.position + np.array([0, 0, 0.15]), start.orientation), 0.05)
    assert until(lambda: not gen3.world.driven)
    assert gen3.world.reading.position[2] < start.position[2] + 0.14


def test_it_stops_where_no_twist_comes_any_more(arm, gen3):
    moved_by(arm, np.array([0.03, 0, 0]), STAND, gen3, count=5)
    assert until(lambda: not gen3.world.driven)
    assert until(lambda: arm._link.lost != "")  # it stops first, then says so
    with pytest.raises(ArmLostError, match="silence for more than 1000 ms while the arm moved"):
        arm.twist(STAND, STAND)
    arm.stop()
    arm.twist(STAND, STAND)


def test_standing_still_needs_no_twists(arm, gen3):
    arm.twist(np.array([0.01, 0, 0]), STAND)
    arm.twist(STAND, STAND)
    time.sleep(1.3)
    arm.twist(STAND, STAND)
    assert "Stop" not in [name for _, name in gen3.commands]


@pytest.mark.parametrize("end", ["its input ends", "it is killed"])
def test_it_stops_when_heft_is_gone_or_its_process_is(arm, gen3, end):
    moved_by(arm, np.array([0.03, 0, 0]), STAND, gen3, count=5)
    process = arm._link._process
    if end == "it is killed":
        os.kill(process.pid, signal.SIGKILL)
    else:
        process.stdin.close()
    assert until(lambda: not gen3.world.driven)
    with pytest.raises(ArmLostError):
        for _ in range(200):
            arm.state()
            time.sleep(0.01)
    arm.stop()


def test_ctrl_c_does_not_reach_the_process(arm, gen3):
    os.kill(arm._link._process.pid, signal.SIGINT)
    time.sleep(0.1)
    assert not arm._link.dead
    arm.state()


def test_a_pulled_cable_is_told_and_stops_the_arm(arm, gen3):
    moved_by(arm, np.array([0.03, 0, 0]), STAND, gen3, count=5)
    gen3.drop()
    assert until(lambda: not gen3.world.driven)
    with pytest.raises(ArmLostError):
        for _ in range(200):
            arm.state()
            time.sleep(0.01)


def test_a_stop_that_the_arm_does_not_answer_is_followed_by_its_emergency_stop(arm, gen3):
    moved_by(arm, np.array([0.03, 0, 0]), STAND, gen3, count=5)
    gen3.faults.refuse = "Base.Stop"
    arm.stop()
    assert until(lambda: not gen3.world.driven)


def test_what_the_arm_refuses_is_told(arm, gen3):
    start = arm.state().tcp_pose
    with pytest.raises(ArmRefusedError, match="outside the workspace"):
        arm.move_to(Pose(np.array([1.5, 0, 0.3]), start.orientation), 0.1)
    goal = Pose(start.position + np.array([0, 0, 0.03]), start.orientation)
    gen3.faults.aborts = True
    with pytest.raises(ArmRefusedError, match=r"not reached: aborted by the arm \(detail 55\)"):
        arm.move_to(goal, 0.1)
    gen3.faults.aborts, gen3.faults.short = False, True
    goal = Pose(gen3.world.reading.position + np.array([0, 0, 0.03]), start.orientation)
    with pytest.raises(ArmRefusedError, match=r"says that it has arrived, \d+\.\d mm"):
        arm.move_to(goal, 0.1)
    gen3.faults.refuse = "Base.SendTwistCommand"
    with pytest.raises(ArmRefusedError, match="twist refused"):
        moved_by(arm, np.array([0.03, 0, 0]), STAND, gen3)
    with pytest.raises(ArmRefusedError, match=r"a twist of 0\.6 m/s and 0 rad/s; allowed: 0\.5 m/s"):
        arm.twist(np.array([0.6, 0, 0]), STAND)


def test_a_fault_is_told_and_cleared(arm, gen3):
    gen3.faults.fault_bank = 0x10
    assert until(lambda: arm.state().faulted)
    assert arm.state().message == "fault banks 0x10 0x0"
    with pytest.raises(ArmRefusedError, match=r"in a fault \(fault banks 0x10 0x0\); clear it"):
        arm.twist(STAND, STAND)
    arm.clear_faults()
    assert not arm.state().faulted


def test_the_gripper_closes_opens_and_tells_its_opening(arm, gen3):
    gripper = KortexGripper(arm)
    assert gripper.width() == pytest.approx(0.085, abs=1e-3)
    with pytest.raises(ArmRefusedError, match=r"closed to \d mm; expected 50 mm: on nothing"):
        gripper.close_on(0.05, 100.0)
    gripper.open()
    assert gripper.width() == pytest.approx(0.085, abs=1e-3)


def test_a_missing_api_is_told_with_where_it_is_to_be_had(gen3, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "")
    with pytest.raises(
        RobotError, match=r"kortex_api: not usable in .*No module named 'kortex_api'.*\.whl.*HEFT_KORTEX_PYTHON"
    ):
        arm_at(gen3.port).__enter__()
    monkeypatch.setenv(PYTHON_VARIABLE, "/no/such/python")
    with pytest.raises(RobotError, match=r"HEFT_KORTEX_PYTHON: got /no/such/python, which does not start"):
        arm_at(gen3.port).__enter__()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"password": "wrong"}, r"cannot be connected: KServerException: wrong password; check its power"),
        (
            {"tool_length": 0.2},
            r"stored tool has its centre at \(0\.0000, 0\.0000, 0\.2115\) m; expected \(0, 0, 0\.2000\)",
        ),
    ],
)
def test_an_arm_that_is_not_as_expected_is_refused(gen3, settings, said):
    with pytest.raises(RobotError, match=said):
        arm_at(gen3.port, **settings).__enter__()


def test_nobody_at_the_address_is_told():
    with pytest.raises(ArmLostError, match=r"arm 127\.0\.0\.1: cannot be connected: ConnectionRefusedError"):
        arm_at(1).__enter__()
    with pytest.raises(InvalidValueError, match=r"KortexArm\.port"):
        KortexArm(port=0)


@pytest.mark.parametrize("module", [kortex_messages, kortex_process, kortex_session], ids=lambda m: m.__name__)
def test_what_runs_beside_heft_runs_in_an_old_python(module):
    path = module.__file__
    assert path is not None
    tree = ast.parse(Path(path).read_text(encoding="utf-8"), feature_version=(3, 8))
    imported = {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module}
    imported |= {alias.name for n in ast.walk(tree) if isinstance(n, ast.Import) for alias in n.names}
    ours = {name for name in imported if name.startswith("testbed")}
    assert ours <= {"testbed.robot.kinova.messages", "testbed.robot.kinova.session"}
    assert {name.split(".")[0] for name in imported - ours} <= set(sys.stdlib_module_names)
