"""Algorithm 1 line by line as printed in the paper, for comparison with `hidden_states`.

Names and equations are the paper's. At constant speed its filtered states and wrenches are constant in the object
frame, so one window here represents all times of a turn, and has their weight.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import nnls
from torch import Tensor

from estimators.base import Estimate, HiddenStateEstimate, Trace, weighed
from estimators.descent import OPTIMIZERS, check_optimizers, descend
from estimators.evaluation.judged import misfit_on
from estimators.hidden_states.estimator import Solver
from estimators.hidden_states.friction import CONTRADICTORY
from estimators.hidden_states.masses import SMALLEST_PART, feet_of, inertia_map
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.particles.load_groups import rank_of, weight_per_mass
from estimators.particles.observe import HAS_HINGES, NO_DATA, ONE_BODY
from estimators.particles.windows import Observations
from estimators.wrench.model import Inertia, ModelErrors, acceleration, inertia_of, rotate, step, turned
from estimators.wrench.support import ASSUMPTION, own_weight
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import check_integer, check_positive_fields

DT = 0.01
"""dt of Eqs. update1 and update2 [s], at the paper's 100 Hz."""
ROUNDS = 3
"""Rounds of subtracting the gripper's load."""


@dataclass(frozen=True)
class PublishedHiddenStates:
    """Algorithm 1 as printed: gradient descent in s, without covariance and load of the gripper.

    Assumes that every mass group rests on its own weight. `solver` and `gripper_load` are steps towards `HiddenStates`.
    """

    solver: Solver = "descent"
    """Source of s: `steps` of gradient descent on Eq. problem_si, as published, or its exact minimum over s >= 0."""
    steps: int = 500
    """Gradient steps of each optimizer; 500 in the paper."""
    optimizers: tuple[str, ...] = OPTIMIZERS
    """Optimizers to descend with; the lowest loss wins. Paper: Adam, RMSProp and others, the best is picked."""
    learning_rate: float = 3.0
    """First step of Adam and RMSProp over the mean friction load; it decays quadratically to zero. Ours: the best of
    0.03 to 10 on the block objects, since the paper states none."""
    gripper_load: bool = False
    """True subtracts the drag of the gripper's measured load from the wrenches first. Ours."""

    def __post_init__(self) -> None:
        name = type(self).__name__
        check_optimizers(name, self.optimizers)
        if self.solver not in get_args(Solver):
            raise InvalidValueError(f"{name}.solver", self.solver, f"one of {', '.join(get_args(Solver))}")
        check_integer(f"{name}.steps", self.steps)
        check_positive_fields(self, "learning_rate")
        if not isinstance(self.gripper_load, bool):
            raise InvalidValueError(f"{name}.gripper_load", self.gripper_load, "true or false")

    def estimate(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Estimate from turns, slides and accelerated turns. Draws nothing: `seed` changes nothing.

        Diagnostics: "loss" is Eq. problem_si [(m/s)^2]; "misfit" that of `Misfit`.

        Raises:
            InvalidValueError: no weight, which Algorithm 1 needs.
        """
        begin = time.perf_counter()
        weight = weighed(shape, weight)
        if shape.chain is not None:
            return Estimate(None, "assumption_violated", HAS_HINGES)
        if not shape.stands_in_groups:
            return Estimate(None, "assumption_violated", ONE_BODY)
        trials = TrialWindows.of(shape, weight, trajectories, ModelErrors())
        if trials is None:
            return Estimate(None, "no_data", NO_DATA)
        found = self._algorithm_1(trials)
        for _ in range(ROUNDS if self.gripper_load else 0):
            if found.distribution is not None:
                found = self._algorithm_1(_unloaded(trials, found.distribution))
        return replace(_judged(trials, trajectories, found), seconds=time.perf_counter() - begin)

    def _algorithm_1(self, trials: TrialWindows) -> Estimate:
        """The paper's Algorithm 1 on sampled trials."""
        M, pairs, n_s = trials.weight, trials.groups.pairs, len(trials.groups.pairs)
        uniform = inertia_of(trials.model, torch.full_like(trials.model.fill, M / len(trials.model.fill)))
        p_j, I_j = moments_of_inertia(trials.accelerated)  # for each action in S_1
        if len(np.unique(p_j, axis=0)) < 2:
            why = "c and I_cm: fewer than two pivots were turned about with acceleration"
            return Estimate(None, "underdetermined", why)
        c, I_cm = com_and_inertia(p_j, I_j, M, uniform.com.numpy())  # solve Eq. problem_com_inertia
        if I_cm <= 0:
            return Estimate(None, "contradictory", f"I_cm is {I_cm:.2g} kg m^2 by the inertias about the pivots")
        H = Inertia(*(torch.tensor(value, dtype=torch.float64) for value in (M, c, I_cm)))

        times = (trials.steady.since_tare.diff(dim=1) / DT).sqrt()

        def errors(s: Float[Tensor, "... n_s"]) -> Float[Tensor, "... 3K"]:
            """Terms of Eq. problem_si; each window has the weight of all its times."""
            return (times * velocity_errors(trials, H, s)).flatten(-2)

        b = -errors(torch.zeros(n_s).double())
        Q = (errors(torch.eye(n_s).double()) + b).T
        # rank in N and N m, as in the sampling of S_2
        in_newton = torch.tensor([M, M, I_cm] * len(times)).double()[:, None]
        if (rank := rank_of((in_newton * Q).numpy())) < n_s:
            why = f"rank(Q) is {rank} and {n_s} friction loads are unknown: turn about more points"
            return Estimate(None, "underdetermined", why)

        traces: tuple[Trace, ...] = ()
        if self.solver == "closed_form":
            s = torch.tensor(nnls(Q.numpy(), b.numpy())[0])
        else:
            # while not timeout: L(s) and its gradient, s = s - rate * gradient; the forward dynamics are affine in s
            rate = self.learning_rate * trials.steady.drag / int(trials.model.contact.sum())
            rates = {"adam": rate, "rmsprop": rate, "plain": 0.5 / float(Q.square().sum())}
            runs = descend(
                lambda s: (s @ Q.T - b).square().sum(-1),
                torch.zeros(n_s).double(),
                {name: rates[name] for name in self.optimizers},
                self.steps,
                masses=lambda s: masses_of(trials, H, s)[0],
                robot_seconds=trials.robot_seconds,
            )
            s, traces = runs[0].best.clamp(min=0.0), tuple(run.trace for run in runs)
        m, mu = (values.numpy() for values in masses_of(trials, H, s))  # solve for m from H
        return Estimate(
            MassDistribution(m, mu),
            "ok",
            hidden=HiddenStateEstimate(M, I_cm, c, s.numpy(), pairs),
            traces=traces,
            diagnostics={"loss": float(errors(s).square().sum()), "rank": float(rank)},
            assumes=ASSUMPTION["own_weight"],
        )


def moments_of_inertia(windows: Observations) -> tuple[Float[np.ndarray, "k 2"], Float[np.ndarray, "k"]]:
    """p_j [m] and I_j [kg m^2] of each accelerated turn, the slope of its torques over its accelerations, Eq. dvp."""
    turns = [windows.where(windows.trial == trial) for trial in windows.trial.unique()]
    slopes = [np.polyfit(turn.acceleration[:, 2], turn.wrench[:, 2], 1)[0] for turn in turns]
    return np.array([turn.grasp[0].numpy() for turn in turns]).reshape(-1, 2), np.array(slopes)


def com_and_inertia(
    p_j: Float[np.ndarray, "k 2"], I_j: Float[np.ndarray, "k"], M: float, start: Float[np.ndarray, "2"]
) -> tuple[Float[np.ndarray, "2"], float]:
    """c [m] and I_cm [kg m^2] of Eq. problem_com_inertia, which is linear in c and I_cm + M |c|^2.

    Pivots in a straight row do not determine c across it: that component stays at `start` [m].
    """
    center = p_j.mean(axis=0)
    offset = p_j - center
    _, spread, axes = np.linalg.svd(offset, full_matrices=False)
    axes = axes[spread > 1e-3 * spread[0]]
    design = np.column_stack([np.ones(len(I_j)), -2 * M * offset @ axes.T])
    bracket, *along = np.linalg.lstsq(design, I_j - M * (offset**2).sum(axis=1), rcond=None)[0]
    c = start + axes.T @ (along - axes @ (start - center))
    return c, float(bracket - M * (c - center) @ (c - center))


def velocity_errors(trials: TrialWindows, H: Inertia, s: Float[Tensor, "... n_s"]) -> Float[Tensor, "... K 3"]:
    """Phi(p_t, v_t, s, u_t) - v_{t+1} [m/s, rad/s] of every window, by the forward dynamics, Eqs. fif to update2.

    A turn with its center in the held particle's cell is about that particle, which is then at rest, as in the paper.
    """
    model, turns = trials.model, trials.steady
    spin, held = turns.twist[:, 2:], turns.twist[:, :2]
    held = torch.where(held.norm(dim=1, keepdim=True) < model.cell / 2 * spin.abs(), 0.0, held)
    linear = held + spin * turned(H.com - turns.grasp)
    p_t = torch.cat([H.com, torch.zeros(1, dtype=torch.float64)]).expand(len(turns), 3)
    v_t, measured = torch.cat([linear, spin], 1), torch.cat([rotate(spin[:, 0] * DT, linear), spin], 1)
    a_t = acceleration(model, H, trials.groups.spread(s)[..., None, :], p_t, v_t, turns.wrench, turns.grasp)
    return step(p_t, v_t, a_t, DT)[1] - measured


def masses_of(
    trials: TrialWindows, H: Inertia, s: Float[Tensor, "... n_s"]
) -> tuple[Float[Tensor, "... n_m"], Float[Tensor, "... n_mu"]]:
    """m [kg] and mu from the hidden states: m = s / (mu g), with 1 / mu by Eqs. mass, com and inertia.

    M holds exactly; with one friction, it alone determines 1 / mu.
    """
    shape, pairs = trials.shape, trials.groups.pairs
    mass_of, friction_of = torch.tensor(pairs).T
    feet, per_mass = torch.tensor(feet_of(shape, pairs)).double(), torch.tensor(weight_per_mass(shape, pairs))
    count, s = torch.tensor(shape.particles_per_group).double(), s.clamp(min=0.0)

    on_group = torch.zeros(shape.n_m).double().index_add(0, mass_of, feet)
    per_nu = torch.zeros(*s.shape[:-1], shape.n_m, shape.n_mu).double()  # m of nu = 1 / mu
    per_nu[..., mass_of, friction_of] = s / per_mass * feet / on_group[mass_of]
    radius = float(H.about_com / H.mass) ** 0.5
    com = torch.tensor(shape.per_group(shape.particles.T - H.com[:, None].numpy())) / radius
    inertia = torch.tensor(inertia_map(shape, H.com[None].numpy())) / radius**2
    of_mass = torch.tensor([1.0, 0.0, 0.0, 1.0]).double() * H.mass
    nu = (torch.linalg.pinv(torch.cat([count[None], com, inertia]) @ per_nu) @ of_mass).clamp(min=0.0)

    m = (per_nu @ nu.clamp(min=SMALLEST_PART * nu.amax(-1, keepdim=True))[..., None])[..., 0]
    total = (m @ count)[..., None]
    m = torch.where(total > 0, m * H.mass / total, H.mass / count.sum())
    of_group = torch.eye(shape.n_mu).double()[friction_of]
    mu = (s * feet @ of_group) / (m[..., mass_of] * per_mass * feet @ of_group).clamp(min=1e-12)
    return m, mu


def _unloaded(trials: TrialWindows, guess: MassDistribution) -> TrialWindows:
    """Trials less the drag of the gripper's load, by the masses and frictions of the round before."""
    windows, model = trials.windows, trials.model
    mass = model.particle_mass(torch.tensor(guess.mass))
    load = windows.gripper_load(model, mass, trials.shape.height)
    support = own_weight(model, mass, load)
    of_load = model.particle_friction(torch.tensor(guess.friction)) * (support.lean + support.change(load))
    drag = (windows.drag_rows(model, trials.errors.pivot_error) @ of_load[..., None])[..., 0]
    return replace(trials, windows=replace(windows, wrench=windows.wrench - drag))


def _judged(trials: TrialWindows, trajectories: Sequence[Trajectory], found: Estimate) -> Estimate:
    """Estimate with its misfit and the status by it."""
    if found.distribution is None or found.hidden is None:
        return found
    misfit = misfit_on("own_weight", trials.shape, trials.weight, trajectories, found.distribution)
    assert misfit is not None
    found = replace(found, diagnostics=found.diagnostics | misfit.diagnostics)
    if misfit.value > CONTRADICTORY:
        why = f"the masses miss the measured wrenches by {misfit.value:.0f} mean squared errors: too few steps, or the "
        return replace(found, status="not_converged", message=f"{why}trajectories contradict each other")
    return replace(found, status=misfit.status, message=misfit.reason)
