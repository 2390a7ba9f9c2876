"""Descent with several optimizers side by side, on functions whose minimum is known."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from torch import Tensor

from estimators.descent import GROW, OPTIMIZERS, SHRINK, check_optimizers, descend, descend_all
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
