"""heft robot: check, sensor, calibrate, trial, verify. Signatures alone, so that --help loads nothing heavy."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

Config = Annotated[Path, tyro.conf.arg(metavar="FILE")]
Seconds = Annotated[float, tyro.conf.arg(metavar="S")]


def check(*, config: Config = Path("robot.toml")) -> None:
    """Say what of the real bench is there, what is missing, and what to do about it. Moves nothing.

    The bench is described by a file, robot.toml in the current folder: where its sensor, arm and table are, and what
    must never be done. docs/hardware.md has every field and the way from here to a first trial, step by step.

    Exit code: 0 all that a trial needs is there, 1 something is missing.
    Example: heft robot check --config benches/left.toml

    Args:
        config: of the bench; without a robot.toml, its defaults.
    """
    from rich.console import Console  # noqa: PLC0415

    from scenarios.cli.robot.check import check_bench  # noqa: PLC0415

    _end(check_bench(config, Console()))


def sensor(
    *,
    config: Config = Path("robot.toml"),
    port: Annotated[str | None, tyro.conf.arg(metavar="DEVICE")] = None,
    seconds: Seconds = 30.0,
    mass: Annotated[float | None, tyro.conf.arg(metavar="KG")] = None,
    viewer: bool = True,
) -> None:
    """Show the FT-300S live in Rerun, or as a line a second; or check it against a known mass. Moves nothing.

    Numbers are mean +- standard deviation over a second, forces then torques, with the sensor's own zero and sign.
    Exit code: 1 where it disagrees with the mass, or loses more than one frame in a hundred.
    Examples: heft robot sensor --port /dev/ttyUSB0 --no-viewer --seconds 5
              heft robot sensor --mass 2

    Args:
        config: of the bench; only its sensor is used.
        port: device file of the sensor, instead of the config's.
        seconds: how long to show it.
        mass: a known mass to hang from the tool: asked for, weighed, and compared.
        viewer: Rerun; without it, or where none can open, numbers.
    """
    from scenarios.cli.robot.sensor import show_sensor  # noqa: PLC0415

    _end(show_sensor(config, port, seconds, mass, viewer=viewer))


def calibrate(*, config: Config = Path("robot.toml"), seconds: Seconds = 3.0) -> None:
    """Find how the sensor sits, its sign, and what the tool weighs. Moves nothing: you move the arm, by its joystick.

    Bring the arm into six or more poses, tilted by 30 degrees and more about two axes and both ways, one of them upside
    down or level; at each, wait until it stands and press Enter. From the sixth on it says how well all is known. The
    result goes to calibration.toml beside the bench's file, for this sensor and what hangs from it alone.

    Args:
        config: of the bench; names the file to write ([sensor] calibration).
        seconds: of measuring in each pose.
    """
    from scenarios.cli.robot.calibrate import calibrate_sensor  # noqa: PLC0415

    calibrate_sensor(config, seconds)


def trial(
    object_: Annotated[str, tyro.conf.Positional, tyro.conf.arg(name="object", metavar="OBJECT")],
    *,
    action: Literal["rotate", "slide", "accelerate", "weigh"] = "rotate",
    grasp: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    seconds: Annotated[float | None, tyro.conf.arg(metavar="S")] = None,
    speed: Annotated[float | None, tyro.conf.arg(metavar="V")] = None,
    pivot: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y")] = None,
    direction: Annotated[float, tyro.conf.arg(metavar="DEG")] = 0.0,
    back: bool = True,
    at: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y DEG")] = None,
    weight: Annotated[float | None, tyro.conf.arg(metavar="KG")] = None,
    support: Annotated[str, tyro.conf.arg(metavar="SUPPORT")] = "own_weight",
    config: Config = Path("robot.toml"),
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/robot"),
    dry_run: bool = False,
) -> None:
    """Run one trial on the real arm and store it. The motion is shown, and made only after you have typed yes.

    Exit code: 1 where the trial is no data.
    Examples: heft robot trial L2 --grasp A2 --dry-run
              heft robot trial L2 --grasp A2 --speed 5 --seconds 2 --out results/lab
              heft robot trial L2 --action weigh --weight 1.8 --out results/lab
              heft estimate results/lab

    Args:
        object_: name in the library, or path to a TOML file.
        action: what to do.
        grasp: where to grip, as heft show names it; the first one if left out.
        seconds: at constant speed; the action's own if left out.
        speed: deg/s of a turn, m/s of a slide.
        pivot: centre of a turn, mm from the object's middle; between particles beside the grasp if left out.
        direction: of a slide, in the object's frame.
        back: turn back again in the same grasp.
        at: where the object's middle lies, m, and how it is turned, base frame of the arm; where it must be put for the
            simulated bench's path if left out.
        weight: what a scale said, with --action weigh; nothing moves then.
        support: who carries the object's weight, as far as you know; kept with the record.
        config: of the bench.
        out: results folder.
        dry_run: say where everything would go and how fast, and connect to nothing.
    """
    from scenarios.cli.robot.trial import Asked, run_trial  # noqa: PLC0415

    asked = Asked(action, grasp, seconds, speed, pivot, direction, back, at, weight, support)
    _end(run_trial(object_, asked, config, out, dry_run=dry_run))


def verify(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
) -> None:
    """Say whether the sensor's sign, rotation and zero hold, by measured trials and physics alone. Moves nothing.

    A hanging object pulls down, friction takes work out of every turn and slide, a slide is felt against its motion,
    and what is felt in a turn flips when it is turned back: that needs no masses. A scale's reading in the folder is
    held against the lift. Best are a weighing by lifting, a turn there and back, and two slides.

    Exit code: 1 where something is wrong.
    Example: heft robot verify results/lab

    Args:
        folder: results folder of heft robot trial or heft import.
    """
    from rich.console import Console  # noqa: PLC0415

    from scenarios.cli.robot.verify import verify as say  # noqa: PLC0415

    _end(say(folder, Console()))


def _end(code: int) -> None:
    """With this exit code, where it is not that of success."""
    if code:
        sys.exit(code)


Task = (
    Annotated[None, tyro.conf.subcommand(name="check", constructor=check)]
    | Annotated[None, tyro.conf.subcommand(name="sensor", constructor=sensor)]
    | Annotated[None, tyro.conf.subcommand(name="calibrate", constructor=calibrate)]
    | Annotated[None, tyro.conf.subcommand(name="trial", constructor=trial)]
    | Annotated[None, tyro.conf.subcommand(name="verify", constructor=verify)]
)


def robot(task: Annotated[Task, tyro.conf.arg(name="")]) -> None:
    """The real bench: check it, look at its sensor, calibrate it, run a trial on it, and see what trials say of it."""
