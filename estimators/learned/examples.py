"""Examples to learn from: questions with the truth, of objects and trials drawn in the analytic lab."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import pad

from estimators.learned.question import VECTORS, Question, ask
from estimators.testing.analytic_lab import LAB, Draw, contacts, drawn, flawed_trial
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import TableAction
from testbed.actions.rotate import Rotate
from testbed.objects.model import ObjectModel

CONTACTS = ("grid", "random", "corners", "rim", "dense")
"""Contact patterns drawn; `ring` and `pressed` are left out, for a test beyond them."""
BLOCKS = (2, 8)
"""Fewest and most blocks of an object."""
TRIALS = 14
"""Most trials of an example."""
SUBSETS = 3
"""Examples of an object, each of other trials."""
NEAR = 0.5
"""Part of the objects whose turns are all about points beside their grasps, as in fixed sets of trials."""
SPEEDS, SECONDS = (np.radians(5), np.radians(15)), (3.0, 9.0)
"""Turn rates, rad/s, and times at constant speed, s."""
RATES = 25.0, 50.0
"""Sampling rates of turns at constant speed and of accelerated ones, Hz: below the usual, to save time."""


@dataclass(frozen=True, eq=False)
class Examples:
    """N questions, padded to G groups and W windows. Absent groups have zeros, and a variance of 1."""

    center: Float[Tensor, "N G 2"]
    mean: Float[Tensor, "N G"]
    covariance: Float[Tensor, "N G G"]
    group: Float[Tensor, "N G f"]
    edges: Float[Tensor, "N W G e"]
    summary: Float[Tensor, "N n"]
    groups: Bool[Tensor, "N G"]
    """True for the groups of the object."""
    windows: Bool[Tensor, "N W"]
    """True for the windows of the trials."""
    truth: Float[Tensor, "N G"]
    """Logarithm of each group's friction load over the object's weight; zeros where it is not known."""

    @staticmethod
    def of(questions: Sequence[Question], truths: Sequence[Float[Tensor, "G"]] = ()) -> Examples:
        """Questions, with their truths if those are known."""
        known = truths or [torch.zeros_like(question.first.mean) for question in questions]
        return Examples.joined([_single(*each) for each in zip(questions, known, strict=True)])

    def __len__(self) -> int:
        return len(self.mean)

    def __getitem__(self, index: Tensor | slice) -> Examples:
        return Examples(*(values[index] for values in vars(self).values()))

    @staticmethod
    def joined(parts: Sequence[Examples]) -> Examples:
        """Examples of several parts together."""
        most = max(p.mean.shape[1] for p in parts), max(p.windows.shape[1] for p in parts)
        wide = [vars(p._padded(*most)) for p in parts]
        return Examples(*(torch.cat([values[name] for values in wide]) for name in wide[0]))

    def turned(self, angle: Float[Tensor, "N"], mirrored: Bool[Tensor, "N"]) -> Examples:
        """The examples in axes turned by `angle`, rad, and mirrored; groups in their `order`."""
        sign, order = torch.where(mirrored, -1.0, 1.0).double(), self.order(angle)
        c, s = angle.cos(), angle.sin()
        axes = torch.stack([torch.stack([c, s], -1), torch.stack([-s * sign, c * sign], -1)], 1)  # (N, 2, 2)
        center = torch.einsum("nij,ngj->ngi", axes, self.center)
        vectors = self.edges[..., : 2 * VECTORS].unflatten(-1, (VECTORS, 2))
        vectors = torch.einsum("nij,nwgvj->nwgvi", axes, vectors).flatten(-2)
        torques = self.edges[..., 2 * VECTORS : 3 * VECTORS - 1] * sign[:, None, None, None]
        edges = torch.cat([vectors, torques, self.edges[..., 3 * VECTORS - 1 :]], -1)
        row = torch.arange(len(self))[:, None]
        return replace(
            self,
            center=center[row, order],
            mean=self.mean[row, order],
            covariance=self.covariance[row[..., None], order[:, :, None], order[:, None]],
            group=self.group[row, order],
            edges=edges.transpose(1, 2)[row, order].transpose(1, 2),
            truth=self.truth[row, order],
        )

    def order(self, angle: Float[Tensor, "N"]) -> Int[Tensor, "N G"]:
        """Groups in the order of their places along a direction [rad], which does not depend on their names."""
        along = self.center[..., 0] * angle.cos()[:, None] + self.center[..., 1] * angle.sin()[:, None]
        return along.masked_fill(~self.groups, torch.inf).argsort(1)

    def _padded(self, groups: int, windows: int) -> Examples:
        g, w = groups - self.mean.shape[1], windows - self.windows.shape[1]
        covariance = pad(self.covariance, (0, g, 0, g))
        covariance = covariance + torch.diag(pad(torch.zeros(groups - g), (0, g), value=1.0)).double()
        return Examples(
            pad(self.center, (0, 0, 0, g)),
            pad(self.mean, (0, g)),
            covariance,
            pad(self.group, (0, 0, 0, g)),
            pad(self.edges, (0, 0, 0, g, 0, w)),
            self.summary,
            pad(self.groups, (0, g)),
            pad(self.windows, (0, w)),
            pad(self.truth, (0, g)),
        )


def _single(question: Question, truth: Float[Tensor, "G"]) -> Examples:
    """Example of one question with its truth."""
    first, there = question.first, [torch.ones(n, dtype=torch.bool) for n in question.edges.shape[1::-1]]
    values = question.center, first.mean, first.covariance, question.group, question.edges, question.summary
    return Examples(*(each[None] for each in (*values, *there, truth)))


def fixed_axes(count: int) -> tuple[Float[Tensor, "N"], Bool[Tensor, "N"]]:
    """Angles at equal distances [rad], every second one mirrored."""
    return 2 * torch.pi * (torch.arange(count, dtype=torch.float64) + 0.5) / count, torch.arange(count) % 2 == 1


def make_examples(seed: int, objects: Sequence[int]) -> Examples:
    """Examples of some objects, by their numbers, in worlds drawn by the seed."""
    found = [pair for index in objects for pair in _of_object(seed, index)]
    return Examples.of([question for question, _ in found], [truth for _, truth in found])


def _of_object(seed: int, index: int) -> list[tuple[Question, Tensor]]:
    """Questions of one object in one drawn world, each of a part of its trials, and the truth."""
    rng = np.random.default_rng([seed, index, 1])
    pattern = str(rng.choice(CONTACTS))
    obj = drawn(index, seed, pattern, BLOCKS, least_grasps=1)
    sizes = [1 + int(TRIALS * rng.uniform() ** 0.7) for _ in range(SUBSETS)]
    feet, draw = contacts(obj, pattern, LAB, rng), Draw.of(LAB, rng)
    near = rng.uniform() < NEAR
    actions = [_action(obj, rng, near=near) for _ in range(max(sizes))]
    rates = [RATES[action.accelerated] for action in actions]
    made = [flawed_trial(obj, a, feet, draw, rng, rate) for a, rate in zip(actions, rates, strict=True)]
    made = [replace(trial, setup=LAB) for trial in made]
    truth = torch.tensor(np.log(obj.truth.friction[0] * obj.group_mass / obj.total_mass))
    found = []
    for size in sizes:
        part = [made[i] for i in rng.permutation(len(made))[:size]]
        weight = obj.total_mass + (0.001 + LAB.scale) * rng.standard_normal()
        question = ask(obj.shape, weight, part)
        if not isinstance(question, str):
            found.append((question, truth + float(np.log(obj.total_mass / weight))))
    return found


def _action(obj: ObjectModel, rng: np.random.Generator, *, near: bool) -> TableAction:
    """Accelerated turn, or turn there and back about a point beside the grasp or, unless `near`, any point."""
    grasp = int(rng.integers(len(obj.shape.grasps)))
    if rng.uniform() < 0.4:
        return Accelerate(grasp)
    at = obj.shape.grasps[grasp].position
    beside = obj.shape.cell * rng.choice([-0.5, 0.5], 2)
    reach = np.ptp(obj.shape.particles, axis=0) / 2
    pivot = at + (beside if near or rng.uniform() < 0.5 else reach * rng.uniform(-1, 1, 2))
    speed = rng.choice([-1, 1]) * rng.uniform(*SPEEDS)
    return Rotate(grasp, speed=speed, duration=rng.uniform(*SECONDS), pivot=tuple(pivot), back=True)
