"""Diff-LCP, a baseline of the paper: descent through a differentiable engine with friction by complementarity."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.baselines.base import Candidates, GradientBaseline
from estimators.baselines.lcp import LcpEngine
from estimators.baselines.problem import STEP, Problem
from estimators.particles.windows import Observations
from estimators.particles.wrench import AffineLoads
from estimators.wrench.model import ParticleModel, inertia_of, rotate, turned
from testbed.errors import InvalidValueError
from testbed.validation import check_integer


@dataclass(frozen=True)
class DiffLcp(GradientBaseline):
    """Gradient descent in m and mu on the velocities that the LCP engine predicts (Song & Boularias 2020)."""

    takes_links: ClassVar[bool] = False
    """It moves the object in one piece."""

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

    loads: AffineLoads
    """Normal loads in each state."""
    yaw: Float[Tensor, "N"]
    """Yaw of the object [rad]."""
    grasp: Float[Tensor, "N 2"]
    """Grasp point [m], object frame."""
    wrench: Float[Tensor, "2 N 3"]
    """Wrench at the beginning and at the end of the step."""
    velocity: Float[Tensor, "3 N 3"]
    """Velocity of the center of mass: of the frame's origin, and what each coordinate of the center adds to it a m."""
    after: Float[Tensor, "3 N 3"]
    """The same, one step of the record later."""
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
        places = torch.cat([torch.zeros(1, 2, dtype=torch.float64), torch.eye(2, dtype=torch.float64)])
        velocity, after = torch.stack([_motion(windows, yaw, com) for com in places], 1)
        for affine in (velocity, after):
            affine[1:] -= affine[0].clone()
        wrench = torch.stack([_in_world(windows.wrench, yaw + t * windows.twist[:, 2]) for t in (0.0, STEP)])
        loads = AffineLoads.of(problem.shape, problem.model, windows)
        return _States(loads, yaw, windows.grasp, wrench, velocity, after, size[of_state])

    @staticmethod
    def stacked(draws: Sequence[_States]) -> _States:
        """States of D draws, equal in number, for candidates (D, S, ...)."""
        loads = AffineLoads.stacked([draw.loads for draw in draws])
        yaw, grasp, share = (torch.stack([getattr(d, n) for d in draws])[:, None] for n in ("yaw", "grasp", "share"))
        wrench, velocity, after = (
            torch.stack([getattr(d, n) for d in draws], 1)[:, :, None] for n in ("wrench", "velocity", "after")
        )
        return _States(loads, yaw, grasp, wrench, velocity, after, share)

    def loss(self, model: ParticleModel, engine: LcpEngine, guessed: Candidates, known: list[Tensor]) -> Tensor:
        """Mean over windows of |v_predicted - v_measured|^2 after one step of the record, shape (D, S).

        `known` holds the sticking sets of the last call and receives this call's.
        """
        inertia = inertia_of(model, model.particle_mass(guessed.mass[..., None, :]))
        friction = model.particle_friction(guessed.friction)[..., None, :] * self.loads.at(guessed.mass)
        x, y = inertia.com[..., :1], inertia.com[..., 1:]
        velocity, after = (origin + x * along + y * across for origin, along, across in (self.velocity, self.after))
        pose = torch.cat([torch.zeros_like(self.grasp), self.yaw[..., None]], -1)
        wrench = (self.wrench[0], self.wrench[1])
        _, found = engine.advance(model, inertia, friction, pose, velocity, wrench, self.grasp, STEP, known)
        return (found - after).square().sum(-1).mul(self.share).sum(-1)


def _motion(windows: Observations, yaw: Float[Tensor, "N"], com: Float[Tensor, "2"]) -> Float[Tensor, "2 N 3"]:
    """Measured velocity of a center of mass, world axes, now and one step of the record later."""
    spin = windows.twist[:, 2:]
    planar = windows.twist[:, :2] + spin * turned(com - windows.grasp)
    now = _in_world(torch.cat([planar, spin], -1), yaw)
    arm, a = com - windows.grasp, windows.acceleration
    pulled = a[:, :2] + a[:, 2:] * turned(arm) - windows.spin_square[:, None] * arm
    change = _in_world(torch.cat([pulled, a[:, 2:]], -1), yaw)
    return torch.stack([now, now + change * STEP])


def _in_world(planar: Float[Tensor, "N 3"], yaw: Float[Tensor, "N"]) -> Float[Tensor, "N 3"]:
    """A planar velocity, acceleration or wrench in world axes."""
    return torch.cat([rotate(yaw, planar[:, :2]), planar[:, 2:]], -1)
