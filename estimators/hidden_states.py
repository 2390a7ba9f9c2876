"""Algorithm 1: the paper's multi-stage estimate through the hidden states."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import torch

from estimators.descent import OPTIMIZERS, check_optimizers
from estimators.dynamics import ParticleModel, direction, friction_wrench, inertia_of
from estimators.evidence import Evidence
from estimators.friction_loads import (
    LinearSystem,
    LoadGroups,
    closed_form,
    closed_form_covariance,
    contradiction,
    descend_loads,
    friction_system,
    rank_of,
)
from estimators.identifiability import Identifiability, identifiability
from estimators.inertia import PivotInertia, com_and_inertia, pivot_inertias
from estimators.mass_solve import MassSolution, evenly_rough, fixed_rows, load_jacobian, solve_masses
from estimators.observations import Observations, observe, robot_seconds
from estimators.protocol import Estimate, HiddenStates, Trace
from estimators.support import own_weight
from testbed.arrays import check_positive, is_number
from testbed.errors import InvalidValueError
from testbed.objects import GRAVITY, MassDistribution, ObjectShape
from testbed.trajectory import Trajectory

Solver = Literal["closed_form", "descent"]


@dataclass(frozen=True)
class HiddenStatesEstimator:
    """Multi-stage Hidden States estimation, Algorithm 1. Assumes that every mass group rests on its own weight."""

    solver: Solver = "closed_form"
    """Where s comes from: the exact minimum of Eq. problem_si, or `steps` of gradient descent on it."""
    steps: int = 500
    """Gradient steps of each optimiser; 500 in the paper."""
    optimizers: tuple[str, ...] = OPTIMIZERS
    """Optimisers to descend with; the one with the lowest loss is taken."""
    refinements: int = 3
    """Rounds of solving with what the gripper carries worked out from the round before."""
    pivot_error: float = 8e-5
    """How well the centre of a turn is known, m."""
    force_error: float = 0.0005
    """Model error of a force, as a part of the total drag."""
    torque_error: float = 0.0006
    """Model error of a torque, as a part of itself."""
    height_error: float = 0.0009
    """How well the TCP's height over the feet is known, m."""
    lift_error: float = 0.06
    """Vertical force of a nulled gripper that the sensor cannot tell, N."""
    inertia_error: float = 0.007
    """Model error of I_j, as a part of itself: once of each, and once of all together."""
    weight_error: float = 1e-3
    """Error of the weighing, kg."""

    def __post_init__(self) -> None:
        check_optimizers("HiddenStatesEstimator", self.optimizers)
        if self.solver not in get_args(Solver):
            raise InvalidValueError(
                "HiddenStatesEstimator.solver", self.solver, f"one of {', '.join(get_args(Solver))}"
            )
        for name in ("steps", "refinements"):
            value = getattr(self, name)
            if isinstance(value, bool) or not (isinstance(value, int) and value >= 1):
                raise InvalidValueError(f"HiddenStatesEstimator.{name}", value, "an integer >= 1")
        for name in ("pivot_error", "force_error", "torque_error", "height_error", "lift_error", "inertia_error"):
            value = getattr(self, name)
            if not (is_number(value) and value >= 0):
                raise InvalidValueError(f"HiddenStatesEstimator.{name}", value, "a finite number >= 0")
        check_positive("HiddenStatesEstimator.weight_error", self.weight_error)

    def estimate(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Estimate from turns, slides and accelerated turns. Draws nothing: `seed` changes nothing.

        Raises:
            InvalidValueError: no weight, which Algorithm 1 needs.
        """
        begin = time.perf_counter()
        if weight is None or not (np.isfinite(weight) and weight > 0):
            raise InvalidValueError("weight", weight, "M as weighed, a finite number > 0, kg")
        observed = observe(shape, trajectories)
        if observed is None or bool(observed.accelerated.all()):
            why = "no trajectory with status ok that slides or turns at constant speed"
            return Estimate(None, "no_data", why, seconds=time.perf_counter() - begin)
        problem = _Problem.of(shape, weight, observed, robot_seconds(trajectories))
        mass, friction = problem.first_guess()
        answer: _Round | None = None
        for _ in range(self.refinements):
            system = self._system(problem, mass, friction)
            rank, unknowns = rank_of(system.q.numpy()), len(problem.groups.pairs)
            if rank < unknowns:
                why = f"rank(Q) is {rank} and {unknowns} friction loads are unknown: turn about more points"
                guess = MassDistribution(mass.numpy(), friction.numpy())
                loads = load_jacobian(problem.shape, problem.groups.pairs, guess)[:, : len(mass)] @ guess.mass
                report = self._report(problem, system, self._pivots(problem, loads, mass, friction), guess)
                return Estimate(
                    None, "underdetermined", why, identifiability=report, seconds=time.perf_counter() - begin
                )
            answer = self._round(problem, system, mass, friction)
            found = answer.solution.distribution
            mass, friction = torch.tensor(found.mass), torch.tensor(found.friction)
        assert answer is not None
        if why := contradiction(float(answer.system.loss(torch.tensor(answer.loads)))):
            return Estimate(None, "contradictory", why, seconds=time.perf_counter() - begin)
        return self._answer(problem, answer, begin)

    def evidence(
        self, shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory], at: MassDistribution
    ) -> Evidence:
        """What the trials say, with what the gripper carries worked out at an answer: for a posterior.

        Raises:
            InvalidValueError: no trajectory at constant speed.
        """
        observed = observe(shape, trajectories)
        if observed is None or bool(observed.accelerated.all()):
            raise InvalidValueError(
                "trajectories", len(trajectories), "one or more that slide or turn at constant speed"
            )
        problem = _Problem.of(shape, weight, observed, robot_seconds(trajectories))
        mass, friction = torch.tensor(at.mass), torch.tensor(at.friction)
        system, pairs = self._system(problem, mass, friction), problem.groups.pairs
        loads = load_jacobian(shape, pairs, at)[:, : shape.n_m] @ at.mass
        pivots = self._pivots(problem, loads, mass, friction)
        fixed, values = fixed_rows(shape, weight, self.weight_error, pivots, shape.n_m)
        return Evidence(shape, pairs, system.q.numpy(), system.b.numpy(), fixed, values)

    def _system(self, problem: _Problem, mass: torch.Tensor, friction: torch.Tensor) -> LinearSystem:
        """Q s = b, with what the gripper carries worked out from a guess of mass and friction."""
        model = problem.model
        particle_mass = model.particle_mass(mass)
        return friction_system(
            model,
            problem.groups,
            problem.steady,
            particle_mass,
            model.particle_friction(friction),
            inertia_of(model, particle_mass),
            problem.shape.height,
            pivot_error=self.pivot_error,
            force_error=self.force_error,
            torque_error=self.torque_error,
            height_error=self.height_error,
            lift_error=self.lift_error,
        )

    def _round(self, problem: _Problem, system: LinearSystem, mass: torch.Tensor, friction: torch.Tensor) -> _Round:
        """s, I_j, and mass and friction from them."""
        loads = closed_form(system)
        traces: tuple[Trace, ...] = ()
        if self.solver == "descent":
            loads, traces = descend_loads(system, self.optimizers, self.steps, problem.robot_seconds)
        pivots = self._pivots(problem, loads, mass, friction)
        solution = solve_masses(
            problem.shape,
            problem.weight,
            self.weight_error,
            problem.groups.pairs,
            loads,
            closed_form_covariance(system),
            pivots,
        )
        return _Round(system, loads, traces, pivots, solution)

    def _pivots(
        self, problem: _Problem, loads: np.ndarray, mass: torch.Tensor, friction: torch.Tensor
    ) -> PivotInertia | None:
        """I_j, with the change of friction that the gripper's changing load brings taken away."""
        windows, model, groups = problem.accelerated, problem.model, problem.groups
        if len(windows) == 0:
            return None
        particle_mass = model.particle_mass(mass)
        inertia = inertia_of(model, particle_mass)
        load = windows.gripper_load(inertia, problem.shape.height)
        support = own_weight(model.particles, model.mass_group, model.contact, particle_mass, load)
        own = torch.where(groups.index >= 0, torch.tensor(loads)[groups.index.clamp(min=0)], 0.0)
        drag = own + model.particle_friction(friction) * (support.lean + support.change(load))
        unit = direction(windows.particle_velocity(model))
        felt = -friction_wrench(drag, unit, windows.lever(model))[:, 2]
        moved = windows.inertial_wrench(inertia)[:, 2]
        return pivot_inertias(windows, felt.numpy(), moved.numpy(), self.inertia_error)

    def _report(
        self, problem: _Problem, system: LinearSystem, pivots: PivotInertia | None, at: MassDistribution
    ) -> Identifiability:
        """What Q, the weight and I_j show of masses and frictions."""
        shape = problem.shape
        fixed, _ = fixed_rows(shape, problem.weight, self.weight_error, pivots, shape.n_m + shape.n_mu)
        of_loads = system.q.numpy() @ load_jacobian(shape, problem.groups.pairs, at)
        return identifiability(shape, at, np.vstack([of_loads, fixed]))

    def _answer(self, problem: _Problem, last: _Round, begin: float) -> Estimate:
        found, shape = last.solution.distribution, problem.shape
        if (
            last.solution.rank < last.solution.unknowns
        ):  # then the answer is any of many, at a bound: read off amidst them
            found = evenly_rough(shape, problem.weight, problem.groups.pairs, last.loads)
        report = self._report(problem, last.system, last.pivots, found)
        com = com_and_inertia(last.pivots, problem.weight)
        hidden = HiddenStates(
            problem.weight, com.inertia_cm, com.center_of_mass, last.loads, problem.groups.pairs, com.unobserved
        )
        open_ = report.unknowns - report.rank
        q = last.system.q.numpy()
        return Estimate(
            last.solution.distribution,
            "underdetermined" if open_ else "ok",
            f"mass and friction cannot be told apart in {open_} direction(s): {'; '.join(report.unobservable)}"
            if open_
            else "",
            covariance=report.covariance / np.outer(shape.particles_per_group, shape.particles_per_group),
            hidden=hidden,
            identifiability=report,
            traces=last.traces,
            seconds=time.perf_counter() - begin,
            diagnostics={
                "rank": q.shape[1],
                "condition": float(np.linalg.cond(q / np.linalg.norm(q, axis=0))),
                "loss": float(last.system.loss(torch.tensor(last.loads))),
            },
        )


@dataclass(frozen=True, eq=False)
class _Problem:
    """What one call of `estimate` works on."""

    shape: ObjectShape
    weight: float
    model: ParticleModel
    groups: LoadGroups
    steady: Observations
    """Windows of constant speed."""
    accelerated: Observations
    """Windows of constant acceleration."""
    robot_seconds: float
    """What the data cost, s."""

    @staticmethod
    def of(shape: ObjectShape, weight: float, observed: Observations, seconds: float) -> _Problem:
        model = ParticleModel.of(shape)
        steady, accelerated = observed.where(~observed.accelerated), observed.where(observed.accelerated)
        return _Problem(shape, weight, model, LoadGroups.of(model), steady, accelerated, seconds)

    def first_guess(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Uniform mass, as Algorithm 1 starts, and the largest drag felt over the weight, a lower bound of friction."""
        mass = torch.full((self.shape.n_m,), self.weight / len(self.shape.particles), dtype=torch.float64)
        drag = self.steady.wrench[:, :2].norm(dim=1).max() / (self.weight * GRAVITY)
        return mass, drag.expand(self.shape.n_mu)


@dataclass(frozen=True, eq=False)
class _Round:
    """One pass through Algorithm 1."""

    system: LinearSystem
    loads: np.ndarray
    traces: tuple[Trace, ...]
    pivots: PivotInertia | None
    solution: MassSolution
