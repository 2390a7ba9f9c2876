"""Gradient descent with several optimizers side by side, and its trace."""

from __future__ import annotations

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
        rates: first step of each optimizer; it falls to zero as a square. Plain descent takes back a step that raised
            the loss, halves it and goes on.
        steps: gradient evaluations of each optimizer.
        masses: particle masses of each point, for the trace.
        robot_seconds: robot time of the data [s], for the trace.
    """
    points = [start.clone().requires_grad_() for _ in rates]
    lanes = [_optimizer(name, point, rate) for (name, rate), point in zip(rates.items(), points, strict=True)]
    losses, seconds, history = [], [], []
    best, lowest = torch.stack([start] * len(points)), torch.full((len(points),), torch.inf, dtype=torch.float64)
    begin = time.perf_counter()
    for i in range(steps):
        batch = torch.stack(points)
        values = loss(batch)
        for point, gradient in zip(points, torch.autograd.grad(values.sum(), points), strict=True):
            point.grad = gradient
        with torch.no_grad():
            values = values.detach()
            better = values < lowest
            best = torch.where(better[:, None], batch, best)
            lowest = torch.where(better, values, lowest)
            for lane, value in zip(lanes, values.tolist(), strict=True):
                lane.step(value, (1 - i / steps) ** 2)
        losses.append(values.numpy())
        seconds.append(time.perf_counter() - begin)
        if masses is not None:
            history.append(masses(batch.detach()).numpy())
    runs = []
    for lane, name in enumerate(rates):
        mass = np.array(history)[:, lane] if history else np.empty((0, 0))
        trace = Trace(name, tuple(np.array(losses)[:, lane].tolist()), tuple(seconds), robot_seconds, mass)
        runs.append(Run(best[lane], trace))
    return [runs[lane] for lane in lowest.argsort().tolist()]


class _Adaptive:
    """Adam or RMSProp with a falling step."""

    def __init__(self, kind: type[torch.optim.Optimizer], point: Tensor, rate: float):
        self._optimizer, self._rate = kind([point], lr=rate), rate  # pyright: ignore[reportCallIssue]

    def step(self, value: float, part: float) -> None:
        self._optimizer.param_groups[0]["lr"] = self._rate * part
        self._optimizer.step()


class _Plain:
    """Steps against the gradient; one that raised the loss is taken back and halved."""

    def __init__(self, point: Tensor, rate: float):
        self._point, self._rate = point, rate
        self._lowest, self._from, self._slope = float("inf"), point.detach().clone(), torch.zeros_like(point)

    def step(self, value: float, part: float) -> None:
        del part
        if value <= self._lowest:
            assert self._point.grad is not None
            self._lowest, self._from, self._slope = value, self._point.clone(), self._point.grad.clone()
            self._rate *= GROW
        else:
            self._rate *= SHRINK
        self._point.copy_(self._from - self._rate * self._slope)


def _optimizer(name: str, point: Tensor, rate: float) -> _Adaptive | _Plain:
    if name == "plain":
        return _Plain(point, rate)
    return _Adaptive({"adam": torch.optim.Adam, "rmsprop": torch.optim.RMSprop}[name], point, rate)
