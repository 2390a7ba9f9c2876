"""heft doctor: what is wrong with a setup, from how the trials of a folder disagree."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from testbed.errors import InvalidValueError

if TYPE_CHECKING:
    from estimators.evaluation.statistics import Row
    from estimators.particles.misfit import Misfit

MOST_LISTED = 8
"""Causes in the table."""


def doctor(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    objects: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[OBJECT ...]")] = (),
    *,
    draw: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
) -> None:
    """Say what is wrong with a setup, from how its trials disagree.

    DIR is a results folder with estimates: of `heft run`, or of `heft estimate` on imported logs or the robot's trials.
    Of each object under each support and sensor it fits Algorithm 1's masses, and tells the misfit (about 1 where the
    masses explain the trials), the misfit of each trial, and what each error of the setup would explain if it were the
    only one: how large it would be, and what to check. A figure goes to DIR/figures.

    Examples: heft doctor results/lab
              heft doctor results/blocks L2 --draw 1

    Args:
        folder: results folder.
        objects: objects to look at; all if left out.
        draw: draw of the sensor's errors of simulated trials.
    """
    from scenarios.cli.terminal import open_console
    from scenarios.results.estimates import load_rows
    from scenarios.results.files import inside
    from scenarios.views.figures import file_name
    from viz.figures.doctor import misfit_figure
    from viz.figures.maps import save_figure

    rows = [row for row in load_rows(folder) if row.get("trial_keys") is not None and row["seed"] == draw]
    known = list(dict.fromkeys(str(row["object"]) for row in rows))
    for name in objects:
        if name not in known:
            raise InvalidValueError("OBJECT", name, f"one of {', '.join(known) or 'none: no estimate is done'}")
    console, asked = open_console(), set[tuple[str, ...]]()
    for row in rows:
        keys = (*row["trial_keys"], row["sensing"])
        if keys in asked or (objects and row["object"] not in objects):
            continue
        asked.add(keys)
        title, trials, misfit, why = _diagnosed(folder, row)
        console.print(f"{title}: {why if misfit is None else _verdict(misfit)}", style="bold")
        if misfit is not None:
            console.print(_table(misfit, trials))
            name = file_name(f"doctor_{row['object']}_{row['key'][:8]}")
            files = save_figure(misfit_figure(misfit, trials, title), inside(folder, "figures", name))
            console.print(f"figure: {files[0]}")
    if not asked:
        raise InvalidValueError("--draw", draw, "a draw that the folder has estimates of")


def _diagnosed(folder: Path, row: Row) -> tuple[str, list[str], Misfit | None, str]:
    """Title of an experiment, its trials in words, and their misfit or why there is none."""
    from estimators.hidden_states.estimator import HiddenStates
    from scenarios.results.store import Store
    from scenarios.results.trials import sensed_trials
    from scenarios.views.values import estimate_view
    from testbed.sensing.windows import weight_of

    shape = estimate_view(folder, row).shape
    weighing, *moved = sensed_trials(Store(folder), tuple(row["trial_keys"]), row["sensing"], int(row["seed"]))
    found, misfit = HiddenStates().diagnose(shape, weight_of(weighing), moved)
    title = f"{row['object']}, {row['support'].replace('_', ' ')}, {row['sensing']}"
    words = [f"{i}: {trial.action.describe(shape)}" for i, trial in enumerate(moved, start=1)]
    return title, words, misfit, f"{found.status}: {found.message}"


def _verdict(misfit: Misfit) -> str:
    from estimators.particles.misfit import CAUSES, inertia_in_words

    if misfit.by_chance:
        return f"misfit {misfit.value:.2g}: the trials agree within the errors stated"
    if misfit.inertia is not None:
        return f"misfit {misfit.value:.2g} in place of 1; {inertia_in_words(misfit.inertia)}"
    name, cause = next(iter(misfit.explained.items()))
    size, words = CAUSES[name].formatted(cause.size), CAUSES[name].cause
    return f"misfit {misfit.value:.2g} in place of 1; likeliest, {size}: {words}"


def _table(misfit: Misfit, trials: list[str]):
    from rich import box
    from rich.table import Table

    from estimators.particles.misfit import CAUSES

    table = Table(box=box.SIMPLE_HEAD)
    for column in ("alone, it would explain", "with", "if so"):
        table.add_column(column, justify="right" if column != "if so" else "left")
    for name, cause in list(misfit.explained.items())[:MOST_LISTED]:
        table.add_row(f"{100 * cause.part:.0f} %", CAUSES[name].formatted(cause.size), CAUSES[name].cause)
    worst = sorted(misfit.trials, key=lambda trial: -misfit.trials[trial])[:3]
    table.caption = "trials that fit least: " + "; ".join(f"{trials[k]} ({misfit.trials[k]:.2g})" for k in worst)
    return table
