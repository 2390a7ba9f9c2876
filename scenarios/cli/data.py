"""heft import, calibrate, estimate, export: measured trials in, the methods' answers to them, an answer out."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from scenarios.cli.terminal import open_console
from testbed.errors import InvalidValueError

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pandas as pd

    from estimators.evaluation.statistics import Row
    from scenarios.results.logs import ImportedLog
    from testbed.objects.export import Exported

_ENDING = {"mjcf": "xml", "urdf": "urdf", "toml": "toml"}


def import_(
    mapping: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MAPPING")],
    logs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[LOG ...]")] = (),
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/lab"),
    weight: Annotated[float | None, tyro.conf.arg(metavar="KG")] = None,
    support: Annotated[str, tyro.conf.arg(metavar="SUPPORT")] = "own_weight",
) -> None:
    """Read another robot's logs (tables, MCAP, ROS 2 bags) as trials, for every method.

    MAPPING is a TOML file that says which column is what, in which unit, and what was done: docs/formats.md has one to
    begin with. All errors are listed at once, and then nothing is written. A log that is imported again, by a
    corrected mapping, takes the place of its earlier import. Exit code: 1 where a trial is no data.

    Examples: heft import lab.toml turn_1.csv turn_2.csv --weight 1.8
              heft import lab.toml                 (the logs that its [[logs]] name)
              heft estimate results/lab

    Args:
        mapping: TOML file.
        logs: tables, .mcap files or ROS 2 bags, one a trial; those that the mapping names if left out.
        out: results folder to put the trials into.
        weight: mass of the object as a scale read it; every method needs it once.
        support: support of the object's weight, as far as you know: own_weight, rigid, or a stiffness in N/m.
    """
    from scenarios.cli.run import show_progress
    from scenarios.results.logs import import_logs
    from testbed.robot.calibration.motion import check_motion

    with show_progress() as progress:
        imported = import_logs(mapping, logs, out, support, weight, progress)
    for log in imported:
        print(_summary(log))
    model = imported[0].object
    for finding in check_motion(model.shape, [log.trajectory for log in imported]):
        if not finding.ok:
            print(f"wrong   {finding.text}")
    bad, name = sum(not log.trajectory.ok for log in imported), imported[0].object.name
    print(
        f"{len(imported)} trial{'s' * (len(imported) > 1)} of {name} in {out}, {bad} of them no data; "
        f"heft estimate {out} asks every method"
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
    about two axes and both ways, one of them upside down or level; or it moves slowly through as many. Of MAPPING,
    [time], [sensor] and [hand] are read; the sign and the mount there do not count, for they are found. With the
    file that is written named as `calibration` in the [sensor] table of a mapping, heft import reckons with it.

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
    from testbed.importers.still import recorded_poses
    from testbed.robot.calibration.file import save_calibration
    from testbed.robot.calibration.static_poses import calibrate as fit
    from testbed.robot.calibration.static_poses import in_words

    poses = recorded_poses(log, mapping)
    found = fit(poses, gain_error)
    print(f"{len(poses)} poses, misfit {found.misfit:.2g} in place of 1")
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
    return (
        f"{trajectory.status:8}{log.path}: {action}: trial {log.key[:8]}{why}\n"
        f"        {trajectory.time_s[-1]:.1f} s; phases {facts['phases']}; velocity {facts['velocity']}; "
        f"joints {facts['joints']}\n        drift: {facts['drift']}"
        + (f"\n        delay of the wrench: {facts['delay']}" if "delay" in facts else "")
    )


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
    from scenarios.cli.run import show_progress, show_tables
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
            show_tables(console, done.scenario, done.rows)
        for path in write_answers(folder, groups):
            print(path)
        print(f"report: {report(folder)}; heft view {folder} shows the maps")
    bad = [row for row in done.rows if row["status"] != "ok"]
    for row in bad:
        line = f"{row['object']}, {row['support']}, {row['method']}: {row['status']}: {row.get('message') or ''}"
        print(line)
    if any(row.get("mass_kg") is None and row["status"] not in NO_MASSES for row in bad):
        sys.exit(1)


def export(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ESTIMATE")],
    *,
    format_: Annotated[Literal["mjcf", "urdf", "toml"], tyro.conf.arg(name="format")] = "mjcf",
    inertial: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    draws: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    models: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Write an estimate for another simulator: a box a block. A JSON beside it says how sure every mass is.

    Examples: heft export results/blocks 3f9a
              heft export results/blocks 3f9a --format urdf --inertial --out my_robot/hammer.urdf
              heft export results/blocks 3f9a --draws 500
              heft export results/blocks 3f9a --draws 100 --models

    Args:
        folder: of a run.
        what: beginning of an estimate's key (see its report).
        format_: mjcf, urdf, or toml: an object file that heft itself can run.
        inertial: one mass, centre and inertia for the whole object instead.
        draws: write N draws of masses and frictions from the posterior too, as CSV; of an estimate by Algorithm 1.
        models: write each draw as a model too, numbered in a folder, to train or test a controller on all of them.
        out: DIR/exports/OBJECT_KEY if left out, with the format's ending.
    """
    from scenarios.results.estimates import row_of
    from scenarios.results.files import inside
    from scenarios.views.figures import file_name
    from testbed.files import write_whole
    from testbed.objects.export import to_sidecar, written

    if models and draws is None:
        raise InvalidValueError("--models", True, "with --draws N")
    row = row_of(folder, what)
    exported = exported_of(folder, row)
    text = written(exported, format_, inertial=inertial)
    name = file_name(f"{exported.name}_{row['key'][:8]}.{_ENDING[format_]}")
    path = out or inside(folder, "exports", name)
    for file, content in ((path, text), (path.with_suffix(".json"), to_sidecar(exported))):
        write_whole(file, lambda part, content=content: part.write_text(content, encoding="utf-8"))
        print(file)
    if draws is not None:
        table = posterior_table(folder, row, draws)
        write_whole(path.with_suffix(".draws.csv"), lambda part: table.to_csv(part, index=False))
        print(path.with_suffix(".draws.csv"))
        for number, drawn in enumerate(drawn_from(exported, table) if models else ()):
            file = path.with_suffix(".draws") / f"{number:04d}{path.suffix}"
            content = written(drawn, format_, inertial=inertial)
            write_whole(file, lambda part, content=content: part.write_text(content, encoding="utf-8"))
        if models:
            print(path.with_suffix(".draws"))


def posterior_table(folder: Path, row: Row, count: int) -> pd.DataFrame:
    """Draws from the posterior of a row's trials, one a row: mass of each group [kg], and frictions.

    Raises:
        InvalidValueError: an estimate that is not by Algorithm 1, or a count that the sampler cannot give.
    """
    import numpy as np
    import pandas as pd

    from estimators.hidden_states.estimator import HiddenStates
    from estimators.identifiability.posterior import sample_posterior
    from estimators.registry import METHODS, build_method
    from scenarios.results.estimates import load_estimate
    from scenarios.results.files import read_manifest
    from scenarios.results.store import Store
    from scenarios.results.trials import sensed_trials
    from scenarios.views.values import estimate_view
    from testbed.sensing.windows import weight_of

    scenario = (read_manifest(folder) or {}).get("scenario", {})
    kind = METHODS.get(row["kind"])  # of heft's own alone: a folder names no code to run
    answer, shape = load_estimate(folder, row["key"]), estimate_view(folder, row).shape
    method = build_method(row["kind"], scenario.get("methods", {}).get(row["method"], {})) if kind else None
    if not isinstance(method, HiddenStates) or answer.distribution is None:
        raise InvalidValueError("--draws", row["method"], "an estimate by hidden_states that has masses")
    weighing, *trials = sensed_trials(Store(folder), tuple(row["trial_keys"]), row["sensing"], int(row["seed"]))
    likelihood = method.likelihood(shape, weight_of(weighing), trials, answer.distribution)
    posterior = sample_posterior(likelihood, answer.distribution, seed=0, covariance=answer.covariance)
    if not 1 <= count <= len(posterior.mass):
        raise InvalidValueError("--draws", count, f"an integer from 1 to {len(posterior.mass)}")
    chosen = np.random.default_rng(0).choice(len(posterior.mass), count, replace=False)
    frictions = ["friction"] if shape.n_mu == 1 else [f"friction {k}" for k in range(shape.n_mu)]
    table = np.hstack([posterior.mass[chosen], posterior.friction[chosen]])
    return pd.DataFrame(table, columns=[*shape.group_names, *frictions])


def drawn_from(exported: Exported, table: pd.DataFrame) -> Iterator[Exported]:
    """The object with the masses and frictions of each draw of a `posterior_table` in place of the estimate's."""
    from testbed.objects.model import MassDistribution

    shape = exported.shape
    for number, values in enumerate(table.to_numpy()):
        at = MassDistribution(values[: shape.n_m] / shape.particles_per_group, values[shape.n_m :])
        notes = (*exported.notes, f"draw {number} from the posterior")
        yield replace(exported, distribution=at, covariance=None, notes=notes)


def exported_of(folder: Path, row: Row) -> Exported:
    """The masses of a row of the results, as they are exported.

    Raises:
        InvalidValueError: it has none.
    """
    from scenarios.views.values import estimate_view
    from testbed.objects.export import Exported

    view = estimate_view(folder, row)
    if view.answer is None:
        why = f"{row['status']}: {row['message']}"
        raise InvalidValueError("ESTIMATE", row["key"], f"one with masses; this one has none, {why}")
    why = f": {row['message']}" if row.get("message") else ""
    notes = (
        f"estimated by heft: {view.title}, draw {row['seed']}",
        f"status {row['status']}{why}",
        *([f"assumed, not tested: {row['assumes']}"] if row.get("assumes") else []),
        f"estimate {row['key']}",
    )
    return Exported(str(row["object"]), view.shape, view.answer, view.covariance, notes)
