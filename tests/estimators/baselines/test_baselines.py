"""The paper's baselines in a world of exact Coulomb friction: what each can find, and how it says what it cannot."""

from __future__ import annotations

import math
from dataclasses import replace
from statistics import median

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.base import Estimate
from estimators.baselines.base import DENSEST, ITERATIONS, Baseline
from estimators.baselines.diff_lcp import DiffLcp
from estimators.baselines.explicit_state import ExplicitState
from estimators.baselines.random_search import RandomSearch
from estimators.baselines.weighted_sampling import WeightedSampling
from estimators.descent import OPTIMIZERS
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.testing.analytic_world import accelerated, drawn_object, turns
from testbed.errors import InvalidValueError
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.trajectory import Trajectory

SEARCHES = (RandomSearch, WeightedSampling)
METHODS = (*SEARCHES, ExplicitState, DiffLcp)
QUICK = {RandomSearch: 200, WeightedSampling: 200, ExplicitState: 40, DiffLcp: 10}
"""Budgets for what does not ask how good an answer is."""


def blocks(layout: list[str], mass: list[float], friction: float = 0.4) -> ObjectModel:
    """A few blocks of 2 x 2 particles."""
    cells = parse_layout(layout)
    groups = [0] * len(cells)
    return block_object(
        "few", cells, size=0.05, height=0.03, mass=mass, friction=[friction], friction_group=groups, grid=2
    )


TWO = blocks(["11"], [0.3, 0.1])
THREE = blocks(["10", "11"], [0.3, 0.1, 0.2])


def data(obj: ObjectModel) -> list[Trajectory]:
    return turns(obj) + accelerated(obj)


def ask(
    obj: ObjectModel, method: Baseline, trajectories: list[Trajectory] | None = None, seed: int = 0, **settings: object
) -> Estimate:
    # the analytic world knows the centre of a turn exactly
    exact = replace(method, **{"pivot_error": 0.0} | settings)
    given = data(obj) if trajectories is None else trajectories
    return exact.estimate(obj.shape, obj.total_mass, given, seed)


def quick(method: type[Baseline], **settings: object) -> Baseline:
    return method(**{"iterations": QUICK[method]} | settings)  # pyright: ignore[reportArgumentType]


def nad(obj: ObjectModel, answer: Estimate) -> float:
    assert answer.distribution is not None, answer.message
    return normalized_absolute_difference(obj.shape, answer.distribution, obj.truth)


def typical_nad(obj: ObjectModel, method: Baseline, seeds: int = 5) -> float:
    trajectories = data(obj)
    return median(nad(obj, ask(obj, method, trajectories, seed)) for seed in range(seeds))


# What each finds


@pytest.mark.parametrize("name", ["I1", "L1"])
def test_explicit_state_with_m_finds_uniform_objects(name):
    obj = load_object(name)
    answer = ask(obj, ExplicitState(use_weight=True, weighting="covariance"))
    assert answer.status == "ok"
    assert nad(obj, answer) < 1e-3
    assert answer.distribution is not None
    assert_allclose(answer.distribution.friction, obj.truth.friction, rtol=1e-4)


@pytest.mark.parametrize("seed", [0, 2])
def test_explicit_state_with_m_finds_drawn_objects(seed):
    obj = drawn_object(seed)
    assert nad(obj, ask(obj, ExplicitState(use_weight=True, weighting="covariance"))) < 5e-3


@pytest.mark.slow
@pytest.mark.parametrize("draw", ["I2", "L2", "F2", 0, 1, 2])
def test_explicit_state_with_m_finds_every_object_given_time(draw):
    obj = drawn_object(draw) if isinstance(draw, int) else load_object(draw)
    answer = ask(obj, ExplicitState(iterations=3000, use_weight=True, weighting="covariance"))
    assert nad(obj, answer) < 1e-5
    assert answer.diagnostics["misfit"] < 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_explicit_state_without_m_finds_the_valley_and_crawls_along_it(seed):
    answer = ask(TWO, ExplicitState(), seed=seed)
    assert answer.status == "ok"
    assert answer.distribution is not None
    drag = answer.distribution.friction[0] * answer.distribution.mass
    assert_allclose(drag, TWO.truth.friction[0] * TWO.truth.mass, rtol=0.03)
    assert nad(TWO, answer) > 0.1


@pytest.mark.parametrize("method", [RandomSearch(use_weight=True), WeightedSampling(use_weight=True)])
@pytest.mark.parametrize("obj", [TWO, THREE], ids=["two", "three"])
def test_a_search_is_nearer_the_truth_the_more_it_draws(obj, method):
    few, more, most = (typical_nad(obj, replace(method, iterations=n)) for n in (100, 1000, 10_000))
    assert few > more > most
    assert most < (0.1 if isinstance(method, RandomSearch) else 2e-3)


def test_a_longer_random_search_has_a_lower_loss():
    # it draws the same and goes on
    losses = [ask(THREE, RandomSearch(iterations=n)).diagnostics["loss"] for n in (100, 1000, 10_000)]
    assert losses[0] > losses[1] > losses[2]


def test_explicit_state_is_nearer_the_truth_the_longer_it_descends():
    method = ExplicitState(use_weight=True)
    few, more, most = (typical_nad(THREE, replace(method, iterations=n), seeds=3) for n in (30, 150, 500))
    assert few > more > most
    assert most < 0.01


def test_diff_lcp_is_nearer_the_truth_the_longer_it_descends():
    method = DiffLcp(use_weight=True, directions=16, substeps=1, samples=2)
    few, most = (typical_nad(TWO, replace(method, iterations=n), seeds=3) for n in (10, 80))
    assert few > most
    assert most < 0.02


def test_diff_lcp_comes_to_the_truth_as_its_polygon_becomes_a_circle():
    errors = []
    for directions in (4, 16, 64):
        method = DiffLcp(iterations=100, use_weight=True, learning_rate=0.1, directions=directions, samples=2)
        answer = ask(TWO, method, seed=2)
        errors.append(nad(TWO, answer))
        assert answer.distribution is not None
        # along the motion a polygon's friction is its radius times sin(pi / n) / (pi / n) in the mean
        part = math.sin(math.pi / directions) / (math.pi / directions)
        assert answer.distribution.friction * part == pytest.approx(TWO.truth.friction, rel=0.04)
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.005


def test_diff_lcp_does_not_come_away_from_an_object_that_sticks():
    # friction drawn above what the hand overcomes: predicted at rest, and standing still has no gradient
    answer = ask(TWO, DiffLcp(iterations=60, samples=2), turns(TWO), seed=0)
    assert answer.diagnostics["misfit"] > 1000
    assert nad(TWO, answer) > 0.3
    found = ask(TWO, DiffLcp(iterations=60, use_weight=True, learning_rate=0.1, samples=4), turns(TWO), seed=2)
    assert nad(TWO, found) < 0.1


# What they are given


@pytest.mark.parametrize(
    ("method", "close"),
    [
        (RandomSearch(iterations=10_000), 0.2),
        (WeightedSampling(iterations=3000), 0.05),
        (ExplicitState(iterations=600), 0.01),
        # a polygon of 8 corners: friction is up to 8 % weaker on its sides
        (DiffLcp(iterations=60, learning_rate=0.1, samples=4), 0.12),
    ],
)
def test_without_m_and_acceleration_only_mass_times_friction_is_found(method, close):
    answer = ask(TWO, method, turns(TWO), seed=2)
    assert answer.status == "underdetermined"
    assert "only mass times friction" in answer.message
    assert answer.distribution is not None
    drag = answer.distribution.friction[0] * answer.distribution.mass
    assert_allclose(drag, TWO.truth.friction[0] * TWO.truth.mass, rtol=close)


@pytest.mark.parametrize("method", METHODS)
def test_with_m_constant_speed_is_enough(method):
    assert ask(TWO, quick(method, use_weight=True), turns(TWO)).status == "ok"


@pytest.mark.parametrize("method", METHODS)
def test_m_is_kept_exactly_where_it_is_given_and_not_looked_at_where_it_is_not(method):
    told = ask(THREE, quick(method, use_weight=True))
    assert told.distribution is not None
    assert_allclose(told.distribution.mass @ THREE.shape.particles_per_group, THREE.total_mass, rtol=1e-12)
    for trace in told.traces:
        assert_allclose(trace.mass @ THREE.shape.particles_per_group, THREE.total_mass, rtol=1e-12)
    blind, heavy = (quick(method).estimate(THREE.shape, m, data(THREE), 0).distribution for m in (None, 5.0))
    assert blind is not None
    assert heavy is not None
    assert np.array_equal(blind.mass, heavy.mass)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("weight", [None, 0.0, -1.0, float("nan"), float("inf")])
def test_m_is_missed_where_it_is_to_be_used(method, weight):
    with pytest.raises(InvalidValueError, match=r"weight: .*as weighed"):
        quick(method, use_weight=True).estimate(TWO.shape, weight, turns(TWO), 0)


@pytest.mark.parametrize("method", METHODS)
def test_the_seed_decides(method):
    first, again, other = (ask(THREE, quick(method), seed=seed).distribution for seed in (3, 3, 4))
    assert first is not None
    assert again is not None
    assert other is not None
    assert np.array_equal(first.mass, again.mass)
    assert np.array_equal(first.friction, again.friction)
    assert not np.allclose(first.mass, other.mass)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("use_weight", [False, True])
def test_masses_double_exactly_with_the_wrenches(method, use_weight):
    # light, so that no draw comes near the density of steel
    light = blocks(["10", "11"], [0.003, 0.001, 0.002])
    twice = [replace(t, wrench_on_object_world=2 * t.wrench_on_object_world) for t in data(light)]
    kind = quick(method, use_weight=use_weight)
    once = kind.estimate(light.shape, light.total_mass, data(light), 0).distribution
    double = kind.estimate(light.shape, 2 * light.total_mass, twice, 0).distribution
    assert once is not None
    assert double is not None
    # to rounding, which many steps carry on, the more so where it decides which side of a polygon's corner one ends
    rounding = 1e-4 if method is DiffLcp else 1e-6
    assert_allclose(double.mass, 2 * once.mass, rtol=rounding)
    assert_allclose(double.friction, once.friction, rtol=rounding)


@pytest.mark.parametrize("method", SEARCHES)
@pytest.mark.parametrize("seed", range(3))
def test_no_search_draws_below_nothing_or_above_steel(method, seed):
    heavy = blocks(["10", "11"], [0.5, 0.58, 0.55], friction=0.9)
    steel = DENSEST * heavy.shape.cell**2 * heavy.shape.height
    answer = ask(heavy, quick(method), seed=seed)
    (trace,) = answer.traces
    assert (trace.mass >= 0).all()
    assert trace.mass.max() <= steel
    assert answer.distribution is not None
    assert (answer.distribution.friction > 0).all()
    told = ask(heavy, quick(method, use_weight=True), seed=seed)
    assert (told.traces[0].mass >= 0).all()


# What they say


@pytest.mark.parametrize("method", METHODS)
def test_too_little_is_said_to_be_too_little(method):
    obj = drawn_object(0)
    for given, status, why in (
        ([], "no_data", "no trajectory"),
        (accelerated(obj), "no_data", "constant speed"),
        (turns(obj)[:1], "underdetermined", "turn about more points"),
        ([replace(t, status="slipped", reason="it slipped") for t in data(obj)], "no_data", "status ok"),
    ):
        answer = ask(obj, quick(method), given)
        assert answer.status == status
        assert answer.distribution is None
        assert why in answer.message
        assert answer.seconds > 0


@pytest.mark.parametrize("method", METHODS)
def test_trials_that_did_not_end_well_are_left_out(method):
    failed = replace(data(TWO)[0], status="slipped", reason="it slipped")
    wrong = replace(failed, wrench_on_object_world=5 * failed.wrench_on_object_world)
    clean, mixed = (ask(TWO, quick(method), given).distribution for given in (data(TWO), [*data(TWO), wrong]))
    assert clean is not None
    assert mixed is not None
    assert np.array_equal(clean.mass, mixed.mass)


def test_a_sample_that_is_no_number_is_no_trajectory():
    turn = turns(TWO)[0]
    wrench = turn.wrench_on_object_world.copy()
    wrench[7, 0] = np.nan
    with pytest.raises(InvalidValueError, match="wrench_on_object_world"):
        replace(turn, wrench_on_object_world=wrench)


@pytest.mark.parametrize("method", METHODS)
def test_traces_show_the_way_to_the_answer(method):
    answer = ask(THREE, quick(method))
    budget = QUICK[method]
    assert answer.distribution is not None
    assert len(answer.traces) == (1 if method in SEARCHES else len(OPTIMIZERS))
    for trace in answer.traces:
        assert len(trace.loss) == len(trace.seconds) == len(trace.mass) == budget
        assert trace.robot_seconds == pytest.approx(sum(t.time_s[-1] - t.time_s[0] for t in data(THREE)))
    lowest = [min(trace.loss) for trace in answer.traces]
    assert lowest == sorted(lowest)
    assert lowest[0] == pytest.approx(answer.diagnostics["loss"], rel=1e-9)
    best = answer.traces[0].mass[int(np.argmin(answer.traces[0].loss))]
    assert_allclose(best, answer.distribution.mass, rtol=1e-9)


@pytest.mark.parametrize("method", SEARCHES)
def test_the_trace_of_a_search_is_the_best_so_far(method):
    (trace,) = ask(THREE, quick(method)).traces
    assert (np.diff(trace.loss) <= 0).all()
    fell = np.flatnonzero(np.diff(trace.loss) < 0)
    assert len(fell) > 2
    same = np.setdiff1d(np.arange(len(trace.loss) - 1), fell)
    assert (trace.mass[same] == trace.mass[same + 1]).all()


def test_weighted_sampling_begins_on_a_grid_and_ends_near_its_best():
    (trace,) = ask(TWO, WeightedSampling(use_weight=True), seed=1).traces
    other = ask(TWO, WeightedSampling(use_weight=True), seed=2).traces[0]
    on_grid = round(0.25 * ITERATIONS)
    assert trace.loss[: on_grid // 2] == other.loss[: on_grid // 2]
    assert trace.loss[-1] < 0.1 * trace.loss[on_grid // 2]
    assert trace.loss != other.loss


@pytest.mark.parametrize("method", METHODS)
def test_a_budget_of_one_is_an_answer(method):
    answer = ask(THREE, method(iterations=1))
    assert answer.status in ("ok", "not_converged")
    assert bool(answer.message) == (answer.status != "ok")
    assert answer.distribution is not None
    assert len(answer.traces[0].loss) == 1


@pytest.mark.parametrize("method", [RandomSearch, ExplicitState])
def test_two_friction_groups_are_searched_too(method):
    obj = drawn_object(1, friction_groups=2)
    answer = ask(obj, quick(method, use_weight=True))
    assert answer.distribution is not None
    assert answer.distribution.friction.shape == (2,)
    assert (answer.distribution.friction > 0).all()


WRONG: tuple[tuple[type[Baseline], dict[str, object], str], ...] = (
    *((kind, {"iterations": bad}, "an integer >= 1") for kind in METHODS for bad in (0, -3, 2.5, True)),
    *((kind, {"use_weight": bad}, "true or false") for kind in METHODS for bad in (1, "yes")),
    *((kind, {"weighting": "none"}, "velocity") for kind in METHODS),
    *((kind, {"pivot_error": bad}, ">= 0") for kind in METHODS for bad in (-1.0, math.nan)),
    (WeightedSampling, {"grid_part": 0.0}, "> 0"),
    (WeightedSampling, {"grid_part": 1.5}, "<= 1"),
    (WeightedSampling, {"decay": 1.1}, "<= 1"),
    (WeightedSampling, {"decay": -0.5}, "> 0"),
    (WeightedSampling, {"first_deviation": 0.0}, "> 0"),
    (WeightedSampling, {"generation": 0}, "an integer >= 1"),
    (WeightedSampling, {"generation": 2.0}, "an integer >= 1"),
    *(
        (kind, {"optimizers": bad}, "adam, rmsprop, plain")
        for kind in (ExplicitState, DiffLcp)
        for bad in ((), ("sgd",))
    ),
    *((kind, {"learning_rate": bad}, "> 0") for kind in (ExplicitState, DiffLcp) for bad in (0.0, math.inf)),
    (DiffLcp, {"weighting": "covariance"}, "velocity"),
    (DiffLcp, {"samples": 0}, "an integer >= 1"),
    (DiffLcp, {"directions": 7}, "even integer >= 4"),
    (DiffLcp, {"substeps": 0}, "an integer >= 1"),
)


@pytest.mark.parametrize(("kind", "settings", "allowed"), WRONG)
def test_a_wrong_setting_is_refused_by_name_with_what_was_given_and_what_is_allowed(kind, settings, allowed):
    ((name, given),) = settings.items()
    with pytest.raises(InvalidValueError) as refused:
        kind(**settings)
    assert name in refused.value.field
    assert repr(given) in str(refused.value)
    assert allowed in refused.value.allowed
