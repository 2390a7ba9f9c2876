"""The heft command: a table of its subcommands. Only the module of the called one is imported."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from importlib import import_module
from importlib.metadata import version
from inspect import signature
from operator import or_
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import tyro

from testbed.errors import HeftError
from testbed.files import print_damage_plainly
from testbed.packages import hidden_package

PATIENCE = 2.0
"""Time that a thread may take to end after the command has [s]."""
COMMANDS = {
    "run": ("scenarios.cli.run:run", "Run a scenario: trials, estimates of every method, tables and a report."),
    "status": ("scenarios.cli.run:status", "Show the progress and the failures of a results folder."),
    "view": ("scenarios.cli.view:view", "View results in Rerun, or write recordings, figures or films."),
    "doctor": ("scenarios.cli.doctor:doctor", "Diagnose a setup from how its trials disagree."),
    "export": ("scenarios.cli.export:export", "Export an estimate as a model, or a trial as ROS 2 messages."),
    "objects": ("scenarios.cli.view:objects", "List the objects in the library."),
    "show": ("scenarios.cli.view:show", "Show one object: blocks, mass, center of mass, inertia and grasps."),
    "mesh": ("scenarios.cli.mesh:mesh", "Convert mesh files to objects: repaired, cut into parts, with grasps."),
    "scenarios": ("scenarios.cli.view:scenarios", "List the scenarios in the library."),
    "methods": ("scenarios.cli.view:methods", "List built-in and installed methods with their settings."),
    "watch": ("scenarios.cli.film:watch", "Show a simulated or recorded trial in a window."),
    "identify": ("scenarios.cli.plan:identify", "Predict how well trials of an object determine its masses."),
    "plan": ("scenarios.cli.plan:plan", "Plan actions that determine an object's masses in little robot time."),
    "touch": ("scenarios.cli.touch:touch", "Plan and simulate actions until an object's masses are known."),
    "benchmark make": ("scenarios.cli.benchmark.make:make", "Simulate a benchmark with hidden test masses."),
    "benchmark answer": ("scenarios.cli.benchmark.answer:answer", "Answer the problems of a benchmark, as CSV."),
    "score": ("scenarios.cli.benchmark.score:score", "Score answers to a benchmark: accuracy, honesty, robot time."),
    "learn": ("scenarios.cli.learn.learn:learn", "Train the network of the method `learned` on simulated trials."),
    "import": ("scenarios.cli.data:import_", "Import another robot's logs (CSV, Parquet, HDF5, MCAP, bags)."),
    "estimate": ("scenarios.cli.data:estimate", "Estimate masses from the measured trials of a folder."),
    "calibrate": ("scenarios.cli.data:calibrate", "Calibrate a force/torque sensor from a recording of still poses."),
    "payload": ("scenarios.cli.export:payload", "Write the payload of a robot's flange for its controller."),
    "robot check": ("scenarios.cli.robot.check:check", "Check which parts of the robot are available."),
    "robot sensor": ("scenarios.cli.robot.sensor:sensor", "Show the sensor live, or check it with a known mass."),
    "robot calibrate": ("scenarios.cli.robot.calibrate:calibrate", "Estimate the sensor rotation and the tool mass."),
    "robot hand-eye": ("scenarios.cli.robot.calibrate:hand_eye", "Estimate a tracker's pose in the arm's base frame."),
    "robot trial": ("scenarios.cli.robot.trial:trial", "Run one trial on the real arm and store it."),
    "robot verify": ("scenarios.cli.robot.check:verify", "Test the sensor's sign, rotation and zero with trials."),
}  # fmt: skip
"""Path of the function of each command, and its line in `heft --help`."""
GROUPS = {
    "benchmark": "A benchmark with hidden truth: make it, and answer it with heft's methods or your own.",
    "robot": "The real robot: check, sensor, calibration, trials, verification.",
}
"""First words of commands of two words."""
TOPICS = {"run": "Run and compare", "objects": "Objects and library", "identify": "Plan", "benchmark make": "Benchmark",
          "import": "Measured data", "robot check": "Real robot"}  # fmt: skip
"""Headings of `heft --help`, by the first command under each."""
ABOUT = "What can a robot learn about an object's mass distribution from the wrench at its wrist?"


def main(arguments: list[str] | None = None) -> None:
    """Run heft. Exit codes: 0 done, 1 failed trials or estimates, 2 a wrong argument or file, 130 or 143 stopped."""
    arguments = sys.argv[1:] if arguments is None else arguments
    print_damage_plainly()
    if hidden := hidden_package():
        print(f"heft: {hidden}", file=sys.stderr)
        sys.exit(2)
    if len(arguments) == 1 and arguments[0] in GROUPS:
        arguments = [*arguments, "--help"]
    try:
        if arguments == ["--version"]:
            print(f"heft {version('heft-testbed')}")
            return
        if not arguments or arguments[0] in ("-h", "--help"):
            print(overview())
            sys.exit(0)
        tyro.extras.subcommand_cli_from_dict(
            commands_of(arguments),
            prog="heft",
            description=ABOUT,
            args=arguments,
        )
    except HeftError as error:
        print(f"heft: {error}", file=sys.stderr)
        sys.exit(2)
    except ImportError as error:
        print(f"heft: this installation is incomplete: {error}; install heft-testbed again", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:
        _discard_output()
    except OSError as error:
        place = f": {error.filename}" if error.filename else ""
        print(f"heft: {error.strerror or error}{place}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt as stop:
        print("heft: stopped; run the same command again to continue", file=sys.stderr)
        sys.exit(143 if isinstance(stop, _Terminated) else 130)


class _Terminated(KeyboardInterrupt):
    """SIGTERM, which ends a command as Ctrl-C does."""


def _terminate(*_: object) -> None:
    raise _Terminated


def command() -> None:
    """Console command: run `main`, and exit even if a plug-in leaves threads running."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # problems are small: threads take longer than they save
    code: Any = 0
    signal.signal(signal.SIGTERM, _terminate)
    try:
        main()
    except SystemExit as end:
        code = end.code
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        _discard_output()
    left = [thread for thread in threading.enumerate() if not thread.daemon and thread is not threading.main_thread()]
    for thread in left:
        thread.join(PATIENCE)
    if names := [thread.name for thread in left if thread.is_alive()]:
        print(f"heft: ended with threads of a plug-in still running: {', '.join(names)}", file=sys.stderr)
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code if isinstance(code, int) else 0 if code is None else 1)
    sys.exit(code)


def _discard_output() -> None:
    """Discard further output, whose reader has closed the pipe, as in `heft ... | head`."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def commands_of(arguments: Sequence[str]) -> dict[str, Callable[..., None]]:
    """Functions of all commands by their first word: the called one, and placeholders for the others."""
    words = [word for word in arguments if not word.startswith("-")]
    completion = any(word.startswith("--tyro-") for word in arguments)  # a shell's completion knows every option
    functions: dict[str, Callable[..., None]] = {}
    groups: dict[str, dict[str, Callable[..., None]]] = {}
    for name, (path, line) in COMMANDS.items():
        first, *rest = name.split()
        called = completion or words[: len(rest) + 1] == [first, *rest]
        function = load(path) if called else _placeholder(line)
        if rest:
            groups.setdefault(first, {})[" ".join(rest)] = function
            functions[first] = function  # until its group is whole
        else:
            functions[first] = function
    return functions | {first: _group(group, GROUPS[first]) for first, group in groups.items()}


def overview() -> str:
    """Text of `heft --help`: the commands by topic."""
    lines = [
        "usage: heft COMMAND [OPTIONS]    heft COMMAND --help explains one, heft --version prints the version",
        "",
        ABOUT,
    ]
    for name, (_, line) in COMMANDS.items():
        lines += ["", TOPICS[name]] if name in TOPICS else []
        lines.append(f"  {name:<16} {line}")
    return "\n".join(lines)


def load(path: str) -> Callable[..., None]:
    """Function at "module:name", whose help omits defaults of None, False and empty tuples."""
    module, name = path.split(":")
    function = getattr(import_module(module), name)
    hints = get_type_hints(function, include_extras=True)
    function.__annotations__ |= {name: _hinted(hints[name]) for name in signature(function).parameters}
    return function


def _hinted(hint: Any) -> Any:
    """Annotation of an option whose help has its default by `default_hint`, and no None among its choices."""
    from scenarios.cli.terminal import default_hint

    bare = get_args(hint)[0] if get_origin(hint) is Annotated else hint
    choices = [choice for part in get_args(bare) if get_origin(part) is Literal for choice in get_args(part)]
    metavar = f"{{{','.join(choices)}}}" if type(None) in get_args(bare) and choices else None
    return Annotated[hint, tyro.conf.arg(help_behavior_hint=default_hint, metavar=metavar)]


def _placeholder(line: str) -> Callable[[], None]:
    def command() -> None: ...

    command.__doc__ = line
    return command


def _group(functions: Mapping[str, Callable[..., None]], line: str) -> Callable[..., None]:
    """Command whose second word selects one of these functions."""
    choices: list[Any] = [Annotated[None, tyro.conf.subcommand(name=n, constructor=f)] for n, f in functions.items()]

    def group(task: None) -> None: ...

    group.__annotations__ = {"task": Annotated[reduce(or_, choices), tyro.conf.arg(name="")], "return": None}
    group.__doc__ = line
    return group
