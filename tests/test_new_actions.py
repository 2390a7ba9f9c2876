"""Actions defined here alone go through simulation, robot, files, logs, planning, estimates and figures."""

from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.distance import cdist

from estimators.action_selection.design import Design, Guess, prior_belief
from estimators.action_selection.greedy import greedy_plan
from estimators.action_selection.plan import FeasibilityLog, Goal
from estimators.posterior.estimator import Bayes
from scenarios.views.values import wrench_fit
from testbed import ObjectShape, Push, Rotate, SimulationRunner, Trial, faces, load_object, preset
from testbed.actions import base
from testbed.actions.base import Action, ActionWords, TableAction, action_from_dict
from testbed.actions.path import Steady
from testbed.sensing.push_windows import window_samples
from testbed.simulation.rendering import body_poses
from testbed.trajectory import Phase, Trajectory, load_trajectory, save_trajectory
from tests.fakes.lab_bench import through_mcap
from tests.fakes.robot import robot_for
from tests.helpers.chunks import read_chunks, verify
from viz.figures.trials import trials_figure
from viz.recordings.page import SIM_TIME, Page, save
from viz.recordings.trial import log_trial, trial_blueprint
from viz.trials import TrialsView
from viz.values import TrialView

L2 = load_object("L2")
SENSING = preset("ft300s")


@dataclass(frozen=True)
class Arc(TableAction):
    """Arc of a radius about a point beside the object, held by the pads."""

    turns: ClassVar[bool] = True
    radius: float = 0.08
    speed: float = 0.3
    duration: float = 2.0

    @property
    def steady(self) -> tuple[Steady, ...]:
        return (Steady(self.speed, 0.0, self.duration),)

    def center(self, shape: ObjectShape) -> np.ndarray:
        return super().center(shape) + np.array([0.0, self.radius])

    def words(self, shape: ObjectShape) -> ActionWords:
        return ActionWords("arc", manner=f"{1e3 * self.radius:.0f} mm")


@dataclass(frozen=True)
class Bend(Push):
    """Push along a straight line that becomes an arc, by the fingertip."""

    straight: float = 0.03

    def path(self, shape: ObjectShape, distance: np.ndarray) -> np.ndarray:
        along = np.asarray(distance, dtype=float) - self.gap - self.straight
        turned, heading = np.maximum(along, 0.0) * self.curvature, self.direction
        corner = np.array(self.point) + self.radius * self.face(shape).normal
        corner = corner + self.straight * np.array([np.cos(heading), np.sin(heading)])
        chord = along * np.sinc(turned / 2 / np.pi)
        return corner + chord[:, None] * np.column_stack([np.cos(heading + turned / 2), np.sin(heading + turned / 2)])

    def headings(self, distance: np.ndarray) -> np.ndarray:
        return self.direction + self.curvature * np.maximum(np.asarray(distance) - self.gap - self.straight, 0.0)

    def words(self, shape: ObjectShape) -> ActionWords:
        return ActionWords("bend", manner=f"{self.speed * 100:g} cm/s")


ACTIONS: dict[str, tuple[Action, ...]] = {
    "arc": tuple(Arc(grasp, radius, speed) for grasp in range(3) for radius, speed in ((0.08, -0.3), (0.03, 0.3))),
    "bend": tuple(replace(Bend.into(face, 0.4, 0.0, 6.0), speed=0.05, length=0.08) for face in faces(L2.shape)[:2]),
}
KIND = pytest.mark.parametrize("kind", list(ACTIONS))


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Registered by their names in files, as `class Arc(TableAction, kind="arc")` would be for good."""
    for kind, cls in (("arc", Arc), ("bend", Bend)):
        monkeypatch.setitem(base.KINDS, kind, cls)
        monkeypatch.setattr(cls, "kind", kind)


@cache
def simulated(kind: str, index: int = 0) -> Trajectory:
    return SimulationRunner(secret="x").run(Trial(L2, ACTIONS[kind][index], sensing="ft300s"))


@KIND
def test_it_is_simulated_along_its_path_and_stored(kind, tmp_path):
    record, action = simulated(kind), ACTIONS[kind][0]
    assert record.ok, record.reason
    moving = np.flatnonzero(record.mask(Phase.RAMP, Phase.STEADY))
    path = action.tool_path(L2.shape, action.centered_pose(L2.shape, 0.01), 0.01)
    wanted = np.array([path.at(0.01 * (1 + k))[0][:2] for k in range(len(moving))])
    place = record.tcp_position[moving, :2]
    assert cdist(place, wanted).min(axis=1).max() < 2e-3  # along the path the arm lags under load
    assert_allclose(place[[0, -1]], wanted[[0, -1]], atol=2e-3)
    assert action_from_dict(action.to_dict()) == action
    save_trajectory(record, tmp_path / "trial.npz")
    assert load_trajectory(tmp_path / "trial.npz").action == action


@pytest.mark.parametrize("kind", ["arc", pytest.param("bend", marks=pytest.mark.slow)])
def test_it_is_exported_and_imported(kind, tmp_path):
    pytest.importorskip("rosbags", reason="needs the extra robot")
    given = simulated(kind)
    back = through_mcap(given, "L2", tmp_path)
    assert back.action == given.action
    for one, other in zip(window_samples(back), window_samples(given), strict=True):
        assert_allclose(back.wrench_on_object_world[one], given.wrench_on_object_world[other], atol=1e-6)


@KIND
def test_it_is_planned(kind):
    guess = Guess(L2.total_mass, SENSING)
    design = Design.of(L2.shape, [Rotate(0, duration=0.5), *ACTIONS[kind]], guess)
    before = prior_belief(L2.shape, guess)
    plan = greedy_plan(design, before, Goal(most=3), FeasibilityLog())
    assert {action.kind for action in plan.actions} >= {kind}
    assert plan.after.expected_nad < 0.8 * before.expected_nad
    assert plan.seconds > sum(action.seconds for action in plan.actions)


@pytest.mark.slow
def test_masses_follow_from_it():
    trials = [simulated("arc", index) for index in range(len(ACTIONS["arc"]))]
    answer = Bayes().estimate(L2.shape, L2.total_mass, [*trials, simulated("bend"), simulated("bend", 1)], 0)
    assert answer.status == "ok", answer.message
    off, error = answer.group_mass(L2.shape) - L2.group_mass, answer.group_error(L2.shape)
    assert error is not None
    assert np.abs(off).sum() < 0.06 * L2.total_mass
    assert (np.abs(off) < 3.5 * error).all()


@KIND
def test_it_is_drawn(kind, tmp_path):
    record, action = simulated(kind), ACTIONS[kind][0]
    view = TrialsView.of(L2.shape, [record], "")
    (arrow,) = view.arrows.values()
    assert_allclose(arrow.grasp, action.hand(L2.shape)[0])
    assert (arrow.pivot is None) == (kind == "bend")
    assert trials_figure(view).get_axes()
    poses = body_poses(record, (0.02, 0.04), meshes=False, every=100)
    shown = TrialView("", L2.shape, record, poses, record.time_s[::100], wrench_fit("", record, None), truth=L2.truth)
    page = Page("x", "x", lambda stream: log_trial(stream, "t", shown), trial_blueprint("t", shown), SIM_TIME)
    save(page, tmp_path / "x.rrd")
    verify(tmp_path / "x.rrd")
    assert ("t/scene/fingertip" in read_chunks(tmp_path / "x.rrd")) == (kind == "bend")


@pytest.mark.slow
@KIND
def test_the_fake_robot_makes_it(kind):
    trial = Trial(L2, ACTIONS[kind][0])
    _, runner = robot_for(trial, seed=1)
    with runner:
        record = runner.run(trial)
    assert record.ok, record.reason
    ours, usual = (one.mask(Phase.STEADY) for one in (record, simulated(kind)))
    assert_allclose(record.tcp_position[ours][[0, -1], :2], simulated(kind).tcp_position[usual][[0, -1], :2], atol=3e-3)
