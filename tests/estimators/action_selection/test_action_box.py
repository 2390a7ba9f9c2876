"""A family of actions as a box: every point is an action, every candidate a point."""

import numpy as np
import pytest

from estimators.action_selection.box import SIZE, ActionBox
from estimators.action_selection.candidates import ActionFamily
from testbed.actions.accelerate import Accelerate
from testbed.actions.lift import Lift
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object

SHAPE = load_object("F2").shape
GRASPS = (0, 2, 3)


def box(**family: object) -> ActionBox:
    return ActionBox(SHAPE, GRASPS, ActionFamily(**family))  # pyright: ignore[reportArgumentType]


def test_every_candidate_of_a_family_is_a_point_within_its_limits():
    whole = box()
    drawn = whole.family.sample(SHAPE, GRASPS, 120, 0)
    assert {type(action) for action in drawn} == set(whole.kinds)
    for action in drawn:
        again = whole.action(whole.point(action).astype(np.float32))
        assert whole.refusal(action) == ""
        assert (type(again), again.grasp) == (type(action), action.grasp)
        assert again.seconds == pytest.approx(action.seconds)
        if isinstance(action, Rotate) and isinstance(again, Rotate):
            assert again.pivot == action.pivot
            assert again.speed == pytest.approx(action.speed, abs=5.1e-5)
        elif isinstance(action, Slide) and isinstance(again, Slide):
            assert again.direction == pytest.approx(action.direction, abs=5.1e-5)
        else:
            assert again == action
        assert whole.action(whole.point(again).astype(np.float32)) == again  # rounded once, for good


def test_every_point_is_an_action_of_the_family():
    whole, rng = box(), np.random.default_rng(0)
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * SIZE)).reshape(SIZE, -1).T
    for point in [*corners, *rng.uniform(-1, 1, (200, SIZE)), np.full(SIZE, 7.0)]:
        action = whole.action(point)
        assert action.grasp in GRASPS
        if isinstance(action, Rotate):
            low, high = whole.family.duration
            assert low <= action.duration <= high
            assert 6 - 0.01 <= abs(np.degrees(action.speed)) <= 12 + 0.01
            arm = np.linalg.norm(action.center(SHAPE) - SHAPE.grasps[action.grasp].position)
            assert arm <= whole.family.arm + 1e-4


def test_a_family_without_slides_has_none():
    assert box(slides=False).kinds == (Rotate, Accelerate)
    assert box(slides=False, accelerated=False).kinds == (Rotate,)


@pytest.mark.parametrize(
    ("action", "why"),
    [
        (Rotate(0, pivot=tuple(SHAPE.particles[0]), back=True), "particle"),  # pyright: ignore[reportArgumentType]
        (Rotate(0, speed=0.2, pivot=(0.19, 0.003), back=True), "reach"),
        (Slide(0, duration=40.0), "table"),
    ],
)
def test_what_the_family_would_not_draw_is_refused(action, why):
    assert why in box().refusal(action)


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: box().action(np.zeros(3)), "action"),
        (lambda: box().action(np.full(SIZE, np.nan)), "action"),
        (lambda: box().point(Lift(0)), "action"),
        (lambda: box().point(Rotate(1)), "action"),
        (lambda: box(slides=False).point(Slide(0)), "action"),
        (lambda: box(pushes=True), "ActionBox.family"),
        (lambda: ActionBox(SHAPE, ()), "ActionBox.grasps"),
    ],
)
def test_what_is_no_action_of_the_box_is_named(call, field):
    with pytest.raises(InvalidValueError) as error:
        call()
    assert error.value.field == field
