"""Identifiability: ranks, open directions and standard errors of actions, `heft identify`, and trailing links."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, cast

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators import HiddenStates, OnlinePolicy, PlannedPolicy
from estimators.action_selection.candidates import MOST_DRAGS, ActionFamily
from estimators.action_selection.design import Guess
from estimators.action_selection.plan import Goal
from estimators.action_selection.random import random_drags, random_pushes
from estimators.action_selection.rank import between_particles
from estimators.identifiability.information import (
    Assumptions,
    expected,
    observed,
    predicted_information,
    prior_information,
)
from estimators.identifiability.report import identifiability
from estimators.identifiability.trailing import trailing_motions
from estimators.particles.links import HINGE_PRIOR
from estimators.posterior import table_errors
from estimators.posterior.scale import Weighing
from estimators.testing.analytic_world import drawn_object, own_weight_loads, turns
from estimators.wrench.model import ModelErrors
from scenarios.cli.main import main
from scenarios.cli.plan import actions_of
from testbed import Accelerate, Action, Lift, Push, Rotate, Slide, Weigh, load_object, world
from testbed.actions.path import RAMP_TIME
from testbed.errors import InvalidValueError
from testbed.objects.faces import faces
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape
from testbed.sensing.presets import Sensing, preset
from testbed.worlds.setup_errors import EXACT_SETUP
from tests.fakes.analytic_links import analytic_links, drawn_chain
from tests.fakes.analytic_push import analytic_pushes
from tests.helpers.answers import ask, claimed, found, trials_of
from viz.figures.maps import error_figure

NAMES = ("I1", "I2", "L1", "L2", "F1", "F2")
L2, CHAIN, IDEAL = load_object("L2"), drawn_chain(1), preset("ideal")
GRASPS = range(len(CHAIN.shape.grasps))
DRAGS = (
    Slide(1, -2.6, duration=3.0),
    Rotate(2, np.radians(-10), 4.0, (0.04, 0.02)),
    Rotate(1, np.radians(10), 4.0, (-0.03, -0.02)),
)
slow = pytest.mark.slow


def all_turns(obj: ObjectModel) -> list[Action]:
    shape = obj.shape
    beside = [between_particles(shape, grasp.position) for grasp in shape.grasps]
    back_and_forth = [Rotate(g, pivot=pivot, back=True) for g, pivot in enumerate(beside)]
    return [Weigh(), *map(Accelerate, range(len(shape.grasps))), *back_and_forth]


def of_rows(rows: list[list[float]]):
    """Identifiability of rows of unit error over the masses of L2 and its friction."""
    return identifiability(L2.shape, L2.truth, 1e3 * np.array(rows, dtype=float))


@pytest.mark.parametrize("name", NAMES)
def test_on_own_weight_every_mass_is_observed(name):
    obj = load_object(name)
    report = expected(obj.shape, obj.truth, all_turns(obj), preset("ft300s"))
    assert report.rank == report.unknowns == obj.shape.n_m + 1
    assert np.isfinite(report.standard_error).all()
    assert report.unobservable == ()
    assert report.sentence == "all 7 masses and frictions are observed"


COMBINATIONS = ("the combination A1 - B1 - A3 + B3", "the combination A1 - 3 A2 + 3 A3 - A4")


@pytest.mark.parametrize(("name", "rank", "words"), [("I2", 4, None), ("L2", 5, None), ("F2", 5, COMBINATIONS)])
def test_under_one_rigid_body_only_weight_center_and_inertia_are_observed(name, rank, words):
    obj = load_object(name)
    report = expected(obj.shape, obj.truth, all_turns(obj), preset("ideal"), Assumptions("rigid"))
    assert report.rank == rank
    assert np.isinf(report.standard_error).all()
    of_mass = report.open_directions[:, :-1]
    middles = np.array([obj.shape.particles[obj.shape.mass_group == g].mean(axis=0) for g in range(obj.shape.n_m)])
    assert_allclose(of_mass.sum(axis=1), 0, atol=1e-6)
    assert_allclose(of_mass @ middles, 0, atol=1e-6)
    assert_allclose(of_mass @ (middles**2).sum(axis=1), 0, atol=1e-6)
    assert_allclose(report.open_directions[:, -1], 0, atol=1e-6)
    assert words is None or report.unobservable == words


def test_masses_that_only_change_places_are_named_as_a_sum():
    sums = of_rows([[1, 0, 0, 0, 0, 0, 0], [0, 1, 1, 0, 0, 0, 0], [0, 0, 0, 1, 1, 1, 0], [0, 0, 0, 0, 0, 0, 1]])
    assert sums.unobservable == ("B1 and C1 only as a sum", "A2, A3 and A4 only as a sum")
    assert np.isinf(sums.standard_error).tolist() == [False, True, True, True, True, True]
    assert (sums.rank, sums.unknowns) == (4, 7)


@pytest.mark.parametrize(
    ("rows", "open_"),
    [(np.eye(7)[[0, 1, 2, 3, 4, 6]], 5), (np.diag([1e-6, *[0.1] * 6]), 0)],
    ids=["untouched", "an error as large as the object"],
)
def test_an_unobserved_mass_is_named_alone(rows, open_):
    found = of_rows(rows.tolist())
    assert found.unobservable == (f"{found.group_names[open_]} not at all",)
    assert np.flatnonzero(np.isinf(found.standard_error)).tolist() == [open_]


def test_slides_show_friction_and_center_alone():
    slides = [Slide(g, direction) for g in range(5) for direction in (0.0, 1.0, 2.0)]
    report = expected(L2.shape, L2.truth, slides, preset("ft300s"))
    assert report.rank == 4 and np.isinf(report.standard_error).any()


def test_a_better_sensor_and_more_trials_show_more():
    ideal, low, high, usual, twice = (
        expected(L2.shape, L2.truth, count * all_turns(L2), preset(name)).standard_error
        for name, count in (("ideal", 1), ("low", 1), ("high", 1), ("ft300s", 1), ("ft300s", 2))
    )
    assert (ideal < low).all() and (low < high).all() and (twice < usual).all()


def test_the_weighing_is_as_good_as_assumed():
    rough = Assumptions(errors=replace(ModelErrors(), weight_error=0.05))
    count, given = L2.shape.particles_per_group, (L2.shape, L2.truth, all_turns(L2), preset("ft300s"))
    usual, told = (expected(*given, assumptions) for assumptions in (None, rough))
    of_whole = [float(np.sqrt(np.ones(len(count)) @ each.covariance @ np.ones(len(count)))) for each in (usual, told)]
    assert of_whole[0] < 0.002 and of_whole[1] > 0.01


def test_predicted_errors_are_those_of_records():
    obj = drawn_object(0)
    seen = observed(obj.shape, obj.truth, trials_of(obj))
    quiet = replace(preset("ideal"), scale=Assumptions().model_errors.weight_error)
    planned = expected(obj.shape, obj.truth, [trial.action for trial in trials_of(obj)], quiet)
    # a record trims its stretches by whole samples, and its slopes are measured
    assert_allclose(planned.standard_error, seen.standard_error, rtol=0.05)


def test_rows_are_derivatives_of_the_drag_which_is_bilinear():
    obj = drawn_object(1)
    slow = [replace(a, speed=1e-4) for a in all_turns(obj) if isinstance(a, Rotate)]  # hardly any centripetal force
    trials = predicted_information(obj.shape, obj.truth, slow, preset("ft300s"), Assumptions())
    steady = trials.rows[..., : trials.known].reshape(-1, trials.known)
    # what scales all masses up scales the friction down
    assert_allclose(steady[:, :-1] @ obj.truth.mass, steady[:, -1] * obj.truth.friction[0], rtol=1e-6, atol=1e-6)
    weighing = Weighing.of(obj.shape, 0.01, EXACT_SETUP)
    weighing = prior_information(obj.shape, weighing, Assumptions())[: obj.shape.n_m, : obj.shape.n_m]
    assert obj.truth.mass @ weighing @ obj.truth.mass == pytest.approx((obj.total_mass / 0.01) ** 2)


def test_every_answer_carries_the_report_and_too_few_turns_say_what_they_leave_open():
    answer, few = (ask(L2, given) for given in (trials_of(L2), turns(L2, [0])))
    report = answer.identifiability
    assert report is not None and report.rank == report.unknowns
    assert_allclose(report.standard_error, claimed(answer) * L2.shape.particles_per_group)
    assert few.status == "underdetermined" and few.identifiability is not None
    assert few.identifiability.rank < few.identifiability.unknowns and few.identifiability.unobservable
    assert np.isinf(few.identifiability.standard_error).any()


@pytest.mark.slow
def test_answers_scatter_as_the_bound_says():
    """In a world of exact Coulomb friction with white noise, Algorithm 1 reaches the Cramer-Rao bound, and says so."""
    exact = HiddenStates(
        force_error=0.0, torque_error=0.0, pivot_error=0.0, height_error=0.0, lift_error=0.0, weight_error=1e-6
    )
    off, errors, noisy = [], [], []
    for seed in range(25):
        noisy = []
        for i, turn in enumerate(turns(L2)):
            rng = np.random.default_rng([seed, i])
            noise = 0.2 * np.array([1, 1, 1, 0.1, 0.1, 0.1]) * rng.standard_normal((len(turn.time_s), 6))
            noisy.append(replace(turn, wrench_on_object_world=turn.wrench_on_object_world + noise))
        answer = ask(L2, noisy, exact)
        errors.append(claimed(answer) * L2.shape.particles_per_group)
        off.append((found(answer).mass - L2.truth.mass) * L2.shape.particles_per_group)
    last = observed(L2.shape, L2.truth, noisy, Assumptions(errors=exact.errors))
    assert_allclose(np.sqrt(np.mean(np.square(off), axis=0)), last.standard_error, rtol=0.35)
    assert_allclose(np.mean(errors, axis=0), last.standard_error, rtol=0.1)


SLAB = drawn_object(3, ["11", "11", "11"])
"""2 x 3 blocks, which no hand can grip."""


def brisk_pushes(shape: ObjectShape, count: int, seed: int, *, length: float = 0.06) -> list[Push]:
    return [replace(push, speed=0.05, length=length) for push in random_pushes(shape, count, seed)]


@pytest.mark.slow
def test_predicted_information_of_pushes_is_that_of_records(monkeypatch):
    """At a model error of 1 %: a smaller one does not cover the change of force that a brief record counts as noise."""
    monkeypatch.setattr(table_errors, "PUSH_ERROR", 0.01)
    pushes = brisk_pushes(SLAB.shape, 6, 0, length=0.12)
    before = expected(SLAB.shape, SLAB.truth, pushes, Sensing("exact"))
    after = observed(SLAB.shape, SLAB.truth, analytic_pushes(SLAB, pushes))
    assert before.rank == after.rank == before.unknowns == 7
    assert_allclose(before.standard_error, after.standard_error, rtol=0.2)
    guessed = MassDistribution(np.full(6, SLAB.truth.mass.mean()), SLAB.truth.friction)
    elsewhere = expected(SLAB.shape, guessed, pushes, Sensing("exact"))  # where even masses would have gone
    assert_allclose(elsewhere.standard_error.mean(), before.standard_error.mean(), rtol=0.5)


@pytest.mark.slow
def test_a_camera_that_sees_less_shows_less():
    pushes = brisk_pushes(SLAB.shape, 5, 1)
    errors = [
        expected(SLAB.shape, SLAB.truth, pushes, preset(name), Assumptions(setup=world(place).stated)).standard_error
        for name, place in (("ft300s:camera=exact", "ideal"), ("ft300s", "ideal"), ("ft300s", "lab"))
    ]
    assert (errors[0] < errors[1]).all() and (errors[1] < errors[2]).all()


@pytest.mark.slow
def test_pushes_and_turns_add_up():
    where = Assumptions(setup=world("lab").stated)
    actions = [Rotate(0, pivot=(0.02, 0.05)), *brisk_pushes(L2.shape, 3, 0), Accelerate(1), Slide(2)]
    together = predicted_information(L2.shape, L2.truth, actions, preset("ft300s"), where)
    for index, action in enumerate(actions):
        alone = predicted_information(L2.shape, L2.truth, [action], preset("ft300s"), where)
        assert_allclose(alone.information(), together.information([index]), rtol=1e-6, atol=1e-9)


def test_the_plan_is_the_policys_and_of_the_grasps_pushes_and_lifts_asked_for():
    actions = actions_of(L2, slides=3, duration=9.0)
    kinds = [type(action) for action in actions]
    assert [kinds.count(kind) for kind in (Weigh, Accelerate, Rotate, Slide)] == [1, 6, 6, 3]
    assert all(a.back and a.duration == 9.0 for a in actions if isinstance(a, Rotate))
    directions = [a.direction for a in actions if isinstance(a, Slide)]
    assert len(set(directions)) == 3
    assert {a.grasp for a in actions_of(L2, grasps=(L2.shape.grasps[1].name,)) if a.moves} == {1}
    assert actions_of(L2, pivots=0, pushes=5)[1:] == random_pushes(L2.shape, 5, 0)
    lifts = [a for a in actions_of(load_object("I2"), support="rigid", lifts=3) if isinstance(a, Lift)]
    assert [lift.grasp for lift in lifts] == [2, 3, 1], "the inner grasps"


@pytest.mark.parametrize("part", [0.0, 1.0])
def test_no_trials_a_weighing_and_a_push_that_slips_off_at_once_show_the_weight_alone(part: float):
    slips = Push.into(faces(L2.shape)[0], part, 0.0, 0.0)
    planned = (expected(L2.shape, L2.truth, actions, preset("ft300s").stated) for actions in ([slips], [], [Weigh()]))
    for report in (observed(L2.shape, L2.truth, []), *planned):
        assert report.rank == 1 and np.isinf(report.standard_error).any()


LINKS = "scenarios/library/objects/fold_2.toml"
REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: expected(L2.shape, L2.truth, [Rotate(9)], preset("ideal")), "one of the shape's 5 grasps"),
    (
        lambda: expected(L2.shape, L2.truth, [Rotate(0)], cast(Any, "ft300s")),
        'a Sensing, such as heft.preset\\("ft300s"\\)',
    ),
    (lambda: Assumptions("floating"), "own_weight, rigid"),
    *(
        (partial(actions_of, L2, **{option: -1}), rf"^--{option}: got -1; allowed: an integer >= 0")
        for option in ("pivots", "accelerated", "slides", "pushes")
    ),
    (lambda: actions_of(L2, grasps=("nose",)), "grasps of L2: "),
    (lambda: actions_of(load_object("I2"), "rigid", lifts=-1), "lifts"),
    (lambda: actions_of(load_object("I2"), "own_weight", lifts=1), "lifts"),
    (
        lambda: actions_of(load_object(LINKS), pushes=2),
        "pushes: got 2; allowed: 0: an object with hinges is not pushed",
    ),
    (lambda: ActionFamily(pushes=True).sample(CHAIN.shape, GRASPS, 4000, 0), "pushes: got True; allowed: none"),
]


@pytest.mark.parametrize(("call", "said"), REFUSED)
def test_wrong_arguments_are_refused(call: Callable[[], object], said: str):
    with pytest.raises(InvalidValueError, match=said):
        call()


ALL_SEEN = "all 7 masses and frictions are observed"


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ("L2", ("L2, own_weight, ft300s: 1 weigh, 6 accelerate, 6 rotate", ALL_SEEN)),
        ("F2 --assumed-support rigid --lifts 1", ("6 of 7 masses and frictions are observed",)),
        ("I1 --pivots 0", ("1 of 7 masses and frictions are observed",)),
        ("L2 --world lab --pivots 2 --accelerated 0", (ALL_SEEN, "hardly known: B1 0.100 +- 0.1")),
        pytest.param(
            f"{LINKS} --pivots 2 --slides 2",
            ("1 weigh, 2 rotate, 2 slide", "friction of hinges: standard error"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_identify_prints_the_report(words, parts, capsys):
    main(["identify", *words.split()])
    said = " ".join(capsys.readouterr().out.split())
    assert [part for part in parts if part not in said] == []


def test_identify_names_open_masses_alone(capsys):
    main(["identify", "F2", "--assumed-support", "rigid"])
    said = " ".join(capsys.readouterr().out.split())
    assert "the combination A1 - B1 - A3 + B3" in said
    assert said.count("not observed") == 12
    main(["identify", "L2", "--world", "lab", "--pivots", "12", "--accelerated", "0"])
    said = capsys.readouterr().out
    assert ALL_SEEN in said and "hardly known" not in said


def test_a_group_without_mass_is_observed_but_has_no_relative_error(tmp_path, capsys):
    blocks = '[blocks]\nlayout = ["11"]\nmass_kg = [0.3, 0.0]\nfriction = 0.35\n'
    (tmp_path / "hollow.toml").write_text('name = "hollow"\n' + blocks, encoding="utf-8")
    main(["identify", str(tmp_path / "hollow.toml")])
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "0.000" in line]
    *_, error, part, _ = (cell.strip() for cell in line.split("│"))
    assert float(error) > 0 and part == "-"


def test_the_heatmap_shows_the_standard_errors_of_the_table(tmp_path, capsys, monkeypatch):
    drawn = []
    monkeypatch.setattr("viz.figures.maps.save_figure", lambda figure, path: drawn.append(figure) or [f"{path}.png"])
    main(["identify", "L2", "--out", str(tmp_path / "errors")])
    said = capsys.readouterr().out
    assert "errors.png" in said
    assert "standard error, g" in said and drawn[0].axes[1].get_xlabel() == "standard error, g"
    rows = [line.split("│") for line in said.splitlines() if line.startswith("│")]
    printed = [float(row[3]) for row in rows if row[3].strip()]
    assert [float(text.get_text()) for text in drawn[0].axes[0].texts] == pytest.approx(printed, abs=0.006)


@pytest.mark.slow
def test_the_heatmap_is_written_whole(tmp_path, capsys):
    main(["identify", "L2", "--out", str(tmp_path / "errors")])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["errors.pdf", "errors.png"]
    assert "errors.png" in capsys.readouterr().out


def test_unobserved_groups_are_hatched_and_labelled():
    figure = error_figure(L2, np.array([0.01, np.inf, 0.02, 0.03, 0.01, 0.01]), "some trials")
    axis, bar = figure.axes
    assert [text.get_text() for text in axis.texts] == ["10.0", "not observed", "20.0", "30.0", "10.0", "10.0"]
    assert "standard error" in bar.get_xlabel()
    hatched = [patches for patches in axis.collections if patches.get_hatch()]
    assert len(hatched) == 1 and len(hatched[0].get_paths()) == 9
    assert len(error_figure(L2, np.full(6, np.inf), "nothing").axes) == 1


def friction_of(obj: ObjectModel) -> np.ndarray:
    return obj.truth.friction[obj.shape.friction_group] * own_weight_loads(obj)


def turned_off(action: Rotate | Slide, step: float) -> float:
    """Greatest difference of a link's yaw from that of exact mechanics, once both are past their start, rad."""
    (motion,) = trailing_motions(
        CHAIN.shape, CHAIN.particle_mass, friction_of(CHAIN), [action], step, list(CHAIN.hinge_friction)
    )
    record = analytic_links(CHAIN, action)  # which moves at full speed at once
    assert record.camera is not None
    time = np.arange(1, len(motion.turned) + 1) * step - RAMP_TIME / 2
    kept = (time > 1.0) & (time < record.time_s[-1])
    assert kept.sum() > 1 / step
    yaw = record.camera.poses[:, :, 2] - record.camera.poses[0, :, 2]
    exact = np.stack([np.interp(time[kept], record.time_s, each) for each in yaw.T], 1)
    return float(np.abs(motion.turned[kept, :, 0] - exact).max())


@slow
@pytest.mark.parametrize("action", DRAGS, ids=["slide", "turn right", "turn left"])
def test_links_trail_as_exact_mechanics_have_it(action: Rotate | Slide):
    # a slide that starts at once throws the links by its jerk
    assert turned_off(action, 0.04) < (0.03 if isinstance(action, Slide) else 0.003)


@slow
def test_predicted_information_of_links_is_that_of_records():
    trials = [analytic_links(CHAIN, action) for action in DRAGS]
    assumptions = Assumptions(hinge_friction=CHAIN.hinge_friction)
    before = expected(CHAIN.shape, CHAIN.truth, DRAGS, IDEAL, assumptions)
    after = observed(CHAIN.shape, CHAIN.truth, trials)
    assert before.rank == after.rank == before.unknowns
    assert_allclose(before.standard_error, after.standard_error, rtol=0.25)
    assert_allclose(before.hinge_error, after.hinge_error, rtol=0.25)


def test_a_hinge_that_nothing_moves_keeps_its_prior_error():
    rule = load_object("folding_rule")
    assert_allclose(expected(rule.shape, rule.truth, [], IDEAL).hinge_error, HINGE_PRIOR)


@pytest.mark.slow
def test_more_drags_leave_less_open():
    drags = random_drags(CHAIN.shape, GRASPS, 6, 0)
    reports = [expected(CHAIN.shape, CHAIN.truth, drags[:count], IDEAL) for count in (1, 3, 6)]
    assert [r.rank for r in reports] == sorted(r.rank for r in reports)
    errors = np.array([report.hinge_error for report in reports])
    assert (np.diff(errors, axis=0) <= 1e-12).all() and (errors > 0).all()


def test_candidates_of_links_are_slides_and_turns_one_way():
    found = ActionFamily(lifts=True).sample(CHAIN.shape, GRASPS, 4000, 0)
    assert 0.9 * MOST_DRAGS < len(found) <= MOST_DRAGS
    assert all(isinstance(each, Slide) or (isinstance(each, Rotate) and not each.back) for each in found)


@slow
def test_a_plan_is_more_informative_than_random_drags():
    policy = PlannedPolicy(Guess(CHAIN.total_mass, preset("ft300s")), goal=Goal(most=4), candidates=40)
    planned, drawn = policy.plan(CHAIN.shape).actions, random_drags(CHAIN.shape, GRASPS, 4, 0)
    assert all(isinstance(action, (Rotate, Slide)) for action in planned)
    assumptions = Assumptions(hinge_friction=CHAIN.hinge_friction)
    by_plan, by_chance = (
        expected(CHAIN.shape, CHAIN.truth, each, preset("ft300s"), assumptions) for each in (planned, drawn)
    )
    assert by_plan.standard_error.mean() < by_chance.standard_error.mean()


@slow
def test_the_online_policy_uses_estimated_hinges():
    guess = Guess(CHAIN.total_mass, IDEAL)
    policy = OnlinePolicy(guess, goal=Goal(most=6), candidates=40)
    decision = policy.decide(CHAIN.shape, [analytic_links(CHAIN, action) for action in DRAGS[:2]])
    assert decision.estimate is not None and decision.estimate.status == "ok"
    assert isinstance(decision.action, (Slide, Rotate))
