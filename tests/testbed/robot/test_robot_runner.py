"""Whole trials on a fake robot in simulated time, the plans of their paths, and records that are no data."""

import math
import signal
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from testbed import Accelerate, InfeasibleTrialError, Phase, Rotate, SimulationRunner, Slide, Tool, Weigh
from testbed.frames import pose_from_point
from testbed.robot.config import RobotSettings
from testbed.robot.interfaces import RobotError
from testbed.robot.kinova.gripper import data_sheet
from testbed.robot.path import closing_yaw, plan_trial, starting_pose, tool_down
from testbed.robot.recorder import GripEvidence, Record, doubts
from testbed.sensing.windows import steady_windows, weight_of
from testbed.trial import RIGID, Trial, TrialRunner
from tests.fakes.faults import BOUND, FAULTS, LIVE, PHASES, struck_by, undisturbed
from tests.fakes.robot import ACTION, briefly, robot_for, run_trial, small_object
from tests.fakes.world import BIAS
from tests.helpers.runner_conformance import RECORD_RULES, RUNNER_RULES, Bench

OBJECT = small_object()
TOOL = Tool(0.9, np.zeros(3), np.eye(3) * 1e-3, np.array([0, 0, 0.17]))


CONFORMING = Trial(OBJECT, replace(ACTION, speed=math.radians(20), duration=1.6, back=True))
TOO_FAST = Trial(OBJECT, replace(ACTION, speed=2.0))


@pytest.fixture(scope="module")
def raw(tmp_path_factory):
    """Folder of raw records."""
    return tmp_path_factory.mktemp("raw")


@pytest.fixture(scope="module")
def bench(raw) -> Bench:
    """The fake robot for the conformance suite: commanded motion is the time for which its arm has been driven."""
    fake, runner = robot_for(CONFORMING, seed=1, raw=raw, change=briefly)
    return Bench(lambda: runner, CONFORMING, TOO_FAST, moved=lambda: float(sum(m[2] for m in fake.motion)))


@pytest.fixture(scope="module")
def record(bench):
    with bench.make() as runner:
        return runner.run(CONFORMING)


@pytest.fixture
def measured(action, request):
    """Record of an action."""
    conforms = action is CONFORMING.action
    return (
        request.getfixturevalue("record") if conforms else run_trial(Trial(OBJECT, action), seed=1, change=briefly)[0]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("action", "allowed"),
    [
        (CONFORMING.action, 0.1),
        (Slide(0, direction=0.5, duration=1.6), 0.1),
        (Accelerate(1, (1.0, -1.0), 0.6, 0.2), 0.3),  # the arm still gives way when a stretch begins
    ],
    ids=["turn", "slide", "accelerated turn"],
)
def test_the_robot_measures_what_the_simulation_does(action, allowed, measured):
    trajectory = measured
    assert trajectory.ok, trajectory.reason
    usual = SimulationRunner().run(Trial(OBJECT, action))
    for ours, theirs in zip(steady_windows(trajectory), steady_windows(usual), strict=True):
        assert_allclose((ours.wrench - theirs.wrench)[[0, 1, 5]] / [allowed, allowed, 0.004], 0, atol=1)
        assert_allclose((ours.twist - theirs.twist) / [2e-3, 2e-3, 0.02], 0, atol=1)
        assert ours.tcp_height == pytest.approx(theirs.tcp_height, abs=5e-4)
        assert_allclose(np.ptp(ours.yaw), np.ptp(theirs.yaw), atol=0.03)
    moving = usual.mask(Phase.RAMP, Phase.STEADY)
    assert_allclose(
        trajectory.object_pose[trajectory.mask(Phase.RAMP, Phase.STEADY)][0], usual.object_pose[moving][0], atol=2e-3
    )
    assert trajectory.figures["drift_N"] < 0.1
    assert trajectory.provenance["runner"] == "robot"


@pytest.mark.slow
def test_the_raw_record_is_kept_with_its_bias():
    usual, _ = undisturbed()
    tare, tool = usual.mask(Phase.TARE), usual.tool
    assert tool is not None
    held = np.array([0, 0, -tool.mass * 9.81])  # the tool points down, and so does the sensor's z axis
    assert_allclose(usual.sensor_wrench[tare].mean(axis=0)[:3], BIAS[:3] + held, atol=0.05)
    assert_allclose(usual.wrench_on_object_world[tare].mean(axis=0), 0, atol=0.05)
    assert usual.figures["slip_m"] < 1e-3


class Seen:
    """Tracker that sees one pose."""

    def __init__(self, pose):
        self._pose = pose

    def read(self):
        return self._pose


def test_slip_is_that_of_the_grasp_wherever_the_object_has_its_origin(monkeypatch):
    trial = Trial(OBJECT, ACTION)
    grasp, held, turn, slip = trial.grasp.position, np.array([0.45, 0.0]), 0.02, np.array([0.003, -0.002])
    monkeypatch.setattr(
        "testbed.robot.runner.object_poses", lambda *_: pose_from_point(held, grasp, np.array(0.3))[None]
    )
    seen = pose_from_point(held + slip, grasp, np.array(0.3 + turn))
    _, runner = robot_for(trial, tracker=Seen(tuple(seen)))
    plan = plan_trial(trial, starting_pose(trial), runner._settings)
    record: Any = SimpleNamespace(during=lambda *_: np.array([True]))
    assert runner._slip(plan, record) == pytest.approx((np.hypot(*slip), turn))


@pytest.mark.slow
def test_a_sensor_that_is_turned_and_negated_and_has_gains_gives_the_same():
    """The calibration undoes what the mount and the axes do."""
    trial, about_z = Trial(OBJECT, ACTION), np.array([-1.0, -1.0, 1.0])
    gain = np.array([1.1, 0.9, 1.2, 0.9, 1.1, 0.8])
    robot, runner = robot_for(
        trial,
        change=lambda settings: replace(
            settings,
            tool=replace(settings.tool, com=settings.tool.com * about_z, tcp=settings.tool.tcp * about_z),
            sensor_orientation=np.array([0.0, 0.0, 0.0, 1.0]),
            sensor_sign=-1,
            sensor_gain=gain,
        ),
    )
    robot.world.mount = -np.tile(about_z, 2) * gain
    with runner:
        trajectory = runner.run(trial)
    assert trajectory.ok, trajectory.reason
    (ours,), (theirs,) = steady_windows(trajectory), steady_windows(undisturbed()[0])
    assert_allclose((ours.wrench - theirs.wrench) / [0.05, 0.05, 0.1, 0.01, 0.01, 0.003], 0, atol=1)


@pytest.mark.slow
def test_lifting_weighs_the_object_with_its_error():
    trajectory, _ = run_trial(Trial(OBJECT, Weigh(), RIGID))
    assert trajectory.ok, trajectory.reason
    error = trajectory.figures["weight_std_kg"]
    assert 0.002 < error < 0.02
    assert weight_of(trajectory) == pytest.approx(OBJECT.total_mass, abs=3 * error)
    assert weight_of(trajectory) == pytest.approx(trajectory.figures["weight_kg"], abs=1e-3)


@pytest.mark.slow
def test_nothing_moves_before_the_motion_was_shown_and_confirmed():
    """Shown once a runner, and only by a connected one; without a tracker slip is not known."""
    shown: list[str] = []
    trial = Trial(OBJECT, replace(ACTION, duration=1.3))
    robot, runner = robot_for(
        trial,
        confirm=lambda text: shown.append(text) or len(shown) > 1,
        tracker=None,
        change=briefly,
    )
    assert isinstance(runner, TrialRunner)
    with pytest.raises(RobotError, match="not connected"):
        runner.run(trial)
    with runner:
        robot.clock.sleep(0.5)
        with pytest.raises(RobotError, match="not confirmed; nothing has moved"):
            runner.run(trial)
        assert robot.driven_after(0.0) == 0.0
        for _ in range(2):
            robot.world.place(starting_pose(trial), 0)
            record = runner.run(trial)
            assert record.ok
            assert "slip_m" not in record.figures and "not known" in record.provenance["slip"]
    assert len(shown) == 2
    for part in ("down to the object", "the action", "turned by", "17.2 deg/s", "x: 0.4", "allowed 0.250 to 0.650 m"):
        assert part in shown[0]


def test_a_motion_that_is_not_confirmed_leaves_no_record(tmp_path):
    trial, answers = Trial(OBJECT, ACTION), iter([lambda: False, lambda: signal.raise_signal(signal.SIGINT)])
    _, runner = robot_for(trial, confirm=lambda _: next(answers)(), raw=tmp_path)
    for error in (RobotError, KeyboardInterrupt):
        with runner, pytest.raises(error):
            runner.run(trial)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("action", "why"),
    [
        (Slide(0, duration=14.0), r"down to the object: y of the tool: 0\.36 m; allowed: at most 0\.35 m"),
        (Rotate(0, speed=1.4, duration=1.0), r"the action: planned turn rate: 1\.4 rad/s; allowed: at most 1\.2"),
    ],
)
def test_what_passes_a_limit_is_refused_before_it_moves(action, why):
    trial = Trial(OBJECT, action)
    robot, runner = robot_for(trial)
    with runner, pytest.raises(InfeasibleTrialError, match=why):
        runner.run(trial)
    assert robot.driven_after(0.0) == 0.0


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.0])
def test_the_tools_orientation_and_its_yaw_are_inverses(angle):
    settings = RobotSettings(TOOL, closing_angle=angle)
    yaw = np.linspace(-3, 3, 7)
    orientation = np.array([tool_down(float(y), settings) for y in yaw])
    assert_allclose(closing_yaw(orientation, settings), yaw, atol=1e-12)


def test_a_plan_follows_the_object_where_it_lies():
    settings = RobotSettings(TOOL, table_height=-0.02)
    pose = np.array([0.5, -0.1, 0.4])
    plan = plan_trial(Trial(OBJECT, ACTION), pose, settings)
    grasp = OBJECT.shape.grasps[0]
    c, s = math.cos(0.4), math.sin(0.4)
    x, y = pose[:2] + np.array([[c, -s], [s, c]]) @ grasp.position
    assert_allclose(plan.descent.end, [x, y, settings.grip_height - 0.02], atol=1e-12)
    assert plan.descent.yaw == pytest.approx(0.4 + grasp.angle)
    assert plan.act is not None
    for leg in plan.legs.values():  # velocities are those of the positions
        times = np.linspace(0.1, leg.duration - 0.1, 9)
        ahead, behind = ([leg.at(t + d) for t in times] for d in (0.01, -0.01))
        slope = np.array([(a.position - b.position) / 0.02 for a, b in zip(ahead, behind, strict=True)])
        assert_allclose(slope, [leg.at(t).velocity for t in times], atol=2e-3)


@pytest.mark.parametrize("rule", RUNNER_RULES, ids=lambda f: f.__name__)
def test_the_runner_keeps(rule, bench):
    rule(bench)


@pytest.mark.parametrize("rule", RECORD_RULES, ids=lambda f: f.__name__)
def test_the_record_keeps(rule, record):
    rule(record, CONFORMING)


MISTAKES = {
    "sign": {"sensor_sign": -1},
    "gains": {"sensor_gain": np.repeat([1.0, 0.5], 3)},
    "rotation": {"sensor_orientation": np.array([0.0, 0.0, 0.0, 1.0])},
    "mass": {"tool": replace(TOOL, mass=2.0)},
    "center": {"tool": replace(data_sheet(0.05), com=np.array([0.0, 0.0, -0.06]))},
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n == "sign" else pytest.mark.slow) for n in MISTAKES], ids=str
)
def test_a_wrong_calibration_is_detected_before_any_contact(name):
    """By the change of the wrench as the tool is tilted over the object."""
    lowest: list[float] = []
    record, robot = run_trial(
        Trial(OBJECT, ACTION),
        lambda robot: lowest.append(robot.world.reading.tcp_pose.position[2]),
        change=lambda settings: replace(settings, **MISTAKES[name]),
    )
    assert record.status == "fault"
    assert "than its weight says" in record.reason
    assert min(lowest) > 0.07 and robot.world.grip < 0


def test_the_raw_record_has_every_frame_and_how_it_ended(record, raw):
    path = raw / record.provenance["raw"]
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[-1].split(",")[0::2] == ["end", "ok"]
    frames = np.array([line.split(",")[1:] for line in lines[4:] if line.startswith("frame,")], dtype=float)
    kept = frames[(frames[:, 0] >= frames[-1, 0] - record.time_s[-1] - 1e-6), 2:]
    assert_allclose(kept[: len(record.time_s)], record.sensor_wrench, atol=1e-9)
    assert sum(line.startswith("mark,") for line in lines[4:]) == 7


QUICK = ("SIGTERM",)
CASES = [(fault, None) for fault in FAULTS] + [
    (fault, phase)
    for n, fault in enumerate(LIVE)
    for m, phase in enumerate(fault.phases)
    if n in (0, 2) or (n + m) % len(PHASES) == 0
]


@pytest.mark.parametrize(
    ("fault", "phase"),
    [
        pytest.param(*case, id=f"{case[0].name}-{case[1]}", marks=() if case[0].name in QUICK else pytest.mark.slow)
        for case in CASES
    ],
)
def test_a_fault_stops_the_arm_and_no_bad_record_is_data(fault, phase):
    """In a phase, or at one moment of a trial; bench/faults.py strikes at many, and with all faults in all phases."""
    outcome = struck_by(fault, 0, phase)
    assert outcome.after_stop <= BOUND
    assert outcome.after_loss <= BOUND
    assert not outcome.wrong
    assert outcome.ended == "ok" or outcome.reason or outcome.ended == "KeyboardInterrupt"
    if phase is not None:
        assert outcome.to_stop <= fault.stops_in
        assert outcome.ended in ("fault", "limit")
        assert fault.says in outcome.reason
        assert fault.says in outcome.raw_end or "disk" in fault.name
        assert outcome.raw_frames > 95 * outcome.struck


PATH = Rotate(0, duration=2.0).tool_path(OBJECT.shape, np.zeros(3), 0.01)
RESTLESS = "tare: the force scattered"
GOOD = GripEvidence(lost_frames=0, held_width=(0.05, 0.0501), slip=(1e-4, 1e-3))


def turn_of(**changes) -> Record:
    """A tare, a turn under 1 N, a tare, at 100 Hz, with a sensor's noise."""
    tare, turn = 100, len(PATH.segment)
    count = tare + turn + tare
    phase = np.full(count, Phase.TARE)
    phase[tare:-tare] = np.where(PATH.segment >= 0, Phase.STEADY, Phase.RAMP)
    segment = np.full(count, -1)
    segment[tare:-tare] = PATH.segment
    values = {
        "time_s": np.arange(count) / 100,
        "phase": phase,
        "segment": segment,
        "wrench": 0.07 * np.random.default_rng(0).standard_normal((count, 6)) + (phase != Phase.TARE)[:, None],
        "tcp_position": np.zeros((count, 3)),
        "tcp_orientation": np.tile([0.0, 1.0, 0.0, 0.0], (count, 1)),
        "tcp_velocity": np.zeros((count, 6)),
        "joint_position": np.zeros((count, 7)),
        "wrench_gap": 0.01,
        "feedback_gap": 0.01,
    }
    return Record(**{**values, **changes})


def wrench(at: slice, value: np.ndarray | float) -> np.ndarray:
    changed = turn_of().wrench.copy()
    changed[at] = value
    return changed


def test_a_good_record_has_no_defect():
    assert list(doubts(turn_of(), GOOD, PATH)) == []
    assert list(doubts(turn_of(), replace(GOOD, slip=None), None)) == []


@pytest.mark.parametrize(
    ("changes", "evidence", "status", "said"),
    [
        ({}, {"held_width": (0.05, 0.047)}, "slipped", "opening changed by 3.0 mm"),
        ({}, {"slip": (0.004, 0.0)}, "slipped", "moved 4.0 mm and 0.00 deg in the grip"),
        ({}, {"slip": (0.0, 0.03)}, "slipped", "1.72 deg"),
        ({}, {"slip": (np.nan, 0.0)}, "slipped", "nan"),
        ({}, {"lost_frames": 10}, "fault", "10 of "),
        ({"wrench_gap": 0.06}, {}, "fault", "sensor: silent for 60 ms"),
        ({"feedback_gap": 0.09}, {}, "fault", "arm: silent for 90 ms"),
        ({"wrench": wrench(slice(0, 50), 3 + np.arange(50)[:, None] * 1e-3)}, {}, "fault", RESTLESS),
        ({"wrench": wrench(slice(-40, -1), 3 + np.arange(39)[:, None] * 1e-3)}, {}, "fault", RESTLESS),
        ({"segment": np.where(np.arange(480) % 9 == 0, -1, turn_of().segment)}, {}, "fault", "of steady stretch 0"),
    ],
)
def test_each_reason_is_found_alone(changes, evidence, status, said):
    found = list(doubts(turn_of(**changes), replace(GOOD, **evidence), PATH))
    assert [f[0] for f in found] == [status]
    assert said in found[0][1]


@pytest.mark.parametrize("scale", [0.0, 1e-3, 1.0], ids=["frozen", "quiet", "noise"])
def test_a_sensor_without_a_response_to_the_motion_is_dead(scale):
    idle = scale * 0.07 * np.random.default_rng(0).standard_normal((480, 6)) + [3.3, -2.1, 9.2, 0.11, -0.21, 0.31]
    (found,) = doubts(turn_of(wrench=idle), GOOD, PATH)
    assert found[0] == "fault" and "the sensor feels nothing" in found[1]


def test_a_zero_that_drifts_between_the_tares_is_no_scatter_of_either():
    assert list(doubts(turn_of(wrench=turn_of().wrench + np.linspace(0, 5, 480)[:, None] ** 3 / 400), GOOD, PATH)) == []
