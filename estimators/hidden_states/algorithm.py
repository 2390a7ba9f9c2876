"""Algorithm 1 of the paper: the hidden states H = [M, I_cm, c, s], and from them mass m and friction mu.

The names are the paper's: I_j is the moment of inertia about pivot j, c the center of mass, s = mu m g the friction
loads of the groups G_s, and Q s = b the friction system. The order differs from the paper's: Q and b are about the
grasp point, where they do not need c, and s precedes I_j, the slopes of torques less friction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from estimators.base import HiddenStateEstimate, Trace
from estimators.hidden_states.equations import LinearSystem
from estimators.hidden_states.friction import closed_form_covariance
from estimators.hidden_states.inertia import com_and_inertia
from estimators.hidden_states.masses import MassSolution, PivotInertia, solve_masses
from estimators.hidden_states.trial_windows import TrialWindows
from testbed.objects.model import MassDistribution

LoadSolver = Callable[[LinearSystem], tuple[Float[np.ndarray, "n_s"], tuple[Trace, ...]]]
"""Minimizer of Eq. problem_si over s >= 0: s [N], and the traces of its optimizers."""


@dataclass(frozen=True, eq=False)
class Solution:
    """One pass through Algorithm 1."""

    Q_s_b: LinearSystem
    I_j: PivotInertia | None
    """Moments of inertia about the pivots; None without an accelerated turn."""
    H: HiddenStateEstimate
    """Hidden states."""
    masses: MassSolution
    """m and mu."""
    traces: tuple[Trace, ...]
    """Trace of each optimizer of s."""


def algorithm_1(trials: TrialWindows, guess: MassDistribution, solve: LoadSolver) -> Solution | LinearSystem:
    """Estimate hidden states, mass and friction from the windows of some trials; Q s = b alone where rank(Q) < n_s.

    Args:
        trials: steady and accelerated windows, M and the groups G_s.
        guess: mass and friction about which the rows are linearized; errors and the gripper's load scale with them.
        solve: minimizer of Eq. problem_si.
    """
    M, groups, n_s = trials.weight, trials.groups.pairs, len(trials.groups.pairs)

    Q_s_b = trials.friction_system(guess)  # Eq. dvs
    if Q_s_b.rank < n_s:
        return Q_s_b
    s, traces = solve(Q_s_b)  # Eq. problem_si

    I_j = trials.pivot_inertias(guess, s)  # Eq. dvp
    c, I_cm, unobserved = com_and_inertia(I_j, M)  # Eq. problem_com_inertia

    covariance = closed_form_covariance(Q_s_b)
    masses = solve_masses(trials.shape, M, trials.weighing, groups, s, covariance, I_j)  # last line of Algorithm 1
    return Solution(Q_s_b, I_j, HiddenStateEstimate(M, I_cm, c, s, groups, unobserved), masses, traces)
