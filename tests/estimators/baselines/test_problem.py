"""Eq. problem on steady windows: predicted wrench, loss and gradient, against plain numpy and the dynamics."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from estimators import Estimate, HiddenStates
from estimators.baselines.base import Baseline
from estimators.baselines.problem import ROUNDS, STEP, Problem
from estimators.hidden_states.friction import closed_form
from estimators.hidden_states.masses import inertia_map, one_friction_masses
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.particles.wrench import AffineLoads
from estimators.testing.analytic_world import accelerated, analytic_trial, drawn_object, turns
from estimators.wrench.model import ModelErrors, ParticleModel, inertia_of, one_step, rotate, turned
from estimators.wrench.support import own_weight
from testbed import InvalidValueError, ObjectModel, Slide, Trajectory
from tests.helpers.answers import true_values, windows_of
from tests.helpers.blocks import blocks

CARRIED = {"lift": 0.4, "moment": (0.004, -0.003)}
ROUNDING = 1e-12
# Below this speed, m/s, `dynamics` fades the direction of friction; the windows are given the same blur
REST_SPEED, SPEED = 1e-6, np.radians(10)
OBJECT = drawn_object(0)


def cut(grid: int, friction_groups: int = 1) -> ObjectModel:
    """Five blocks of drawn masses, cut `grid` x `grid`."""
    rng = np.random.default_rng(grid)
    mass, friction = rng.uniform(0.05, 0.6, 5).tolist(), rng.uniform(0.2, 0.8, friction_groups).tolist()
    return blocks(["101", "111"], mass, friction, [i % friction_groups for i in range(5)], grid=grid)


def problem_of(
    obj: ObjectModel,
    trials: list[Trajectory],
    pivot_error: float = 0.0,
    errors: ModelErrors | None = None,
    *,
    use_weight: bool = False,
) -> Problem:
    errors = errors or ModelErrors(pivot_error)
    problem = Problem.of(obj.shape, obj.total_mass, trials, use_weight=use_weight, errors=errors)
    assert isinstance(problem, Problem), problem
    return problem


def truth(obj: ObjectModel) -> tuple[torch.Tensor, torch.Tensor]:
    mass, friction = true_values(obj).values()
    return mass, friction


def guesses(obj: ObjectModel, count: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Masses and frictions within a factor of two of the truth."""
    rng = np.random.default_rng(seed)
    return tuple(t * torch.tensor(rng.uniform(0.5, 2, (count, len(t)))) for t in truth(obj))  # pyright: ignore[reportReturnType]


def everything(obj: ObjectModel, **carried: Any) -> list[Trajectory]:
    """Turns, accelerated turns and a slide."""
    slide = analytic_trial(obj, Slide(0, direction=0.7, duration=2.5), **carried)
    return [*turns(obj, **carried), *accelerated(obj, **carried), slide]


@pytest.mark.parametrize(("grid", "friction_groups"), [(1, 1), (2, 2), (3, 1), (4, 3), (0, 2)])
def test_the_truth_predicts_the_measured_wrench(grid, friction_groups):
    obj = cut(grid, friction_groups) if grid else drawn_object(0, friction_groups=friction_groups)
    problem = problem_of(obj, everything(obj, **CARRIED))
    assert bool(problem.windows.accelerated.any())
    predicted = problem.wrenches.wrench(*truth(obj))
    assert_allclose(predicted, problem.windows.wrench, atol=1e-9 * problem.windows.drag)


def test_the_blur_of_the_pivot_is_all_that_it_changes():
    blur, obj = 2e-4, cut(2)
    problem = problem_of(obj, turns(obj), blur)
    away = problem.windows.table(problem.model).velocity.norm(dim=-1) / problem.windows.twist[:, 2:].abs()
    load = problem.model.particle_friction(truth(obj)[1]) * problem.loads.at(truth(obj)[0])
    largest = (load * blur**2 / (2 * away**2)).sum(-1, keepdim=True)
    missing = (problem.wrenches.wrench(*truth(obj)) - problem.windows.wrench)[:, :2].abs()
    assert (missing <= largest + 1e-9).all()
    assert missing.max() > 1e-6


def test_candidates_are_predicted_one_by_one_or_together():
    obj = cut(2, 2)
    problem = problem_of(obj, everything(obj))
    mass, friction = guesses(obj, 12)
    together, loss = problem.wrenches.wrench(mass, friction), problem.loss(mass, friction)
    for k in range(12):
        assert_allclose(problem.wrenches.wrench(mass[k], friction[k]), together[k], atol=ROUNDING)
        assert_allclose(problem.loss(mass[k], friction[k]), loss[k], rtol=1e-9)
    assert problem.loss(mass.reshape(3, 4, -1), friction.reshape(3, 4, -1)).shape == (3, 4)


def stepped(problem: Problem, mass: torch.Tensor, friction: torch.Tensor) -> torch.Tensor:
    """The loss by `dynamics.one_step`, from states built of the windows at some yaw."""
    w, model = problem.windows, problem.model
    inertia = inertia_of(model, model.particle_mass(mass))
    drag = model.particle_friction(friction) * problem.loads.at(mass)
    yaw = torch.linspace(-2, 3, len(w), dtype=torch.float64)
    arm = inertia.com - w.grasp
    velocity = torch.cat([rotate(yaw, w.twist[:, :2] + w.twist[:, 2:] * turned(arm)), w.twist[:, 2:]], -1)
    pulled = w.table(model).motion(model.particle_mass(mass))[:, :2] / inertia.mass
    change = torch.cat([rotate(yaw, pulled), w.acceleration[:, 2:]], -1)
    pose = torch.cat([torch.ones(len(w), 2, dtype=torch.float64), yaw[:, None]], -1)
    wrench = torch.cat([rotate(yaw, w.wrench[:, :2]), w.wrench[:, 2:]], -1)
    after = torch.cat(
        [
            one_step(model, inertia, drag[at], pose[at], velocity[at], wrench[at], w.grasp[k], STEP)
            for k, at in enumerate(slice(k, k + 1) for k in range(len(w)))
        ]
    )
    return (after - velocity - STEP * change).square().sum(-1).mean()


@pytest.mark.parametrize("friction_groups", [1, 2])
def test_the_loss_is_the_velocity_error_of_the_dynamics_one_step_on(friction_groups):
    obj = drawn_object(0, friction_groups=friction_groups)
    steady = problem_of(obj, turns(obj, **CARRIED), pivot_error=REST_SPEED / SPEED)
    both = problem_of(obj, everything(obj, **CARRIED))
    for mass, friction in zip(*guesses(obj, 5), strict=True):
        assert_allclose(steady.loss(mass, friction), stepped(steady, mass, friction), rtol=1e-9)
        # an accelerated turn has no one speed at which to blur alike; its slowest particle moves at 1 mm/s or so
        assert_allclose(both.loss(mass, friction), stepped(both, mass, friction), rtol=1e-6)


@pytest.mark.parametrize(("weighting", "rounding"), [("velocity", 1e-15), ("covariance", 1e-13)])
@pytest.mark.parametrize("seed", range(2))
def test_the_truth_alone_has_no_loss(seed, weighting, rounding):
    obj = drawn_object(seed, friction_groups=1 + seed)
    # what the gripper carries is among the errors of the covariance
    problem = problem_of(obj, everything(obj, **(CARRIED if weighting == "velocity" else {})))
    assert float(problem.loss(*truth(obj), weighting)) < rounding  # whitened: in units of errors of 1e-4 of the drag
    assert float(problem.loss(*guesses(obj, 50), weighting).min()) > 1e-7
    assert problem.unexplained(*truth(obj)) < 1e-15


def covariance_of(problem: Problem) -> torch.Tensor:
    """Covariance of the residuals of all six components, N^2, N^2 m and (N m)^2."""
    whiten = problem.sensed.whiten
    return torch.linalg.inv(whiten.T @ whiten)


@pytest.mark.parametrize("errors", [ModelErrors(inertia_error=0.0), ModelErrors(0.0, 0.01, inertia_error=0.0)])
def test_errors_are_counted_as_algorithm_1_counts_them(errors: ModelErrors):
    obj = drawn_object(0)
    trials = turns(obj, noise=0.02)
    problem = problem_of(obj, trials, errors=errors, use_weight=True)
    ours = TrialWindows.of(obj.shape, obj.total_mass, trials, errors)
    assert ours is not None
    guess = ours.first_guess()
    for _ in range(ROUNDS):
        loads = closed_form(ours.friction_system(guess))
        ours = ours.about_errors(guess, loads)
        guess = one_friction_masses(obj.shape, obj.total_mass, ours.groups.pairs, loads)
    covariance = ours.friction_equations(guess).covariance.flatten(0, 1).flatten(1)
    assert_allclose(covariance_of(problem), covariance, rtol=1e-6, atol=1e-12)
    assert Baseline.pivot_error == HiddenStates.pivot_error == ModelErrors.pivot_error


@pytest.mark.slow
def test_the_torque_of_an_accelerated_turn_is_as_wrong_as_its_moment_of_inertia():
    obj = drawn_object(0)
    with_, without = (
        problem_of(obj, everything(obj), errors=ModelErrors(inertia_error=part), use_weight=True) for part in (0.1, 0.0)
    )
    more = covariance_of(with_) - covariance_of(without)
    spread = torch.diagonal(more).reshape(-1, 6)
    windows = with_.windows
    inertia = inertia_map(obj.shape, windows.grasp.numpy()) @ obj.truth.mass
    expected = 2 * (0.1 * inertia * windows.acceleration[:, 2].numpy() * windows.accelerated.numpy()) ** 2
    assert_allclose(spread[:, 5], expected, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("grid", [1, 2, 3])
def test_affine_loads_are_the_loads_of_the_support_model(grid):
    obj = cut(grid)
    windows, model = windows_of(obj, everything(obj, **CARRIED)), ParticleModel.of(obj.shape)
    loads = AffineLoads.of(obj.shape, model, windows)
    masses = guesses(obj, 6)[0]
    for mass, found in zip(masses, loads.at(masses), strict=True):
        particle = model.particle_mass(mass)
        pressed = windows.gripper_load(model, particle, obj.shape.height)
        feet = own_weight(model, particle, pressed)
        assert_allclose(found, feet.loads(pressed), atol=1e-11)


@pytest.mark.parametrize("weighting", ["velocity", "covariance"])
def test_the_gradient_of_the_loss_is_that_of_finite_differences(weighting):
    obj = cut(2, 2)
    problem = problem_of(obj, everything(obj, **CARRIED))
    mass, friction = (x.requires_grad_() for x in guesses(obj, 3, seed=4))
    assert torch.autograd.gradcheck(lambda m, f: problem.loss(m, f, weighting), (mass, friction), eps=1e-7, rtol=1e-4)


def test_covariance_weighting_is_the_whitened_error():
    obj = drawn_object(0)
    problem = problem_of(obj, turns(obj, noise=0.05))
    mass, friction = guesses(obj, 1)
    error = (problem.sensed.read - problem.sensed.model.wrench(mass[0], friction[0])).flatten()
    covariance = covariance_of(problem)
    by_hand = error @ torch.linalg.solve(covariance, error) / len(error)
    assert_allclose(problem.loss(mass[0], friction[0], "covariance"), by_hand, rtol=1e-6)
    within = torch.stack([covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(len(problem.windows))])
    assert (torch.diagonal(within - problem.windows.noise, dim1=-2, dim2=-1) > 0).all()


def test_mass_is_known_by_weighing_or_by_an_acceleration_alone():
    obj = drawn_object(0)
    steady = problem_of(obj, turns(obj))
    assert not steady.scale_known
    assert problem_of(obj, turns(obj) + accelerated(obj, [0])).scale_known
    told = problem_of(obj, turns(obj), use_weight=True)
    assert told.scale_known
    assert_allclose(told.typical_mass(torch.ones(3)) * len(obj.shape.particles), obj.total_mass)
    # what the largest drag weighs at a friction; a turn beside the middle never feels the whole of it
    light = steady.typical_mass(torch.tensor(obj.truth.friction)) * len(obj.shape.particles)
    assert 0.3 * obj.total_mass < float(light[0]) <= obj.total_mass


@pytest.mark.parametrize(
    ("given", "status", "why"),
    [
        ([], "no_data", "no trajectory"),
        (accelerated(OBJECT), "no_data", "constant speed"),
        (
            [replace(t, wrench_on_object_world=0 * t.wrench_on_object_world) for t in everything(OBJECT)],
            "no_data",
            "dead",
        ),
        (turns(OBJECT)[:1], "underdetermined", "turn about more points"),
        ([replace(t, status="slipped", reason="it slipped") for t in turns(OBJECT)], "no_data", "status ok"),
    ],
)
def test_insufficient_data_has_its_status(given, status, why):
    answer = Problem.of(OBJECT.shape, None, given, use_weight=False, errors=ModelErrors(0.0))
    assert isinstance(answer, Estimate)
    assert (answer.status, answer.distribution) == (status, None) and why in answer.message


@pytest.mark.parametrize("weight", [None, 0.0, -1.0, float("nan"), float("inf")])
def test_no_weight_is_refused_where_it_is_used_and_not_missed_where_it_is_not(weight):
    given = OBJECT.shape, weight, turns(OBJECT)
    with pytest.raises(InvalidValueError, match=r"^weight: "):
        Problem.of(*given, use_weight=True, errors=ModelErrors(0.0))
    assert isinstance(Problem.of(*given, use_weight=False, errors=ModelErrors(0.0)), Problem)


def test_the_wrench_is_linear_in_mass_and_in_friction():
    obj = cut(2, 2)
    problem = problem_of(obj, everything(obj))
    (mass, other), (friction, another) = guesses(obj, 2)
    wrench = problem.wrenches.wrench
    zero = wrench(0 * mass, friction)
    assert_allclose(wrench(mass + other, friction) + zero, wrench(mass, friction) + wrench(other, friction), atol=1e-11)
    still = wrench(mass, 0 * friction)
    assert_allclose(
        wrench(mass, friction + another) + still, wrench(mass, friction) + wrench(mass, another), atol=1e-11
    )
