"""Diff-LCP, a baseline of the paper: descent through a differentiable engine with friction by complementarity."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.baselines.base import LCP_DIRECTIONS, LCP_SAMPLES, LCP_SUBSTEPS, Candidates, GradientBaseline, Searched
from estimators.baselines.lcp import LcpEngine
from estimators.baselines.problem import STEP, Problem
from estimators.particles.model import rotate, turned
from estimators.particles.windows import Observations
from estimators.particles.wrench import AffineLoads
from testbed.errors import InvalidValueError


@dataclass(frozen=True)
class DiffLcp(GradientBaseline):
    """Gradient descent in m and mu on the velocities that the LCP engine predicts (Song & Boularias 2020)."""

    directions: int = LCP_DIRECTIONS
    """Corners of the friction polygon."""
    substeps: int = LCP_SUBSTEPS
    """Steps of the engine in one of the record's; the wrench is interpolated linearly."""
    samples: int = LCP_SAMPLES
    """States along each turn at constant speed to predict from."""

    def __post_init__(self) -> None:
        super().__post_init__()
        LcpEngine(self.directions, self.substeps)
        if self.weighting != "velocity":
            raise InvalidValueError("DiffLcp.weighting", self.weighting, "velocity: the engine predicts velocities")
        if isinstance(self.samples, bool) or not (isinstance(self.samples, int) and self.samples >= 1):
            raise InvalidValueError("DiffLcp.samples", self.samples, "an integer >= 1")

    def _search(self, problem: Problem, seed: int) -> Searched:
        states = _States.of(problem, self.samples)
        engine, guesses = LcpEngine(self.directions, self.substeps), {}

        def loss(candidates: Candidates) -> Tensor:
            known = guesses.setdefault(len(candidates.mass), [])
            return states.loss(problem, engine, candidates, known)

        return self._descend(problem, seed, loss)


@dataclass(frozen=True, eq=False)
class _States:
    """N measured states to predict one step from, world axes, and what follows them."""

    windows: Observations
    """The window of each state."""
    loads: AffineLoads
    """Normal loads in each."""
    yaw: Float[Tensor, "N"]
    """rad."""
    share: Float[Tensor, "N"]
    """Part of the loss that falls to each state: that of the windows that it stands for."""

    @staticmethod
    def of(problem: Problem, samples: int) -> _States:
        """`samples` states spread over every turn at constant speed; one for speeding up and one for slowing down.

        In an accelerated turn friction keeps its direction, so that windows differ in momentum alone, in which a step
        is linear: those of one sign are merged. Where a turn is sampled moves on from window to window, so that all
        together see the polygon from every side.
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

    def loss(self, problem: Problem, engine: LcpEngine, guessed: Candidates, known: list[Tensor]) -> Tensor:
        """Mean over windows of |v_predicted - v_measured|^2 one step of the record on, one a candidate, (S,).

        Args:
            problem: what is searched.
            engine: the forward simulation.
            guessed: S candidates.
            known: sticking sets of the last call, replaced by this one's.
        """
        model, w = problem.model, self.windows
        inertia = problem.inertia(guessed.mass[:, None])
        friction = model.particle_friction(guessed.friction)[:, None] * self.loads.at(guessed.mass)
        arm = inertia.com - w.grasp
        spin = w.twist[:, 2:].expand(*arm.shape[:-1], 1)
        velocity = torch.cat([rotate(self.yaw, w.twist[:, :2] + spin * turned(arm)), spin], -1)
        change = torch.cat(
            [rotate(self.yaw, w.com_acceleration(inertia.com)), w.acceleration[:, 2:].expand_as(spin)], -1
        )
        pose = torch.cat([torch.zeros_like(arm), self.yaw[:, None].expand_as(spin)], -1)
        now, then = (
            torch.cat([rotate(yaw, w.wrench[:, :2]), w.wrench[:, 2:]], -1)
            for yaw in (self.yaw, self.yaw + w.twist[:, 2] * STEP)
        )
        _, after = engine.advance(model, inertia, friction, pose, velocity, (now, then), w.grasp, STEP, known)
        return (after - velocity - change * STEP).square().sum(-1) @ self.share
