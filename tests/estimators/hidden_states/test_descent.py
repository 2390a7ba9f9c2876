"""Descent with several optimisers side by side, on functions whose minimum is known."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from torch import Tensor

from estimators.descent import GROW, OPTIMIZERS, SHRINK, check_optimizers, descend
from testbed.errors import InvalidValueError

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


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_every_optimizer_finds_the_minimum_of_a_quadratic(name):
    (run,) = descend(bowl, START, {name: RATES[name]}, 500)
    assert run.trace.method == name
    assert_allclose(run.best, MINIMUM, atol=1e-4)
    assert min(run.trace.loss) == pytest.approx(LOWEST, abs=1e-7)
    assert float(bowl(run.best[None])[0]) == min(run.trace.loss)


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_side_by_side_each_does_as_it_does_alone(name):
    (alone,) = descend(bowl, START, {name: RATES[name]}, 60)
    together = next(run for run in descend(bowl, START, RATES, 60) if run.trace.method == name)
    assert together.trace.loss == alone.trace.loss
    assert torch.equal(together.best, alone.best)


@pytest.mark.parametrize("steps", [1, 2, 40])
def test_a_trace_has_one_entry_a_step_and_begins_at_the_start(steps):
    runs = descend(bowl, START, RATES, steps, masses=lambda x: x[:, :2].exp(), robot_seconds=12.5)
    assert {run.trace.method for run in runs} == set(OPTIMIZERS)
    for run in runs:
        assert len(run.trace.loss) == len(run.trace.seconds) == steps
        assert run.trace.mass.shape == (steps, 2)
        assert_allclose(run.trace.mass[0], 1.0)
        assert run.trace.loss[0] == float(bowl(START[None])[0])
        assert (np.diff(run.trace.seconds) > 0).all()
        assert run.trace.robot_seconds == 12.5


def test_masses_of_the_trace_belong_to_its_losses():
    runs = descend(bowl, START, RATES, 30, masses=lambda x: x)
    for run in runs:
        assert_allclose(bowl(torch.tensor(run.trace.mass)), run.trace.loss)
        assert_allclose(run.trace.mass[int(np.argmin(run.trace.loss))], run.best)


def test_without_masses_the_trace_has_none():
    assert descend(bowl, START, RATES, 3)[0].trace.mass.shape == (0, 0)


def test_the_best_run_comes_first():
    for rates in ({"plain": 1e-6, "adam": 0.1}, {"adam": 1e-6, "plain": 0.1}, {"rmsprop": 0.1, "adam": 0.0001}):
        lowest = [min(run.trace.loss) for run in descend(bowl, START, rates, 50)]
        assert lowest == sorted(lowest)
        assert lowest[0] < lowest[1]


def test_the_start_is_left_as_it_was():
    start = START.clone()
    descend(bowl, start, RATES, 5)
    assert torch.equal(start, START)
    assert not start.requires_grad


@pytest.mark.parametrize("rate", [1e-6, 1.0, 1e3, 1e9])
@pytest.mark.parametrize(("loss", "start"), [(bowl, START), (valley, torch.tensor([-1.2, 1.0], dtype=torch.float64))])
def test_plain_descent_never_diverges_whatever_its_first_rate(loss, start, rate):
    (run,) = descend(loss, start, {"plain": rate}, 400)
    losses = np.array(run.trace.loss)
    assert np.isfinite(losses).all()
    assert losses.min() < losses[0]
    # only the tens of steps that bring a wild rate back may lie above the start
    assert np.median(losses) <= losses[0]


def test_plain_descent_takes_back_a_step_that_raised_the_loss():
    (run,) = descend(bowl, START, {"plain": 10.0}, 60, masses=lambda x: x)
    losses, points = np.array(run.trace.loss), run.trace.mass
    slope = 2 * CURVES.numpy() * (START - MINIMUM).numpy()
    rate = 10.0 * GROW
    for k in range(1, 4):  # each time from the start again, by half the step
        assert losses[k] > losses[0]
        assert_allclose(points[k], -rate * slope)
        rate *= SHRINK
    assert losses[-1] < losses[0]


def test_plain_descent_grows_a_step_that_is_too_small():
    (run,) = descend(bowl, START, {"plain": 1e-4}, 200)
    assert min(run.trace.loss) == pytest.approx(LOWEST, abs=1e-3)


def test_a_first_guess_at_the_minimum_stays_there():
    for run in descend(bowl, MINIMUM, RATES, 20):
        assert_allclose(run.best, MINIMUM, atol=1e-12)


def test_unknown_optimizers_are_refused_by_name():
    for names in ((), ("newton",), ("adam", "newton")):
        with pytest.raises(InvalidValueError, match=r"Owner\.optimizers: .*adam, rmsprop, plain"):
            check_optimizers("Owner", names)
    check_optimizers("Owner", OPTIMIZERS)
