"""Actions: plain data and back, and values out of range refused."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testbed.actions.accelerate import Accelerate
from testbed.actions.base import Action, action_from_dict
from testbed.actions.lift import Lift
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.actions.weigh import Weigh
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object

GRASP = st.integers(0, 20)
POSITIVE = st.floats(1e-6, 1e3)
FINITE = st.floats(-1e3, 1e3)
SIGN = st.sampled_from([-1.0, 1.0])


@st.composite
def accelerate(draw: st.DrawFn) -> Accelerate:
    """Ups and downs in pairs that never stop the turn."""
    sign, size = draw(SIGN), draw(st.floats(0.1, 5.0))
    pair = (sign * size, -sign * size / 2)
    return Accelerate(draw(GRASP), pair * draw(st.integers(1, 4)), draw(POSITIVE), sign * draw(st.floats(0.01, 2.0)))


ACTIONS = st.one_of(
    st.just(Weigh()),
    st.builds(
        Rotate,
        GRASP,
        speed=st.builds(math.copysign, POSITIVE, SIGN),
        duration=POSITIVE,
        pivot=st.none() | st.tuples(FINITE, FINITE),
        back=st.booleans(),
    ),
    st.builds(Slide, GRASP, direction=FINITE, speed=POSITIVE, duration=POSITIVE),
    accelerate(),
    st.builds(Lift, GRASP, tilt=st.floats(0, 0.5), acceleration=POSITIVE, swings=st.integers(0, 9), hold=POSITIVE),
)


@settings(deadline=None, derandomize=True)
@given(ACTIONS)
def test_an_action_comes_back_from_plain_data(action: Action):
    assert action_from_dict(json.loads(json.dumps(action.to_dict()))) == action


def test_the_turn_of_the_paper_is_the_default():
    assert (math.degrees(Rotate(0).speed), Rotate(0).duration) == (pytest.approx(10), 18)
    assert (Slide(0).speed, Slide(0).duration) == (0.05, 4)


def test_a_turn_is_about_its_grasp_unless_a_pivot_is_given():
    shape = load_object("L2").shape
    assert Rotate(2).center(shape).tolist() == shape.grasps[2].position.tolist()
    assert Accelerate(1).center(shape).tolist() == shape.grasps[1].position.tolist()
    assert Rotate(2, pivot=(0.1, -0.2)).center(shape).tolist() == [0.1, -0.2]


REFUSED: list[tuple[type[Action], dict[str, object], str]] = [
    *((Rotate, {"grasp": bad}, "Rotate.grasp") for bad in (-1, 0.5, True, "0", "A1", None, np.int64(1))),
    *((Accelerate, {"grasp": bad}, "Accelerate.grasp") for bad in (-1, math.nan)),
    *((Lift, {"grasp": bad}, "Lift.grasp") for bad in (-1, None)),
    *((Rotate, {"speed": bad}, "Rotate.speed") for bad in (0.0, math.nan, "1", 10**400)),
    *((Rotate, {"duration": bad}, "Rotate.duration") for bad in (0.0, math.inf, None)),
    *((Rotate, {"pivot": bad}, "Rotate.pivot") for bad in ((0.0, math.nan), [0, 0, 0], 5, ["1", "2"])),
    (Rotate, {"back": "no"}, "Rotate.back"),
    *((Slide, {"speed": bad}, "Slide.speed") for bad in (0.0, -0.05, True)),
    (Slide, {"duration": -1.0}, "Slide.duration"),
    *((Slide, {"direction": bad}, "Slide.direction") for bad in (math.nan, "x")),
    (Accelerate, {"hold": 0.0}, "Accelerate.hold"),
    (Accelerate, {"start_speed": 0.0}, "Accelerate.start_speed"),
    (Accelerate, {"start_speed": -0.15}, "Accelerate.accelerations"),
    *(
        (Accelerate, {"accelerations": bad}, "Accelerate.accelerations")
        for bad in ((), (1.0, 0.5), (1.0, -math.inf), (-1.0, 1.0), 3, ["1", "-1"])
    ),
    *((Lift, {"tilt": bad}, "Lift.tilt") for bad in (-0.1, 1.0)),
    (Lift, {"swings": 1.5}, "Lift.swings"),
    (Lift, {"hold": 0.0}, "Lift.hold"),
    (Lift, {"height": -1.0}, "Lift.height"),
]


@pytest.mark.parametrize(("kind", "fields", "field"), REFUSED)
def test_an_action_out_of_range_is_refused(kind, fields: dict[str, object], field: str):
    for make in (
        lambda: kind(**{"grasp": 0} | fields),
        lambda: action_from_dict({"kind": kind.kind, "grasp": 0} | fields),
    ):
        with pytest.raises(InvalidValueError) as refused:
            make()
        assert refused.value.field == field


@pytest.mark.parametrize(
    ("data", "field", "allowed"),
    [
        ({"kind": "roll"}, "action.kind", "one of accelerate, lift, push, rotate, slide, weigh"),
        ({}, "action.kind", "rotate"),
        ({"kind": ["rotate"]}, "action.kind", "rotate"),
        ({"kind": "weigh", "grasp": 0}, "action", "fields"),
        ({"kind": "rotate", "grasp": 0, "sped": 1}, "action", "speed"),
        ({"kind": "accelerate", "hold": 0.5}, "action", "grasp as well"),
        ({"kind": "slide"}, "action", "grasp as well"),
        (None, "action", "a table"),
        ("rotate", "action", "a table"),
    ],
)
def test_plain_data_that_is_no_action_is_refused(data, field: str, allowed: str):
    with pytest.raises(InvalidValueError, match=allowed) as refused:
        action_from_dict(data)
    assert refused.value.field == field


def test_an_action_is_a_sentence():
    shape = load_object("L2").shape
    turn = Rotate(0, speed=-0.2, pivot=(0.05, 0.02), back=True)
    name = shape.grasps[0].name
    assert turn.describe(shape) == f"turn at {name} about (50, 20) mm, right and back, 11 deg/s"
    assert Accelerate(0).reversed().describe(shape) == f"accelerate at {name}, right"
    assert Slide(0).describe(shape) == f"slide at {name}, towards 0 deg"
    assert Lift(0).describe(shape) == f"lift at {name}, 6 swings, held 2 s"
    assert (Weigh().describe(shape), Slide(99).describe(shape)) == ("weigh", "slide at grasp 99, towards 0 deg")


def test_what_does_not_move_takes_no_time():
    assert Weigh().seconds == 0.0
    with pytest.raises(InvalidValueError, match="an action that moves the object"):
        Weigh().tool_path(load_object("L2").shape, np.zeros(3), 0.01)
