"""The trial that tells whether a calibration holds: a right one passes, and each wrong one is named."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimators.testing.analytic_world import analytic_trial, drawn_object
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.errors import InvalidValueError
from testbed.frames import rotate_wrench
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.robot.calibration.trial import Finding, check_trial
from testbed.sensing.windows import SteadyWindow, steady_windows
from testbed.trajectory import Trajectory

COVARIANCE = np.diag(np.array([0.01, 0.01, 0.01, 5e-4, 5e-4, 2e-4]) ** 2)


@pytest.fixture(scope="module", params=[0, 1, 2])
def obj(request: pytest.FixtureRequest) -> ObjectModel:
    return drawn_object(request.param)


def hanging(obj: ObjectModel) -> np.ndarray:
    """Wrench of the gripper on the object, held at its first grasp."""
    force = np.array([0, 0, obj.total_mass * GRAVITY])
    return np.concatenate([force, np.cross([*center(obj), -0.01], force)])


def center(obj: ObjectModel) -> np.ndarray:
    return obj.center_of_mass - obj.shape.grasps[0].position


def moves(obj: ObjectModel) -> list[Trajectory]:
    turn = Rotate(0, duration=2.5, pivot=(0.1, 0.15), back=True)
    return [
        analytic_trial(obj, a, noise=0.05) for a in (turn, Slide(0, 0.4, duration=2.5), Slide(0, 2.0, duration=2.5))
    ]


def seen(obj: ObjectModel, change: np.ndarray) -> list[Finding]:
    """The findings where every wrench goes through a 6 x 6 matrix first."""
    turned = [replace(t, wrench_on_object_world=t.wrench_on_object_world @ change.T) for t in moves(obj)]
    windows: list[SteadyWindow] = [w for t in turned for w in steady_windows(t)]
    lift = change @ hanging(obj)
    return check_trial(lift, change @ COVARIANCE @ change.T, windows, mass=obj.total_mass, center=center(obj))


def wrong(findings: list[Finding]) -> dict[str, str]:
    return {f.what: f.text for f in findings if not f.ok}


def turned(rotation: Rotation) -> np.ndarray:
    return rotate_wrench(rotation.as_matrix(), np.eye(6)).T


def test_a_right_calibration_passes(obj: ObjectModel):
    findings = seen(obj, np.eye(6))
    assert wrong(findings) == {}
    names = [f.what for f in findings]
    assert names.count("friction") == 4
    assert {"weight", "mass", "vertical", "lever arm", "there and back", "direction"} <= set(names)


def test_the_wrong_sign_is_named(obj: ObjectModel):
    said = wrong(seen(obj, -np.eye(6)))
    assert "it cannot hang upwards: sign is the wrong one" in said["weight"]
    assert "friction would have to push; sign or rotation is wrong" in said["friction"]


@pytest.mark.parametrize("degrees", [90.0, -90.0, 30.0, 180.0])
def test_a_turn_about_the_tool_axis_is_named_with_its_cure(obj: ObjectModel, degrees: float):
    said = wrong(seen(obj, turned(Rotation.from_euler("z", degrees, degrees=True))))
    cure = re.search(r"turn the sensor's rotation by ([+-]\d+) deg about the vertical", said["direction"])
    assert cure
    left = (float(cure[1]) + degrees + 180) % 360 - 180
    assert left == pytest.approx(0, abs=1)
    assert "weight" not in said
    assert "there and back" not in said


@pytest.mark.parametrize(("degrees", "told"), [(1.0, False), (4.0, True)])
def test_a_mount_that_leans_is_named(obj: ObjectModel, degrees: float, told: bool):
    said = wrong(seen(obj, turned(Rotation.from_euler("y", degrees, degrees=True))))
    assert ("vertical" in said) == told
    if told:
        assert "the sensor's rotation is off, or something touched the object" in said["vertical"]


def test_a_sensor_mounted_upside_down_is_named(obj: ObjectModel):
    said = wrong(seen(obj, turned(Rotation.from_euler("x", 180, degrees=True))))
    assert "or the sensor is mounted upside down" in said["weight"]


@pytest.mark.parametrize(("millimetres", "told"), [(1.0, False), (8.0, True)])
def test_a_lever_arm_that_is_off_is_named(obj: ObjectModel, millimetres: float, told: bool):
    x, change = millimetres / 1e3, np.eye(6)
    change[3:, :3] = np.array([[0, 0, 0], [0, 0, -x], [0, x, 0]])  # (x, 0, 0) x force
    said = wrong(seen(obj, change))
    assert ("lever arm" in said) == told
    if told:
        assert f"{millimetres:.1f} +- " in said["lever arm"]


def test_a_sensor_that_reads_too_much_is_named(obj: ObjectModel):
    assert "check the gain by a known mass" in wrong(seen(obj, 1.1 * np.eye(6)))["mass"]


def test_a_bias_is_named(obj: ObjectModel):
    turn = moves(obj)[0]
    torque = np.abs(turn.wrench_on_object_world[turn.segment >= 0, 5]).mean()
    biased = replace(turn, wrench_on_object_world=turn.wrench_on_object_world + 0.3 * torque * np.eye(6)[5])
    for trajectory, told in ((turn, False), (biased, True)):
        findings = check_trial(hanging(obj), COVARIANCE, steady_windows(trajectory))
        said = wrong(findings)
        assert ("there and back" in said) == told
        if told:
            assert "a bias that the tare left, or a cable that pulls" in said["there and back"]


def test_nothing_lifted_is_told(obj: ObjectModel):
    (finding,) = check_trial(np.array([0, 0, 0.01, 0, 0, 0]), COVARIANCE, [])
    assert not finding.ok
    assert "nothing was lifted" in finding.text
    with pytest.raises(InvalidValueError, match=r"check_trial\.mass"):
        check_trial(hanging(obj), COVARIANCE, [], mass=0.0)


def test_a_hand_that_scarcely_feels_anything_is_not_believed(obj: ObjectModel):
    slide = analytic_trial(obj, Slide(0, duration=2.5), noise=0.0)
    rng = np.random.default_rng(0)
    faint = replace(slide, wrench_on_object_world=5.0 * rng.standard_normal((len(slide.time_s), 6)))
    said = wrong(check_trial(hanging(obj), COVARIANCE, steady_windows(faint)))
    assert "too little to tell" in said["friction"]
