"""The Kortex arm over its own process, against a fake Gen3 that runs in real time: its driver, and faults in motion."""

import ast
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

import testbed
from estimators import HiddenStates, RankDriven, normalized_absolute_difference
from testbed import SimulationRunner, Trial, load_object
from testbed.robot.interfaces import Arm, ArmLostError, ArmRefusedError, Gripper, MonotonicClock, Pose, RobotError
from testbed.robot.kinova.arm import GEN3, KortexArm
from testbed.robot.kinova.gripper import KortexGripper
from testbed.robot.kinova.link import PYTHON_VARIABLE
from testbed.simulation.motion import arm_model
from tests.fakes.gen3 import FakeGen3, Faults
from tests.fakes.rig import KORTEX, over_wires
from tests.fakes.robot import small_object
from tests.fakes.wire_faults import PHASES, WIRE_FAULTS, Phase, freeze_both, stopped_after
from tests.fakes.world import Gen3World
from tests.helpers.waiting import until

STAND, FORWARD = np.zeros(3), np.array([0.03, 0, 0])
slow = pytest.mark.slow  # real lines and processes in real time


@pytest.fixture(scope="module")
def running() -> Iterator[FakeGen3]:
    with FakeGen3(Gen3World(small_object())) as fake:
        yield fake


@pytest.fixture
def gen3(running, monkeypatch) -> FakeGen3:
    """The fake arm without faults, standing."""
    monkeypatch.setenv("PYTHONPATH", KORTEX)
    monkeypatch.delenv(PYTHON_VARIABLE, raising=False)
    running.faults = Faults()
    running.world.stop()
    assert until(lambda: running.world.speed < 1e-3)
    running.commands.clear()
    return running


@pytest.fixture
def arm(gen3) -> Iterator[KortexArm]:
    with arm_at(gen3.port) as connected:
        yield connected


def arm_at(port: int, **settings: Any) -> KortexArm:
    """An arm that bears the pauses of a busy machine: longer ones than a setting may allow."""
    arm = KortexArm("127.0.0.1", **{"port": port, **settings})
    vars(arm).update({"silence": 1.0, "watchdog": 1.0} | settings)
    return arm


def reach(arm: KortexArm, pose: Pose, speed: float) -> None:
    """Move to a pose, watched as by a guard."""

    def look() -> None:
        with suppress(RobotError):
            arm.state()

    with MonotonicClock().every(0.02, look):
        arm.move_to(pose, speed)


def stands(gen3: FakeGen3) -> bool:
    return until(lambda: not gen3.world.driven)


def moved_by(arm: KortexArm, linear: np.ndarray, angular: np.ndarray, gen3: FakeGen3, count: int = 20) -> np.ndarray:
    """Twist of the fake arm after some commands."""
    for _ in range(count):
        arm.twist(linear, angular)
        time.sleep(0.02)
    return gen3.world.reading.tcp_twist


def ahead(arm: KortexArm, z: float = 0.03) -> Pose:
    start = arm.state().tcp_pose
    return Pose(start.position + np.array([0, 0, z]), start.orientation)


def test_it_fits_its_interface_and_the_model():
    arm, model = KortexArm(), arm_model()
    assert isinstance(arm, Arm)
    assert isinstance(KortexGripper(arm), Gripper)
    assert arm.limits is GEN3
    limited = model.jnt_limited[:7].astype(bool)
    assert_allclose(GEN3.joint_range[limited], model.jnt_range[:7][limited])
    assert np.isinf(GEN3.joint_range[~limited]).all()


@slow
def test_connecting_moves_nothing_and_leaving_ends_the_process(gen3):
    with arm_at(gen3.port) as arm:
        state, link = arm.state(), arm._link
    assert link is not None and link.dead
    assert set(gen3.commands) <= {"Stop"}
    assert_allclose(state.tcp_pose.position, gen3.world.reading.tcp_pose.position, atol=1e-4)
    assert_allclose(np.cos(state.joint_position), np.cos(gen3.world.reading.joint_position), atol=1e-4)
    assert abs(state.joint_position).max() <= math.pi
    with pytest.raises(ArmLostError, match="not connected"):
        arm.state()
    arm.stop()  # and this is no error


@slow
def test_twists_are_in_the_base_frame_and_in_radians(arm, gen3):
    for linear in (0.04 * np.eye(3)[0], 0.04 * np.eye(3)[1], 0.04 * np.eye(3)[2]):
        twist = moved_by(arm, linear, np.array([0.0, 0.0, 0.2]), gen3)
        assert_allclose(twist[:3], linear, atol=0.012)
        assert_allclose(twist[3:], [0.0, 0.0, 0.2], atol=0.06)
    moved_by(arm, STAND, np.array([0.1, 0.1, 0.3]), gen3)
    arm.stop()
    assert until(lambda: not gen3.world.driven and gen3.world.speed < 1e-4)
    time.sleep(0.05)
    measured, truth = arm.state().tcp_pose.orientation, gen3.world.reading.tcp_pose.orientation
    assert abs(measured @ truth) == pytest.approx(1.0, abs=1e-6)


@slow
def test_poses_are_reached_and_stopped(arm, gen3):
    start = arm.state().tcp_pose
    goal = Pose(start.position + np.array([0.02, 0.01, 0.03]), start.orientation)
    reach(arm, goal, 0.2)
    assert_allclose(gen3.world.reading.tcp_pose.position, goal.position, atol=2e-3)
    moved_by(arm, FORWARD, STAND, gen3, count=5)
    arm.stop()
    assert stands(gen3)
    height = gen3.world.reading.tcp_pose.position[2]
    Timer(0.3, arm.stop).start()
    reach(arm, ahead(arm, 0.15), 0.05)
    assert stands(gen3)
    assert gen3.world.reading.tcp_pose.position[2] < height + 0.14


@slow
def test_polling_keeps_it_engaged_and_silence_stops_it(arm, gen3):
    arm.twist(FORWARD / 3, STAND)
    arm.twist(STAND, STAND)
    begin = time.monotonic()
    while time.monotonic() < begin + 1.3:
        arm.state()
        time.sleep(0.02)
    arm.twist(STAND, STAND)
    assert "Stop" not in gen3.commands
    moved_by(arm, FORWARD, STAND, gen3, count=5)
    assert stands(gen3)
    assert until(lambda: arm._link.lost != "")  # it stops first, then reports
    with pytest.raises(ArmLostError, match="heft was silent for 1000 ms during a trial"):
        arm.twist(STAND, STAND)
    arm.stop()
    arm.twist(STAND, STAND)


def close_input(arm: Any, _: FakeGen3) -> None:
    arm._link._process.stdin.close()


def kill(arm: Any, _: FakeGen3) -> None:
    os.kill(arm._link._process.pid, signal.SIGKILL)


def kill_both(arm: Any, gen3: FakeGen3) -> None:
    gen3.faults.endures_silence = False  # the arm's own limit is what is left
    os.kill(arm._link._standby.pid, signal.SIGKILL)
    kill(arm, gen3)


def pull_the_cable(_: KortexArm, gen3: FakeGen3) -> None:
    gen3.faults.endures_silence = False
    gen3.drop()


@slow
@pytest.mark.parametrize("end", [close_input, kill, kill_both, pull_the_cable], ids=lambda f: f.__name__)
def test_it_stops_without_heft_its_process_or_its_cable(arm, gen3, end):
    """By its process, and if that is killed by the one that stands by; only then by the arm itself."""
    gen3.faults.endures_silence = True
    moved_by(arm, FORWARD, STAND, gen3, count=5)
    end(arm, gen3)
    assert stands(gen3)
    with pytest.raises(ArmLostError):
        for _ in range(200):
            arm.state()
            time.sleep(0.01)
    arm.stop()


@slow
def test_a_stop_without_an_answer_is_followed_by_the_emergency_stop(arm, gen3):
    moved_by(arm, FORWARD, STAND, gen3, count=5)
    gen3.faults.refuse = "Base.Stop"
    arm.stop()
    assert stands(gen3)


@slow
def test_refusals_and_faults_are_named(arm, gen3):
    far = Pose(np.array([1.5, 0, 0.3]), arm.state().tcp_pose.orientation)
    refusals: tuple[tuple[dict[str, Any], Callable[[], object], str], ...] = (
        ({}, lambda: reach(arm, far, 0.1), "outside the workspace"),
        ({"aborts": True}, lambda: reach(arm, ahead(arm), 0.1), r"aborted by the arm \(detail 55\)"),
        ({"short": True}, lambda: reach(arm, ahead(arm), 0.1), r"says that it has arrived, \d+\.\d mm"),
        ({"refuse": "Base.SendTwistCommand"}, lambda: moved_by(arm, FORWARD, STAND, gen3), "twist refused"),
        ({}, lambda: arm.twist(20 * FORWARD, STAND), r"a twist of 0\.6 m/s and 0 rad/s; allowed: 0\.5 m/s"),
    )
    for faults, call, reason in refusals:
        gen3.faults = Faults(**faults)
        with pytest.raises(ArmRefusedError, match=reason):
            call()
    gen3.faults = Faults(fault_bank=0x10)
    assert until(lambda: arm.state().faulted)
    assert arm.state().message == "fault banks 0x10 0x0"
    with pytest.raises(ArmRefusedError, match=r"in a fault \(fault banks 0x10 0x0\); clear it"):
        arm.twist(STAND, STAND)


@pytest.mark.parametrize(
    ("stands", "call", "said"),
    [
        (0.085, lambda gripper: gripper.close_on(0.05, 100.0), "closed to 85 mm; expected 50 mm: it does not close"),
        (0.05, lambda gripper: gripper.open(None), "opened to 50 mm; expected 85 mm: it does not open"),
        (0.085, lambda gripper: gripper.open(0.06), "opened to 85 mm; expected 60 mm: it does not close so far"),
    ],
)
def test_a_gripper_that_does_not_move_is_refused(monkeypatch, stands, call, said):
    arm = KortexArm()
    monkeypatch.setattr(arm, "ask", lambda *_, **__: None)
    monkeypatch.setattr(arm, "closed_part", lambda: 1 - stands / 0.085)
    with pytest.raises(ArmRefusedError, match=said):
        call(KortexGripper(arm))


@slow
def test_the_gripper_closes_opens_and_measures_its_opening(arm, gen3):
    gripper = KortexGripper(arm)
    assert gripper.width() == pytest.approx(0.085, abs=1e-3)
    with pytest.raises(ArmRefusedError, match=r"closed to \d mm; expected 50 mm: on nothing"):
        gripper.close_on(0.05, 100.0)
    gripper.open(0.06)
    assert gripper.width() == pytest.approx(0.06, abs=1e-3)
    gripper.open(None)
    assert gripper.width() == pytest.approx(0.085, abs=1e-3)


@slow
@pytest.mark.parametrize(
    ("environment", "settings", "reason"),
    [
        (
            {"PYTHONPATH": ""},
            {},
            r"kortex_api: not usable in .*No module named 'kortex_api'.*\.whl.*HEFT_KORTEX_PYTHON",
        ),
        ({PYTHON_VARIABLE: "/no/such/python"}, {}, r"HEFT_KORTEX_PYTHON: got /no/such/python, which does not start"),
        ({}, {"password": "wrong"}, r"cannot be connected: KServerException: wrong password; check its power"),
        ({}, {"tool_length": 0.2}, r"stored tool .* \(0\.0000, 0\.0000, 0\.2115\) m; expected \(0, 0, 0\.2000\)"),
        ({}, {"port": 1}, r"arm 127\.0\.0\.1: cannot be connected: ConnectionRefusedError"),
    ],
)
def test_a_connection_that_fails_is_explained(gen3, monkeypatch, environment, settings, reason):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(RobotError, match=reason):
        arm_at(**{"port": gen3.port, **settings}).__enter__()


def test_the_kortex_processes_run_in_an_old_python():
    """Standard library alone, and the syntax of Python 3.8: these modules and the packages above them."""
    kinova = Path(testbed.__file__).parent / "robot" / "kinova"
    beside = ("process", "session", "connection", "standby")
    modules = [*(kinova / f"{name}.py" for name in beside), kinova.parents[1] / "packages.py"]
    for path in (*modules, *(folder / "__init__.py" for folder in (kinova, *list(kinova.parents)[:2]))):
        tree = ast.parse(path.read_text(encoding="utf-8"), feature_version=(3, 8))
        loaded = ast.walk(tree) if path in modules else tree.body
        imported = {n.module for n in loaded if isinstance(n, ast.ImportFrom) and n.module}
        imported |= {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
        ours = {name for name in imported if name.startswith("testbed")}
        assert ours <= {*(f"testbed.robot.kinova.{name}" for name in beside), "testbed.packages"}, path
        assert {name.split(".")[0] for name in imported - ours} <= set(sys.stdlib_module_names), path


ELSEWHERE = (
    "Ctrl-Z",
    "kill -9 of the stand-by",
    "SIGSTOP of the arm's process",
    "arm resets the connection",
    "SIGSTOP of the arm's process, and both are reset",
)
"""Faults that are struck in every phase; the others during twists."""


untouched = running
"""An arm that the tests above have not moved."""


CASES = [(name, phase) for name in WIRE_FAULTS for phase in (PHASES if name in ELSEWHERE else PHASES[:1])]


@slow
@pytest.mark.parametrize(("name", "phase"), CASES)
def test_every_fault_stops_the_arm_and_ends_the_trial(name: str, phase: Phase, untouched: FakeGen3):
    """By a command, long before the end of the motion; the record does not report success."""
    outcome = stopped_after(untouched, WIRE_FAULTS[name], phase)
    assert outcome.stop_s < 1.0
    assert outcome.moved_mm < 25
    assert "went on" not in outcome.said


@slow
def test_where_both_processes_are_frozen_the_arm_stops_itself(untouched: FakeGen3):
    outcome = stopped_after(untouched, freeze_both, "twists", own_limit=True)
    assert outcome.stop_s < 1.0 and outcome.moved_mm < 25


@slow
def test_the_real_path_ends_in_the_simulations_masses():
    torch.set_num_threads(1)
    model, policy, runner = load_object("L2"), RankDriven(pivots=4, duration=4.0, accelerated=0), SimulationRunner()
    simulated = []
    while (action := policy.next(model.shape, simulated)) is not None:
        simulated.append(runner.run(Trial(model, action)))
    real = over_wires(model, [t.action for t in simulated])
    if len(real) < len(simulated):
        pytest.skip("this machine is too busy for real time: trials ended as faults or came late")
    nad = []
    for trajectories in (simulated, real):
        answer = HiddenStates().estimate(model.shape, model.total_mass, trajectories, 0)
        assert answer.distribution is not None
        nad.append(100 * normalized_absolute_difference(model.shape, answer.distribution, model.truth))
    assert nad[1] < nad[0] + 1.0, [t.figures for t in real]
    assert all(t.figures["lost_frames"] == 0 for t in real)
