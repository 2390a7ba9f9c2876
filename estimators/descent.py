"""Gradient descent with several optimizers side by side, and its trace."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.base import Trace
from testbed.errors import InvalidValueError

OPTIMIZERS = ("adam", "rmsprop", "plain")
SHRINK, GROW = 0.5, 1.2
"""Factors on the step of plain descent after the loss rose, and after it fell."""
Loss = Callable[[Float[Tensor, "O n"]], Float[Tensor, "O"]]


@dataclass(frozen=True, eq=False)
class Run:
    """Descent of one optimizer."""

    best: Float[Tensor, "n"]
    """Point of lowest loss."""
    trace: Trace


def check_optimizers(owner: str, names: tuple[str, ...]) -> None:
    """Raise InvalidValueError unless there is at least one name, and all are known."""
    if not names or set(names) - set(OPTIMIZERS):
        raise InvalidValueError(f"{owner}.optimizers", names, f"some of {', '.join(OPTIMIZERS)}")


def descend(
    loss: Loss,
    start: Float[Tensor, "n"],
    rates: Mapping[str, float],
    steps: int,
    masses: Callable[[Tensor], Tensor] | None = None,
    robot_seconds: float = 0.0,
) -> list[Run]:
    """Descend from `start` with every optimizer of `rates`, all in one batch; the best run first.

    Args:
        loss: loss of each row of a batch of points.
        start: first point.
        rates: first step of each optimizer; it falls to zero as a square. Plain descent undoes a step that raised
            the loss and continues with half of it.
        steps: gradient evaluations of each optimizer.
        masses: particle masses of each point, for the trace.
        robot_seconds: robot time of the data [s], for the trace.
    """
    only = None if masses is None else lambda z: masses(z[:, 0])[:, None]
    return descend_all(lambda z: loss(z[0])[None], start[None], rates, steps, only, robot_seconds)[0]


def descend_all(
    loss: Callable[[Float[Tensor, "D O n"]], Float[Tensor, "D O"]],
    starts: Float[Tensor, "D n"],
    rates: Mapping[str, float],
    steps: int,
    masses: Callable[[Float[Tensor, "steps D O n"]], Float[Tensor, "steps D O n_m"]] | None = None,
    robot_seconds: float = 0.0,
) -> list[list[Run]]:
    """Descend on D losses at once, each as `descend` does; the runs of each, its best first.

    The wall time of a trace is a loss's share of the batch.
    """
    points = starts.numpy()[:, None].repeat(len(rates), 1)
    rules = [_RULES[name](points[:, lane], rate) for lane, (name, rate) in enumerate(rates.items())]
    best, lowest = points.copy(), np.full(points.shape[:2], np.inf)
    losses, seconds, history = [], [], []
    begin = time.perf_counter()
    for i in range(steps):
        batch = torch.tensor(points, requires_grad=True)
        found = loss(batch)
        slope = torch.autograd.grad(found.sum(), batch)[0].numpy()
        value = found.detach().numpy()
        better = value < lowest
        best, lowest = np.where(better[..., None], points, best), np.where(better, value, lowest)
        losses.append(value)
        history.append(batch.detach())
        for lane, rule in enumerate(rules):
            points[:, lane] = rule.step(points[:, lane], slope[:, lane], value[:, lane], (1 - i / steps) ** 2)
        seconds.append((time.perf_counter() - begin) / len(starts))
    mass = None if masses is None else masses(torch.stack(history)).numpy()
    values = np.array(losses)

    def run(draw: int, lane: int, name: str) -> Run:
        path = np.empty((0, 0)) if mass is None else mass[:, draw, lane]
        trace = Trace(name, tuple(values[:, draw, lane].tolist()), tuple(seconds), robot_seconds, path)
        return Run(torch.from_numpy(best[draw, lane]), trace)

    runs = [[run(draw, lane, name) for lane, name in enumerate(rates)] for draw in range(len(starts))]
    return [[of[lane] for lane in order] for of, order in zip(runs, lowest.argsort(1, kind="stable"), strict=True)]


class _Adam:
    """Adam of Kingma and Ba (2015) with a falling step; its constants are torch's."""

    def __init__(self, points: np.ndarray, rate: float):
        self._rate, self._steps = rate, 0
        self._mean, self._square = np.zeros_like(points), np.zeros_like(points)

    def step(self, points: np.ndarray, slope: np.ndarray, value: np.ndarray, part: float) -> np.ndarray:
        """The next points (D, n) after `slope` (D, n) and `value` (D,) at `points`, its step `part` of the first."""
        self._steps += 1
        self._mean += 0.1 * (slope - self._mean)
        self._square = 0.999 * self._square + 0.001 * slope * slope
        size = np.sqrt(self._square) / math.sqrt(1 - 0.999**self._steps) + 1e-8
        return points - self._rate * part / (1 - 0.9**self._steps) * self._mean / size


class _RmsProp:
    """RMSProp of Tieleman and Hinton (2012) with a falling step; its constants are torch's."""

    def __init__(self, points: np.ndarray, rate: float):
        self._rate, self._square = rate, np.zeros_like(points)

    def step(self, points: np.ndarray, slope: np.ndarray, value: np.ndarray, part: float) -> np.ndarray:
        """As in `_Adam`."""
        self._square = 0.99 * self._square + 0.01 * slope * slope
        return points - self._rate * part * slope / (np.sqrt(self._square) + 1e-8)


class _Plain:
    """Steps against the gradient; one that raised the loss is taken back and halved."""

    def __init__(self, points: np.ndarray, rate: float):
        self._rate, self._lowest = np.full((len(points), 1), rate), np.full((len(points), 1), np.inf)
        self._from, self._slope = points.copy(), np.zeros_like(points)

    def step(self, points: np.ndarray, slope: np.ndarray, value: np.ndarray, part: float) -> np.ndarray:
        """As in `_Adam`; its rate is its own."""
        fell = value[:, None] <= self._lowest
        self._lowest = np.where(fell, value[:, None], self._lowest)
        self._from, self._slope = np.where(fell, points, self._from), np.where(fell, slope, self._slope)
        self._rate = self._rate * np.where(fell, GROW, SHRINK)
        return self._from - self._rate * self._slope


_RULES = {"adam": _Adam, "rmsprop": _RmsProp, "plain": _Plain}
