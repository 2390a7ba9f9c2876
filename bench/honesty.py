"""Honesty of the answers in worlds that are not the model: python bench/honesty.py [--objects N] [--seed S].

Objects of four to eight blocks, 30 to 60 mm, 0.05 to 0.8 kg, friction 0.15 to 0.9, stand on their own weight in a plain
Coulomb world of its own contact points, offsets, frictions and sensor errors, drawn for each object; in `plastic`
friction departs from Coulomb's law by 10 %. Six turns there and back and six accelerated ones. A row per contact kind:
methods know the spreads of the errors, never the draw. NAD is the median over all answers in percent; then the root
mean square of the errors over that of the bound, the posterior spread by the trials' information at the truth with the
errors of the setup as drawn; that of error over claimed error, the 90 % intervals that hold the truth and
their median width as a part of the object's mass, the answers with status ok, and those of them with a group off by
more than three times its claimed error. In brackets 95 % intervals, by a bootstrap over objects, and for the silent
ones the exact upper bound. Below, the methods paired on the same trials.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.stats import beta
from shared import head_table, parser_of, pooled, show

from estimators.action_selection.design import Guess, prior_belief
from estimators.evaluation.statistics import NINETY
from estimators.identifiability.information import shown_information
from estimators.registry import build_method
from estimators.testing.analytic_lab import LAB, PADS, PATTERNS, RIGID, ROUGH, Draw, contacts, drawn, flawed_trial
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import TableAction
from testbed.actions.rotate import Rotate
from testbed.objects.model import ObjectModel
from testbed.sensing.presets import preset
from testbed.trajectory import Trajectory
from testbed.worlds.presets import UNSTATED
from testbed.worlds.setup_errors import SetupErrors

IDEAL = SetupErrors()
WORLDS = {"ideal": IDEAL, "lab": LAB, "rough": ROUGH, "plastic": replace(LAB, friction_law=0.1)}
SETTINGS = {"explicit_state": {"use_weight": True, "weighting": "covariance"}}


def trials(
    obj: ObjectModel, pattern: str, setup: SetupErrors, stated: SetupErrors, rng: np.random.Generator
) -> tuple[list[Trajectory], float]:
    """Trials of a drawn world and the weight that the scale read."""
    feet, draw = contacts(obj, pattern, setup, rng), Draw.of(setup, rng)
    grasps = [int(g) for g in rng.permutation(len(obj.shape.grasps))]
    chosen = (grasps * 6)[:6]
    beside = obj.shape.cell / 2
    actions: list[TableAction] = [Accelerate(g) for g in chosen]
    for k, g in enumerate(chosen):
        sign = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)][k % 4])
        pivot = obj.shape.grasps[g].position + beside * sign
        actions.append(Rotate(g, duration=6.0, pivot=tuple(pivot), back=True))
    found = [flawed_trial(obj, action, feet, draw, rng) for action in actions]
    weight = obj.total_mass + (0.001 + setup.scale) * rng.standard_normal()
    return [replace(t, setup=stated) for t in found], weight


@dataclass(frozen=True)
class Judged:
    """One answer."""

    index: int
    world: str
    contact: str
    method: str
    status: str
    nad: float
    off: tuple[float, ...]
    """Errors of the masses over those claimed."""
    width: float
    """Median width of the 90 % intervals, as a part of the object's mass."""
    seconds: float
    misfit: float
    errors: tuple[float, ...]
    """Errors of the groups, as parts of the object's mass; empty without an answer."""
    bound: tuple[float, ...]
    """Standard deviations of the groups by the information of the trials, as parts of the object's mass."""


def bound(obj: ObjectModel, made: list[Trajectory], weight: float, setup: SetupErrors, support: str) -> np.ndarray:
    """Standard deviations of the masses of the groups that no estimator can beat on average over setups [kg].

    Those of the posterior by the information of the trials at the true masses and frictions (van Trees' bound).
    """
    guess = Guess(weight, preset("ft300s"), setup=setup, supports=(support,))
    information = shown_information(obj.shape, obj.truth, made, guess.assumptions()[0]).information()
    return np.sqrt(np.diag(prior_belief(obj.shape, guess).after(information[None]).covariance()[0]))


def judged(job: tuple[int, str, str], seed: int, methods: tuple[str, ...], given: SetupErrors | None) -> list[Judged]:
    """Answers of the methods on one object under one contact in one world."""
    index, pattern, world = job
    setup = WORLDS[world]
    obj = drawn(index, seed, pattern)
    rng = np.random.default_rng(seed * 1000 + index)
    made, weight = trials(obj, pattern, setup, given or setup, rng)
    support = "rigid" if pattern in RIGID else "own_weight"
    least = tuple(bound(obj, made, weight, setup, support) / obj.total_mass)
    return [answered(name, obj, made, weight, (index, world, pattern), least) for name in methods]


def answered(
    name: str,
    obj: ObjectModel,
    made: list[Trajectory],
    weight: float,
    labels: tuple[int, str, str],
    least: tuple[float, ...] = (),
) -> Judged:
    """Answer of one method to trials; `labels` are the first fields of the row, `least` its bound."""
    begin = time.process_time()
    found = build_method(name, SETTINGS.get(name, {})).estimate(obj.shape, weight, made, 0)
    spent, misfit = time.process_time() - begin, found.diagnostics.get("misfit", np.nan)
    nad, off, width, errors = np.nan, np.zeros(0), np.nan, ()
    if found.distribution is not None:
        off, claimed = found.distribution.group_mass(obj.shape) - obj.group_mass, found.group_error(obj.shape)
        nad, errors = float(np.abs(off).sum() / obj.total_mass), tuple(off / obj.total_mass)
        if claimed is None:
            off = np.zeros(0)
        else:
            width, bounded = float(np.median(2 * NINETY * claimed) / obj.total_mass), np.isfinite(claimed)
            off = off[bounded] / claimed[bounded]
    return Judged(*labels, name, found.status, nad, tuple(off), width, spent, misfit, errors, least)


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__, objects=20, seed=1, methods=["hidden_states"], workers=2)
    parser.add_argument("--worlds", nargs="+", choices=WORLDS, default=["ideal", "lab", "rough"])
    parser.add_argument("--contacts", nargs="+", default=list(PATTERNS), help=f"{', '.join([*PATTERNS, PADS, *RIGID])}")
    given = parser.add_mutually_exclusive_group()
    given.add_argument("--blind", dest="given", action="store_const", const=IDEAL, help="state that the setup is exact")
    given.add_argument(
        "--unstated", dest="given", action="store_const", const=UNSTATED, help="state nothing of the setup"
    )
    args = parser.parse_args()
    kinds = {world: ["grid"] if world == "ideal" else args.contacts for world in args.worlds}
    jobs = [(i, kind, world) for world in args.worlds for kind in kinds[world] for i in range(args.objects)]
    judge = partial(judged, seed=args.seed, methods=tuple(args.methods), given=args.given)
    rows = [row for part in pooled(judge, jobs, args.workers) for row in part]
    names = ("world", "contacts", "method")
    numbers = ("NAD", "RMSE / bound", "off / claimed", "90 % hold", "width, %", "ok, %", "silent, %", "misfit", "s")
    table = head_table(*names, *numbers, left=names)
    for world in args.worlds:
        for kind in [*kinds[world], "all"] if len(kinds[world]) > 1 else kinds[world]:
            for method in args.methods:
                part = [r for r in rows if (r.world, r.method) == (world, method) and kind in (r.contact, "all")]
                table.add_row(world, kind, method, *summary(part))
    first, *others = args.methods
    lines = [f"{world}: {paired(rows, world, first, method)}" for world in args.worlds for method in others]
    show(table, *lines, width=160)


def paired(rows: list[Judged], world: str, first: str, second: str) -> str:
    """Mean difference of NAD of two methods on the same trials, with its 95 % interval: a bootstrap over objects."""
    nad = {name: [r for r in rows if (r.world, r.method) == (world, name)] for name in (first, second)}
    off = 100 * np.array([b.nad - a.nad for a, b in zip(nad[first], nad[second], strict=True)])
    of_object = np.array([r.index for r in nad[first]])
    objects = np.unique(of_object)
    means = np.array([np.nanmean(off[of_object == index]) for index in objects])
    drawn = np.random.default_rng(0).choice(means, (10_000, len(means))).mean(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"NAD of {second} less that of {first}: {means.mean():.1f} points [{low:.1f}, {high:.1f}]"


def holding(part: list[Judged]) -> str:
    """95 % interval of the share of 90 % intervals that hold: a bootstrap over objects."""
    objects = sorted({r.index for r in part})
    held = np.array([[sum(abs(z) < NINETY for r in part if r.index == i for z in r.off)] for i in objects])
    total = np.array([[sum(len(r.off) for r in part if r.index == i)] for i in objects])
    again = np.random.default_rng(0).integers(len(objects), size=(len(objects), 2000))
    low, high = np.quantile(held[again].sum(0) / total[again].sum(0), [0.025, 0.975])
    return f"[{100 * low:.0f}, {100 * high:.0f}]"


def summary(part: list[Judged]) -> list[str]:
    """Cells of some answers."""
    off = np.concatenate([np.array(r.off) for r in part])
    ok = [r for r in part if r.status == "ok"]
    silent = sum(any(abs(z) > 3 for z in r.off) for r in ok)
    claimed = len(off) > 0
    answered = [r for r in part if r.errors]
    errors, least = (np.concatenate([getattr(r, name) for r in answered]) for name in ("errors", "bound"))
    most = float(beta.ppf(0.975, silent + 1, len(part) - silent)) if silent < len(part) else 1.0
    return [
        f"{100 * np.nanmedian([r.nad for r in part]):.1f}",
        f"{np.sqrt(np.mean(errors**2) / np.mean(least**2)):.2f}",
        f"{np.sqrt(np.mean(off**2)):.2f}" if claimed else "",
        f"{100 * np.mean(np.abs(off) < NINETY):.0f} {holding(part)}" if claimed else "",
        f"{100 * np.nanmedian([r.width for r in part]):.0f}" if claimed else "",
        f"{100 * len(ok) / len(part):.0f}",
        f"{100 * silent / len(part):.1f} [< {100 * most:.1f}]" if claimed else "",
        f"{np.nanmedian([r.misfit for r in part]):.2f}",
        f"{np.mean([r.seconds for r in part]):.2f}",
    ]


if __name__ == "__main__":
    main()
