"""Training of the network on examples, and its loss on held-out objects."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable
from dataclasses import asdict

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.learned.checkpoint import FALSE_ALARM, LEAST_FREEDOM, Checkpoint, Origin
from estimators.learned.examples import Examples, fixed_axes
from estimators.learned.network import Network, Sizes, departures
from estimators.learned.question import MISFIT, MISFIT_OF_INERTIA, SUMMARY, TURNS
from estimators.particles.misfit import UNEXPLAINED

BATCH = 64
"""Examples of a step."""
RATE, DECAY = 2e-3, 1e-2
"""Largest step of AdamW, and its weight decay."""
HELD_OUT = 10
"""Number of objects of which one is held out."""


def train(
    examples: Examples,
    held_out: Examples,
    origin: Origin,
    epochs: int,
    progress: Callable[[str, int, int], object] = lambda stage, done, total: None,
    seconds: float = 0.0,
) -> Checkpoint:
    """Network of the epoch with the least loss on the held-out examples.

    Args:
        examples: examples to train on, in random axes in each epoch.
        held_out: examples of other objects.
        origin: origin of the examples; its seed draws weights and batches.
        epochs: passes through the examples.
        progress: called after each epoch with stage, epochs done and epochs in all.
        seconds: CPU time that the examples took, s.
    """
    begin = time.process_time()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(origin.seed)
        network = Network(Sizes(examples.edges.shape[-1], examples.group.shape[-1], examples.summary.shape[-1]))
        network.standardize(examples)
        steps = -(-len(examples) // BATCH)
        optimizer = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=DECAY)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=max(epochs * steps, 2))
        best, state = float("inf"), network.state_dict()
        for epoch in range(epochs):
            network.train()
            for part in torch.randperm(len(examples)).chunk(steps):
                optimizer.zero_grad()
                loss(network, in_drawn_axes(examples[part])).backward()
                torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
                optimizer.step()
                schedule.step()
            network.eval()
            with torch.no_grad():
                value = float(loss(network, held_out.turned(*fixed_axes(len(held_out)))))
            if value < best:
                best, state = value, copy.deepcopy(network.state_dict())
            progress("epochs", epoch + 1, epochs)
    low, high = examples.summary.min(0).values, examples.summary.max(0).values
    spent = seconds + time.process_time() - begin
    return Checkpoint(
        origin, asdict(network.sizes), state, low, high, limits_of(examples), best, first_loss(held_out), spent
    )


def loss(network: Network, examples: Examples) -> Float[Tensor, ""]:
    """Negative log density of the logarithm of a group's load, nats: mean over all groups."""
    root = torch.linalg.cholesky(examples.covariance).diagonal(dim1=1, dim2=2).log()
    density = network.log_prob(examples) - (root * examples.groups).sum(1)
    return -density.sum() / examples.groups.sum()


def limits_of(examples: Examples) -> dict[str, float]:
    """`Checkpoint.limits` by examples with enough rows; at least 1, and `UNEXPLAINED` where there are none."""
    freedom = 3 * examples.windows.sum(1) - examples.groups.sum(1)
    counted = {MISFIT: freedom >= LEAST_FREEDOM, MISFIT_OF_INERTIA: examples.summary[:, SUMMARY.index(TURNS)] > 0}
    found = {name: examples.summary[rows, SUMMARY.index(name)].exp() for name, rows in counted.items()}
    return {
        name: max(float(values.quantile(1 - FALSE_ALARM)), 1.0) if len(values) else UNEXPLAINED
        for name, values in found.items()
    }


def in_drawn_axes(examples: Examples) -> Examples:
    """The examples, each in axes turned and mirrored at random."""
    count = len(examples)
    return examples.turned(2 * torch.pi * torch.rand(count, dtype=torch.float64), torch.rand(count) < 0.5)


def first_loss(examples: Examples) -> float:
    """`loss` of the first answer itself, a normal distribution with its errors."""
    root = torch.linalg.cholesky(examples.covariance).diagonal(dim1=1, dim2=2).log()
    square = departures(examples).square() / 2 + math.log(2 * math.pi) / 2 + root
    return float((square * examples.groups).sum() / examples.groups.sum())
