"""heft doctor: errors of a setup, diagnosed from how the trials of a folder disagree."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from testbed.errors import InvalidValueError

if TYPE_CHECKING:
    from estimators.evaluation.statistics import Row
    from estimators.posterior.diagnosis import Diagnosis
    from scenarios.study.experiment import Progress

MOST_LISTED = 8
"""Number of causes in the table."""
NOTHING = "no usable trial slides, turns or is pushed at constant speed"


def doctor(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    objects: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[OBJECT ...]")] = (),
    *,
    draw: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
) -> None:
    """Diagnose a setup from how its trials disagree.

    DIR is a results folder with estimates, from `heft run` or from `heft estimate` on imported or robot trials. First
    come trials whose motion or friction contradicts their actions, with what to correct. Otherwise, for each object,
    support and sensor, the joint posterior (method bayes) is fitted and the misfit printed: about 1 if the
    masses explain the trials within the stated errors. Otherwise three causes are tested in order: another support (one
    rigid body, or springs between blocks); a single inconsistent trial; an error of the setup larger than stated, with
    its size and what to check. A figure is written to DIR/figures.

    Examples: heft doctor results/lab
              heft doctor results/blocks L2 --draw 1

    Args:
        folder: results folder.
        objects: objects to diagnose; default: all.
        draw: index of the sensor-error draw of simulated trials.
    """
    from scenarios.cli.run import show_progress
    from scenarios.cli.terminal import open_console
    from scenarios.results.estimates import load_rows
    from scenarios.results.files import check_results, inside
    from scenarios.views.figures import file_name
    from viz.figures.doctor import diagnosis_figure
    from viz.figures.maps import save_figure

    check_results(folder)
    if not (rows := load_rows(folder)):
        raise InvalidValueError("DIR", folder, "a results folder with estimates: heft run, heft touch or heft estimate")
    done = [row for row in rows if row.get("trial_keys") is not None]
    known = list(dict.fromkeys(str(row["object"]) for row in done))
    for name in objects:
        if name not in known:
            raise InvalidValueError("OBJECT", name, f"one of {', '.join(known) or 'none: no estimate is done'}")
    chosen = [row for row in done if not objects or row["object"] in objects]
    console, diagnosed = open_console(), set[tuple[str, ...]]()
    for row in chosen:
        keys = (*row["trial_keys"], row["sensing"])
        if keys in diagnosed or row["seed"] != draw:
            continue
        diagnosed.add(keys)
        with show_progress() as progress:
            title, trials, found = _diagnosed(folder, row, progress)
        console.print(f"{title}: {found if isinstance(found, str) else found.verdict}", style="bold")
        if not isinstance(found, str):
            if found.named or not found.misfit.by_chance:
                console.print(_table(found))
            worst = sorted(found.trials.items(), key=lambda each: -each[1])[:3]
            least = "; ".join(f"{trials[k]} ({misfit:.2g})" for k, misfit in worst)
            console.print(f"trials that fit least: {least}")
            name = file_name(f"doctor_{row['object']}_{row['key'][:8]}")
            files = save_figure(diagnosis_figure(found, trials, title), inside(folder, "figures", name))
            console.print(f"figure: {files[0]}")
    if not diagnosed:
        if draws := sorted({int(row["seed"]) for row in chosen}):
            allowed = f"a draw that the folder has estimates of: {', '.join(map(str, draws))}"
            raise InvalidValueError("--draw", draw, allowed)
        raise InvalidValueError("DIR", folder, f"a folder with an answer; it has none (heft status {folder})")


def _diagnosed(folder: Path, row: Row, progress: Progress) -> tuple[str, list[str], Diagnosis | str]:
    """Title of an experiment, its trials in words, and their diagnosis, or the reason why there is none."""
    from estimators.posterior.diagnosis import diagnose
    from scenarios.results.trials import trials_behind, trials_in_words
    from scenarios.views.values import estimate_view
    from testbed.robot.calibration.motion import wrong_motion
    from testbed.sensing.windows import weight_of

    shape, keys = estimate_view(folder, row).shape, tuple(row["trial_keys"])
    weighing, *moved = trials_behind(folder, row)
    title = f"{row['object']}, {row['support'].replace('_', ' ')}, {row['sensing']}"
    words = trials_in_words(folder, shape, keys[1:], moved)
    if wrong := wrong_motion(shape, moved):
        return title, words, "; ".join(["the trials are not what their actions say", *wrong])
    return title, words, diagnose(shape, weight_of(weighing), moved, partial(progress, "fits")) or NOTHING


def _table(found: Diagnosis):
    from rich import box

    from estimators.posterior.posterior import CAUSES
    from scenarios.cli.terminal import open_table

    columns = ("error", "odds of being larger than stated", "size", "what to check")
    table = open_table(*columns, left=("error", "what to check"), box=box.SIMPLE_HEAD)
    for cause in found.causes[:MOST_LISTED]:
        table.add_row(cause.name.replace("_", " "), odds(cause.odds), cause.formatted, CAUSES[cause.name].cause)
    return table


def odds(log10: float) -> str:
    """Odds in words, from their decimal logarithm."""
    if log10 > 4:
        return f"10^{log10:.0f} : 1"
    return f"{10**log10:.0f} : 1" if log10 > 0 else f"1 : {10**-log10:.0f}"
