"""Algorithm 1 as an estimator: settings, rounds until errors and the gripper's load have converged, estimate."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from estimators.base import Estimate, Trace, weighed
from estimators.descent import OPTIMIZERS, check_optimizers
from estimators.hidden_states.algorithm import Solution, algorithm_1
from estimators.hidden_states.equations import LinearSystem
from estimators.hidden_states.friction import CONTRADICTORY, closed_form, descend_loads
from estimators.hidden_states.masses import PivotInertia, fixed_rows, load_jacobian, one_friction_masses
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.identifiability.report import Identifiability, hardly_known, identifiability
from estimators.particles.links import hinge_frictions
from estimators.particles.observe import NO_DATA, NO_LINKS, ONE_BODY
from estimators.wrench.model import ModelErrors
from estimators.wrench.support import ASSUMPTION
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import check_integer

Solver = Literal["closed_form", "descent"]
MOST_ROUNDS, SETTLED = 8, 0.05
"""Largest number of rounds, and the change of the masses over the whole mass in a round below which they end."""


@dataclass(frozen=True)
class HiddenStates:
    """Multi-stage Hidden States estimation, Algorithm 1. Assumes that every mass group rests on its own weight."""

    solver: Solver = "closed_form"
    """Source of s: the exact minimum of Eq. problem_si, or `steps` of gradient descent on it."""
    steps: int = 500
    """Gradient steps of each optimizer; 500 in the paper."""
    optimizers: tuple[str, ...] = OPTIMIZERS
    """Optimizers to descend with; the one with the lowest loss is taken."""
    refinements: int = 3
    """Least number of rounds, each with the most likely errors and gripper's load of the round before; up to
    `MOST_ROUNDS` until the masses have converged."""
    pivot_error: float = ModelErrors.pivot_error
    """Error of the center of a turn, m."""
    force_error: float = ModelErrors.force_error
    """Model error of a force, as a part of the total drag."""
    torque_error: float = ModelErrors.torque_error
    """Model error of a torque, as a part of itself."""
    height_error: float = ModelErrors.height_error
    """Error of the TCP's height over the feet, m."""
    lift_error: float = ModelErrors.lift_error
    """Vertical force of a nulled gripper that the sensor cannot measure, N."""
    tilt_error: float = ModelErrors.tilt_error
    """Moment of a nulled gripper that the sensor cannot measure, N m."""
    lead_error: float = ModelErrors.lead_error
    """Time by which friction leads the motion, s."""
    inertia_error: float = ModelErrors.inertia_error
    """Model error of I_j, as a part of itself: once of each, and once of all together."""
    weight_error: float = ModelErrors.weight_error
    """Error of the weighing, kg."""

    def __post_init__(self) -> None:
        check_optimizers("HiddenStates", self.optimizers)
        if self.solver not in get_args(Solver):
            raise InvalidValueError("HiddenStates.solver", self.solver, f"one of {', '.join(get_args(Solver))}")
        check_integer("HiddenStates.steps", self.steps)
        check_integer("HiddenStates.refinements", self.refinements)
        _ = self.errors

    @property
    def errors(self) -> ModelErrors:
        """Errors of the model."""
        return ModelErrors(**{field.name: getattr(self, field.name) for field in fields(ModelErrors)})

    def estimate(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Estimate from turns, slides and accelerated turns. Draws nothing: `seed` changes nothing.

        Raises:
            InvalidValueError: no weight, which Algorithm 1 needs.
        """
        begin = time.perf_counter()
        weight = weighed(shape, weight)
        return replace(self._rounds(shape, weight, trajectories), seconds=time.perf_counter() - begin)

    def _rounds(self, shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory]) -> Estimate:
        """Algorithm 1 in rounds, each linearized about the masses and most likely errors of the round before."""
        if not shape.stands_in_groups:
            return Estimate(None, "assumption_violated", ONE_BODY)
        trials = TrialWindows.of(shape, weight, trajectories, self.errors)
        if trials is None:
            return Estimate(None, "no_data", NO_DATA if shape.chain is None else NO_LINKS)
        guess = trials.first_guess()
        solution: Solution | None = None
        for done in range(max(self.refinements, MOST_ROUNDS)):
            found = algorithm_1(trials, guess, partial(self._solve, seconds=trials.robot_seconds))
            if isinstance(found, LinearSystem):
                return _underdetermined(trials, found, guess)
            trials, last = trials.about_errors(guess, found.H.friction_load), guess
            solution, guess = found, _settled(trials, found)
            change = np.abs(guess.mass - last.mass) @ shape.particles_per_group
            if done + 1 >= self.refinements and change < SETTLED * weight:
                break
        assert solution is not None
        return _estimate_of(trials, solution)

    def _solve(self, system: LinearSystem, seconds: float) -> tuple[Float[np.ndarray, "n_s"], tuple[Trace, ...]]:
        """s and the traces of its optimizers; `seconds` is the robot time of the data."""
        if self.solver == "descent":
            return descend_loads(system, self.optimizers, self.steps, seconds)
        return closed_form(system), ()


def _report(
    trials: TrialWindows, system: LinearSystem, pivots: PivotInertia | None, at: MassDistribution
) -> Identifiability:
    """Masses and frictions that Q, the weight and I_j show."""
    shape = trials.shape
    fixed, _ = fixed_rows(shape, trials.weight, trials.weighing, pivots, shape.n_m + shape.n_mu)
    of_loads = system.q.numpy() @ load_jacobian(shape, trials.groups.pairs, at)
    return identifiability(shape, at, np.vstack([of_loads, fixed]))


def _underdetermined(trials: TrialWindows, system: LinearSystem, guess: MassDistribution) -> Estimate:
    """Estimate without masses, where rank(Q) < n_s."""
    pivots = trials.pivot_inertias(guess, trials.friction_loads(guess))
    report, n_s = _report(trials, system, pivots, guess), len(trials.groups.pairs)
    why = f"rank(Q) is {system.rank} and {n_s} friction loads are unknown: turn about more points"
    return Estimate(None, "underdetermined", why, identifiability=report)


def _settled(trials: TrialWindows, found: Solution) -> MassDistribution:
    """Masses found; where the system is rank-deficient, those of one friction for all groups."""
    if found.masses.rank < found.masses.unknowns and found.H.friction_load.any():
        return one_friction_masses(trials.shape, trials.weight, trials.groups.pairs, found.H.friction_load)
    return found.masses.distribution


def _estimate_of(trials: TrialWindows, found: Solution) -> Estimate:
    """Estimate of the last round with its covariance, or one without masses where trials are contradictory."""
    system, s = found.Q_s_b, found.H.friction_load
    loss = system.loss(s)
    if loss > CONTRADICTORY:
        why = (
            f"the trajectories contradict each other: their mean squared misfit is {loss:.0f} where about 1 is "
            "expected; is a trial of another object among them, or one with its signs turned?"
        )
        return Estimate(None, "contradictory", why)
    at, count = _settled(trials, found), trials.shape.particles_per_group
    report = _report(trials, system, found.I_j, at)
    open_, q = report.unknowns - report.rank, system.q.numpy()
    misfit = trials.misfit(at, s)
    covariance = misfit.widening * report.covariance / np.outer(count, count)
    loose = hardly_known(trials.shape, at.mass, covariance) if misfit.explains and not open_ else ""
    numbers = {"rank": q.shape[1], "condition": float(np.linalg.cond(q / np.linalg.norm(q, axis=0))), "loss": loss}
    directions = f"mass and friction cannot be told apart in {open_} direction(s): {'; '.join(report.unobservable)}"
    torque, std = trials.friction_equations(at).hinge_friction() or ((), ())
    widening = misfit.widening**0.5
    hinges, unseen = hinge_frictions(torque, std, widening)
    known = enumerate((widening * report.friction_error).tolist())
    frictions = {f"friction_{k}_std": error for k, error in known if np.isfinite(error)}
    return Estimate(
        at,
        "underdetermined" if open_ or loose else misfit.status,
        "; ".join(filter(None, [directions if open_ else loose, unseen, misfit.reason])),
        covariance=covariance,
        hidden=found.H,
        identifiability=report,
        traces=found.traces,
        diagnostics=numbers | misfit.diagnostics | frictions | hinges,
        assumes=ASSUMPTION["own_weight"],
    )
