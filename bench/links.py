"""Tables of what trials of objects in links show: python bench/links.py [--objects N] [--workers N].

Drawn chains of two or three links, one to three blocks each, with random masses, friction, and hinges of up to 15 mN m.
Each is slid and turned eight times at random (`random`), and for as long by a greedy plan for an FT-300S and its camera
(`planned`), which knows its shape and weight alone. The first table has the number of chains all of whose masses,
frictions and hinges are seen by so many slides, turns, or both, by their expected errors under an FT-300S and a camera
that sees exactly: of a mass less than the whole object's, of a hinge less than the most that a drawn one has.
The second has answers of `hidden_states`: chains with status ok, median NAD of the masses and median error of
the hinges over their mean, in percent, and the 90 % intervals of masses that hold.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
import torch
from pushes import SENSORS, Judged, answered, compared, made, planned
from rich import box
from rich.console import Console
from rich.table import Table

from estimators.action_selection.cost import spent_seconds
from estimators.action_selection.drags import RandomDrags, random_drags
from estimators.evaluation.metrics import hinge_columns
from estimators.identifiability.information import Assumptions, expected
from estimators.testing.analytic_links import drawn_chain
from testbed.actions.base import Action
from testbed.objects.model import ObjectModel
from testbed.sensing.presets import preset
from testbed.trajectory import Trajectory

COUNTS = (1, 2, 3, 4, 6, 8)
"""Numbers of actions of the first table."""
KINDS = {"slides": slice(0, None, 2), "turns": slice(1, None, 2), "both": slice(None)}
"""Kinds of actions among random ones."""
DRAGS = 8
"""Random slides and turns of each chain."""
MOST_FRICTION = 0.015
"""Greatest friction of a drawn hinge [N m]."""


class Found(NamedTuple):
    """Findings of the trials of one chain."""

    links: int
    seconds: float
    """Robot time of its random trials [s]."""
    seen: dict[tuple[str, int], bool]
    """True where so many actions of a kind show everything."""
    answers: dict[tuple[str, str], tuple[Judged, float]]
    """Answers by sensor and trials, each with its error of the hinges [%]."""


def judged(model: ObjectModel, clean: Sequence[Trajectory], sensor: str) -> tuple[Judged, float]:
    """The answer from trials under one draw of a sensor, and its error of the hinges [%]."""
    found = answered(model, clean, sensor)
    return compared(model, found), 100 * hinge_columns(model.hinge_friction, found.diagnostics)["hinge_error"]


def shown(index: int) -> Found:
    """Findings of a chain, by actions and by answers."""
    torch.set_num_threads(1)
    model = drawn_chain(index, most_hinge_friction=MOST_FRICTION)
    shape, grasps = model.shape, tuple(range(len(model.shape.grasps)))
    drawn = random_drags(shape, grasps, 2 * max(COUNTS), index)
    assumed = Assumptions(hinge_friction=model.hinge_friction)
    seen = {}
    for kind, of in KINDS.items():
        for count in COUNTS:
            report = expected(shape, model.truth, drawn[of][:count], preset(SENSORS[1]), assumed)
            seen[kind, count] = report.rank == report.unknowns and max(report.hinge_error) < MOST_FRICTION
    refused: dict[Action, str] = {}
    trials = {"random": made(model, RandomDrags(DRAGS, seed=index, refused=refused), refused, np.inf)}
    seconds = spent_seconds(shape, trials["random"])
    trials["planned"] = planned(model, seconds, grasps, pushes=False)
    answers = {(sensor, kind): judged(model, each, sensor) for sensor in SENSORS for kind, each in trials.items()}
    assert shape.chain is not None
    return Found(shape.chain.links, seconds, seen, answers)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    every: list[Found] = []
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        for index, found in enumerate(pool.map(shown, range(given.objects))):
            nads = " ".join(f"{one.nad:.2g}" for one, _ in found.answers.values())
            print(f"chain {index}, {found.links} links, {found.seconds:.0f} s: {nads}", flush=True)
            every.append(found)
    console = Console(width=110)
    table = Table(box=box.SIMPLE, title=f"Chains of {len(every)} of which everything is seen, by number of actions")
    for heading in ("actions", *map(str, COUNTS)):
        table.add_column(heading, justify="left" if heading == "actions" else "right")
    for kind in KINDS:
        table.add_row(kind, *(str(sum(found.seen[kind, count] for found in every)) for count in COUNTS))
    console.print(table)
    seconds = np.median([found.seconds for found in every])
    table = Table(box=box.SIMPLE, title=f"In equal robot time, {seconds:.0f} s in the median")
    for heading in ("sensor", "links", "trials", "ok", "NAD, %", "hinges, %", "90 % hold"):
        table.add_column(heading, justify="left" if heading in ("sensor", "trials") else "right")
    for sensor in SENSORS:
        for links in (2, 3):
            for kind in ("random", "planned"):
                each = [found.answers[sensor, kind] for found in every if found.links == links]
                known = [(one.nad, hinges, one.hold) for one, hinges in each if one.ok]
                if not known:
                    continue
                (nad, hinges, _), hold = np.nanmedian(known, axis=0), 100 * np.mean(known, axis=0)[2]
                ok = f"{len(known)} of {len(each)}"
                table.add_row(sensor, str(links), kind, ok, f"{nad:.2g}", f"{hinges:.2g}", f"{hold:.0f}")
    console.print(table)


if __name__ == "__main__":
    main()
