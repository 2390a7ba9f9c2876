"""Checks of a calibrated bench: a trial, motion against the stated actions, weighing and a known mass."""

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from estimators.testing.analytic_world import analytic_trial, drawn_object
from testbed import GRAVITY, ObjectModel, Rotate, Slide, Trajectory, steady_windows
from testbed.frames import perpendicular, rotate_wrench, rotation_2d
from testbed.robot.calibration.motion import check_motion, check_wrenches, wrong_motion
from testbed.robot.calibration.trial import Finding, check_trial
from testbed.robot.weighing import Weighing, check_known_mass, held_center, weigh
from testbed.worlds.presets import UNSTATED
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors
from tests.fakes.analytic_links import analytic_links, drawn_chain
from tests.helpers.blocks import blocks
from tests.helpers.records import coloured_noise

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


def wrong(findings: Iterable[Finding]) -> dict[str, str]:
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


def test_nothing_lifted_and_a_drag_below_the_noise_are_reported(moves: list[Trajectory]):
    assert "nothing was lifted" in wrong(check_trial(np.array([0, 0, 0.01, 0, 0, 0]), COVARIANCE, []))["weight"]
    noise = 5.0 * np.random.default_rng(0).standard_normal((len(moves[1].time_s), 6))
    faint = replace(moves[1], wrench_on_object_world=noise)
    assert "too little to decide" in wrong(check_trial(None, None, steady_windows(faint)))["friction"]


OBJECT = drawn_object(0)
BESIDE = np.array([[0.02, 0.015], [-0.02, 0.01], [0.015, -0.025], [-0.01, -0.02], [0.03, 0.0]])


def turns(obj: ObjectModel = OBJECT) -> list[Trajectory]:
    grasps = [k % len(obj.shape.grasps) for k in range(len(BESIDE))]
    pivots = [tuple(obj.shape.grasps[g].position + by) for g, by in zip(grasps, BESIDE, strict=True)]
    return [analytic_trial(obj, Rotate(g, duration=2.5, pivot=p)) for g, p in zip(grasps, pivots, strict=True)]


def turn_of(trial: Trajectory) -> Rotate:
    assert isinstance(trial.action, Rotate)
    return trial.action


def yawed(trial: Trajectory, more: float) -> Trajectory:
    """Trial whose stated yaw of the object is off by `more` [rad], about the grasp."""
    return replace(trial, object_pose=trial.object_pose + np.array([0.0, 0.0, more]))


def wrong_in(trials: list[Trajectory], shape=OBJECT.shape) -> dict[str, str]:
    return wrong(check_motion(shape, trials))


def test_right_statements_pass():
    findings = check_motion(OBJECT.shape, [*turns(), SLIDE])
    assert [finding.what for finding in findings] == ["closing direction", "TCP", "center", "heading"]
    assert all(finding.ok for finding in findings)


SLIDE = analytic_trial(OBJECT, Slide(0, 0.3))


def test_a_bias_turns_the_force_of_a_light_object_and_nothing_is_wrong():
    light = blocks(["11"], [0.03, 0.03], 0.3)
    slide = analytic_trial(light, Slide(0, 0.3))
    bias = np.array([*(rotation_2d(0.3) @ [0.0, 0.05]), 0.0, 0.0, 0.0, 0.0])
    biased = replace(slide, wrench_on_object_world=slide.wrench_on_object_world + bias)
    assert "direction" in wrong(check_wrenches(light.shape, [biased]))
    stated = replace(biased, sensor_bias_std=np.array([0.05, 0.05, 0.05, 0.002, 0.002, 0.002]))
    assert not wrong(check_wrenches(light.shape, [stated]))
    turn = analytic_trial(light, Rotate(0, duration=2.5))
    tared = replace(
        turn, wrench_on_object_world=turn.wrench_on_object_world - np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.01])
    )
    assert [f.what for f in check_wrenches(light.shape, [tared]) if f.value < 0] == ["friction"]
    assert wrong_motion(light.shape, [tared])
    assert not wrong_motion(light.shape, [replace(tared, sensor_bias_std=np.repeat([0.05, 0.005], 3))])


def test_a_trial_too_short_for_an_estimate_has_no_findings_and_leaves_those_of_others():
    brief = [analytic_trial(OBJECT, action) for action in (Rotate(0, duration=1.1), Slide(0, 0.3, duration=1.1))]
    assert wrong_motion(OBJECT.shape, [*turns(), *brief]) == []
    assert set(wrong_in([*(yawed(trial, 0.3) for trial in turns()), *brief])) == {"closing direction"}


def test_a_slide_in_another_direction_is_named():
    assert not wrong_in([SLIDE])
    other = replace(SLIDE, action=Slide(0, -0.6))
    assert "it moves +52 deg off that direction: correct its direction" in wrong_in([other])["heading"]
    assert set(wrong_in([*(yawed(trial, 0.7) for trial in turns()), other])) == {"closing direction"}


@pytest.mark.parametrize("degrees", [90, -35, 2, -2])
def test_the_closing_direction_is_corrected_by_what_it_is_off(degrees):
    trials = [yawed(trial, np.radians(degrees)) for trial in turns()]
    found = wrong_in(trials)
    assert set(found) == {"closing direction"}
    cure = f"correct closing_deg by {degrees:+.1f} (z axis that points up: {-degrees:+.1f})"
    assert cure in found["closing direction"]
    assert not wrong_in(turns()[:1]) and set(wrong_in(trials[:1])) == {"closing direction"}


@pytest.mark.parametrize(("setup", "found"), [(EXACT_SETUP, {"closing direction"}), (UNSTATED, set())])
def test_a_setup_that_is_stated_as_exact_is_held_to_it(setup: SetupErrors, found: set[str]):
    trials = [replace(yawed(trial, np.radians(0.5)), setup=setup) for trial in turns()]
    assert set(wrong_in(trials)) == found
    assert not wrong_in([replace(trial, setup=setup) for trial in turns()])


def test_a_force_against_the_motion_is_first_a_wrong_sign():
    against = replace(SLIDE, wrench_on_object_world=-SLIDE.wrench_on_object_world)
    said = wrong(check_wrenches(OBJECT.shape, [against]))
    assert "off the motion: sign is the other one; else turn" in said["direction"]


def test_trailing_links_turn_the_force_and_nothing_is_wrong():
    chain = drawn_chain(1)
    slide = analytic_links(chain, Slide(0, math.pi / 2, duration=1.2))
    assert "direction" in wrong(check_wrenches(OBJECT.shape, [slide]))
    assert not wrong(check_wrenches(chain.shape, [slide]))
    assert wrong_motion(chain.shape, [slide]) == []


def tcp_beside(trial: Trajectory) -> Trajectory:
    """The turn with its TCP 3 mm and -1 mm off the stated place."""
    angle = trial.object_pose[:, 2] + OBJECT.shape.grasps[turn_of(trial).grasp].angle
    by = np.einsum("nij,j->ni", rotation_2d(angle), np.array([0.003, -0.001]))
    velocity = trial.tcp_velocity.copy()
    velocity[:, :2] += perpendicular(by) * trial.object_velocity[:, 2:]
    return replace(trial, tcp_velocity=velocity)


def test_a_tcp_beside_its_place_is_named_with_its_offset():
    found = wrong_in([tcp_beside(trial) for trial in turns()])
    assert set(found) == {"TCP"} and "(-3.0, +1.0)" in found["TCP"]


def test_stated_errors_of_the_setup_are_allowed_and_the_defaults_are_not():
    """A TCP 3 mm off, and a force 6 deg off the motion, where a setup states as much."""
    stated = SetupErrors(tcp_offset=0.0015, anisotropy=0.05)
    trials = [tcp_beside(trial) for trial in turns()]
    wrench = SLIDE.wrench_on_object_world.copy()
    wrench[:, :2] = wrench[:, :2] @ rotation_2d(np.radians(6.0)).T
    trials.append(replace(SLIDE, wrench_on_object_world=wrench))
    for setup, kinds in ((EXACT_SETUP, 2), (UNSTATED, 2), (stated, 0)):
        assert len(wrong_motion(OBJECT.shape, [replace(t, setup=setup) for t in trials])) == kinds


def test_exchanged_logs_are_off_by_themselves_alone():
    right = turns()
    trials = [replace(right[other], action=right[k].action) for k, other in enumerate((1, 0, 3, 2))]
    assert set(wrong_in(trials)) == {"center"}
    assert set(wrong_in([*trials[:2], *right[2:]])) == {"center"}  # no TCP that is off


def test_one_wrong_grasp_is_named_with_the_one_that_would_fit():
    trials, shape = turns(), OBJECT.shape
    action = turn_of(trials[2])
    other = (action.grasp + 1) % len(shape.grasps)
    turned = shape.grasps[action.grasp].angle - shape.grasps[other].angle
    trials[2] = replace(yawed(trials[2], turned), action=replace(action, grasp=other))
    found = wrong_in(trials)
    assert set(found) == {"center"}
    assert f"grasp {shape.grasps[action.grasp].name} would fit" in found["center"]


def test_a_mirrored_object_is_named():
    flip = np.array([1.0, -1.0])
    grasps = tuple(replace(g, position=g.position * flip, angle=-g.angle) for g in OBJECT.shape.grasps)
    mirrored = replace(OBJECT.shape, particles=OBJECT.shape.particles * flip, grasps=grasps)
    trials = []
    for trial in turns():
        x, y = turn_of(trial).center(OBJECT.shape)
        angle = OBJECT.shape.grasps[turn_of(trial).grasp].angle
        trials.append(replace(yawed(trial, 2 * angle), action=replace(turn_of(trial), pivot=(x, -y))))
    assert "mirrored" in wrong_in(trials, mirrored)


SPREAD = np.array([0.067, 0.083, 0.065, 0.0034, 0.0030, 0.0010])
BIAS = np.array([5.0, -3.0, 8.0, 0.1, 0.2, -0.3])
UP = Rotation.from_euler("xyz", [170, 10, 30], degrees=True).as_matrix()[2]
"""World z in the axes of a sensor that points down, not quite."""


def samples(mass: float, seed: int = 0, *, sign: int = 1, noise: float = 1.0, count: int = 200) -> np.ndarray:
    """Two seconds of a hand that holds a mass."""
    rng = np.random.default_rng(seed)
    held = np.concatenate([mass * GRAVITY * UP, np.zeros(3)])
    return BIAS + sign * held + noise * SPREAD * coloured_noise(count, 6, 0.3, rng)


def weighed(mass: float, seed: int = 0, **how: Any) -> Weighing:
    return weigh(samples(0.0, 2 * seed), samples(mass, 2 * seed + 1, **how), UP)


def test_without_noise_it_reads_the_mass():
    for sign in (1, -1):
        empty, loaded = (samples(m, sign=sign, noise=1e-9) for m in (0.0, 1.23))
        assert weigh(empty, loaded, UP).mass == pytest.approx(sign * 1.23, abs=1e-8)
        assert weigh(empty, loaded, None).mass == pytest.approx(1.23, abs=1e-8)


def test_its_error_is_as_large_as_it_says():
    found = [weighed(0.8, seed) for seed in range(300)]
    z = np.array([(w.mass - 0.8) / w.standard_error for w in found])
    assert abs(z.mean()) < 4 / np.sqrt(300)
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.35)
    assert np.mean([w.standard_error for w in found]) < 0.002


def test_drift_between_the_readings_is_in_its_error():
    empty, loaded = samples(0.0), samples(0.5, 1)
    still, drifting = weigh(empty, loaded, UP), weigh(empty, loaded, UP, drift=0.5)
    assert drifting.mass == still.mass
    assert drifting.standard_error == pytest.approx(np.hypot(still.standard_error, 0.5 / GRAVITY))


@pytest.mark.parametrize(
    ("mass", "how", "verdict", "said"),
    [
        (1.0, {}, "agrees", r"9\.8\d \+- 0\.0\d N where 1 kg weighs 9\.81 N: within 2%"),
        (1.0, {"sign": -1}, "negated", "set sign = -1"),
        (1.1, {}, "disagrees", r"off by \+\d+\.\d %: the sensor may hold a stored tool calibration"),
        (0.5, {}, "disagrees", r"off by -(49|50)\.\d %"),
        (1.0, {"noise": 20.0}, "unsure", r"the scatter hides 2%: measure longer, or take \d+\.\d kg or more"),
    ],
)
def test_a_known_mass_tells_a_sensors_faults(mass: float, how: dict[str, Any], verdict: str, said: str):
    found, text = check_known_mass(weighed(mass, **how), 1.0)
    assert found == verdict
    assert re.search(said, text)


def test_an_honest_sensor_agrees_and_a_dishonest_one_does_not_whatever_the_draw():
    for seed in range(100):
        assert check_known_mass(weighed(1.0, seed), 1.0)[0] == "agrees"
        assert check_known_mass(weighed(1.05, seed), 1.0)[0] == "disagrees"


def test_an_object_hangs_where_its_moment_says():
    center, weight = np.array([0.03, -0.02, -0.05]), np.array([0, 0, 0.6 * GRAVITY])
    held = np.concatenate([weight, np.cross(center, weight)])
    offset, covariance = held_center(held, COVARIANCE)
    assert_allclose(offset, center[:2], atol=1e-12)
    rng = np.random.default_rng(0)
    draws = [held_center(held + rng.multivariate_normal(np.zeros(6), COVARIANCE), COVARIANCE)[0] for _ in range(300)]
    assert_allclose(np.cov(draws, rowvar=False), covariance, rtol=0.3, atol=2e-10)
