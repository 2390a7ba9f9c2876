"""Training of the index of `TrainedPolicy` in the environment by CMA-ES: python -m scenarios.environment.train."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
import tyro
from cmaes import CMA
from jaxtyping import Float
from rich.console import Console
from rich.progress import track

from estimators.action_selection.design import Design
from estimators.action_selection.greedy import Index, gain_rate, greedy_choice
from estimators.action_selection.plan import FeasibilityLog, Goal
from estimators.action_selection.trained import SHAPE, TrainedIndex
from scenarios.environment.planning import PlanningEnv
from testbed.errors import HeftError
from testbed.validation import check_integer

SPREAD = 0.3
"""Initial standard deviation of the weights about those of greedy."""
UNSEEN = 1_000_000
"""Offset of the seeds of unseen objects from those of training."""


def train(
    out: Path,
    objects: int = 24,
    unseen: int = 24,
    generations: int = 20,
    population: int = 10,
    candidates: int = 400,
    budget_s: float = 110.0,
    seed: int = 0,
) -> Float[np.ndarray, "2 unseen"]:
    """Search the weights that lower the expected NAD of drawn objects most, and compare them with greedy on others.

    Args:
        out: file of the weights.
        objects: number of objects to train on.
        unseen: number of other objects to compare on.
        generations: generations of CMA-ES, which begins with greedy.
        population: candidates of weights in a generation, at least 3.
        candidates: actions to choose from.
        budget_s: robot time of an episode [s].
        seed: seed of the objects and of the search.

    Returns:
        Fall of the logarithm of the expected NAD of each unseen object, by greedy and by the trained index.
    """
    for name, value in {"objects": objects, "unseen": unseen, "generations": generations}.items():
        check_integer(name, value)
    check_integer("population", population, least=3)
    env = PlanningEnv("expected", "log_nad", budget_s)
    known = _designs(env, range(seed, seed + objects), candidates)

    def index(weights: Float[np.ndarray, "9"]) -> TrainedIndex:
        return TrainedIndex(tuple(tuple(row) for row in weights.reshape(SHAPE).round(4).tolist()), budget_s)

    search = CMA(np.zeros(int(np.prod(SHAPE))), SPREAD, seed=seed, population_size=population)
    for _ in track(range(generations), "training", transient=True):
        drawn = [search.ask() for _ in range(population)]
        search.tell([(weights, -float(_falls(env, known, index(weights)).mean())) for weights in drawn])
    found = index(search.mean)
    others = _designs(env, range(UNSEEN + seed, UNSEEN + seed + unseen), candidates)
    falls = np.array([_falls(env, others, each) for each in (gain_rate, found)])
    found.save(out, objects=objects, generations=generations, population=population, seed=seed)
    return falls


def _designs(env: PlanningEnv, seeds: Sequence[int], candidates: int) -> dict[int, Design]:
    """Candidates of the object of each seed, predicted once."""
    found = {}
    for seed in track(seeds, "predicting", transient=True):
        env.reset(seed=seed)
        drawn = env.family.sample(env.box.shape, env.box.grasps, candidates, seed)
        near = dict.fromkeys(env.box.action(env.box.point(action)) for action in drawn)
        found[seed] = Design.of(env.box.shape, [a for a in near if not env.box.refusal(a)], env.guess)
    return found


def _falls(env: PlanningEnv, designs: Mapping[int, Design], index: Index) -> Float[np.ndarray, "episodes"]:
    """Fall of the logarithm of the expected NAD in an episode of each object, actions chosen by an index."""
    return np.array([_fall(env, seed, design, index) for seed, design in designs.items()])


def _fall(env: PlanningEnv, seed: int, design: Design, index: Index) -> float:
    env.reset(seed=seed)
    total, over = 0.0, False
    env.predictions.update({a: design.information_of([i]) for i, a in enumerate(design.candidates)})
    while not over:
        best, _ = greedy_choice(design, env.belief, env.done, Goal(), env.left, FeasibilityLog(), index)
        if best is None:
            break
        _, reward, _, over, info = env.step(env.box.point(design.candidates[best]))
        total += reward * info["seconds"]
    return total


def main() -> None:
    """Train, and print the comparison."""
    torch.set_num_threads(1)
    try:
        falls = tyro.cli(train)
    except HeftError as error:
        raise SystemExit(str(error)) from None
    greedy, trained = 100 * np.exp(-falls.mean(axis=1))
    better = falls[1] - falls[0]
    error = 100 * better.std(ddof=1) / np.sqrt(len(better)) if len(better) > 1 else math.nan
    Console(soft_wrap=True).print(
        f"{len(better)} unseen objects: expected NAD falls to {greedy:.2f} % of its first value by greedy, "
        f"{trained:.2f} % by the trained index: {100 * (1 - np.exp(-better.mean())):.1f} % lower (geometric mean, "
        f"standard error {error:.1f} %); lower on {(better > 1e-9).sum()}, higher on {(better < -1e-9).sum()}"
    )


if __name__ == "__main__":
    main()
