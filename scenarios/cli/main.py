"""The `heft` command."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from scenarios.cli.identify import identify
from scenarios.cli.plan import plan
from scenarios.cli.robot.command import robot
from scenarios.cli.touch import touch
from testbed.errors import HeftError


def import_(
    mapping: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MAPPING")],
    logs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[LOG ...]")] = (),
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/lab"),
    weight: Annotated[float | None, tyro.conf.arg(metavar="KG")] = None,
    support: Annotated[str, tyro.conf.arg(metavar="SUPPORT")] = "own_weight",
) -> None:
    """Read another bench's logs (CSV, or MCAP with JSON messages) as trials, which every method can be asked about.

    MAPPING is a TOML file that says which column is what, in which unit, and what was done: docs/formats.md has one to
    begin with. All that is wrong is told at once, and then nothing is written. A log that is imported again, by a
    corrected mapping, takes the place of its earlier import. Exit code: 1 where a trial is no data.

    Examples: heft import lab.toml turn_1.csv turn_2.csv --weight 1.8
              heft import lab.toml                 (the logs that its [[logs]] name)
              heft estimate results/lab

    Args:
        mapping: TOML file.
        logs: .csv or .mcap files, one a trial; those that the mapping names if left out.
        out: results folder to put the trials into.
        weight: mass of the object as a scale said; every method needs it once.
        support: who carries the object's weight, as far as you know: own_weight, rigid, or a stiffness in N/m.
    """
    from rich.console import Console  # noqa: PLC0415

    from scenarios.cli.data import ImportRequest, import_logs  # noqa: PLC0415

    _end(import_logs(Console(), mapping, logs, ImportRequest(out, weight, support)))


def estimate(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    *,
    objects: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME ...")] = None,
    methods: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="METHOD ...")] = None,
    scenario: Annotated[str, tyro.conf.arg(metavar="SCENARIO")] = "blocks",
    held_out: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
) -> None:
    """Ask every method about the trials that a folder has of a real bench, and write its tables and report.

    The trials are those of heft robot trial and heft import, as they were measured: no sensor's errors are drawn. Those
    that are no data are left out. The last weighing counts. Masses in the object's file are taken for the truth: where
    they are a guess, so is the NAD, and only mass_kg of results.parquet says something.

    Exit code: 1 where some method has no answer.
    Examples: heft estimate results/robot --methods hidden_states explicit_state_M
              heft estimate results/lab --scenario my/scenario.toml --held-out 2

    Args:
        folder: results folder with measured trials.
        objects: names of the objects to ask about; all if left out.
        methods: labels of the scenario's methods, instead of all; or others: by name, or package:Class.
        scenario: whose methods, with their settings: name in the library, or path to a TOML file.
        held_out: last turns that no method is given, for the mean particle distance.
        workers: worker processes; one a core if left out, 0 runs everything in this process.
    """
    from scenarios.cli.data import EstimateRequest, estimate_recorded  # noqa: PLC0415

    _end(estimate_recorded(folder, EstimateRequest(objects, methods, scenario, held_out, workers)))


def _end(code: int) -> None:
    """With this exit code, where it is not that of success."""
    if code:
        sys.exit(code)


def run(
    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")] = "blocks",
    *,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    executor: Literal["inline", "local", "ray"] = "local",
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    methods: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="METHOD ...")] = None,
    seeds: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    objects: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="OBJECT ...")] = None,
    record: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    live: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    dry_run: bool = False,
) -> None:
    """Run a scenario: try every object under every support, ask every method, print the tables, write a report.

    Ctrl-C leaves whole files; the same command goes on from them, after kill -9 too.
    Examples: heft run blocks --objects L2 my/object.toml
              heft run my/scenario.toml --methods hidden_states explicit_state --seeds 20 --out results/tonight

    Args:
        scenario: name in the library (see heft scenarios), or path to a TOML file.
        out: folder for the results; results/<scenario> if left out.
        executor: inline (this process), local (worker processes), or ray (extra "ray"; joins a running cluster).
        workers: worker processes; one a core if left out, 0 runs everything in this process.
        methods: labels of the scenario's methods, instead of all; or others: by name, or package:Class.
        seeds: sensing draws of each trial; the scenario's own number if left out.
        objects: names in the library or paths to TOML files, instead of the scenario's own.
        record: write a recording of every trial and estimate as it is done, into DIR/recordings.
        live: show every trial and estimate as it is done in an open viewer, or in a new one.
        dry_run: say how many trials and estimates there are and how long they take, and run nothing.
    """
    from scenarios.cli.run import Asked, run_and_show  # noqa: PLC0415  torch and MuJoCo take seconds that --help need not wait for

    run_and_show(scenario, Asked(out, workers, executor, seeds, objects, methods, dry_run, record, live))


def status(folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]) -> None:
    """Say how far a results folder is: trials and estimates done, failures with their reasons.

    Args:
        folder: of a run, finished, running or stopped.
    """
    from scenarios.cli.progress import show_status  # noqa: PLC0415

    show_status(Console(), folder)


def report(folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]) -> None:
    """Write DIR/report.html: one file with tables, figures, failures and what is needed to run it again.

    Args:
        folder: of a finished run.
    """
    from scenarios.cli.report import report as write  # noqa: PLC0415

    print(write(folder))


def render(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    trial: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="TRIAL")] = None,
    *,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    width: Annotated[int, tyro.conf.arg(metavar="PX")] = 960,
    height: Annotated[int, tyro.conf.arg(metavar="PX")] = 640,
    fps: Annotated[float, tyro.conf.arg(metavar="N")] = 25.0,
    speed: Annotated[float, tyro.conf.arg(metavar="X")] = 1.0,
    camera: Literal["bench", "object", "above"] = "bench",
    at: Annotated[float | None, tyro.conf.arg(metavar="S")] = None,
    caption: bool = True,
) -> None:
    """Draw a recorded trial, simulated or real: a film (.mp4, .gif) or one picture (.png). Needs no display.

    Examples: heft render results/blocks                 (lists the trials)
              heft render results/blocks 3f9a --speed 4
              heft render results/blocks 3f9a --out turn.gif --camera above --width 480 --height 320 --fps 12.5

    Args:
        folder: of a run.
        trial: its key, or a beginning of it that no other has; left out, the trials are listed.
        out: file that ends in .mp4, .gif or .png; DIR/trials/TRIAL/trial.mp4 if left out.
        width: of the picture, px; even.
        height: of the picture, px; even.
        fps: pictures a second of film.
        speed: seconds of trial a second of film.
        camera: bench (all of it), object (close), or above (the object alone, with the arm out of the way).
        at: instant of the one picture of a .png, s; the middle if left out.
        caption: say in each picture what it shows, and when.
    """
    from scenarios.cli.render import Wish, list_trials, render_trial  # noqa: PLC0415

    if trial is None:
        list_trials(Console(), folder)
    else:
        print(render_trial(folder, trial, Wish(out, width, height, fps, speed, camera, at, caption)))


def watch(
    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="OBJECT|DIR")] = "L2",
    trial: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="TRIAL")] = None,
    *,
    action: Literal["rotate", "slide", "accelerate"] = "rotate",
    grasp: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    support: Annotated[str, tyro.conf.arg(metavar="SUPPORT")] = "own_weight",
) -> None:
    """Open a window on a trial: heft watch OBJECT simulates one as you look, heft watch DIR TRIAL plays a recorded one.

    Needs a display; heft render needs none. Space starts and stops, backspace begins again, F1 lists all keys.
    Examples: heft watch hammer --action slide --grasp handle_mid
              heft watch results/blocks 3f9a

    Args:
        what: an object, by name in the library or path to a TOML file; or the folder of a run.
        trial: key of a trial in that folder, or a beginning of it that no other has.
        action: what to simulate; with the action's own speed and duration.
        grasp: where it is gripped (see heft show); the first grasp if left out.
        support: who carries the weight: own_weight, rigid, or a stiffness in N/m.
    """
    from scenarios.cli.render import watch_live, watch_record  # noqa: PLC0415

    if trial is None:
        watch_live(what, action, grasp, support)
    else:
        watch_record(Path(what), trial)


def view(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    what: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="WHAT")] = None,
    *,
    web: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Open a trial, an estimate or a comparison of methods in the Rerun viewer.

    Examples: heft view results/blocks            every object under every method
              heft view results/blocks L2         one object under every method
              heft view results/blocks 3f9a       the trial or the estimate whose key begins so (see its report)

    Args:
        folder: of a run, finished or still running.
        what: an object, or the beginning of a trial's or an estimate's key; everything if left out.
        web: serve the viewer to a browser on this machine instead of opening a window.
    """
    from scenarios.cli.view import view as show_page  # noqa: PLC0415

    show_page(folder, what, web=web)


def record(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    what: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="WHAT")] = (),
    *,
    all_: Annotated[bool, tyro.conf.arg(name="all"), tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Write Rerun recordings: DIR/recording.rrd, or DIR/recordings/WHAT.rrd.

    `rerun FILE` opens one on any machine; it needs nothing else of the folder.

    Args:
        folder: of a run, finished or still running.
        what: objects, or beginnings of trials' or estimates' keys; every object under every method if left out.
        all_: every trial and estimate that has no recording yet, instead.
    """
    from scenarios.cli.view import record as write  # noqa: PLC0415

    write(folder, what, Console(), everything=all_)


def figures(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    what: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="ESTIMATE")] = None,
) -> None:
    """Draw figures for a paper, as PDF and PNG, into DIR/figures.

    Args:
        folder: of a finished run.
        what: beginning of an estimate's key: its maps, bars, losses and wrench fits; of the whole run if left out.
    """
    from scenarios.cli.report import show_figures  # noqa: PLC0415

    show_figures(Console(), folder, what)


def export(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ESTIMATE")],
    *,
    format_: Annotated[Literal["mjcf", "urdf", "toml"], tyro.conf.arg(name="format")] = "mjcf",
    inertial: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Write an estimate for another simulator: a box a block. A JSON beside it says how sure every mass is.

    Examples: heft export results/blocks 3f9a
              heft export results/blocks 3f9a --format urdf --inertial --out my_robot/hammer.urdf

    Args:
        folder: of a run.
        what: beginning of an estimate's key (see its report).
        format_: mjcf, urdf, or toml: an object file that heft itself can run.
        inertial: one mass, centre and inertia for the whole object instead.
        out: DIR/exports/OBJECT_KEY if left out, with the format's ending.
    """
    from scenarios.cli.export import export as write  # noqa: PLC0415

    for path in write(folder, what, format_, out, inertial=inertial):
        print(path)


def objects() -> None:
    """List the objects in the library."""
    from scenarios.cli.show import list_objects  # noqa: PLC0415

    list_objects(Console())


def scenarios() -> None:
    """List the scenarios in the library."""
    from scenarios.config import LIBRARY, scenario_names  # noqa: PLC0415

    for name in scenario_names():
        first = (LIBRARY / f"{name}.toml").read_text(encoding="utf-8").splitlines()[0].lstrip("# ")
        Console().print(f"{name}: {first}", highlight=False)


def show(object_: Annotated[str, tyro.conf.Positional, tyro.conf.arg(name="object", metavar="OBJECT")]) -> None:
    """Show one object: its blocks, mass, centre, inertia, and where it can be gripped.

    Args:
        object_: name in the library, or path to a TOML file.
    """
    from scenarios.cli.show import show_object  # noqa: PLC0415

    show_object(Console(), object_)


def main(arguments: list[str] | None = None) -> None:
    """Entry point: 0 done, 1 done but some trials or estimates failed, 2 a wrong argument or file, 130 interrupted."""
    try:
        tyro.extras.subcommand_cli_from_dict(
            {
                "run": run,
                "status": status,
                "report": report,
                "view": view,
                "record": record,
                "figures": figures,
                "export": export,
                "render": render,
                "watch": watch,
                "objects": objects,
                "scenarios": scenarios,
                "show": show,
                "identify": identify,
                "plan": plan,
                "touch": touch,
                "robot": robot,
                "import": import_,
                "estimate": estimate,
            },
            prog="heft",
            description="What can a robot learn about how an object's mass is spread, from the wrench at its wrist?",
            args=arguments,
        )
    except HeftError as error:
        print(f"heft: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # what reads our output has read enough: `heft ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        print(f"heft: {error.strerror or error}: {error.filename or ''}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("heft: stopped; the same command goes on from here", file=sys.stderr)
        sys.exit(130)
