"""Training of the index of `TrainedPolicy` in the environment, by CMA-ES: python -m scenarios.environment.train."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
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

UNSEEN = 1_000_000
"""Seed of the first object on which weights are compared with greedy, none of which they are trained on."""


class Course:
    """Objects of an environment with the candidates of each, predicted once."""

    def __init__(self, env: PlanningEnv, seeds: Sequence[int], candidates: int):
        self.env, self.designs = env, dict[int, Design]()
        for seed in track(seeds, "predicting candidates", transient=True):
            env.reset(seed=seed)
            drawn = env.family.sample(env.box.shape, env.box.grasps, candidates, seed)
            near = dict.fromkeys(env.box.action(env.box.point(action)) for action in drawn)
            kept = [action for action in near if not env.box.refusal(action)]
            self.designs[seed] = Design.of(env.box.shape, kept, env.guess)

    def falls(self, index: Index) -> Float[np.ndarray, "episodes"]:
        """Fall of the logarithm of the expected NAD in an episode of each object, actions chosen by an index."""
        return np.array([self._fall(seed, index) for seed in self.designs])

    def _fall(self, seed: int, index: Index) -> float:
        env, design, total, over = self.env, self.designs[seed], 0.0, False
        env.reset(seed=seed)
        each = (design.information_of([i]) for i in range(len(design.candidates)))
        env.predictions.update(zip(design.candidates, each, strict=True))
        while not over:
            best, _ = greedy_choice(design, env.belief, env.done, Goal(), env.left, FeasibilityLog(), index)
            if best is None:
                break
            _, reward, _, over, info = env.step(env.box.point(design.candidates[best]))
            total += reward * info["seconds"]
        return total


def train(
    out: Path,
    objects: int = 24,
    unseen: int = 24,
    generations: int = 20,
    population: int = 10,
    candidates: int = 400,
    budget_s: float = 110.0,
    spread: float = 0.3,
    seed: int = 0,
) -> tuple[TrainedIndex, Float[np.ndarray, "2 episodes"]]:
    """Search the weights that lower the expected NAD of drawn objects most, and compare them with greedy on others.

    Args:
        out: file of the weights.
        objects: number of objects to train on.
        unseen: number of objects to compare on.
        generations: of CMA-ES, which begins with greedy.
        population: of a generation.
        candidates: actions of each object.
        budget_s: robot time of an episode [s].
        spread: first standard deviation of the weights.
        seed: seed of the objects and of the search.
    """
    for name, value in {"objects": objects, "unseen": unseen, "generations": generations}.items():
        check_integer(name, value)
    env = PlanningEnv("expected", "log_nad", budget_s)
    course = Course(env, range(seed, seed + objects), candidates)

    def index(weights: Float[np.ndarray, "9"]) -> TrainedIndex:
        return TrainedIndex(tuple(tuple(row) for row in weights.reshape(SHAPE).round(4).tolist()), budget_s)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rounding in the first steps of the covariance
        search = CMA(np.zeros(int(np.prod(SHAPE))), spread, seed=seed, population_size=population)
    for _ in track(range(generations), "training", transient=True):
        drawn = [search.ask() for _ in range(search.population_size)]
        search.tell([(weights, -float(course.falls(index(weights)).mean())) for weights in drawn])
    found = index(search.mean)
    others = Course(env, range(UNSEEN + seed, UNSEEN + seed + unseen), candidates)
    falls = np.array([others.falls(each) for each in (gain_rate, found)])
    found.save(out, objects=objects, generations=generations, population=population, seed=seed)
    return found, falls


def main(out: Path, objects: int = 24, unseen: int = 24, generations: int = 20, seed: int = 0) -> None:
    """Train the weights of heft's trained policy, and compare it with greedy on objects that it was not trained on.

    Args:
        out: file of the weights.
        objects: number of objects to train on.
        unseen: number of objects to compare on.
        generations: generations of the search.
        seed: seed of the objects and of the search.
    """
    torch.set_num_threads(1)
    console = Console()
    _, falls = train(out, objects, unseen, generations, seed=seed)
    for name, each in zip(("greedy", "trained"), falls, strict=True):
        left = 100 * np.exp(-each.mean())
        console.print(f"{name}: expected NAD falls to {left:.2f} % of its first value in {len(each)} unseen episodes")
    better = falls[1] - falls[0]
    console.print(
        f"trained over greedy: lower by {100 * (1 - np.exp(-better.mean())):.1f} % (geometric mean, standard error "
        f"{100 * better.std() / np.sqrt(len(better)):.1f} %); better on {(better > 1e-9).sum()} of {len(better)}"
    )


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except HeftError as error:
        raise SystemExit(str(error)) from None
