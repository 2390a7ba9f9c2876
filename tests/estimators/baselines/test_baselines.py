"""The paper's baselines in a world of exact Coulomb friction: recovery, use of M, traces and statuses."""

import math
from dataclasses import replace
from statistics import median

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators import DiffLcp, Estimate, ExplicitState, LeastSquares
from estimators.base import MOST_MASS
from estimators.baselines.base import DENSEST, ITERATIONS, Baseline
from estimators.baselines.sampling import RandomSearch, WeightedSampling, _grid
from estimators.descent import OPTIMIZERS
from estimators.testing.analytic_world import analytic_trial, drawn_object, turns
from testbed import ObjectModel, Slide, Trajectory, load_object
from tests.helpers.answers import ask as answered
from tests.helpers.answers import claimed, found, nad, trials_of
from tests.helpers.blocks import blocks

SEARCHES = (RandomSearch, WeightedSampling)
METHODS = (*SEARCHES, ExplicitState, DiffLcp)
QUICK = {RandomSearch: 200, WeightedSampling: 200, ExplicitState: 40, DiffLcp: 10}
"""Budgets for tests that need no good answer."""
EACH = [pytest.param(kind, marks=[pytest.mark.slow] * (kind in (WeightedSampling, DiffLcp))) for kind in METHODS]
"""A search and a descent quickly, their twins in CI."""
TWO = blocks(["11"], [0.3, 0.1], 0.4, grid=2)
THREE = blocks(["10", "11"], [0.3, 0.1, 0.2], 0.4, grid=2)


def ask(
    obj: ObjectModel, method: Baseline, trajectories: list[Trajectory] | None = None, seed: int = 0, **settings: object
) -> Estimate:
    # the analytic world knows the center of a turn exactly
    exact = replace(method, **{"pivot_error": 0.0} | settings)
    given = trials_of(obj) if trajectories is None else trajectories
    return exact.estimate(obj.shape, obj.total_mass, given, seed)


def quick(method: type[Baseline], **settings: object) -> Baseline:
    return method(**{"iterations": QUICK[method]} | settings)  # pyright: ignore[reportArgumentType]


def drag(answer: Estimate) -> np.ndarray:
    """Friction times particle mass of each group [kg]."""
    return found(answer).friction[0] * found(answer).mass


WITH_M = ExplicitState(use_weight=True, weighting="covariance")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("draw", "iterations", "error"), [(2, 1000, 5e-4), ("L2", 3000, 1e-5), ("F2", 6000, 1e-5), (1, 3000, 1e-5)]
)
def test_explicit_state_with_m_converges_to_the_truth(draw, iterations, error):
    obj = drawn_object(draw) if isinstance(draw, int) else load_object(draw)
    answer = ask(obj, replace(WITH_M, iterations=iterations))
    assert answer.status == "ok" and nad(obj, answer) < error and answer.diagnostics["misfit"] < error
    assert_allclose(found(answer).friction, obj.truth.friction, rtol=error)


@pytest.mark.slow
def test_explicit_state_without_m_finds_the_valley_and_crawls_along_it():
    answer = ask(TWO, ExplicitState(iterations=300))
    assert answer.status == "unexplained" and "the search ended early" in answer.message
    assert_allclose(drag(answer), TWO.truth.friction[0] * TWO.truth.mass, rtol=0.03)
    assert nad(TWO, answer) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("obj", "method", "budgets", "seeds", "bound"),
    [
        (THREE, RandomSearch(use_weight=True), (100, 1000, 10_000), 5, 0.1),
        (TWO, WeightedSampling(use_weight=True), (100, 500, 1000), 5, 1e-3),
        (THREE, ExplicitState(use_weight=True), (30, 150, 500), 1, 0.01),  # with M a descent does not draw
        (TWO, DiffLcp(use_weight=True, directions=16, substeps=1, samples=2), (10, 80), 1, 0.02),
    ],
    ids=["random", "weighted", "explicit", "lcp"],
)
def test_a_larger_budget_comes_nearer_to_the_truth(obj, method, budgets, seeds, bound):
    given = trials_of(obj)
    errors = [
        median(nad(obj, ask(obj, replace(method, iterations=budget), given, seed)) for seed in range(seeds))
        for budget in budgets
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < bound


@pytest.mark.slow
def test_diff_lcp_comes_to_the_truth_as_its_polygon_becomes_a_circle():
    errors = []
    for directions in (4, 64):
        method = DiffLcp(iterations=100, use_weight=True, learning_rate=0.1, directions=directions, samples=2)
        answer = ask(TWO, method, seed=2)
        errors.append(nad(TWO, answer))
        # along the motion a polygon's friction is its radius times sin(pi / n) / (pi / n) in the mean
        part = math.sin(math.pi / directions) / (math.pi / directions)
        assert found(answer).friction * part == pytest.approx(TWO.truth.friction, rel=0.04)
    assert errors[1] < 0.005 < errors[0]


@pytest.mark.slow
def test_diff_lcp_does_not_come_away_from_an_object_that_sticks():
    # friction drawn above what the hand overcomes: predicted at rest, and standing still has no gradient
    answer = ask(TWO, DiffLcp(iterations=60, samples=2), turns(TWO), seed=0)
    assert answer.diagnostics["misfit"] > 1000
    assert nad(TWO, answer) > 0.3
    told = ask(TWO, DiffLcp(iterations=60, use_weight=True, learning_rate=0.1, samples=4), turns(TWO), seed=2)
    assert nad(TWO, told) < 0.1


@pytest.mark.slow
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
    assert_allclose(drag(answer), TWO.truth.friction[0] * TWO.truth.mass, rtol=close)


@pytest.mark.slow
@pytest.mark.parametrize("method", EACH)
def test_m_is_kept_exactly_if_given_and_ignored_if_not(method):
    told = ask(THREE, quick(method, use_weight=True), turns(THREE))
    assert told.status != "underdetermined", "with M, constant speed is enough"
    for mass in (found(told).mass, *(trace.mass for trace in told.traces)):
        assert_allclose(mass @ THREE.shape.particles_per_group, THREE.total_mass, rtol=1e-12)
    blind, heavy, again = (
        found(quick(method).estimate(THREE.shape, weight, trials_of(THREE), seed))
        for weight, seed in ((None, 0), (5.0, 0), (None, 4))
    )
    assert np.array_equal(blind.mass, heavy.mass)
    assert not np.allclose(again.mass, blind.mass)  # what is given decides, and the seed


@pytest.mark.parametrize("method", SEARCHES)
def test_searches_draw_positive_masses_no_denser_than_steel(method):
    heavy = blocks(["10", "11"], [0.5, 0.58, 0.55], 0.9, grid=2)
    steel = DENSEST * heavy.shape.cell**2 * heavy.shape.height
    answer, told = (ask(heavy, quick(method, use_weight=known)) for known in (False, True))
    assert (answer.traces[0].mass >= 0).all() and answer.traces[0].mass.max() <= steel
    assert (told.traces[0].mass >= 0).all()
    assert (found(answer).friction > 0).all()


@pytest.mark.parametrize("method", METHODS)
def test_traces_lead_to_the_answer(method):
    answer = ask(THREE, quick(method))
    budget = QUICK[method]
    assert len(answer.traces) == (1 if method in SEARCHES else len(OPTIMIZERS))
    for trace in answer.traces:
        assert len(trace.loss) == len(trace.seconds) == len(trace.mass) == budget
        assert trace.robot_seconds == pytest.approx(sum(t.time_s[-1] - t.time_s[0] for t in trials_of(THREE)))
    lowest = [min(trace.loss) for trace in answer.traces]
    assert lowest == sorted(lowest)
    assert lowest[0] == pytest.approx(answer.diagnostics["loss"], rel=1e-9)
    first = answer.traces[0]
    assert_allclose(first.mass[int(np.argmin(first.loss))], found(answer).mass, rtol=1e-9)
    if method in SEARCHES:  # the best so far
        change = np.diff(first.loss)
        assert (change <= 0).all() and (change < 0).sum() > 2
        assert (np.diff(first.mass, axis=0)[change == 0] == 0).all()


@pytest.mark.parametrize(
    ("obj", "budget", "levels"),
    [(load_object("I2"), 500, 2), (load_object("I2"), 20_000, 3), (TWO, 500, 5), (TWO, 8, 2)],
)
def test_the_grid_of_weighted_sampling_has_every_combination_of_its_levels(obj, budget, levels):
    sides = obj.shape.n_mu + obj.shape.n_m
    points = _grid(sides, obj.shape.n_mu, budget, 0.25)
    assert len(points) == levels**sides == len(np.unique(points, axis=0)) <= budget
    assert all(len(np.unique(column)) == levels for column in points.T)


def test_where_not_even_two_levels_fit_the_masses_of_the_grid_are_alike():
    points = _grid(9, 1, 500, 0.25)
    assert len(points) == 11**2 and (points[:, 1:] == points[:, 1:2]).all()
    assert len(_grid(9, 1, 512, 0.25)) == 512


@pytest.mark.slow
def test_on_a_block_object_the_budget_of_the_paper_holds_a_grid():
    obj = load_object("L2")
    one, other = (ask(obj, WeightedSampling(), seed=seed).traces[0] for seed in (0, 1))
    assert one.loss[:128] == other.loss[:128] != one.loss[:1] * 128
    assert one.loss[128:] != other.loss[128:]
    best = one.mass[127]
    assert len(np.unique(best.round(12))) > 1, "the best of the grid tells light blocks from heavy ones"


def test_weighted_sampling_begins_on_a_grid_and_ends_near_its_best():
    (trace,) = ask(TWO, WeightedSampling(use_weight=True), seed=1).traces
    other = ask(TWO, WeightedSampling(use_weight=True), seed=2).traces[0]
    on_grid = round(0.25 * ITERATIONS)
    assert trace.loss[: on_grid // 2] == other.loss[: on_grid // 2]
    assert trace.loss[-1] < 0.1 * trace.loss[on_grid // 2]
    assert trace.loss != other.loss


@pytest.mark.parametrize("method", EACH)
def test_a_budget_of_one_is_an_answer(method):
    answer = ask(THREE, method(iterations=1))
    assert answer.status in ("unexplained", "not_converged") and answer.message
    assert len(found(answer).mass) == THREE.shape.n_m and len(answer.traces[0].loss) == 1


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_slides_without_a_torque_are_explained(noise):
    one = blocks(["1"], [0.3], 0.4)
    (middle,) = (k for k, grasp in enumerate(one.shape.grasps) if not grasp.position.any())
    slides = [analytic_trial(one, Slide(middle, way), noise=noise, seed=k + 3) for k, way in enumerate((0.0, 1.6, 3.1))]
    answer = LeastSquares().estimate(one.shape, one.total_mass, slides, 0)
    assert answer.status == "ok"
    assert found(answer).friction == pytest.approx([0.4], rel=0.03)


def test_a_search_that_diverges_is_an_answer_that_has_not_converged():
    class Diverging(ExplicitState):
        def _search(self, problem, seed):
            result = super()._search(problem, seed)
            return replace(result, mass=np.array([1e9, np.nan]), friction=np.array([np.nan]))

    answer = Diverging(iterations=1).estimate(TWO.shape, TWO.total_mass, trials_of(TWO), 0)
    assert answer.status == "not_converged"
    assert_allclose(found(answer).mass, MOST_MASS)


@pytest.mark.parametrize("method", [RandomSearch, ExplicitState])
def test_two_friction_groups_are_searched_too(method):
    obj = drawn_object(1, friction_groups=2)
    answer = ask(obj, quick(method, use_weight=True))
    assert found(answer).friction.shape == (2,) and (found(answer).friction > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("method", EACH)
@pytest.mark.parametrize("use_weight", [False, True])
def test_masses_double_exactly_with_the_wrenches(method, use_weight):
    # light, so that no draw comes near the density of steel
    light, kind = blocks(["10", "11"], [0.003, 0.001, 0.002]), quick(method, use_weight=use_weight)
    twice = [replace(t, wrench_on_object_world=2 * t.wrench_on_object_world) for t in trials_of(light)]
    once = found(kind.estimate(light.shape, light.total_mass, trials_of(light), 0))
    double = found(kind.estimate(light.shape, 2 * light.total_mass, twice, 0))
    # many steps amplify rounding, and more so where it decides the side of a polygon's corner
    rounding = 1e-4 if method is DiffLcp else 1e-6
    assert_allclose(double.mass, 2 * once.mass, rtol=rounding)
    assert_allclose(double.friction, once.friction, rtol=rounding)


@pytest.mark.slow
def test_least_squares_claims_the_errors_that_its_answers_have():
    off = []
    for seed in range(4):
        obj = drawn_object(seed)
        answer = answered(obj, trials_of(obj, noise=0.1), LeastSquares())
        assert answer.status == "ok"
        off.append((found(answer).mass - obj.truth.mass) / claimed(answer))
    spread = np.sqrt(np.mean(np.concatenate(off) ** 2))
    assert 0.1 < spread < 1.5, spread
    assert ask(TWO, LeastSquares(weighting="velocity")).covariance is None
