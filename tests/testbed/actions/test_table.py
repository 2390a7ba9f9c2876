"""The table's edge: known to planning and to the bench, and exact."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.action_selection.candidates import ActionFamily
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import TableAction
from testbed.actions.lift import Lift
from testbed.actions.path import HIGH, LOW, PlanarPath, outline, overhang_of
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.errors import InfeasibleTrialError
from testbed.frames import transform_point
from testbed.objects.files import load_object
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape
from testbed.simulation.motion import plan_motion
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.scene import part
from testbed.simulation.settings import GripSettings, SimulationSettings
from testbed.trial import RIGID, Trial

WELD = SimulationSettings(grip=GripSettings(mode="weld"))


def stretched(times: float) -> ObjectShape:
    """L2, its blocks so much farther apart."""
    shape = load_object("L2").shape
    grasps = tuple(replace(grasp, position=times * grasp.position) for grasp in shape.grasps)
    return replace(shape, particles=times * shape.particles, grasps=grasps)


def path_of(action: TableAction, shape: ObjectShape) -> PlanarPath:
    return action.centered_path(shape, action.profile(0.01).length)


def beyond(action: TableAction, shape: ObjectShape, parts: int = 2001) -> np.ndarray:
    """Overhang of any corner of any cell past each edge, by looking everywhere, (4,)."""
    half = shape.cell / 2 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    corners = (shape.particles[:, None] + half).reshape(-1, 2)
    poses = path_of(action, shape).object_pose(np.linspace(-0.5, 0.5, parts))
    places = transform_point(poses[:, None], corners).reshape(-1, 2)
    return np.concatenate([places.max(axis=0) - HIGH, LOW - places.min(axis=0)])


def test_it_is_as_large_as_the_scene_has_it():
    spec = part("table")
    for name in ("top", "slab"):
        geom = spec.geom(name)
        np.testing.assert_allclose(geom.pos[:2] - geom.size[:2], LOW)
        np.testing.assert_allclose(geom.pos[:2] + geom.size[:2], HIGH)


@pytest.mark.parametrize("seed", range(4))
def test_how_far_an_object_gets_is_exact(seed):
    rng, shape = np.random.default_rng(seed), load_object("F2").shape
    pivot = tuple(rng.uniform(-0.4, 0.4, 2))
    turn = Rotate(int(rng.integers(len(shape.grasps))), float(rng.choice([-1, 1])) * 0.2, rng.uniform(1, 30), pivot)
    for action in (turn, Slide(0, rng.uniform(-4, 4), duration=rng.uniform(2, 8)), Accelerate(1)):
        found = overhang_of(shape, path_of(action, shape))
        np.testing.assert_allclose(found, beyond(action, shape), atol=1e-5)


def test_no_candidate_carries_the_object_over_the_edge():
    near, far = stretched(1.0), stretched(3.0)  # 0.6 m from end to end
    for shape in (near, far):
        found = ActionFamily().sample(shape, range(len(shape.grasps)), 100, 0)
        assert {Rotate, Slide, Accelerate} == {type(action) for action in found}
        moved = [action for action in found if isinstance(action, TableAction)]
        assert max(beyond(action, shape, 51).max() for action in moved) <= 1e-9
    turns = [action for action in moved if isinstance(action, Rotate)]
    assert len(turns) > 50 and len({turn.grasp for turn in turns}) > 1
    longer = [replace(turn, duration=18.0) for turn in turns]  # which is not for want of turns that would
    assert max(beyond(turn, far, 51).max() for turn in longer) > 0.05


def test_the_bench_refuses_what_would_pass_the_edge():
    def check(action: Rotate | Slide | Lift, times: float) -> None:
        shape = stretched(times)
        mass = MassDistribution(np.full(shape.n_m, 0.2 / len(shape.particles)), np.full(shape.n_mu, 0.2))
        SimulationRunner(WELD).check(Trial(ObjectModel("long", shape, mass), action, RIGID))

    check(Rotate(0, duration=4.0), 2.0)
    whole = r"within x -0\.30 to 1\.00 m and y -0\.60 to 0\.60 m"
    with pytest.raises(InfeasibleTrialError, match=rf"table: .* (left|right|far) edge by \d+ mm; .*{whole}"):
        check(Rotate(0, duration=18.0), 5.0)
    for action, times in ((Slide(0, np.pi / 2), 4.2), (Lift(0), 6.0)):  # a lift: where it lies, before it is lifted
        with pytest.raises(InfeasibleTrialError, match=r"table: .* edge by"):
            check(action, times)


def test_where_an_object_is_laid_down_its_way_begins():
    shape, action = load_object("L2").shape, Rotate(2, duration=3.0, pivot=(0.05, -0.1), back=True)
    path = action.path_from(shape, action.profile(0.01).length, plan_motion(action, shape, WELD).object_pose)
    np.testing.assert_allclose(overhang_of(shape, path), overhang_of(shape, path_of(action, shape)), atol=1e-9)
    assert len(outline(shape)) <= 8
