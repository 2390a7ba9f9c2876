"""`heft robot verify`: the sensor's sign, rotation and zero tested by measured trials and physics alone."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from scenarios.results.trials import TrialRecord
    from testbed.robot.calibration.trial import Finding


def verify(folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]) -> None:
    """Test the sensor's sign, rotation and zero by measured trials and physics alone. Moves nothing.

    A hanging object pulls down, friction takes work out of every turn and slide, the force of a slide is against its
    motion, and the torque of a turn flips when it is turned back: that needs no masses. A scale's reading in the folder
    is compared with the lift. Best are a weighing by lifting, a turn there and back, and two slides.

    Exit code: 1 if something is wrong.
    Example: heft robot verify results/lab

    Args:
        folder: results folder of heft robot trial or heft import.
    """
    from rich.console import Console

    from scenarios.results.trials import measured_records
    from testbed.errors import InvalidValueError

    console = Console()
    sound = [t for t in measured_records(folder) if t.trajectory.ok]
    found = [
        (name, finding) for name in dict.fromkeys(t.object.name for t in sound) for finding in findings(sound, name)
    ]
    if not found:
        raise InvalidValueError("DIR", str(folder), "a folder with measured turns, slides, or weighings by lifting")
    for name, finding in found:
        line = f"{'ok' if finding.ok else 'wrong':8}{name}: {finding.text}"
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    wrong, total = sum(not finding.ok for _, finding in found), len(found)
    console.print(f"{wrong} of {total} findings are wrong" if wrong else f"all {total} findings are as they should be")
    if wrong:
        sys.exit(1)


def findings(trials: list[TrialRecord], name: str) -> list[Finding]:
    """Findings of one object's sound trials: its last lift, its turns and slides at constant speed."""
    import numpy as np

    from testbed.robot.calibration.trial import check_trial
    from testbed.sensing.windows import mean_covariance, steady_windows, weight_of

    records = [t.trajectory for t in trials if t.object.name == name]
    weighings = [t for t in records if not t.action.moves]
    lifts = [t for t in weighings if "weight_std_kg" in t.figures]
    scale = [weight_of(t) for t in weighings if "weight_std_kg" not in t.figures]
    found: list[Finding] = []
    if lifts:
        wrench = lifts[-1].wrench_on_object_world
        covariance = mean_covariance(wrench) + np.diag(lifts[-1].sensor_bias_std ** 2)
        found += check_trial(wrench.mean(axis=0), covariance, [], mass=scale[-1] if scale else None)
    for moved in records:
        if moved.action.on_table and not moved.action.accelerated:
            found += check_trial(None, None, steady_windows(moved))
    return found
