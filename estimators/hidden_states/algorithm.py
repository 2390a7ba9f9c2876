"""What Algorithm 1 works on: one object's windows, sorted, and where it starts."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import torch

from estimators.base import Estimate, HiddenStateEstimate, Trace
from estimators.descent import OPTIMIZERS, check_optimizers
from estimators.hidden_states.friction import closed_form, closed_form_covariance, contradiction, descend_loads
from estimators.hidden_states.inertia import com_and_inertia
from estimators.hidden_states.masses import (
    MassSolution,
    evenly_rough,
    fixed_rows,
    load_jacobian,
    solve_masses,
)
from estimators.hidden_states.nuisance import JointLoads, Layout, Nuisances, corrected, grained, restated
from estimators.identifiability.information import Likelihood
from estimators.identifiability.report import Identifiability, identifiability
from estimators.particles.errors import ModelErrors
from estimators.particles.friction_system import (
    FrictionEquations,
    LinearSystem,
    LoadGroups,
    friction_equations,
    rank_of,
)
from estimators.particles.model import ParticleModel, direction, friction_wrench, inertia_of
from estimators.particles.pivots import PivotInertia, pivot_inertias
from estimators.particles.support import own_weight
from estimators.particles.windows import Observations, observe, robot_seconds
from estimators.particles.wrench_errors import torque_covariance
from testbed.errors import InvalidValueError
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import check_positive


@dataclass(frozen=True, eq=False)
class Problem:
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
    def of(shape: ObjectShape, weight: float, observed: Observations, seconds: float) -> Problem:
        """Windows sorted by whether they accelerate."""
        model = ParticleModel.of(shape)
        steady, accelerated = observed.where(~observed.accelerated), observed.where(observed.accelerated)
        return Problem(shape, weight, model, LoadGroups.of(model), steady, accelerated, seconds)

    def on(self, joint: JointLoads | None) -> Problem:
        """The same on a table with the grain that was found."""
        if joint is None:
            return self
        grain = torch.zeros(len(self.accelerated), 7, dtype=torch.float64)
        grain[:, 5:] = joint.grain
        return replace(self, accelerated=corrected(self.accelerated, grain))

    def loads(self, at: MassDistribution) -> np.ndarray:
        """s under masses and frictions, N."""
        return load_jacobian(self.shape, self.groups.pairs, at)[:, : self.shape.n_m] @ at.mass

    def first_guess(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Uniform mass, as Algorithm 1 starts, and the largest drag felt over the weight, a lower bound of friction."""
        mass = torch.full((self.shape.n_m,), self.weight / len(self.shape.particles), dtype=torch.float64)
        drag = self.steady.wrench[:, :2].norm(dim=1).max() / (self.weight * GRAVITY)
        return mass, drag.expand(self.shape.n_mu)


Solver = Literal["closed_form", "descent"]
SETTLING = 3
"""Rounds more where something of the bench is unknown: it is not linear in the wrench."""


@dataclass(frozen=True)
class HiddenStates(ModelErrors):
    """Multi-stage Hidden States estimation, Algorithm 1. Assumes that every mass group rests on its own weight."""

    solver: Solver = "closed_form"
    """Where s comes from: the exact minimum of Eq. problem_si, or `steps` of gradient descent on it."""
    steps: int = 500
    """Gradient steps of each optimiser; 500 in the paper."""
    optimizers: tuple[str, ...] = OPTIMIZERS
    """Optimisers to descend with; the one with the lowest loss is taken."""
    refinements: int = 3
    """Rounds of solving with what the gripper carries worked out from the round before."""
    unknown: tuple[str, ...] = ()
    """What of the bench is estimated with the loads: any of bias, grasp_offset, anisotropy."""
    offset_error: float = 0.003
    """How far an unknown grasp offset is thought to go along each axis, m."""
    grain_error: float = 0.3
    """How far each component of an unknown anisotropy is thought to go."""

    def __post_init__(self) -> None:
        check_optimizers("HiddenStates", self.optimizers)
        if self.solver not in get_args(Solver):
            raise InvalidValueError("HiddenStates.solver", self.solver, f"one of {', '.join(get_args(Solver))}")
        for name in ("steps", "refinements"):
            value = getattr(self, name)
            if isinstance(value, bool) or not (isinstance(value, int) and value >= 1):
                raise InvalidValueError(f"HiddenStates.{name}", value, "an integer >= 1")
        super().__post_init__()
        for name in ("offset_error", "grain_error"):
            check_positive(f"HiddenStates.{name}", getattr(self, name))
        Nuisances(self.unknown)

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
        found = self._once(shape, weight, trajectories, begin)
        if "bias" in self.unknown:
            found = self._once(shape, weight, restated(trajectories, found.diagnostics), begin)
        return found

    def _once(self, shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory], begin: float) -> Estimate:
        """Algorithm 1, with the sensor's errors as the trajectories state them."""
        observed = observe(shape, trajectories, self)
        if observed is None or bool(observed.accelerated.all()):
            why = "no trajectory with status ok that slides or turns at constant speed"
            return Estimate(None, "no_data", why, seconds=time.perf_counter() - begin)
        problem = Problem.of(shape, weight, observed, robot_seconds(trajectories))
        mass, friction = problem.first_guess()
        answer: _Round | None = None
        joint: JointLoads | None = None
        for _ in range(self.refinements + (SETTLING if self.unknown else 0)):
            if self.unknown:
                loads = answer.loads if answer else problem.loads(MassDistribution(mass.numpy(), friction.numpy()))
                joint = self._joint(problem, mass, friction, loads, joint)
                problem = problem.on(joint)
            system = self._system(problem, mass, friction, joint)
            rank, unknowns = rank_of(system.q.numpy()), len(problem.groups.pairs)
            if rank < unknowns:
                why = f"rank(Q) is {rank} and {unknowns} friction loads are unknown: turn about more points"
                guess = MassDistribution(mass.numpy(), friction.numpy())
                loads = problem.loads(guess)
                report = self._report(problem, system, self._pivots(problem, loads, mass, friction), guess)
                none = Estimate(
                    None, "underdetermined", why, identifiability=report, seconds=time.perf_counter() - begin
                )
                return joint.told(none, closed_form(system)) if joint else none
            answer = replace(self._round(problem, system, mass, friction), joint=joint)
            found = answer.solution.distribution
            mass, friction = torch.tensor(found.mass), torch.tensor(found.friction)
        assert answer is not None
        if why := contradiction(float(answer.system.loss(torch.tensor(answer.loads)))):
            found = Estimate(None, "contradictory", why, seconds=time.perf_counter() - begin)
        else:
            found = self._answer(problem, answer, begin)
        return answer.joint.told(found, answer.loads) if answer.joint else found

    def evidence(
        self, shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory], at: MassDistribution
    ) -> Likelihood:
        """What the trials say, with what the gripper carries worked out at an answer: for a posterior.

        Raises:
            InvalidValueError: no trajectory at constant speed.
        """
        observed = observe(shape, trajectories, self)
        if observed is None or bool(observed.accelerated.all()):
            raise InvalidValueError(
                "trajectories", len(trajectories), "one or more that slide or turn at constant speed"
            )
        problem = Problem.of(shape, weight, observed, robot_seconds(trajectories))
        mass, friction = torch.tensor(at.mass), torch.tensor(at.friction)
        pairs = problem.groups.pairs
        loads = problem.loads(at)
        joint: JointLoads | None = None
        for _ in range(SETTLING if self.unknown else 0):
            joint = self._joint(problem, mass, friction, loads, joint)
        problem = problem.on(joint)
        system = self._system(problem, mass, friction, joint)
        pivots = self._pivots(problem, loads, mass, friction)
        fixed, values = fixed_rows(shape, weight, self.weight_error, pivots, shape.n_m)
        return Likelihood(shape, pairs, system.q.numpy(), system.b.numpy(), fixed, values)

    def _system(
        self, problem: Problem, mass: torch.Tensor, friction: torch.Tensor, joint: JointLoads | None
    ) -> LinearSystem:
        """Q s = b, whitened, with what is unknown of the bench put in as it fits best."""
        return joint.reduced() if joint else self._equations(problem, mass, friction).whitened()

    def _equations(self, problem: Problem, mass: torch.Tensor, friction: torch.Tensor) -> FrictionEquations:
        """Q s = b, with what the gripper carries worked out from a guess of mass and friction."""
        model = problem.model
        particle_mass = model.particle_mass(mass)
        return friction_equations(
            model,
            problem.groups,
            problem.steady,
            particle_mass,
            model.particle_friction(friction),
            inertia_of(model, particle_mass),
            problem.shape.height,
            self,
        )

    def _joint(
        self,
        problem: Problem,
        mass: torch.Tensor,
        friction: torch.Tensor,
        loads: np.ndarray,
        last: JointLoads | None,
    ) -> JointLoads:
        """The same with what is unknown of the bench, about the round before's."""

        def equations(windows: Observations) -> FrictionEquations:
            return self._equations(replace(problem, steady=windows), mass, friction)

        layout = last.layout if last else Layout.of(self._nuisances, problem.steady)
        at = last.unknowns(loads) if last else torch.zeros(len(layout.names), dtype=torch.float64)
        return JointLoads.of(equations, problem.steady, layout, at, loads)

    @property
    def _nuisances(self) -> Nuisances:
        return Nuisances(self.unknown, grasp_offset=self.offset_error, anisotropy=self.grain_error)

    def _round(self, problem: Problem, system: LinearSystem, mass: torch.Tensor, friction: torch.Tensor) -> _Round:
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
        self, problem: Problem, loads: np.ndarray, mass: torch.Tensor, friction: torch.Tensor
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
        unit = grained(windows, direction(windows.particle_velocity(model)))
        felt = -friction_wrench(drag, unit, windows.lever(model))[:, 2]
        moved = windows.inertial_wrench(inertia)[:, 2]
        response = windows.drag_rows(model, 0.0)[0] @ (model.particle_friction(friction)[:, None] * support.response)
        error = torque_covariance(windows, response)
        pivots = pivot_inertias(windows, felt.numpy(), moved.numpy(), self.inertia_error, error)
        return self._nuisances.loosened(pivots, windows, problem.weight, inertia.com.numpy()) if pivots else None

    def _report(
        self, problem: Problem, system: LinearSystem, pivots: PivotInertia | None, at: MassDistribution
    ) -> Identifiability:
        """What Q, the weight and I_j show of masses and frictions."""
        shape = problem.shape
        fixed, _ = fixed_rows(shape, problem.weight, self.weight_error, pivots, shape.n_m + shape.n_mu)
        of_loads = system.q.numpy() @ load_jacobian(shape, problem.groups.pairs, at)
        return identifiability(shape, at, np.vstack([of_loads, fixed]))

    def _answer(self, problem: Problem, last: _Round, begin: float) -> Estimate:
        found, shape = last.solution.distribution, problem.shape
        if (
            last.solution.rank < last.solution.unknowns
        ):  # then the answer is any of many, at a bound: read off amidst them
            found = evenly_rough(shape, problem.weight, problem.groups.pairs, last.loads)
        report = self._report(problem, last.system, last.pivots, found)
        com = com_and_inertia(last.pivots, problem.weight)
        hidden = HiddenStateEstimate(
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
class _Round:
    """One pass through Algorithm 1."""

    system: LinearSystem
    loads: np.ndarray
    traces: tuple[Trace, ...]
    pivots: PivotInertia | None
    solution: MassSolution
    joint: JointLoads | None = None
