"""heft import, calibrate and estimate: measured trials, and the answers of the methods."""

from __future__ import annotations

import re
import sys
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from scenarios.cli.terminal import open_console
from testbed.errors import InvalidValueError

if TYPE_CHECKING:
    from estimators.evaluation.statistics import Row
    from scenarios.results.logs import ImportedLog
    from testbed.trajectory import Trajectory


def import_(
    mapping: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MAPPING")],
    logs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[LOG ...]")] = (),
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/lab"),
    weight: Annotated[float | None, tyro.conf.arg(metavar="KG")] = None,
    support: Annotated[str | None, tyro.conf.arg(metavar="SUPPORT")] = None,
    find: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    grasps: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = (),
) -> None:
    """Import another robot's logs (CSV, Parquet, HDF5, MCAP, ROS 2 bags) as trials.

    MAPPING is a TOML file that names the columns, their units and the actions; docs/own_logs.md has an example. All
    errors are listed at once, and nothing is written if there are any. Importing a log, or a stretch of it, again
    replaces its earlier trial of that object; one of another object stays, and is named. Exit code: 1 if a trial is
    unusable or contradicts its action, or if --find cannot read a log.

    Examples: heft import lab.toml turn_1.csv turn_2.csv --weight 1.8
              heft import lab.toml                 (the logs that its [[logs]] name)
              heft import lab.toml day_1.mcap --find   (finds the actions in a long recording, for review)
              heft estimate results/lab

    Args:
        mapping: TOML file.
        logs: tables, .mcap files or ROS 2 bags, one per trial; default: the logs that the mapping names.
        out: results folder for the trials.
        weight: mass of the object as read from a scale, kg; every method needs it once.
        support: support of the object, if known: own_weight, rigid, or a stiffness in N/m; default: rigid for an object
            with contact points, otherwise own_weight.
        find: print the tares, turns, slides and pushes found in the logs, and write MAPPING with one [[logs]] table per
            action as *.found.toml, if there is none yet, to be reviewed and imported; nothing is imported.
        grasps: with --find, grasps of the first actions, where the motion is consistent with several.
    """
    if grasps and not find:
        raise InvalidValueError(
            "--grasps", list(grasps), "only with --find; otherwise a mapping names the grasp of its action"
        )
    if find:
        from scenarios.cli.find import show_found

        if not show_found(mapping, logs, grasps):
            sys.exit(1)
        return
    from scenarios.cli.run import show_progress
    from scenarios.results.logs import import_logs
    from scenarios.results.trials import is_weighed
    from testbed.robot.calibration.motion import wrong_motion

    with show_progress() as progress:
        imported = import_logs(mapping, logs, out, support, weight, progress)
    unused = [_reason_unused(log.trajectory) for log in imported]
    for log, why in zip(imported, unused, strict=True):
        print(_summary(log, why))
    model = imported[0].object
    wrong = wrong_motion(model.shape, [log.trajectory for log in imported])
    for text in wrong:
        print(f"wrong   {text}")
    bad, name = sum(not log.trajectory.ok for log in imported), model.name
    state = f"{bad} of them not usable" if bad else "all usable" if not wrong else "contradicting their actions"
    scale = "" if is_weighed(out, name) else f", after importing with the weight of {name}: --weight KG"
    useless = all(not log.trajectory.ok or why for log, why in zip(imported, unused, strict=True))
    after = (
        "see the messages about the trials above"
        if useless or 2 * bad > len(imported)
        else f"heft estimate {out}{scale}"
    )
    if wrong:
        after = f"correct {mapping}, its units and signs too, and import again"
    print(f"{len(imported)} trial{'s' * (len(imported) > 1)} of {name} in {out}, {state}; next: {after}")
    if bad or wrong:
        sys.exit(1)


def calibrate(
    mapping: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MAPPING")],
    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")],
    *,
    gain_error: Annotated[float, tyro.conf.arg(metavar="PART")] = 0.0,
    sensor: Annotated[str, tyro.conf.arg(metavar="SERIAL")] = "unknown",
    out: Annotated[Path, tyro.conf.arg(metavar="FILE.toml")] = Path("calibration.toml"),
    figure: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Calibrate a force/torque sensor from a recording: mounting, sign, bias and gains, and the tool below it.

    In the recording, the arm holds still in six or more poses for at least two seconds each, tilted by at least 30
    degrees about two axes and in both directions, one pose upside down or level; or it moves slowly through as many;
    or LOG is a table with one row per pose (rows = "poses" in MAPPING). The tables [time], [sensor] and [hand] of
    MAPPING are read, except for the sign and mounting, which are estimated. To use the result in heft import, name the
    file as `calibration` in the [sensor] table of a mapping.

    Examples: heft calibrate lab.toml poses.csv
              heft calibrate lab.toml poses.mcap --gain-error 0.02 --figure results/residuals

    Args:
        mapping: TOML file that names the columns, as for heft import.
        log: table, .mcap file or ROS 2 bag.
        gain_error: relative standard deviation of the gain of each axis; 0 treats the gains as exact.
        sensor: serial number of the sensor, stored in the file.
        out: file to write.
        figure: plot of the residuals at every pose, written as FILE.pdf and FILE.png.
    """
    from testbed.importers.columns import Columns
    from testbed.robot.calibration.file import save_calibration
    from testbed.robot.calibration.recorded_poses import recorded_poses
    from testbed.robot.calibration.static_poses import calibrate as fit
    from testbed.robot.calibration.static_poses import sentences
    from testbed.toml import load_toml

    poses, left_out = recorded_poses(log, mapping)
    found = fit(poses, gain_error, load_toml(mapping, Columns).gravity)
    print(f"{len(poses)} poses, misfit {found.misfit:.2g} in place of 1")
    if left_out:
        print(f"left out of the wrench: {left_out}")
    for sentence in sentences(found):
        print(sentence)
    save_calibration(out, found, sensor, f"{datetime.now(UTC):%Y-%m-%d}")
    print(out)
    if figure is not None:
        from viz.figures.calibration import calibration_figure
        from viz.figures.maps import save_figure

        for path in save_figure(calibration_figure(found, poses), figure):
            print(path)


def _summary(log: ImportedLog, unused: str) -> str:
    """Content of a log in words, for the operator to check; `unused` is the reason why no estimate uses it."""
    from testbed.replay import Recording

    trajectory, facts = log.trajectory, log.trajectory.provenance
    why = f": {trajectory.reason}" if trajectory.reason else ""
    action = Recording(log.path, trajectory.action, log.object.name, None).description
    return (
        f"{trajectory.status:8}{log.place}: {action}: trial {log.key[:8]}{why}\n"
        f"        {trajectory.time_s[-1]:.1f} s; phases {facts['phases']}; velocity {facts['velocity']}; "
        f"joints {facts['joints']}\n        drift: {facts['drift']}"
        + (f"\n        delay of the wrench: {facts['delay']}" if "delay" in facts else "")
        + (f"\n        left out of the wrench: {facts['left out']}" if "left out" in facts else "")
        + (f"\n        no estimate uses it: {unused}" if unused else "")
        + "".join(f"\n        replaces trial {key[:8]}" for key in log.replaced)
        + "".join(
            f"\n        trials/{key} is of another file of this name, and counts too: if it is the same recording, "
            "delete that folder"
            for key in log.alike
        )
        + "".join(
            f"\n        trials/{key} is of the same stretch, but of the object {name}, and counts for it: if {name} is "
            "the wrong object, delete that folder"
            for key, name in log.of_others.items()
        )
    )


def _reason_unused(trajectory: Trajectory) -> str:
    """Reason why a usable trial has no window for an estimate; empty if it has one."""
    from testbed.sensing.push_windows import window_samples

    if not trajectory.ok:
        return ""
    try:
        window_samples(trajectory)
    except InvalidValueError as error:
        return f"{error.given}; allowed: {error.allowed}"
    return ""


def _trials_named(folder: Path, row: Row, message: str) -> list[str]:
    """Descriptions of the trials that a message names by their numbers."""
    from scenarios.results.table import has_files
    from scenarios.results.trials import trials_behind, trials_in_words
    from scenarios.views.values import estimate_view

    numbers = sorted({int(number) for number in re.findall(r"trial (\d+)", message)})
    if not (numbers and has_files(row)):
        return []
    shape, keys = estimate_view(folder, row).shape, tuple(row["trial_keys"])
    words = trials_in_words(folder, shape, keys[1:], trials_behind(folder, row)[1:])
    return [words[number - 1] for number in numbers if number <= len(words)]


def estimate(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    *,
    objects: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME ...")] = None,
    methods: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="METHOD ...")] = None,
    scenario: Annotated[str, tyro.conf.arg(metavar="SCENARIO")] = "blocks",
    held_out: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    allow_code: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Estimate masses with intervals from the measured trials of a folder, with every method, and write a report.

    Prints a map of the first answer and suggests the next step. The trials come from heft robot trial and heft import
    and are used as measured, without simulated sensor errors; unusable ones are skipped. The last weighing counts.
    masses.csv and masses.json contain the numbers. If the object file states masses, the NAD is computed against
    them.

    Exit code: 1 if a method failed or had no data.

    Examples: heft estimate results/robot --methods hidden_states explicit_state_M
              heft estimate results/lab --scenario my/scenario.toml --held-out 2

    Args:
        folder: results folder with measured trials.
        objects: names of the objects; default: all.
        methods: labels of methods in the scenario, or other methods by name or package:Class; default: all of the
            scenario.
        scenario: scenario that defines the methods and their settings: name in the library, or path to a TOML file.
        held_out: number of last turns withheld from every method, to compute the mean particle distance.
        workers: number of worker processes; default: one per core. 0 runs everything in this process.
        allow_code: allow the scenario to load classes from the current folder; --methods needs no permission.
    """
    from estimators.base import NO_MASSES
    from scenarios.cli.run import show_main_table, show_progress
    from scenarios.study.run import EstimateRequest, estimate_measured
    from scenarios.views.answers import answers_of, write_answers
    from scenarios.views.next_step import next_step
    from scenarios.views.report import report
    from testbed.plugins import find_code_here
    from viz.report.answers import answer_table
    from viz.report.mass_map import mass_map
    from viz.report.terminal import rich_table

    if allow_code or any(":" in method for method in methods or ()):
        find_code_here()
    console = open_console()
    request = EstimateRequest(objects, methods, scenario, held_out, workers, allow_code)
    with ExitStack() as stack:
        with show_progress() as progress:
            done = stack.enter_context(estimate_measured(folder, request, progress))
        for line in done.left_out:
            print(line)
        groups = answers_of(folder, done.rows)
        for answers in groups:
            console.print(rich_table(answer_table(answers)))
            for answer in answers:
                if answer.evidence:
                    print(f"support, by {answer.method}: {answer.evidence}")
            if best := next((answer for answer in answers if answer.distribution is not None), None):
                console.print(mass_map(best))
                print(next_step(folder, done.rows, best))
        if any(row.get("nad") is not None for row in done.rows):
            show_main_table(console, done.scenario, done.rows)
        for path in write_answers(folder, groups):
            print(path)
        print(f"report: {report(folder)}; heft view {folder} shows the maps")
    bad = [row for row in done.rows if row["status"] != "ok"]
    for row in bad:
        message = row.get("message") or ""
        print(f"{row['object']}, {row['support']}, {row['method']}: {row['status']}: {message}")
        for words in _trials_named(folder, row, message):
            print(f"  trial {words}")
    if any(row.get("mass_kg") is None and row["status"] not in NO_MASSES for row in bad):
        sys.exit(1)
