"""Steps of Algorithm 1: friction loads, moments of inertia, masses and frictions; and descent on known functions."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from torch import Tensor

from estimators.descent import GROW, OPTIMIZERS, SHRINK, check_optimizers, descend, descend_all
from estimators.hidden_states.equations import LinearSystem
from estimators.hidden_states.friction import closed_form, closed_form_covariance, descend_loads
from estimators.hidden_states.inertia import com_and_inertia
from estimators.hidden_states.masses import (
    MassSolution,
    PivotInertia,
    feet_of,
    friction_loads,
    inertia_map,
    solve_masses,
)
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.particles.load_groups import LoadGroups, rank_of
from estimators.particles.windows import Observations
from estimators.posterior import table_errors
from estimators.posterior.scale import Weighing
from estimators.testing.analytic_world import analytic_trial, drawn_object, turns
from estimators.wrench.model import EXACT, ModelErrors, ParticleModel
from testbed import Accelerate, InvalidValueError, Rotate, Slide, Trajectory, load_object
from testbed.objects.model import GRAVITY, MassDistribution, ObjectModel
from testbed.worlds.setup_errors import EXACT_SETUP
from tests.helpers.answers import trials_of, windows_of
from tests.helpers.blocks import blocks

NAMES = ("I2", "L2", "F2")
ERRORS = ModelErrors(pivot_error=0.0, force_error=0.002, torque_error=0.001)


def system_of(obj: ObjectModel, trajectories: list[Trajectory]) -> LinearSystem:
    """Q s = b with the gripper's load worked out from the truth."""
    trials = TrialWindows.of(obj.shape, obj.total_mass, trajectories, ERRORS)
    assert trials is not None
    return trials.friction_system(obj.truth)


def true_loads(obj: ObjectModel) -> np.ndarray:
    return friction_loads(obj.shape, LoadGroups.of(ParticleModel.of(obj.shape)).pairs, obj.truth)


def directions(obj: ObjectModel, action: Rotate | Slide) -> np.ndarray:
    """Three rows of Q from geometry alone, by numpy: one column per mass group."""
    x, y = (obj.shape.particles - obj.shape.grasps[action.grasp].position).T
    if isinstance(action, Slide):
        unit = np.tile([np.cos(action.direction), np.sin(action.direction)], (len(x), 1))
    else:
        unit = np.column_stack([-y, x]) / np.maximum(np.hypot(x, y), 1e-9)[:, None]
    rows = (unit[:, 0], unit[:, 1], x * unit[:, 1] - y * unit[:, 0])
    return np.array([np.bincount(obj.shape.mass_group, row, obj.shape.n_m) for row in rows])


@pytest.mark.parametrize("groups", [1, 2, 3])
def test_gather_and_spread_are_the_groups_matrix(groups):
    model = ParticleModel.of(drawn_object(1, friction_groups=groups).shape)
    found = LoadGroups.of(model)
    both = list(zip(model.mass_group.tolist(), model.friction_group.tolist(), strict=True))
    matrix = np.array([[pair == column for column in found.pairs] for pair in both], dtype=float)
    rng = np.random.default_rng(0)
    values, s = torch.tensor(rng.normal(size=(2, 3, len(both)))), rng.normal(size=len(found.pairs))
    assert_allclose(found.gather(values), values.numpy() @ matrix, atol=1e-13)
    assert_allclose(found.spread(s), matrix @ s)


@pytest.mark.parametrize("carried", [{}, {"lift": 0.5, "moment": (0.004, -0.003)}], ids=["free", "carried"])
@pytest.mark.parametrize("name", NAMES)
def test_the_truth_solves_the_system(name, carried):
    obj = load_object(name)
    slide = analytic_trial(obj, Slide(1, direction=0.7), **carried)
    system = system_of(obj, [*turns(obj, **carried), slide])
    if not carried:  # what the gripper carries is in the errors of the rows
        assert_allclose(system.q.numpy() @ true_loads(obj), system.b, atol=1e-6 * float(system.b.abs().max()))
    assert_allclose(closed_form(system), true_loads(obj), rtol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_closed_form_is_least_squares_and_descent_arrives_there(name):
    system = system_of(load_object(name), turns(load_object(name), noise=0.05))
    exact = closed_form(system)
    free, *_ = np.linalg.lstsq(system.q.numpy(), system.b.numpy(), rcond=None)
    assert (free > 0).all()
    assert_allclose(exact, free, rtol=1e-9)
    found, traces = descend_loads(system, OPTIMIZERS, 500, 0.0)
    # 500 steps: the slowest of the three is within two parts in ten thousand of the largest load
    assert_allclose(found, exact, atol=2e-4 * exact.max())
    assert {trace.method for trace in traces} == set(OPTIMIZERS)
    for trace in traces:
        assert len(trace.loss) == 500
        assert trace.loss[-1] == pytest.approx(system.loss(exact), rel=1e-3, abs=1e-6)


def test_the_closed_form_keeps_to_the_bound_at_its_true_minimum():
    rng = np.random.default_rng(0)
    q, s = rng.normal(size=(30, 5)), np.array([1.0, -0.5, 0.3, -0.2, 0.8])
    found = closed_form(LinearSystem(torch.tensor(q), torch.tensor(q @ s), torch.eye(len(q))))
    slope = q.T @ (q @ found - q @ s)
    assert (found == 0).any()
    assert_allclose(slope[found > 0], 0, atol=1e-9)
    assert (slope[found == 0] > 0).all()


def test_the_covariance_is_the_scatter_of_the_answers():
    obj = load_object("L2")
    system = system_of(obj, turns(obj, noise=0.05))
    rng = np.random.default_rng(0)
    q, mean = system.q.numpy(), system.q.numpy() @ true_loads(obj)
    draws = [np.linalg.lstsq(q, mean + rng.normal(size=len(mean)), rcond=None)[0] for _ in range(1500)]
    claimed = closed_form_covariance(system)
    scale = np.sqrt(np.diag(claimed))
    assert_allclose(np.cov(np.array(draws).T) / np.outer(scale, scale), claimed / np.outer(scale, scale), atol=0.12)


def test_the_rank_counts_directions_whatever_the_units_of_a_column():
    q = np.random.default_rng(0).normal(size=(12, 4))
    assert rank_of(q) == rank_of(q * [1e-6, 1, 1e6, 1]) == rank_of(np.column_stack([q, q[:, 0] + q[:, 1]])) == 4
    assert rank_of(np.zeros((6, 3))) == 0


@pytest.mark.parametrize(("name", "most"), [("I1", 2), ("L1", 3), ("F1", 3)])
def test_slides_alone_never_fill_the_rank(name, most):
    obj = load_object(name)
    slides = [Slide(i % len(obj.shape.grasps), direction=0.3 + i, duration=2.5) for i in range(6)]
    for count in range(1, len(slides) + 1):
        rank = system_of(obj, [analytic_trial(obj, slide) for slide in slides[:count]]).rank
        assert rank <= min(count + 1, most)
        assert rank == rank_of(np.vstack([directions(obj, slide) for slide in slides[:count]]))


OFF_ROW = np.array([[0.0, 0.0], [0.05, 0.01], [-0.02, 0.08], [0.03, -0.06]])
OBJECT = drawn_object(1)
L2, F2 = load_object("L2"), load_object("F2")


def about(obj: ObjectModel, points: np.ndarray) -> np.ndarray:
    """Moments of inertia about some points, cell by cell, kg m^2."""
    squares = np.sum((obj.shape.particles - np.asarray(points)[:, None]) ** 2, axis=2) + obj.shape.cell**2 / 6
    return squares @ obj.particle_mass


def pivots_about(obj: ObjectModel, points: np.ndarray) -> PivotInertia:
    return PivotInertia(points, about(obj, points), np.full(len(points), 1e-12))


def slopes(
    obj: ObjectModel, windows: Observations, relative_error: float = 0.0, guess: MassDistribution | None = None
) -> PivotInertia:
    """I_j by the true friction loads, about the true masses or a guess."""
    trials = TrialWindows.about(obj.shape, obj.total_mass, windows, replace(EXACT, inertia_error=relative_error))
    found = trials.pivot_inertias(guess or obj.truth, true_loads(obj))
    assert found is not None
    return found


def with_torque(windows: Observations, torque: np.ndarray) -> Observations:
    """Windows with more torque about the grasp point, N m."""
    more = torch.zeros(len(windows), 6, dtype=torch.float64)
    more[:, 5] = torch.tensor(torque)
    return replace(windows, sensed=windows.sensed + torch.linalg.solve(windows.from_sensor, more))


@pytest.mark.parametrize("name", ["I1", "I2", "L1", "L2", "F1", "F2"])
def test_the_slope_is_the_moment_of_inertia(name):
    obj = load_object(name)
    windows = windows_of(obj, trials_of(obj))
    found = slopes(obj, windows)
    assert len(found.pivot) == len(obj.shape.grasps)
    # the turn is steady to rounding; acceleration itself is a slope of samples
    assert_allclose(found.inertia, about(obj, found.pivot), rtol=1e-5)
    even = MassDistribution(np.full(obj.shape.n_m, obj.total_mass / len(obj.shape.particles)), obj.truth.friction)
    # a center of mass that is elsewhere is unknown within the object's reach, and the arm swings: off by a part of that
    guessed = slopes(obj, windows, guess=even)
    assert_allclose(guessed.inertia, about(obj, found.pivot), rtol=1.5e-3)
    assert_allclose(inertia_map(obj.shape, found.pivot) @ obj.truth.mass, about(obj, found.pivot))


def test_turns_of_both_directions_about_one_point_are_one_pivot():
    there = Accelerate(1)
    back = Accelerate(1, tuple(-a for a in there.accelerations), start_speed=-there.start_speed)
    found = slopes(L2, windows_of(L2, [*turns(L2), analytic_trial(L2, there), analytic_trial(L2, back)]))
    assert_allclose(found.pivot, [L2.shape.grasps[1].position], atol=1e-9)
    assert_allclose(found.inertia, about(L2, found.pivot), rtol=1e-5)


def test_a_constant_of_every_trial_is_taken_away():
    windows = windows_of(F2, [*turns(F2)[:1], *(analytic_trial(F2, Accelerate(grasp)) for grasp in (0, 0, 2))])
    constant = np.array([0.0, 0.3, -0.2, 0.1])[windows.trial]
    assert_allclose(slopes(F2, with_torque(windows, constant)).inertia, slopes(F2, windows).inertia, rtol=1e-9)


@pytest.mark.slow
def test_the_variance_is_the_scatter_of_the_slopes(monkeypatch):
    monkeypatch.setattr(table_errors, "SWING", 0.0)  # this arm does not swing
    clean, noisy = (
        windows_of(L2, [*turns(L2, noise=noise)[:1], analytic_trial(L2, Accelerate(0), noise=noise)])
        for noise in (0.0, 0.2)
    )
    rng, runs = np.random.default_rng(0), []
    for _ in range(150):
        noise = rng.standard_normal(len(clean)) * noisy.covariance[:, 2, 2].sqrt().numpy()
        runs.append(slopes(L2, replace(with_torque(clean, noise), noise=noisy.noise)))
    scatter = np.std([run.inertia[0] for run in runs])
    claimed = np.sqrt(np.mean([run.variance[0] for run in runs]))
    assert claimed == pytest.approx(scatter, rel=0.3)
    bound = slopes(L2, clean, relative_error=0.01)
    assert np.sqrt(bound.variance[0]) >= 0.01 * bound.inertia[0]


@pytest.mark.parametrize("seed", range(4))
def test_center_and_inertia_come_back_from_pivots_off_one_row(seed):
    obj = drawn_object(seed)
    found = com_and_inertia(pivots_about(obj, OFF_ROW), obj.total_mass)
    assert_allclose(found.center_of_mass, obj.center_of_mass, atol=1e-10)
    assert found.inertia_cm == pytest.approx(obj.inertia_cm, rel=1e-9)
    assert found.unobserved == ""


def test_the_answer_obeys_the_parallel_axis_theorem_and_moves_with_the_frame():
    pivots = pivots_about(OBJECT, OFF_ROW)
    found = com_and_inertia(pivots, OBJECT.total_mass)
    squares = np.sum((OFF_ROW - found.center_of_mass) ** 2, axis=1)
    assert_allclose(found.inertia_cm + OBJECT.total_mass * squares, pivots.inertia)
    turn, shift = np.array([[0.6, -0.8], [0.8, 0.6]]), np.array([0.3, -0.2])
    moved = com_and_inertia(replace(pivots, pivot=OFF_ROW @ turn.T + shift), OBJECT.total_mass)
    assert_allclose(moved.center_of_mass, turn @ found.center_of_mass + shift, atol=1e-10)
    assert moved.inertia_cm == pytest.approx(found.inertia_cm)


def test_a_pivot_known_badly_hardly_counts():
    pivots = pivots_about(OBJECT, OFF_ROW)
    wrong = replace(pivots, inertia=pivots.inertia * [1, 1, 1, 2], variance=np.array([1e-12, 1e-12, 1e-12, 1.0]))
    assert_allclose(com_and_inertia(wrong, OBJECT.total_mass).center_of_mass, OBJECT.center_of_mass, atol=1e-7)


def test_a_straight_row_gives_no_number_across_itself():
    row = np.array([[-0.1, 0.02], [0.0, 0.02], [0.05, 0.02]])
    found = com_and_inertia(pivots_about(OBJECT, row), OBJECT.total_mass)
    assert found.center_of_mass[0] == pytest.approx(OBJECT.center_of_mass[0], abs=1e-10)
    assert np.isnan([found.center_of_mass[1], found.inertia_cm]).all()
    bound = OBJECT.inertia_cm + OBJECT.total_mass * (OBJECT.center_of_mass[1] - 0.02) ** 2
    assert "straight row" in found.unobserved
    assert f"= {bound:.6f} kg m^2" in found.unobserved


@pytest.mark.parametrize(
    ("points", "why"),
    [
        (np.array([[0.0, 0.0], [0.03, 0.03], [0.1, 0.1]]), "straight row"),
        (OFF_ROW[:2], "straight row"),
        (OFF_ROW[:1], "fewer than two pivots"),
        (None, "fewer than two pivots"),
    ],
    ids=["slanted row", "two", "one", "none"],
)
def test_too_few_pivots_give_no_center_and_say_why(points, why):
    found = com_and_inertia(None if points is None else pivots_about(OBJECT, points), OBJECT.total_mass)
    assert np.isnan([*found.center_of_mass, found.inertia_cm]).all()
    assert why in found.unobserved


PRECISE = 1e-6
"""Error of every load, N, and of the weight, kg, where the hidden states are exact."""
SIX = [0.4, 0.1, 0.2, 0.3, 0.4, 0.2]
"""Masses of six blocks, kg."""


def exact_loads(obj: ObjectModel) -> tuple[tuple[tuple[int, int], ...], np.ndarray]:
    """Pairs of groups in contact and s = mu m g of one particle of each, all weight on the pair's own feet, N."""
    pairs = LoadGroups.of(ParticleModel.of(obj.shape)).pairs
    feet = np.bincount(obj.shape.mass_group[obj.shape.friction_group >= 0], minlength=obj.shape.n_m)
    return pairs, np.array([obj.truth.friction[f] * obj.group_mass[m] * GRAVITY / feet[m] for m, f in pairs])


def exact_pivots(obj: ObjectModel, error: float = 1e-8) -> PivotInertia:
    """I_j about every grasp, kg m^2."""
    points = np.array([grasp.position for grasp in obj.shape.grasps])
    return PivotInertia(points, inertia_map(obj.shape, points) @ obj.truth.mass, np.full(len(points), error**2))


def solved(
    obj: ObjectModel, pivots: PivotInertia | None, loads: np.ndarray | None = None, variance: float = PRECISE**2
) -> MassSolution:
    """Masses and frictions by hidden states, the loads exact if left out."""
    pairs, exact = exact_loads(obj)
    loads, weighing = exact if loads is None else loads, Weighing.of(obj.shape, PRECISE, EXACT_SETUP)
    covariance = variance * np.eye(len(loads))
    return solve_masses(obj.shape, obj.total_mass, weighing, pairs, loads, covariance, pivots)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("groups", [1, 2, 3])
def test_exact_hidden_states_give_exact_masses(groups, seed):
    obj = drawn_object(seed, friction_groups=groups)
    found = solved(obj, exact_pivots(obj))
    assert_allclose(found.distribution.mass, obj.truth.mass, rtol=1e-9)
    assert_allclose(found.distribution.friction, obj.truth.friction, rtol=1e-9)
    assert found.rank == found.unknowns == obj.shape.n_m + obj.shape.n_mu


def test_one_friction_needs_the_weight_alone_and_two_are_not_of_full_rank():
    one, two = (drawn_object(0, friction_groups=groups) for groups in (1, 2))
    known, open_ = (solved(obj, None) for obj in (one, two))
    assert known.rank == known.unknowns and open_.rank == open_.unknowns - 1
    assert_allclose(known.distribution.mass, one.truth.mass, rtol=1e-9)


def test_a_block_that_stands_on_part_of_itself_weighs_all_of_it():
    whole = load_object("L2")
    friction_group = np.array(whole.shape.friction_group)
    friction_group[::2] = -1
    obj = replace(whole, shape=replace(whole.shape, friction_group=friction_group))
    found = solved(obj, exact_pivots(obj))
    assert_allclose(found.distribution.mass, obj.truth.mass, rtol=1e-9)
    pairs, _ = exact_loads(obj)
    assert feet_of(obj.shape, pairs).sum() == (friction_group >= 0).sum()


@pytest.mark.parametrize(
    ("layout", "most"),
    [(["111111"], 3), (["1", "1", "1", "111"], 4), (["10", "11", "10", "11"], 4)],
    ids=["I", "L", "F"],
)
def test_as_many_frictions_as_claimed_are_distinguished_and_no_more(layout, most):
    for count in (most, most + 1):
        groups = [i % count for i in range(6)]
        obj = blocks(layout, SIX, np.linspace(0.3, 0.7, count).tolist(), groups)
        found = solved(obj, exact_pivots(obj))
        assert (found.rank == found.unknowns) == (count == most)


@pytest.mark.parametrize("least", [0.0, 1e-5])
def test_the_mass_of_a_frictionless_group_comes_from_weight_and_inertia(least):
    obj = blocks(["1", "1", "1", "111"], SIX, [0.5, least], [0, 0, 0, 0, 0, 1])
    found = solved(obj, exact_pivots(obj)).distribution
    assert_allclose(found.mass, obj.truth.mass, rtol=1e-6)
    assert least or abs(found.friction - obj.truth.friction).max() < 1e-6


def test_no_mass_is_below_zero_when_the_loads_are_noise():
    obj = drawn_object(0)
    loads = exact_loads(obj)[1]
    loads[2] = 0.0
    found = solved(obj, None, loads, 1e-4)
    assert (found.distribution.mass >= 0).all()
    assert found.distribution.mass[2] == pytest.approx(0, abs=1e-9)


MINIMUM = torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64)
CURVES = torch.tensor([1.0, 3.0, 0.4], dtype=torch.float64)
START = torch.zeros(3, dtype=torch.float64)
LOWEST = 0.25
RATES = {"adam": 0.1, "rmsprop": 0.1, "plain": 0.1}


def bowl(x: Tensor) -> Tensor:
    """A quadratic of condition number 7.5, lowest at MINIMUM."""
    return LOWEST + (CURVES * (x - MINIMUM).square()).sum(-1)


def valley(x: Tensor) -> Tensor:
    """Rosenbrock's, lowest at (1, 1)."""
    return (1 - x[:, 0]).square() + 100 * (x[:, 1] - x[:, 0].square()).square()


def test_every_optimizer_finds_the_minimum_of_a_quadratic():
    runs = descend(bowl, START, RATES, 500)
    assert {run.trace.method for run in runs} == set(OPTIMIZERS)
    for run in runs:
        assert_allclose(run.best, MINIMUM, atol=1e-4)
        assert min(run.trace.loss) == pytest.approx(LOWEST, abs=1e-7)
        assert float(bowl(run.best[None])[0]) == min(run.trace.loss)


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_side_by_side_each_does_as_it_does_alone(name):
    (alone,) = descend(bowl, START, {name: RATES[name]}, 60)
    together = next(run for run in descend(bowl, START, RATES, 60) if run.trace.method == name)
    assert together.trace.loss == alone.trace.loss
    assert torch.equal(together.best, alone.best)


@pytest.mark.slow  # torch.optim imports the compiler
@pytest.mark.parametrize(("name", "kind"), [("adam", torch.optim.Adam), ("rmsprop", torch.optim.RMSprop)])
def test_steps_are_those_of_torch(name, kind):
    point = torch.tensor([-1.2, 1.0], dtype=torch.float64, requires_grad=True)
    optimizer, losses = kind([point], lr=0.05), []
    for i in range(200):
        optimizer.param_groups[0]["lr"] = 0.05 * (1 - i / 200) ** 2
        optimizer.zero_grad()
        value = valley(point[None])[0]
        value.backward()
        losses.append(value.item())
        optimizer.step()
    (run,) = descend(valley, torch.tensor([-1.2, 1.0], dtype=torch.float64), {name: 0.05}, 200)
    assert_allclose(run.trace.loss, losses, rtol=1e-9)


def test_many_descents_at_once_are_those_one_by_one():
    starts = torch.tensor([[0.0, 0.0, 0.0], [3.0, 1.0, -1.0], [1.0, -2.0, 0.5]], dtype=torch.float64)
    many = descend_all(lambda z: bowl(z.flatten(0, 1)).unflatten(0, z.shape[:2]), starts, RATES, 60, masses=lambda z: z)
    for start, runs in zip(starts, many, strict=True):
        for run, alone in zip(runs, descend(bowl, start, RATES, 60, masses=lambda z: z), strict=True):
            assert run.trace.method == alone.trace.method
            assert_allclose(run.trace.loss, alone.trace.loss, rtol=1e-12)
            assert_allclose(run.trace.mass, alone.trace.mass, rtol=1e-12, atol=1e-14)
            assert torch.equal(run.best, alone.best)


@pytest.mark.parametrize("steps", [1, 40])
def test_a_trace_has_one_entry_a_step_with_the_masses_of_its_losses(steps):
    start = START.clone()
    for run in descend(bowl, start, RATES, steps, masses=lambda x: x, robot_seconds=12.5):
        trace = run.trace
        assert len(trace.loss) == len(trace.seconds) == len(trace.mass) == steps
        assert (np.diff(trace.seconds) > 0).all()
        assert trace.robot_seconds == 12.5
        assert_allclose(bowl(torch.tensor(trace.mass)), trace.loss)
        assert_allclose(trace.mass[[0, int(np.argmin(trace.loss))]], np.stack([START, run.best]))
    assert descend(bowl, start, RATES, 1)[0].trace.mass.shape == (0, 0)
    assert torch.equal(start, START)
    assert not start.requires_grad


@pytest.mark.parametrize(
    "rates", [{"plain": 1e-6, "adam": 0.1}, {"adam": 1e-6, "plain": 0.1}, {"rmsprop": 0.1, "adam": 1e-4}]
)
def test_the_best_run_comes_first(rates):
    first, second = (min(run.trace.loss) for run in descend(bowl, START, rates, 50))
    assert first < second


@pytest.mark.parametrize("rate", [1e-6, 1.0, 1e9])
@pytest.mark.parametrize(("loss", "start"), [(bowl, START), (valley, torch.tensor([-1.2, 1.0], dtype=torch.float64))])
def test_plain_descent_never_diverges_whatever_its_first_rate(loss, start, rate):
    (run,) = descend(loss, start, {"plain": rate}, 400)
    losses = np.array(run.trace.loss)
    assert np.isfinite(losses).all()
    assert losses.min() < losses[0]
    # only the tens of steps that bring a wild rate back may lie above the start
    assert np.median(losses) <= losses[0]


def test_plain_descent_takes_back_a_step_that_raised_the_loss_and_grows_one_that_is_too_small():
    (run,) = descend(bowl, START, {"plain": 10.0}, 60, masses=lambda x: x)
    losses, points = np.array(run.trace.loss), run.trace.mass
    slope = 2 * CURVES.numpy() * (START - MINIMUM).numpy()
    for k in range(1, 4):  # each time from the start again, by half the step
        assert losses[k] > losses[0]
        assert_allclose(points[k], -10.0 * GROW * SHRINK ** (k - 1) * slope)
    assert losses[-1] < losses[0]
    (run,) = descend(bowl, START, {"plain": 1e-4}, 200)
    assert min(run.trace.loss) == pytest.approx(LOWEST, abs=1e-3)


def test_a_first_guess_at_the_minimum_stays_there():
    for run in descend(bowl, MINIMUM, RATES, 20):
        assert_allclose(run.best, MINIMUM, atol=1e-12)


@pytest.mark.parametrize("names", [(), ("newton",), ("adam", "newton")])
def test_unknown_optimizers_are_refused_by_name(names):
    with pytest.raises(InvalidValueError, match=r"^Owner\.optimizers:"):
        check_optimizers("Owner", names)
