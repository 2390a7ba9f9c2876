"""heft import, calibrate, estimate: measured trials in, the methods' answers to them out."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from scenarios.cli.terminal import open_console
from testbed.errors import InvalidValueError

if TYPE_CHECKING:
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
    """Read another robot's logs (CSV, Parquet, HDF5, MCAP, ROS 2 bags) as trials, for every method.

    MAPPING is a TOML file that says which column is what, in which unit, and what was done: docs/formats.md has one to
    begin with. All errors are listed at once, and then nothing is written. A log that is imported again, by a
    corrected mapping, takes the place of its earlier import. Exit code: 1 where a trial is no data, or --find cannot
    read a log.

    Examples: heft import lab.toml turn_1.csv turn_2.csv --weight 1.8
              heft import lab.toml                 (the logs that its [[logs]] name)
              heft import lab.toml day_1.mcap --find   (finds the actions of a long recording, for you to look through)
              heft estimate results/lab

    Args:
        mapping: TOML file.
        logs: tables, .mcap files or ROS 2 bags, one a trial; those that the mapping names if left out.
        out: results folder to put the trials into.
        weight: mass of the object as a scale read it; every method needs it once.
        support: support of the object's weight, as far as you know: own_weight, rigid, or a stiffness in N/m; if
            left out, rigid for an object on points of contact, else own_weight.
        find: print the tares, turns, slides and pushes that the logs hold, and write MAPPING with a [[logs]] table for
            each action as *.found.toml, to be corrected and imported; nothing is imported.
        grasps: with --find, grasps of the first actions, where the motion fits several.
    """
    if find or grasps:
        from scenarios.cli.find import show_found

        if not show_found(mapping, logs, grasps):
            sys.exit(1)
        return
    from scenarios.cli.run import show_progress
    from scenarios.results.logs import import_logs
    from testbed.robot.calibration.motion import wrong_motion

    with show_progress() as progress:
        imported = import_logs(mapping, logs, out, support, weight, progress)
    for log in imported:
        print(_summary(log))
    model = imported[0].object
    for text in wrong_motion(model.shape, [log.trajectory for log in imported]):
        print(f"wrong   {text}")
    bad, name = sum(not log.trajectory.ok for log in imported), imported[0].object.name
    print(
        f"{len(imported)} trial{'s' * (len(imported) > 1)} of {name} in {out}, "
        f"{f'{bad} of them not usable' if bad else 'all usable'}; next: heft estimate {out}"
        + ("" if weight is not None else f", once it knows what {name} weighs: --weight KG"),
    )
    if bad:
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
    """Calibrate a force/torque sensor from a recording: its mount, sign, bias and gains, and the tool below it.

    In the recording the arm holds still in six or more poses, for two seconds or more, tilted by 30 degrees and more
    about two axes and both ways, one of them upside down or level; or it moves slowly through as many; or LOG is a
    table with one row per pose (rows = "poses" in MAPPING). Of MAPPING, [time], [sensor] and [hand] are read; the
    sign and the mount there do not count, for they are found. With the file that is written named as `calibration` in
    the [sensor] table of a mapping, heft import uses it.

    Examples: heft calibrate lab.toml poses.csv
              heft calibrate lab.toml poses.mcap --gain-error 0.02 --figure results/residuals

    Args:
        mapping: TOML file that says which column is what, as for heft import.
        log: table, .mcap file or ROS 2 bag.
        gain_error: standard deviation of each axis' gain, as a part of itself; 0 takes the gains as exact.
        sensor: serial number of the sensor, for the file.
        out: file to write.
        figure: readings less model at every pose, written as FILE.pdf and FILE.png.
    """
    from testbed.importers.columns import Columns
    from testbed.robot.calibration.file import save_calibration
    from testbed.robot.calibration.recorded_poses import recorded_poses
    from testbed.robot.calibration.static_poses import calibrate as fit
    from testbed.robot.calibration.static_poses import in_words
    from testbed.toml import load_toml

    poses, left_out = recorded_poses(log, mapping)
    found = fit(poses, gain_error, load_toml(mapping, Columns).gravity)
    print(f"{len(poses)} poses, misfit {found.misfit:.2g} in place of 1")
    if left_out:
        print(f"left out of the wrench: {left_out}")
    for sentence in in_words(found):
        print(sentence)
    save_calibration(out, found, sensor, f"{datetime.now(UTC):%Y-%m-%d}")
    print(out)
    if figure is not None:
        from viz.figures.calibration import calibration_figure
        from viz.figures.maps import save_figure

        for path in save_figure(calibration_figure(found, poses), figure):
            print(path)


def _summary(log: ImportedLog) -> str:
    """Reading of a log in words, for the operator to check."""
    from testbed.replay import Recording

    trajectory, facts = log.trajectory, log.trajectory.provenance
    why = f": {trajectory.reason}" if trajectory.reason else ""
    action = Recording(log.path, trajectory.action, log.object.name, None).description
    nothing = _shows_nothing(trajectory)
    return (
        f"{trajectory.status:8}{log.place}: {action}: trial {log.key[:8]}{why}\n"
        f"        {trajectory.time_s[-1]:.1f} s; phases {facts['phases']}; velocity {facts['velocity']}; "
        f"joints {facts['joints']}\n        drift: {facts['drift']}"
        + (f"\n        delay of the wrench: {facts['delay']}" if "delay" in facts else "")
        + (f"\n        left out of the wrench: {facts['left out']}" if "left out" in facts else "")
        + (f"\n        no estimate uses it: {nothing}" if nothing else "")
    )


def _shows_nothing(trajectory: Trajectory) -> str:
    """Reason why a trial that is data has no window for an estimate; empty if it has one."""
    from testbed.sensing.push_windows import window_samples

    if not trajectory.ok:
        return ""
    try:
        window_samples(trajectory)
    except InvalidValueError as error:
        return f"{error.given}; allowed: {error.allowed}"
    return ""


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
    """Estimate from the measured trials of a folder by every method: masses with their intervals, and a report.

    Then a map of the first answer, and what to do next. The trials are those of heft robot trial and heft import, as
    they were measured: no sensor's errors are drawn. Those that are no data are left out. The last weighing counts.
    masses.csv and masses.json hold the numbers. Masses in the object's file are taken for the truth that the NAD is
    against.

    Exit code: 1 where some method failed or had no data.

    Examples: heft estimate results/robot --methods hidden_states explicit_state_M
              heft estimate results/lab --scenario my/scenario.toml --held-out 2

    Args:
        folder: results folder with measured trials.
        objects: names of the objects; all if left out.
        methods: labels of the scenario's methods, instead of all; or others: by name, or package:Class.
        scenario: scenario of the methods and their settings: name in the library, or path to a TOML file.
        held_out: last turns that no method is given, for the mean particle distance.
        workers: worker processes; one a core if left out, 0 runs everything in this process.
        allow_code: run classes of the current folder that the scenario names; those of --methods need no leave.
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
        line = f"{row['object']}, {row['support']}, {row['method']}: {row['status']}: {row.get('message') or ''}"
        print(line)
    if any(row.get("mass_kg") is None and row["status"] not in NO_MASSES for row in bad):
        sys.exit(1)
