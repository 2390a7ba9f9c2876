"""The trial that tells whether a calibration holds: a right one passes, and each wrong one is named."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimators.testing.analytic_world import analytic_trial, drawn_object
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.frames import rotate_wrench
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.robot.calibration.trial import Finding, check_trial
from testbed.sensing.windows import steady_windows
from testbed.trajectory import Trajectory

COVARIANCE = np.diag(np.array([0.01, 0.01, 0.01, 5e-4, 5e-4, 2e-4]) ** 2)
TURN = Rotate(0, duration=2.5, pivot=(0.1, 0.15), back=True)
MOVES = (TURN, Slide(0, 0.4, duration=2.5), Slide(0, 2.0, duration=2.5))


@pytest.fixture(scope="module", params=[0, 1, 2])
def obj(request: pytest.FixtureRequest) -> ObjectModel:
    return drawn_object(request.param)


@pytest.fixture(scope="module")
def moves(obj: ObjectModel) -> list[Trajectory]:
    return [analytic_trial(obj, action, noise=0.05) for action in MOVES]


@pytest.fixture
def findings(obj: ObjectModel, moves: list[Trajectory], change: np.ndarray) -> list[Finding]:
    """Findings where every wrench goes through a 6 x 6 matrix first."""
    changed = [replace(t, wrench_on_object_world=t.wrench_on_object_world @ change.T) for t in moves]
    windows = [window for t in changed for window in steady_windows(t)]
    center = obj.center_of_mass - obj.shape.grasps[0].position
    force = np.array([0, 0, obj.total_mass * GRAVITY])
    lift = change @ np.concatenate([force, np.cross([*center, -0.01], force)])
    return check_trial(lift, change @ COVARIANCE @ change.T, windows, mass=obj.total_mass, center=center)


def wrong(findings: list[Finding]) -> dict[str, str]:
    return {f.what: f.text for f in findings if not f.ok}


def turned(axis: str, degrees: float) -> np.ndarray:
    return rotate_wrench(Rotation.from_euler(axis, degrees, degrees=True).as_matrix(), np.eye(6)).T


def lever(x: float) -> np.ndarray:
    """Moments about a point x [m] aside."""
    change = np.eye(6)
    change[3:, :3] = np.array([[0, 0, 0], [0, 0, -x], [0, x, 0]])
    return change


@pytest.mark.parametrize("change", [np.eye(6)])
def test_a_right_calibration_passes(findings: list[Finding]):
    assert wrong(findings) == {}
    names = [f.what for f in findings]
    assert names.count("friction") == 4
    assert {"weight", "mass", "vertical", "lever arm", "there and back", "direction"} <= set(names)


@pytest.mark.parametrize(
    ("change", "what", "words"),
    [
        (-np.eye(6), "weight", "it cannot hang upwards: sign is the wrong one"),
        (-np.eye(6), "friction", "friction would have to push; sign or rotation is wrong"),
        (1.1 * np.eye(6), "mass", "check the gain by a known mass"),
        (turned("x", 180), "weight", "or the sensor is mounted upside down"),
        (turned("y", 4.0), "vertical", "the sensor's rotation is off, or something touched the object"),
        (turned("y", 1.0), "vertical", None),
        (lever(0.008), "lever arm", "8.0 +- "),
        (lever(0.001), "lever arm", None),
        (turned("z", 30.0), "weight", None),
        (turned("z", 30.0), "there and back", None),
    ],
)
def test_what_is_wrong_is_named(findings: list[Finding], what: str, words: str | None):
    said = wrong(findings)
    assert words in said[what] if words else what not in said


@pytest.mark.parametrize(("degrees", "change"), [(d, turned("z", d)) for d in (90.0, -90.0, 30.0, 180.0)])
def test_a_turn_about_the_tool_axis_is_named_with_its_cure(findings: list[Finding], degrees: float):
    cure = re.search(r"turn the sensor's rotation by ([+-]\d+) deg about the vertical", wrong(findings)["direction"])
    assert cure
    assert (float(cure[1]) + degrees + 180) % 360 - 180 == pytest.approx(0, abs=1)


def test_a_bias_is_named(moves: list[Trajectory]):
    turn = moves[0]
    torque = np.abs(turn.wrench_on_object_world[turn.segment >= 0, 5]).mean()
    biased = replace(turn, wrench_on_object_world=turn.wrench_on_object_world + 0.3 * torque * np.eye(6)[5])
    assert "there and back" not in wrong(check_trial(None, None, steady_windows(turn)))
    said = wrong(check_trial(None, None, steady_windows(biased)))
    assert "a bias that the tare left, or a cable that pulls" in said["there and back"]


def test_nothing_lifted_and_next_to_nothing_measured_are_told(moves: list[Trajectory]):
    assert "nothing was lifted" in wrong(check_trial(np.array([0, 0, 0.01, 0, 0, 0]), COVARIANCE, []))["weight"]
    noise = 5.0 * np.random.default_rng(0).standard_normal((len(moves[1].time_s), 6))
    faint = replace(moves[1], wrench_on_object_world=noise)
    assert "too little to decide" in wrong(check_trial(None, None, steady_windows(faint)))["friction"]
