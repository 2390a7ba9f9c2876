"""Diff-LCP, a baseline of the paper: descent through a differentiable engine with friction by complementarity."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.baselines.base import Candidates, GradientBaseline
from estimators.baselines.lcp import LcpEngine
from estimators.baselines.problem import STEP, Problem
from estimators.particles.model import ParticleModel, inertia_of, rotate, turned
from estimators.particles.windows import Observations
from estimators.particles.wrench import AffineLoads
from testbed.errors import InvalidValueError
from testbed.validation import check_integer


@dataclass(frozen=True)
class DiffLcp(GradientBaseline):
    """Gradient descent in m and mu on the velocities that the LCP engine predicts (Song & Boularias 2020)."""

    directions: int = 8
    """Corners of the friction polygon. Ours."""
    substeps: int = 2
    """Engine steps per sample of the record. Paper: smaller than the record's, wrench interpolated linearly."""
    samples: int = 1
    """States along each turn at constant speed to predict from; a polygon acts differently in each. Ours."""

    def __post_init__(self) -> None:
        super().__post_init__()
        LcpEngine(self.directions, self.substeps)
        if self.weighting != "velocity":
            raise InvalidValueError("DiffLcp.weighting", self.weighting, "velocity: the engine predicts velocities")
        check_integer("DiffLcp.samples", self.samples)

    def _loss(self, problems: Sequence[Problem]) -> Callable[[Candidates], Tensor]:
        states = _States.stacked([_States.of(problem, self.samples) for problem in problems])
        engine, guesses = LcpEngine(self.directions, self.substeps), {}

        def loss(candidates: Candidates) -> Tensor:
            return states.loss(problems[0].model, engine, candidates, guesses.setdefault(candidates.mass.shape, []))

        return loss


@dataclass(frozen=True, eq=False)
class _States:
    """N measured states to predict one step from, world axes."""

    windows: Observations
    """The window of each state."""
    loads: AffineLoads
    """Normal loads in each state."""
    yaw: Float[Tensor, "N"]
    """Yaw of the object [rad]."""
    share: Float[Tensor, "N"]
    """Weight of each state in the loss: the part of the windows that it represents."""

    @staticmethod
    def of(problem: Problem, samples: int) -> _States:
        """`samples` states spread over every turn at constant speed; one for each sign of acceleration.

        In an accelerated turn friction keeps its direction, so windows differ in momentum alone, in which a step is
        linear: those of one sign are merged. The sampled places shift from window to window, so that together they
        meet the polygon at every angle.
        """
        golden = 0.6180339887498949
        alike: dict[tuple[int, ...], int] = {}
        group, index, part = [], [], []
        for k, accelerated in enumerate(problem.windows.accelerated.tolist()):
            sign = int(torch.sign(problem.windows.acceleration[k, 2]))
            name = (int(problem.windows.trial[k]), sign) if accelerated else (-1, k)
            if name not in alike:
                alike[name] = len(alike)
                count = 1 if accelerated else samples
                index += [alike[name]] * count
                part += [(i + (golden * len(alike)) % 1) / count for i in range(count)]
            group.append(alike[name])
        of_window, of_state = torch.tensor(group), torch.tensor(index)
        windows = problem.windows.merged(of_window).where(of_state)
        size = torch.bincount(of_window).double() / len(group) / torch.bincount(of_state)
        first, last = windows.yaw.unbind(-1)
        yaw = first + torch.tensor(part, dtype=torch.float64) * (last - first)
        return _States(windows, AffineLoads.of(problem.shape, problem.model, windows), yaw, size[of_state])

    @staticmethod
    def stacked(draws: Sequence[_States]) -> _States:
        """States of D draws, equal in number, for candidates (D, S, ...)."""
        return _States(
            Observations.stacked([draw.windows for draw in draws]),
            AffineLoads.stacked([draw.loads for draw in draws]),
            torch.stack([draw.yaw for draw in draws])[:, None],
            torch.stack([draw.share for draw in draws])[:, None],
        )

    def loss(self, model: ParticleModel, engine: LcpEngine, guessed: Candidates, known: list[Tensor]) -> Tensor:
        """Mean over windows of |v_predicted - v_measured|^2 after one step of the record, shape (D, S).

        `known` holds the sticking sets of the last call and receives this call's.
        """
        w = self.windows
        inertia = inertia_of(model, model.particle_mass(guessed.mass[..., None, :]))
        friction = model.particle_friction(guessed.friction)[..., None, :] * self.loads.at(guessed.mass)
        arm = inertia.com - w.grasp
        spin = w.twist[..., 2:].expand(*arm.shape[:-1], 1)
        velocity = torch.cat([rotate(self.yaw, w.twist[..., :2] + spin * turned(arm)), spin], -1)
        change = torch.cat(
            [rotate(self.yaw, w.com_acceleration(inertia.com)), w.acceleration[..., 2:].expand_as(spin)], -1
        )
        pose = torch.cat([torch.zeros_like(arm), self.yaw[..., None].expand_as(spin)], -1)
        now, then = (
            torch.cat([rotate(yaw, w.wrench[..., :2]), w.wrench[..., 2:]], -1)
            for yaw in (self.yaw, self.yaw + w.twist[..., 2] * STEP)
        )
        _, after = engine.advance(model, inertia, friction, pose, velocity, (now, then), w.grasp, STEP, known)
        return (after - velocity - change * STEP).square().sum(-1).mul(self.share).sum(-1)
