"""Whether the sensor's sign, rotation and zero hold, by the measured trials of a folder and physics alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console

from scenarios.results.measured import MeasuredTrial, measured_trials
from testbed.actions.base import Rotate, Slide, Weigh
from testbed.errors import InvalidValueError
from testbed.robot.calibration.trial import Finding, check_trial
from testbed.sensing.windows import mean_covariance, steady_windows, weight_of


def verify(folder: Path, console: Console) -> int:
    """Print what each object's trials tell; 0 where all is as it should be, else 1.

    Raises:
        InvalidValueError: no measured trials that tell anything.
    """
    sound = [t for t in measured_trials(folder) if t.trajectory.ok]
    told = {name: findings(sound, name) for name in dict.fromkeys(t.object for t in sound)}
    if not any(told.values()):
        raise InvalidValueError("DIR", str(folder), "a folder with measured turns, slides, or weighings by lifting")
    for name, found in told.items():
        for finding in found:
            line = f"{'ok' if finding.ok else 'wrong':8}{name}: {finding.said}"
            console.print(line, highlight=False, markup=False, soft_wrap=True)
    wrong = sum(not finding.ok for found in told.values() for finding in found)
    total = sum(len(found) for found in told.values())
    console.print(f"{wrong} of {total} findings are wrong" if wrong else f"all {total} findings are as they should be")
    return int(wrong > 0)


def findings(trials: list[MeasuredTrial], name: str) -> list[Finding]:
    """What the sound trials of one object tell: its last lift, its turns and slides at constant speed."""
    of = [t.trajectory for t in trials if t.object == name]
    weighings = [t for t in of if isinstance(t.action, Weigh)]
    lifts = [t for t in weighings if "weight_std_kg" in t.figures]
    read = [weight_of(t) for t in weighings if "weight_std_kg" not in t.figures]
    found: list[Finding] = []
    if lifts:
        felt = lifts[-1].wrench_on_object_world
        covariance = mean_covariance(felt) + np.diag(lifts[-1].sensor_bias_std ** 2)
        found += check_trial(felt.mean(axis=0), covariance, [], mass=read[-1] if read else None)
    for moved in of:
        if isinstance(moved.action, Rotate | Slide):
            found += check_trial(None, None, steady_windows(moved))
    return found
