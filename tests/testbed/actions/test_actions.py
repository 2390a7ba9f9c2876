"""Actions: plain data and back, and values out of range refused."""

from __future__ import annotations

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


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Rotate(-1), r"Rotate\.grasp: got -1; allowed: an integer >= 0"),
        (lambda: action_from_dict({"kind": "rotate", "grasp": 0.5}), r"Rotate\.grasp: got 0\.5; allowed: an integer"),
        (lambda: Rotate(0, speed=0.0), r"Rotate\.speed: got 0\.0; allowed: a finite number other than 0"),
        (lambda: Rotate(0, speed=math.nan), r"Rotate\.speed: got nan; allowed: a finite number other than 0"),
        (lambda: Rotate(0, duration=0.0), r"Rotate\.duration: got 0\.0; allowed: a finite number > 0"),
        (lambda: Rotate(0, duration=math.inf), r"Rotate\.duration: got inf; allowed: a finite number > 0"),
        (lambda: Rotate(0, pivot=(0.0, math.nan)), r"Rotate\.pivot: got '1 NaN or infinite entries'; .*finite numbers"),
        (
            lambda: action_from_dict({"kind": "rotate", "grasp": 0, "pivot": [0, 0, 0]}),
            r"Rotate\.pivot: got 'shape \(3,\)'; allowed: shape \(2,\)",
        ),
        (lambda: Slide(0, speed=0.0), r"Slide\.speed: got 0\.0; allowed: a finite number > 0"),
        (lambda: Slide(0, speed=-0.05), r"Slide\.speed: got -0\.05; allowed: a finite number > 0"),
        (lambda: Slide(0, duration=-1.0), r"Slide\.duration: got -1\.0; allowed: a finite number > 0"),
        (lambda: Slide(0, direction=math.nan), r"Slide\.direction: got nan; allowed: a finite angle"),
        (lambda: Accelerate(0, hold=0.0), r"Accelerate\.hold: got 0\.0; allowed: a finite number > 0"),
        (lambda: Accelerate(0, start_speed=0.0), r"Accelerate\.start_speed: got 0\.0; .*other than 0"),
        (lambda: Accelerate(0, ()), r"Accelerate\.accelerations: got \(\); allowed: finite numbers of both signs"),
        (lambda: Accelerate(0, (1.0, 0.5)), r"Accelerate\.accelerations: .*both signs"),
        (lambda: Accelerate(0, (1.0, -math.inf)), r"Accelerate\.accelerations: .*finite numbers"),
        (lambda: Accelerate(0, (-1.0, 1.0)), r"Accelerate\.accelerations: .*never stops or reverses the turn"),
        (lambda: Accelerate(0, start_speed=-0.15), r"Accelerate\.accelerations: .*never stops or reverses"),
    ],
)
def test_an_action_out_of_range_is_refused(make, said: str):
    with pytest.raises(InvalidValueError, match=said):
        make()


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"kind": "push"}, r"action\.kind: got 'push'; allowed: one of accelerate, lift, rotate, slide, weigh"),
        ({}, r"action\.kind: got None"),
        ({"kind": "weigh", "grasp": 0}, r"action: got \['grasp'\]"),
        ({"kind": "rotate", "grasp": 0, "sped": 1}, r"action: got \['sped'\]; allowed: fields .*speed"),
        ({"kind": "rotate", "grasp": 0, "speed": 0}, r"Rotate\.speed: got 0; allowed"),
        ({"kind": "rotate"}, r"action: got \{'kind': 'rotate'\}; allowed: fields grasp as well"),
        ({"kind": "accelerate", "hold": 0.5}, r"action: .*'hold': 0\.5.*; allowed: fields grasp as well"),
        ({"kind": "slide"}, r"action: .*allowed: fields grasp as well"),
        ({"kind": ["rotate"]}, r"action\.kind: got \['rotate'\]; allowed: one of accelerate, lift"),
        ({"kind": "rotate", "grasp": "0"}, r"Rotate\.grasp: got '0'; allowed: an integer"),
        ({"kind": "rotate", "grasp": None}, r"Rotate\.grasp: got None; allowed: an integer"),
        ({"kind": "rotate", "grasp": 0, "speed": "1"}, r"Rotate\.speed: got '1'; allowed: a finite number"),
        ({"kind": "rotate", "grasp": 0, "speed": 10**400}, r"Rotate\.speed: got 10+\.\.\.; allowed: a finite number"),
        ({"kind": "rotate", "grasp": 0, "duration": None}, r"Rotate\.duration: got None; allowed: a finite number"),
        ({"kind": "rotate", "grasp": 0, "back": "no"}, r"Rotate\.back: got 'no'; allowed: true or false"),
        ({"kind": "rotate", "grasp": 0, "pivot": 5}, r"Rotate\.pivot: got 'shape \(\)'; allowed: shape \(2,\)"),
        ({"kind": "rotate", "grasp": 0, "pivot": ["1", "2"]}, r"Rotate\.pivot: got \['1', '2'\]; allowed: numbers"),
        ({"kind": "slide", "grasp": 0, "direction": "x"}, r"Slide\.direction: got 'x'; allowed: a finite angle"),
        ({"kind": "slide", "grasp": 0, "speed": True}, r"Slide\.speed: got True; allowed: a finite number > 0"),
        (
            {"kind": "accelerate", "grasp": 0, "accelerations": 3},
            r"accelerations: got 'shape \(\)'; allowed: shape \(n,\)",
        ),
        (
            {"kind": "accelerate", "grasp": 0, "accelerations": ["1", "-1"]},
            r"accelerations: got \['1', '-1'\]; .*numbers",
        ),
        (None, r"action: got None; allowed: a table"),
        ("rotate", r"action: got 'rotate'; allowed: a table"),
    ],
)
def test_plain_data_that_is_no_action_is_refused(data: object, said: str):
    with pytest.raises(InvalidValueError, match=said):
        action_from_dict(data)  # type: ignore[arg-type]


NO_INDEX = st.one_of(
    st.integers(max_value=-1),
    st.booleans(),
    st.floats(),
    st.sampled_from(["", "0", "A1"]),
    st.none(),
    st.integers(0, 20).map(np.int64),
)


@settings(deadline=None, derandomize=True)
@given(st.sampled_from([Rotate, Accelerate, Slide]), NO_INDEX)
def test_a_grasp_that_is_no_plain_index_is_refused(kind: type[Rotate | Accelerate | Slide], grasp: object):
    with pytest.raises(InvalidValueError) as refused:
        kind(grasp)  # type: ignore[arg-type]
    said = f"{kind.__name__}.grasp: got {grasp!r}; allowed: an integer >= 0"
    assert str(refused.value) == said


def test_an_array_index_of_a_grasp_is_refused_and_a_plain_one_survives_json():
    with pytest.raises(InvalidValueError, match=r"Rotate\.grasp: got .*1.*; allowed: an integer >= 0"):
        Rotate(np.arange(3)[1])
    assert json.loads(json.dumps(Rotate(1).to_dict()))["grasp"] == 1
