"""Simulation-based calibration of the joint posterior: python bench/posterior_ranks.py [--problems N] [--seed S].

Every problem draws masses, frictions and all errors of the setup from the estimator's own prior, and readings from its
own forward model and errors; then the rank of each true mass and friction among draws of the posterior is even between
0 and 1, if the posterior is right (Talts et al. 2018). A row per world: intervals that hold the true masses; mean rank
(0.5) and p of the ranks' histogram by chi squared, of masses the least times their number (Bonferroni), and of the
friction: below 0.01, Laplace's approximation fails there; and the answers that do not explain their own trials, those
of a search that ended elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from scipy.stats import chisquare
from shared import head_table, parser_of, pooled, show

from estimators.particles.misfit import UNEXPLAINED
from estimators.particles.observe import observe
from estimators.posterior.estimator import START_FRICTION
from estimators.posterior.on_table import OnTable
from estimators.posterior.posterior import Posterior
from estimators.posterior.priors import priors
from estimators.posterior.scale import Scale, Weighing
from estimators.posterior.solver import solve
from estimators.testing.analytic_world import accelerated, drawn_object, turns
from estimators.wrench.model import ModelErrors
from testbed.objects.model import GRAVITY
from testbed.worlds.presets import world

DRAWS = 400
"""Draws of a posterior."""
BINS = 10
NOISE = 0.02
"""Noise of a sample, N, and a tenth of it in N m: it sets the errors that the windows state."""


@dataclass(frozen=True)
class Problem:
    """Trials whose readings are drawn anew."""

    name: str
    setup: str
    """World whose errors are stated."""
    swung: bool = True
    """True with accelerated turns."""


PROBLEMS = {
    each.name: each
    for each in (
        Problem("ideal", "ideal"),
        Problem("lab", "lab"),
        Problem("rough", "rough"),
        Problem("lab, turns alone", "lab", swung=False),
    )
}


def ranks(problem: Problem, seed: int) -> np.ndarray:
    """Rank of every true mass and friction among the draws of one problem, 0 to 1; the last entry is the misfit."""
    rng, errors = np.random.default_rng([seed, 1]), ModelErrors()  # draws apart from those of the posterior
    obj, stated = drawn_object(seed % 7), world(problem.setup).stated
    trials = turns(obj, noise=NOISE) + (accelerated(obj, noise=NOISE) if problem.swung else [])
    windows = observe(obj.shape, [replace(trial, setup=stated) for trial in trials], errors)
    assert windows is not None
    on_table, weighing = OnTable.of(obj.shape, windows, "own_weight", errors), Weighing.of(obj.shape, 1e-3, stated)
    unknowns = priors(obj.shape, stated, errors, obj.total_mass, on_table.trials, lifted=False)
    true = torch.tensor(rng.standard_normal(len(unknowns)))
    found = on_table.linearized(unknowns, true)
    read = found.residual + on_table.read.flatten()
    for rows, covariance in found.blocks:
        drawn = torch.tensor(rng.standard_normal((*rows.shape, 1)))
        read[rows] += (torch.linalg.cholesky(covariance) @ drawn)[..., 0]
    read = read.reshape(len(windows), -1)[:, :6]
    sensed = torch.linalg.solve(windows.from_sensor, read[..., None])[..., 0]
    values = unknowns.values(true)
    weight = float(torch.tensor(weighing.count) @ values["mass"])
    scale = Scale(weight + weighing.error * rng.standard_normal(), weighing)
    measurements = [replace(on_table, windows=replace(windows, sensed=sensed)), scale]
    drag = float(read[:, :2].norm(dim=1).max()) / (weight * GRAVITY)
    start = unknowns.start(friction=float(np.clip(drag, *START_FRICTION)))
    posterior = Posterior(unknowns, measurements, solve(measurements, unknowns, start))
    mass, friction = posterior.draws(obj.shape, DRAWS, seed)
    truth = np.append(values["mass"].numpy() * obj.shape.particles_per_group, values["friction"].numpy())
    return np.append((np.hstack([mass, friction]) < truth).mean(axis=0), posterior.misfit)


def row(name: str, found: Sequence[np.ndarray]) -> list[str]:
    """Figures of a world."""
    each = [one[:-1] for one in found]
    # objects have different numbers of groups: the k-th of each together, and the last, which is the friction
    count = min(len(one) for one in each) - 1
    masses, friction = [np.array([one[k] for one in each]) for k in range(count)], np.array([one[-1] for one in each])
    of_masses = min(1.0, count * min(even(column) for column in masses))
    every = np.concatenate([one[:-1] for one in each])
    held = [100 * float(np.mean(np.abs(every - 0.5) < level / 2)) for level in (0.5, 0.9)]
    misfits = np.array([one[-1] for one in found])
    ends = f"{100 * float((misfits > UNEXPLAINED).mean()):.0f} %"
    figures = [f"{every.mean():.2f}", f"{of_masses:.2g}", f"{friction.mean():.2f}", f"{even(friction):.2g}"]
    return [name, str(len(found)), *(f"{percent:.0f} %" for percent in held), *figures, ends]


def even(ranks: np.ndarray) -> float:
    """p of a histogram of ranks, were they even."""
    return float(chisquare(np.histogram(ranks, BINS, (0, 1))[0]).pvalue)


def main() -> None:
    parser = parser_of(__doc__, problems=300, seed=0, workers=2)
    parser.add_argument("--worlds", nargs="+", choices=list(PROBLEMS), default=list(PROBLEMS))
    asked = parser.parse_args()
    heads = ["world", "problems", "50 % hold", "90 % hold", "rank", "p", "friction's rank", "p", "unexplained"]
    table = head_table(*heads, left=heads)
    for name in asked.worlds:
        seeds = range(1000 * asked.seed, 1000 * asked.seed + asked.problems)
        table.add_row(*row(name, pooled(partial(ranks, PROBLEMS[name]), seeds, asked.workers)))
    show(table)


if __name__ == "__main__":
    main()
