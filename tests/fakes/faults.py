"""The table of faults: everything that may go wrong on the real robot, put into a trial on the fake one."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np

from testbed import HeftError, Phase, Trajectory, Trial, steady_windows
from testbed.robot.raw_record import RawRecord
from testbed.robot.robotiq.ft300s import NOISE
from tests.fakes.robot import ACTION, COUNTS, FakeRobot, robot_for, run_trial, small_object

BOUND = 0.150
"""Time after which nothing may drive the arm [s]."""
WRONG = np.array([0.25, 0.25, np.inf, np.inf, np.inf, 0.02])
"""Difference from an undisturbed trial's wrench that makes a record wrong [N, N m]: ten times its noise."""
LOST_PLACE = 0.003
"""Slip of the object that makes a record wrong [m]."""


@dataclass(frozen=True)
class Fault:
    """One fault at some moment of a trial."""

    name: str
    changes: dict[str, Any]
    """Fields of `Troubles`, or "world.*" and "clock.*", and their values from then on."""
    pause: float = math.inf
    """Time after which all is well again [s]."""
    blinds: bool = False
    """True if the arm's feedback ends."""
    until: float = 0.95
    """Part of the trial in which it may strike."""
    stops_in: float = math.inf
    """Time within which it must stop the arm, in every phase of a trial that is long enough [s]."""
    says: str = ""
    """Part of what the record then says."""

    @property
    def phases(self) -> tuple[str, ...]:
        """Phases that are long enough to find it."""
        return PHASES if self.stops_in < LAST_TARE else PHASES[:-1]

    def strike(self, robot: FakeRobot) -> None:
        """Cause it."""
        for name, value in self.changes.items():
            owner, _, field = name.rpartition(".")
            part = getattr(robot, owner or "troubles")
            if self.pause < math.inf:
                robot.later(self.pause, partial(setattr, part, field, getattr(part, field)))
            setattr(part, field, value)


RANDOM = np.random.default_rng(5).integers(0, 2, (100_000, 6))
"""Tosses of a coin for each frame and component."""


def toggles(number: int, held: np.ndarray) -> np.ndarray:
    """Last count of every component, up and down."""
    return held[-1] + (number % 2) / COUNTS


def toggles_at_random(number: int, held: np.ndarray) -> np.ndarray:
    """Last count of every component, by chance."""
    return held[-1] + RANDOM[number] / COUNTS


def creeps(number: int, held: np.ndarray) -> np.ndarray:
    """One count up in every third frame."""
    return held[-1] + (number // 3) / COUNTS


def replays(number: int, held: np.ndarray) -> np.ndarray:
    """The last 30 frames, again and again."""
    return held[-30 + number % 30]


def hears_noise_alone(number: int, held: np.ndarray) -> np.ndarray:
    """Noise about the last wrench: the load no longer reaches the sensor."""
    noise = np.array(NOISE) * np.random.default_rng([number, 8]).standard_normal(6)
    return np.round((held.mean(axis=0) + noise) * COUNTS) / COUNTS


def alone(axis: int, dead: Callable[[int, np.ndarray], np.ndarray]) -> Callable[[int, np.ndarray], np.ndarray]:
    """One dead component."""
    return lambda number, held: np.where(np.arange(6) == axis, dead(number, held), np.nan)


FORCE, TORQUE = np.array([100.0, 0, 0, 0, 0, 0]), np.array([0, 0, 0, 0, 0, 20.0])
FAULTS = (
    Fault("connection of the arm lost", {"arm_lost": True}, blinds=True),
    Fault("feedback of the arm stalls", {"feedback_stalls": True}, blinds=True),
    Fault("feedback of the arm pauses for 90 ms", {"feedback_stalls": True}, pause=0.09),
    Fault("feedback of the arm says it stands", {"feedback_lies": True}),
    Fault("arm goes into a fault", {"arm_faulted": True}),
    Fault("arm refuses twists", {"refuses_twists": True}),
    Fault("arm refuses poses", {"refuses_poses": True}, until=0.05),
    Fault("arm stops short of poses", {"misses_poses": True}, until=0.08),
    Fault("arm ignores twists", {"ignores_twists": True}),
    Fault("twists in the wrong unit", {"twist_scale": 57.3}),
    Fault("twists in the wrong direction", {"twist_scale": -1.0}),
    Fault("twists 300 ms late", {"latency": 0.3}),
    Fault("a twist hangs for 1 s", {"hang": 1.0}),
    Fault("the arm's driver crashes", {"crash": ValueError("a mistake in a driver")}),
    Fault("Ctrl-C", {"crash": KeyboardInterrupt()}),
    Fault("SIGTERM", {"crash": SystemExit(143)}),
    Fault("the control loop hangs for 1 s", {"clock.hang": 1.0}),
    Fault("the guard no longer looks", {"guard_dead": True}),
    Fault("sensor unplugged", {"sensor_lost": True}),
    Fault("sensor stalls", {"sensor_stalls": True}),
    Fault("sensor pauses for 70 ms", {"sensor_stalls": True}, pause=0.07),
    Fault("a fifth of the frames lost", {"drops": 0.2}),
    Fault("sensor repeats one frame", {"frozen": True}),
    Fault("sensor hears its noise alone", {"dead": hears_noise_alone}),
    Fault("the tool hits something", {"load": FORCE}),
    Fault("the tool is twisted", {"load": TORQUE}),
    Fault("the sensor's zero jumps by 1 N", {"load": FORCE / 100}),
    Fault("the sensor's zero creeps by 0.1 N/s", {"drift": FORCE / 1000}),
    Fault("the gripper refuses", {"gripper_refuses": True}),
    Fault("the gripper lets go", {"lets_go": True}),
    Fault("the grip weakens", {"world.strength": 0.03}),
    Fault("the object is pushed away", {"world.push": (20, np.array([60.0, 60.0, 0.0]))}),
)
NAN = np.full(6, np.nan)
LIVE = (
    Fault("the tool hits something", {"load": FORCE}, stops_in=0.03, says="force: "),
    Fault("1000 N", {"load": 10 * FORCE}, stops_in=0.03, says="raw force: "),
    Fault("NaN for one frame", {"load": NAN}, pause=0.01, stops_in=0.03, says="no number"),
    Fault("sensor repeats one frame", {"frozen": True}, stops_in=0.07, says="equal frames in a row: 5"),
    Fault("fx is stuck", {"stuck": 0}, stops_in=0.1, says="equal values of fx in a row: 8"),
    Fault("tz is stuck", {"stuck": 5}, stops_in=0.22, says="equal values of tz in a row: 20"),
    Fault("last counts toggle", {"dead": toggles}, stops_in=0.09, says="those of 2 before: 5"),
    Fault(
        "last counts toggle at random", {"dead": toggles_at_random}, stops_in=0.2, says="changes from frame to frame"
    ),
    Fault("counts creep", {"dead": creeps}, stops_in=0.2, says="changes from frame to frame"),
    Fault("30 frames are replayed", {"dead": replays}, stops_in=0.1, says="those of 30 before: 5"),
    Fault("fx toggles", {"dead": alone(0, toggles)}, stops_in=0.13, says="fx in a row with a period of 2"),
    Fault("fx toggles at random", {"dead": alone(0, toggles_at_random)}, stops_in=0.25, says="fx has two values alone"),
    Fault("tz toggles", {"dead": alone(5, toggles)}, stops_in=0.26, says="tz in a row with a period of 2"),
    Fault("tz toggles at random", {"dead": alone(5, toggles_at_random)}, stops_in=0.62, says="tz has two values alone"),
    Fault("sensor stalls", {"sensor_stalls": True}, stops_in=0.1, says="age of the wrench"),
    Fault("sensor unplugged", {"sensor_lost": True}, stops_in=0.03, says="unplugged"),
    Fault("feedback of the arm stalls", {"feedback_stalls": True}, stops_in=0.1, says="age of the feedback"),
    Fault("arm goes into a fault", {"arm_faulted": True}, stops_in=0.03, says="fault"),
    Fault("the disk is full", {"disk_full": True}, stops_in=0.03, says="No space left on device"),
    Fault("frozen, and the disk is full", {"frozen": True, "disk_full": True}, stops_in=0.03, says="No space left"),
    Fault("sensor and feedback stall", {"sensor_stalls": True, "feedback_stalls": True}, stops_in=0.1, says="age of"),
    Fault("NaN in an arm's fault", {"load": NAN, "arm_faulted": True}, stops_in=0.03),
)
"""Faults that the guard must find while a trial runs, also two at once, and how soon."""
LAST_TARE = 0.4
"""Time that is left of a trial in the middle of its last tare [s]: slower finds do not fit in."""
PHASES = ("travel", "tool check", "tare", "approach", "grasp", "settle", "action", "release", "last tare")


@dataclass(frozen=True)
class Outcome:
    """Outcome of a trial with a fault."""

    fault: str
    seed: int
    struck: float
    """Time of the fault [s]."""
    ended: str
    """Status of the trajectory, or the error's name."""
    reason: str
    after_stop: float
    """Time for which the arm was driven after `stop` [s]."""
    after_loss: float
    """Time for which it was driven after the last feedback, if that was lost [s]."""
    rolled: float
    """Time for which the tool moved after `stop` [s]: the fake arm slows down."""
    wrong: str
    """Reason that an ok trajectory is wrong, else empty."""
    to_stop: float
    """Time from the fault to the next stop [s]; infinite without any."""
    way: float
    """Way of the tool after the fault [m], a radian counted as 0.1 m."""
    raw_end: str
    """Last line of the raw record."""
    raw_frames: int
    """Frames in it."""


@lru_cache(maxsize=1)
def undisturbed() -> tuple[Trajectory, float]:
    """The trial without any fault, and its duration [s]."""
    trajectory, robot = run_trial(Trial(small_object(), ACTION), seed=99)
    assert trajectory.ok, trajectory.reason
    return trajectory, robot.clock.now()


def middle_of(phase: str) -> float:
    """Time in the middle of a phase of the undisturbed trial [s]."""
    trajectory, duration = undisturbed()
    begin = duration - trajectory.time_s[-1]
    if phase in ("travel", "tool check"):
        return 0.3 * begin if phase == "travel" else begin - 1.5
    kinds = ("RAMP", "STEADY") if phase == "action" else ("TARE" if "tare" in phase else phase.upper(),)
    inside = trajectory.time_s[trajectory.mask(*(Phase[kind] for kind in kinds))]
    if "tare" in phase:
        inside = inside[inside > inside.mean()] if phase == "last tare" else inside[inside < inside.mean()]
    return begin + float(inside.mean())


def struck_by(fault: Fault, seed: int, phase: str | None = None) -> Outcome:
    """Run the trial with one fault at a random moment of it, or in the middle of a phase."""
    _, duration = undisturbed()
    at = float(np.random.default_rng([seed, 5]).uniform(0.0, fault.until) * duration)
    at = at if phase is None else middle_of(phase)
    done: list[float] = []

    def watch(robot: FakeRobot) -> None:
        if not done and robot.clock.now() >= at:
            done.append(robot.clock.now())
            fault.strike(robot)

    trial = Trial(small_object(), ACTION)
    folder = TemporaryDirectory()
    robot, runner = robot_for(trial, watch, seed=seed, raw=Path(folder.name))

    def remembered(at: Path) -> RawRecord:
        robot.raw.append(RawRecord(at))
        return robot.raw[-1]

    trajectory, ended, reason = None, "", ""
    try:
        with patch("testbed.robot.runner.RawRecord", remembered), runner:
            trajectory = runner.run(trial)
        ended, reason = trajectory.status, trajectory.reason
    except (HeftError, KeyboardInterrupt, SystemExit, ValueError) as error:
        ended, reason = type(error).__name__, str(error)
    robot.clock.sleep(1.0)  # nothing may move of itself afterwards
    first = min(robot.arm.stopped)
    lines = robot.raw[0].path.read_text(encoding="utf-8").splitlines()
    folder.cleanup()
    struck = done[0] if done else math.inf
    return Outcome(
        fault.name,
        seed,
        done[0] if done else float("nan"),
        ended,
        reason,
        robot.driven_after(first),
        robot.driven_after(done[0]) if fault.blinds and done else 0.0,
        robot.moved_after(first),
        "" if trajectory is None or not trajectory.ok else wrongness(trajectory, robot),
        min((stop - struck for stop in robot.arm.stopped if stop >= struck), default=math.inf),
        robot.way_after(struck),
        lines[-1],
        sum(line.startswith("frame,") for line in lines) - 1,
    )


def wrongness(trajectory: Trajectory, robot: FakeRobot) -> str:
    """Reason that a trajectory is no data, by the truth of the fake robot; else empty."""
    expected = steady_windows(undisturbed()[0])
    for window, usual in zip(steady_windows(trajectory), expected, strict=True):
        off = np.abs(window.wrench - usual.wrench)
        if (off > WRONG).any():
            return f"wrench off by {off.round(3).tolist()}"
    if (slid := robot.slid) > LOST_PLACE:
        return f"the object slid {slid * 1e3:.1f} mm in the grip"
    return ""
