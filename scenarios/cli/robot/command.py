"""`heft robot`: the table of its commands."""

from __future__ import annotations

from typing import Annotated

import tyro

from scenarios.cli.robot.calibrate import calibrate
from scenarios.cli.robot.check import check
from scenarios.cli.robot.hand_eye import hand_eye
from scenarios.cli.robot.sensor import sensor
from scenarios.cli.robot.trial import trial
from scenarios.cli.robot.verify import verify

Task = (
    Annotated[None, tyro.conf.subcommand(name="check", constructor=check)]
    | Annotated[None, tyro.conf.subcommand(name="sensor", constructor=sensor)]
    | Annotated[None, tyro.conf.subcommand(name="calibrate", constructor=calibrate)]
    | Annotated[None, tyro.conf.subcommand(name="hand-eye", constructor=hand_eye)]
    | Annotated[None, tyro.conf.subcommand(name="trial", constructor=trial)]
    | Annotated[None, tyro.conf.subcommand(name="verify", constructor=verify)]
)


def robot(task: Annotated[Task, tyro.conf.arg(name="")]) -> None:
    """The real robot: check it, look at its sensor, calibrate it, run a trial on it, and verify measured trials."""
