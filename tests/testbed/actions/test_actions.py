"""Actions: plain data, tool paths, pushes, and the table of properties of every kind."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from estimators.action_selection.candidates import ActionFamily
from testbed import RIGID, Accelerate, Lift, Rotate, SimulationRunner, Slide, Trial, Weigh, faces, load_object
from testbed.actions.base import Action, TableAction, action_from_dict
from testbed.actions.path import HIGH, LOW, RAMP_TIME, WORKSPACE, PlanarPath, outline, overhang_of
from testbed.actions.push import GAP, Push
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.frames import transform_point
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape
from testbed.simulation.motion import plan_motion
from testbed.simulation.scene import part
from testbed.simulation.settings import GripSettings, SimulationSettings
from testbed.trial import Support, parse_support

SHAPE = load_object("L2").shape
GRASP = st.integers(0, 20)
POSITIVE = st.floats(1e-6, 1e3)
FINITE = st.floats(-1e3, 1e3)
PLACE = st.floats(-10, 10)
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
        pivot=st.none() | st.tuples(PLACE, PLACE),
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


def test_defaults_are_those_of_the_paper():
    assert (math.degrees(Rotate(0).speed), Rotate(0).duration) == (pytest.approx(10), 18)
    assert (Slide(0).speed, Slide(0).duration) == (0.05, 4)


def test_a_turn_is_about_its_grasp_unless_a_pivot_is_given():
    assert Rotate(2).center(SHAPE).tolist() == SHAPE.grasps[2].position.tolist()
    assert Accelerate(1).center(SHAPE).tolist() == SHAPE.grasps[1].position.tolist()
    assert Rotate(2, pivot=(0.1, -0.2)).center(SHAPE).tolist() == [0.1, -0.2]


def test_an_index_of_numpy_is_an_integer():
    assert Rotate(np.argmax([0, 1])).to_dict()["grasp"] == 1  # pyright: ignore[reportArgumentType]
    lift = Lift(np.int32(1), swings=np.int64(2), poses=np.int64(3))  # pyright: ignore[reportArgumentType]
    assert {type(value) for value in (lift.grasp, lift.swings, lift.poses)} == {int}


REFUSED: list[tuple[type[Action], dict[str, object], str]] = [
    *((Rotate, {"grasp": bad}, "Rotate.grasp") for bad in (-1, 0.5, True, "0", "A1", None, np.float64(1), np.True_)),
    *((Accelerate, {"grasp": bad}, "Accelerate.grasp") for bad in (-1, math.nan)),
    *((Lift, {"grasp": bad}, "Lift.grasp") for bad in (-1, None)),
    *((Rotate, {"speed": bad}, "Rotate.speed") for bad in (0.0, math.nan, "1", 10**400, 10**5000)),
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
    (Push, {"speed": 0.3}, "Push.speed"),
    *((Push, {"length": length, "speed": speed}, "Push.length") for length, speed in ((0.0, 0.03), (0.035, 0.2))),
    (Push, {"curvature": math.nan}, "Push.curvature"),
    (Push, {"point": (1.0,)}, "Push.point"),
]


TRIAL = Trial(load_object("L2"), Rotate(0))
SIDE = faces(SHAPE)[0]
MIDDLE = tuple(((SIDE.begin + SIDE.end) / 2).tolist())
OUTWARDS = math.atan2(SIDE.normal[1], SIDE.normal[0])
KINDS = "one of accelerate, lift, push, rotate, slide, weigh"
REFUSED_CALLS: list[tuple[Callable[[], object], str, str]] = [
    (partial(replace, TRIAL, object="L2"), "Trial.object", ""),
    (partial(replace, TRIAL, support="rigid"), "Trial.support", ""),
    *(
        (partial(parse_support, bad), "support", 'allowed: "own_weight", "rigid", or a stiffness')  # pyright: ignore[reportArgumentType]
        for bad in (None, [1], "air", -1, 10**400, "rigid N/m", "-1 N/m")
    ),
    (partial(Lift.stop_and_go, 0, tilt=None), "Lift.tilt", "an angle from 0"),  # pyright: ignore[reportArgumentType]
    (partial(Lift.stop_and_go, 0, poses=1), "Lift.poses", "an integer >= 2"),
    *(
        (partial(Push.into, faces(SHAPE)[2], bad), "Push.into.part", "0 to 1, from one end of the face")  # pyright: ignore[reportArgumentType]
        for bad in (-0.1, 1.5, "middle")
    ),
    (partial(Push(MIDDLE, OUTWARDS).face, SHAPE), "Push.direction", "of the normal into the face"),
    (partial(Push(MIDDLE, OUTWARDS + math.pi / 2).face, SHAPE), "Push.direction", "of the normal into the face"),
    (partial(Push((9.0, 9.0), 0.0).face, SHAPE), "Push.point", "a point of the outline"),
    (partial(Weigh().tool_path, SHAPE, np.zeros(3), 0.01), "action", "an action that moves the object"),
    *(
        (partial(action_from_dict, data), field, allowed)  # pyright: ignore[reportArgumentType]
        for data, field, allowed in (
            ({"kind": "roll"}, "action.kind", KINDS),
            ({}, "action.kind", KINDS),
            ({"kind": ["rotate"]}, "action.kind", KINDS),
            ({"kind": "weigh", "grasp": 0}, "action", "fields"),
            ({"kind": "rotate", "grasp": 0, "sped": 1}, "action", "speed"),
            ({"kind": "accelerate", "hold": 0.5}, "action", "grasp as well"),
            ({"kind": "slide"}, "action", "grasp as well"),
            (None, "action", "a table"),
            ("rotate", "action", "a table"),
        )
    ),
]


@pytest.mark.parametrize(("kind", "fields", "field"), REFUSED)
def test_an_action_out_of_range_is_refused(kind, fields: dict[str, Any], field: str):
    least: dict[str, Any] = {"point": (0.0, 0.0), "direction": 0.0} if kind is Push else {"grasp": 0}
    given = least | fields
    for make in (lambda: kind(**given), lambda: action_from_dict({"kind": kind.kind} | given)):
        with pytest.raises(InvalidValueError) as refused:
            make()
        assert refused.value.field == field


@pytest.mark.parametrize(("call", "field", "allowed"), REFUSED_CALLS)
def test_a_call_with_a_wrong_value_is_refused(call, field: str, allowed: str):
    with pytest.raises(InvalidValueError) as refused:
        call()
    assert refused.value.field == field and allowed in str(refused.value)


@pytest.mark.parametrize(
    ("stiffness", "name"),
    [
        *((0.0, "own_weight"), (math.inf, "rigid"), (0.1, "0.1 N/m"), (300.0, "300 N/m"), (1e6, "1e+06 N/m")),
        *((1234567.0, "1234567.0 N/m"), (1234568.0, "1234568.0 N/m")),
    ],
)
def test_a_support_is_read_back_from_its_name(stiffness: float, name: str):
    assert Support(stiffness).name == name and parse_support(name) == Support(stiffness)


def test_an_action_is_a_sentence():
    turn = Rotate(0, speed=-0.2, pivot=(0.05, 0.02), back=True)
    name = SHAPE.grasps[0].name
    assert turn.describe(SHAPE) == f"turn at {name} about (50, 20) mm, right and back, 11 deg/s"
    assert Accelerate(0).reversed().describe(SHAPE) == f"accelerate at {name}, right"
    assert Slide(0).describe(SHAPE) == f"slide at {name}, towards 0 deg"
    for direction in (-1e-6, 100.0 * math.tau):
        assert Slide(0, direction).describe(SHAPE) == Slide(0).describe(SHAPE)
        pushed = Push((0.0, 0.05), direction).describe(SHAPE)
        assert pushed == Push((-1e-6, 0.05), 0.0).describe(SHAPE) and "-0" not in pushed
    assert Lift(0).describe(SHAPE) == f"lift at {name}, 6 swings, held 2 s"
    assert (Weigh().describe(SHAPE), Slide(99).describe(SHAPE)) == ("weigh", "slide at grasp 99, towards 0 deg")


PATHS = [
    Rotate(2, pivot=(0.01, -0.02), back=True, duration=3.0),
    Rotate(0, speed=-0.3, duration=2.0),
    Slide(1, direction=0.7, duration=2.0),
    Accelerate(1),
    Accelerate(0, (-1.0, 1.0), 0.6, -0.7),
]


@pytest.mark.parametrize("action", PATHS, ids=str)
def test_distance_is_the_integral_of_the_rate_and_that_is_as_stated(action):
    profile = action.profile(0.01)
    rate = np.concatenate([[0.0], profile.rate])
    assert_allclose(profile.distance, np.cumsum((rate[1:] + rate[:-1]) / 2) * 0.01, atol=1e-12)
    assert rate[-1] == pytest.approx(0.0)
    for index, stretch in enumerate(action.steady):
        ahead = np.sign(action.steady[0].speed) * profile.rate[profile.segment == index]
        assert_allclose(np.diff(ahead), stretch.acceleration * 0.01, atol=1e-12)
        assert ahead[0] == pytest.approx(stretch.speed, abs=abs(stretch.acceleration) * 0.01 + 1e-12)
    if action.accelerated:
        assert action.steady[0].speed == action.start_speed
        assert tuple(stretch.acceleration for stretch in action.steady) == action.accelerations
    else:
        asked = [(action.speed, 0.0), (-action.speed, 0.0)][: len(action.steady)]
        assert [(stretch.speed, stretch.acceleration) for stretch in action.steady] == asked
        back = len(asked) == 2
        assert profile.length == pytest.approx(abs(action.speed) * (action.duration + RAMP_TIME))
        assert profile.distance[-1] == pytest.approx(0.0 if back else profile.length, abs=1e-12)


@pytest.mark.parametrize("action", [*PATHS, Push.into(faces(SHAPE)[2], 0.4, 0.2, 5.0), Lift(1)], ids=str)
def test_between_ticks_a_tool_path_is_that_of_finer_ticks_and_its_rate_is_the_derivative(action):
    path, fine = (action.tool_path(SHAPE, np.array([0.4, 0.1, 0.3]), step) for step in (0.01, 0.001))
    times = np.arange(1, len(fine.segment), 101) * 0.001
    poses, rates = (np.array(each) for each in zip(*map(fine.at, times), strict=True))
    ahead, behind = (np.array([fine.at(t + d)[0] for t in times]) for d in (5e-4, -5e-4))
    assert_allclose((ahead - behind) / 1e-3, rates, atol=2e-3)
    if not action.in_air:  # where every stretch lasts whole ticks
        assert_allclose([path.at(t)[0] for t in times], poses, atol=5e-5)
        assert_allclose([path.at(t)[1] for t in times], rates, atol=3e-3)
    for time, there in ((-1.0, path.start), (1e3, path.at(path.duration)[0])):
        pose, rate = path.at(time)
        assert_allclose(pose, there)
        assert not rate.any()
    assert path.duration == pytest.approx(action.tool_path(SHAPE, np.zeros(3), 0.01).duration)


@pytest.mark.parametrize("action", PATHS, ids=str)
def test_a_path_keeps_its_pivot_and_its_grasp_and_leads_on_from_its_start(action):
    path = action.centered_path(SHAPE, 0.6)
    part = np.linspace(-0.5, 0.5, 11)
    objects, tools = path.object_pose(part), path.tool_pose(part)
    grasp = SHAPE.grasps[action.grasp]
    assert_allclose(tools[5, :2], WORKSPACE, atol=1e-12)
    assert_allclose(tools[5, 2], 0.0, atol=1e-12)
    assert_allclose(transform_point(objects, grasp.position), tools[:, :2], atol=1e-12)
    assert_allclose(tools[:, 2] - objects[:, 2], grasp.angle)
    pivot = transform_point(objects, path.pivot)
    if not action.turns:
        assert_allclose(np.linalg.norm(pivot[-1] - pivot[0]), 0.6)
        heading = np.arctan2(*(pivot[-1] - pivot[0])[::-1]) - objects[0, 2]
        assert heading == pytest.approx(0.7)
    else:
        assert_allclose(pivot, np.tile(pivot[0], (11, 1)), atol=1e-12)
        assert objects[-1, 2] - objects[0, 2] == pytest.approx(math.copysign(0.6, action.steady[0].speed))
    along = (part + 0.5)[:, None]
    assert_allclose(pivot, pivot[0] + along * (pivot[-1] - pivot[0]), atol=1e-12)
    assert_allclose(objects[:, 2], objects[0, 2] + along[:, 0] * (objects[-1, 2] - objects[0, 2]), atol=1e-12)
    again = action.path_from(SHAPE, 0.6, objects[0])
    assert_allclose(again.tool_pose(part), tools, atol=1e-12)


def test_faces_close_the_outline():
    every = faces(SHAPE)
    assert sum(face.length * face.normal for face in every) == pytest.approx(0, abs=1e-12)
    # the area, by the divergence theorem, is that of all cells
    area = sum(face.length * face.normal @ (face.begin + face.end) / 4 for face in every)
    assert area == pytest.approx(len(SHAPE.particles) * SHAPE.cell**2)
    nearest = [np.linalg.norm(SHAPE.particles - (face.begin + face.end) / 2, axis=1).argmin() for face in every]
    assert [SHAPE.mass_group[particle] for particle in nearest] == [face.group for face in every]


def test_the_path_of_a_push_meets_its_point_and_bends():
    for bend in (0.0, 3.0, -3.0):
        push = Push(MIDDLE, OUTWARDS + math.pi, bend, length=0.1)
        way = np.linspace(0.0, GAP + 0.1, 200)
        path = push.path(SHAPE, way)
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(GAP + 0.1, rel=1e-5)
        contact = push.path(SHAPE, np.array([GAP]))[0] - push.radius * SIDE.normal
        assert contact == pytest.approx(MIDDLE)
        ends = [np.arctan2(*np.diff(path[part], axis=0)[0][::-1]) for part in (slice(0, 2), slice(-2, None))]
        assert math.remainder(ends[1] - ends[0] - bend * 0.1, 2 * math.pi) == pytest.approx(0, abs=2e-3)
        assert push.seconds > (GAP + 0.1) / push.speed
        assert action_from_dict(json.loads(json.dumps(push.to_dict()))) == push
        assert push.grasp is None and "push at" in push.describe(SHAPE)


WELD = SimulationSettings(grip=GripSettings(mode="weld"))


def stretched(times: float) -> ObjectShape:
    """L2, its blocks so much farther apart."""
    grasps = tuple(replace(grasp, position=times * grasp.position) for grasp in SHAPE.grasps)
    return replace(SHAPE, particles=times * SHAPE.particles, grasps=grasps)


def path_of(action: TableAction, shape: ObjectShape) -> PlanarPath:
    return action.centered_path(shape, action.profile(0.01).length)


def beyond(action: TableAction, shape: ObjectShape, parts: int = 1001) -> np.ndarray:
    """Overhang of the corners of all cells past each edge, by sampling the path, (4,)."""
    half = shape.cell / 2 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    corners = np.unique((shape.particles[:, None] + half).reshape(-1, 2).round(9), axis=0)
    poses = path_of(action, shape).object_pose(np.linspace(-0.5, 0.5, parts))
    places = transform_point(poses[:, None], corners).reshape(-1, 2)
    return np.concatenate([places.max(axis=0) - HIGH, LOW - places.min(axis=0)])


def test_the_edges_are_those_of_the_table_in_the_scene():
    spec = part("table")
    for name in ("top", "slab"):
        geom = spec.geom(name)
        assert_allclose(geom.pos[:2] - geom.size[:2], LOW)
        assert_allclose(geom.pos[:2] + geom.size[:2], HIGH)


@pytest.mark.parametrize("seed", range(4))
def test_the_overhang_is_exact(seed):
    rng, shape = np.random.default_rng(seed), load_object("F2").shape
    pivot = tuple(rng.uniform(-0.4, 0.4, 2))
    turn = Rotate(int(rng.integers(len(shape.grasps))), float(rng.choice([-1, 1])) * 0.2, rng.uniform(1, 30), pivot)
    for action in (turn, Slide(0, rng.uniform(-4, 4), duration=rng.uniform(2, 8)), Accelerate(1)):
        found = overhang_of(shape, path_of(action, shape))
        assert_allclose(found, beyond(action, shape), atol=1e-5)


@pytest.mark.slow
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


def test_the_path_begins_where_the_object_is_placed():
    action = Rotate(2, duration=3.0, pivot=(0.05, -0.1), back=True)
    path = action.path_from(SHAPE, action.profile(0.01).length, plan_motion(action, SHAPE, WELD).object_pose)
    assert_allclose(overhang_of(SHAPE, path), overhang_of(SHAPE, path_of(action, SHAPE)), atol=1e-9)
    assert len(outline(SHAPE)) <= 8
