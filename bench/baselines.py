"""Sources of each baseline's error: python bench/baselines.py [random|weighted|explicit|lcp|all].

All of it in the exact Coulomb world of the tests: own weight, no simulator, no sensor but where a column says so.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from statistics import median

import numpy as np
import torch
from scipy.optimize import minimize
from shared import head_table
from shared import show as printed
from torch import Tensor

from estimators.base import Estimate
from estimators.baselines.base import ITERATIONS, Baseline, LogCoordinates
from estimators.baselines.diff_lcp import DiffLcp
from estimators.baselines.explicit_state import ExplicitState
from estimators.baselines.problem import Problem, Weighting
from estimators.baselines.sampling import RandomSearch, WeightedSampling
from estimators.descent import OPTIMIZERS
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.testing.analytic_world import accelerated, turns
from estimators.wrench.model import ModelErrors
from testbed.objects.files import load_object
from testbed.objects.model import MassDistribution, ObjectModel
from testbed.trajectory import Trajectory

OBJECTS = ("I2", "L2", "F2")
SEEDS = range(5)
BELOW = 2
"""Seed that draws a first friction of 0.30; the truth is 0.5."""
BUDGETS = (500, 5000, 50_000)
STEPS = {"as published": BUDGETS, "with M": (500,), "covariance": (500,), "with M, covariance": (500, 5000)}
"""Budgets of Explicit State."""
CASES: tuple[tuple[str, bool, Weighting], ...] = (
    ("as published", False, "velocity"),
    ("with M", True, "velocity"),
    ("covariance", False, "covariance"),
    ("with M, covariance", True, "covariance"),
)


@cache
def data(name: str, noise: float = 0.0) -> tuple[ObjectModel, list[Trajectory]]:
    """An object, and turns and accelerated turns about every grasp; noise in N, and 0.1 N m."""
    obj = load_object(name)
    return obj, turns(obj, noise=noise) + accelerated(obj, noise=noise)


def ask(name: str, method: Baseline, seed: int = 0, noise: float = 0.0) -> Estimate:
    """The method's answer; the center of a turn is known exactly here."""
    obj, trajectories = data(name, noise)
    exact = replace(method, pivot_error=0.0)
    return exact.estimate(obj.shape, obj.total_mass, trajectories, seed)  # pyright: ignore[reportAttributeAccessIssue]


def off(name: str, mass: np.ndarray) -> float:
    """NAD, %."""
    obj, _ = data(name)
    return 100 * normalized_absolute_difference(obj.shape, MassDistribution(mass, obj.truth.friction), obj.truth)


def nad(name: str, method: Baseline, seed: int = 0, noise: float = 0.0) -> float:
    """NAD of an answer, %."""
    answer = ask(name, method, seed, noise)
    assert answer.distribution is not None
    return off(name, answer.distribution.mass)


def spread(values: Sequence[float]) -> str:
    """Median and range."""
    return f"{median(values):.3g} ({min(values):.2g} - {max(values):.2g})"


def over_seeds(name: str, method: Baseline) -> str:
    return spread([nad(name, method, seed) for seed in SEEDS])


def show(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table on the screen."""
    table = head_table(*columns, left=columns[:1], title=title, title_justify="left")
    for row in rows:
        table.add_row(*row)
    printed(table, width=110)


def random_search() -> None:
    """NAD against the number of draws."""
    rows = [["uniform mass", *(f"{off(n, uniform(n)):.3g}" for n in OBJECTS)]]
    for title, use_weight, _ in CASES[:2]:
        for budget in BUDGETS:
            method = RandomSearch(iterations=budget, use_weight=use_weight)
            rows.append([f"{title}, {budget} draws", *(over_seeds(n, method) for n in OBJECTS)])
    show("Random Search: NAD, %, median and range of 5 seeds", ["", *OBJECTS], rows)


def uniform(name: str) -> np.ndarray:
    """The right M, evenly spread."""
    shape = data(name)[0].shape
    return np.full(shape.n_m, data(name)[0].total_mass / len(shape.particles))


def weighted_sampling() -> None:
    """NAD against the number of draws, with the decay as it is and stretched over them."""
    rows = []
    for title, use_weight, _ in CASES[:2]:
        for budget in BUDGETS:
            kept = WeightedSampling(iterations=budget, use_weight=use_weight)
            # as small a deviation at the end as the published decay has after the published number of draws
            stretched = replace(kept, decay=kept.decay ** (ITERATIONS / budget))
            for how, method in (("decay as it is", kept), ("decay stretched", stretched)):
                # the deviation of the one is 1e-11 after 5000 draws, that of the other the same after 500
                if not (method is kept and budget > BUDGETS[1]) and not (method is stretched and budget == ITERATIONS):
                    rows.append([f"{title}, {budget} draws, {how}", *(over_seeds(n, method) for n in OBJECTS)])
    show("Weighted Sampling Search: NAD, %, median and range of 5 seeds", ["", *OBJECTS], rows)


def explicit_state() -> None:
    """NAD of each optimiser and budget, and of the minimum that Newton's method finds."""
    rows = []
    for title, use_weight, weighting in CASES:
        for budget in STEPS[title]:
            method = ExplicitState(iterations=budget, use_weight=use_weight, weighting=weighting)
            names = OBJECTS if budget < BUDGETS[-1] else OBJECTS[-1:]  # the longest on the hardest alone
            answers = {n: ask(n, method, BELOW) for n in names}
            for k in OPTIMIZERS:
                found = {n: next(t for t in answers[n].traces if t.method == k) for n in names}
                values = {n: f"{off(n, t.mass[int(np.argmin(t.loss))]):.3g}" for n, t in found.items()}
                rows.append([f"{title}, {budget} steps, {k}", *(values.get(n, "") for n in OBJECTS)])
    show("Explicit State from uniform mass and friction 0.30: NAD, %", ["", *OBJECTS], rows)
    rows = [
        [title, *(over_seeds(n, ExplicitState(use_weight=use_weight, weighting=weighting)) for n in OBJECTS)]
        for title, use_weight, weighting in CASES[1:]
    ]
    show(f"Explicit State, {ITERATIONS} steps: NAD, %, median and range of 5 first frictions", ["", *OBJECTS], rows)
    rows = []
    for title, use_weight, weighting in CASES:
        for noise in (0.0, 0.02, 0.3):
            ends = [lowest(n, use_weight, weighting, noise) for n in OBJECTS]
            rows.append([f"{title}, noise {noise:g} N", *(f"{a:.2g} / {b:.2g}" for a, b in ends)])
    title = "NAD, %, of the minimum that Newton finds: from the truth / from where 500 steps of descent ended"
    show(title, ["", *OBJECTS], rows)


def problem_of(name: str, use_weight: bool, noise: float = 0.0) -> tuple[Problem, LogCoordinates, Tensor]:
    """The problem, coordinates about uniform mass and friction 0.5, and the truth in them."""
    obj, trajectories = data(name, noise)
    problem = Problem.of(obj.shape, obj.total_mass, trajectories, use_weight=use_weight, errors=ModelErrors(0.0))
    assert isinstance(problem, Problem)
    coordinates = LogCoordinates.about(problem, float(obj.truth.friction[0]))
    typical = problem.typical_mass(torch.tensor(obj.truth.friction))
    return problem, coordinates, torch.cat([torch.zeros(1), torch.log(torch.tensor(obj.truth.mass) / typical)])


def in_logs(problem: Problem, coordinates: LogCoordinates, weighting: Weighting) -> Callable[[Tensor], Tensor]:
    """The loss as a function of one point of the coordinates."""

    def loss(z: Tensor) -> Tensor:
        point = coordinates.candidates(z[None])
        return problem.loss(point.mass, point.friction, weighting)[0]

    return loss


def lowest(name: str, use_weight: bool, weighting: Weighting, noise: float) -> tuple[float, float]:
    """NAD, %, of the minima that a second-order method finds from the truth and from the end of the descent."""
    problem, coordinates, truth = problem_of(name, use_weight, noise)
    loss = in_logs(problem, coordinates, weighting)
    answer = ask(name, ExplicitState(use_weight=use_weight, weighting=weighting), BELOW, noise).distribution
    assert answer is not None
    first = (coordinates.first_friction.numpy(), coordinates.first_mass.numpy())
    ended = np.concatenate([np.log(answer.friction / first[0]), np.log(answer.mass / first[1])])
    scale = float(loss(coordinates.start))

    def value(z: np.ndarray) -> tuple[float, np.ndarray]:
        point = torch.tensor(z, requires_grad=True)
        now = loss(point) / scale
        return float(now.detach()), torch.autograd.grad(now, point)[0].numpy()

    def bend(z: np.ndarray) -> np.ndarray:
        return torch.autograd.functional.hessian(lambda x: loss(x) / scale, torch.tensor(z)).numpy()  # pyright: ignore[reportAttributeAccessIssue]

    found = []
    for start in (truth.numpy(), ended):
        settings = {"gtol": 1e-13, "maxiter": 500}
        end = minimize(value, start, jac=True, hess=bend, method="trust-exact", options=settings).x
        found.append(off(name, coordinates.candidates(torch.tensor(end)[None]).mass[0].numpy()))
    return found[0], found[1]


def diff_lcp() -> None:
    """NAD against the corners of the polygon."""
    rows = []
    for directions in (4, 8, 16, 32):
        answers = {n: ask(n, DiffLcp(use_weight=True, directions=directions), BELOW) for n in OBJECTS}
        rows.append(
            [f"{directions}", *(friction_and_nad(n, a) for n, a in answers.items()), f"{radius(directions):.3f}"]
        )
    title = f"Diff-LCP with M, {DiffLcp.substeps} substeps, first friction 0.30: NAD, %, and mu M g over the truth's"
    show(title, ["corners", *OBJECTS, "1 / mean radius"], rows)


def radius(directions: int) -> float:
    """Over its mean radius along the motion: how much larger the friction of a polygon must be than the circle's."""
    return math.pi / directions / math.sin(math.pi / directions)


def friction_and_nad(name: str, answer: Estimate) -> str:
    obj, _ = data(name)
    assert answer.distribution is not None
    load = answer.distribution.friction[0] * (answer.distribution.mass @ obj.shape.particles_per_group)
    drag = load / (obj.truth.friction[0] * obj.total_mass)
    return f"{off(name, answer.distribution.mass):.3g}, {drag:.3f}"


EXPERIMENTS = {
    "random": random_search,
    "weighted": weighted_sampling,
    "explicit": explicit_state,
    "lcp": diff_lcp,
}


def main() -> None:
    """Run what is asked for."""
    asked = sys.argv[1] if len(sys.argv) > 1 else "all"
    if asked not in (*EXPERIMENTS, "all"):
        sys.exit(f"unknown experiment {asked!r}; one of {', '.join(EXPERIMENTS)}, all")
    torch.set_num_threads(1)
    for name in EXPERIMENTS if asked == "all" else [asked]:
        begin = time.perf_counter()
        EXPERIMENTS[name]()
        print(f"{name}: {time.perf_counter() - begin:.0f} s\n")


if __name__ == "__main__":
    main()
